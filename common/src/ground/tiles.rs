//! The tiles that questions are answered from.

use super::cache::{Cached, TileCache};
use crate::database::{Layer, NodeRanges, TileError, TileScratch, TileSource};
use crate::node::NodeId;
use crate::world::World;
use glam::DVec2;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Tiles that are kept at least, where any are.
const LEAST_TILES: usize = 16;

/// The elevation tiles of a world, those in memory that were used last. Threads share it; a tile
/// that none of them has blocks the one that asks for it on storage.
pub struct GroundTiles<'a> {
    source: &'a dyn TileSource,
    pub(super) world: World,
    pub(super) ranges: Option<&'a NodeRanges>,
    cache: Mutex<TileCache>,
    failures: Mutex<Failures>,
}

/// Tiles that could not be read.
#[derive(Debug, Default)]
struct Failures {
    count: u64,
    first: Option<TileError>,
}

/// What a thread keeps from question to question.
#[derive(Debug, Default)]
pub struct GroundScratch {
    tile: TileScratch,
    /// The tile of the last point: points that follow each other are often neighbours.
    pub(super) last: Option<(NodeId, TileAt)>,
    /// Places of a batch, by node.
    pub(super) order: Vec<(u64, u32)>,
}

/// A tile that has been found for a node.
#[derive(Debug, Clone)]
pub(super) struct TileAt {
    /// The node of the tile: the one that was asked for, or one above it.
    pub(super) node: NodeId,
    /// Heights, and planes of validity where the world has them.
    pub(super) values: Arc<[f32]>,
    /// Whether no finer tile exists that could not be read.
    pub(super) is_finest: bool,
}

impl std::fmt::Debug for GroundTiles<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("GroundTiles").field("world", &self.world).finish_non_exhaustive()
    }
}

impl<'a> GroundTiles<'a> {
    /// The tiles of a source, of which as many are kept as fit `most_bytes`: 16 at least, and none
    /// for 0.
    #[must_use]
    pub fn new(source: &'a dyn TileSource, world: &World, most_bytes: usize) -> Self {
        let fit = most_bytes / (size_of::<f32>() * world.elevation_values());
        let capacity = if most_bytes == 0 { 0 } else { fit.max(LEAST_TILES) };
        let cache = Mutex::new(TileCache::new(capacity));
        Self { source, world: *world, ranges: None, cache, failures: Mutex::default() }
    }

    /// With the ranges of height of the same world, which tell which tiles exist, and of most
    /// ground that a line does not meet it.
    #[must_use]
    pub fn bounded(self, ranges: &'a NodeRanges) -> Self {
        Self { ranges: Some(ranges), world: *ranges.world(), ..self }
    }

    /// The geometry of the world.
    #[must_use]
    pub fn world(&self) -> &World {
        &self.world
    }

    /// A height that no ground of `level` or coarser at a foot exceeds; `None` where nothing is
    /// known of it.
    #[must_use]
    pub fn highest_m(&self, foot: DVec2, level: u8) -> Option<f64> {
        let (surface, ranges) = (self.world.surface(), self.ranges?);
        if !surface.holds(foot) {
            return None;
        }
        // Where the finest levels are not there, the ground is that of a coarser one.
        let mut nodes = (level..self.world.levels()).filter_map(|q| surface.node_at(foot, q));
        nodes.find_map(|node| ranges.range(node)).map(|[_, highest]| highest.into())
    }

    /// How many times a tile could not be read since this was last asked, and the first error.
    pub fn take_failures(&self) -> Option<(u64, TileError)> {
        let failures = std::mem::take(&mut *lock(&self.failures));
        failures.first.map(|first| (failures.count, first))
    }

    /// The finest tile at a foot inside the world, of `level` or coarser; `None` where none can be
    /// read.
    pub(super) fn tile_at(&self, foot: DVec2, level: u8, scratch: &mut GroundScratch) -> Option<TileAt> {
        let finest = self.world.surface().node_at(foot, level)?;
        self.tile_of(finest, scratch)
    }

    /// The finest tile of a node or one above it.
    pub(super) fn tile_of(&self, node: NodeId, scratch: &mut GroundScratch) -> Option<TileAt> {
        if let Some((last, tile)) = &scratch.last
            && *last == node
        {
            return Some(tile.clone());
        }
        let mut is_finest = true;
        // A tile that cannot be read is drawn from its parent, so the ground is its parent's too.
        for q in node.q()..self.world.levels() {
            let at = self.world.surface().ancestor(node, q);
            if self.ranges.is_some_and(|ranges| !ranges.has_tile(Layer::Elevation, at)) {
                continue;
            }
            match self.read(at, &mut scratch.tile) {
                Read::Values(values) => {
                    let tile = TileAt { node: at, values, is_finest };
                    scratch.last = Some((node, tile.clone()));
                    return Some(tile);
                }
                Read::NotThere => {}
                Read::Failed => is_finest = false,
            }
        }
        None
    }

    fn read(&self, node: NodeId, scratch: &mut TileScratch) -> Read {
        match lock(&self.cache).get(node) {
            Some(Cached::Values(values)) => return Read::Values(values),
            Some(Cached::Failed(_)) => return Read::Failed,
            None => {}
        }
        let mut values = vec![0f32; self.world.elevation_values()];
        match self.source.read_elevation(node, &mut values, scratch) {
            Ok(()) => {
                let values: Arc<[f32]> = values.into();
                lock(&self.cache).put(node, Cached::Values(Arc::clone(&values)));
                Read::Values(values)
            }
            // A sparse level without a tile here.
            Err(TileError::Missing { .. }) if node.q() < self.world.complete_level() => Read::NotThere,
            Err(error) => {
                tracing::debug!(%error, "a question to the ground met a tile that cannot be read");
                let mut failures = lock(&self.failures);
                failures.count += 1;
                failures.first.get_or_insert(error);
                lock(&self.cache).put(node, Cached::Failed(Instant::now()));
                Read::Failed
            }
        }
    }
}

/// What became of a tile.
enum Read {
    Values(Arc<[f32]>),
    NotThere,
    Failed,
}

/// Locks a mutex, also after a panic of its holder: no code here panics between two writes that
/// belong together.
fn lock<T: ?Sized>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
