//! A prefetcher small enough to be seen through: it serves want lists from a source that needs no
//! waiting.

use super::flight::Source;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;
use terravision_common::database::{Layer, Tile, TileScratch, TileSource};
use terravision_common::ids::Sequence;
use terravision_common::outcome::{Outcome, TileFailure, TileOutcome};
use terravision_common::shm::{
    Control, PoolWriter, Producer, Residency, RunState, WAIT_BOUND, WantHead, WantListReader,
};

/// Serves on a thread of its own until the last list, or the end of the run; dropped, it ends the
/// run.
pub struct Server {
    control: Arc<Control>,
    thread: Option<JoinHandle<()>>,
}

/// Makes what is there, when a frame is made, a matter of the test instead of who is faster.
#[derive(Debug, Default)]
pub struct Gate {
    is_open: AtomicBool,
    served: AtomicU64,
}

impl Gate {
    /// From now on frames are served; until then the top levels alone.
    pub fn open(&self) {
        self.is_open.store(true, Ordering::Release);
    }

    fn lets_through(&self, sequence: Sequence) -> bool {
        sequence == Sequence::NONE || self.is_open.load(Ordering::Acquire)
    }

    /// Waits until all has been served that frame `sequence` of the run lacked, or the run is over.
    pub fn await_served(&self, sequence: Sequence, control: &Control) {
        while self.served.load(Ordering::Acquire) < sequence.get() && control.check_running().is_ok() {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

pub struct TileServer {
    pub control: Arc<Control>,
    pub gate: Arc<Gate>,
    pub source: Source,
    /// Elevation, colour.
    pub pools: [PoolWriter; 2],
    pub wants: WantListReader,
    pub outcomes: Producer<TileOutcome>,
    /// A list is served from this place on, and then from its beginning: the order of tiles must
    /// not matter.
    pub rotation: usize,
}

impl Server {
    pub fn start(mut server: TileServer) -> Self {
        let control = Arc::clone(&server.control);
        let thread = std::thread::spawn(move || {
            let (mut tiles, mut scratch) = (vec![], TileScratch::default());
            loop {
                match server.wants.read(&mut tiles).expect("not corrupt") {
                    Some(head) if head.is_last => return,
                    Some(head) if server.gate.lets_through(head.sequence) => {
                        server.serve(head, &mut tiles, &mut scratch);
                        server.gate.served.store(head.sequence.get(), Ordering::Release);
                    }
                    _ => {}
                }
                if server.wants.wait(&server.control, WAIT_BOUND, || false).is_err() {
                    return;
                }
            }
        });
        Self { control, thread: Some(thread) }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.control.set_state(RunState::Stopping);
        let ended = self.thread.take().map(JoinHandle::join);
        assert!(std::thread::panicking() || ended.is_none_or(|e| e.is_ok()), "the server panicked");
    }
}

impl TileServer {
    fn serve(&mut self, head: WantHead, tiles: &mut [Tile], scratch: &mut TileScratch) {
        if !tiles.is_empty() {
            tiles.rotate_left(self.rotation % tiles.len());
        }
        let mut is_full = [false; 2];
        for tile in tiles {
            let outcome = match self.pools[tile.layer as usize].touch_node(tile.node, head.sequence) {
                Residency::Resident { key } => Some(Outcome::Resident { key }),
                Residency::Filling => unreachable!("one thread fills"),
                Residency::Absent if self.source.is_missing(*tile) => {
                    Some(Outcome::Unavailable { failure: TileFailure::Missing })
                }
                Residency::Absent => self.load(*tile, head.sequence, &mut is_full, scratch),
            };
            if let Some(outcome) = outcome {
                self.outcomes.push(&TileOutcome::new(*tile, outcome), &self.control).ok();
            }
        }
    }

    fn load(
        &mut self,
        tile: Tile,
        sequence: Sequence,
        is_full: &mut [bool; 2],
        scratch: &mut TileScratch,
    ) -> Option<Outcome> {
        let layer = tile.layer as usize;
        let completed = self.control.completed_sequence();
        let Some(mut guard) = self.pools[layer].allocate(tile.node, sequence, completed) else {
            return (!std::mem::replace(&mut is_full[layer], true)).then_some(Outcome::NoRoom { completed });
        };
        let read = match tile.layer {
            Layer::Elevation => self.source.read_elevation(tile.node, guard.f32_mut(), scratch),
            Layer::Color => self.source.read_color(tile.node, guard.bytes_mut(), scratch),
        };
        read.expect("always");
        let key = guard.publish();
        // The top levels stay for ever.
        if sequence == Sequence::NONE {
            self.pools[layer].lock(key.slot);
        }
        Some(Outcome::Resident { key })
    }
}
