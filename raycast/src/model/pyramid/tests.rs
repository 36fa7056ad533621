use super::*;
use terravision_common::surface::facet::facet_linear;

const CELLS: u32 = 8;
const POSTS: usize = 9;
const STRIDE: u32 = 96;
const LEVELS: u8 = 4;

fn random(seed: &mut u64) -> f64 {
    *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*seed >> 11) as f64 / (1u64 << 53) as f64
}

/// A pool of as many tiles, every post of them another height.
fn pool(tiles: usize, seed: &mut u64) -> Vec<f32> {
    (0..tiles * STRIDE as usize).map(|_| (100.0 * random(seed)) as f32).collect()
}

fn empty(slots: u32, exaggeration: f32) -> Pyramid {
    let shape = PoolShape { slots, stride: STRIDE, exaggeration, has_validity: false };
    Pyramid::new(shape, Plane::new(10.0, [u32::MAX; 2], CELLS), LEVELS)
}

/// A tree with some of its nodes left out.
fn fill(pyramid: &mut Pyramid, heights: &[f32], seed: &mut u64) {
    pyramid.clear();
    let (mut open, mut slot) = (vec![([0u32; 2], LEVELS - 1)], 0);
    while let Some((origin, level)) = open.pop() {
        pyramid.add(&PoolTile { origin, level, slot, generation: 1 }, heights).unwrap();
        slot += 1;
        if level > 0 && random(seed) < 0.8 {
            let side = CELLS << (level - 1);
            let corners = [[0, 0], [side, 0], [0, side], [side, side]];
            open.extend(
                corners.iter().filter(|_| random(seed) < 0.9).map(|by| ([0, 1].map(|n| origin[n] + by[n]), level - 1)),
            );
        }
    }
    pyramid.finish();
}

fn height_of(
    pyramid: &Pyramid,
    heights: &[f32],
    point: [f64; 2],
    away2: f32,
    distances: &LevelDistances,
) -> Option<f32> {
    let Source::Tile(source) = pyramid.find(point, away2, distances) else { return None };
    assert!((source.from2..source.until2).contains(&away2), "{source:?}, {away2}");
    let at = |first: u32, [u, v]: [f64; 2]| {
        let [i, j] = [u, v].map(|at| (at as usize).min(POSTS - 2));
        let z = |i: usize, j: usize| heights[first as usize + j * POSTS + i];
        facet_linear(z(i, j), z(i + 1, j), z(i, j + 1), z(i + 1, j + 1), (u - i as f64) as f32, (v - j as f64) as f32)
    };
    let own = [0, 1].map(|n| (point[n] - f64::from(source.origin[n])) / f64::from(1u32 << source.level));
    let next = [0, 1].map(|n| 0.5 * own[n] + f64::from(source.next_corner[n]));
    let over = source.until2 - source.blend_from2;
    let share =
        if over.is_finite() && over > 0.0 { ((away2 - source.blend_from2) / over).clamp(0.0, 1.0) } else { 0.0 };
    let height = at(source.first, own);
    let next = if share > 0.0 { at(source.next_first, next) } else { height };
    Some((height + share * (next - height)) * pyramid.exaggeration())
}

#[test]
fn no_ground_rises_above_the_bound_of_a_rectangle_or_of_all() {
    let mut seed = 7;
    let heights = pool(85, &mut seed);
    let mut pyramid = empty(85, 1.5);
    let distances = LevelDistances::new(&Plane::new(10.0, [u32::MAX; 2], CELLS), 100.0, 5.0);
    let (mut found, mut above) = (0, 0);
    for _ in 0..300 {
        fill(&mut pyramid, &heights, &mut seed);
        let end = f64::from(CELLS << (LEVELS - 1));
        let low = [0, 1].map(|_| random(&mut seed) * end);
        let high = low.map(|low| (low + random(&mut seed).powi(3) * end).min(end - 0.01));
        let near2 = (4000.0 * random(&mut seed).powi(2)).powi(2) as f32;
        let far2 = near2 * (1.0 + random(&mut seed) as f32);
        let limit = (150.0 * random(&mut seed)) as f32;
        let rises = pyramid.rises_above(limit, [low, high], [near2, far2], &distances);
        let all = pyramid.highest(&distances, |_, _| far2);
        above += u32::from(rises);
        for _ in 0..40 {
            let point = [0, 1].map(|n| low[n] + random(&mut seed) * (high[n] - low[n]));
            let away2 = near2 + random(&mut seed) as f32 * (far2 - near2);
            if let Some(height) = height_of(&pyramid, &heights, point, away2, &distances) {
                found += 1;
                assert!(rises || height <= limit * 1.000_01, "{height} is above {limit}");
                assert!(height <= all * 1.000_01, "{height} is above all, {all}");
            }
        }
    }
    assert!(found > 5000 && above > 50 && above < 290, "{found} points, {above} of 300 rise");
}

#[test]
fn what_a_slot_holds_is_looked_at_once_for_each_generation() {
    let mut seed = 3;
    let mut heights = pool(2, &mut seed);
    let mut pyramid = empty(2, 1.0);
    let root = PoolTile { origin: [0; 2], level: LEVELS - 1, slot: 1, generation: 4 };
    let range = |pyramid: &mut Pyramid, tile: &PoolTile, heights: &[f32]| {
        pyramid.clear();
        pyramid.add(tile, heights).map(|()| pyramid.finish())
    };
    let before = range(&mut pyramid, &root, &heights).unwrap();
    heights[STRIDE as usize + 40] = 5000.0;
    assert_eq!(range(&mut pyramid, &root, &heights).unwrap(), before);
    assert_eq!(range(&mut pyramid, &PoolTile { generation: 5, ..root }, &heights).unwrap(), [before[0], 5000.0]);
    heights[STRIDE as usize + 80] = f32::NAN;
    let error = range(&mut pyramid, &PoolTile { generation: 6, ..root }, &heights);
    assert_eq!(error, Err(GroundError::Height { origin: [0; 2], index: 80 }));
    let beyond = range(&mut pyramid, &PoolTile { slot: 2, ..root }, &heights);
    assert!(matches!(beyond, Err(GroundError::Cells { .. })), "{beyond:?}");
    let orphan = range(&mut pyramid, &PoolTile { level: 0, slot: 0, ..root }, &heights);
    assert_eq!(orphan, Err(GroundError::Unattached { origin: [0; 2], level: 0 }));
    let twice = range(&mut pyramid, &PoolTile { generation: 5, ..root }, &pool(2, &mut seed));
    assert!(twice.is_ok() && pyramid.add(&root, &heights) == Err(GroundError::Occupied { origin: [0; 2] }));
}
