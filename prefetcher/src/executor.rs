//! Requests run on an async runtime; dedicated threads decode tiles directly into pool slots.

use crate::light::elevations::{Elevations, StoredElevations};
use crate::light::{LightScratch, Lighting};
use crate::source::PayloadSource;
use bytes::Bytes;
use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;
use terravision_common::bug::contained;
use terravision_common::database::{
    Layer, Tile, TileScratch, color_tile_bytes, decode_color_picture, decode_elevation_planes, make_color_mips,
};
use terravision_common::event::monotonic_nanos;
use terravision_common::ids::SlotKey;
use terravision_common::node::NodeId;
use terravision_common::outcome::TileFailure;
use terravision_common::shm::{FillGuard, WantBell};
use terravision_common::texels::{TexelFormat, compress_tile};
use terravision_common::threads::ensure;
use terravision_common::traversal::HeightRanges;
use terravision_common::world::World;
use tokio::runtime::Runtime;
use tokio::task::AbortHandle;

/// Threads for requests, which mostly wait.
const REQUEST_THREADS: usize = 2;
/// Threads for blocking reads of files.
const FILE_THREADS: usize = 8;
/// How long to wait for requests that do not end with the run.
const PATIENCE_AT_END: Duration = Duration::from_millis(200);

/// A payload to be decoded, and its slot.
#[derive(Debug)]
pub struct DecodeJob {
    /// The tile.
    pub tile: Tile,
    /// As it is stored.
    pub payload: Bytes,
    /// Its slot.
    pub guard: FillGuard,
}

/// Work that has ended.
#[derive(Debug)]
pub enum Ended {
    /// A request.
    Fetched {
        /// Which.
        ticket: u64,
        /// The payload, or why the request failed.
        result: Result<Bytes, TileFailure>,
        /// When the answered request was made, if the source repeated the request.
        resent_at_nanos: Option<u64>,
        /// When, nanoseconds of the monotonic clock.
        at_nanos: u64,
    },
    /// A decoding.
    Decoded {
        /// The tile.
        tile: Tile,
        /// Its slot, or why decoding failed.
        result: Result<SlotKey, TileFailure>,
        /// The thread, from 1.
        thread: u32,
        /// When it began, nanoseconds of the monotonic clock.
        start_nanos: u64,
        /// How long it took.
        duration_nanos: u64,
    },
}

/// Carries out the decisions of the scheduler. No method blocks.
pub trait Executor {
    /// Begins a request.
    fn fetch(&mut self, ticket: u64, tile: Tile);
    /// Cancels a request, which may have ended already.
    fn cancel(&mut self, ticket: u64);
    /// Begins to decode a payload.
    fn decode(&mut self, job: DecodeJob);
    /// Takes out the work that has ended since the last call.
    fn drain(&mut self, ended: &mut Vec<Ended>);
    /// Why a tile must not be requested at this moment ([`PayloadSource::recent_failure`]).
    fn recent_failure(&self, tile: Tile) -> Option<TileFailure>;
}

/// Buffers of a decoding thread.
#[derive(Debug, Default)]
pub struct DecodeScratch {
    tile: TileScratch,
    /// A colour tile before it is compressed.
    texels: Vec<u8>,
    light: LightScratch,
}

/// What lights colour tiles, and out of which elevation tiles.
struct Lit<'a> {
    lighting: &'a Lighting,
    tiles: &'a dyn Elevations,
}

/// Decodes a tile into its slot and publishes it. Colours are lit, if they are to be, and converted
/// to the format of the pool.
///
/// # Errors
/// The payload is damaged.
fn decode(
    world: &World,
    texels: TexelFormat,
    lit: Option<&Lit<'_>>,
    job: DecodeJob,
    scratch: &mut DecodeScratch,
) -> Result<SlotKey, TileFailure> {
    let DecodeJob { tile, payload, mut guard } = job;
    let is_decoded = match tile.layer {
        Layer::Elevation => {
            guard.f32_mut().len() >= world.elevation_values()
                && decode_elevation_planes(world, &payload, guard.f32_mut(), &mut scratch.tile).is_ok()
        }
        Layer::Color => {
            let side = world.color_stored();
            let DecodeScratch { texels: plain, light, .. } = scratch;
            guard.bytes_mut().len() as u64 >= texels.tile_bytes(side)
                && if texels.is_compressed() {
                    plain.resize(color_tile_bytes(world), 0);
                    let is_decoded = decode_color(&payload, side, tile.node, lit, plain, light);
                    if is_decoded {
                        compress_tile(plain, side, guard.bytes_mut());
                    }
                    is_decoded
                } else {
                    decode_color(&payload, side, tile.node, lit, guard.bytes_mut(), light)
                }
        }
    };
    if is_decoded { Ok(guard.publish()) } else { Err(TileFailure::Damaged) }
}

/// Decodes a colour tile, `side` texels wide, with its mip levels, and lights it.
fn decode_color(
    payload: &[u8],
    side: u32,
    node: NodeId,
    lit: Option<&Lit<'_>>,
    out: &mut [u8],
    scratch: &mut LightScratch,
) -> bool {
    if decode_color_picture(payload, side, out).is_err() {
        return false;
    }
    if let Some(Lit { lighting, tiles }) = lit {
        lighting.light(node, out, *tiles, scratch);
    }
    make_color_mips(out, side);
    true
}

#[derive(Default)]
struct Queue {
    jobs: VecDeque<DecodeJob>,
    is_closed: bool,
}

struct Shared {
    queue: Mutex<Queue>,
    /// Signals that there are jobs, or that the queue is closed.
    work: Condvar,
    ended: Mutex<Vec<Ended>>,
    bell: WantBell,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Nothing panics while it holds a lock; if it did, the lists are still lists.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shared {
    fn end(&self, ended: Ended) {
        lock(&self.ended).push(ended);
        self.bell.ring();
    }
}

/// The executor cannot be set up.
#[derive(Debug, thiserror::Error)]
#[error("cannot start the threads that load tiles: {source}")]
pub struct ExecutorError {
    /// Why.
    #[from]
    source: std::io::Error,
}

/// The executor of a run. When dropped, it cancels all requests, lets the threads finish their
/// current tile, and joins them.
pub struct Workers<S> {
    source: Arc<S>,
    runtime: Option<Runtime>,
    requests: HashMap<u64, AbortHandle>,
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

impl<S> std::fmt::Debug for Workers<S> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Workers")
            .field("requests", &self.requests.len())
            .field("threads", &self.threads.len())
            .finish_non_exhaustive()
    }
}

impl<S: PayloadSource> Workers<S> {
    /// Starts `threads` threads (at least one) that decode tiles of `world`, with colours in the
    /// format `texels`, lit by `lighting`. `ranges` knows which tiles there are. They ring `bell`
    /// when work has ended.
    ///
    /// # Errors
    /// [`ExecutorError`].
    pub fn new(
        source: S,
        (world, ranges): (&World, impl HeightRanges + Send + Sync + 'static),
        texels: TexelFormat,
        lighting: Option<Lighting>,
        threads: u32,
        bell: WantBell,
    ) -> Result<Self, ExecutorError> {
        // Without threads the runtime panics.
        ensure(REQUEST_THREADS + FILE_THREADS + threads.max(1) as usize)?;
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(REQUEST_THREADS)
            .max_blocking_threads(FILE_THREADS)
            .thread_name("requests")
            .enable_all()
            .build()?;
        let shared = Arc::new(Shared { queue: Mutex::default(), work: Condvar::new(), ended: Mutex::default(), bell });
        let mut workers = Self {
            source: Arc::new(source),
            runtime: Some(runtime),
            requests: HashMap::new(),
            shared,
            threads: Vec::new(),
        };
        let lighting = lighting.map(|lighting| {
            let tiles = StoredElevations::new(Arc::clone(&workers.source), ranges, world);
            (lighting, Arc::new(tiles))
        });
        for thread in 1..=threads.max(1) {
            let (source, shared, world) = (Arc::clone(&workers.source), Arc::clone(&workers.shared), *world);
            let lighting = lighting.clone();
            let work = move || {
                let lit = lighting.as_ref().map(|(lighting, tiles)| Lit { lighting, tiles: &**tiles });
                decode_tiles(&*source, &shared, &world, texels, lit.as_ref(), thread);
            };
            workers.threads.push(std::thread::Builder::new().name(format!("decoder-{thread}")).spawn(work)?);
        }
        Ok(workers)
    }
}

impl<S> Workers<S> {
    /// Whether all threads are alive: a thread that panicked has printed a message on standard
    /// error.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        !self.threads.iter().any(JoinHandle::is_finished)
    }

    /// The source of payloads.
    #[must_use]
    pub fn source(&self) -> &S {
        &self.source
    }

    /// A function that tells whether ended work waits to be drained.
    pub fn has_ended(&self) -> impl Fn() -> bool + use<S> {
        let shared = Arc::clone(&self.shared);
        move || !lock(&shared.ended).is_empty()
    }
}

impl<S: PayloadSource> Executor for Workers<S> {
    fn fetch(&mut self, ticket: u64, tile: Tile) {
        let Some(runtime) = &self.runtime else { return };
        let (source, shared) = (Arc::clone(&self.source), Arc::clone(&self.shared));
        let request = runtime.spawn(async move {
            let read = source.payload(tile).await;
            let at_nanos = monotonic_nanos();
            let resent_at = read.as_ref().ok().and_then(|payload| payload.resent_at);
            let resent_at_nanos = resent_at.map(|at| at_nanos.saturating_sub(at.elapsed().as_nanos() as u64));
            let result = read.map(|payload| payload.bytes);
            shared.end(Ended::Fetched { ticket, result, resent_at_nanos, at_nanos });
        });
        self.requests.insert(ticket, request.abort_handle());
    }

    fn cancel(&mut self, ticket: u64) {
        if let Some(request) = self.requests.remove(&ticket) {
            request.abort();
        }
    }

    fn decode(&mut self, job: DecodeJob) {
        lock(&self.shared.queue).jobs.push_back(job);
        self.shared.work.notify_one();
    }

    fn drain(&mut self, ended: &mut Vec<Ended>) {
        ended.append(&mut lock(&self.shared.ended));
        for ended in ended.iter() {
            if let Ended::Fetched { ticket, .. } = ended {
                self.requests.remove(ticket);
            }
        }
    }

    fn recent_failure(&self, tile: Tile) -> Option<TileFailure> {
        self.source.recent_failure(tile)
    }
}

impl<S> Drop for Workers<S> {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_timeout(PATIENCE_AT_END);
        }
        let jobs = {
            let mut queue = lock(&self.shared.queue);
            queue.is_closed = true;
            std::mem::take(&mut queue.jobs)
        };
        self.shared.work.notify_all();
        drop(jobs);
        for thread in self.threads.drain(..) {
            drop(thread.join());
        }
    }
}

/// The loop of a decoding thread, until the queue is closed.
fn decode_tiles(
    source: &impl PayloadSource,
    shared: &Shared,
    world: &World,
    texels: TexelFormat,
    lit: Option<&Lit<'_>>,
    thread: u32,
) {
    let mut scratch = DecodeScratch::default();
    loop {
        let job = {
            let mut queue = lock(&shared.queue);
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
        let tile = job.tile;
        let start_nanos = monotonic_nanos();
        // If a decoder panics on foreign bytes, only its tile is lost, not the flight.
        let result = contained(|| decode(world, texels, lit, job, &mut scratch)).unwrap_or_else(|_panic| {
            scratch = DecodeScratch::default();
            Err(TileFailure::Damaged)
        });
        if result.is_err() {
            // Before the failure is reported: the scheduler must not request the tile again at
            // once.
            source.reject(tile);
        }
        let duration_nanos = monotonic_nanos().saturating_sub(start_nanos);
        shared.end(Ended::Decoded { tile, result, thread, start_nanos, duration_nanos });
    }
}
