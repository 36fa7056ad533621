//! Models of the algorithms: `loom` runs them under every order of their atomic steps (at most
//! three preemptions), with every value that a weak memory may return, and reports races on the
//! bytes in between. A file per structure.

mod bell;
mod frame_ring;
mod ping_pong;
mod pool;
mod ring;
mod seqlock;
mod want_list;

use super::bell::{Bell, Slept};
use super::cursor::Positions;
use super::kind::SegmentKind;
use super::ring_core::Items;
use loom::cell::UnsafeCell;
use loom::sync::Arc;
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

// SAFETY: the positions' protocol gives each cell to one side at a time, which is what the models
// check.
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
