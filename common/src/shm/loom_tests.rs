//! Models of the algorithms: `loom` runs them under every order of their atomic steps (at most three preemptions), with
//! every value that a weak memory may return, and reports races on the bytes in between.

use super::bell::{Bell, Slept};
use super::cursor::{Positions, ReadCursor, WriteCursor};
use super::frame_core::{FrameSlot, newest};
use super::kind::SegmentKind;
use super::ring_core::{Items, ReadEnd, WriteEnd};
use super::seqlock::SeqLock;
use super::slot_words::{SlotState, SlotWords};
use super::want_core::{HEAD_WORDS, Look, WantEntry, WantWords};
use crate::node::NodeId;
use loom::cell::UnsafeCell;
use loom::sync::Arc;
use loom::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

const KIND: SegmentKind = SegmentKind::Ring;

fn model(run: impl Fn() + Sync + Send + 'static) {
    let mut builder = loom::model::Builder::new();
    builder.preemption_bound = Some(3);
    builder.check(run);
}

struct HeapItems {
    positions: Positions,
    cells: Vec<UnsafeCell<u64>>,
}

impl HeapItems {
    fn new(capacity: usize) -> Arc<Self> {
        let cells = (0..capacity).map(|_| UnsafeCell::new(0)).collect();
        Arc::new(Self { positions: Positions::new(), cells })
    }
}

// SAFETY: the positions' protocol gives each cell to one side at a time, which is what the models check.
unsafe impl Sync for HeapItems {}

// SAFETY: `put` and `take` reach the one cell of the index; clones of the Arc share the positions.
unsafe impl Items for Arc<HeapItems> {
    type Item = u64;

    fn positions(&self) -> &Positions {
        &self.positions
    }

    unsafe fn put(&self, index: u64, item: &u64) {
        // SAFETY: the caller owns the cell; loom checks that.
        self.cells[index as usize].with_mut(|cell| unsafe { *cell = *item });
    }

    unsafe fn take(&self, index: u64) -> u64 {
        // SAFETY: as in `put`.
        self.cells[index as usize].with(|cell| unsafe { *cell })
    }
}

/// The wait of `Control::wait_for`, without backoff and without an end of the run.
fn wait<R>(bell: &Bell, mut attempt: impl FnMut() -> Option<R>) -> R {
    loop {
        if let Some(found) = attempt() {
            return found;
        }
        if let Ok(Slept::NotAtAll(found)) = bell.sleep_unless(Duration::ZERO, || Ok::<_, ()>(attempt())) {
            return found;
        }
    }
}

#[test]
fn loom_ring_hands_over_every_item_in_order_and_loses_no_wake() {
    model(|| {
        let items = HeapItems::new(2);
        let mut producer = WriteEnd::attach(Arc::clone(&items), KIND, 2).unwrap();
        let mut consumer = ReadEnd::attach(Arc::clone(&items), KIND, 2).unwrap();
        let writer = loom::thread::spawn(move || {
            let items = Arc::clone(&producer.items);
            for item in 1..=3 {
                wait(items.positions.writable(), || producer.try_push(&item).unwrap().then_some(()));
            }
        });
        for expected in 1..=3 {
            let item = wait(items.positions.readable(), || consumer.try_pop().unwrap());
            assert_eq!(item, expected);
        }
        writer.join().unwrap();
    });
}

#[test]
fn loom_ring_publishes_a_batch_as_far_as_it_fits() {
    model(|| {
        let items = HeapItems::new(2);
        let mut producer = WriteEnd::attach(Arc::clone(&items), KIND, 2).unwrap();
        let mut consumer = ReadEnd::attach(Arc::clone(&items), KIND, 2).unwrap();
        let writer = loom::thread::spawn(move || {
            let items = Arc::clone(&producer.items);
            let mut rest: &[u64] = &[1, 2, 3];
            while !rest.is_empty() {
                let count = wait(items.positions.writable(), || {
                    Some(producer.try_push_some(rest).unwrap()).filter(|&count| count > 0)
                });
                rest = &rest[count..];
            }
        });
        for expected in 1..=3 {
            assert_eq!(wait(items.positions.readable(), || consumer.try_pop().unwrap()), expected);
        }
        writer.join().unwrap();
    });
}

#[test]
fn loom_ping_pong_gives_each_half_to_one_side_at_a_time() {
    model(|| {
        // A half is written and read in place, in several steps, between the cursor's calls, as the handles do it.
        let halves = HeapItems::new(2);
        let mut writer = WriteCursor::attach(&halves.positions, KIND, 2).unwrap();
        let mut reader = ReadCursor::attach(&halves.positions, KIND, 2).unwrap();
        let generator = {
            let halves = Arc::clone(&halves);
            loom::thread::spawn(move || {
                for tree in 1..=3u64 {
                    wait(halves.positions.writable(), || {
                        (writer.room(&halves.positions, 1).unwrap() > 0).then_some(())
                    });
                    let half = (writer.position() & 1) as usize;
                    // SAFETY: the half is ours; loom checks that.
                    halves.cells[half].with_mut(|cell| unsafe { *cell = 100 * tree });
                    // SAFETY: as above.
                    halves.cells[half].with_mut(|cell| unsafe { *cell += tree });
                    writer.publish(&halves.positions, 1);
                }
            })
        };
        for tree in 1..=3u64 {
            wait(halves.positions.readable(), || (reader.filled(&halves.positions).unwrap() > 0).then_some(()));
            let half = (reader.position() & 1) as usize;
            for _ in 0..2 {
                // SAFETY: the half is ours until the release; loom checks that.
                assert_eq!(halves.cells[half].with(|cell| unsafe { *cell }), 101 * tree);
            }
            reader.release(&halves.positions, 1);
        }
        generator.join().unwrap();
    });
}

struct HeapPool {
    words: SlotWords,
    tile: UnsafeCell<u32>,
    completed: AtomicU64,
}

// SAFETY: the slot's protocol gives the tile to one side at a time, which is what the models check.
unsafe impl Sync for HeapPool {}

fn node(number: u32) -> NodeId {
    NodeId::new(number, 0, 0).unwrap()
}

impl HeapPool {
    /// A slot that holds the tile of node 1, generation 1, wanted last by frame `sequence`.
    fn with_tile(sequence: u64) -> Arc<Self> {
        let pool = Self { words: SlotWords::new(), tile: UnsafeCell::new(0), completed: AtomicU64::new(0) };
        assert_eq!(pool.words.claim(node(1), sequence, 0), Some(1));
        pool.fill(1);
        pool.words.publish();
        Arc::new(pool)
    }

    fn fill(&self, value: u32) {
        // SAFETY: the slot was claimed; loom checks that.
        self.tile.with_mut(|tile| unsafe { *tile = value });
    }

    fn read(&self) -> u32 {
        // SAFETY: the slot is readable for a frame that is not completed; loom checks that.
        self.tile.with(|tile| unsafe { *tile })
    }
}

#[test]
fn loom_pool_shows_a_tile_only_when_it_is_whole() {
    model(|| {
        let pool =
            Arc::new(HeapPool { words: SlotWords::new(), tile: UnsafeCell::new(0), completed: AtomicU64::new(0) });
        let generation = pool.words.claim(node(7), 1, 0).unwrap();
        let filler = {
            let pool = Arc::clone(&pool);
            loom::thread::spawn(move || {
                pool.fill(7);
                pool.words.publish();
            })
        };
        // The main thread wants it for a later frame meanwhile.
        assert!(pool.words.touch(None, 5));
        if pool.words.is_readable(generation) {
            assert_eq!(pool.read(), 7);
        }
        filler.join().unwrap();
        let info = pool.words.info(0);
        assert_eq!((info.state, info.last_used, info.node), (SlotState::Ready, 5, Some(node(7))));
    });
}

#[test]
fn loom_pool_refills_no_slot_that_a_frame_in_flight_reads() {
    model(|| {
        let pool = HeapPool::with_tile(1);
        let renderer = {
            let pool = Arc::clone(&pool);
            loom::thread::spawn(move || {
                assert!(pool.words.is_readable(1));
                assert_eq!(pool.read(), 1);
                // SYNC control.completed.
                pool.completed.fetch_max(1, Ordering::Release);
            })
        };
        let completed = pool.completed.load(Ordering::Acquire);
        if let Some(generation) = pool.words.claim(node(2), 2, completed) {
            assert_eq!(generation, 2);
            pool.fill(2);
            pool.words.publish();
        }
        renderer.join().unwrap();
    });
}

#[test]
fn loom_pool_lets_either_the_wish_or_the_eviction_win() {
    model(|| {
        let pool = HeapPool::with_tile(1);
        let wisher = {
            let pool = Arc::clone(&pool);
            loom::thread::spawn(move || {
                // Frame 2 wants the tile. When that was in time, the tile stays until frame 2 is completed.
                let is_kept = pool.words.touch(Some(1), 2);
                if is_kept && pool.words.is_readable(1) {
                    assert_eq!(pool.read(), 1);
                } else {
                    assert!(!is_kept, "a tile that was to stay is gone");
                }
            })
        };
        // Frame 1 is completed, frame 2 is not.
        if pool.words.claim(node(2), 3, 1).is_some() {
            pool.fill(2);
            pool.words.publish();
        }
        wisher.join().unwrap();
    });
}

#[test]
fn loom_pool_reports_node_and_generation_that_belong_together() {
    model(|| {
        let pool = HeapPool::with_tile(1);
        let writer = {
            let pool = Arc::clone(&pool);
            loom::thread::spawn(move || {
                assert_eq!(pool.words.claim(node(2), 2, 1), Some(2));
                pool.words.publish();
            })
        };
        let info = pool.words.info(0);
        if info.state.is_readable() {
            assert_eq!(info.node, Some(node(info.generation)));
        }
        writer.join().unwrap();
    });
}

#[test]
fn loom_pool_slot_that_was_given_up_is_filled_again() {
    model(|| {
        let pool =
            Arc::new(HeapPool { words: SlotWords::new(), tile: UnsafeCell::new(0), completed: AtomicU64::new(0) });
        pool.words.claim(node(1), 1, 0).unwrap();
        let filler = {
            let pool = Arc::clone(&pool);
            loom::thread::spawn(move || {
                pool.fill(1);
                pool.words.abandon();
            })
        };
        if pool.words.claim(node(2), 1, 0).is_some() {
            pool.fill(2);
            pool.words.publish();
            assert_eq!(pool.read(), 2);
        }
        filler.join().unwrap();
    });
}

#[test]
fn loom_seqlock_gives_whole_values() {
    model(|| {
        let lock = Arc::new(SeqLock::<2>::new());
        lock.write(&[1, 1]);
        let writer = {
            let lock = Arc::clone(&lock);
            loom::thread::spawn(move || lock.write(&[2, 2]))
        };
        if let Some([a, b]) = lock.read() {
            assert!(a == b && (a == 1 || a == 2));
        }
        writer.join().unwrap();
        assert_eq!(lock.read(), Some([2, 2]));
    });
}

const FRAME_WORDS: usize = 2;

/// A frame ring of two slots.
struct HeapFrames {
    newest: AtomicU64,
    sequences: [AtomicU64; 2],
    words: [[AtomicU64; FRAME_WORDS]; 2],
}

impl HeapFrames {
    fn new() -> Arc<Self> {
        let words = || std::array::from_fn(|_| AtomicU64::new(0));
        let sequences = [AtomicU64::new(0), AtomicU64::new(0)];
        Arc::new(Self { newest: AtomicU64::new(0), sequences, words: [words(), words()] })
    }

    fn slot(&self, number: u64) -> FrameSlot<'_> {
        let index = (number.wrapping_sub(1) % 2) as usize;
        FrameSlot { sequence: &self.sequences[index], words: &self.words[index] }
    }

    fn write(&self, number: u64) {
        let slot = self.slot(number);
        slot.begin(number);
        for word in slot.words {
            word.store(100 + number, Ordering::Relaxed);
        }
        slot.publish(number, &self.newest);
    }

    /// Number and words of the newest frame, if the copy was not overtaken.
    fn read(&self) -> Option<(u64, Vec<u64>)> {
        let number = newest(&self.newest);
        if number == 0 {
            return None;
        }
        let copy = |words: &[AtomicU64]| words.iter().map(|word| word.load(Ordering::Relaxed)).collect();
        Some((number, self.slot(number).copy(number, copy)?))
    }
}

#[test]
fn loom_frame_ring_gives_whole_frames_and_the_one_that_was_asked_for() {
    model(|| {
        let ring = HeapFrames::new();
        ring.write(1);
        let writer = {
            let ring = Arc::clone(&ring);
            // The third frame takes the place of the first.
            loom::thread::spawn(move || (2..=3).for_each(|number| ring.write(number)))
        };
        if let Some((number, words)) = ring.read() {
            assert_eq!(words, vec![100 + number; FRAME_WORDS]);
        }
        writer.join().unwrap();
        assert_eq!(ring.read(), Some((3, vec![103; FRAME_WORDS])));
    });
}

#[test]
fn loom_frame_ring_always_has_a_newest_frame_that_is_whole_unless_it_is_overtaken() {
    model(|| {
        let ring = HeapFrames::new();
        ring.write(1);
        let writer = {
            let ring = Arc::clone(&ring);
            loom::thread::spawn(move || ring.write(2))
        };
        // One more frame is no lap: the copy cannot fail.
        let (number, words) = ring.read().expect("a frame was published");
        assert_eq!(words, vec![100 + number; FRAME_WORDS]);
        writer.join().unwrap();
    });
}

#[test]
fn loom_frame_ring_goes_on_after_a_writer_that_died_in_a_frame() {
    model(|| {
        let ring = HeapFrames::new();
        ring.write(1);
        // Killed in the middle of frame 2.
        ring.slot(2).begin(2);
        ring.slot(2).words[0].store(7, Ordering::Relaxed);
        let successor = {
            let ring = Arc::clone(&ring);
            loom::thread::spawn(move || ring.write(newest(&ring.newest) + 1))
        };
        let (number, words) = ring.read().expect("a frame was published");
        assert_eq!(words, vec![100 + number; FRAME_WORDS]);
        successor.join().unwrap();
    });
}

#[test]
fn loom_frame_slot_is_whole_also_for_who_does_not_go_by_the_newest() {
    model(|| {
        let ring = HeapFrames::new();
        let writer = {
            let ring = Arc::clone(&ring);
            loom::thread::spawn(move || ring.write(1))
        };
        let copy = |words: &[AtomicU64]| words.iter().map(|word| word.load(Ordering::Relaxed)).collect();
        let words: Option<Vec<u64>> = ring.slot(1).copy(1, copy);
        assert!(words.is_none_or(|words| words == vec![101; FRAME_WORDS]));
        writer.join().unwrap();
    });
}

struct HeapWants {
    words: WantWords,
    entries: Vec<WantEntry>,
}

impl HeapWants {
    fn new(capacity: usize) -> Arc<Self> {
        Arc::new(Self { words: WantWords::new(), entries: (0..capacity).map(|_| WantEntry::new()).collect() })
    }

    /// A list of `tiles` tiles whose head says of which.
    fn write(&self, sequence: u64, tiles: &[u64]) {
        let mut head = [0; HEAD_WORDS];
        (head[0], head[HEAD_WORDS - 1]) = (sequence, tiles.len() as u64);
        self.words.write(&self.entries, head, tiles.iter().copied());
    }
}

#[test]
fn loom_want_list_is_read_whole_or_not_at_all() {
    model(|| {
        let wants = HeapWants::new(2);
        wants.write(1, &[1, 1]);
        let writer = {
            let wants = Arc::clone(&wants);
            loom::thread::spawn(move || wants.write(2, &[2]))
        };
        let mut tiles = Vec::new();
        let looked = wants.words.read(&wants.entries, 0, &mut tiles);
        if let Look::Changed { head, version } = looked {
            let expected: &[u64] = if head[0] == 1 { &[1, 1] } else { &[2] };
            assert_eq!(tiles, expected);
            assert_eq!(version, 2 * head[0]);
        }
        writer.join().unwrap();
        assert!(matches!(wants.words.read(&wants.entries, 2, &mut tiles), Look::Changed { version: 4, .. }));
        assert_eq!(tiles, [2]);
    });
}

#[test]
fn loom_want_list_wakes_its_reader_for_the_newest() {
    model(|| {
        let wants = HeapWants::new(1);
        let writer = {
            let wants = Arc::clone(&wants);
            loom::thread::spawn(move || {
                for sequence in 1..=2 {
                    wants.write(sequence, &[sequence]);
                    wants.words.bell().ring();
                }
            })
        };
        // Lists may be missed, the last one never.
        let (mut seen, mut tiles) = (0, Vec::new());
        loop {
            let head = wait(wants.words.bell(), || match wants.words.read(&wants.entries, seen, &mut tiles) {
                Look::Changed { version, head } => {
                    seen = version;
                    Some(head)
                }
                Look::Unchanged | Look::Busy => None,
            });
            if head[0] == 2 {
                break;
            }
        }
        writer.join().unwrap();
    });
}

#[test]
fn loom_a_bell_that_two_threads_ring_loses_no_wake() {
    model(|| {
        let bell = Arc::new(Bell::new());
        let done = Arc::new(AtomicU64::new(0));
        let ringers = [1, 2].map(|bit| {
            let (bell, done) = (Arc::clone(&bell), Arc::clone(&done));
            loom::thread::spawn(move || {
                done.fetch_or(bit, Ordering::Release);
                bell.ring();
            })
        });
        wait(&bell, || (done.load(Ordering::Acquire) == 3).then_some(()));
        ringers.into_iter().for_each(|ringer| ringer.join().unwrap());
    });
}
