//! The surface as a graphics device has it, and whether what is drawn of it is of its nodes.

use super::{EyeCell, Surface};
use crate::node::NodeId;
use glam::DVec3;

/// The eye, for shaders.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DeviceEye {
    /// The lattice cell that it is over; of a body, none in particular.
    pub cell: EyeCell,
    /// The eye in that cell, metres; of a body, sine and cosine of its latitude.
    pub eye: [f32; 2],
    /// Distance of two lattice points, metres; of a body, the eye's height above the ellipsoid.
    pub scale_m: f32,
}

/// A block that is drawn, as a slot tells of it.
#[derive(Debug, Clone, Copy)]
pub struct DrawnBlock {
    /// The node that is drawn.
    pub node: Option<NodeId>,
    /// Levels of its elevation leaf and of the node of its colour tile.
    pub levels: [u8; 2],
    /// Lower left corners of these, lattice units.
    pub origins: [[u32; 2]; 2],
    /// First and last column and row, in posts of the elevation leaf.
    pub posts: [[u32; 2]; 2],
}

/// What is wrong with a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BlockFault {
    /// A corner is that of no node.
    Origin,
    /// The colour tile does not cover the block.
    Cover,
}

impl Surface {
    /// An eye, for shaders.
    #[must_use]
    pub fn on_device(&self, eye: DVec3) -> DeviceEye {
        match self {
            Self::Plane(plane) => {
                let cell = plane.eye_cell(eye);
                DeviceEye { cell, eye: cell.eye_m, scale_m: plane.unit_m() as f32 }
            }
            Self::Globe(globe) => {
                let [sin, cos, height_m] = globe.eye(eye).numbers();
                let cell = EyeCell { corner: [0; 2], eye_m: [0.0; 2] };
                DeviceEye { cell, eye: [sin, cos], scale_m: height_m }
            }
        }
    }

    /// Whether lattice points can be counted from an eye, at most this many units from the lattice.
    #[must_use]
    pub fn is_countable_from(&self, eye: DVec3, most: u64) -> bool {
        match self {
            Self::Plane(plane) => plane.lattice_of_foot(plane.foot(eye)).abs().max_element() <= most as f64,
            Self::Globe(_) => self.is_over(eye),
        }
    }

    /// What is wrong with a block that is to be drawn, if anything is.
    #[must_use]
    pub fn fault_of(&self, block: &DrawnBlock) -> Option<BlockFault> {
        let [elevation, color] = block.levels;
        match self {
            Self::Plane(plane) => {
                let is_node = |origin: [u32; 2], level: u8| {
                    let side = plane.node_side(level);
                    (0..2)
                        .all(|axis| u64::from(origin[axis]).is_multiple_of(side) && origin[axis] < plane.extent()[axis])
                };
                if !is_node(block.origins[0], elevation) || !is_node(block.origins[1], color) {
                    return Some(BlockFault::Origin);
                }
                let is_covered = |axis: usize| {
                    let at = |post: u32| u64::from(block.origins[0][axis]) + (u64::from(post) << elevation);
                    let first = u64::from(block.origins[1][axis]);
                    first <= at(block.posts[0][axis]) && at(block.posts[1][axis]) <= first + plane.node_side(color)
                };
                (!is_covered(0) || !is_covered(1)).then_some(BlockFault::Cover)
            }
            Self::Globe(globe) => {
                let exists = |node: &NodeId| globe.lattice().contains(*node) && elevation.min(color) >= node.q();
                let Some(node) = block.node.filter(exists) else { return Some(BlockFault::Origin) };
                let above = block.levels.map(|q| self.ancestor(node, q));
                let corners = above.map(|node| self.node_origin(node).map(|at| at as u32));
                if elevation.max(color) > globe.lattice().top() || corners != block.origins {
                    return Some(BlockFault::Origin);
                }
                let [start, side] = self.block_of(above[0], node);
                let is_within = |axis: usize| {
                    block.posts[0][axis] >= start[axis] && block.posts[1][axis] <= start[axis] + side[axis]
                };
                (!is_within(0) || !is_within(1)).then_some(BlockFault::Cover)
            }
        }
    }
}
