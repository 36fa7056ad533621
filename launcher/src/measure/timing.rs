//! From the moments of frames to how long they took.

use super::collector::frame::FrameStats;
use terravision_common::report::FrameTimes;

pub(super) const NANOS_PER_MS: f64 = 1e6;

/// A frame is on time when it is finished within this many frame times after its moment: one for
/// the stages before the renderer, one for the renderer.
pub(super) const ON_TIME_PERIODS: f64 = 2.0;

/// Seconds between two moments.
pub(super) fn seconds(from_nanos: u64, to_nanos: u64) -> f64 {
    to_nanos.saturating_sub(from_nanos) as f64 / 1e9
}

/// Median, 99th percentile (nearest rank) and maximum.
pub(super) fn frame_times(values: &[f64]) -> FrameTimes {
    let mut values = values.to_vec();
    let ms_median = median(&mut values);
    let ms_max = values.last().copied().unwrap_or(0.0);
    let rank = ((values.len() as f64 * 0.99).ceil() as usize).saturating_sub(1);
    let ms_p99 = values.get(rank).copied().unwrap_or(0.0);
    FrameTimes { ms_median, ms_p99, ms_max }
}

/// The median; 0 of no values. Leaves the values sorted.
pub(super) fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    match values.len() {
        0 => 0.0,
        n if n % 2 == 1 => values[middle],
        _ => 0.5 * (values[middle - 1] + values[middle]),
    }
}

/// Time from the end of the frame before to the end of each; of the first from its beginning, and
/// of one whose pose came later than that from its pose. In the order of frames.
pub(super) fn frame_ms(frames: &[FrameStats]) -> Vec<f64> {
    let mut before = None;
    let done = frames.iter().filter(|frame| frame.done_nanos > 0);
    done.map(|frame| {
        let from = before.unwrap_or(frame.draw_started_nanos).max(if before.is_some() { frame.pose_nanos } else { 0 });
        before = Some(frame.done_nanos);
        if from == 0 { 0.0 } else { frame.done_nanos.saturating_sub(from) as f64 / NANOS_PER_MS }
    })
    .collect()
}

/// What the renderer itself took for each frame: from when it began with it, or was done with the
/// one before if that was later, to the end of its read-back. Waiting for the ring is not in it.
pub(super) fn renderer_ms(frames: &[FrameStats]) -> Vec<f64> {
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

/// Frames per second from the end of the first to the end of the last, without what was waited for
/// poses; of a single frame, the inverse of its time.
pub(super) fn frames_per_second(frames: &[FrameStats]) -> f64 {
    let done: Vec<&FrameStats> = frames.iter().filter(|frame| frame.done_nanos > 0).collect();
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
