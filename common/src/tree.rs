//! The layout of the truncated quad tree in one half of the ping-pong buffer.
//!
//! A half is a [`TreeHeader`] and then a flat array of [`TreeNode`]s. The root is node 0. The
//! children of a node are contiguous, nearest to the eye first, and the blocks of children follow
//! depth first. Only nodes that may be visible are present; a tree in which nothing is visible has
//! no nodes at all. A reader checks every index ([`TreeNode::children`]) before it follows it.

use crate::camera::CameraFields;
use crate::node::NodeId;
use crate::surface::MOST_CHILDREN;
use bytemuck::{Pod, Zeroable};
use std::ops::Range;

/// The node's elevation array is made at this level; set on one node of every path from root to
/// leaf.
pub const ELEVATION_LEAF: u8 = 1;
/// The node is drawn with a colour tile of its own; it has no children.
pub const COLOR_LEAF: u8 = 2;

/// The node is drawn with the colour of its nearest ancestor without this flag: that is fine
/// enough, and the node's own colour tile is not wanted. All nodes below one with this flag have it
/// too; the root never has it.
pub const COLOR_FROM_ANCESTOR: u8 = 4;

/// One node of a truncated quad tree; 24 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct TreeNode {
    /// [`NodeId::pack`] of the node.
    pub node: u64,
    /// Index of the first child; meaningless without children.
    pub first_child: u32,
    /// Number of children, 0 to 4; of the crown, which is above the roots of a body, up to 8.
    pub child_count: u8,
    /// [`ELEVATION_LEAF`] | [`COLOR_LEAF`] | [`COLOR_FROM_ANCESTOR`].
    pub flags: u8,
    /// Zero.
    pub reserved: [u8; 10],
}

impl TreeNode {
    /// The node's id, or `None` when the number is not valid.
    #[must_use]
    pub fn id(&self) -> Option<NodeId> {
        NodeId::unpack(self.node)
    }

    /// Indices of the children within a tree of `len` nodes, for the node at `index`. `None` when
    /// they do not lie after the node and inside the tree: following them could read out of bounds
    /// or loop.
    #[must_use]
    pub fn children(&self, index: u32, len: u32) -> Option<Range<u32>> {
        if self.child_count == 0 {
            return Some(0..0);
        }
        let end = self.first_child.checked_add(u32::from(self.child_count))?;
        (usize::from(self.child_count) <= MOST_CHILDREN && self.first_child > index && end <= len)
            .then_some(self.first_child..end)
    }
}

/// The header of a tree; 128 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct TreeHeader {
    /// The frame of the tree.
    pub frame: u64,
    /// The camera for which it was made.
    pub camera: CameraFields,
    /// Wanted screen resolution of facets, pixels.
    pub r_z_px: f64,
    /// Wanted screen resolution of texels, pixels.
    pub r_c_px: f64,
    /// Number of nodes that follow.
    pub node_count: u32,
    /// 1 when the buffer was too small and the tree is coarser than wanted.
    pub is_cut_short: u32,
    /// When the generator began with it, nanoseconds of the monotonic clock.
    pub started_nanos: u64,
    /// When the generator finished it.
    pub finished_nanos: u64,
    /// Zero.
    pub reserved: [u8; 8],
}

const _: () = assert!(size_of::<TreeNode>() == 24 && size_of::<TreeHeader>() == 128);
