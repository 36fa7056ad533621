//! What the server does wrong, and when.

/// One way not to answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Fault {
    /// The connection is closed without an answer.
    Drop,
    /// A status, with `Retry-After` if that is told.
    Status(u16, Option<u64>),
    /// No answer, ever.
    Hang,
    /// Half of the answer, then the connection is closed.
    Truncate,
    /// The length that is told is not that of the answer: 100 bytes more, and they come.
    TooLong,
    /// A range that was not asked for: everything is told and sent one byte further.
    Shifted,
    /// The answer's length is right and its content is not.
    Garbage,
    /// A page for people, as if it were the file.
    WebPage,
    /// The answer is elsewhere, and so for ever.
    RedirectLoop,
    /// All of the file, as if no range had been asked for.
    IgnoreRange,
    /// The answer comes, but this many milliseconds late.
    Late(u64),
}

/// When a fault strikes.
#[derive(Debug, Clone)]
pub struct Rule {
    fault: Fault,
    path: String,
    percent: u64,
    skip: u64,
    most: u64,
}

impl Rule {
    /// At every request.
    #[must_use]
    pub fn new(fault: Fault) -> Self {
        Self { fault, path: String::new(), percent: 100, skip: 0, most: u64::MAX }
    }

    /// Only at requests for a path that ends so.
    #[must_use]
    pub fn of(mut self, path: &str) -> Self {
        path.clone_into(&mut self.path);
        self
    }

    /// Only at this share of requests, spread by a fixed pattern.
    #[must_use]
    pub fn percent(mut self, percent: u64) -> Self {
        self.percent = percent;
        self
    }

    /// Only after this many requests.
    #[must_use]
    pub fn after(mut self, skip: u64) -> Self {
        self.skip = skip;
        self
    }

    /// Only at this many requests.
    #[must_use]
    pub fn times(mut self, most: u64) -> Self {
        self.most = most;
        self
    }

    pub(crate) fn fault(&self) -> Fault {
        self.fault.clone()
    }

    pub(crate) fn fits(&self, path: &str) -> bool {
        path.ends_with(&self.path)
    }

    /// Whether it strikes at the request of this number, counted from 0 among those that fit.
    pub(crate) fn strikes(&self, number: u64) -> bool {
        let is_within = number >= self.skip && number - self.skip < self.most;
        // Fibonacci hashing spreads consecutive numbers evenly over 0..100.
        let spread = ((number.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32) * 100) >> 32;
        is_within && spread < self.percent
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_share_of_requests_is_struck_and_spread() {
        let rule = Rule::new(Fault::Drop).percent(30);
        let struck = |range: std::ops::Range<u64>| range.filter(|n| rule.strikes(*n)).count();
        for start in (0..1000).step_by(100) {
            assert!((25..=35).contains(&struck(start..start + 100)));
        }
        let some = Rule::new(Fault::Drop).after(3).times(2);
        assert_eq!((0..10).filter(|n| some.strikes(*n)).collect::<Vec<_>>(), [3, 4]);
    }
}
