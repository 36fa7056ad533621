//! From what a run measured to its report (docs/report.md; the fields are those of
//! [`terravision_common::report`]).
//!
//! * [`realtime`]: the part about a flight against the clock. [`network`]: the parts about where
//!   tiles came from.
//! * [`summary`]: a report in one line, and what could not be read.

pub mod network;
pub mod realtime;
pub mod summary;

use super::collector::frame::{FrameStats, TECHNIQUES};
use super::stats::RunStats;
use super::timing::{NANOS_PER_MS, frame_ms, frame_times, frames_per_second, median, renderer_ms, seconds};
use std::collections::BTreeMap;
use std::io::{self, Write};
use terravision_common::database::{Layer, Tile};
use terravision_common::event::SpanName;
use terravision_common::outcome::TileFailure;
use terravision_common::report::{self as schema, DrawReport, FrameTimes, Report, SCHEMA, Settings, TilesReport};
use terravision_common::run::RunConfig;
use terravision_common::shm::Stage;

/// The report of a run.
#[must_use]
pub fn report(config: &RunConfig, stats: &RunStats) -> Report {
    let [width, height] = config.output_size();
    let collector = &stats.collector;
    let frames = &collector.frames;
    let frame_ms = frame_ms(frames);
    let spread = frame_times(&frame_ms);
    let tiles = tiles(stats);
    let first_written = frames.iter().map(|frame| frame.written_nanos).find(|nanos| *nanos > 0);
    let is_complete = stats.written_frames == stats.asked_frames;
    let mut pss_peak_mb = stats.memory.pss_mb.clone();
    pss_peak_mb.insert("all".into(), stats.memory.pss_total_mb);
    Report {
        schema: SCHEMA.to_owned(),
        mode: if config.realtime.is_some() { "realtime" } else { "exact" }.to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        frames: stats.written_frames,
        first_frame: collector.first_frame().get(),
        fps: frames_per_second(frames),
        wall_s: seconds(stats.started_nanos, stats.ended_nanos),
        frame_ms_median: spread.ms_median,
        frame_ms_p99: spread.ms_p99,
        frame_ms_max: spread.ms_max,
        frame_ms,
        width,
        height,
        technique: collector.technique().unwrap_or_default(),
        technique_reason: collector.technique_reason(),
        device: collector.device(),
        driver: collector.driver(),
        settings: settings(config),
        stages: stages(frames),
        spans: SpanName::ALL.iter().map(|name| (name.as_str().to_owned(), span_times(frames, *name))).collect(),
        draws: draws(frames),
        nodes_median: median_of(frames, |frame| f64::from(frame.nodes)),
        triangles_median: median_of(frames, |frame| frame.triangles as f64),
        rss_peak_mb: stats.memory.rss_mb.clone(),
        pss_peak_mb,
        shared_memory_mb: stats.shared_memory_bytes as f64 / f64::from(1 << 20),
        time_to_first_frame_s: seconds(stats.started_nanos, first_written.unwrap_or(stats.ended_nanos)),
        settled: is_complete && tiles.unavailable_count == 0 && stats.frames_unsettled == 0,
        tiles,
        trees_cut_short: stats.trees_cut_short,
        events_dropped: stats.events_dropped + collector.malformed_events,
        restarts: stats.restarts.iter().map(|(stage, count)| ((*stage).to_owned(), *count)).collect(),
        realtime: realtime::part(config, stats),
        prefetch: network::prefetch_part(config, stats),
        network: network::part(config, stats),
    }
}

/// Writes a report as JSON.
///
/// # Errors
/// The writer's.
pub fn write(report: &Report, writer: &mut impl Write) -> io::Result<()> {
    serde_json::to_writer_pretty(&mut *writer, report)?;
    writer.write_all(b"\n")
}

fn settings(config: &RunConfig) -> Settings {
    Settings {
        facet_px: config.r_z_px,
        texel_px: config.r_c_px,
        measure: format!("{:?}", config.measure).to_lowercase(),
        samples: config.render.samples,
        exaggeration: config.exaggeration,
        threads: config.decoder_threads,
        texels: config.texels,
    }
}

fn stages(frames: &[FrameStats]) -> BTreeMap<String, FrameTimes> {
    let times = [
        (Stage::Generator, span_times(frames, SpanName::Generate)),
        (Stage::Preparer, span_times(frames, SpanName::Prepare)),
        (Stage::Renderer, frame_times(&renderer_ms(frames))),
    ];
    times.into_iter().map(|(stage, times)| (stage.name().to_owned(), times)).collect()
}

/// Of the frames that have such work.
fn span_times(frames: &[FrameStats], name: SpanName) -> FrameTimes {
    let nanos = frames.iter().map(|frame| frame.span_nanos[name as usize - 1]).filter(|nanos| *nanos > 0);
    frame_times(&nanos.map(|nanos| nanos as f64 / NANOS_PER_MS).collect::<Vec<_>>())
}

/// Of each technique that has drawn, over the frames that it has drawn in.
fn draws(frames: &[FrameStats]) -> BTreeMap<String, DrawReport> {
    let of = |index: usize| {
        let own = frames.iter().map(move |frame| frame.draws[index]).filter(|draws| draws.nanos > 0);
        let ms: Vec<f64> = own.clone().map(|draws| draws.nanos as f64 / NANOS_PER_MS).collect();
        let tiles_median = median(&mut own.map(|draws| draws.tiles as f64).collect::<Vec<_>>());
        (!ms.is_empty()).then(|| DrawReport { times: frame_times(&ms), tiles_median })
    };
    let named = TECHNIQUES.iter().enumerate().map(|(index, technique)| Some((technique.name().to_owned(), of(index)?)));
    named.flatten().collect()
}

/// Of the frames that were drawn.
fn median_of(frames: &[FrameStats], value: fn(&FrameStats) -> f64) -> f64 {
    median(&mut frames.iter().filter(|frame| frame.done_nanos > 0).map(value).collect::<Vec<_>>())
}

fn tiles(stats: &RunStats) -> TilesReport {
    let collector = &stats.collector;
    let unavailable: Vec<schema::UnavailableTile> =
        collector.unavailable.iter().map(|(tile, failure)| unavailable_tile(*tile, *failure)).collect();
    let counted = stats.tiles.unavailable.saturating_sub(collector.came_later);
    TilesReport {
        wanted: stats.tiles.wanted,
        loaded: stats.tiles.loaded,
        evicted: stats.tiles.evicted,
        uploaded: stats.tiles.uploaded,
        unavailable_count: counted.max(unavailable.len() as u64),
        unavailable,
    }
}

fn unavailable_tile(tile: Tile, failure: TileFailure) -> schema::UnavailableTile {
    schema::UnavailableTile {
        layer: match tile.layer {
            Layer::Elevation => "elevation",
            Layer::Color => "color",
        }
        .to_owned(),
        node: [tile.node.m(), tile.node.n()],
        level: tile.node.q(),
        cause: failure.words().to_owned(),
    }
}

#[cfg(test)]
pub(crate) mod tests;
