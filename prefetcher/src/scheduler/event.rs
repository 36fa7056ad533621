//! Events of the scheduler.

use terravision_common::database::Tile;
use terravision_common::event::{Event, EventContent, SpanName};
use terravision_common::ids::FrameNumber;
use terravision_common::outcome::TileFailure;

/// In a trace, tracks from this number on show requests.
const FIRST_TRACK: u32 = 1000;
/// Number of tracks for requests.
const TRACKS: u64 = 64;

/// An event for the launcher.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TileEvent {
    /// A request was answered.
    Fetched {
        /// The tile.
        tile: Tile,
        /// The frame that was the newest when it was made.
        frame: FrameNumber,
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
        frame: FrameNumber,
        /// The thread, from 1.
        thread: u32,
        /// When it began, nanoseconds of the monotonic clock.
        start_nanos: u64,
        /// How long it took.
        duration_nanos: u64,
    },
    /// A tile that a frame wants, or one of the top levels, is unavailable; reported once for each
    /// tile.
    Unavailable {
        /// The tile.
        tile: Tile,
        /// The frame that was the newest when it was asked for.
        frame: FrameNumber,
        /// Why.
        failure: TileFailure,
        /// When, nanoseconds of the monotonic clock.
        at_nanos: u64,
    },
    /// A tile that had been unavailable has arrived.
    Came {
        /// The tile.
        tile: Tile,
        /// When, nanoseconds of the monotonic clock.
        at_nanos: u64,
    },
}

impl TileEvent {
    /// The event as it is sent to the launcher.
    #[must_use]
    pub fn to_event(self) -> Event {
        let span = |name, tile: Tile, frame: FrameNumber, start_nanos, duration_nanos| {
            let span = Event::new(EventContent::Span { name, node: Some(tile.node) });
            span.of_frame(frame).at(start_nanos).lasting(duration_nanos)
        };
        match self {
            Self::Fetched { tile, frame, start_nanos, duration_nanos } => {
                let track = FIRST_TRACK + (start_nanos / 1000 % TRACKS) as u32;
                span(SpanName::FetchTile, tile, frame, start_nanos, duration_nanos).on_thread(track)
            }
            Self::Decoded { tile, frame, thread, start_nanos, duration_nanos } => {
                span(SpanName::LoadTile, tile, frame, start_nanos, duration_nanos).on_thread(thread)
            }
            Self::Unavailable { tile, frame, failure, at_nanos } => {
                Event::new(EventContent::TileUnavailable { tile, failure }).of_frame(frame).at(at_nanos)
            }
            Self::Came { tile, at_nanos } => Event::new(EventContent::TileCame { tile }).at(at_nanos),
        }
    }
}
