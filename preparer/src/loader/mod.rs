//! How the preparer asks for tiles.
//!
//! The preparer asks a [`TileLoader`] for each tile that a frame wants; the loader then asks the
//! prefetcher for all missing tiles of the frame at once. [`wanted::WantedTiles`] is the loader of
//! a run; tests have others. The states of a tile, as the frame sees them:
//!
//! ```text
//!               asked, in flight, undecoded
//!   (absent) ──────────▶ Loading ──────────────────▶ Resident
//!     ▲  ▲                │  │  outcome: resident        │
//!     │  └── NoRoom ◀─────┘  │ outcome: unavailable      │ no later frame wants it, another tile needs the slot
//!     │   until a frame      ▼                           │
//!     │   completes     Unavailable (the store may try   │
//!     │                 again, and the prefetcher tell)  │
//!     └──────────────────────────────────────────────────┘
//! ```

pub mod wanted;

use crate::frame_tree::Tile;
use crate::truncation::Tiles;
use terravision_common::ids::{FrameNumber, Sequence};
use terravision_common::shm::{Control, WaitError};

/// The state of a wanted tile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TileState {
    /// It is in its pool, and stays there until the frame that wanted it is completed.
    Resident,
    /// It has been requested, or is about to be.
    Loading,
    /// Every slot of its pool is used by a frame in flight.
    NoRoom,
    /// It cannot be read.
    Unavailable {
        /// Whether the next attempt may succeed
        /// ([`terravision_common::outcome::TileFailure::may_pass`]).
        may_come: bool,
    },
}

/// Asks for tiles to be brought into the pools. Used by the preparer's only thread.
pub trait TileLoader: Tiles {
    /// Frame `frame`, at place `sequence` of the run, wants a tile: pins it if it is resident,
    /// otherwise notes that it is to be asked for. Does not block.
    fn want(&mut self, tile: Tile, frame: FrameNumber, sequence: Sequence, control: &Control) -> TileState;

    /// Asks for all missing tiles, after [`TileLoader::want`] has been called for all tiles of the
    /// frame. Does not block.
    fn ask(&mut self, frame: FrameNumber, sequence: Sequence);

    /// Waits until a requested tile has arrived or failed, or a short time has passed.
    ///
    /// # Errors
    /// The run ended.
    fn wait(&mut self, control: &Control) -> Result<(), WaitError>;

    /// Takes the outcomes of requested tiles, before they are wanted again.
    ///
    /// # Errors
    /// The run ended.
    fn drain(&mut self) -> Result<(), WaitError>;

    /// Number of tiles that the frame found to be loading since the last [`TileLoader::drain`].
    fn in_flight(&self) -> usize;

    /// Slots of the pool of a layer.
    fn capacity(&self, layer: terravision_common::database::Layer) -> u32;

    /// All frames of the run are prepared: no more tiles will be wanted.
    fn close(&mut self);
}
