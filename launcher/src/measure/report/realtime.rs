//! The part of a report that is about a flight against the clock.

use crate::measure::collector::frame::FrameStats;
use crate::measure::stats::RunStats;
use crate::measure::timing::ON_TIME_PERIODS;
use terravision_common::report::{DrawnFrames, Percentiles, RealtimeReport};
use terravision_common::run::RunConfig;

/// The part of a run; `None` in exact mode and of a flight whose clock never started.
#[must_use]
pub fn part(config: &RunConfig, stats: &RunStats) -> Option<RealtimeReport> {
    let realtime = config.realtime.as_ref()?;
    let start = stats.clock_start_nanos?;
    let period = config.period_nanos();
    let frames = &stats.collector.frames;
    let forgotten = stats.collector.forgotten();
    let first = [stats.collector.first_frame().get() + forgotten, forgotten];
    let drawn = drawn_frames(frames, first, start, period);
    let slots = frames.len() as u64;
    let on_time = drawn.is_on_time.iter().filter(|is_on_time| **is_on_time).count() as u64;
    let count = drawn.frame.len() as u64;
    // The first frame waits for the start of the stages: it says nothing of the pace.
    let after_first = |values: &[f64]| values.get(1..).unwrap_or_default().to_vec();
    let of = |values: &[f64]| Percentiles::of(&after_first(values));
    let mut new_latencies = after_first(&drawn.latency_ms);
    new_latencies.retain(|latency| *latency > 0.0);
    Some(RealtimeReport {
        clock_start_nanos: start,
        target_ms: period / 1e6,
        has_feedback: realtime.has_feedback,
        frames: slots,
        on_time,
        late: count - on_time,
        skipped: slots - count,
        on_time_share: if slots == 0 { 0.0 } else { on_time as f64 / slots as f64 },
        lacking: frames.iter().filter(|frame| frame.lacked > 0).count() as u64,
        sharp_mean: drawn.sharp.iter().sum::<f64>() / drawn.sharp.len().max(1) as f64,
        interval_ms: of(&drawn.interval_ms),
        renderer_ms: of(&drawn.renderer_ms),
        latency_ms: Percentiles::of(&new_latencies),
        drawn,
    })
}

/// The columns of the frames that were drawn; `first`: number of the first one, and its place in the
/// flight; `start`: the clock's, `period` in nanoseconds.
fn drawn_frames(frames: &[FrameStats], first: [u64; 2], start: u64, period: f64) -> DrawnFrames {
    let mut drawn = DrawnFrames::default();
    let mut before: Option<&FrameStats> = None;
    for (index, frame) in (0u64..).zip(frames).filter(|(_, frame)| frame.done_nanos > 0) {
        let ms = |from: u64| frame.done_nanos.saturating_sub(from) as f64 / 1e6;
        let place = first[1] + index;
        let moment = start + (place as f64 * period) as u64;
        // The clock starts with the end of the first frame.
        let is_on_time = place == 0 || frame.done_nanos <= moment + (ON_TIME_PERIODS * period) as u64;
        drawn.frame.push(first[0] + index);
        drawn.done_s.push((frame.done_nanos as f64 - start as f64) / 1e9);
        drawn.is_on_time.push(is_on_time);
        drawn.interval_ms.push(before.map_or(0.0, |before| ms(before.done_nanos)));
        let began = frame.draw_started_nanos.max(before.map_or(0, |before| before.done_nanos));
        drawn.renderer_ms.push(if frame.draw_started_nanos == 0 { 0.0 } else { ms(began) });
        // A picture that shows the pose of the one before once more is of no new moment.
        let is_new = frame.camera_nanos > before.map_or(0, |before| before.camera_nanos);
        drawn.latency_ms.push(if is_new { ms(frame.camera_nanos) } else { 0.0 });
        drawn.r_z_px.push(finite(frame.r_px[0]));
        drawn.r_c_px.push(finite(frame.r_px[1]));
        drawn.triangles.push(frame.triangles);
        drawn.tiles_wanted.push(frame.wanted);
        drawn.tiles_resident.push(frame.wanted.saturating_sub(frame.lacked));
        drawn.sharp.push(finite(frame.sharp));
        before = Some(frame);
    }
    drawn
}

/// A number from shared memory for a JSON file, which cannot hold NaN and infinity.
fn finite(value: f32) -> f64 {
    if value.is_finite() { value.into() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::report::tests::{config, stats};
    use terravision_common::run::RealtimeConfig;

    const MS: u64 = 1_000_000;

    #[test]
    fn frames_are_on_time_late_or_left_out() {
        let realtime = RealtimeConfig { has_feedback: true, coarsest_px: [40.0, 4.0], rest_px: [3.0, 1.0] };
        let config = RunConfig { realtime: Some(realtime), fps: 100.0, ..config() };
        let mut stats = stats();
        stats.clock_start_nanos = Some(100 * MS);
        let frame = |done: u64, camera: u64| FrameStats {
            done_nanos: done * MS,
            draw_started_nanos: (done - 4) * MS,
            camera_nanos: camera * MS,
            r_px: [20.0, f32::NAN],
            wanted: 10,
            lacked: 3,
            sharp: 0.75,
            ..FrameStats::default()
        };
        // Moments are 100, 110, 120...; a frame has 20 ms.
        let none = FrameStats::default();
        stats.collector.frames = vec![frame(100, 50), frame(130, 110), none, frame(151, 130), frame(154, 140)];
        let report = part(&config, &stats).unwrap();
        assert_eq!((report.frames, report.on_time, report.late, report.skipped), (5, 3, 1, 1));
        assert_eq!(report.drawn.frame, [5, 6, 8, 9]);
        assert_eq!(report.drawn.is_on_time, [true, true, false, true]);
        assert_eq!(report.drawn.interval_ms, [0.0, 30.0, 21.0, 3.0]);
        assert_eq!(report.drawn.renderer_ms, [4.0, 4.0, 4.0, 3.0]);
        assert_eq!(report.drawn.latency_ms, [50.0, 20.0, 21.0, 14.0]);
        assert_eq!((report.drawn.tiles_resident[0], report.drawn.r_z_px[0], report.drawn.r_c_px[0]), (7, 20.0, 0.0));
        assert_eq!((report.latency_ms.p50, report.latency_ms.worst, report.interval_ms.worst), (20.0, 21.0, 30.0));
        assert_eq!((report.sharp_mean, report.drawn.sharp[0]), (0.75, 0.75));
    }

    #[test]
    fn exact_mode_has_no_such_part() {
        assert_eq!(part(&config(), &stats()), None);
    }
}
