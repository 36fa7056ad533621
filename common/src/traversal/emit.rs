//! Writes the found nodes as the flat tree of [`crate::tree`].

use super::{Found, HeightRanges, Search, Traversal, TreeStats};
use crate::database::Layer;
use crate::tree::{COLOR_FROM_ANCESTOR, COLOR_LEAF, ELEVATION_LEAF, TreeNode};
use bytemuck::Zeroable;

/// A written node whose children are still to be written.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pending {
    found: u32,
    out: u32,
}

impl Traversal {
    /// Writes the drawn nodes; `out` is long enough (the search was limited by it).
    pub(super) fn emit<R: HeightRanges>(&mut self, search: &Search<'_, R>, out: &mut [TreeNode]) -> TreeStats {
        let mut stats = TreeStats::default();
        if !self.found.first().is_some_and(|root| root.is_drawn) || out.is_empty() {
            return stats;
        }
        out[0] = leaf_node(&self.found[0], 0);
        stats.node_count = 1;
        self.stack.clear();
        self.stack.push(Pending { found: 0, out: 0 });
        while let Some(pending) = self.stack.pop() {
            let parent = self.found[pending.found as usize];
            stats.elevation_leaf_count += u32::from(parent.is_elevation_leaf);
            if !parent.is_split {
                stats.color_leaf_count += 1;
                continue;
            }
            let color_bound = parent.bound + search.level.color_minus_elevation() + search.coarser;
            // Where colour ends above elevation it counts as fine enough: there is no finer colour.
            let is_color_fine =
                f64::from(parent.id.q()) <= color_bound || !search.has_children(Layer::Color, parent.id);
            let node = &mut out[pending.out as usize];
            let inherited = if is_color_fine { COLOR_FROM_ANCESTOR } else { node.flags & COLOR_FROM_ANCESTOR };
            node.flags &= !COLOR_LEAF;
            node.first_child = stats.node_count;
            let first_pending = self.stack.len();
            let (order, count) = self.world.surface().near_to_far(parent.id, search.level.frame().eye());
            for index in &order[..count] {
                let Some(child) = parent.children[usize::from(*index)] else { continue };
                let found = &self.found[child.get() as usize];
                if found.is_drawn {
                    out[stats.node_count as usize] = leaf_node(found, inherited);
                    self.stack.push(Pending { found: child.get(), out: stats.node_count });
                    stats.node_count += 1;
                }
            }
            out[pending.out as usize].child_count = (self.stack.len() - first_pending) as u8;
            self.stack[first_pending..].reverse();
        }
        stats
    }
}

fn leaf_node(found: &Found, inherited: u8) -> TreeNode {
    let elevation = if found.is_elevation_leaf { ELEVATION_LEAF } else { 0 };
    TreeNode { node: found.id.pack(), flags: COLOR_LEAF | elevation | inherited, ..TreeNode::zeroed() }
}
