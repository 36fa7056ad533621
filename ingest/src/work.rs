//! Threads, progress and interruption.
//!
//! Work is numbered; workers take the next number. What they make goes to its place at once ([`Work::each`]) or is
//! handed to one consumer in order of the numbers ([`Work::in_order`]), with a bounded lead. So results never depend on
//! the number of threads.

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
    /// Work with so many threads (at least one) for this output. When `stop` becomes true the work ends with
    /// [`IngestError::Interrupted`]. Progress is shown only when standard error is a terminal.
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

    /// Calls `job` for every number below `count`, on all threads; each thread has a `state` of its own.
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

    /// Calls `job` for every number below `count`, on all threads, and `consume` on this thread with what the jobs
    /// made, in order of their numbers. At most a few results per thread are kept at a time.
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
        let window = 4 * self.threads;
        let next = AtomicUsize::new(0);
        let is_over = AtomicBool::new(false);
        let results = Mutex::new((0usize, BTreeMap::<usize, Result<T, IngestError>>::new()));
        let changed = Condvar::new();
        let worker = || {
            let _guard = PanicGuard(&is_over, &changed);
            let mut state = state();
            loop {
                // Relaxed: the number itself is all that is taken.
                let index = next.fetch_add(1, Ordering::Relaxed);
                if index >= count {
                    return;
                }
                let mut guard = lock(&results);
                while index >= guard.0 + window && !is_over.load(Ordering::Acquire) {
                    guard = changed.wait(guard).unwrap_or_else(PoisonError::into_inner);
                }
                drop(guard);
                if is_over.load(Ordering::Acquire) {
                    return;
                }
                let result = match &mut state {
                    Ok(state) => self.check().and_then(|()| job(state, index)),
                    // Made again only to have an error to give: errors do not clone.
                    Err(error) => Err(std::mem::replace(error, IngestError::usage("a worker could not start"))),
                };
                lock(&results).1.insert(index, result);
                changed.notify_all();
            }
        };
        let outcome = std::thread::scope(|scope| {
            let _guard = PanicGuard(&is_over, &changed);
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
                let mut guard = lock(&results);
                let result = loop {
                    if let Some(result) = guard.1.remove(&index) {
                        break Some(result);
                    }
                    if is_over.load(Ordering::Acquire) {
                        break None;
                    }
                    guard = changed.wait(guard).unwrap_or_else(PoisonError::into_inner);
                };
                guard.0 = index + 1;
                drop(guard);
                changed.notify_all();
                outcome = match result {
                    Some(result) => result.and_then(&mut consume),
                    None => break,
                };
                if outcome.is_err() {
                    break;
                }
                bar.inc(1);
            }
            is_over.store(true, Ordering::Release);
            // Taken so that no worker is between its check and its wait when it is woken.
            drop(lock(&results));
            changed.notify_all();
            outcome
        });
        bar.finish_and_clear();
        outcome
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
