//! Elevation tiles that light is made of, as they are stored. They are kept for the tiles beside,
//! apart from the pool: they are finer than those that are drawn, and nothing waits for them.

use crate::source::PayloadSource;
use std::collections::HashMap;
use std::pin::pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, Wake, Waker};
use std::thread::Thread;
use terravision_common::database::{Layer, Tile, TileScratch, decode_elevation_planes};
use terravision_common::node::NodeId;
use terravision_common::traversal::HeightRanges;
use terravision_common::world::World;

/// Bytes of tiles that are kept.
pub const MOST_KEPT_BYTES: usize = 64 << 20;

/// Elevation tiles. Calls block on storage.
pub trait Elevations: Send + Sync {
    /// Heights of a node's posts, metres, row 0 in the south; `None` without a tile that can be
    /// read.
    fn posts(&self, node: NodeId) -> Option<Arc<[f32]>>;
}

/// Tiles of the last while: those that are used stay.
#[derive(Debug, Default)]
struct Kept {
    recent: HashMap<NodeId, Option<Arc<[f32]>>>,
    older: HashMap<NodeId, Option<Arc<[f32]>>>,
}

impl Kept {
    fn find(&mut self, node: NodeId) -> Option<Option<Arc<[f32]>>> {
        if let Some(found) = self.recent.get(&node) {
            return Some(found.clone());
        }
        let found = self.older.remove(&node)?;
        self.recent.insert(node, found.clone());
        Some(found)
    }

    fn keep(&mut self, node: NodeId, tile: Option<Arc<[f32]>>, most: usize) {
        if self.recent.len() >= most / 2 {
            self.older = std::mem::take(&mut self.recent);
        }
        self.recent.insert(node, tile);
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Nothing panics while it holds a lock; if it did, what is kept are still tiles.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

struct Unpark(Thread);

impl Wake for Unpark {
    fn wake(self: Arc<Self>) {
        self.0.unpark();
    }
}

/// Drives a future on this thread. It is not within an async runtime: a store then reads local
/// files at once, in place of handing each to another thread.
fn wait_for<T>(future: impl Future<Output = T>) -> T {
    let waker = Waker::from(Arc::new(Unpark(std::thread::current())));
    let mut future = pin!(future);
    loop {
        if let Poll::Ready(done) = future.as_mut().poll(&mut Context::from_waker(&waker)) {
            return done;
        }
        std::thread::park();
    }
}

/// Elevation tiles out of a source of payloads.
pub struct StoredElevations<S, R> {
    source: Arc<S>,
    ranges: R,
    world: World,
    kept: Mutex<Kept>,
    /// Buffers that no thread uses at the moment.
    scratch: Mutex<Vec<TileScratch>>,
    most_kept: usize,
}

impl<S, R> std::fmt::Debug for StoredElevations<S, R> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("StoredElevations").field("most_kept", &self.most_kept).finish_non_exhaustive()
    }
}

impl<S: PayloadSource, R: HeightRanges> StoredElevations<S, R> {
    /// Tiles of `source`. `ranges` knows which tiles there are.
    pub fn new(source: Arc<S>, ranges: R, world: &World) -> Self {
        let tile_bytes = world.elevation_posts().pow(2) as usize * size_of::<f32>();
        let most_kept = (MOST_KEPT_BYTES / tile_bytes).max(16);
        Self { source, ranges, world: *world, kept: Mutex::default(), scratch: Mutex::default(), most_kept }
    }

    fn is_stored(&self, node: NodeId) -> bool {
        self.world.has_elevation(node)
            && (node.q() >= self.world.complete_level() || self.ranges.has_children(Layer::Elevation, node.parent()))
    }

    fn read(&self, node: NodeId) -> Option<Arc<[f32]>> {
        let payload = wait_for(self.source.payload(Tile { layer: Layer::Elevation, node })).ok()?;
        let mut heights = vec![0.0; self.world.elevation_values()];
        let mut scratch = lock(&self.scratch).pop().unwrap_or_default();
        let decoded = decode_elevation_planes(&self.world, &payload.bytes, &mut heights, &mut scratch);
        lock(&self.scratch).push(scratch);
        decoded.ok()?;
        heights.truncate(self.world.elevation_posts().pow(2) as usize);
        Some(heights.into())
    }
}

impl<S: PayloadSource, R: HeightRanges + Send + Sync> Elevations for StoredElevations<S, R> {
    fn posts(&self, node: NodeId) -> Option<Arc<[f32]>> {
        if !self.is_stored(node) {
            return None;
        }
        if let Some(found) = lock(&self.kept).find(node) {
            return found;
        }
        // Two threads may read the same tile; both get the same.
        let tile = self.read(node);
        lock(&self.kept).keep(node, tile.clone(), self.most_kept);
        tile
    }
}
