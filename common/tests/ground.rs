//! Answers against brute force: every facet of the finest level, one by one.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use glam::{DVec2, DVec3};
use proptest::prelude::*;
use std::collections::HashSet;
use std::sync::atomic::{AtomicUsize, Ordering};
use terravision_common::database::{Layer, NodeRanges, TileError, TileScratch, TileSource};
use terravision_common::ground::{Answer, GroundScratch, GroundTiles, Interpolation, LineOfSight, NoGround, Touch};
use terravision_common::node::NodeId;
use terravision_common::validity::Validity;
use terravision_common::world::{World, WorldFields};

const SPACING_M: f64 = 10.0;

/// A rough world of 10 m posts, of tiles of 4 cells; some posts are holes, some tiles broken.
struct Rough {
    world: World,
    seed: u32,
    broken: HashSet<NodeId>,
    reads: AtomicUsize,
}

fn noise(x: u64, y: u64, seed: u32) -> f32 {
    let h =
        (x as u32).wrapping_mul(0x9E37_79B9) ^ (y as u32).wrapping_mul(0x85EB_CA6B) ^ seed.wrapping_mul(0xC2B2_AE35);
    let h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    ((h ^ (h >> 13)) & 0xFFF) as f32 / 128.0
}

impl Rough {
    fn new(extent: [u32; 2], seed: u32, has_holes: bool) -> Self {
        let nodes = extent[0].max(extent[1]).div_ceil(4).next_power_of_two();
        let fields = WorldFields {
            origin: [500_000.0, 4_000_000.0],
            lattice_unit_m: SPACING_M,
            extent,
            elevation_tile: 4,
            color_tile: 16,
            levels: nodes.ilog2() as u8 + 1,
            finest_elevation_level: 0,
            finest_color_level: 0,
            body: None,
        };
        let world = World::new(fields).unwrap();
        let world = if has_holes { world.with_validity(true) } else { world };
        Self { world, seed, broken: HashSet::new(), reads: AtomicUsize::new(0) }
    }

    fn height(&self, x: u64, y: u64) -> f32 {
        noise(x, y, self.seed)
    }

    fn is_ground(&self, x: u64, y: u64) -> bool {
        !self.world.has_validity() || noise(x, y, self.seed + 1) > 8.0
    }

    /// The ranges of the finest heights, as wide as all of a node's posts.
    fn ranges(&self) -> NodeRanges {
        let levels = (0..self.world.levels()).map(|q| {
            let [columns, rows] = self.world.nodes_at(q);
            let nodes = (0..rows).flat_map(|n| (0..columns).map(move |m| NodeId::new(m, n, q).unwrap()));
            nodes
                .map(|node| {
                    let ([x, y], side) = (self.world.node_origin(node), self.world.node_side(node.q()));
                    let heights = (y..=y + side)
                        .flat_map(|y| (x..=x + side).map(move |x| (x, y)))
                        .map(|(x, y)| self.height(x, y));
                    heights.fold([f32::INFINITY, f32::NEG_INFINITY], |[a, b], z| [a.min(z), b.max(z)])
                })
                .collect()
        });
        NodeRanges::from_parts(&self.world, levels.collect()).unwrap()
    }

    /// Its facets, and whether they are ground.
    fn facets(&self) -> Vec<([DVec3; 3], bool)> {
        let [width, height] = self.world.extent().map(u64::from);
        let corner = |x: u64, y: u64| DVec3::new(x as f64 * SPACING_M, y as f64 * SPACING_M, self.height(x, y).into());
        let cells = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        cells
            .flat_map(|(x, y)| {
                let at = [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)];
                [[0, 1, 3], [0, 3, 2]].map(|of: [usize; 3]| {
                    (of.map(|k| corner(at[k].0, at[k].1)), of.iter().any(|k| self.is_ground(at[*k].0, at[*k].1)))
                })
            })
            .collect()
    }

    /// The ground as a formula: linear between the posts of a facet.
    fn ground(&self, foot: DVec2, interpolation: Interpolation) -> f64 {
        let place = foot / SPACING_M;
        let [x, y] = [0, 1].map(|axis| (place[axis] as u64).min(u64::from(self.world.extent()[axis]) - 1));
        let (u, v) = (place.x - x as f64, place.y - y as f64);
        let z = |i: u64, j: u64| f64::from(self.height(x + i, y + j));
        match interpolation {
            Interpolation::Bilinear => {
                (1.0 - v) * ((1.0 - u) * z(0, 0) + u * z(1, 0)) + v * ((1.0 - u) * z(0, 1) + u * z(1, 1))
            }
            Interpolation::Facet if u > v => (1.0 - u) * z(0, 0) + (u - v) * z(1, 0) + v * z(1, 1),
            Interpolation::Facet => (1.0 - v) * z(0, 0) + (v - u) * z(0, 1) + u * z(1, 1),
        }
    }
}

impl TileSource for Rough {
    fn read_elevation(&self, node: NodeId, out: &mut [f32], _: &mut TileScratch) -> Result<(), TileError> {
        self.reads.fetch_add(1, Ordering::Relaxed);
        if self.broken.contains(&node) {
            return Err(TileError::Missing { layer: Layer::Elevation, node });
        }
        let origin = self.world.node_origin(node);
        let posts = 25;
        for (k, z) in out[..posts].iter_mut().enumerate() {
            *z = self.height(origin[0] + ((k as u64 % 5) << node.q()), origin[1] + ((k as u64 / 5) << node.q()));
        }
        if self.world.has_validity() {
            for k in 0..posts {
                let is_ground =
                    self.is_ground(origin[0] + ((k as u64 % 5) << node.q()), origin[1] + ((k as u64 / 5) << node.q()));
                (out[posts + k], out[2 * posts + k]) = (f32::from(is_ground), f32::from(is_ground));
            }
        }
        Ok(())
    }

    fn read_color(&self, node: NodeId, _: &mut [u8], _: &mut TileScratch) -> Result<(), TileError> {
        Err(TileError::Missing { layer: Layer::Color, node })
    }
}

/// The distance of a point from a facet: over its inside across its plane, else from the nearest of
/// its sides.
fn distance_from([a, b, c]: [DVec3; 3], point: DVec3) -> f64 {
    let normal = (b - a).cross(c - a).normalize();
    let below = point - normal * normal.dot(point - a);
    // Barycentric coordinates by areas.
    let area = |p: DVec3, q: DVec3, r: DVec3| normal.dot((q - p).cross(r - p));
    if [area(a, b, below), area(b, c, below), area(c, a, below)].iter().all(|part| *part >= 0.0) {
        return normal.dot(point - a).abs();
    }
    let from_side = |p: DVec3, q: DVec3| {
        let along = ((point - p).dot(q - p) / (q - p).length_squared()).clamp(0.0, 1.0);
        point.distance(p.lerp(q, along))
    };
    from_side(a, b).min(from_side(b, c)).min(from_side(c, a))
}

/// Where a line crosses a facet, as a share of it: the height above the facet's plane is linear
/// along it.
fn crossing([a, b, c]: [DVec3; 3], from: DVec3, to: DVec3) -> Option<f64> {
    let normal = (b - a).cross(c - a).normalize();
    let [start, end] = [from, to].map(|point| normal.dot(point - a));
    let share = start / (start - end);
    let at = from.lerp(to, share);
    let area = |p: DVec3, q: DVec3| normal.dot((q - p).cross(at - p));
    ((0.0..=1.0).contains(&share) && area(a, b).min(area(b, c)).min(area(c, a)) >= -1e-9).then_some(share)
}

fn shares() -> impl Strategy<Value = [f64; 3]> {
    [0.0f64..1.0, 0.0..1.0, 0.0..1.0]
}

/// A position over the world, from below the lowest ground to above the highest.
fn position(world: &World, [x, y, z]: [f64; 3]) -> DVec3 {
    let end = world.plane().end();
    DVec3::new(x * end.x, y * end.y, -4.0 + 44.0 * z)
}

proptest! {
    #[test]
    fn heights_and_normals_are_those_of_the_formula(
        extent in [1u32..40, 1u32..40], seed in 0u32..1000, at in prop::collection::vec(shares(), 1..60), bilinear: bool,
    ) {
        let rough = Rough::new(extent, seed, false);
        let tiles = GroundTiles::new(&rough, &rough.world, 1 << 20);
        let interpolation = if bilinear { Interpolation::Bilinear } else { Interpolation::Facet };
        let feet: Vec<DVec2> = at.iter().map(|at| position(&rough.world, *at).truncate()).collect();
        let (mut scratch, mut answers) = (GroundScratch::default(), Vec::new());
        tiles.sample_all(&feet, interpolation, &mut scratch, &mut answers);
        for (foot, answer) in feet.iter().zip(&answers) {
            prop_assert_eq!(*answer, tiles.sample(*foot, interpolation, &mut GroundScratch::default()));
            let Answer { found, is_finest } = answer.unwrap();
            let expected = rough.ground(*foot, interpolation);
            prop_assert!((found.ground.height_m - expected).abs() < 1e-9 && is_finest);
            // The normal is across two steps within the same facet or cell.
            let step = |way: DVec2| {
                let cell = (*foot / SPACING_M).fract();
                let to_middle = if bilinear { DVec2::splat(0.5) } else if cell.x > cell.y { DVec2::new(0.75, 0.25) } else { DVec2::new(0.25, 0.75) };
                let sign = if (to_middle - cell).dot(way) < 0.0 { -1e-6 } else { 1e-6 };
                let rise = rough.ground(*foot + way * sign, interpolation) - expected;
                (way * sign).extend(rise).normalize()
            };
            for along in [step(DVec2::X), step(DVec2::Y)] {
                prop_assert!(found.normal.dot(along).abs() < 1e-3, "{found:?} {along}");
            }
            prop_assert!((found.normal.length() - 1.0).abs() < 1e-9 && found.normal.z > 0.0);
        }
    }

    #[test]
    fn a_line_is_hidden_where_it_enters_the_first_facet(
        extent in [1u32..24, 1u32..24], seed in 0u32..1000, from in shares(), to in shares(), has_holes: bool,
    ) {
        let rough = Rough::new(extent, seed, has_holes);
        let ranges = rough.ranges();
        let tiles = GroundTiles::new(&rough, &rough.world, 1 << 20).bounded(&ranges);
        let mut scratch = GroundScratch::default();
        let (from, to) = (position(&rough.world, from), position(&rough.world, to));
        let found = tiles.line_of_sight(from, to, &mut scratch).unwrap().found;
        let mut ground = |at: DVec3| {
            let sample = tiles.sample(at.truncate(), Interpolation::Facet, &mut scratch).unwrap().found.ground;
            (sample.validity != Validity::Hole).then_some(at.z - sample.height_m)
        };
        // Ends near the ground are lifted: see places_on_the_ground_see_each_other.
        let ends = [from, to].map(&mut ground);
        prop_assume!(ends.iter().flatten().all(|above| above.abs() > 0.02));
        let (until, is_hidden) = match found {
            LineOfSight::Visible => (1.0, false),
            LineOfSight::Hidden { at, share } => {
                prop_assert!(share > 0.0 && (at - from.lerp(to, share)).length() < 1e-6 || at == from);
                (share, true)
            }
        };
        prop_assert_eq!(is_hidden && until == 0.0, ends[0].is_some_and(|above| above < 0.0));
        if until == 0.0 {
            return Ok(());
        }
        let met = rough.facets().into_iter().filter_map(|(corners, _)| {
            let share = crossing(corners, from, to)?;
            ground(from.lerp(to, share)).map(|_| share)
        });
        let first = met.reduce(f64::min);
        prop_assert_eq!(first.is_some(), is_hidden);
        prop_assert!((first.unwrap_or(1.0) - until).abs() < 1e-9, "{first:?} {until}");
    }

    #[test]
    fn a_sphere_touches_first_what_is_first_as_near(
        extent in [1u32..14, 1u32..14], seed in 0u32..1000, from in shares(), to in shares(), radius in 0.1f64..12.0, has_holes: bool,
    ) {
        let rough = Rough::new(extent, seed, has_holes);
        let ranges = rough.ranges();
        let tiles = GroundTiles::new(&rough, &rough.world, 1 << 20).bounded(&ranges);
        let mut scratch = GroundScratch::default();
        let (from, to) = (position(&rough.world, from), position(&rough.world, to));
        let found = tiles.sweep_sphere(from, to, radius, &mut scratch).unwrap().found;
        let facets = rough.facets();
        let distance = |center: DVec3| {
            let ground = facets.iter().filter(|(_, is_ground)| *is_ground);
            let near = ground.map(|(corners, _)| distance_from(*corners, center));
            near.fold(f64::INFINITY, f64::min)
        };
        let until = found.map_or(1.0, |touch| touch.share);
        for step in 0..60 {
            let share = until * f64::from(step) / 60.0;
            prop_assert!(share == until || distance(from.lerp(to, share)) > radius - 1e-6, "{share} of {until}");
        }
        if let Some(Touch { share, center, contact, normal }) = found {
            prop_assert!((center - from.lerp(to, share)).length() < 1e-6 && (normal.length() - 1.0).abs() < 1e-9);
            prop_assert!(distance(contact) < 1e-6, "{contact} is not on the ground");
            prop_assert!(share == 0.0 || ((center - contact).length() - radius).abs() < 1e-6);
        }
    }
}

#[test]
fn beside_the_world_nothing_is_known_except_what_is_met_before() {
    let rough = Rough::new([16, 16], 1, false);
    let ranges = rough.ranges();
    let tiles = GroundTiles::new(&rough, &rough.world, 1 << 20).bounded(&ranges);
    let mut scratch = GroundScratch::default();
    for foot in [[-0.1, 5.0], [160.1, 5.0], [f64::NAN, 5.0], [5.0, f64::INFINITY]] {
        assert_eq!(tiles.sample(foot.into(), Interpolation::Facet, &mut scratch), Err(NoGround::Outside), "{foot:?}");
    }
    let (inside, high, low) =
        (DVec3::new(80.0, 80.0, 50.0), DVec3::new(-50.0, 80.0, 60.0), DVec3::new(400.0, 80.0, -500.0));
    assert_eq!(tiles.line_of_sight(inside, high, &mut scratch), Err(NoGround::Outside));
    let hidden = tiles.line_of_sight(inside, low, &mut scratch).unwrap().found;
    assert!(matches!(hidden, LineOfSight::Hidden { at, .. } if at.x < 160.0), "{hidden:?}");
    assert_eq!(tiles.sweep_sphere(inside, high, 1.0, &mut scratch), Err(NoGround::Outside));
    assert!(tiles.sweep_sphere(inside, low, 1.0, &mut scratch).unwrap().found.is_some());
}

#[test]
fn places_on_the_ground_see_each_other_over_a_plain_and_not_through_a_hill() {
    let rough = Rough::new([16, 16], 3, false);
    let ranges = rough.ranges();
    let tiles = GroundTiles::new(&rough, &rough.world, 1 << 20).bounded(&ranges);
    let mut scratch = GroundScratch::default();
    let mut on_ground = |x: f64, y: f64| {
        let sample = tiles.sample(DVec2::new(x, y), Interpolation::Facet, &mut scratch).unwrap();
        DVec3::new(x, y, sample.found.ground.height_m)
    };
    let eye = DVec3::new(83.0, 81.0, 500.0);
    let (near, far) = (on_ground(84.0, 82.0), on_ground(3.0, 155.0));
    let mut look = |from, to| tiles.line_of_sight(from, to, &mut scratch).unwrap().found;
    for place in [near, far] {
        assert_eq!(look(eye, place), LineOfSight::Visible);
        assert_eq!(look(place, eye), LineOfSight::Visible);
        assert_eq!(look(place, place), LineOfSight::Visible);
        assert!(matches!(look(eye, place - DVec3::Z), LineOfSight::Hidden { share, .. } if share > 0.9));
        assert_eq!(look(place - DVec3::Z, eye), LineOfSight::Hidden { at: place - DVec3::Z, share: 0.0 });
    }
    assert!(matches!(look(near, far), LineOfSight::Hidden { .. }));
}

#[test]
fn tiles_that_cannot_be_read_are_answered_from_coarser_ones_and_told_of() {
    let mut rough = Rough::new([16, 16], 5, false);
    let place = DVec2::new(21.0, 33.0);
    let node = rough.world.plane().node_at(place, 0).unwrap();
    rough.broken.insert(node);
    let ranges = rough.ranges();
    let tiles = GroundTiles::new(&rough, &rough.world, 1 << 20).bounded(&ranges);
    let mut scratch = GroundScratch::default();
    let coarser = tiles.sample(place, Interpolation::Facet, &mut scratch).unwrap();
    let parent = tiles.sample_from(place, 1, Interpolation::Facet, &mut scratch).unwrap();
    assert!(!coarser.is_finest && parent.is_finest && coarser.found == parent.found);
    assert!(matches!(tiles.take_failures(), Some((1, TileError::Missing { node: found, .. })) if found == node));
    assert!(tiles.take_failures().is_none());
    let down = tiles.line_of_sight(place.extend(100.0), place.extend(-100.0), &mut scratch).unwrap();
    assert!(!down.is_finest && matches!(down.found, LineOfSight::Hidden { .. }));
    rough.broken.extend((0..rough.world.levels()).filter_map(|q| rough.world.plane().node_at(place, q)));
    let tiles = GroundTiles::new(&rough, &rough.world, 1 << 20).bounded(&ranges);
    let mut scratch = GroundScratch::default();
    assert_eq!(tiles.sample(place, Interpolation::Facet, &mut scratch), Err(NoGround::Unreadable));
    let down = tiles.line_of_sight(place.extend(100.0), place.extend(-100.0), &mut scratch);
    assert_eq!(down, Err(NoGround::Unreadable));
}

#[test]
fn a_batch_reads_each_tile_once_however_few_are_kept() {
    let rough = Rough::new([64, 64], 9, false);
    let tiles = GroundTiles::new(&rough, &rough.world, 1);
    let feet: Vec<DVec2> = (0..16_384u64)
        .map(|k| (k * 7919) % 16_384)
        .map(|k| DVec2::new((k % 128 * 5) as f64, (k / 128 * 5) as f64))
        .collect();
    let (mut scratch, mut answers) = (GroundScratch::default(), Vec::new());
    tiles.sample_all(&feet, Interpolation::Facet, &mut scratch, &mut answers);
    assert!(answers.iter().all(Result::is_ok) && answers.len() == feet.len());
    assert_eq!(rough.reads.load(Ordering::Relaxed), 256);
}
