//! A circuit breaker for each file: when requests fail in a row, only one request at a time probes.
//!
//! ```text
//!            8 failures in a row                     an answer
//!   Closed ─────────────────────▶ Open: one probes ──────────────▶ Closed
//!                                   │      ▲
//!           nothing for a deadline  ▼      │ a probe now and then
//!                                Given up ─┘   (every read fails at once)
//! ```

use super::RetryOptions;
use super::backoff::{backoff, random};
use crate::error::Fault;
use crate::lock;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::time::{Instant, sleep_until, timeout_at};

/// Number of failures in a row, without a success, that opens the breaker. (If a third of all
/// requests are lost, one in 15 000 opens it, and the next answer closes it.)
const BREAKER_FAILURES: u32 = 8;
/// While the breaker is open, one request in this time is made; at first more often.
const PROBE_EVERY: Duration = Duration::from_secs(2);

/// Permission to make a request; only one read at a time holds that of a probe.
pub(super) type Turn<'b> = Option<tokio::sync::MutexGuard<'b, ()>>;

/// The breaker of a file.
#[derive(Debug, Default)]
pub(super) struct Breaker {
    row: Mutex<Row>,
    /// Held by the read that probes while the breaker is open. The others queue for it.
    probe: tokio::sync::Mutex<()>,
}

/// Consecutive failures.
#[derive(Debug, Default)]
struct Row {
    failures: u32,
    /// The time of the first failure.
    since: Option<Instant>,
    last: Option<Arc<Fault>>,
    next_probe: Option<Instant>,
}

impl Row {
    fn is_open(&self) -> bool {
        self.failures >= BREAKER_FAILURES
    }

    fn is_given_up(&self, now: Instant, patience: Duration) -> bool {
        self.is_open() && self.since.is_some_and(|since| now - since >= patience)
    }
}

impl Breaker {
    pub(super) fn succeeded(&self) {
        *lock(&self.row) = Row::default();
    }

    pub(super) fn failed(&self, fault: &Arc<Fault>, options: &RetryOptions) {
        let (mut row, now) = (lock(&self.row), Instant::now());
        row.failures = row.failures.saturating_add(1);
        row.since.get_or_insert(now);
        row.last = Some(Arc::clone(fault));
        let probes = row.failures.saturating_sub(BREAKER_FAILURES);
        row.next_probe = Some(now + backoff(options, probes, random()).min(PROBE_EVERY));
    }

    pub(super) fn is_open(&self) -> bool {
        lock(&self.row).is_open()
    }

    /// Whether there was no success for as long as a read may take.
    pub(super) fn is_given_up(&self, patience: Duration) -> bool {
        lock(&self.row).is_given_up(Instant::now(), patience)
    }

    /// Waits until a request may be made. While the breaker is open, it is the only one as long as
    /// the returned guard is held.
    ///
    /// # Errors
    /// The last failure, at the end of the time or when the file is given up.
    pub(super) async fn turn(&self, end: Instant, patience: Duration) -> Result<Turn<'_>, Arc<Fault>> {
        let told = |row: &Row, fallback: Instant| (row.next_probe.unwrap_or(fallback), row.last.clone());
        let (next, last) = {
            let (row, now) = (lock(&self.row), Instant::now());
            if !row.is_open() {
                return Ok(None);
            }
            let (next, last) = told(&row, now);
            if row.is_given_up(now, patience) {
                // The first read that comes when a probe is due makes it; no read waits for a
                // probe.
                return match (last, self.probe.try_lock()) {
                    (_, Ok(probe)) if next <= now => Ok(Some(probe)),
                    (Some(last), _) => Err(last),
                    (None, _) => Ok(None),
                };
            }
            (next, last)
        };
        let turn = async {
            let probe = self.probe.lock().await;
            // The previous probe may have failed or succeeded.
            let next = {
                let row = lock(&self.row);
                row.is_open().then(|| told(&row, next).0)?
            };
            sleep_until(next).await;
            self.is_open().then_some(probe)
        };
        match (timeout_at(end, turn).await, last) {
            (Ok(probe), _) => Ok(probe),
            (Err(_late), Some(last)) => Err(last),
            (Err(_late), None) => Ok(None),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Cause;

    fn quick() -> RetryOptions {
        let wait = Duration::from_millis;
        RetryOptions { first_wait: wait(2), longest_wait: wait(20), ..RetryOptions::default() }
    }

    #[tokio::test]
    async fn while_a_file_fails_in_a_row_one_asks_at_a_time_and_all_others_wait() {
        let patience = Duration::from_millis(300);
        let fault = Arc::new(Fault { cause: Cause::Connect, why: "no".into(), place: "there".into() });
        let breaker = Breaker::default();
        let end = Instant::now() + patience;
        for _ in 0..BREAKER_FAILURES {
            assert!(breaker.turn(end, patience).await.expect("a turn").is_none(), "closed");
            breaker.failed(&fault, &quick());
        }
        let mut probes = 0;
        while !breaker.is_given_up(patience) {
            let Ok(probe) = breaker.turn(end, patience).await else { break };
            assert!(probe.is_some());
            let other = breaker.turn(Instant::now() + Duration::from_millis(1), patience).await;
            assert_eq!(other.expect_err("no other"), fault);
            breaker.failed(&fault, &quick());
            probes += 1;
        }
        assert!((1..40).contains(&probes), "{probes} probes");
        // Silent for as long as a read may take: reads no longer wait.
        tokio::time::sleep(Duration::from_millis(40)).await;
        let late = Instant::now() + Duration::from_secs(600);
        let probe = breaker.turn(late, patience).await.expect("a probe is due");
        assert!(breaker.is_given_up(patience) && probe.is_some());
        assert_eq!(breaker.turn(late, patience).await.expect_err("one at a time"), fault);
        drop(probe);
        breaker.succeeded();
        assert!(breaker.turn(late, patience).await.is_ok_and(|probe| probe.is_none()), "closed again");
    }

    #[tokio::test]
    async fn whoever_waits_goes_on_when_a_probe_has_brought_an_answer() {
        let patience = Duration::from_secs(60);
        let fault = Arc::new(Fault { cause: Cause::Server, why: "500".into(), place: "there".into() });
        let breaker = Breaker::default();
        (0..BREAKER_FAILURES).for_each(|_| breaker.failed(&fault, &RetryOptions::default()));
        let end = Instant::now() + patience;
        let probe = breaker.turn(end, patience).await.expect("a turn");
        let others = futures_util::future::join_all((0..100).map(|_| breaker.turn(end, patience)));
        let answer = async {
            tokio::time::sleep(Duration::from_millis(50)).await;
            breaker.succeeded();
            drop(probe);
        };
        let (others, ()) = futures_util::future::join(others, answer).await;
        assert!(others.iter().all(|turn| matches!(turn, Ok(None))));
    }
}
