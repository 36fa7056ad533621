//! The source of tiles in their stored form.

use std::future::Future;
use std::sync::Arc;
use terravision_common::database::Tile;
use terravision_common::outcome::TileFailure;
use terravision_store::{ErrorLog, Payload, Store, StoreStats};

/// A terrain database, local or remote. Only the source decides when a request is repeated, and
/// when a tile that could not be read may be requested again (docs/retries.md). It also handles
/// deadlines and caches.
pub trait PayloadSource: Send + Sync + 'static {
    /// Reads a tile in its stored form. The future is dropped when the tile is no longer wanted;
    /// that cancels the request, on the network too.
    fn payload(&self, tile: Tile) -> impl Future<Output = Result<Payload, TileFailure>> + Send;

    /// Why a tile must not be requested at this moment; `None` when it may be. Does not block, and
    /// sends no request.
    fn recent_failure(&self, tile: Tile) -> Option<TileFailure>;

    /// Reports that the tile's payload cannot be decoded. May be called by any thread.
    fn reject(&self, tile: Tile);

    /// Statistics of all reads so far.
    fn stats(&self) -> StoreStats {
        StoreStats::default()
    }

    /// All failures so far, also those after which a repeated request succeeded; `None` for a
    /// source without a log.
    fn errors(&self) -> Option<&ErrorLog> {
        None
    }
}

impl PayloadSource for Arc<Store> {
    async fn payload(&self, tile: Tile) -> Result<Payload, TileFailure> {
        self.fetch(tile).await.map_err(|error| error.failure())
    }

    fn recent_failure(&self, tile: Tile) -> Option<TileFailure> {
        Store::recent_failure(self, tile)
    }

    fn reject(&self, tile: Tile) {
        Store::reject(self, tile);
    }

    fn stats(&self) -> StoreStats {
        Store::stats(self)
    }

    fn errors(&self) -> Option<&ErrorLog> {
        Some(Store::errors(self))
    }
}
