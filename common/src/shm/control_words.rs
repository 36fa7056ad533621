//! The layout of the control block, and the names of its numbers.

use super::bell::Bell;
use super::cursor::Padded;
use super::region::SharedWords;
use super::seqlock::SeqLock;
use crate::camera::CameraFields;
use crate::rate::FrameTiming;
use crate::sync::{AtomicU32, AtomicU64};

/// Words of a [`CameraFields`].
pub(crate) const CAMERA_WORDS: usize = size_of::<CameraFields>() / 8;

/// Words of a [`FrameTiming`].
pub(crate) const TIMING_WORDS: usize = size_of::<FrameTiming>() / 8;

/// The state of a run. It only moves forward: a failed run cannot stop in good order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u32)]
pub enum RunState {
    /// Frames are being made.
    Running = 1,
    /// A flight without a known number of frames is over, and all of its frames are written: stages
    /// end, and their output is complete.
    Finished = 2,
    /// All stages have to end: the flight is over, or was interrupted.
    Stopping = 3,
    /// A stage died or gave up; all others have to end.
    Failed = 4,
}

/// Numbers that the stages add up for the report.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(usize)]
pub enum Counter {
    /// Tiles that frames wanted, summed over frames.
    TilesWanted = 0,
    /// Tiles loaded into the pools.
    TilesLoaded,
    /// Tiles evicted from the pools.
    TilesEvicted,
    /// Tiles that could not be read.
    TilesUnavailable,
    /// Colour tiles copied to the device.
    TilesUploaded,
    /// Events that found their ring full.
    EventsDropped,
    /// Frames generated.
    FramesGenerated,
    /// Frames prepared.
    FramesPrepared,
    /// Frames drawn.
    FramesDrawn,
    /// Frames that were written although a tile that they wanted was missing.
    FramesUnsettled,
    /// Trees that did not fit into a half of the ping-pong buffer.
    TreesCutShort,
    /// Slots that the renderer refused because of an invalid number.
    SlotsRejected,
    /// Tiles requested from the database.
    TilesRequested,
    /// Tiles received from the database, damaged ones included.
    TilesReceived,
    /// Requests that were cancelled because the tile was no longer wanted, or because no answer
    /// came.
    TilesCancelled,
    /// Bytes of the received tiles.
    BytesReceived,
    /// Requests to a server of the database, each repetition counted.
    NetworkRequests,
    /// Of these, repeated after a failure.
    NetworkRepeated,
    /// Bytes of content that servers sent.
    NetworkBytes,
    /// Pieces of the database that were in the disk cache.
    CacheHits,
    /// Pieces that were not.
    CacheMisses,
    /// Bytes read from the disk cache.
    CacheBytes,
}

impl Counter {
    /// All counters.
    pub const ALL: [Self; 22] = [
        Self::TilesWanted,
        Self::TilesLoaded,
        Self::TilesEvicted,
        Self::TilesUnavailable,
        Self::TilesUploaded,
        Self::EventsDropped,
        Self::FramesGenerated,
        Self::FramesPrepared,
        Self::FramesDrawn,
        Self::FramesUnsettled,
        Self::TreesCutShort,
        Self::SlotsRejected,
        Self::TilesRequested,
        Self::TilesReceived,
        Self::TilesCancelled,
        Self::BytesReceived,
        Self::NetworkRequests,
        Self::NetworkRepeated,
        Self::NetworkBytes,
        Self::CacheHits,
        Self::CacheMisses,
        Self::CacheBytes,
    ];
}

/// Current values, for metrics.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(usize)]
pub enum Gauge {
    /// N: the number of requests that the prefetcher may have in flight.
    PrefetchWindow = 0,
    /// Requested tiles that have not arrived.
    TilesInFlight,
    /// Tiles that the newest frame wants and that are not resident.
    TilesMissing,
    /// Listed tiles that the predicted view wants and that are not resident.
    TilesPredicted,
    /// Time from the request of a tile until it is resident, nanoseconds, smoothed.
    TileLatencyNanos,
    /// How far ahead the view is predicted, nanoseconds; 0 when it is not.
    PredictedAheadNanos,
    /// Share of answered requests in the last judged cycle with any, in millionths.
    ReceivedPerMillion,
    /// Round trip time of a request, nanoseconds, smoothed.
    RoundTripNanos,
    /// Slots of the elevation pool that hold a tile.
    ElevationSlotsUsed,
    /// Slots of the colour pool that hold a tile.
    ColorSlotsUsed,
}

pub(crate) const GAUGES: usize = 16;

/// Number of causes of failure that are counted separately; the store defines them.
pub const FAILURE_CAUSES: usize = 32;

pub(crate) const COUNTERS: usize = 32;
const _: () = assert!(Counter::ALL.len() <= COUNTERS);

/// The entry of a stage.
#[derive(Debug)]
#[repr(C, align(128))]
pub(crate) struct StageWords {
    /// Its process; 0 before it registers.
    pub(crate) pid: AtomicU64,
    pub(crate) start_time: AtomicU64,
    /// Monotonic nanoseconds of its last heartbeat.
    pub(crate) heartbeat_nanos: AtomicU64,
    /// How often a process registered here: distinguishes a restarted stage from a slow one.
    pub(crate) generation: AtomicU64,
    /// How often it made progress.
    pub(crate) progress: AtomicU64,
    /// What it has waited for since its last progress ([`super::activity::Activity`]).
    pub(crate) activity: AtomicU32,
}

/// The control block. Words that different processes write lie on different cache lines.
#[derive(Debug)]
#[repr(C)]
pub(crate) struct ControlWords {
    /// [`RunState`]; 0 counts as running.
    pub(crate) state: Padded<AtomicU32>,
    pub(crate) stages: [StageWords; 4],
    /// All frames up to this sequence are drawn; written by the renderer.
    pub(crate) completed_sequence: Padded<AtomicU64>,
    pub(crate) completed_bell: Padded<Bell>,
    /// Frames that have left the sink; written by the renderer.
    pub(crate) written_frames: Padded<AtomicU64>,
    pub(crate) written_bell: Padded<Bell>,
    /// Bits of two f64: the currently wanted screen resolutions.
    pub(crate) r_z_bits: Padded<AtomicU64>,
    pub(crate) r_c_bits: Padded<AtomicU64>,
    pub(crate) camera: Padded<SeqLock<CAMERA_WORDS>>,
    pub(crate) camera_bell: Padded<Bell>,
    pub(crate) counters: [AtomicU64; COUNTERS],
    /// Moment of the first frame of a realtime flight, monotonic nanoseconds; 0 before. Written by
    /// the launcher.
    pub(crate) clock_start: Padded<AtomicU64>,
    /// The newest finished frame; written by the renderer.
    pub(crate) timing: Padded<SeqLock<TIMING_WORDS>>,
    /// The time of the preparer for its newest frame, nanoseconds.
    pub(crate) prepare_nanos: Padded<AtomicU64>,
    /// Not 0: the launcher restarts dead stages.
    pub(crate) is_supervised: Padded<AtomicU32>,
    /// Sequence of the run's last frame, once that is prepared; 0 before. Written by the preparer.
    pub(crate) last_sequence: Padded<AtomicU64>,
    pub(crate) gauges: [AtomicU64; GAUGES],
    /// Failures while the database was read, by cause.
    pub(crate) failures: [AtomicU64; FAILURE_CAUSES],
}

// SAFETY: atomics alone (padding between them is never read), repr(C), aligned to 128.
unsafe impl SharedWords for ControlWords {}

const _: () = {
    assert!(size_of::<ControlWords>() == 18 * 128 + (COUNTERS + GAUGES + FAILURE_CAUSES) * 8);
    assert!(size_of::<ControlWords>() as u64 <= super::geometry::WORDS_BYTES);
    assert!(size_of::<CameraFields>() == CAMERA_WORDS * 8);
};
