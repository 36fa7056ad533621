//! In the steady state of a flight no handle allocates memory.

use super::within_deadline;
use crate::camera::Camera;
use crate::ids::{RingPosition, Sequence};
use crate::node::NodeId;
use crate::shm::pool::Residency;
use crate::shm::{Counter, Stage, memory};
use crate::slot::Slot;
use crate::tree::TreeHeader;
use bytemuck::Zeroable;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::time::Duration;

/// The system's allocator, which counts each thread's allocations.
struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

// SAFETY: all calls go to `System` as they came; the counter is a thread local without destructor
// or allocation.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.with(|count| count.set(count.get() + 1));
        // SAFETY: the caller's promise, handed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise, handed on.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn allocations() -> u64 {
    ALLOCATIONS.with(Cell::get)
}

#[test]
fn frames_pass_without_an_allocation() {
    within_deadline(|| {
        let control = memory::control().unwrap();
        let (mut ring, mut slots) = memory::ring::<Slot>(64).unwrap();
        let (mut trees, mut halves) = memory::ping_pong(64).unwrap();
        let (mut arrays, mut read) = memory::elevation_ring(16, 25).unwrap();
        let (mut pool, tiles) = memory::pool(32, 256).unwrap();
        control.register(Stage::Preparer).unwrap();
        let frame = [Slot::zeroed(); 16];
        let before = allocations();
        assert!(before > 0, "the counter counts");
        let mut node = 0;
        for number in 1..2000u64 {
            let sequence = Sequence::new(number);
            trees.write(&control, |_| TreeHeader::zeroed()).unwrap();
            drop(halves.next(&control).unwrap());
            // Eight new tiles a frame: every one evicts another, after the first four frames.
            for _ in 0..8 {
                node += 1;
                let node = NodeId::new(node, 0, 0).unwrap();
                assert_eq!(pool.touch_node(node, sequence), Residency::Absent);
                let mut guard = pool.allocate(node, sequence, control.completed_sequence()).unwrap();
                guard.bytes_mut().fill(1);
                let key = guard.publish();
                assert!(tiles.bytes(key).is_some());
            }
            for _ in 0..4 {
                arrays.begin(&control).unwrap().publish();
            }
            ring.push_all(&frame, &control).unwrap();
            for _ in 0..16 {
                slots.pop(&control).unwrap();
            }
            read.released(RingPosition::new(4 * number)).unwrap();
            control.publish_camera(&Camera::default());
            control.heartbeat(Stage::Preparer);
            control.count(Counter::FramesPrepared, 1);
            control.set_completed_sequence(sequence);
            control.wait_completed(sequence).unwrap();
        }
        assert_eq!(allocations() - before, 0);
    });
}

#[test]
fn a_long_wait_does_not_allocate_either() {
    within_deadline(|| {
        let control = memory::control().unwrap();
        control.register(Stage::Preparer).unwrap();
        let (mut producer, mut consumer) = memory::ring::<u64>(4).unwrap();
        std::thread::scope(|scope| {
            let control = &control;
            scope.spawn(move || {
                // Long enough for the looks at launcher and peer.
                std::thread::sleep(Duration::from_millis(350));
                producer.push(&1, control).unwrap();
            });
            let before = allocations();
            assert_eq!(consumer.pop(control).unwrap(), 1);
            assert_eq!(allocations() - before, 0);
        });
    });
}
