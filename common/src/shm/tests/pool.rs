//! The pool against a simple model, and what its writer and readers are promised.

use super::within_deadline;
use crate::ids::{Generation, Sequence, SlotIndex, SlotKey};
use crate::node::NodeId;
use crate::shm::kind::SegmentKind;
use crate::shm::memory::{self, segment};
use crate::shm::pool::{PoolIndex, PoolReader, PoolWriter, Residency, SlotState};
use proptest::prelude::*;
use std::collections::HashMap;

fn node(number: u32) -> NodeId {
    NodeId::new(number, 3, 1).unwrap()
}

fn at(sequence: u64) -> Sequence {
    Sequence::new(sequence)
}

#[derive(Debug, Clone)]
enum Step {
    /// A frame wants this tile: touch it, or load it (published, or given up).
    Want {
        node: u32,
        is_good: bool,
    },
    NextFrame,
    Complete {
        behind: u64,
    },
    Lock {
        node: u32,
    },
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        6 => (0u32..20, prop::bool::weighted(0.9)).prop_map(|(node, is_good)| Step::Want { node, is_good }),
        2 => Just(Step::NextFrame),
        2 => (0u64..4).prop_map(|behind| Step::Complete { behind }),
        1 => (0u32..3).prop_map(|node| Step::Lock { node }),
    ]
}

/// Steps of a random run. Under Miri each takes a thousand times as long.
const MOST_STEPS: usize = if cfg!(miri) { 20 } else { 300 };

#[derive(Debug, Clone, Copy)]
struct Entry {
    key: SlotKey,
    last_used: Sequence,
    is_locked: bool,
}

proptest! {
    /// Tiles stay while a frame in flight wants them, the least recently wanted goes first, and
    /// locked ones never.
    #[test]
    fn a_pool_is_a_least_recently_wanted_cache(steps in proptest::collection::vec(step(), 0..MOST_STEPS)) {
        const SLOTS: usize = 8;
        let (mut writer, reader) = memory::pool(SLOTS as u32, 64).unwrap();
        let mut model: HashMap<u32, Entry> = HashMap::new();
        let (mut sequence, mut completed) = (Sequence::FIRST, Sequence::NONE);
        for step in steps {
            match step {
                Step::NextFrame => sequence = sequence.next(),
                Step::Complete { behind } => completed = completed.max(sequence.saturating_sub(behind + 1)),
                Step::Lock { node: number } => {
                    if let Some(key) = writer.find(node(number)) {
                        prop_assert!(writer.lock(key.slot));
                        model.get_mut(&number).unwrap().is_locked = true;
                    }
                }
                Step::Want { node: number, is_good } => {
                    let residency = writer.touch_node(node(number), sequence);
                    if let Some(entry) = model.get_mut(&number) {
                        entry.last_used = sequence;
                        prop_assert_eq!(residency, Residency::Resident { key: entry.key });
                        prop_assert!(writer.allocate(node(number), sequence, completed).is_none());
                        continue;
                    }
                    prop_assert_eq!(residency, Residency::Absent);
                    let oldest = model
                        .values()
                        .filter(|entry| !entry.is_locked && entry.last_used <= completed)
                        .map(|entry| entry.last_used)
                        .min();
                    let has_room = model.len() < SLOTS || oldest.is_some();
                    let guard = writer.allocate(node(number), sequence, completed);
                    prop_assert_eq!(guard.is_some(), has_room);
                    let Some(mut guard) = guard else { continue };
                    // The tile in that slot was the least recently wanted one, and was evicted only
                    // if no slot was free.
                    let evicted = model.iter().find(|(_, entry)| entry.key.slot == guard.key().slot).map(|(n, e)| (*n, *e));
                    if let Some((evicted, entry)) = evicted {
                        prop_assert_eq!(Some(entry.last_used), oldest);
                        prop_assert!(!entry.is_locked);
                        prop_assert!(reader.bytes(entry.key).is_none());
                        model.remove(&evicted);
                    }
                    guard.bytes_mut().fill(number as u8);
                    if is_good {
                        let key = guard.publish();
                        model.insert(number, Entry { key, last_used: sequence, is_locked: false });
                    } else {
                        drop(guard);
                        prop_assert_eq!(writer.residency(node(number)), Residency::Absent);
                    }
                }
            }
            for (&number, entry) in &model {
                let tile = reader.bytes(entry.key).unwrap();
                prop_assert!(tile.iter().all(|&byte| byte == number as u8));
                prop_assert_eq!(reader.find(node(number)), Some(entry.key));
            }
            prop_assert_eq!(reader.slots().filter(|info| info.state.is_readable()).count(), model.len());
        }
    }
}

#[test]
fn a_slot_given_up_is_found_again_even_when_all_others_are_wanted() {
    let (mut writer, _) = memory::pool(2, 64).unwrap();
    writer.allocate(node(1), at(1), at(0)).unwrap().publish();
    drop(writer.allocate(node(2), at(1), at(0)).unwrap());
    let key = writer.allocate(node(3), at(1), at(0)).unwrap().publish();
    assert!(writer.allocate(node(4), at(1), at(0)).is_none(), "both slots are wanted by frame 1");
    assert_eq!(writer.find(node(2)), None);
    assert_eq!(writer.find(node(3)).map(|found| found.slot), Some(key.slot));
}

#[test]
fn a_tile_that_is_being_loaded_is_neither_evicted_nor_loaded_twice() {
    let (mut writer, reader) = memory::pool(1, 64).unwrap();
    let guard = writer.allocate(node(1), at(1), at(0)).unwrap();
    assert_eq!(writer.residency(node(1)), Residency::Filling);
    assert!(writer.allocate(node(1), at(1), at(u64::MAX)).is_none());
    assert!(writer.allocate(node(2), at(9), at(u64::MAX)).is_none());
    assert!(reader.bytes(guard.key()).is_none());
    // Wanted by a later frame while it loads: it stays for that frame.
    assert_eq!(writer.touch_node(node(1), at(5)), Residency::Filling);
    let key = guard.publish();
    assert!(writer.allocate(node(2), at(6), at(4)).is_none());
    assert!(reader.bytes(key).is_some_and(|tile| tile.is_still_valid()));
    assert!(writer.allocate(node(2), at(6), at(5)).is_some());
}

#[test]
fn generations_tell_a_tile_from_the_one_before_it() {
    let (mut writer, reader) = memory::pool(1, 64).unwrap();
    let first = writer.allocate(node(1), at(1), at(0)).unwrap().publish();
    let second = writer.allocate(node(2), at(2), at(1)).unwrap().publish();
    assert!(first.slot == second.slot && first.generation != second.generation);
    assert!(reader.bytes(first).is_none());
    assert!(!reader.touch(first, at(9)) && reader.touch(second, at(9)));
    assert!(reader.bytes(second).is_some());
    let [elsewhere, empty] =
        [SlotKey { slot: SlotIndex::new(1), ..second }, SlotKey { generation: Generation::NEVER_FILLED, ..second }];
    assert!(reader.bytes(elsewhere).is_none() && reader.bytes(empty).is_none());
    assert_eq!(reader.info(second.slot).unwrap().last_used, at(9));
}

#[test]
fn a_writer_that_takes_over_keeps_published_tiles_and_frees_half_filled_slots() {
    let segment = segment(SegmentKind::ColorPool, 3, 64).unwrap();
    let mut first = PoolWriter::attach(&segment).unwrap();
    let kept = first.allocate(node(1), at(1), at(0)).unwrap().publish();
    let mut guard = first.allocate(node(2), at(1), at(0)).unwrap();
    guard.bytes_mut().fill(1);
    let half_filled = guard.key().slot;
    // A guard on another thread still has the writer's place.
    drop(first);
    assert!(PoolWriter::attach(&segment).is_err());
    // As if the process had been killed: the slot stays as it is, the place is free.
    guard.abandon_as_if_killed();
    let second = PoolWriter::attach(&segment).unwrap();
    assert_eq!(second.find(node(1)), Some(kept));
    assert_eq!(second.residency(node(2)), Residency::Absent);
    let reader = PoolReader::attach(&segment).unwrap();
    assert_eq!(reader.info(half_filled).unwrap().state, SlotState::Free);
}

#[test]
fn a_writer_that_takes_over_takes_free_slots_before_tiles_that_were_expected() {
    let segment = segment(SegmentKind::ColorPool, 8, 64).unwrap();
    let mut first = PoolWriter::attach(&segment).unwrap();
    for number in 0..4 {
        first.allocate_expected(node(number), at(9), at(8)).unwrap().publish();
    }
    drop(first);
    // It knows not what was expected; nothing of it has to go before all slots are full.
    let mut second = PoolWriter::attach(&segment).unwrap();
    for number in 4..8 {
        second.allocate(node(number), at(20), at(19)).unwrap().publish();
    }
    assert!((0..8).all(|number| second.find(node(number)).is_some()));
    assert!(second.allocate(node(8), at(21), at(20)).is_some(), "then the oldest goes");
}

#[test]
fn decoding_threads_fill_slots_while_the_writer_goes_on() {
    const SLOT_BYTES: u64 = if cfg!(miri) { 64 } else { 4096 };
    within_deadline(|| {
        let (mut writer, reader) = memory::pool(64, SLOT_BYTES).unwrap();
        std::thread::scope(|scope| {
            for number in 0..64 {
                let mut guard = writer.allocate(node(number), at(1), at(0)).unwrap();
                scope.spawn(move || {
                    guard.bytes_mut().fill(number as u8);
                    guard.publish();
                });
                writer.touch_node(node(number / 2), at(1));
            }
        });
        for number in 0..64 {
            let key = writer.find(node(number)).unwrap();
            assert!(reader.bytes(key).unwrap().iter().all(|&byte| byte == number as u8));
        }
    });
}

#[test]
fn expected_tiles_take_only_what_nobody_wants_or_expects_and_are_evicted_in_one_order_with_the_wanted() {
    let (mut writer, _) = memory::pool(4, 64).unwrap();
    for number in 1..=3 {
        writer.allocate(node(number), at(number.into()), at(0)).unwrap().publish();
    }
    let locked = writer.find(node(1)).unwrap().slot;
    assert!(writer.lock(locked));
    // A free slot first.
    assert_eq!(writer.unexpected_slots(at(5), at(3)), 3);
    writer.allocate_expected(node(10), at(5), at(3)).unwrap().publish();
    // Tile 2 is expected at 5 too; tile 3 was last wanted by frame 3.
    assert!(matches!(writer.expect(node(2), at(5)), Residency::Resident { .. }));
    assert_eq!(writer.unexpected_slots(at(5), at(3)), 1);
    assert!(writer.allocate_expected(node(11), at(5), at(2)).is_none(), "frame 3 is not completed");
    writer.allocate_expected(node(11), at(5), at(3)).unwrap().publish();
    assert_eq!(writer.find(node(3)), None);
    assert!(writer.allocate_expected(node(12), at(5), at(9)).is_none(), "all others are as much expected");
    // A tile that is wanted now takes one of them: predicted tiles are not pinned.
    writer.allocate(node(20), at(6), at(5)).unwrap().publish();
    assert!(writer.find(node(1)).is_some());
    assert_eq!([2, 10, 11].iter().filter(|number| writer.find(node(**number)).is_none()).count(), 1);
    // What is expected later goes later than what was wanted before.
    let left: Vec<u32> = [2, 10, 11].into_iter().filter(|number| writer.find(node(*number)).is_some()).collect();
    writer.expect(node(left[0]), at(8));
    writer.allocate(node(21), at(7), at(6)).unwrap().publish();
    assert!(writer.find(node(left[0])).is_some() && writer.find(node(left[1])).is_none());
}

#[test]
fn an_index_keeps_what_is_there_and_forgets_what_has_gone() {
    let (mut writer, reader) = memory::pool(2, 64).unwrap();
    writer.allocate(node(1), at(1), at(0)).unwrap().publish();
    let mut index = PoolIndex::new(reader);
    // What was there before it; and for the frames that want it alone.
    assert!(index.keep(node(1), at(2)));
    assert!(index.kept(node(1), at(2)).is_some() && index.kept(node(1), at(3)).is_none());
    let guard = writer.allocate(node(2), at(2), at(0)).unwrap();
    let key = guard.key();
    assert!(!index.note(node(2), key), "it is being filled");
    guard.publish();
    assert!(!index.note(node(3), key) && !index.note(node(2), SlotKey { generation: key.generation.next(), ..key }));
    assert!(!index.note(node(2), SlotKey { slot: SlotIndex::new(7), ..key }) && !index.keep(node(2), at(2)));
    assert!(index.note(node(2), key) && index.keep(node(2), at(2)));
    assert!(index.bytes(node(2), at(2)).is_some());
    // Kept for frame 2, both of them: nothing is evicted before it is completed.
    assert!(writer.allocate(node(4), at(3), at(1)).is_none());
    let other = writer.allocate(node(4), at(3), at(2)).unwrap().publish();
    assert!(!index.keep(node(1), at(3)) || !index.keep(node(2), at(3)));
    assert!(index.note(node(4), other) && index.keep(node(4), at(3)));
}
