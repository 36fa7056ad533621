//! Ring, ping-pong buffer and elevation ring against simple models, and between threads.

use super::within_deadline;
use crate::ids::RingPosition;
use crate::shm::memory;
use crate::tree::{TreeHeader, TreeNode};
use bytemuck::Zeroable;
use proptest::prelude::*;
use std::collections::VecDeque;

#[derive(Debug, Clone)]
enum Step {
    Push(u64),
    Pop,
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    proptest::collection::vec(prop_oneof![any::<u64>().prop_map(Step::Push), Just(Step::Pop)], 0..200)
}

proptest! {
    #[test]
    fn a_ring_is_a_queue_with_a_bound(steps in steps(), log2_capacity in 0u32..5) {
        let capacity = 1usize << log2_capacity;
        let (mut producer, mut consumer) = memory::ring::<u64>(capacity as u32).unwrap();
        let mut model = VecDeque::new();
        for step in steps {
            match step {
                Step::Push(item) if model.len() < capacity => {
                    prop_assert_eq!(producer.try_push(item), Ok(()));
                    model.push_back(item);
                }
                Step::Push(item) => prop_assert_eq!(producer.try_push(item), Err(item)),
                Step::Pop => prop_assert_eq!(consumer.try_pop().unwrap(), model.pop_front()),
            }
            prop_assert_eq!(consumer.pending().unwrap(), model.len() as u64);
        }
    }

    #[test]
    fn an_elevation_ring_holds_what_was_published_and_not_released(
        releases in proptest::collection::vec(0u64..6, 1..60)
    ) {
        let (mut writer, mut reader) = memory::elevation_ring(4, 9).unwrap();
        let control = memory::control().unwrap();
        let (mut written, mut released) = (0u64, 0u64);
        for ahead in releases {
            while written - released < 4 {
                let mut array = writer.begin(&control).unwrap();
                prop_assert_eq!(array.position(), written);
                array.values_mut().fill(written as f32);
                prop_assert_eq!(array.publish(), written);
                written += 1;
            }
            for position in released.saturating_sub(2)..written + 2 {
                let values = reader.read_array(position).unwrap().map(<[f32]>::to_vec);
                let expected = (released..written).contains(&position).then(|| vec![position as f32; 9]);
                prop_assert_eq!(values, expected);
            }
            let upto = released + ahead;
            prop_assert_eq!(reader.released(RingPosition::new(upto)).is_ok(), upto <= written);
            if upto <= written {
                released = upto;
            }
        }
    }
}

#[test]
fn an_array_that_is_dropped_unpublished_was_never_there() {
    let (mut writer, mut reader) = memory::elevation_ring(2, 4).unwrap();
    let control = memory::control().unwrap();
    drop(writer.begin(&control).unwrap());
    assert_eq!(reader.read_array(0).unwrap(), None);
    assert_eq!(writer.begin(&control).unwrap().publish(), 0);
    assert!(reader.read_array(0).unwrap().is_some());
}

#[test]
fn items_pass_between_threads_in_order_through_a_small_ring() {
    // A step takes a thousand times as long under Miri.
    let half: u64 = if cfg!(miri) { 100 } else { 10_000 };
    within_deadline(move || {
        let (mut producer, mut consumer) = memory::ring::<[u64; 3]>(4).unwrap();
        let control = memory::control().unwrap();
        std::thread::scope(|scope| {
            let control = &control;
            scope.spawn(move || {
                for i in 0..half {
                    producer.push(&[i, !i, i * 7], control).unwrap();
                }
                let rest: Vec<_> = (half..2 * half).map(|i| [i, !i, i * 7]).collect();
                producer.push_all(&rest, control).unwrap();
            });
            for i in 0..2 * half {
                assert_eq!(consumer.pop(control).unwrap(), [i, !i, i * 7]);
            }
        });
        assert_eq!(consumer.try_pop().unwrap(), None);
    });
}

#[test]
fn the_generator_fills_one_half_while_the_preparer_holds_the_other() {
    let control = memory::control().unwrap();
    let (mut writer, mut reader) = memory::ping_pong(8).unwrap();
    let tree = |frame| TreeHeader { frame, node_count: frame as u32, ..TreeHeader::zeroed() };
    let write = |writer: &mut crate::shm::TreeWriter, frame: u64| {
        writer
            .write(&control, |nodes| {
                assert_eq!(nodes.len(), 8);
                nodes[..frame as usize].fill(TreeNode { node: frame, ..TreeNode::zeroed() });
                tree(frame)
            })
            .unwrap();
    };
    write(&mut writer, 1);
    let guard = reader.next(&control).unwrap();
    write(&mut writer, 2);
    assert_eq!(guard.header().frame, 1);
    assert_eq!(guard.iter().map(|node| node.node).collect::<Vec<_>>(), [1]);
    drop(guard);
    write(&mut writer, 3);
    for frame in [2, 3] {
        let guard = reader.next(&control).unwrap();
        assert_eq!((guard.header().frame, guard.len()), (frame, frame as usize));
        assert!(guard.nodes().iter().all(|node| node.node == frame));
    }
    assert!(reader.try_next().unwrap().is_none());
}

#[test]
fn a_tree_with_more_nodes_than_a_half_is_refused_and_not_published() {
    let control = memory::control().unwrap();
    let (mut writer, mut reader) = memory::ping_pong(8).unwrap();
    let error = writer.write(&control, |_| TreeHeader { node_count: 9, ..TreeHeader::zeroed() }).unwrap_err();
    assert!(error.to_string().contains("number of nodes is 9"), "{error}");
    assert!(reader.try_next().unwrap().is_none());
}

#[test]
fn capacities_that_cannot_be_are_errors() {
    assert!(memory::ring::<u64>(0).is_err());
    assert!(memory::ring::<u64>(3).is_err());
    assert!(memory::ping_pong(0).is_err());
    assert!(memory::elevation_ring(4, 0).is_err());
    assert!(memory::pool(0, 64).is_err());
}
