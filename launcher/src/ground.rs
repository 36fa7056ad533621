//! The ground under the camera: read from the terrain database, as it is drawn close by.

use crate::path::orbit::Extent;
use crate::path::{Ground, Pose};
use glam::{DVec2, DVec3};
use std::cell::RefCell;
use terravision_common::database::{NodeRanges, TileSource};
use terravision_common::ground::{GroundScratch, GroundTiles, Interpolation};
use terravision_common::surface::tile::GroundPoint;
use terravision_common::validity::Validity;
use terravision_common::world::World;

/// The camera stays at least this high above ground, metres.
pub const CLEARANCE_M: f64 = 2.0;
/// A camera that is farther from the world than this many times the world's longer side sees
/// nothing of it.
pub const FAR_FROM_WORLD: f64 = 2.0;
/// Tiles that are kept, bytes; a flight goes on from the tile where it was.
const KEPT_BYTES: usize = 16 << 20;

/// Heights of a world's ground, exaggerated as it is drawn, at positions in its CRS. For one
/// thread; blocks on storage.
pub struct WorldGround<'a> {
    tiles: GroundTiles<'a>,
    exaggeration: f64,
    /// Finest level that is read.
    level: u8,
    scratch: RefCell<GroundScratch>,
}

impl std::fmt::Debug for WorldGround<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("WorldGround").field("level", &self.level).finish_non_exhaustive()
    }
}

impl<'a> WorldGround<'a> {
    /// The ground at the finest level.
    #[must_use]
    pub fn finest(source: &'a dyn TileSource, world: &'a World, exaggeration: f64) -> Self {
        let tiles = GroundTiles::new(source, world, KEPT_BYTES);
        Self { tiles, exaggeration, level: world.finest_elevation_level(), scratch: RefCell::default() }
    }

    /// With the ranges of height of the same world, which tell of most places that the ground is
    /// far below.
    #[must_use]
    pub fn bounded(self, ranges: &'a NodeRanges) -> Self {
        Self { tiles: self.tiles.bounded(ranges), ..self }
    }

    /// The ground at the coarsest level whose posts are not farther apart than `spacing_m` (or the
    /// finest level).
    #[must_use]
    pub fn coarse(source: &'a dyn TileSource, world: &'a World, exaggeration: f64, spacing_m: f64) -> Self {
        let finest = world.finest_elevation_level();
        let level = (finest..world.levels()).rev().find(|&q| world.elevation_spacing_m(q) <= spacing_m);
        Self { level: level.unwrap_or(finest), ..Self::finest(source, world, exaggeration) }
    }

    /// The world's extent in its CRS.
    #[must_use]
    pub fn extent(&self) -> Extent {
        let [low, high] = self.tiles.world().crs_bounds();
        Extent { low, high }
    }

    /// The foot of a position in the CRS.
    fn foot(&self, x: f64, y: f64) -> DVec2 {
        self.tiles.world().crs_frame().foot(DVec2::new(x, y))
    }

    /// The ground at a position, its height exaggerated; `None` outside the world, or where no tile
    /// can be had.
    #[must_use]
    pub fn at(&self, x: f64, y: f64) -> Option<GroundPoint> {
        let scratch = &mut *self.scratch.borrow_mut();
        let sample = self.tiles.sample_from(self.foot(x, y), self.level, Interpolation::Facet, scratch).ok()?;
        let ground = sample.found.ground;
        Some(GroundPoint { height_m: ground.height_m * self.exaggeration, ..ground })
    }
}

impl Ground for WorldGround<'_> {
    fn height_m(&self, x: f64, y: f64) -> Option<f64> {
        // A hole is not ground: what height it has is for the filters alone.
        self.at(x, y).filter(|ground| ground.validity != Validity::Hole).map(|ground| ground.height_m)
    }

    fn is_measured(&self, x: f64, y: f64) -> bool {
        self.at(x, y).is_some_and(|ground| ground.validity == Validity::Measured)
    }

    fn bound_m(&self, x: f64, y: f64) -> Option<f64> {
        self.tiles.highest_m(self.foot(x, y), self.level).map(|highest| highest * self.exaggeration)
    }
}

/// Lifts a pose that is below ground + [`CLEARANCE_M`]; `true` if it was.
pub fn lift(pose: &mut Pose, ground: &dyn Ground) -> bool {
    let DVec3 { x, y, z } = pose.position;
    // The ground may be in a database far away: it is read only where the pose may be below it.
    if ground.bound_m(x, y).is_some_and(|bound| z >= bound + CLEARANCE_M) {
        return false;
    }
    let Some(height) = ground.height_m(x, y) else { return false };
    let is_low = z < height + CLEARANCE_M;
    if is_low {
        pose.position.z = height + CLEARANCE_M;
    }
    is_low
}

#[cfg(test)]
mod tests {
    use super::*;
    use terravision_common::database::{Layer, TileError, TileScratch};
    use terravision_common::node::NodeId;
    use terravision_common::world::WorldFields;
    use terravision_testkit::worlds::fields;

    /// Height = easting + 3 * northing at every level, but the finest tiles of the first column are
    /// missing.
    struct Slope(World);

    impl TileSource for Slope {
        fn read_elevation(&self, node: NodeId, out: &mut [f32], _: &mut TileScratch) -> Result<(), TileError> {
            if node.q() == 0 && node.m() == 0 {
                return Err(TileError::Missing { layer: Layer::Elevation, node });
            }
            let posts = self.0.elevation_posts() as usize;
            let origin = self.0.node_origin(node);
            for (k, z) in out.iter_mut().enumerate() {
                let x = origin[0] as f64 + ((k % posts) as f64) * f64::from(1u32 << node.q());
                let y = origin[1] as f64 + ((k / posts) as f64) * f64::from(1u32 << node.q());
                *z = ((x + 3.0 * y) * self.0.lattice_unit_m()) as f32;
            }
            Ok(())
        }

        fn read_color(&self, node: NodeId, _: &mut [u8], _: &mut TileScratch) -> Result<(), TileError> {
            Err(TileError::Missing { layer: Layer::Color, node })
        }
    }

    fn world() -> World {
        World::new(WorldFields { origin: [500_000.0, 4_000_000.0], ..fields([20, 13], 10.0, [4, 16]) }).unwrap()
    }

    #[test]
    fn heights_come_from_the_finest_tile_that_can_be_had() {
        let world = world();
        let source = Slope(world);
        let ground = WorldGround::finest(&source, &world, 2.0);
        for (x, y) in [(0.0, 0.0), (3.0, 4.0), (200.0, 130.0), (199.9, 0.1), (55.5, 66.6)] {
            let height = ground.height_m(500_000.0 + x, 4_000_000.0 + y).unwrap();
            assert!((height - 2.0 * (x + 3.0 * y)).abs() < 1e-6, "{x} {y}: {height}");
        }
        for (x, y) in [(-0.1, 0.0), (200.1, 0.0), (0.0, 130.1), (f64::NAN, 0.0)] {
            assert_eq!(ground.height_m(500_000.0 + x, 4_000_000.0 + y), None);
        }
        assert_eq!(WorldGround::coarse(&source, &world, 1.0, 45.0).level, 2);
        assert_eq!(WorldGround::coarse(&source, &world, 1.0, 1.0).level, 0);
    }

    #[test]
    fn low_poses_are_lifted_and_high_ones_stay() {
        let world = world();
        let source = Slope(world);
        let ground = WorldGround::finest(&source, &world, 1.0);
        let pose = |z| Pose {
            position: DVec3::new(500_100.0, 4_000_000.0, z),
            heading_rad: 0.0,
            pitch_rad: 0.0,
            roll_rad: 0.0,
        };
        let (mut low, mut high, mut outside) = (pose(50.0), pose(102.5), pose(-5.0));
        outside.position.x = 0.0;
        assert!(lift(&mut low, &ground) && low.position.z == 102.0);
        assert!(!lift(&mut high, &ground) && high.position.z == 102.5);
        assert!(!lift(&mut outside, &ground) && outside.position.z == -5.0);
    }

    /// A source that may not be asked.
    struct Untouched;

    impl TileSource for Untouched {
        fn read_elevation(&self, node: NodeId, _: &mut [f32], _: &mut TileScratch) -> Result<(), TileError> {
            panic!("{node} was read");
        }

        fn read_color(&self, node: NodeId, _: &mut [u8], _: &mut TileScratch) -> Result<(), TileError> {
            panic!("{node} was read");
        }
    }

    #[test]
    fn ground_is_read_only_where_a_pose_may_be_below_it() {
        let world = world();
        let count = |q| world.nodes_at(q).iter().product::<u32>() as usize;
        let ranges = (0..world.levels()).map(|q| vec![[0.0, 700.0]; count(q)]).collect();
        let ranges = NodeRanges::from_parts(&world, ranges).unwrap();
        let position = DVec3::new(500_100.0, 4_000_000.0, 1402.0);
        let mut pose = Pose { position, heading_rad: 0.0, pitch_rad: 0.0, roll_rad: 0.0 };
        assert!(!lift(&mut pose, &WorldGround::finest(&Untouched, &world, 2.0).bounded(&ranges)));
        assert_eq!(pose.position, position);
        let source = Slope(world);
        let ground = WorldGround::finest(&source, &world, 1.0).bounded(&ranges);
        pose.position.z = 50.0;
        assert!(lift(&mut pose, &ground) && pose.position.z == 102.0);
    }
}
