//! Where tiles come from, as they are stored.

use bytes::Bytes;
use std::error::Error;
use std::future::Future;
use std::sync::Arc;
use terravision_common::database::Tile;
use terravision_store::{Cause, ErrorLog, Figures, Store};

/// Why a payload cannot be had.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FetchError {
    /// The database has none.
    #[error("the {tile} is missing")]
    Missing {
        /// The tile.
        tile: Tile,
    },
    /// What there is of it is damaged.
    #[error("the {tile} is damaged: {source}")]
    Corrupt {
        /// The tile.
        tile: Tile,
        /// How.
        #[source]
        source: Box<dyn Error + Send + Sync>,
    },
    /// The server refuses it, and will do so again.
    #[error("the {tile} is refused: {source}")]
    Refused {
        /// The tile.
        tile: Tile,
        /// Why.
        #[source]
        source: Box<dyn Error + Send + Sync>,
    },
    /// It is not in the disk cache, and no server is asked.
    #[error("the {tile} is not in the cache")]
    NotCached {
        /// The tile.
        tile: Tile,
    },
    /// It cannot be read, now at least.
    #[error("the {tile} cannot be read: {source}")]
    Unreadable {
        /// The tile.
        tile: Tile,
        /// Why.
        #[source]
        source: Box<dyn Error + Send + Sync>,
    },
}

impl FetchError {
    /// The cause as events and reports give it: 1 missing, 2 corrupt, 3 read error, 4 refused, 5 not in the cache.
    #[must_use]
    pub fn code(&self) -> u8 {
        match self {
            Self::Missing { .. } => 1,
            Self::Corrupt { .. } => 2,
            Self::Unreadable { .. } => 3,
            Self::Refused { .. } => 4,
            Self::NotCached { .. } => 5,
        }
    }
}

/// A terrain database, wherever it is. Retries, deadlines and caches are its own business.
pub trait PayloadSource: Send + Sync + 'static {
    /// A tile as it is stored. The future is dropped when nothing wants the tile any more; that ends the request, on the
    /// wire too.
    fn payload(&self, tile: Tile) -> impl Future<Output = Result<Bytes, FetchError>> + Send;

    /// What reading has cost so far.
    fn figures(&self) -> Figures {
        Figures::default()
    }

    /// What went wrong so far, those failures too that a later request made good; `None` for a source that keeps no log.
    fn errors(&self) -> Option<&ErrorLog> {
        None
    }
}

impl PayloadSource for Arc<Store> {
    async fn payload(&self, tile: Tile) -> Result<Bytes, FetchError> {
        let read = Store::payload(self, tile.layer, tile.node).await;
        read.map_err(|error| match error.cause() {
            None => FetchError::Missing { tile },
            Some(Cause::Damaged) => FetchError::Corrupt { tile, source: error.into() },
            Some(Cause::Offline) => FetchError::NotCached { tile },
            // That the disk fails is nobody's refusal.
            Some(cause) if cause.is_refusal() => FetchError::Refused { tile, source: error.into() },
            Some(_) => FetchError::Unreadable { tile, source: error.into() },
        })
    }

    fn figures(&self) -> Figures {
        Store::figures(self)
    }

    fn errors(&self) -> Option<&ErrorLog> {
        Some(Store::errors(self))
    }
}
