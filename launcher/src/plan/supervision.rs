//! Which deaths of stages a flight survives, and when a stage hangs.

use super::checks::in_range;
use crate::cli::supervision::SupervisionArgs;
use crate::failure::Failure;
use std::time::Duration;
use terravision_common::run::{OPEN_END, RunConfig};

/// How stages of a run are started again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RestartRules {
    /// Most restarts within a minute, and most between two pictures, of all stages together; 0 for
    /// none at all.
    pub limit: u32,
    /// Which stages hang; they are killed.
    pub hang: HangRules,
}

impl RestartRules {
    /// The first death ends the run, and nothing hangs.
    pub const NONE: Self = Self { limit: 0, hang: HangRules::NEVER };
}

/// How long is waited for what.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HangRules {
    /// A stage, or ffmpeg, that makes no progress for this long hangs.
    pub after: Duration,
    /// While requests to the database are in flight: they have timeouts of their own.
    pub storage: Duration,
    /// A camera comes within this time, when one is due.
    pub camera: Duration,
    /// The launcher has all cameras; else another program sends them, and may rest as long as it
    /// likes.
    pub has_path: bool,
}

impl HangRules {
    /// Nothing ever hangs.
    pub const NEVER: Self =
        Self { after: Duration::MAX, storage: Duration::MAX, camera: Duration::MAX, has_path: true };
    /// A database on a disk that is slow has this long for one tile.
    const DISK: Duration = Duration::from_secs(60);

    /// For a run in which a stage hangs `after` this long without progress.
    #[must_use]
    pub fn new(after: Duration, config: &RunConfig) -> Self {
        // A read is asked again within three times what a request may take.
        let request = Duration::from_millis(config.database.request_timeout_ms);
        let storage = if config.database.is_remote() { request.saturating_mul(4) } else { Self::DISK };
        let is_realtime = config.realtime.is_some();
        let frame = if is_realtime { Duration::from_nanos(config.period_nanos() as u64) } else { Duration::ZERO };
        let camera = after.max(frame.saturating_mul(3));
        Self { after, storage: after.max(storage), camera, has_path: config.frames[1] != OPEN_END }
    }
}

/// Restarts within a minute in real time, by default.
const REALTIME_RESTARTS: u32 = 5;
/// Seconds without progress after which a stage hangs, by default: in real time, and in exact mode,
/// where the next picture has no deadline.
const HANG_AFTER_SECS: [f64; 2] = [10.0, 30.0];

/// Which deaths of stages a flight survives, and which stages hang.
pub(super) fn restarts(args: &SupervisionArgs, config: &RunConfig) -> Result<RestartRules, Failure> {
    let is_realtime = config.realtime.is_some();
    let limit = args.restarts.unwrap_or(if is_realtime { REALTIME_RESTARTS } else { 0 });
    let seconds = args.hang_after.unwrap_or(HANG_AFTER_SECS[usize::from(!is_realtime)]);
    let hang_after = Duration::from_secs_f64(in_range("--hang-after", seconds, 1.0, 1e5, "seconds from 1 to 100000")?);
    Ok(RestartRules { limit, hang: HangRules::new(hang_after, config) })
}
