//! Reports of a run of three frames.

use super::*;
use crate::data_set::FlownFrame;
use crate::measure::collector::Collector;
use crate::measure::memory::MemoryPeaks;
use crate::measure::stats::{PrefetchStats, TileStats};
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::database::{Layer, Tile};
use terravision_common::event::{Event, EventContent, SpanName};
use terravision_common::ids::FrameNumber;
use terravision_common::node::NodeId;
use terravision_common::outcome::TileFailure;
use terravision_common::run::TechniqueChoice;
use terravision_common::run::{DatabaseConfig, RenderConfig};
use terravision_testkit::runs;

pub(crate) fn config() -> RunConfig {
    let run = runs::config([5, 8]);
    RunConfig {
        run_id: "tv-1-2".into(),
        world: "w.tv".into(),
        database: DatabaseConfig::folder("w.tv".as_ref()),
        width: 64,
        height: 36,
        decoder_threads: 2,
        render: RenderConfig { sky_rgb: [1, 2, 3], ..run.render.clone() },
        ..run
    }
}

/// Three frames of 10 ms each, of which the renderer works 8, 10 and 4.
pub(crate) fn stats() -> RunStats {
    let mut collector = Collector::new(FrameNumber::new(5), 3, true);
    const MS: u64 = 1_000_000;
    for (frame, started, done) in [(5u64, 102, 110), (6, 109, 120), (7, 126, 130)] {
        let mut event = |stage, content, start, duration| {
            collector.take(
                stage,
                Event::new(content).of_frame(FrameNumber::new(frame)).at(start * MS).lasting(duration * MS),
            );
        };
        let span = |name| EventContent::Span { name, node: None };
        event(Stage::Generator, span(SpanName::Generate), started - 50, 1);
        event(Stage::Preparer, span(SpanName::Prepare), started - 20, frame - 4);
        event(Stage::Renderer, span(SpanName::Record), started, 1);
        for view in 0..2 {
            let draw = EventContent::FrameDraw { technique: TechniqueChoice::Mesh, view, tiles: 30 };
            event(Stage::Renderer, draw, done, frame - 3);
        }
        event(Stage::Renderer, EventContent::FrameDone { triangles: 1000 + frame }, done, 10);
        event(Stage::Renderer, EventContent::FrameWritten { is_settled: true }, done + 5, 0);
    }
    RunStats {
        started_nanos: 15 * MS,
        ended_nanos: 215 * MS,
        asked_frames: 3,
        written_frames: 3,
        tiles: TileStats { wanted: 30, loaded: 12, evicted: 0, uploaded: 6, unavailable: 0 },
        frames_unsettled: 0,
        events_dropped: 0,
        trees_cut_short: 0,
        clock_start_nanos: None,
        shared_memory_bytes: 1 << 20,
        collector,
        memory: MemoryPeaks::default(),
        prefetch: PrefetchStats::default(),
        pids: vec![(Stage::Generator, 11), (Stage::Preparer, 12), (Stage::Renderer, 13), (Stage::Prefetcher, 14)],
        restarts: BTreeMap::new(),
        poses: Vec::new(),
        phases: Vec::new(),
    }
}

/// Frames that were done at 110, 120 and 130 ms; the pose of the second came at 117, that of the
/// third while the second was drawn.
#[test]
fn waiting_for_a_pose_is_no_part_of_a_frames_time() {
    let mut stats = stats();
    const MS: u64 = 1_000_000;
    let pose = |frame, at: u64| {
        let camera =
            Camera::new(CameraFields { timestamp_nanos: at * MS, ..*Camera::default().fields() }).expect("valid");
        FlownFrame { frame: FrameNumber::new(frame), time_s: 0.0, camera }
    };
    stats.collector.note_poses(&[pose(5, 101), pose(6, 117), pose(7, 118), pose(99, 1)]);
    let report = serde_json::to_value(report(&config(), &stats)).unwrap();
    assert_eq!(report["frame_ms"], serde_json::json!([8.0, 3.0, 10.0]));
    assert_eq!(report["frame_ms_max"], 10.0);
    assert_eq!(report["fps"].as_f64().map(|fps| (fps * 1e3).round()), Some((2e6f64 / 13.0).round()));
}

#[test]
fn the_report_has_the_schema_and_the_stats() {
    let mut bytes = Vec::new();
    write(&report(&config(), &stats()), &mut bytes).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&bytes).unwrap();
    assert_eq!(report["schema"], "terravision-fly-1");
    assert_eq!(report["frames"], 3);
    assert_eq!(report["fps"], 100.0);
    assert_eq!(report["frame_ms"], serde_json::json!([8.0, 10.0, 10.0]));
    assert_eq!(report["stages"]["generator"]["ms_median"], 1.0);
    assert_eq!(report["stages"]["preparer"]["ms_median"], 2.0);
    assert_eq!(report["stages"]["preparer"]["ms_p99"], 3.0);
    assert_eq!(report["stages"]["renderer"]["ms_median"], 8.0);
    assert_eq!(report["stages"]["renderer"]["ms_p99"], 10.0);
    assert_eq!(
        report["tiles"],
        serde_json::json!({"wanted": 30, "loaded": 12, "evicted": 0, "uploaded": 6, "unavailable": [], "unavailable_count": 0})
    );
    assert_eq!(report["triangles_median"], 1006.0);
    assert_eq!(report["time_to_first_frame_s"], 0.1);
    assert_eq!(report["settled"], true);
}

#[test]
fn a_tile_that_could_not_be_had_is_listed_and_the_run_is_not_settled() {
    let mut stats = stats();
    let tile = Tile { layer: Layer::Elevation, node: NodeId::new(3, 4, 1).unwrap() };
    let content = EventContent::TileUnavailable { tile, failure: TileFailure::Damaged };
    stats.collector.take(Stage::Preparer, Event::new(content).of_frame(FrameNumber::new(6)));
    let report = report(&config(), &stats);
    assert!(!report.settled && !report.is_as_promised());
    let told = summary::unavailable(&report).unwrap();
    assert!(told.starts_with("1 tile could not be read and was drawn"), "{told}");
    assert!(told.contains("elevation tile of node (3, 4, 1), corrupt"), "{told}");
    let listed = serde_json::to_value(&report).unwrap()["tiles"]["unavailable"].clone();
    assert_eq!(listed, serde_json::json!([{"layer": "elevation", "node": [3, 4], "level": 1, "cause": "corrupt"}]));
}

#[test]
fn a_run_of_nothing_has_a_report() {
    let mut stats = stats();
    stats.collector = Collector::new(FrameNumber::new(0), 0, false);
    stats.written_frames = 0;
    let report = report(&config(), &stats);
    assert!(report.frame_ms.is_empty() && report.fps == 0.0);
}
