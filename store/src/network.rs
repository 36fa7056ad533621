//! Reads over a network that loses, delays and damages data: requests are repeated, within limits.
//!
//! ```text
//!            ┌────────────── wait: backoff with jitter, not before Retry-After ◀──┐
//!            ▼                                                                     │ passing failure, and
//!   read ─▶ ask ─▶ answer ─▶ of the same file as before? ─▶ checked ─▶ bytes       │ attempts, time, budget left
//!                    │                 │ no: Changed           │ damaged           │
//!                    └─ failure ───────┴───────────────────────┴───────────────────┴─▶ error
//! ```
//!
//! [`crate::retry`] decides when and how often; this module does it.

use crate::error::{Cause, Fault, FetchError};
use crate::error_log::ErrorLog;
use crate::options::StoreOptions;
use crate::retry::{Allowance, RetryPolicy};
use crate::transport::{Answer, Transport};
use std::future::Future;
use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::Semaphore;
use tokio::time::{Instant, sleep_until, timeout_at};

/// The reason for sending no request when `Retry-After` ends later than the read.
const LONG_PAUSE: &str = "the server asks for fewer requests, and for a longer pause than a read may wait";

/// A request to a server.
#[derive(Debug, Clone)]
pub(crate) struct Request {
    /// The file of the database.
    pub(crate) file: &'static str,
    /// The byte range; `None` for the whole file.
    pub(crate) range: Option<Range<u64>>,
    /// Upper bound of the bytes that are read.
    pub(crate) most_bytes: u64,
    /// How it may be repeated.
    pub(crate) allowance: Allowance,
}

/// The end of a request that did not fail.
enum Ended {
    Answered {
        answer: Answer,
        begun: Instant,
    },
    /// It waited for longer than its patience.
    Slow,
}

/// The network, with retries.
#[derive(Debug)]
pub(crate) struct Network {
    transport: Transport,
    request_timeout: Duration,
    permits: Semaphore,
    policy: RetryPolicy,
    log: Arc<ErrorLog>,
}

impl Network {
    pub(crate) fn new(transport: Transport, options: &StoreOptions, log: Arc<ErrorLog>) -> Self {
        Self {
            policy: RetryPolicy::new(options.retries, options.deadline, options.is_hasty, transport.is_local()),
            transport,
            request_timeout: options.request_timeout,
            permits: Semaphore::new(options.parallel_requests.max(1)),
            log,
        }
    }

    pub(crate) fn transport(&self) -> &Transport {
        &self.transport
    }

    /// The retry policy.
    pub(crate) fn policy(&self) -> &RetryPolicy {
        &self.policy
    }

    /// Sends requests until an answer passes `check`, which converts it into the result.
    ///
    /// # Errors
    /// The last failure, if it is final or no attempts are left.
    pub(crate) async fn read<T, C>(&self, request: &Request, check: impl Fn(Answer) -> C) -> Result<T, FetchError>
    where
        C: Future<Output = Result<T, FetchError>>,
    {
        let mut tries = self.policy.begin(request.file, request.allowance);
        let place = self.transport.place(request.file);
        loop {
            if self.transport.wire().held_until().is_some_and(|until| until >= tries.end()) {
                let error = FetchError::failed(Cause::Throttled, LONG_PAUSE, place);
                self.note(&error);
                return Err(error);
            }
            let turn = tries.turn().await.map_err(FetchError::failed_as)?;
            let patience = tries.patience(&turn);
            let result = self.request(request, tries.end(), patience, &place).await;
            let error = match result {
                Ok(Ended::Answered { mut answer, begun }) => {
                    tries.answered(begun.elapsed());
                    answer.resent_at = tries.is_resent().then(|| begun.into_std());
                    drop(turn);
                    match check(answer).await {
                        Ok(checked) => return Ok(checked),
                        Err(error) => error,
                    }
                }
                Ok(Ended::Slow) => {
                    drop(turn);
                    tries.hurry();
                    continue;
                }
                Err(fault) => {
                    let fault = Arc::new(fault);
                    tries.failed(&fault);
                    drop(turn);
                    FetchError::Failed { fault }
                }
            };
            self.note(&error);
            if !tries.again(&error).await {
                return Err(error);
            }
        }
    }

    /// Sends one request, after the server's `Retry-After` and within its timeout.
    async fn request(
        &self,
        request: &Request,
        end: Instant,
        patience: Option<Duration>,
        place: &str,
    ) -> Result<Ended, Fault> {
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
            // The server may have sent `Retry-After` while this request queued.
            if self.transport.wire().held_until().is_none() {
                break permit;
            }
        };
        let begun = Instant::now();
        let timeout = end.min(begun + self.request_timeout);
        let limit = patience.map_or(timeout, |patience| timeout.min(begun + patience));
        let get = self.transport.get(request.file, request.range.clone(), request.most_bytes);
        let answer = timeout_at(limit, get).await;
        drop(permit);
        let (range, is_answered) = (request.range.as_ref(), matches!(answer, Ok(Ok(_))));
        tracing::trace!(file = request.file, ?range, is_answered, elapsed = ?begun.elapsed(), "request");
        match answer {
            Ok(answer) => Ok(Ended::Answered { answer: answer?, begun }),
            Err(_late) if limit < timeout => Ok(Ended::Slow),
            Err(_late) => Err(fault(Cause::Timeout, format!("no complete answer within {:.0?}", self.request_timeout))),
        }
    }

    fn note(&self, error: &FetchError) {
        if let FetchError::Failed { fault } = error {
            self.log.note(fault);
        }
    }
}
