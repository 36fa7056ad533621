//! Trees come from shared memory and are not trusted: whatever bytes are in them, they are refused
//! or they are drawn.

mod support;

use proptest::prelude::*;
use support::{NODES, case};
use terravision_common::tree::TreeNode;
use terravision_preparer::frame_tree::FrameTree;

/// A change of one node: which, what, and to what.
fn damage() -> impl Strategy<Value = (usize, u8, u64)> {
    (any::<usize>(), 0u8..6, prop_oneof![any::<u64>(), 0u64..300])
}

fn apply(tree: &mut [TreeNode], (at, what, value): (usize, u8, u64)) {
    let other = tree[value as usize % tree.len()];
    let len = tree.len();
    let node = &mut tree[at % len];
    match what {
        0 => node.node = value,
        1 => node.first_child = value as u32,
        2 => node.child_count = value as u8,
        3 => node.flags = value as u8 & 15,
        4 => *node = other,
        _ => node.flags ^= 1 << (value % 3),
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, max_global_rejects: 20_000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_damaged_tree_is_refused_or_drawn(case in case(), damages in prop::collection::vec(damage(), 1..4)) {
        let mut tree = case.tree();
        prop_assume!(!tree.is_empty());
        let whole = tree.clone();
        damages.iter().for_each(|d| apply(&mut tree, *d));
        let mut frame_tree = FrameTree::new(&case.world, NODES, NODES);
        let read = frame_tree.read(&tree);
        if tree == whole {
            prop_assert_eq!(read, Ok(()));
        }
        if read.is_ok() {
            prop_assert_eq!(frame_tree.len(), tree.len());
            let frame = case.frame(&tree, &case.tiles(&tree));
            prop_assert!(frame.slots().len() > 2);
        }
    }

    #[test]
    fn random_bytes_are_refused(case in case(), bytes in prop::collection::vec(any::<u64>(), 3..300)) {
        let mut tree: Vec<TreeNode> = bytemuck::cast_slice(&bytes[..bytes.len() / 3 * 3]).to_vec();
        let mut frame_tree = FrameTree::new(&case.world, NODES, NODES);
        prop_assert!(frame_tree.read(&tree).is_err());
        // Also behind a root that looks good.
        tree[0].node = case.world.root().pack();
        tree[0].flags = 0;
        prop_assert!(frame_tree.read(&tree).is_err());
    }
}
