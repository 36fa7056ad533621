//! What the ground answers: heights of the world's tiles, and the place that a ray meets. On a
//! thread of its own, which may wait for storage.

use crate::hands::view::{eye_of, ray_through};
use crate::hands::{Answer, Question};
use glam::{DVec2, DVec3};
use std::ffi::OsStr;
use std::io;
use std::sync::mpsc::{SyncSender, sync_channel};
use terravision_common::database::{NodeRanges, TileSource};
use terravision_common::ground::{GroundScratch, GroundTiles, Interpolation};
use terravision_common::run::DatabaseConfig;
use terravision_common::validity::Validity;
use terravision_common::viewer::ViewerPose;
use terravision_common::world::World;
use terravision_store::{Location, Store, StoreOptions};

/// Tiles that are kept, bytes: a camera goes on from where it was.
const KEPT_BYTES: usize = 16 << 20;
/// Questions that wait. Hands ask one at a time of a kind.
const MOST_QUESTIONS: usize = 64;
/// Steps along a ray at most; what is farther shows as sky.
const MOST_STEPS: u32 = 20_000;
/// Posts are this many pixels apart at least, where a ray is followed.
const POST_PX: f64 = 2.0;
/// Halvings of the step in which a ray enters the ground.
const HALVINGS: u32 = 24;

/// The ground of a world, exaggerated as it is drawn.
pub struct Ground<'a> {
    tiles: GroundTiles<'a>,
    world: World,
    ranges: &'a NodeRanges,
    exaggeration: f64,
    scratch: GroundScratch,
}

impl std::fmt::Debug for Ground<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Ground").field("tiles", &self.tiles).finish_non_exhaustive()
    }
}

impl<'a> Ground<'a> {
    /// Of these tiles, whose nodes have these ranges of height.
    #[must_use]
    pub fn new(source: &'a dyn TileSource, ranges: &'a NodeRanges, exaggeration: f64) -> Self {
        let world = *ranges.world();
        let tiles = GroundTiles::new(source, &world, KEPT_BYTES).bounded(ranges);
        Self { tiles, world, ranges, exaggeration, scratch: GroundScratch::default() }
    }

    /// Height at a foot, of tiles no finer than a level; `None` outside the world and in holes.
    fn height_m(&mut self, foot: DVec2, level: u8) -> Option<f64> {
        let sample = self.tiles.sample_from(foot, level, Interpolation::Facet, &mut self.scratch).ok()?;
        let ground = sample.found.ground;
        (ground.validity != Validity::Hole).then_some(ground.height_m * self.exaggeration)
    }

    /// Height of the ground at a place in the CRS; `None` beside the world and in holes.
    #[must_use]
    pub fn below(&mut self, [x, y]: [f64; 2]) -> Option<f64> {
        let foot = self.world.crs_frame().foot(DVec2::new(x, y));
        self.height_m(foot, self.world.finest_elevation_level())
    }

    /// The place that a ray of depth 1 from a pose meets; `pixel` is how wide a pixel is at depth 1.
    #[must_use]
    pub fn place(&mut self, pose: &ViewerPose, ray: DVec3, pixel: f64) -> Option<DVec3> {
        let eye = eye_of(pose);
        let [mut depth, end] = self.crossing(eye, ray)?;
        let mut before = depth;
        for _ in 0..MOST_STEPS {
            let level = self.level_at(depth * pixel);
            let at = eye + ray * depth;
            let next = match self.way_above_ground(at, ray, level) {
                // Nothing that is below reaches up to the ray until there.
                Some(way) => {
                    before = depth + way;
                    before + 1e-6 * before.max(1.0)
                }
                None if self.is_below(at, level) => return Some(self.entry(eye, ray, [before, depth], level)),
                None => {
                    before = depth;
                    depth + 0.5 * self.world.elevation_spacing_m(level) / ray.x.hypot(ray.y)
                }
            };
            if depth >= end {
                return None;
            }
            depth = next.min(end);
        }
        None
    }

    /// Whether a place is in the ground.
    fn is_below(&mut self, place: DVec3, level: u8) -> bool {
        let foot = self.world.crs_frame().foot(place.truncate());
        self.height_m(foot, level).is_some_and(|height| place.z < height)
    }

    /// Where a ray enters the ground between a depth above it and one below.
    fn entry(&mut self, eye: DVec3, ray: DVec3, [mut above, mut below]: [f64; 2], level: u8) -> DVec3 {
        for _ in 0..HALVINGS {
            let middle = 0.5 * (above + below);
            if self.is_below(eye + ray * middle, level) { below = middle } else { above = middle }
        }
        eye + ray * below
    }

    /// Where a ray is over the world and not above all ground: depths of its beginning and end.
    fn crossing(&self, eye: DVec3, ray: DVec3) -> Option<[f64; 2]> {
        let [low, high] = self.world.crs_bounds();
        let [lowest, highest] = self
            .ranges
            .range(self.world.root())
            .map_or([-1e4, 1e5], |range| range.map(|height| f64::from(height) * self.exaggeration));
        let (low, high) = (low.extend(lowest - 1.0), high.extend(highest + 1.0));
        let (mut from, mut to) = (0.0f64, f64::INFINITY);
        for axis in 0..3 {
            if ray[axis] == 0.0 {
                if !(low[axis]..=high[axis]).contains(&eye[axis]) {
                    return None;
                }
                continue;
            }
            let [a, b] = [low, high].map(|bound| (bound[axis] - eye[axis]) / ray[axis]);
            (from, to) = (from.max(a.min(b)), to.min(a.max(b)));
        }
        (from < to && to.is_finite()).then_some([from, to])
    }

    /// The level whose posts are as far apart as a few pixels that are `pixel_m` wide.
    fn level_at(&self, pixel_m: f64) -> u8 {
        let finest = self.world.finest_elevation_level();
        let coarse =
            (finest..self.world.levels()).rev().find(|q| self.world.elevation_spacing_m(*q) <= POST_PX * pixel_m);
        coarse.unwrap_or(finest)
    }

    /// How far a ray goes on from a place, in depth, over the largest node around it all of whose
    /// ground is below; `None` where there is no such node.
    fn way_above_ground(&self, at: DVec3, ray: DVec3, level: u8) -> Option<f64> {
        let surface = self.world.plane();
        let foot = self.world.crs_frame().foot(at.truncate());
        (level..self.world.levels()).rev().find_map(|q| {
            let node = surface.node_at(foot, q)?;
            let [_, high] = self.ranges.range(node)?;
            let bounds = surface.node_bounds(node, [0.0, 0.0]);
            let leave = (0..2).filter(|axis| ray[*axis] != 0.0).map(|axis| {
                let bound = if ray[axis] > 0.0 { bounds.max[axis] } else { bounds.min[axis] };
                (bound - foot[axis]) / ray[axis]
            });
            let way = leave.fold(f64::INFINITY, f64::min).max(0.0);
            let above = at.z - f64::from(high) * self.exaggeration;
            // Where it falls into the node's heights, it is followed from there.
            let way = if ray.z < 0.0 { way.min(above / -ray.z) } else { way };
            (above > 0.0 && way.is_finite()).then_some(way)
        })
    }

    /// The answer to a question.
    #[must_use]
    pub fn answer(&mut self, question: &Question) -> Answer {
        match question {
            Question::Below(place) => Answer::Below(self.below(*place)),
            Question::Place { id, pose, size, at } => {
                let pixel = 1.0 / crate::hands::view::focal_of(pose, *size);
                Answer::Place { id: *id, place: self.place(pose, ray_through(pose, *size, *at), pixel) }
            }
        }
    }
}

/// Answers questions on a thread of its own, until nobody asks any more.
///
/// # Errors
/// The system gives no thread.
pub fn start(
    database: DatabaseConfig,
    exaggeration: f64,
    tell: impl Fn(Answer) + Send + 'static,
) -> io::Result<SyncSender<Question>> {
    let (ask, questions) = sync_channel::<Question>(MOST_QUESTIONS);
    let answer_all = move || {
        let opened = Location::parse_os(OsStr::new(&database.location)).map_err(|error| error.to_string());
        let options = StoreOptions::of(&database);
        let opened = opened.and_then(|place| Store::open(&place, &options).map_err(|error| error.to_string()));
        match opened {
            Ok(store) => {
                let mut ground = Ground::new(&store, store.ranges(), exaggeration);
                questions.iter().for_each(|question| tell(ground.answer(&question)));
            }
            Err(error) => {
                tracing::warn!(error, "the ground cannot be read: nothing holds it");
                questions.iter().for_each(|question| tell(sky(&question)));
            }
        }
    };
    std::thread::Builder::new().name("ground".into()).spawn(answer_all)?;
    Ok(ask)
}

/// The answer where nothing is known.
#[must_use]
pub fn sky(question: &Question) -> Answer {
    match question {
        Question::Below(_) => Answer::Below(None),
        Question::Place { id, .. } => Answer::Place { id: *id, place: None },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use terravision_common::database::{Layer, TileError, TileScratch};
    use terravision_common::node::NodeId;
    use terravision_common::world::WorldFields;
    use terravision_testkit::worlds::fields;

    /// A slope that rises to the north: height = northing / 4.
    struct Slope(World);

    impl TileSource for Slope {
        fn read_elevation(&self, node: NodeId, out: &mut [f32], _: &mut TileScratch) -> Result<(), TileError> {
            let (origin, posts) = (self.0.node_origin(node), self.0.elevation_posts() as usize);
            for (k, z) in out.iter_mut().enumerate() {
                let y = origin[1] as f64 + ((k / posts) as f64) * f64::from(1u32 << node.q());
                *z = (0.25 * y * self.0.lattice_unit_m()) as f32;
            }
            Ok(())
        }

        fn read_color(&self, node: NodeId, _: &mut [u8], _: &mut TileScratch) -> Result<(), TileError> {
            Err(TileError::Missing { layer: Layer::Color, node })
        }
    }

    fn slope() -> (Slope, NodeRanges) {
        let fields = WorldFields { origin: [500_000.0, 4_000_000.0], ..fields([64, 64], 10.0, [4, 16]) };
        let world = World::new(fields).unwrap();
        let source = Slope(world);
        let rows = |q: u8| world.nodes_at(q)[1];
        let range = |q: u8, n: u32| [n, n + 1].map(|n| (0.25 * world.node_side_m(q) * f64::from(n)) as f32);
        let level = |q: u8| {
            let columns = world.nodes_at(q)[0] as usize;
            (0..rows(q)).flat_map(|n| std::iter::repeat_n(range(q, n), columns)).collect::<Vec<_>>()
        };
        let ranges = NodeRanges::from_parts(&world, (0..world.levels()).map(level).collect()).unwrap();
        (source, ranges)
    }

    fn pose(pitch: f64, heading: f64) -> ViewerPose {
        ViewerPose { x: 500_300.0, y: 4_000_100.0, z: 300.0, heading, pitch, roll: 0.0, vfov: 60.0 }
    }

    #[test]
    fn rays_meet_the_slope_and_others_the_sky() {
        let (source, ranges) = slope();
        let mut ground = Ground::new(&source, &ranges, 1.0);
        let size = [640.0, 360.0];
        let pixel = 1.0 / crate::hands::view::focal_of(&pose(0.0, 0.0), size);
        for heading in [0.0, 30.0, 90.0, 200.0, 359.0] {
            for pitch in [-90.0, -80.0, -60.0, -45.0] {
                let pose = pose(pitch, heading);
                let ray = ray_through(&pose, size, [320.0, 180.0]);
                // Height falls as (ray.z - ray.y / 4) along the ray, relative to the slope.
                let depth = (300.0 - 25.0) / (0.25 * ray.y - ray.z);
                let expected = eye_of(&pose) + ray * depth;
                let is_over =
                    (500_000.0..500_640.0).contains(&expected.x) && (4_000_000.0..4_000_640.0).contains(&expected.y);
                let found = ground.place(&pose, ray, pixel);
                assert_eq!(found.is_some(), is_over, "{heading} {pitch}: {found:?}, {expected}");
                if let Some(found) = found {
                    assert!(found.distance(expected) < 0.1, "{heading} {pitch}: {found}, {expected}");
                }
            }
            assert_eq!(
                ground.place(&pose(5.0, heading), ray_through(&pose(40.0, heading), size, [320.0, 180.0]), pixel),
                None
            );
        }
    }

    #[test]
    fn heights_are_exaggerated_and_end_with_the_world() {
        let (source, ranges) = slope();
        let mut ground = Ground::new(&source, &ranges, 2.0);
        let height = ground.below([500_100.0, 4_000_200.0]).unwrap();
        assert!((height - 100.0).abs() < 1e-3, "{height}");
        assert_eq!(ground.below([499_999.0, 4_000_200.0]), None);
    }
}
