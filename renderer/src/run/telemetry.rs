//! What the frame loop tells the launcher and the rate control.

use crate::engine::{Finished, Submitted};
use crate::sink::workers::Written;
use crate::source::Telemetry;
use terravision_common::event::{Event, EventContent, SpanName, TextKind, monotonic_nanos};
use terravision_common::ids::FrameNumber;
use terravision_common::rate::FrameTiming;
use terravision_common::shm::Counter;

/// A frame was recorded, beginning at `started`.
pub(super) fn tell_of_recording<T: Telemetry + ?Sized>(
    telemetry: &mut T,
    frame: FrameNumber,
    started: u64,
    submitted: &Submitted,
) {
    let now = monotonic_nanos();
    let span = |name: SpanName, start_nanos: u64, duration_nanos: u64| {
        let span = Event::new(EventContent::Span { name, node: None });
        span.of_frame(frame).at(start_nanos).lasting(duration_nanos)
    };
    telemetry.event(&span(SpanName::Record, started, now.saturating_sub(started)));
    for event in submitted.decided.iter().flat_map(|driver| Event::text(TextKind::Driver, driver)) {
        telemetry.event(&event);
    }
    if submitted.uploads > 0 {
        telemetry.event(&span(SpanName::Upload, submitted.upload_started_nanos, submitted.upload_nanos));
        telemetry.count(Counter::TilesUploaded, submitted.uploads.into());
        let uploaded = Event::new(EventContent::FrameUploaded { tiles: submitted.uploads.into() });
        telemetry.event(&uploaded.of_frame(frame).at(now));
    }
}

/// A frame was drawn; the one before it at `last_finished`, 0 before the first.
pub(super) fn tell_of_finished<T: Telemetry + ?Sized>(telemetry: &mut T, finished: &Finished, last_finished: u64) {
    // Frames overlap; a frame's time is the time since the one before, or since it was submitted.
    let started = finished.submitted_nanos.max(last_finished);
    let before = if last_finished == 0 { finished.submitted_nanos } else { last_finished };
    let since_last = finished.finished_nanos.saturating_sub(before);
    telemetry.timed(&FrameTiming {
        frame: finished.frame.get(),
        sequence: finished.sequence.get(),
        r_z_px: finished.r_px[0],
        r_c_px: finished.r_px[1],
        work_nanos: finished.finished_nanos.saturating_sub(finished.started_nanos.max(last_finished)),
        interval_nanos: since_last,
        finished_nanos: finished.finished_nanos,
        camera_nanos: finished.pose.timestamp_nanos(),
    });
    let draw = Event::new(EventContent::Span { name: SpanName::Draw, node: None });
    let draw = draw.on_thread(1).of_frame(finished.frame);
    telemetry.event(&draw.at(started).lasting(finished.finished_nanos.saturating_sub(started)));
    let number = finished.frame;
    for cost in finished.costs.iter() {
        let Some(nanos) = cost.nanos else { continue };
        let content = EventContent::FrameDraw { technique: cost.technique, view: cost.view as u8, tiles: cost.tiles };
        telemetry.event(&Event::new(content).of_frame(number).at(finished.finished_nanos).lasting(nanos));
    }
    let done = Event::new(EventContent::FrameDone { triangles: finished.costs.triangles() });
    telemetry.event(&done.of_frame(number).at(finished.finished_nanos).lasting(since_last));
}

/// A frame has left its sink.
pub(super) fn tell_of_written<T: Telemetry + ?Sized>(telemetry: &mut T, written: &Written) {
    let (thread, end_nanos) = (2 + written.worker, written.started_nanos + written.duration_nanos);
    let encode = Event::new(EventContent::Span { name: SpanName::Encode, node: None });
    let encode = encode.on_thread(thread).of_frame(written.frame);
    telemetry.event(&encode.at(written.started_nanos).lasting(written.duration_nanos));
    let left = Event::new(EventContent::FrameWritten { is_settled: written.is_settled });
    telemetry.event(&left.on_thread(thread).of_frame(written.frame).at(end_nanos));
}
