//! Reading over a network that loses, delays and lies: requests are asked again, within limits.
//!
//! ```text
//!            ┌────────────── wait: backoff with jitter, not before Retry-After ◀──┐
//!            ▼                                                                     │ passing failure, and
//!   read ─▶ ask ─▶ answer ─▶ of the same file as before? ─▶ checked ─▶ bytes       │ attempts, time, budget left
//!                    │                 │ no: Changed           │ damaged           │
//!                    └─ failure ───────┴───────────────────────┴───────────────────┴─▶ error
//! ```
//!
//! The *budget* keeps requests that are asked again in proportion to those that are asked the first time. It is for
//! failures among successes. When requests for a file fail in a row, its *breaker* opens: all reads of the file wait, and one
//! at a time asks, as a probe, until an answer comes. So a server that is away for a while costs a request now and then,
//! nothing of the budget, and no read before its deadline. When nothing has come for as long as one read may take, reads fail
//! at once, but for a probe now and then. Files have breakers of their own: a server that has one file need not have the other.

use crate::error::{Cause, Fault, FetchError};
use crate::error_log::ErrorLog;
use crate::options::{RetryOptions, StoreOptions};
use crate::transport::{Answer, Transport};
use std::collections::BTreeMap;
use std::collections::hash_map::RandomState;
use std::future::Future;
use std::hash::{BuildHasher, Hasher};
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::Semaphore;
use tokio::time::{Instant, sleep_until, timeout_at};

/// Failures in a row, without one success, that open the breaker. (Of requests a third of which are lost one in 15 000 opens it,
/// and it closes with the next answer.)
const BREAKER_FAILURES: u32 = 8;
/// While the breaker is open one request in this time goes through, at first in less.
const PROBE_EVERY: Duration = Duration::from_secs(2);
/// A file of this machine is read once more when that may help: it says the same the next time.
pub(crate) const LOCAL_RETRIES: u32 = 1;
/// Why nobody is asked when `Retry-After` ends later than the read.
const LONG_PAUSE: &str = "the server asks for fewer requests, and for a longer pause than a read may wait";

/// What is asked of a server.
#[derive(Debug, Clone)]
pub(crate) struct Request {
    /// The file of the database.
    pub(crate) file: &'static str,
    /// Its part; all of it when `None`.
    pub(crate) range: Option<Range<u64>>,
    /// The most bytes that are taken.
    pub(crate) most_bytes: u64,
    /// Requests after the first, at most.
    pub(crate) retries: u32,
    /// There is no picture without it: it is asked again whether the budget allows it or not.
    pub(crate) is_vital: bool,
}

/// The network as readers of a database see it.
#[derive(Debug)]
pub(crate) struct Network {
    transport: Transport,
    request_timeout: Duration,
    deadline: Duration,
    retries: RetryOptions,
    permits: Semaphore,
    budget: Mutex<Budget>,
    /// By file.
    breakers: Mutex<BTreeMap<&'static str, Arc<Breaker>>>,
    repeated: AtomicU64,
    log: Arc<ErrorLog>,
}

impl Network {
    pub(crate) fn new(transport: Transport, options: &StoreOptions, log: Arc<ErrorLog>) -> Self {
        Self {
            transport,
            request_timeout: options.request_timeout,
            deadline: options.deadline,
            retries: options.retries,
            permits: Semaphore::new(options.parallel_requests.max(1)),
            budget: Mutex::new(Budget::new(&options.retries)),
            breakers: Mutex::default(),
            repeated: AtomicU64::new(0),
            log,
        }
    }

    pub(crate) fn transport(&self) -> &Transport {
        &self.transport
    }

    /// Requests that were asked again.
    pub(crate) fn repeated(&self) -> u64 {
        self.repeated.load(Ordering::Relaxed)
    }

    /// Most requests after the first, of one read.
    pub(crate) fn most_retries(&self) -> u32 {
        self.retries.most
    }

    /// So many retries, or fewer where they do not help.
    pub(crate) fn retries_at_most(&self, most: u32) -> u32 {
        if self.transport.is_local() { most.min(LOCAL_RETRIES) } else { most }
    }

    /// Asks until an answer passes `check`, which turns it into what is wanted of it.
    ///
    /// # Errors
    /// The last failure, when it is final or nothing is left to try.
    pub(crate) async fn read<T, C>(&self, request: &Request, check: impl Fn(Answer) -> C) -> Result<T, FetchError>
    where
        C: Future<Output = Result<T, FetchError>>,
    {
        let end = Instant::now() + self.deadline;
        let place = self.transport.place(request.file);
        let breaker = Arc::clone(lock(&self.breakers).entry(request.file).or_default());
        lock(&self.budget).first();
        let mut attempt = 0;
        loop {
            if self.transport.wire().held_until().is_some_and(|until| until >= end) {
                let error = FetchError::failed(Cause::Throttled, LONG_PAUSE, place);
                self.note(&error);
                return Err(error);
            }
            let turn = breaker.turn(end, self.deadline).await.map_err(FetchError::Failed)?;
            let result = self.attempt(request, end, &place).await;
            let error = match result {
                Ok(answer) => {
                    breaker.succeeded();
                    drop(turn);
                    match check(answer).await {
                        Ok(checked) => return Ok(checked),
                        Err(error) => error,
                    }
                }
                Err(fault) => {
                    let fault = Arc::new(fault);
                    if fault.cause.is_passing() {
                        breaker.failed(&fault, &self.retries);
                    }
                    drop(turn);
                    FetchError::Failed(fault)
                }
            };
            self.note(&error);
            if !error.is_passing() || Instant::now() >= end || breaker.is_given_up(self.deadline) {
                return Err(error);
            }
            if !breaker.is_open() {
                let wait = backoff(&self.retries, attempt, random());
                attempt += 1;
                let is_late = attempt > self.retries_at_most(request.retries) || Instant::now() + wait >= end;
                if is_late || !(lock(&self.budget).again() || request.is_vital) {
                    return Err(error);
                }
                tokio::time::sleep(wait).await;
            }
            self.repeated.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Whether something may be asked once more, after the wait that belongs to failure `attempt` (from 0).
    pub(crate) async fn again(&self, attempt: u32) -> bool {
        if attempt >= self.retries_at_most(u32::MAX) || !lock(&self.budget).again() {
            return false;
        }
        self.repeated.fetch_add(1, Ordering::Relaxed);
        if !self.transport.is_local() {
            tokio::time::sleep(backoff(&self.retries, attempt, random())).await;
        }
        true
    }

    /// One request, not before the server wants to be asked, and not longer than it may take.
    async fn attempt(&self, request: &Request, end: Instant, place: &str) -> Result<Answer, Fault> {
        let fault = |cause, why: String| Fault { cause, why, place: place.to_owned() };
        let permit = loop {
            if let Some(until) = self.transport.wire().held_until() {
                if until >= end {
                    return Err(fault(Cause::Throttled, LONG_PAUSE.to_owned()));
                }
                sleep_until(until).await;
            }
            let Ok(permit) = timeout_at(end, self.permits.acquire()).await else {
                return Err(fault(Cause::Timeout, "its turn did not come in time".to_owned()));
            };
            // The server may have asked for quiet while this one queued.
            if self.transport.wire().held_until().is_none() {
                break permit;
            }
        };
        let (start, limit) = (Instant::now(), end.min(Instant::now() + self.request_timeout));
        let get = self.transport.get(request.file, request.range.clone(), request.most_bytes);
        let answer = timeout_at(limit, get).await;
        drop(permit);
        let (range, is_answered) = (request.range.as_ref(), matches!(answer, Ok(Ok(_))));
        tracing::trace!(file = request.file, ?range, is_answered, elapsed = ?start.elapsed(), "request");
        answer.unwrap_or_else(|_| {
            let why = format!("no complete answer within {:.0?}", self.request_timeout);
            Err(fault(Cause::Timeout, why))
        })
    }

    fn note(&self, error: &FetchError) {
        if let FetchError::Failed(fault) = error {
            self.log.note(fault);
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A random number. (The standard library seeds each of its hashers anew.)
fn random() -> u64 {
    RandomState::new().build_hasher().finish()
}

/// The wait after failure `attempt` (from 0): doubled each time, at most the longest, then between half and all of it.
fn backoff(options: &RetryOptions, attempt: u32, random: u64) -> Duration {
    let full = options.first_wait.saturating_mul(1 << attempt.min(20)).min(options.longest_wait);
    full.mul_f64(0.5 + 0.5 * (random >> 11) as f64 / (1u64 << 53) as f64)
}

/// How many requests may still be asked again.
#[derive(Debug)]
struct Budget {
    tokens: f64,
    most: f64,
    share: f64,
}

impl Budget {
    fn new(options: &RetryOptions) -> Self {
        let most = f64::from(options.burst);
        Self { tokens: most, most, share: options.share }
    }

    /// A request is asked for the first time.
    fn first(&mut self) {
        self.tokens = (self.tokens + self.share).min(self.most);
    }

    /// Whether one may be asked again.
    fn again(&mut self) -> bool {
        let is_left = self.tokens >= 1.0;
        if is_left {
            self.tokens -= 1.0;
        }
        is_left
    }
}

/// Whether there is any sense in asking for a file.
#[derive(Debug, Default)]
struct Breaker {
    row: Mutex<Row>,
    /// Held by the one that asks while the breaker is open. The others queue for it.
    probe: tokio::sync::Mutex<()>,
}

/// Failures without one success between them.
#[derive(Debug, Default)]
struct Row {
    failures: u32,
    /// When the first of them was.
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
    fn succeeded(&self) {
        *lock(&self.row) = Row::default();
    }

    fn failed(&self, fault: &Arc<Fault>, options: &RetryOptions) {
        let (mut row, now) = (lock(&self.row), Instant::now());
        row.failures = row.failures.saturating_add(1);
        row.since.get_or_insert(now);
        row.last = Some(Arc::clone(fault));
        let probes = row.failures.saturating_sub(BREAKER_FAILURES);
        row.next_probe = Some(now + backoff(options, probes, random()).min(PROBE_EVERY));
    }

    fn is_open(&self) -> bool {
        lock(&self.row).is_open()
    }

    /// Whether nothing has come for as long as a read may take.
    fn is_given_up(&self, patience: Duration) -> bool {
        lock(&self.row).is_given_up(Instant::now(), patience)
    }

    /// Waits until a request may be made; while the breaker is open, as the only one, for as long as what is returned is kept.
    ///
    /// # Errors
    /// The last failure, when the time is over, or when there is no sense in asking.
    async fn turn(
        &self,
        end: Instant,
        patience: Duration,
    ) -> Result<Option<tokio::sync::MutexGuard<'_, ()>>, Arc<Fault>> {
        let told = |row: &Row, fallback: Instant| (row.next_probe.unwrap_or(fallback), row.last.clone());
        let (next, last) = {
            let (row, now) = (lock(&self.row), Instant::now());
            if !row.is_open() {
                return Ok(None);
            }
            let (next, last) = told(&row, now);
            if row.is_given_up(now, patience) {
                // A probe is made by the first that comes when it is due; nobody waits for it.
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
            // The probe before this one may have failed, or brought an answer.
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
        // Silent for as long as a read may take: nobody waits any more.
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
