//! Light on ground that is known by a formula.

use super::elevations::Elevations;
use super::{LightScratch, Lighting};
use std::collections::HashMap;
use std::sync::Arc;
use terravision_common::light::{LightConfig, Sun};
use terravision_common::node::NodeId;
use terravision_common::world::{COLOR_BORDER, World, WorldFields};
use terravision_testkit::worlds::fields;

/// Metres from post to post on the finest level.
const UNIT_M: f64 = 10.0;

/// All elevation tiles of a world.
struct Tiles(HashMap<NodeId, Arc<[f32]>>);

impl Elevations for Tiles {
    fn posts(&self, node: NodeId) -> Option<Arc<[f32]>> {
        self.0.get(&node).cloned()
    }
}

/// 256 x 256 posts, tiles of 8 intervals and 32 texels; colour down to texels of a post.
fn world() -> World {
    World::new(WorldFields { finest_color_level: 2, ..fields([256; 2], UNIT_M, [8, 32]) }).unwrap()
}

/// The pyramid over heights at posts: each coarser level is a half-band of the finer one.
fn tiles(world: &World, height: impl Fn(f64, f64) -> f64) -> Tiles {
    let mut side = 257usize;
    let mut level: Vec<f32> =
        (0..side * side).map(|k| height((k % side) as f64 * UNIT_M, (k / side) as f64 * UNIT_M) as f32).collect();
    let mut tiles = HashMap::new();
    for q in 0..world.levels() {
        let [columns, rows] = world.nodes_at(q);
        for node in (0..columns * rows).map(|k| NodeId::new(k % columns, k / columns, q).unwrap()) {
            let at = |axis: u32, k: u32| ((axis * 8 + k) as usize).min(side - 1);
            let posts = (0..81).map(|k| level[at(node.n(), k / 9) * side + at(node.m(), k % 9)]);
            tiles.insert(node, posts.collect());
        }
        let half = side.div_ceil(2);
        let of = |x: usize, y: usize| level[y.min(side - 1) * side + x.min(side - 1)];
        let coarse = |x: usize, y: usize| {
            let tap = |k: usize, by: usize| (2 * k + by).saturating_sub(1);
            let sum: f32 = (0..9)
                .map(|k| [1.0, 2.0, 1.0][k % 3] * [1.0, 2.0, 1.0][k / 3] * of(tap(x, k % 3), tap(y, k / 3)))
                .sum();
            sum / 16.0
        };
        let next = (0..half * half).map(|k| coarse(k % half, k / half)).collect();
        (level, side) = (next, half);
    }
    Tiles(tiles)
}

fn sun(azimuth_deg: f64, altitude_deg: f64) -> Sun {
    Sun { azimuth_deg, altitude_deg }
}

/// The red of a tile of one grey, lit; rows from the north, with its border.
fn lit(tiles: &Tiles, node: NodeId, sun: Sun, has_shadows: bool) -> Vec<u8> {
    let world = world();
    let lighting = Lighting::new(&world, &LightConfig { sun, has_shadows, relief: 1.0, tint: None }, 1.0);
    let side = world.color_stored() as usize;
    let mut texels = [140, 140, 140, 255].repeat(side * side);
    lighting.light(node, &mut texels, tiles, &mut LightScratch::default());
    assert!(texels.chunks_exact(4).all(|texel| texel[3] == 255));
    texels.chunks_exact(4).map(|texel| texel[0]).collect()
}

fn hills(x: f64, y: f64) -> f64 {
    let wave = |length: f64, turn: f64| ((x * turn.cos() + y * turn.sin()) / length).sin();
    150.0 * wave(240.0, 0.3) * wave(310.0, 1.9) + 40.0 * wave(61.0, 1.1) + 12.0 * wave(24.0, 2.5)
}

#[test]
fn a_plane_is_as_bright_as_the_formula_says() {
    let world = world();
    for (east, north) in [(0.0, 0.0), (0.3, -0.2), (-0.8, 0.1), (0.0, 1.5)] {
        let tiles = tiles(&world, |x, y| 500.0 + east * x + north * y);
        for sun in [Sun::AUTO, sun(100.0, 8.0), sun(200.0, 60.0), sun(20.0, -15.0)] {
            let [x, y, z] = sun.direction();
            let normal = (1.0f64 + east * east + north * north).sqrt();
            let falls = ((z - east * x - north * y) / normal).max(0.0);
            let brightness = sun.brightness();
            let expected = 140.0 * (f64::from(brightness.ambient[0]) + f64::from(brightness.direct[0]) * falls);
            // In the middle of the world: its border repeats beyond.
            let found = lit(&tiles, NodeId::new(3, 4, 2).unwrap(), sun, false);
            let expected = expected.min(255.0);
            assert!(
                found.iter().all(|v| (f64::from(*v) - expected).abs() <= 0.51),
                "{east} {north} {sun:?}: {expected} {}",
                found[700]
            );
        }
    }
}

#[test]
fn tiles_beside_each_other_agree_along_their_border() {
    let world = world();
    let tiles = tiles(&world, hills);
    let (side, border) = (world.color_stored() as usize, COLOR_BORDER as usize);
    for (q, has_shadows) in [(2, false), (2, true), (3, true), (4, true)] {
        let of = |m: u32, n: u32| lit(&tiles, NodeId::new(m, n, q).unwrap(), sun(130.0, 14.0), has_shadows);
        let (west, east, north) = (of(0, 0), of(1, 0), of(0, 1));
        assert!(west.iter().max().unwrap() - west.iter().min().unwrap() > 60, "there is something to see");
        for row in 0..side {
            // What is the border of one is inside the other.
            let [a, b] = [&west[row * side..][side - 2 * border..side], &east[row * side..][..2 * border]];
            assert_eq!(a, b, "level {q}, row {row}");
        }
        let [a, b] = [&west[..2 * border * side], &north[(side - 2 * border) * side..]];
        assert!(a == b, "level {q}");
    }
}

#[test]
fn a_level_is_lit_as_the_finer_one_is_on_the_whole() {
    let world = world();
    let tiles = tiles(&world, hills);
    let (side, border) = (world.color_stored() as usize, COLOR_BORDER as usize);
    let inner = world.color_tile() as usize;
    for (has_shadows, most) in [(false, (7.0, 18)), (true, (7.0, 25))] {
        let sun = sun(130.0, 20.0);
        for parent in [(1, 1, 3), (2, 1, 3), (1, 1, 4)].map(|(m, n, q)| NodeId::new(m, n, q).unwrap()) {
            let coarse = lit(&tiles, parent, sun, has_shadows);
            let fine: Vec<Vec<u8>> = (0..4).map(|k| lit(&tiles, parent.child(k).unwrap(), sun, has_shadows)).collect();
            // Texels of the parent, from its south west corner, and the mean of the four below.
            let of = |tile: &[u8], x: usize, y: usize| u32::from(tile[(side - 1 - border - y) * side + border + x]);
            let mut apart: Vec<u8> = (0..inner * inner)
                .map(|k| {
                    let [x, y] = [k % inner, k / inner].map(|at| 2 * at);
                    let child = &fine[x / inner + 2 * (y / inner)];
                    let four = (0..4).map(|k| of(child, x % inner + k % 2, y % inner + k / 2)).sum::<u32>();
                    of(&coarse, x / 2, y / 2).abs_diff((four + 2) / 4) as u8
                })
                .collect();
            apart.sort_unstable();
            let mean = apart.iter().map(|v| f64::from(*v)).sum::<f64>() / apart.len() as f64;
            let high = apart[apart.len() * 99 / 100];
            println!("level {}, shadows {has_shadows}: mean {mean:.2}, 99 of 100 within {high}", parent.q());
            assert!(mean < most.0 && high < most.1, "{parent}: mean {mean}, 99 of 100 within {high}");
        }
    }
}

#[test]
fn a_wall_throws_a_shadow_as_long_as_the_sun_is_low() {
    let world = world();
    // 50 m high, 160 m wide, from south to north at 1280 m; the sun in the east.
    let tiles = tiles(&world, |x, _| if (1280.0..=1440.0).contains(&x) { 50.0 } else { 0.0 });
    for altitude_deg in [4.0, 10.0, 25.0] {
        let length = 50.0 / f64::to_radians(altitude_deg).tan();
        let direct = sun(90.0, altitude_deg);
        let flat = lit(&tiles, NodeId::new(7, 3, 2).unwrap(), direct, true)[0];
        let shade = (140.0 * direct.brightness().ambient[0] + 0.5) as u8;
        assert!(flat > shade + 8, "{flat} {shade}");
        let mut end = 0.0;
        for m in 0..4 {
            let side = world.color_stored() as usize;
            let tile = lit(&tiles, NodeId::new(m, 3, 2).unwrap(), direct, true);
            let row = &tile[20 * side + COLOR_BORDER as usize..][..32];
            for (k, value) in row.iter().enumerate() {
                let x = (f64::from(m) * 32.0 + k as f64 + 0.5) * UNIT_M;
                if x > 1295.0 - 0.9 * length && x < 1265.0 {
                    assert_eq!(*value, shade, "{x} m, {altitude_deg} degrees");
                } else if x < 1280.0 - length - 40.0 {
                    assert_eq!(*value, flat, "{x} m, {altitude_deg} degrees");
                    end = x;
                }
            }
        }
        assert!(end > 0.0 || length > 1200.0);
    }
}

#[test]
fn water_is_flat_and_missing_tiles_are_lit_as_coarser_ground() {
    let world = world();
    let whole = tiles(&world, |x, y| hills(x, y).max(0.0));
    // One grey wherever all is water.
    let node = NodeId::new(2, 2, 2).unwrap();
    let found = lit(&whole, node, sun(300.0, 40.0), false);
    let level = (140.0 * sun(300.0, 40.0).brightness().ambient[0]
        + 140.0 * sun(300.0, 40.0).brightness().direct[0] * f32::sin(40f32.to_radians())
        + 0.5) as u8;
    assert!(found.iter().filter(|v| **v == level).count() > 50, "{level}");
    // Without the finest level in the east ground is that of the next one there, and nothing fails.
    let mut holed = tiles(&world, hills);
    holed.0.retain(|node, _| node.q() > 0 || node.m() < 20);
    let all = tiles(&world, hills);
    let at = |tiles: &Tiles, m: u32| lit(tiles, NodeId::new(m, 3, 2).unwrap(), sun(300.0, 40.0), true);
    assert_eq!(at(&holed, 2), at(&all, 2), "far from what is missing");
    let apart = at(&holed, 7).iter().zip(at(&all, 7)).map(|(a, b)| u32::from(a.abs_diff(b))).sum::<u32>();
    let count = at(&all, 7).len() as u32;
    assert!(apart > 0 && apart < 12 * count, "{} a texel", f64::from(apart) / f64::from(count));
    let nothing = Tiles(HashMap::new());
    assert!(lit(&nothing, node, Sun::AUTO, true).iter().all(|v| (139..=141).contains(v)));
}
