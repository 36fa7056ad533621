//! How long a read waits before it repeats a request.

use super::RetryOptions;
use std::collections::hash_map::RandomState;
use std::hash::{BuildHasher, Hasher};
use std::time::Duration;

/// A random number. (The standard library seeds each of its hashers anew.)
pub(super) fn random() -> u64 {
    RandomState::new().build_hasher().finish()
}

/// The wait after failure `attempt` (from 0): doubled each time, at most the longest, then between
/// half and all of it.
pub(super) fn backoff(options: &RetryOptions, attempt: u32, random: u64) -> Duration {
    let full = options.first_wait.saturating_mul(1 << attempt.min(20)).min(options.longest_wait);
    full.mul_f64(0.5 + 0.5 * (random >> 11) as f64 / (1u64 << 53) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn waits_grow_and_stay_within_bounds(attempt in 0u32..60, random: u64) {
            let options = RetryOptions::default();
            let wait = backoff(&options, attempt, random);
            prop_assert!(wait <= options.longest_wait && wait >= options.first_wait / 2);
            prop_assert!(wait <= backoff(&options, attempt + 1, u64::MAX));
            prop_assert!(backoff(&options, attempt, 0) * 2 <= backoff(&options, attempt, u64::MAX) + Duration::from_nanos(10));
        }
    }
}
