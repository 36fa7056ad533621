//! Where tiles come from, as they are stored.

use bytes::Bytes;
use std::error::Error;
use std::future::Future;
use std::sync::Arc;
use terravision_common::database::{Database, Tile, TileError};

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
    /// The cause as events and reports give it: 1 missing, 2 corrupt, 3 read error.
    #[must_use]
    pub fn code(&self) -> u8 {
        match self {
            Self::Missing { .. } => 1,
            Self::Corrupt { .. } => 2,
            Self::Unreadable { .. } => 3,
        }
    }
}

/// A terrain database, wherever it is. Retries, deadlines and caches are its own business.
pub trait PayloadSource: Send + Sync + 'static {
    /// A tile as it is stored. The future is dropped when nothing wants the tile any more; that ends the request, on the
    /// wire too.
    fn payload(&self, tile: Tile) -> impl Future<Output = Result<Bytes, FetchError>> + Send;
}

/// A database in a folder of this machine.
#[derive(Debug, Clone)]
pub struct LocalSource {
    database: Arc<Database>,
}

impl LocalSource {
    /// Reads from `database`.
    #[must_use]
    pub fn new(database: Arc<Database>) -> Self {
        Self { database }
    }
}

impl PayloadSource for LocalSource {
    async fn payload(&self, tile: Tile) -> Result<Bytes, FetchError> {
        let database = Arc::clone(&self.database);
        // A disk that is slow, or a network folder, must not hold up the other requests.
        let read = tokio::task::spawn_blocking(move || {
            let mut payload = Vec::new();
            database.payload(tile.layer, tile.node, &mut payload).map(|_| ())?;
            Ok(Bytes::from(payload))
        });
        match read.await {
            Ok(result) => result.map_err(|error: TileError| match error {
                TileError::Missing { .. } => FetchError::Missing { tile },
                error @ TileError::Corrupt { .. } => FetchError::Corrupt { tile, source: error.into() },
                error => FetchError::Unreadable { tile, source: error.into() },
            }),
            Err(ended) => Err(FetchError::Unreadable { tile, source: ended.into() }),
        }
    }
}
