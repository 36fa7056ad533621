//! The report of a run, JSON of the schema `terravision-fly-1` (docs/report.md). [`realtime`]: its part about a flight
//! against the clock; [`network`]: its parts about where tiles came from.

pub mod network;
pub mod realtime;

use crate::data_set::FlownFrame;
use crate::measure::collector::{Collector, FrameFigures};
use crate::measure::memory::MemoryPeaks;
use crate::measure::report::network::{NetworkReport, PrefetchFigures, PrefetchReport, WindowSpan};
use crate::measure::report::realtime::RealtimeReport;
use crate::measure::trace::Phase;
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{self, Write};
use terravision_common::event::SpanName;
use terravision_common::run::RunConfig;
use terravision_common::shm::Stage;
use terravision_common::texels::TexelFormat;

/// All that is known of a run when it has ended.
#[derive(Debug)]
pub struct RunFigures {
    /// When the program started, nanoseconds of the monotonic clock.
    pub started_nanos: u64,
    /// When the last stage had ended.
    pub ended_nanos: u64,
    /// Frames that the flight should have.
    pub asked_frames: u64,
    /// Frames that have left the sink.
    pub written_frames: u64,
    /// Tiles wanted, each frame counted for itself.
    pub tiles_wanted: u64,
    /// Tiles read and decoded.
    pub tiles_loaded: u64,
    /// Tiles that made room for others.
    pub tiles_evicted: u64,
    /// Colour tiles copied to the device.
    pub tiles_uploaded: u64,
    /// Tiles that could not be had, as the stages counted them.
    pub tiles_unavailable: u64,
    /// Frames written although a tile was missing.
    pub frames_unsettled: u64,
    /// Events that found their ring full: figures of single frames may be missing.
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
    pub prefetch: PrefetchFigures,
    /// N.
    pub window: WindowSpan,
    /// Process ids of the stages, of those that were started again behind the first four.
    pub pids: Vec<(Stage, u32)>,
    /// How often stages were started again, by name.
    pub restarts: BTreeMap<&'static str, u32>,
    /// Cameras of the poses that another program sent, each a frame.
    pub poses: Vec<FlownFrame>,
    /// What this program itself did, and its encoder, for the trace.
    pub phases: Vec<Phase>,
}

/// The report. Field names are the schema's.
#[derive(Debug, Serialize)]
pub struct Report {
    schema: &'static str,
    mode: &'static str,
    version: &'static str,
    frames: u64,
    first_frame: u64,
    fps: f64,
    wall_s: f64,
    frame_ms: Vec<f64>,
    frame_ms_median: f64,
    frame_ms_p99: f64,
    frame_ms_max: f64,
    width: u32,
    height: u32,
    technique: String,
    device: String,
    driver: String,
    settings: Settings,
    stages: BTreeMap<&'static str, Spread>,
    spans: BTreeMap<&'static str, Spread>,
    tiles: Tiles,
    nodes_median: f64,
    triangles_median: f64,
    rss_peak_mb: BTreeMap<String, f64>,
    pss_peak_mb: BTreeMap<String, f64>,
    shared_memory_mb: f64,
    time_to_first_frame_s: f64,
    settled: bool,
    trees_cut_short: u64,
    events_dropped: u64,
    restarts: BTreeMap<&'static str, u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    realtime: Option<RealtimeReport>,
    prefetch: PrefetchReport,
    #[serde(skip_serializing_if = "Option::is_none")]
    network: Option<NetworkReport>,
}

#[derive(Debug, Serialize)]
struct Settings {
    facet_px: f64,
    texel_px: f64,
    measure: String,
    samples: u32,
    exaggeration: f64,
    threads: u32,
    /// The format of the pool of colour tiles.
    texels: TexelFormat,
}

/// Milliseconds per frame.
#[derive(Debug, Clone, Copy, Serialize)]
struct Spread {
    ms_median: f64,
    ms_p99: f64,
    ms_max: f64,
}

#[derive(Debug, Serialize)]
struct Tiles {
    wanted: u64,
    loaded: u64,
    evicted: u64,
    uploaded: u64,
    unavailable: Vec<Unavailable>,
    /// Larger than the list when events were lost.
    unavailable_count: u64,
}

#[derive(Debug, Serialize)]
struct Unavailable {
    layer: &'static str,
    node: [u32; 2],
    level: u8,
    cause: &'static str,
}

const NANOS_PER_MS: f64 = 1e6;

impl Report {
    /// The report of a run.
    #[must_use]
    pub fn new(config: &RunConfig, figures: &RunFigures) -> Self {
        let collector = &figures.collector;
        let frames = &collector.frames;
        let span = |name: SpanName| -> Vec<f64> {
            let nanos = frames.iter().map(|frame| frame.span_nanos[name as usize - 1]);
            nanos.filter(|nanos| *nanos > 0).map(|nanos| nanos as f64 / NANOS_PER_MS).collect()
        };
        let renderer_ms = renderer_ms(frames);
        let mut stages = BTreeMap::new();
        stages.insert(Stage::Generator.name(), Spread::of(&span(SpanName::Generate)));
        stages.insert(Stage::Preparer.name(), Spread::of(&span(SpanName::Prepare)));
        stages.insert(Stage::Renderer.name(), Spread::of(&renderer_ms));
        let spans = SpanName::ALL.iter().map(|name| (name.as_str(), Spread::of(&span(*name)))).collect();
        let frame_ms = frame_ms(frames);
        let spread = Spread::of(&frame_ms);
        let unavailable: Vec<Unavailable> = collector
            .unavailable
            .iter()
            .map(|(tile, cause)| Unavailable {
                layer: if tile.is_color { "color" } else { "elevation" },
                node: [tile.node.m(), tile.node.n()],
                level: tile.node.q(),
                cause: match cause {
                    1 => "missing",
                    2 => "corrupt",
                    4 => "refused",
                    5 => "not in the cache",
                    _ => "read error",
                },
            })
            .collect();
        let counted = figures.tiles_unavailable.saturating_sub(collector.came_later);
        let unavailable_count = counted.max(unavailable.len() as u64);
        let first_written = frames.iter().map(|frame| frame.written_nanos).find(|nanos| *nanos > 0);
        let first_written = first_written.unwrap_or(figures.ended_nanos);
        let is_complete = figures.written_frames == figures.asked_frames;
        let of_frames = |value: fn(&FrameFigures) -> f64| -> f64 {
            median(&mut frames.iter().filter(|frame| frame.done_nanos > 0).map(value).collect::<Vec<_>>())
        };
        let mut pss_peak_mb = figures.memory.pss_mb.clone();
        pss_peak_mb.insert("all".into(), figures.memory.pss_total_mb);
        Self {
            schema: "terravision-fly-1",
            mode: if config.realtime.is_some() { "realtime" } else { "exact" },
            version: env!("CARGO_PKG_VERSION"),
            frames: figures.written_frames,
            first_frame: collector.first_frame(),
            fps: frames_per_second(frames),
            wall_s: seconds(figures.started_nanos, figures.ended_nanos),
            frame_ms_median: spread.ms_median,
            frame_ms_p99: spread.ms_p99,
            frame_ms_max: spread.ms_max,
            frame_ms,
            width: config.width,
            height: config.height,
            technique: collector.technique().unwrap_or_default(),
            device: collector.device(),
            driver: collector.driver(),
            settings: Settings {
                facet_px: config.r_z_px,
                texel_px: config.r_c_px,
                measure: format!("{:?}", config.measure).to_lowercase(),
                samples: config.render.samples,
                exaggeration: config.exaggeration,
                threads: config.decoder_threads,
                texels: config.texels,
            },
            stages,
            spans,
            tiles: Tiles {
                wanted: figures.tiles_wanted,
                loaded: figures.tiles_loaded,
                evicted: figures.tiles_evicted,
                uploaded: figures.tiles_uploaded,
                unavailable,
                unavailable_count,
            },
            nodes_median: of_frames(|frame| f64::from(frame.nodes)),
            triangles_median: of_frames(|frame| frame.triangles as f64),
            rss_peak_mb: figures.memory.rss_mb.clone(),
            pss_peak_mb,
            shared_memory_mb: figures.shared_memory_bytes as f64 / f64::from(1 << 20),
            time_to_first_frame_s: seconds(figures.started_nanos, first_written),
            settled: is_complete && unavailable_count == 0 && figures.frames_unsettled == 0,
            trees_cut_short: figures.trees_cut_short,
            events_dropped: figures.events_dropped + collector.strange_events,
            restarts: figures.restarts.clone(),
            realtime: RealtimeReport::new(config, figures),
            prefetch: PrefetchReport::new(config, figures),
            network: NetworkReport::new(config, figures),
        }
    }

    /// Writes it as JSON.
    ///
    /// # Errors
    /// The writer's.
    pub fn write(&self, writer: &mut impl Write) -> io::Result<()> {
        serde_json::to_writer_pretty(&mut *writer, self)?;
        writer.write_all(b"\n")
    }

    /// Whether every tile that was wanted was drawn.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.settled
    }

    /// Whether the flight was what its mode promises: in exact mode complete, in realtime mode without tiles that can never
    /// be had.
    #[must_use]
    pub fn is_as_expected(&self) -> bool {
        if self.realtime.is_some() { self.tiles.unavailable_count == 0 } else { self.settled }
    }

    /// Number of tiles that could not be had.
    #[must_use]
    pub fn unavailable_count(&self) -> u64 {
        self.tiles.unavailable_count
    }

    /// The first tile of the list of those that could not be had, in words.
    #[must_use]
    pub fn first_unavailable(&self) -> String {
        match self.tiles.unavailable.first() {
            Some(tile) => format!(
                "the first is the {} tile of node ({}, {}, {}), {} (a report lists all)",
                tile.layer, tile.node[0], tile.node[1], tile.level, tile.cause
            ),
            None => "which ones was lost on the way".into(),
        }
    }

    /// Where the tiles of a database that is elsewhere came from, in one line.
    #[must_use]
    pub fn network_summary(&self) -> Option<String> {
        self.network.as_ref().map(NetworkReport::summary)
    }

    /// The run in one line.
    #[must_use]
    pub fn summary(&self) -> String {
        if self.frames == 1 {
            return format!("1 frame, {}x{}, in {:.1} s", self.width, self.height, self.wall_s);
        }
        if let Some(realtime) = &self.realtime {
            return realtime.summary([self.width, self.height]);
        }
        format!(
            "{} frames, {}x{}, in {:.1} s ({:.1} frames/s; worst frame {:.0} ms, median {:.0} ms)",
            self.frames, self.width, self.height, self.wall_s, self.fps, self.frame_ms_max, self.frame_ms_median
        )
    }
}

impl Spread {
    fn of(values: &[f64]) -> Self {
        let mut values = values.to_vec();
        let ms_median = median(&mut values);
        let ms_max = values.last().copied().unwrap_or(0.0);
        // Nearest rank.
        let rank = ((values.len() as f64 * 0.99).ceil() as usize).saturating_sub(1);
        let ms_p99 = values.get(rank).copied().unwrap_or(0.0);
        Self { ms_median, ms_p99, ms_max }
    }
}

/// The median; 0 of nothing. Leaves the values sorted.
fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    match values.len() {
        0 => 0.0,
        n if n % 2 == 1 => values[middle],
        _ => 0.5 * (values[middle - 1] + values[middle]),
    }
}

fn seconds(from_nanos: u64, to_nanos: u64) -> f64 {
    to_nanos.saturating_sub(from_nanos) as f64 / 1e9
}

/// Time from the end of the frame before to the end of each; of the first from its beginning, and of one whose pose came later
/// than that from its pose. In the order of frames.
pub(crate) fn frame_ms(frames: &[FrameFigures]) -> Vec<f64> {
    let mut before = None;
    let done = frames.iter().filter(|frame| frame.done_nanos > 0);
    done.map(|frame| {
        let from = before.unwrap_or(frame.draw_started_nanos).max(if before.is_some() { frame.pose_nanos } else { 0 });
        before = Some(frame.done_nanos);
        if from == 0 { 0.0 } else { frame.done_nanos.saturating_sub(from) as f64 / NANOS_PER_MS }
    })
    .collect()
}

/// What the renderer itself took for each frame: from when it began with it, or was done with the one before if that
/// was later, to the end of its read-back. Waiting for the ring is not in it.
pub(crate) fn renderer_ms(frames: &[FrameFigures]) -> Vec<f64> {
    let mut before = 0;
    let known = frames.iter().filter(|frame| frame.done_nanos > 0 && frame.draw_started_nanos > 0);
    known
        .map(|frame| {
            let from = frame.draw_started_nanos.max(before);
            before = frame.done_nanos;
            frame.done_nanos.saturating_sub(from) as f64 / NANOS_PER_MS
        })
        .collect()
}

/// Frames per second from the end of the first to the end of the last, without what was waited for poses; of a single frame,
/// the inverse of its time.
fn frames_per_second(frames: &[FrameFigures]) -> f64 {
    let done: Vec<&FrameFigures> = frames.iter().filter(|frame| frame.done_nanos > 0).collect();
    if done.len() > 1 && done.iter().any(|frame| frame.pose_nanos > 0) {
        let busy_s = frame_ms(frames).iter().skip(1).sum::<f64>() / 1e3;
        return if busy_s > 0.0 { (done.len() - 1) as f64 / busy_s } else { 0.0 };
    }
    let (Some(first), Some(last)) = (done.first(), done.last()) else { return 0.0 };
    let (count, from) = match done.len() {
        1 => (1, first.draw_started_nanos),
        n => (n - 1, first.done_nanos),
    };
    let seconds = seconds(from, last.done_nanos);
    if seconds > 0.0 { count as f64 / seconds } else { 0.0 }
}

#[cfg(test)]
pub(crate) mod tests;
