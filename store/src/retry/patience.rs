//! How long a request for a tile waits for its answer before it is repeated, although nothing has
//! failed. On a link that loses requests silently, tiles would otherwise be missing until the
//! timeout.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// The first request waits for this long, or four times the usual latency if that is longer ...
const FIRST_PATIENCE: Duration = Duration::from_millis(600);
/// ... each further request twice as long; after this many requests the last one has the whole
/// timeout.
const HASTY_TRIES: u32 = 5;

/// The patience of a request after `tries` unanswered ones, when answers usually take `usual`.
/// `None`: its whole timeout.
#[must_use]
pub fn patience(usual: Duration, tries: u32) -> Option<Duration> {
    (tries < HASTY_TRIES).then(|| FIRST_PATIENCE.max(usual.saturating_mul(4)).saturating_mul(1 << tries))
}

/// The usual latency, smoothed.
#[derive(Debug, Default)]
pub(super) struct UsualTime {
    /// Nanoseconds; 0 before the first answer.
    nanos: AtomicU64,
}

impl UsualTime {
    pub(super) fn get(&self) -> Duration {
        // Relaxed, here and below: only statistics, and a lost update does no harm.
        Duration::from_nanos(self.nanos.load(Ordering::Relaxed))
    }

    /// Records the latency of an answer.
    pub(super) fn note(&self, took: Duration) {
        let took = u64::try_from(took.as_nanos()).unwrap_or(u64::MAX);
        let smoothed = match self.nanos.load(Ordering::Relaxed) {
            0 => took,
            before => before - before / 8 + took / 8,
        };
        self.nanos.store(smoothed.max(1), Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patience_grows_with_each_request_and_then_the_last_one_has_its_timeout() {
        let waits = |usual_ms| {
            let waits = (0..7).map_while(|tries| patience(Duration::from_millis(usual_ms), tries));
            waits.map(|wait| wait.as_millis()).collect::<Vec<_>>()
        };
        assert_eq!(waits(0), [600, 1200, 2400, 4800, 9600]);
        assert_eq!(waits(50), waits(0), "a fast link is not asked more often");
        assert_eq!(waits(1000), [4000, 8000, 16_000, 32_000, 64_000]);
    }

    #[test]
    fn what_is_usual_follows_the_answers() {
        let usual = UsualTime::default();
        assert_eq!(usual.get(), Duration::ZERO);
        usual.note(Duration::from_millis(80));
        assert_eq!(usual.get(), Duration::from_millis(80));
        (0..60).for_each(|_| usual.note(Duration::from_millis(400)));
        assert!((395..=400).contains(&usual.get().as_millis()), "{:?}", usual.get());
        usual.note(Duration::MAX);
        assert!(usual.get() > Duration::from_secs(3600));
    }
}
