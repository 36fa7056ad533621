//! The retry policy for requests, and a read under it: from its first request to its answer or its
//! last failure.

use super::backoff::{backoff, random};
use super::breaker::{Breaker, Turn};
use super::budget::Budget;
use super::patience::{UsualTime, patience};
use super::{LOCAL_RETRIES, RetryOptions};
use crate::error::{Fault, FetchError};
use crate::lock;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::time::Instant;

/// The retry policy of one database, shared by all its reads.
#[derive(Debug)]
pub(crate) struct RetryPolicy {
    options: RetryOptions,
    deadline: Duration,
    /// The database is a local file.
    is_local: bool,
    is_hasty: bool,
    budget: Mutex<Budget>,
    /// By file: a server may have only one of them.
    breakers: Mutex<BTreeMap<&'static str, Arc<Breaker>>>,
    usual: UsualTime,
    repeated: AtomicU64,
}

/// The limits of one read.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Allowance {
    /// Maximum number of retries.
    pub(crate) retries: u32,
    /// There is no picture without it: it is repeated even if the budget is used up.
    pub(crate) is_vital: bool,
    /// It may be repeated when its answer takes much longer than usual.
    pub(crate) may_be_hasty: bool,
}

impl RetryPolicy {
    /// `deadline`: of one read. `is_local`: the database is a local file.
    pub(crate) fn new(options: RetryOptions, deadline: Duration, is_hasty: bool, is_local: bool) -> Self {
        Self {
            options,
            deadline,
            is_local,
            is_hasty: is_hasty && !is_local,
            budget: Mutex::new(Budget::new(&options)),
            breakers: Mutex::default(),
            usual: UsualTime::default(),
            repeated: AtomicU64::new(0),
        }
    }

    /// Number of requests that were repeated after a failure.
    pub(crate) fn repeated(&self) -> u64 {
        self.repeated.load(Ordering::Relaxed)
    }

    /// Most requests after the first, of one read.
    pub(crate) fn most_retries(&self) -> u32 {
        self.options.most
    }

    /// Whether the breaker of a file is open.
    pub(crate) fn is_silent(&self, file: &str) -> bool {
        lock(&self.breakers).get(file).is_some_and(|breaker| breaker.is_open())
    }

    /// Begins a read.
    pub(crate) fn begin(&self, file: &'static str, allowance: Allowance) -> Tries<'_> {
        lock(&self.budget).first();
        let breaker = Arc::clone(lock(&self.breakers).entry(file).or_default());
        let end = Instant::now() + self.deadline;
        Tries { policy: self, breaker, allowance, end, failures: 0, hasty: 0 }
    }

    /// Whether content that arrived damaged for the time number `attempt` (from 0) may be read
    /// again; waits until then.
    pub(crate) async fn again_after_damage(&self, attempt: u32, most: u32) -> bool {
        if attempt >= self.at_most(most) || !lock(&self.budget).again() {
            return false;
        }
        self.count_repeated();
        if !self.is_local {
            tokio::time::sleep(backoff(&self.options, attempt, random())).await;
        }
        true
    }

    /// The number of retries, or fewer where they do not help.
    fn at_most(&self, retries: u32) -> u32 {
        if self.is_local { retries.min(LOCAL_RETRIES) } else { retries }
    }

    fn count_repeated(&self) {
        // Relaxed: a count.
        self.repeated.fetch_add(1, Ordering::Relaxed);
    }
}

/// A read in progress.
#[derive(Debug)]
pub(crate) struct Tries<'p> {
    policy: &'p RetryPolicy,
    breaker: Arc<Breaker>,
    allowance: Allowance,
    end: Instant,
    failures: u32,
    hasty: u32,
}

impl Tries<'_> {
    /// The deadline of the read.
    pub(crate) fn end(&self) -> Instant {
        self.end
    }

    /// Waits until the next request may be made. The returned permission must be held until that
    /// request has ended.
    ///
    /// # Errors
    /// The last failure of the file, at the end of the time or when the file is given up.
    pub(crate) async fn turn(&self) -> Result<Turn<'_>, Arc<Fault>> {
        self.breaker.turn(self.end, self.policy.deadline).await
    }

    /// How long the next request waits for its answer before [`Tries::hurry`]; `None`: its whole
    /// timeout, as for a probe, on which many reads depend.
    pub(crate) fn patience(&self, turn: &Turn<'_>) -> Option<Duration> {
        let is_hasty = self.policy.is_hasty && self.allowance.may_be_hasty && turn.is_none();
        is_hasty.then(|| patience(self.policy.usual.get(), self.hasty)).flatten()
    }

    /// Records that the request was replaced by a new one, because its answer takes much longer
    /// than usual. This is not a failure.
    pub(crate) fn hurry(&mut self) {
        self.hasty += 1;
    }

    /// Whether the current request replaces an earlier one.
    pub(crate) fn is_resent(&self) -> bool {
        self.hasty > 0
    }

    /// Records an answer with its latency.
    pub(crate) fn answered(&self, took: Duration) {
        self.breaker.succeeded();
        if self.allowance.may_be_hasty {
            self.policy.usual.note(took);
        }
    }

    /// Records a failed request.
    pub(crate) fn failed(&self, fault: &Arc<Fault>) {
        if fault.cause.is_passing() {
            self.breaker.failed(fault, &self.policy.options);
        }
    }

    /// Whether to repeat the request after a failure; waits until then.
    pub(crate) async fn again(&mut self, error: &FetchError) -> bool {
        let policy = self.policy;
        if !error.is_passing() || Instant::now() >= self.end || self.breaker.is_given_up(policy.deadline) {
            return false;
        }
        // While the breaker is open, its probes set the pace, and take no attempts and no budget.
        if !self.breaker.is_open() {
            let wait = backoff(&policy.options, self.failures, random());
            self.failures += 1;
            let is_late = self.failures > policy.at_most(self.allowance.retries) || Instant::now() + wait >= self.end;
            if is_late || !(lock(&policy.budget).again() || self.allowance.is_vital) {
                return false;
            }
            tokio::time::sleep(wait).await;
        }
        policy.count_repeated();
        true
    }
}
