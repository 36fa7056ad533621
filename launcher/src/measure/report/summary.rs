//! A report in sentences.

use terravision_common::report::{NetworkReport, RealtimeReport, Report};

/// The run in one line. `forgotten`: frames that the report knows nothing of. `has_sizes`: whether
/// pictures had sizes up to that of the run.
#[must_use]
pub fn summary(report: &Report, forgotten: u64, has_sizes: bool) -> String {
    let Report { frames, width, height, wall_s, fps, frame_ms_max, frame_ms_median, .. } = report;
    if *frames == 1 {
        return format!("1 frame, {width}x{height}, in {wall_s:.1} s");
    }
    if let Some(realtime) = &report.realtime {
        let size = format!("{}{width}x{height}", if has_sizes { "up to " } else { "" });
        return realtime_summary(realtime, forgotten, &size);
    }
    format!(
        "{frames} frames, {width}x{height}, in {wall_s:.1} s ({fps:.1} frames/s; worst frame {frame_ms_max:.0} ms, median \
         {frame_ms_median:.0} ms)"
    )
}

fn realtime_summary(report: &RealtimeReport, forgotten: u64, size: &str) -> String {
    let RealtimeReport { frames, target_ms, on_time, late, skipped, .. } = report;
    let of_last = if forgotten > 0 { format!("of the last {frames}, ") } else { String::new() };
    format!(
        "{} frames of {target_ms:.1} ms, {size}: {of_last}{on_time} on time ({:.1} %), {late} late, {skipped} left out; \
         renderer {:.1} ms, latency {:.1} ms (medians), worst interval {:.0} ms",
        frames + forgotten,
        100.0 * report.on_time_share,
        report.renderer_ms.p50,
        report.latency_ms.p50,
        report.interval_ms.worst
    )
}

/// Where the tiles of a database on a server came from, in one line.
#[must_use]
pub fn network_summary(report: &Report) -> Option<String> {
    let NetworkReport { requests, repeated, bytes, cache, .. } = report.network.as_ref()?;
    let mb = |bytes: u64| bytes as f64 / 1e6;
    Some(format!(
        "{requests} requests to the server, {repeated} of them repeated; {:.1} MB from there, {:.1} MB from the disk cache; an \
         answer took {:.0} ms (median)",
        mb(*bytes),
        mb(cache.bytes),
        report.prefetch.round_trip_ms.p50
    ))
}

/// How many tiles could not be read, and which is the first; `None` when all could.
#[must_use]
pub fn unavailable(report: &Report) -> Option<String> {
    let count = report.tiles.unavailable_count;
    let (tiles, were) = if count == 1 { ("tile", "was") } else { ("tiles", "were") };
    let first = match report.tiles.unavailable.first() {
        Some(tile) => format!(
            "the first is the {} tile of node ({}, {}, {}), {} (a report lists all)",
            tile.layer, tile.node[0], tile.node[1], tile.level, tile.cause
        ),
        None => "which ones is not known: the events that named them were lost".to_owned(),
    };
    (count > 0).then(|| format!("{count} {tiles} could not be read and {were} drawn from coarser ones; {first}"))
}
