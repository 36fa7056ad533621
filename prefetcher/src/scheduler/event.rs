//! What the scheduler tells of its work.

use bytemuck::Zeroable;
use terravision_common::database::Tile;
use terravision_common::event::{Event, EventKind, SpanName};
use terravision_common::outcome::{TileFailure, layer_number};

/// Requests are shown on tracks of their own in a trace, from this number on.
const FIRST_TRACK: u32 = 1000;
/// Tracks that requests are spread over.
const TRACKS: u64 = 64;

/// What the launcher is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TileEvent {
    /// A request was answered.
    Fetched {
        /// The tile.
        tile: Tile,
        /// The frame that was the newest when it was made.
        frame: u64,
        /// When it was made, nanoseconds of the monotonic clock.
        start_nanos: u64,
        /// How long it took.
        duration_nanos: u64,
    },
    /// A tile was decoded, or could not be.
    Decoded {
        /// The tile.
        tile: Tile,
        /// The frame that was the newest when it was asked for.
        frame: u64,
        /// The thread, from 1.
        thread: u32,
        /// When it began, nanoseconds of the monotonic clock.
        start_nanos: u64,
        /// How long it took.
        duration_nanos: u64,
    },
    /// A tile that a frame wants, or one of the top levels, was found to be unavailable; told once for each tile.
    Unavailable {
        /// The tile.
        tile: Tile,
        /// The frame that was the newest when it was asked for.
        frame: u64,
        /// Why.
        failure: TileFailure,
        /// When, nanoseconds of the monotonic clock.
        at_nanos: u64,
    },
    /// A tile that was unavailable came after all.
    Came {
        /// The tile.
        tile: Tile,
        /// When, nanoseconds of the monotonic clock.
        at_nanos: u64,
    },
}

impl TileEvent {
    /// As the launcher is told of it.
    #[must_use]
    pub fn to_event(self) -> Event {
        let span = |tile: Tile, frame, thread, start_nanos, duration_nanos, name: SpanName| {
            let (kind, node) = (EventKind::Span as u32, tile.node.pack());
            Event { kind, thread, frame, start_nanos, duration_nanos, value: name as u64, node }
        };
        match self {
            Self::Fetched { tile, frame, start_nanos, duration_nanos } => {
                let track = FIRST_TRACK + (start_nanos / 1000 % TRACKS) as u32;
                span(tile, frame, track, start_nanos, duration_nanos, SpanName::FetchTile)
            }
            Self::Decoded { tile, frame, thread, start_nanos, duration_nanos } => {
                span(tile, frame, thread, start_nanos, duration_nanos, SpanName::LoadTile)
            }
            Self::Unavailable { tile, frame, failure, at_nanos } => Event {
                kind: EventKind::TileUnavailable as u32,
                frame,
                start_nanos: at_nanos,
                value: layer_number(tile.layer) + 256 * u64::from(failure.number()),
                node: tile.node.pack(),
                ..Event::zeroed()
            },
            Self::Came { tile, at_nanos } => Event {
                kind: EventKind::TileCame as u32,
                start_nanos: at_nanos,
                value: layer_number(tile.layer),
                node: tile.node.pack(),
                ..Event::zeroed()
            },
        }
    }
}
