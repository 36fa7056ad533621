//! The part of a report that is about a flight against the clock.

use crate::measure::collector::FrameFigures;
use crate::measure::report::RunFigures;
use serde::Serialize;
use terravision_common::run::RunConfig;

/// A frame is on time when it is finished within so many times the frame's time after its moment: one for the stages
/// before the renderer, one for the renderer.
pub(crate) const ON_TIME_PERIODS: f64 = 2.0;

/// Field names are the schema's.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RealtimeReport {
    /// Moment of the first frame, nanoseconds of the monotonic clock.
    clock_start_nanos: u64,
    target_ms: f64,
    has_feedback: bool,
    /// Frames of the flight: one for each moment.
    frames: u64,
    on_time: u64,
    late: u64,
    skipped: u64,
    on_time_share: f64,
    lacking: u64,
    sharp_mean: f64,
    interval_ms: Percentiles,
    renderer_ms: Percentiles,
    latency_ms: Percentiles,
    /// By frame that was drawn.
    drawn: Drawn,
}

/// Of many values. Field names are the schema's.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub(crate) struct Percentiles {
    pub(crate) p50: f64,
    p95: f64,
    p99: f64,
    worst: f64,
}

/// Columns, all of the same length.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
struct Drawn {
    frame: Vec<u64>,
    /// End of read-back, seconds after the first frame's moment.
    done_s: Vec<f64>,
    is_on_time: Vec<bool>,
    interval_ms: Vec<f64>,
    renderer_ms: Vec<f64>,
    latency_ms: Vec<f64>,
    r_z_px: Vec<f64>,
    r_c_px: Vec<f64>,
    triangles: Vec<u64>,
    tiles_wanted: Vec<u32>,
    tiles_resident: Vec<u32>,
    /// Share of the ground's screen area that is drawn as finely as wanted.
    sharp: Vec<f64>,
}

impl RealtimeReport {
    /// The part of a run; `None` in exact mode and of a flight whose clock never started.
    #[must_use]
    pub fn new(config: &RunConfig, figures: &RunFigures) -> Option<Self> {
        let realtime = config.realtime.as_ref()?;
        let start = figures.clock_start_nanos?;
        let period = config.period_nanos();
        let frames = &figures.collector.frames;
        let mut drawn = Drawn::default();
        let mut before: Option<&FrameFigures> = None;
        for (index, frame) in (0u64..).zip(frames).filter(|(_, frame)| frame.done_nanos > 0) {
            let ms = |from: u64| frame.done_nanos.saturating_sub(from) as f64 / 1e6;
            let moment = start + (index as f64 * period) as u64;
            // The clock starts with the end of the first frame.
            let is_on_time = index == 0 || frame.done_nanos <= moment + (ON_TIME_PERIODS * period) as u64;
            drawn.frame.push(figures.collector.first_frame() + index);
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
        let slots = frames.len() as u64;
        let on_time = drawn.is_on_time.iter().filter(|is_on_time| **is_on_time).count() as u64;
        let count = drawn.frame.len() as u64;
        // The first frame waits for the start of the stages; no figure of pace counts it.
        let after_first = |values: &[f64]| values.get(1..).unwrap_or_default().to_vec();
        let of = |values: &[f64]| Percentiles::of(&after_first(values));
        let mut new_latencies = after_first(&drawn.latency_ms);
        new_latencies.retain(|latency| *latency > 0.0);
        Some(Self {
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

    /// The flight in one line.
    #[must_use]
    pub fn summary(&self, [width, height]: [u32; 2]) -> String {
        format!(
            "{} frames of {:.1} ms, {width}x{height}: {} on time ({:.1} %), {} late, {} left out; \
             renderer {:.1} ms, latency {:.1} ms (medians), worst interval {:.0} ms",
            self.frames,
            self.target_ms,
            self.on_time,
            100.0 * self.on_time_share,
            self.late,
            self.skipped,
            self.renderer_ms.p50,
            self.latency_ms.p50,
            self.interval_ms.worst
        )
    }
}

impl Percentiles {
    /// Nearest rank; 0 of nothing.
    pub(crate) fn of(values: &[f64]) -> Self {
        let mut values = values.to_vec();
        values.sort_by(f64::total_cmp);
        let at = |share: f64| {
            let rank = ((values.len() as f64 * share).ceil() as usize).saturating_sub(1);
            values.get(rank).copied().unwrap_or(0.0)
        };
        Self { p50: at(0.5), p95: at(0.95), p99: at(0.99), worst: at(1.0) }
    }
}

/// A number from shared memory for a JSON file, which has none that are not finite.
fn finite(value: f32) -> f64 {
    if value.is_finite() { value.into() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::report::tests::{config, figures};
    use terravision_common::run::RealtimeConfig;

    const MS: u64 = 1_000_000;

    #[test]
    fn frames_are_on_time_late_or_left_out() {
        let realtime = RealtimeConfig { has_feedback: true, coarsest_px: [40.0, 4.0], rest_px: [3.0, 1.0] };
        let config = RunConfig { realtime: Some(realtime), fps: 100.0, ..config() };
        let mut figures = figures();
        figures.clock_start_nanos = Some(100 * MS);
        let frame = |done: u64, camera: u64| FrameFigures {
            done_nanos: done * MS,
            draw_started_nanos: (done - 4) * MS,
            camera_nanos: camera * MS,
            r_px: [20.0, f32::NAN],
            wanted: 10,
            lacked: 3,
            sharp: 0.75,
            ..FrameFigures::default()
        };
        // Moments are 100, 110, 120...; a frame has 20 ms.
        let none = FrameFigures::default();
        figures.collector.frames = vec![frame(100, 50), frame(130, 110), none, frame(151, 130), frame(154, 140)];
        let report = RealtimeReport::new(&config, &figures).unwrap();
        assert_eq!((report.frames, report.on_time, report.late, report.skipped), (5, 3, 1, 1));
        assert_eq!(report.drawn.frame, [5, 6, 8, 9]);
        assert_eq!(report.drawn.is_on_time, [true, true, false, true]);
        assert_eq!(report.drawn.interval_ms, [0.0, 30.0, 21.0, 3.0]);
        assert_eq!(report.drawn.renderer_ms, [4.0, 4.0, 4.0, 3.0]);
        assert_eq!(report.drawn.latency_ms, [50.0, 20.0, 21.0, 14.0]);
        assert_eq!((report.drawn.tiles_resident[0], report.drawn.r_z_px[0], report.drawn.r_c_px[0]), (7, 20.0, 0.0));
        assert_eq!((report.latency_ms.p50, report.latency_ms.worst, report.interval_ms.worst), (20.0, 21.0, 30.0));
        assert_eq!((report.sharp_mean, report.drawn.sharp[0]), (0.75, 0.75));
        assert!(report.summary([4, 2]).contains("3 on time (60.0 %), 1 late, 1 left out"));
    }

    #[test]
    fn exact_mode_has_no_such_part() {
        assert_eq!(RealtimeReport::new(&config(), &figures()), None);
    }
}
