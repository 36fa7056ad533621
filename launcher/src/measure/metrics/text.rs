//! The metrics as text (Prometheus exposition format 0.0.4).

use super::tally::{BOUNDS_S, FrameTally};
use std::fmt::{Display, Write};
use terravision_common::outcome::TileFailure;
use terravision_common::shm::{Control, Counter, Gauge, Stage};
use terravision_store::Cause;

/// Where metrics come from beside the tally of frames.
#[derive(Debug)]
pub(super) struct Facts {
    pub(super) control: Control,
    /// Of the elevation and the colour pool.
    pub(super) pool_slots: [u32; 2],
    /// 0 when it is not known how many there will be.
    pub(super) asked_frames: u64,
}

const NANOS: f64 = 1e9;
const POOLS: [&str; 2] = ["elevation", "color"];

struct Page(String);

impl Page {
    /// One metric: its name (without the program's), kind and help, and a value for each set of
    /// labels.
    fn put<V: Display>(&mut self, name: &str, kind: &str, help: &str, values: impl IntoIterator<Item = (String, V)>) {
        let mut text = format!("# HELP terravision_{name} {help}\n# TYPE terravision_{name} {kind}\n");
        for (labels, value) in values {
            // Writing to a string does not fail.
            writeln!(text, "terravision_{name}{labels} {value}").unwrap_or_default();
        }
        self.0.push_str(&text);
    }

    fn count(&mut self, name: &str, help: &str, value: u64) {
        self.put(name, "counter", help, [(String::new(), value)]);
    }

    fn gauge(&mut self, name: &str, help: &str, value: f64) {
        self.put(name, "gauge", help, [(String::new(), value)]);
    }
}

fn label(name: &str, value: impl Display) -> String {
    format!("{{{name}=\"{value}\"}}")
}

/// The page of now.
pub(super) fn write(facts: &Facts, frames: &FrameTally) -> String {
    let control = &facts.control;
    let mut page = Page(String::new());
    put_frames(&mut page, facts, frames);
    put_tiles(&mut page, facts, frames);
    put_network(&mut page, control);
    put_prefetch(&mut page, control);
    let restarts = Stage::ALL
        .into_iter()
        .map(|stage| (label("stage", stage.name()), control.generation_of(stage).saturating_sub(1)));
    page.put("stage_restarts_total", "counter", "How often a stage was started again.", restarts);
    page.count("events_dropped_total", "Events that found their ring full.", control.counter(Counter::EventsDropped));
    page.0
}

fn put_frames(page: &mut Page, facts: &Facts, frames: &FrameTally) {
    let control = &facts.control;
    histogram(page, frames);
    page.gauge("frames", "Frames of the flight; 0 when their number is not known.", facts.asked_frames as f64);
    page.count("frames_written_total", "Frames that have left the sink.", control.written_frames());
    page.count("frames_late_total", "Frames that came too late (realtime).", frames.late);
    page.count("frames_skipped_total", "Frames that were left out (realtime).", frames.skipped);
    page.gauge("facet_pixels", "r_z: wanted size of facets on screen.", control.r_z_px().unwrap_or(0.0));
    page.gauge("texel_pixels", "r_c: wanted size of texels on screen.", control.r_c_px().unwrap_or(0.0));
}

fn put_tiles(page: &mut Page, facts: &Facts, frames: &FrameTally) {
    let counter = |counter| facts.control.counter(counter);
    let gauge = |gauge| facts.control.gauge(gauge) as f64;
    page.count("tiles_wanted_total", "Tiles that frames wanted, each frame for itself.", counter(Counter::TilesWanted));
    page.gauge("frame_tiles_wanted", "Tiles that the newest frame wants.", frames.wanted as f64);
    let resident = frames.wanted.saturating_sub(frames.lacked);
    page.gauge("frame_tiles_resident", "Of these, tiles that are there.", resident as f64);
    page.gauge("tiles_in_flight", "Tiles that are asked for and have not come.", gauge(Gauge::TilesInFlight));
    page.gauge("tiles_predicted", "Tiles listed for the predicted view.", gauge(Gauge::TilesPredicted));
    page.count("tiles_requested_total", "Tiles asked of the database.", counter(Counter::TilesRequested));
    page.count("tiles_cancelled_total", "Of these, given up.", counter(Counter::TilesCancelled));
    page.count("tiles_loaded_total", "Tiles decoded into the pools.", counter(Counter::TilesLoaded));
    page.count("tiles_evicted_total", "Tiles that made room for others.", counter(Counter::TilesEvicted));
    page.count("tiles_uploaded_total", "Colour tiles copied to the device.", counter(Counter::TilesUploaded));
    let unavailable =
        TileFailure::ALL.iter().zip(frames.unavailable).map(|(failure, count)| (label("cause", failure.name()), count));
    page.put("tiles_unavailable_total", "counter", "Tiles that could not be read.", unavailable);
    page.put(
        "pool_slots",
        "gauge",
        "Slots of the tile pools.",
        POOLS.map(|p| label("pool", p)).into_iter().zip(facts.pool_slots),
    );
    let used = [Gauge::ElevationSlotsUsed, Gauge::ColorSlotsUsed].map(gauge);
    page.put(
        "pool_slots_used",
        "gauge",
        "Of these, holding a tile.",
        POOLS.map(|p| label("pool", p)).into_iter().zip(used),
    );
}

fn put_network(page: &mut Page, control: &Control) {
    let counter = |counter| control.counter(counter);
    page.count("tile_bytes_total", "Bytes of tiles that the database gave.", counter(Counter::BytesReceived));
    page.count("network_requests_total", "Requests to the database's server.", counter(Counter::NetworkRequests));
    page.count("network_repeated_total", "Of these, asked again.", counter(Counter::NetworkRepeated));
    page.count("network_bytes_total", "Bytes that the server sent.", counter(Counter::NetworkBytes));
    page.count("cache_hits_total", "Pieces that were in the disk cache.", counter(Counter::CacheHits));
    page.count("cache_misses_total", "Pieces that were not.", counter(Counter::CacheMisses));
    page.count("cache_bytes_total", "Bytes from the disk cache.", counter(Counter::CacheBytes));
    let failures = control.failures();
    let failures = Cause::ALL
        .into_iter()
        .map(|cause| (label("cause", cause.name()), failures.get(cause.number()).copied().unwrap_or(0)));
    page.put("failures_total", "counter", "Failures while the database was read, also those made good.", failures);
}

fn put_prefetch(page: &mut Page, control: &Control) {
    let gauge = |gauge| control.gauge(gauge) as f64;
    page.gauge("prefetch_window", "N: tiles asked for at a time.", gauge(Gauge::PrefetchWindow));
    page.gauge(
        "prefetch_received_ratio",
        "Share of tiles asked for that came in time.",
        gauge(Gauge::ReceivedPerMillion) / 1e6,
    );
    page.gauge(
        "prefetch_ahead_seconds",
        "How far ahead the view is predicted.",
        gauge(Gauge::PredictedAheadNanos) / NANOS,
    );
    page.gauge("round_trip_seconds", "From a request to its answer, smoothed.", gauge(Gauge::RoundTripNanos) / NANOS);
    page.gauge(
        "tile_latency_seconds",
        "From a request until its tile is there, smoothed.",
        gauge(Gauge::TileLatencyNanos) / NANOS,
    );
}

fn histogram(page: &mut Page, frames: &FrameTally) {
    let help = "Time from the end of a frame to the end of the next.";
    let mut sum = 0;
    let bounds = BOUNDS_S.iter().map(f64::to_string).chain(["+Inf".to_owned()]);
    let mut lines: Vec<(String, f64)> = Vec::new();
    for (bound, count) in bounds.zip(frames.by_time) {
        sum += count;
        lines.push((format!("_bucket{}", label("le", bound)), sum as f64));
    }
    lines.push(("_sum".to_owned(), frames.time_s));
    lines.push(("_count".to_owned(), frames.drawn as f64));
    page.put("frame_seconds", "histogram", help, lines);
}
