//! The report of a run (`terravision fly --report`), as the launcher writes it and benches read it.
//!
//! Field names are those of the JSON; docs/report.md says what each one is. Fields are only ever
//! added.

use crate::texels::TexelFormat;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Name of the schema.
pub const SCHEMA: &str = "terravision-fly-1";

/// The report of a run.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// [`SCHEMA`].
    pub schema: String,
    /// `exact` or `realtime`.
    pub mode: String,
    /// Version of the program.
    pub version: String,
    /// Frames that were written.
    pub frames: u64,
    /// Number of the first frame.
    pub first_frame: u64,
    /// Frames per second, from the end of the first frame to the end of the last.
    pub fps: f64,
    /// Seconds from the start of the program to the end of its stages.
    pub wall_s: f64,
    /// Per frame, milliseconds from the end of the frame before to its own.
    pub frame_ms: Vec<f64>,
    /// Median of `frame_ms`.
    pub frame_ms_median: f64,
    /// 99th percentile of `frame_ms`.
    pub frame_ms_p99: f64,
    /// Largest of `frame_ms`.
    pub frame_ms_max: f64,
    /// Width of the pictures, pixels.
    pub width: u32,
    /// Height of the pictures, pixels.
    pub height: u32,
    /// The technique: `mesh` or `rays`; empty if no stage has sent it.
    pub technique: String,
    /// Why it drew: `asked for`, or what device there was; empty if no stage has sent it.
    #[serde(default)]
    pub technique_reason: String,
    /// The device.
    pub device: String,
    /// Its driver; for rays, how they were cast.
    pub driver: String,
    /// The effective settings.
    pub settings: Settings,
    /// Time per frame by stage.
    pub stages: BTreeMap<String, FrameTimes>,
    /// Time per frame by kind of work.
    pub spans: BTreeMap<String, FrameTimes>,
    /// What drawing cost, by technique.
    #[serde(default)]
    pub draws: BTreeMap<String, DrawReport>,
    /// Tiles that the run used.
    pub tiles: TilesReport,
    /// Nodes of a frame's tree, median.
    pub nodes_median: f64,
    /// Triangles of a frame, median.
    pub triangles_median: f64,
    /// Largest resident set by process, MiB.
    pub rss_peak_mb: BTreeMap<String, f64>,
    /// Largest proportional set by process, MiB; `all` is the largest sum at one moment.
    pub pss_peak_mb: BTreeMap<String, f64>,
    /// Shared memory of the run, MiB.
    pub shared_memory_mb: f64,
    /// Seconds from the start of the program until the first frame had left the sink.
    pub time_to_first_frame_s: f64,
    /// Whether every frame was written, with every tile that it wanted.
    pub settled: bool,
    /// Trees that were larger than their buffer.
    pub trees_cut_short: u64,
    /// Events that found their ring full, or were malformed.
    pub events_dropped: u64,
    /// How often stages were restarted, by stage.
    pub restarts: BTreeMap<String, u32>,
    /// For a real-time flight.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub realtime: Option<RealtimeReport>,
    /// What the prefetcher did.
    pub prefetch: PrefetchReport,
    /// For a database on a server.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub network: Option<NetworkReport>,
}

impl Report {
    /// Whether the run delivered what its mode promises: in exact mode all frames with all their
    /// tiles, in realtime mode no tile that can never be read.
    #[must_use]
    pub fn is_as_promised(&self) -> bool {
        if self.realtime.is_some() { self.tiles.unavailable_count == 0 } else { self.settled }
    }
}

/// The effective settings.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Wanted size of facets, pixels.
    pub facet_px: f64,
    /// Wanted size of texels, pixels.
    pub texel_px: f64,
    /// How size on screen is measured: `min`, `area` or `max`.
    pub measure: String,
    /// Samples per pixel.
    pub samples: u32,
    /// Factor on the terrain's heights.
    pub exaggeration: f64,
    /// Threads that decode tiles and cast rays.
    pub threads: u32,
    /// Format of the pool of colour tiles.
    pub texels: TexelFormat,
}

/// Milliseconds per frame.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct FrameTimes {
    /// Median.
    pub ms_median: f64,
    /// 99th percentile, by nearest rank.
    pub ms_p99: f64,
    /// Largest.
    pub ms_max: f64,
}

/// What the draws of one technique cost.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct DrawReport {
    /// Milliseconds of all of a frame's views together, by the device's own clock, or of all
    /// processor cores where they draw.
    pub times: FrameTimes,
    /// Tiles of all of a frame's views together, median.
    pub tiles_median: f64,
}

/// Tiles that a run used.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct TilesReport {
    /// Tiles that frames wanted, summed over frames.
    pub wanted: u64,
    /// Tiles read from the database.
    pub loaded: u64,
    /// Tiles that were evicted.
    pub evicted: u64,
    /// Colour tiles copied to the device.
    pub uploaded: u64,
    /// Tiles that could not be read.
    pub unavailable: Vec<UnavailableTile>,
    /// Their number, which is larger than the list when events were lost.
    pub unavailable_count: u64,
}

/// A tile that could not be read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct UnavailableTile {
    /// `elevation` or `color`.
    pub layer: String,
    /// Column and row of its node.
    pub node: [u32; 2],
    /// Level of its node.
    pub level: u8,
    /// Why: `missing`, `corrupt`, `read error`, `refused` or `not in the cache`.
    pub cause: String,
}

/// The part about a real-time flight.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct RealtimeReport {
    /// Moment of the first frame, nanoseconds of the monotonic clock.
    pub clock_start_nanos: u64,
    /// Time of a frame, milliseconds.
    pub target_ms: f64,
    /// Whether facets and texels grew when frames took too long.
    pub has_feedback: bool,
    /// Frames of the flight: one for each moment.
    pub frames: u64,
    /// Frames that were on time.
    pub on_time: u64,
    /// Frames that were late.
    pub late: u64,
    /// Frames that were left out.
    pub skipped: u64,
    /// Share of all frames that were on time.
    pub on_time_share: f64,
    /// Frames that lacked a tile.
    pub lacking: u64,
    /// Mean share of the ground's screen area that was drawn at the wanted resolution.
    pub sharp_mean: f64,
    /// From the end of a frame to the end of the next, milliseconds.
    pub interval_ms: Percentiles,
    /// The renderer's own time of a frame, milliseconds.
    pub renderer_ms: Percentiles,
    /// From a camera to the end of its frame, milliseconds.
    pub latency_ms: Percentiles,
    /// Each frame that was drawn.
    pub drawn: DrawnFrames,
}

/// Percentiles of many values.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Percentiles {
    /// Median.
    pub p50: f64,
    /// 95th percentile.
    pub p95: f64,
    /// 99th percentile.
    pub p99: f64,
    /// The largest.
    pub worst: f64,
}

impl Percentiles {
    /// By nearest rank; 0 without values.
    #[must_use]
    pub fn of(values: &[f64]) -> Self {
        let mut values = values.to_vec();
        values.sort_by(f64::total_cmp);
        let at = |share: f64| {
            let rank = ((values.len() as f64 * share).ceil() as usize).saturating_sub(1);
            values.get(rank).copied().unwrap_or(0.0)
        };
        Self { p50: at(0.5), p95: at(0.95), p99: at(0.99), worst: at(1.0) }
    }
}

/// Frames that were drawn in real time: columns, all of the same length.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct DrawnFrames {
    /// Number of the frame.
    pub frame: Vec<u64>,
    /// End of its read-back, seconds after the first frame's moment.
    pub done_s: Vec<f64>,
    /// Whether it was on time.
    pub is_on_time: Vec<bool>,
    /// From the end of the frame before, milliseconds.
    pub interval_ms: Vec<f64>,
    /// The renderer's own time, milliseconds.
    pub renderer_ms: Vec<f64>,
    /// From its camera to its end, milliseconds; 0 for a frame that shows the camera of the one
    /// before.
    pub latency_ms: Vec<f64>,
    /// Size of facets, pixels.
    pub r_z_px: Vec<f64>,
    /// Size of texels, pixels.
    pub r_c_px: Vec<f64>,
    /// Triangles.
    pub triangles: Vec<u64>,
    /// Tiles that it wanted.
    pub tiles_wanted: Vec<u32>,
    /// Tiles that were resident.
    pub tiles_resident: Vec<u32>,
    /// Share of the ground's screen area that was drawn at the wanted resolution.
    pub sharp: Vec<f64>,
}

/// What the prefetcher did.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct PrefetchReport {
    /// How the camera was predicted.
    pub prediction: String,
    /// Tiles requested from the database.
    pub requested: u64,
    /// Tiles received.
    pub received: u64,
    /// Requests that were cancelled.
    pub cancelled: u64,
    /// Bytes of the received tiles.
    pub bytes: u64,
    /// N: the number of requests that may be in flight.
    pub window: WindowReport,
    /// From the request for a tile to its answer, milliseconds.
    pub round_trip_ms: Percentiles,
}

/// N over a run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct WindowReport {
    /// Smallest.
    pub least: u64,
    /// Largest.
    pub most: u64,
    /// At the end.
    pub last: u64,
}

/// Where the tiles of a database on a server or in an archive came from.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct NetworkReport {
    /// Requests to the server.
    pub requests: u64,
    /// Requests that repeated one that had failed.
    pub repeated: u64,
    /// Bytes that the server sent.
    pub bytes: u64,
    /// The disk cache.
    pub cache: CacheReport,
    /// Failures, by cause.
    pub failures: Vec<FailureReport>,
}

/// The disk cache.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct CacheReport {
    /// Pieces that it contained.
    pub hits: u64,
    /// Pieces that it did not contain.
    pub misses: u64,
    /// Bytes read from it.
    pub bytes: u64,
}

/// Failures of one cause while the database was read.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct FailureReport {
    /// The cause.
    pub cause: String,
    /// How often.
    pub count: u64,
    /// Why and where, a sentence for each place.
    pub told: Vec<String>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_nearest_ranks() {
        let values: Vec<f64> = (1..=100).rev().map(f64::from).collect();
        assert_eq!(Percentiles::of(&values), Percentiles { p50: 50.0, p95: 95.0, p99: 99.0, worst: 100.0 });
        assert_eq!(Percentiles::of(&[]), Percentiles::default());
    }
}
