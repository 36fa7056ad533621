//! The loader of a database on this machine: threads that read and decode tiles into pool slots.

use super::{LoadError, Loaded, TileLoader, TileState};
use crate::frame_tree::Tile;
use crate::truncation::Tiles;
use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use terravision_common::database::{Layer, TileScratch, TileSource};
use terravision_common::event::monotonic_nanos;
use terravision_common::node::NodeId;
use terravision_common::shm::{Control, Counter, FillGuard, PoolWriter, Residency, WAIT_BOUND};

/// One tile to load, and the slot to load it into.
struct Job {
    tile: Tile,
    frame: u64,
    guard: FillGuard,
}

struct Queue {
    jobs: VecDeque<Job>,
    done: Vec<Loaded>,
    is_closed: bool,
}

struct Shared {
    queue: Mutex<Queue>,
    /// There are jobs, or the queue is closed.
    work: Condvar,
    /// A job is done.
    done: Condvar,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Queue> {
        // Nothing panics while it holds the lock; if it did, the lists are still lists.
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Loads tiles from a [`TileSource`] with threads of its own. Dropped, it lets the threads finish their tile and joins
/// them. After it was made it allocates nothing but for tiles that fail.
pub struct LocalLoader {
    elevation: PoolWriter,
    color: PoolWriter,
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
    /// Copies of what the threads have done, to tell without the lock.
    done: Vec<Loaded>,
    unavailable: HashMap<Tile, u8>,
    in_flight: usize,
    /// Slots filled so far, by layer: past the pool's capacity each fill evicts.
    filled: [u64; 2],
}

impl std::fmt::Debug for LocalLoader {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LocalLoader")
            .field("threads", &self.threads.len())
            .field("in_flight", &self.in_flight)
            .field("unavailable", &self.unavailable.len())
            .finish_non_exhaustive()
    }
}

impl LocalLoader {
    /// A loader with `threads` threads (at least one) that fills these pools.
    ///
    /// # Errors
    /// [`LoadError::Thread`].
    pub fn new(
        source: Arc<dyn TileSource>,
        elevation: PoolWriter,
        color: PoolWriter,
        threads: u32,
    ) -> Result<Self, LoadError> {
        let slots = (elevation.capacity() + color.capacity()) as usize;
        let queue = Queue { jobs: VecDeque::with_capacity(slots), done: Vec::with_capacity(slots), is_closed: false };
        let shared = Arc::new(Shared { queue: Mutex::new(queue), work: Condvar::new(), done: Condvar::new() });
        let mut loader = Self {
            elevation,
            color,
            shared,
            threads: Vec::new(),
            done: Vec::with_capacity(slots),
            unavailable: HashMap::new(),
            in_flight: 0,
            filled: [0; 2],
        };
        for thread in 1..=threads.max(1) {
            let (shared, source) = (Arc::clone(&loader.shared), Arc::clone(&source));
            let work = move || load_tiles(&shared, &*source, thread);
            let handle = std::thread::Builder::new().name(format!("loader-{thread}")).spawn(work);
            // Those that were started end with the loader.
            loader.threads.push(handle.map_err(|source| LoadError::Thread { source })?);
        }
        Ok(loader)
    }

    fn pool(&self, layer: Layer) -> &PoolWriter {
        match layer {
            Layer::Elevation => &self.elevation,
            Layer::Color => &self.color,
        }
    }

    fn begin(&mut self, tile: Tile, frame: u64, sequence: u64, control: &Control) -> TileState {
        let pool = match tile.layer {
            Layer::Elevation => &mut self.elevation,
            Layer::Color => &mut self.color,
        };
        let Some(guard) = pool.allocate(tile.node, sequence, control.completed_sequence()) else {
            return TileState::NoRoom;
        };
        let filled = &mut self.filled[tile.layer as usize];
        *filled += 1;
        if *filled > u64::from(pool.capacity()) {
            control.count(Counter::TilesEvicted, 1);
        }
        self.in_flight += 1;
        self.shared.lock().jobs.push_back(Job { tile, frame, guard });
        self.shared.work.notify_one();
        TileState::Loading
    }
}

impl Tiles for LocalLoader {
    fn color(&self, node: NodeId) -> Option<(u32, u32)> {
        self.color.find(node)
    }

    fn elevation(&self, node: NodeId) -> Option<&[f32]> {
        let (slot, generation) = self.elevation.find(node)?;
        self.elevation.bytes(slot, generation).map(|bytes| bytes.f32())
    }
}

impl TileLoader for LocalLoader {
    fn want(&mut self, tile: Tile, frame: u64, sequence: u64, control: &Control) -> TileState {
        match self.pool(tile.layer).touch_node(tile.node, sequence) {
            Residency::Resident { .. } => TileState::Resident,
            Residency::Filling => TileState::Loading,
            Residency::Absent if self.unavailable.contains_key(&tile) => TileState::Unavailable,
            Residency::Absent => self.begin(tile, frame, sequence, control),
        }
    }

    fn wait(&mut self, control: &Control) -> Result<(), LoadError> {
        control.check_running()?;
        let queue = self.shared.lock();
        if queue.done.is_empty() {
            let waited = self.shared.done.wait_timeout(queue, WAIT_BOUND);
            let (queue, timeout) = waited.unwrap_or_else(PoisonError::into_inner);
            drop(queue);
            if timeout.timed_out() {
                if self.threads.iter().any(JoinHandle::is_finished) {
                    return Err(LoadError::ThreadDied);
                }
                if !control.is_launcher_alive() {
                    return Err(terravision_common::shm::WaitError::LauncherGone.into());
                }
            }
        }
        Ok(())
    }

    fn lock(&mut self, tile: Tile) {
        let pool = self.pool(tile.layer);
        if let Some((slot, _)) = pool.find(tile.node) {
            pool.lock(slot);
        }
    }

    fn drain(&mut self, mut tell: impl FnMut(&Loaded)) {
        std::mem::swap(&mut self.done, &mut self.shared.lock().done);
        for loaded in self.done.drain(..) {
            self.in_flight -= 1;
            // Between its failure and this place a tile may have been asked for, and have failed, again.
            let is_news = loaded.code.is_none_or(|code| self.unavailable.insert(loaded.tile, code).is_none());
            if is_news {
                tell(&loaded);
            }
        }
    }

    fn in_flight(&self) -> usize {
        self.in_flight
    }

    fn capacity(&self, layer: Layer) -> u32 {
        self.pool(layer).capacity()
    }
}

impl Drop for LocalLoader {
    fn drop(&mut self) {
        let jobs = {
            let mut queue = self.shared.lock();
            queue.is_closed = true;
            std::mem::take(&mut queue.jobs)
        };
        self.shared.work.notify_all();
        drop(jobs);
        for thread in self.threads.drain(..) {
            // A thread that panicked has said so on standard error.
            drop(thread.join());
        }
    }
}

/// What a thread does: tile after tile, until the queue is closed.
fn load_tiles(shared: &Shared, source: &dyn TileSource, thread: u32) {
    let mut scratch = TileScratch::default();
    loop {
        let job = {
            let mut queue = shared.lock();
            loop {
                if queue.is_closed {
                    return;
                }
                if let Some(job) = queue.jobs.pop_front() {
                    break job;
                }
                queue = shared.work.wait(queue).unwrap_or_else(PoisonError::into_inner);
            }
        };
        let Job { tile, frame, mut guard } = job;
        let start_nanos = monotonic_nanos();
        let read = match tile.layer {
            Layer::Elevation => source.read_elevation(tile.node, guard.f32_mut(), &mut scratch),
            Layer::Color => source.read_color(tile.node, guard.bytes_mut(), &mut scratch),
        };
        let code = match read {
            Ok(()) => {
                guard.publish();
                None
            }
            Err(error) => {
                drop(guard);
                Some(error.code())
            }
        };
        let duration_nanos = monotonic_nanos().saturating_sub(start_nanos);
        shared.lock().done.push(Loaded { tile, code, frame, thread, start_nanos, duration_nanos });
        shared.done.notify_one();
    }
}
