//! What the frame loop tells the launcher and the rate control.

use crate::engine::{Finished, Submitted};
use crate::sink::workers::Written;
use crate::source::Telemetry;
use terravision_common::event::{Event, EventKind, SpanName, monotonic_nanos};
use terravision_common::rate::FrameTiming;
use terravision_common::shm::Counter;

/// A frame was recorded, beginning at `started`.
pub(super) fn tell_of_recording<T: Telemetry + ?Sized>(
    telemetry: &mut T,
    frame: u64,
    started: u64,
    submitted: &Submitted,
) {
    let now = monotonic_nanos();
    let span = |name: SpanName, start_nanos: u64, duration_nanos: u64| Event {
        kind: EventKind::Span as u32,
        thread: 0,
        frame,
        start_nanos,
        duration_nanos,
        value: name as u64,
        node: 0,
    };
    telemetry.event(&span(SpanName::Record, started, now.saturating_sub(started)));
    for event in submitted.decided.iter().flat_map(|driver| Event::text(EventKind::DriverName, driver)) {
        telemetry.event(&event);
    }
    if submitted.uploads > 0 {
        telemetry.event(&span(SpanName::Upload, submitted.upload_started_nanos, submitted.upload_nanos));
        telemetry.count(Counter::TilesUploaded, submitted.uploads.into());
        let uploaded = Event { kind: EventKind::FrameUploaded as u32, ..span(SpanName::Upload, now, 0) };
        telemetry.event(&Event { value: submitted.uploads.into(), ..uploaded });
    }
}

/// A frame was drawn; the one before it at `last_finished`, 0 before the first.
pub(super) fn tell_of_finished<T: Telemetry + ?Sized>(telemetry: &mut T, finished: &Finished, last_finished: u64) {
    // Frames overlap; a frame's time is the time since the one before, or since it was submitted.
    let started = finished.submitted_nanos.max(last_finished);
    let since_last = finished.finished_nanos.saturating_sub(if last_finished == 0 {
        finished.submitted_nanos
    } else {
        last_finished
    });
    telemetry.timed(&FrameTiming {
        frame: finished.frame,
        sequence: finished.sequence,
        r_z_px: finished.r_px[0],
        r_c_px: finished.r_px[1],
        work_nanos: finished.finished_nanos.saturating_sub(finished.started_nanos.max(last_finished)),
        interval_nanos: since_last,
        finished_nanos: finished.finished_nanos,
        camera_nanos: finished.pose.timestamp_nanos,
    });
    telemetry.event(&Event {
        kind: EventKind::Span as u32,
        thread: 1,
        frame: finished.frame,
        start_nanos: started,
        duration_nanos: finished.finished_nanos.saturating_sub(started),
        value: SpanName::Draw as u64,
        node: 0,
    });
    telemetry.event(&Event {
        kind: EventKind::FrameDone as u32,
        thread: 0,
        frame: finished.frame,
        start_nanos: finished.finished_nanos,
        duration_nanos: since_last,
        value: finished.triangles,
        node: 0,
    });
}

/// A frame has left its sink.
pub(super) fn tell_of_written<T: Telemetry + ?Sized>(telemetry: &mut T, written: &Written) {
    telemetry.event(&Event {
        kind: EventKind::Span as u32,
        thread: 2 + written.worker,
        frame: written.frame,
        start_nanos: written.started_nanos,
        duration_nanos: written.duration_nanos,
        value: SpanName::Encode as u64,
        node: 0,
    });
    telemetry.event(&Event {
        kind: EventKind::FrameWritten as u32,
        thread: 2 + written.worker,
        frame: written.frame,
        start_nanos: written.started_nanos + written.duration_nanos,
        duration_nanos: 0,
        value: u64::from(written.is_settled),
        node: 0,
    });
}
