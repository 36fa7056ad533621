//! Where tiles come from, as they are stored.

use std::future::Future;
use std::sync::Arc;
use terravision_common::database::Tile;
use terravision_common::outcome::TileFailure;
use terravision_store::{ErrorLog, Payload, Store, StoreStats};

/// A terrain database, wherever it is. It alone decides when a request is made again, and when a
/// tile that could not be read is asked for again (docs/retries.md); deadlines and caches are its
/// business, too.
pub trait PayloadSource: Send + Sync + 'static {
    /// A tile as it is stored. The future is dropped when nothing wants the tile any more; that
    /// ends the request, on the wire too.
    fn payload(&self, tile: Tile) -> impl Future<Output = Result<Payload, TileFailure>> + Send;

    /// Why a tile is not to be asked for at this moment; `None` when it may be. Neither blocks nor
    /// asks anybody.
    fn recent_failure(&self, tile: Tile) -> Option<TileFailure>;

    /// The tile's payload came, and cannot be decoded. Any thread may say so.
    fn reject(&self, tile: Tile);

    /// What reading has cost so far.
    fn stats(&self) -> StoreStats {
        StoreStats::default()
    }

    /// What went wrong so far, those failures too that a later request made good; `None` for a
    /// source that keeps no log.
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
