//! Threads, progress and interruption.
//!
//! Work is numbered; workers take the next number. What they make goes to its place at once
//! ([`Work::each`]) or is handed to one consumer in order of the numbers ([`Work::in_order`]), with
//! a bounded lead. So results never depend on the number of threads.

use crate::IngestError;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// How work is done: how many threads, whether to go on, what to show meanwhile.
#[derive(Debug, Clone)]
pub struct Work {
    threads: usize,
    stop: Arc<AtomicBool>,
    shows_progress: bool,
    output: PathBuf,
}

/// Turns panics of other threads, which end the scope anyway, into plain locking.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Sets a flag when a thread goes while panicking, so that the others do not wait for it.
struct PanicGuard<'a>(&'a AtomicBool, &'a Condvar);

impl Drop for PanicGuard<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.store(true, Ordering::Release);
            self.1.notify_all();
        }
    }
}

impl Work {
    /// Work with this many threads (at least one) for this output. When `stop` becomes true the
    /// work ends with [`IngestError::Interrupted`]. Progress is shown only when standard error is a
    /// terminal.
    #[must_use]
    pub fn new(threads: usize, stop: Arc<AtomicBool>, shows_progress: bool, output: PathBuf) -> Self {
        Self { threads: threads.max(1), stop, shows_progress, output }
    }

    /// Quiet work that cannot be interrupted: for tests.
    #[must_use]
    pub fn quiet(threads: usize) -> Self {
        Self::new(threads, Arc::default(), false, PathBuf::new())
    }

    /// Number of threads.
    #[must_use]
    pub fn threads(&self) -> usize {
        self.threads
    }

    /// Fails when the user has asked to stop.
    ///
    /// # Errors
    /// [`IngestError::Interrupted`].
    pub fn check(&self) -> Result<(), IngestError> {
        // Relaxed: a flag that carries no data.
        if self.stop.load(Ordering::Relaxed) {
            return Err(IngestError::Interrupted { path: self.output.clone() });
        }
        Ok(())
    }

    /// A line of progress for `total` units of work.
    #[must_use]
    pub fn progress(&self, what: &'static str, total: u64) -> ProgressBar {
        let target = if self.shows_progress { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
        let bar = ProgressBar::with_draw_target(Some(total), target);
        let template = "{msg:>18} [{bar:30}] {percent:>3} %  {per_sec}  {eta} left";
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.set_message(what);
        bar
    }

    /// Calls `job` for every number below `count`, on all threads; each thread has a `state` of its
    /// own.
    ///
    /// # Errors
    /// The first error of a job, or [`IngestError::Interrupted`].
    pub fn each<S>(
        &self,
        what: &'static str,
        count: usize,
        state: impl Fn() -> Result<S, IngestError> + Sync,
        job: impl Fn(&mut S, usize) -> Result<(), IngestError> + Sync,
    ) -> Result<(), IngestError> {
        self.in_order(what, count, state, job, |()| Ok(()))
    }

    /// Calls `job` for every number below `count`, on all threads, and `consume` on this thread
    /// with what the jobs made, in order of their numbers. At most a few results per thread are
    /// kept at a time.
    ///
    /// # Errors
    /// The first error of a job or of `consume`, or [`IngestError::Interrupted`].
    pub fn in_order<S, T: Send>(
        &self,
        what: &'static str,
        count: usize,
        state: impl Fn() -> Result<S, IngestError> + Sync,
        job: impl Fn(&mut S, usize) -> Result<T, IngestError> + Sync,
        mut consume: impl FnMut(T) -> Result<(), IngestError>,
    ) -> Result<(), IngestError> {
        let bar = self.progress(what, count as u64);
        let queue = Queue::new(count, 4 * self.threads);
        let worker = || {
            let _guard = PanicGuard(&queue.is_over, &queue.changed);
            let mut state = state();
            while let Some(index) = queue.next() {
                let result = match &mut state {
                    Ok(state) => self.check().and_then(|()| job(state, index)),
                    // Made again only to have an error to give: errors do not clone.
                    Err(error) => Err(std::mem::replace(error, IngestError::usage("a worker could not start"))),
                };
                queue.put(index, result);
            }
        };
        let outcome = std::thread::scope(|scope| {
            let _guard = PanicGuard(&queue.is_over, &queue.changed);
            let mut outcome = Ok(());
            for thread in 0..self.threads.min(count) {
                // With fewer threads it takes longer, and comes to the same.
                match std::thread::Builder::new().spawn_scoped(scope, worker) {
                    Ok(_) => {}
                    Err(source) if thread == 0 => outcome = Err(IngestError::Threads { source }),
                    Err(_enough) => break,
                }
            }
            for index in 0..count {
                if outcome.is_err() {
                    break;
                }
                let Some(result) = queue.take(index) else { break };
                outcome = result.and_then(&mut consume);
                if outcome.is_ok() {
                    bar.inc(1);
                }
            }
            queue.end();
            outcome
        });
        bar.finish_and_clear();
        outcome
    }
}

/// How many results were taken, and those that lie here.
type Results<T> = (usize, BTreeMap<usize, Result<T, IngestError>>);

/// Numbered pieces of work on their way: handed out in order, and taken back in order.
struct Queue<T> {
    count: usize,
    /// How far workers may be ahead of the consumer.
    lead: usize,
    next: AtomicUsize,
    is_over: AtomicBool,
    results: Mutex<Results<T>>,
    changed: Condvar,
}

impl<T> Queue<T> {
    fn new(count: usize, lead: usize) -> Self {
        let (next, is_over) = (AtomicUsize::new(0), AtomicBool::new(false));
        Self { count, lead, next, is_over, results: Mutex::new((0, BTreeMap::new())), changed: Condvar::new() }
    }

    /// The next number for a worker, once the consumer is near enough; `None` when there is no more
    /// to do.
    fn next(&self) -> Option<usize> {
        // Relaxed: the number itself is all that is taken.
        let index = self.next.fetch_add(1, Ordering::Relaxed);
        if index >= self.count {
            return None;
        }
        let mut results = lock(&self.results);
        while index >= results.0 + self.lead && !self.is_over.load(Ordering::Acquire) {
            results = self.changed.wait(results).unwrap_or_else(PoisonError::into_inner);
        }
        (!self.is_over.load(Ordering::Acquire)).then_some(index)
    }

    fn put(&self, index: usize, result: Result<T, IngestError>) {
        lock(&self.results).1.insert(index, result);
        self.changed.notify_all();
    }

    /// What came of a number, waited for; `None` when a worker panicked.
    fn take(&self, index: usize) -> Option<Result<T, IngestError>> {
        let mut results = lock(&self.results);
        let result = loop {
            if let Some(result) = results.1.remove(&index) {
                break Some(result);
            }
            if self.is_over.load(Ordering::Acquire) {
                break None;
            }
            results = self.changed.wait(results).unwrap_or_else(PoisonError::into_inner);
        };
        results.0 = index + 1;
        drop(results);
        self.changed.notify_all();
        result
    }

    /// Lets workers go that wait.
    fn end(&self) {
        self.is_over.store(true, Ordering::Release);
        // Taken so that no worker is between its check and its wait when it is woken.
        drop(lock(&self.results));
        self.changed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_come_in_order_for_any_number_of_threads() {
        for threads in [1, 2, 7] {
            let mut seen = Vec::new();
            let work = Work::quiet(threads);
            let slow_first = |_: &mut (), i: usize| {
                if i.is_multiple_of(5) {
                    std::thread::yield_now();
                }
                Ok(i)
            };
            work.in_order(
                "",
                100,
                || Ok(()),
                slow_first,
                |i| {
                    seen.push(i);
                    Ok(())
                },
            )
            .unwrap();
            assert_eq!(seen, (0..100).collect::<Vec<_>>());
        }
    }

    #[test]
    fn an_error_ends_the_work() {
        let work = Work::quiet(3);
        let fails = |_: &mut (), i: usize| if i == 40 { Err(IngestError::usage("forty")) } else { Ok(()) };
        let error = work.each("", 1_000_000, || Ok(()), fails).unwrap_err();
        assert_eq!(error.to_string(), "forty");
    }

    #[test]
    fn a_flag_interrupts() {
        let stop = Arc::new(AtomicBool::new(false));
        let work = Work::new(2, Arc::clone(&stop), false, PathBuf::from("w.tv"));
        let job = |_: &mut (), i: usize| {
            if i == 10 {
                stop.store(true, Ordering::Relaxed);
            }
            Ok(())
        };
        let error = work.each("", 1_000_000, || Ok(()), job).unwrap_err();
        assert_eq!(error.exit_code(), 130);
    }
}
