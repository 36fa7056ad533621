//! The segments of a run: what is told when there is no room for them, and when another program
//! truncates them.

use crate::failure::{ExitStatus, Failure};
use crate::machine::bytes_for_people;
use crate::output::TemporaryFile;
use crate::plan::FlightPlan;
use anyhow::anyhow;
use std::path::Path;
use terravision_common::shm::{FrameRing, FrameShape, RunSegments, SharedName, ShmError, end_on_bus_error};

/// The frame ring that other programs shall read, if one is asked for.
pub(super) fn frame_ring(plan: &FlightPlan) -> Result<Option<FrameRing>, Failure> {
    let Some(share) = &plan.config.render.share else { return Ok(None) };
    let shape =
        FrameShape { size: plan.config.output_size(), has_depth: share.has_depth, has_ground: share.has_ground };
    let ring = SharedName::parse(&share.name).and_then(|name| FrameRing::create(&name, shape));
    ring.map(Some).map_err(|error| match error {
        ShmError::NameTaken { .. } | ShmError::NotOurs { .. } => Failure::bad_input(error),
        error => not_created(error),
    })
}

/// Why segments could not be created, and what to do.
pub(super) fn not_created(error: ShmError) -> Failure {
    match error {
        ShmError::NotEnoughSpace { needed, available } => Failure::failed(anyhow!(
            "shared memory is too small: the run needs {} in /dev/shm, which has {} free; give it more \
             (mount -o remount,size=2g /dev/shm, or docker run --shm-size=2g), or ask for less with --memory",
            bytes_for_people(needed),
            bytes_for_people(available)
        )),
        other => Failure::failed(other),
    }
}

/// A launcher that dies of segments that were truncated under it leaves a sentence, and nothing
/// else.
pub(super) fn guard_against_truncation(plan: &FlightPlan, segments: &RunSegments, ring: Option<&FrameRing>) {
    const MESSAGE: &str = "terravision: the flight is broken off: a file of its shared memory, /dev/shm/tv-…, was truncated by \
                           another program (bus error)";
    let mut files = segments.paths();
    tracing::debug!(segments = files.len(), bytes = segments.total_bytes(), "segments created");
    files.extend(ring.map(FrameRing::path));
    files.extend(plan.live.as_ref().and_then(|live| live.input.shared_file()));
    let temporary = plan.files.iter().chain(&plan.report).chain(&plan.trace);
    files.extend(temporary.filter_map(TemporaryFile::to_remove).map(Path::to_owned));
    // Where the system refuses, it dies without a sentence, and the next start removes what it
    // left.
    end_on_bus_error(MESSAGE, files, ExitStatus::Failed as u8).ok();
}
