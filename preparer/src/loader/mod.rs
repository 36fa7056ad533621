//! Loading tiles into the pools.
//!
//! What a frame wants is asked of a [`TileLoader`], tile by tile, until each is there or known to be unavailable. The one
//! here, [`local::LocalLoader`], reads a database with threads of this process; another may leave the work to another
//! process. A tile's states, as the frame sees them:
//!
//! ```text
//!             want: a slot is free                  read, decoded
//!   NoRoom ───────────────────────▶ Loading ───────────────────────▶ Resident
//!     ▲  wait: a frame completes      │                                 │
//!     │                               │ missing, corrupt, unreadable    │ a later frame needs the slot
//!   (absent) ◀────────────────────────┼─────────────────────────────────┘
//!                                     ▼
//!                              Unavailable (for the rest of the run)
//! ```

pub mod local;

use crate::frame_tree::Tile;
use crate::truncation::Tiles;
use terravision_common::shm::{Control, WaitError};

/// How a wanted tile stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TileState {
    /// It is in its pool, and stays until the frame that wanted it is completed.
    Resident,
    /// It is on its way.
    Loading,
    /// Every slot of its pool is named by a frame in flight.
    NoRoom,
    /// It cannot be had.
    Unavailable,
}

/// A tile that was loaded, or found to be unavailable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Loaded {
    /// The tile.
    pub tile: Tile,
    /// Why there is none; `None` for a tile that is there.
    pub code: Option<u8>,
    /// The frame that wanted it first.
    pub frame: u64,
    /// The thread that loaded it, from 1.
    pub thread: u32,
    /// When it began, nanoseconds of the monotonic clock.
    pub start_nanos: u64,
    /// How long it took.
    pub duration_nanos: u64,
}

/// Why tiles cannot be waited for.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LoadError {
    /// The run ended.
    #[error(transparent)]
    Wait(#[from] WaitError),
    /// A thread of the loader has died.
    #[error("a thread that loads tiles has died; this is a bug in the decoder of a tile")]
    ThreadDied,
    /// Threads cannot be started.
    #[error("cannot start a thread that loads tiles: {source}")]
    Thread {
        /// Why.
        #[source]
        source: std::io::Error,
    },
}

/// Brings tiles into the pools. Used by the preparer's one thread.
pub trait TileLoader: Tiles {
    /// Frame `frame`, the `sequence`-th of the run, wants a tile: begins to load it when it is absent, and keeps it.
    /// Does not block.
    fn want(&mut self, tile: Tile, frame: u64, sequence: u64, control: &Control) -> TileState;

    /// Waits until a tile that is being loaded has come or failed, or a moment has passed.
    ///
    /// # Errors
    /// [`LoadError`].
    fn wait(&mut self, control: &Control) -> Result<(), LoadError>;

    /// Keeps a resident tile for ever.
    fn lock(&mut self, tile: Tile);

    /// Gives each load that ended since the last call to `tell`.
    fn drain(&mut self, tell: impl FnMut(&Loaded));

    /// Number of tiles that are being loaded.
    fn in_flight(&self) -> usize;

    /// Slots of the pool of a layer.
    fn capacity(&self, layer: terravision_common::database::Layer) -> u32;
}
