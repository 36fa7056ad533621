//! Pool slots: shown when whole, filled anew when no frame reads them.

use super::model;
use crate::ids::{Generation, Sequence, SlotIndex};
use crate::node::NodeId;
use crate::shm::slot_words::{SlotState, SlotWords};
use loom::cell::UnsafeCell;
use loom::sync::Arc;
use loom::sync::atomic::{AtomicU64, Ordering};

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

fn at(sequence: u64) -> Sequence {
    Sequence::new(sequence)
}

impl HeapPool {
    /// A slot that holds the tile of node 1, generation 1, wanted last by frame `sequence`.
    fn with_tile(sequence: u64) -> Arc<Self> {
        let pool = Self { words: SlotWords::new(), tile: UnsafeCell::new(0), completed: AtomicU64::new(0) };
        assert_eq!(pool.words.claim(node(1), at(sequence), at(0)), Some(Generation::new(1)));
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
        let generation = pool.words.claim(node(7), at(1), at(0)).unwrap();
        let filler = {
            let pool = Arc::clone(&pool);
            loom::thread::spawn(move || {
                pool.fill(7);
                pool.words.publish();
            })
        };
        // The main thread wants it for a later frame meanwhile.
        assert!(pool.words.touch(None, at(5)));
        if pool.words.is_readable(generation) {
            assert_eq!(pool.read(), 7);
        }
        filler.join().unwrap();
        let info = pool.words.info(SlotIndex::new(0));
        assert_eq!((info.state, info.last_used, info.node), (SlotState::Ready, at(5), Some(node(7))));
    });
}

#[test]
fn loom_pool_refills_no_slot_that_a_frame_in_flight_reads() {
    model(|| {
        let pool = HeapPool::with_tile(1);
        let renderer = {
            let pool = Arc::clone(&pool);
            loom::thread::spawn(move || {
                assert!(pool.words.is_readable(Generation::new(1)));
                assert_eq!(pool.read(), 1);
                // SYNC control.completed.
                pool.completed.fetch_max(1, Ordering::Release);
            })
        };
        let completed = pool.completed.load(Ordering::Acquire);
        if let Some(generation) = pool.words.claim(node(2), at(2), at(completed)) {
            assert_eq!(generation, Generation::new(2));
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
                // Frame 2 wants the tile. When that was in time, the tile stays until frame 2 is
                // completed.
                let is_kept = pool.words.touch(Some(Generation::new(1)), at(2));
                if is_kept && pool.words.is_readable(Generation::new(1)) {
                    assert_eq!(pool.read(), 1);
                } else {
                    assert!(!is_kept, "a tile that was to stay is gone");
                }
            })
        };
        // Frame 1 is completed, frame 2 is not.
        if pool.words.claim(node(2), at(3), at(1)).is_some() {
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
                assert_eq!(pool.words.claim(node(2), at(2), at(1)), Some(Generation::new(2)));
                pool.words.publish();
            })
        };
        let info = pool.words.info(SlotIndex::new(0));
        if info.state.is_readable() {
            assert_eq!(info.node, Some(node(info.generation.get())));
        }
        writer.join().unwrap();
    });
}

#[test]
fn loom_pool_slot_that_was_given_up_is_filled_again() {
    model(|| {
        let pool =
            Arc::new(HeapPool { words: SlotWords::new(), tile: UnsafeCell::new(0), completed: AtomicU64::new(0) });
        pool.words.claim(node(1), at(1), at(0)).unwrap();
        let filler = {
            let pool = Arc::clone(&pool);
            loom::thread::spawn(move || {
                pool.fill(1);
                pool.words.abandon();
            })
        };
        if pool.words.claim(node(2), at(1), at(0)).is_some() {
            pool.fill(2);
            pool.words.publish();
            assert_eq!(pool.read(), 2);
        }
        filler.join().unwrap();
    });
}
