//! Inputs of a ground: its shape, the tiles that are added to it, and which of them get voxels.

use super::color::{ColorLayout, ColorPlace};
use super::density::Filter;
use glam::DVec3;
use terravision_common::surface::Plane;

/// Geometry that all tiles of a ground share.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroundShape {
    /// Where lattice points lie, and where the ground ends east and north. With an extent of
    /// `u32::MAX` the ground ends with its tiles. Cells may reach beyond the end.
    pub surface: Plane,
    /// Levels of the quad tree.
    pub levels: u8,
    /// Layers of colour.
    pub color: ColorLayout,
    /// How densities are computed. `None`: the ground has only heights, no voxels.
    pub filter: Option<Filter>,
}

/// A tile to be added to a ground.
#[derive(Debug, Clone, Copy)]
pub struct TileSpec<'a> {
    /// Lower left corner of its node, lattice units.
    pub origin: [u32; 2],
    /// Level of the node: its side is `side << level`.
    pub level: u8,
    /// log2 of the distance of its posts, lattice units.
    pub log_spacing: u8,
    /// Number of cells east and north, at most those that fill its node.
    pub cells: [u32; 2],
    /// Heights of its posts, metres above `datum_m`, rows from south to north.
    pub heights: &'a [f32],
    /// For each post, in the same order, the share that is ground and the share that was measured
    /// (`terravision_common::validity`). `None`: all of it was measured.
    pub shares: Option<[&'a [f32]; 2]>,
    /// Heights from row to row, at least `cells[0] + 1`.
    pub stride: usize,
    /// The datum of the heights, metres in world coordinates (the eye's height for elevation arrays
    /// of the ring).
    pub datum_m: f64,
    /// Its colours.
    pub color: ColorPlace,
    /// Whether it may get voxels. Without voxels, the boundary array and the heights say where
    /// ground is.
    pub is_accurate: bool,
}

/// A part of a ground whose heights lie in the elevation pool.
#[derive(Debug, Clone, Copy)]
pub struct PatchSpec {
    /// Lower left corner of its node, lattice units.
    pub origin: [u32; 2],
    /// Level of the node: its side is `side << level`.
    pub level: u8,
    /// log2 of the distance of the finest posts below it, lattice units.
    pub log_spacing: u8,
    /// Number of cells of that size east and north, at most those that fill its node.
    pub cells: [u32; 2],
    /// Its colours.
    pub color: ColorPlace,
}

/// Why a tile cannot be added.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum GroundError {
    /// No node of the quad tree begins there.
    #[error("no node of level {level} begins at {origin:?} in a quad tree of {levels} levels")]
    Place {
        /// Lower left corner.
        origin: [u32; 2],
        /// Level.
        level: u8,
        /// How many there are.
        levels: u8,
    },
    /// It has no cells, or more than fill its node, or fewer heights than cells.
    #[error("a tile of {}x{} cells with {heights} heights does not fill its node", .cells[0], .cells[1])]
    Cells {
        /// Cells.
        cells: [u32; 2],
        /// Heights.
        heights: usize,
    },
    /// A height is NaN or infinite.
    #[error("height {index} of the tile at {origin:?} is not a finite number")]
    Height {
        /// Lower left corner.
        origin: [u32; 2],
        /// Which.
        index: usize,
    },
    /// The tile above it has not been added.
    #[error("no tile of level {} has been added above the one of level {level} at {origin:?}", level + 1)]
    Unattached {
        /// Lower left corner.
        origin: [u32; 2],
        /// Level.
        level: u8,
    },
    /// Another tile is there.
    #[error("the tile at {origin:?} covers another one")]
    Occupied {
        /// Lower left corner.
        origin: [u32; 2],
    },
}

impl GroundShape {
    /// Checks that a tile lies on a node of the quad tree, and has as many heights as its cells
    /// need.
    pub(super) fn check(&self, spec: &TileSpec<'_>) -> Result<(), GroundError> {
        let TileSpec { origin, level, log_spacing, cells, stride, .. } = *spec;
        self.check_place(origin, level, log_spacing, cells)?;
        let needed = cells[1] as usize * stride + cells[0] as usize + 1;
        let is_short = |plane: &[f32]| plane.len() < needed;
        let are_short = is_short(spec.heights) || spec.shares.is_some_and(|planes| planes.into_iter().any(is_short));
        if stride <= cells[0] as usize || are_short {
            return Err(GroundError::Cells { cells, heights: spec.heights.len() });
        }
        Ok(())
    }

    /// Checks that a node of the quad tree begins there, and that its cells do not more than fill it.
    pub(super) fn check_place(
        &self,
        origin: [u32; 2],
        level: u8,
        log_spacing: u8,
        cells: [u32; 2],
    ) -> Result<(), GroundError> {
        let levels = self.levels;
        let log_node = self.surface.cells().ilog2() + u32::from(level);
        let log_root = self.surface.cells().ilog2() + u32::from(levels) - 1;
        let is_place = level < levels
            && log_root < 32
            && origin.iter().all(|v| v % (1 << log_node) == 0)
            && origin.iter().all(|v| u64::from(*v) < 1 << log_root);
        if !is_place {
            return Err(GroundError::Place { origin, level, levels });
        }
        let is_filled = |n: u32| n > 0 && u64::from(n) << log_spacing <= 1 << log_node;
        if cells.iter().all(|n| is_filled(*n)) { Ok(()) } else { Err(GroundError::Cells { cells, heights: 0 }) }
    }
}

/// Which tiles of a ground get voxels, of those that may ([`TileSpec::is_accurate`]).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Detail {
    /// The eye, world coordinates.
    pub eye_in_world: DVec3,
    /// Tiles that are more than this many times as far from the eye as the nearest tile, and
    /// further than that tile is wide, get none.
    pub reach: f64,
    /// Upper bound of the bytes of all voxels: when it is reached, farther tiles get none.
    pub most_bytes: usize,
}

impl Detail {
    /// All tiles that may have voxels get them.
    pub const ALL: Self = Self { eye_in_world: DVec3::ZERO, reach: f64::INFINITY, most_bytes: usize::MAX };
}
