//! Whether ffmpeg takes what it is given.

use super::StreamKeeper;
use super::encoder::kill_group;
use crate::process::vitals::{BUSY, LONGEST_TICK, MARK_AFTER, Mark};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Watches the encoder of a film, and kills it when it hangs. While it computes, reads or writes,
/// or waits for a disk, it is slow and has longer. Time counts as that of stages
/// ([`crate::flight::hang`]).
#[derive(Debug)]
pub struct EncoderWatch {
    after: Duration,
    bytes: u64,
    still: Duration,
    mark: Option<Mark>,
    seen: Instant,
    hung_after: Option<Duration>,
}

impl EncoderWatch {
    /// An encoder that takes nothing for this long hangs.
    #[must_use]
    pub fn new(after: Duration) -> Self {
        Self { after, bytes: 0, still: Duration::ZERO, mark: None, seen: Instant::now(), hung_after: None }
    }

    /// Takes a look. `is_complete`: it has got all pictures, and is to end.
    pub fn look(&mut self, stream: &StreamKeeper, is_complete: bool) {
        let now = Instant::now();
        let passed = now.duration_since(self.seen).min(LONGEST_TICK);
        self.seen = now;
        let Some(pid) = stream.encoder_pid().filter(|_| self.hung_after.is_none()) else { return };
        let bytes = stream.passage.bytes.load(Ordering::Relaxed);
        if bytes != self.bytes || !(is_complete || stream.is_blocked()) {
            (self.bytes, self.still, self.mark) = (bytes, Duration::ZERO, None);
            return;
        }
        self.still += passed;
        if self.mark.is_none() && self.still >= MARK_AFTER {
            self.mark = Mark::of(pid, self.still);
        }
        let longest = self.after.saturating_mul(BUSY);
        if self.still < self.after {
            return;
        }
        let is_busy = |mark: Mark| mark.is_busy(pid, self.still) || mark.has_moved_bytes(pid);
        if self.still < longest && self.mark.is_some_and(is_busy) {
            return;
        }
        self.hung_after = Some(self.still);
        kill_group(pid);
    }

    /// For how long it had taken nothing when it was killed, if it was.
    #[must_use]
    pub fn hung_after(&self) -> Option<Duration> {
        self.hung_after
    }
}
