//! All that is known of a run when it has ended.

use super::collector::Collector;
use super::memory::MemoryPeaks;
use super::trace::Phase;
use crate::data_set::FlownFrame;
use std::collections::BTreeMap;
use terravision_common::report::WindowReport;
use terravision_common::shm::{Control, Counter, FAILURE_CAUSES, Gauge, Stage};

/// All that is known of a run when it has ended.
#[derive(Debug)]
pub struct RunStats {
    /// When the program started, nanoseconds of the monotonic clock.
    pub started_nanos: u64,
    /// When the last stage had ended.
    pub ended_nanos: u64,
    /// Frames that the flight should have.
    pub asked_frames: u64,
    /// Frames that have left the sink.
    pub written_frames: u64,
    /// What happened to tiles.
    pub tiles: TileStats,
    /// Frames written although a tile was missing.
    pub frames_unsettled: u64,
    /// Events that found their ring full: what single frames took may be missing.
    pub events_dropped: u64,
    /// Trees that were larger than their buffer.
    pub trees_cut_short: u64,
    /// Moment of the first frame of a realtime flight.
    pub clock_start_nanos: Option<u64>,
    /// Shared memory of the run.
    pub shared_memory_bytes: u64,
    /// What the stages told.
    pub collector: Collector,
    /// Peaks of memory.
    pub memory: MemoryPeaks,
    /// What the prefetcher did.
    pub prefetch: PrefetchStats,
    /// Process ids of the stages, of those that were started again behind the first four.
    pub pids: Vec<(Stage, u32)>,
    /// How often stages were started again, by name.
    pub restarts: BTreeMap<&'static str, u32>,
    /// Cameras of the poses that another program sent, each a frame.
    pub poses: Vec<FlownFrame>,
    /// What this program itself did, and its encoder, for the trace.
    pub phases: Vec<Phase>,
}

/// What happened to tiles, as counted in the control block.
#[derive(Debug, Clone, Copy, Default)]
pub struct TileStats {
    /// Tiles wanted, each frame counted for itself.
    pub wanted: u64,
    /// Tiles read and decoded.
    pub loaded: u64,
    /// Tiles that made room for others.
    pub evicted: u64,
    /// Colour tiles copied to the device.
    pub uploaded: u64,
    /// Tiles that could not be read, as the stages counted them.
    pub unavailable: u64,
}

impl TileStats {
    /// What is counted now.
    #[must_use]
    pub fn of(control: &Control) -> Self {
        let counter = |counter| control.counter(counter);
        Self {
            wanted: counter(Counter::TilesWanted),
            loaded: counter(Counter::TilesLoaded),
            evicted: counter(Counter::TilesEvicted),
            uploaded: counter(Counter::TilesUploaded),
            unavailable: counter(Counter::TilesUnavailable),
        }
    }
}

/// What the prefetcher did, as counted in the control block.
#[derive(Debug, Clone, Default)]
pub struct PrefetchStats {
    /// Tiles asked of the database.
    pub requested: u64,
    /// Tiles that it gave.
    pub received: u64,
    /// Requests that were given up.
    pub cancelled: u64,
    /// Bytes of the tiles that it gave.
    pub bytes: u64,
    /// Requests to a server, and of these those asked again.
    pub network_requests: [u64; 2],
    /// Bytes that a server sent.
    pub network_bytes: u64,
    /// Pieces that were in the disk cache, and that were not.
    pub cache_pieces: [u64; 2],
    /// Bytes from the disk cache.
    pub cache_bytes: u64,
    /// Failures by the number of the cause.
    pub failures: [u64; FAILURE_CAUSES],
    /// N: tiles asked for at a time.
    pub window: PrefetchWindow,
}

impl PrefetchStats {
    /// What is counted now.
    #[must_use]
    pub fn of(control: &Control, window: PrefetchWindow) -> Self {
        let counter = |counter| control.counter(counter);
        Self {
            requested: counter(Counter::TilesRequested),
            received: counter(Counter::TilesReceived),
            cancelled: counter(Counter::TilesCancelled),
            bytes: counter(Counter::BytesReceived),
            network_requests: [counter(Counter::NetworkRequests), counter(Counter::NetworkRepeated)],
            network_bytes: counter(Counter::NetworkBytes),
            cache_pieces: [counter(Counter::CacheHits), counter(Counter::CacheMisses)],
            cache_bytes: counter(Counter::CacheBytes),
            failures: control.failures(),
            window,
        }
    }
}

/// N over a run.
#[derive(Debug, Clone, Copy, Default)]
pub struct PrefetchWindow(WindowReport);

impl PrefetchWindow {
    /// Looks at N of now.
    pub fn sample(&mut self, control: &Control) {
        let (n, seen) = (control.gauge(Gauge::PrefetchWindow), &mut self.0);
        if n > 0 {
            seen.least = if seen.most == 0 { n } else { seen.least.min(n) };
            seen.most = seen.most.max(n);
            seen.last = n;
        }
    }

    /// As the report has it.
    #[must_use]
    pub fn report(self) -> WindowReport {
        self.0
    }
}
