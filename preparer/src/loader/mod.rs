//! Tiles, as the preparer asks for them.
//!
//! What a frame wants is asked of a [`TileLoader`], tile by tile; what is not there is asked of the prefetcher, all of a
//! frame together. [`wanted::WantedTiles`] is the loader of a run; tests have others. A tile's states, as the frame sees
//! them:
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

/// How a wanted tile stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TileState {
    /// It is in its pool, and stays until the frame that wanted it is completed.
    Resident,
    /// It is on its way, or about to be asked for.
    Loading,
    /// Every slot of its pool is named by a frame in flight.
    NoRoom,
    /// It cannot be read.
    Unavailable {
        /// Whether the next try may have it ([`terravision_common::outcome::TileFailure::may_pass`]).
        may_come: bool,
    },
}

/// Has tiles brought into the pools. Used by the preparer's one thread.
pub trait TileLoader: Tiles {
    /// Frame `frame`, at place `sequence` of the run, wants a tile: keeps it when it is there, and remembers to ask for it
    /// when it is not. Does not block.
    fn want(&mut self, tile: Tile, frame: FrameNumber, sequence: Sequence, control: &Control) -> TileState;

    /// All tiles of the frame have been wanted: asks for those that are not there. Does not block.
    fn ask(&mut self, frame: FrameNumber, sequence: Sequence);

    /// Waits until a tile that was asked for has come or failed, or a moment has passed.
    ///
    /// # Errors
    /// The run ended.
    fn wait(&mut self, control: &Control) -> Result<(), WaitError>;

    /// Takes in what became of tiles that were asked for, before they are wanted again.
    ///
    /// # Errors
    /// The run ended.
    fn drain(&mut self) -> Result<(), WaitError>;

    /// Number of tiles that the frame has found to be loading since the last [`TileLoader::drain`].
    fn in_flight(&self) -> usize;

    /// Slots of the pool of a layer.
    fn capacity(&self, layer: terravision_common::database::Layer) -> u32;

    /// The run's frames are all prepared: nothing will be wanted any more.
    fn close(&mut self);
}
