//! The retry budget: how many requests may still be repeated.

use super::RetryOptions;

/// Tokens: each first request adds a share of a token, each repeated request takes one.
#[derive(Debug)]
pub(super) struct Budget {
    tokens: f64,
    most: f64,
    share: f64,
}

impl Budget {
    pub(super) fn new(options: &RetryOptions) -> Self {
        let most = f64::from(options.burst);
        Self { tokens: most, most, share: options.share }
    }

    /// Records a first request.
    pub(super) fn first(&mut self) {
        self.tokens = (self.tokens + self.share).min(self.most);
    }

    /// Takes a token for a repeated request; `false` when none is left.
    pub(super) fn again(&mut self) -> bool {
        let is_left = self.tokens >= 1.0;
        if is_left {
            self.tokens -= 1.0;
        }
        is_left
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn requests_asked_again_stay_in_proportion(asked in prop::collection::vec(any::<bool>(), 0..2000)) {
            let options = RetryOptions { share: 0.5, burst: 10, ..RetryOptions::default() };
            let mut budget = Budget::new(&options);
            let (mut first, mut again) = (0u32, 0u32);
            for is_first in asked {
                if is_first {
                    budget.first();
                    first += 1;
                } else if budget.again() {
                    again += 1;
                }
                prop_assert!(f64::from(again) <= 10.0 + 0.5 * f64::from(first));
            }
        }
    }
}
