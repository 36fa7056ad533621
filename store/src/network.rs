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
//! The *budget* keeps requests that are asked again in proportion to those that are asked the first time. The *breaker*
//! opens when nothing has come for as long as one read may take: from then on reads fail at once, but for a probe now
//! and then.

use crate::error::{Cause, Fault, FetchError};
use crate::error_log::ErrorLog;
use crate::options::{RetryOptions, StoreOptions};
use crate::transport::{Answer, Transport};
use std::collections::hash_map::RandomState;
use std::future::Future;
use std::hash::{BuildHasher, Hasher};
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::Semaphore;
use tokio::time::{Instant, sleep_until, timeout_at};

/// Failures in a row, without one success, that open the breaker.
const BREAKER_FAILURES: u32 = 16;
/// While the breaker is open one read in this time goes through.
const PROBE_EVERY: Duration = Duration::from_secs(2);

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
    breaker: Mutex<Breaker>,
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
            breaker: Mutex::default(),
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
        lock(&self.breaker).pass(Instant::now(), self.deadline).map_err(FetchError::Failed)?;
        lock(&self.budget).first();
        let mut attempt = 0;
        loop {
            let error = match self.attempt(request, end, &place).await {
                Ok(answer) => {
                    lock(&self.breaker).succeeded();
                    match check(answer).await {
                        Ok(checked) => return Ok(checked),
                        Err(error) => error,
                    }
                }
                Err(fault) => {
                    let fault = Arc::new(fault);
                    if fault.cause.is_passing() {
                        lock(&self.breaker).failed(Instant::now(), &fault);
                    }
                    FetchError::Failed(fault)
                }
            };
            self.note(&error);
            let wait = backoff(&self.retries, attempt, random());
            let is_held = self.transport.wire().held_until().is_some_and(|until| until >= end);
            let is_late = is_held || Instant::now() + wait >= end;
            attempt += 1;
            if !error.is_passing() || attempt > request.retries || is_late || !lock(&self.budget).again() {
                return Err(error);
            }
            self.repeated.fetch_add(1, Ordering::Relaxed);
            tokio::time::sleep(wait).await;
        }
    }

    /// Whether something may be asked once more, after the wait that belongs to failure `attempt` (from 0).
    pub(crate) async fn again(&self, attempt: u32) -> bool {
        if !lock(&self.budget).again() {
            return false;
        }
        self.repeated.fetch_add(1, Ordering::Relaxed);
        tokio::time::sleep(backoff(&self.retries, attempt, random())).await;
        true
    }

    /// One request, not before the server wants to be asked, and not longer than it may take.
    async fn attempt(&self, request: &Request, end: Instant, place: &str) -> Result<Answer, Fault> {
        let fault = |cause, why: String| Fault { cause, why, place: place.to_owned() };
        let permit = loop {
            if let Some(until) = self.transport.wire().held_until() {
                if until >= end {
                    return Err(fault(
                        Cause::Throttled,
                        "the server asks for fewer requests, and for a longer pause than a read may wait".to_owned(),
                    ));
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
        let limit = end.min(Instant::now() + self.request_timeout);
        let get = self.transport.get(request.file, request.range.clone(), request.most_bytes);
        let answer = timeout_at(limit, get).await;
        drop(permit);
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

/// Whether there is any sense in asking.
#[derive(Debug, Default)]
struct Breaker {
    failures: u32,
    first_failure: Option<Instant>,
    last: Option<Arc<Fault>>,
    next_probe: Option<Instant>,
}

impl Breaker {
    fn succeeded(&mut self) {
        *self = Self::default();
    }

    fn failed(&mut self, now: Instant, fault: &Arc<Fault>) {
        self.failures += 1;
        self.first_failure.get_or_insert(now);
        self.last = Some(Arc::clone(fault));
    }

    /// Whether a read may go ahead; the last failure, when there is no sense in it.
    fn pass(&mut self, now: Instant, patience: Duration) -> Result<(), Arc<Fault>> {
        let (Some(first), Some(last)) = (self.first_failure, &self.last) else { return Ok(()) };
        if self.failures < BREAKER_FAILURES || now - first < patience {
            return Ok(());
        }
        if self.next_probe.is_none_or(|probe| probe <= now) {
            self.next_probe = Some(now + PROBE_EVERY);
            return Ok(());
        }
        Err(Arc::clone(last))
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

    #[test]
    fn the_breaker_opens_after_long_silence_and_lets_probes_through() {
        let patience = Duration::from_secs(60);
        let start = Instant::now();
        let fault = Arc::new(Fault { cause: Cause::Connect, why: "no".into(), place: "there".into() });
        let mut breaker = Breaker::default();
        for _ in 0..100 {
            breaker.failed(start, &fault);
        }
        assert!(breaker.pass(start + patience / 2, patience).is_ok(), "not yet");
        let late = start + patience;
        assert!(breaker.pass(late, patience).is_ok(), "a probe");
        assert_eq!(breaker.pass(late, patience), Err(Arc::clone(&fault)));
        assert!(breaker.pass(late + PROBE_EVERY, patience).is_ok(), "the next probe");
        breaker.succeeded();
        assert!(breaker.pass(late, patience).is_ok() && breaker.pass(late, patience).is_ok());
    }
}
