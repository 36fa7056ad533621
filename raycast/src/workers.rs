//! A pool of threads that share the lines of a frame.

use rustix::time::{ClockId, clock_gettime};
use std::ops::{Add, Range};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Threads could not be started.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[error("cannot start {count} threads for rays: {source}")]
pub struct WorkersError {
    /// How many were wanted.
    count: usize,
    /// Why.
    #[source]
    source: rayon::ThreadPoolBuildError,
}

/// A fixed number of threads; the calling thread is the first of them. They live until this is
/// dropped. To share a frame between them allocates nothing.
#[derive(Debug)]
pub struct Workers {
    count: usize,
    pool: Option<rayon::ThreadPool>,
    /// Processor time of all threads together since it was last taken, nanoseconds.
    busy_nanos: AtomicU64,
}

impl Workers {
    /// Starts `count` threads, at least one.
    ///
    /// # Errors
    /// The system gives none.
    pub fn new(count: usize) -> Result<Self, WorkersError> {
        let count = count.max(1);
        if count == 1 {
            return Ok(Self { count, pool: None, busy_nanos: AtomicU64::new(0) });
        }
        let name = |index| format!("rays-{index}");
        let builder = || rayon::ThreadPoolBuilder::new().num_threads(count).thread_name(name);
        // As a member of the pool, the calling thread works instead of waiting, and hands over work
        // without a queue that allocates. A thread can be a member of only one pool; a second pool
        // gets threads of its own.
        let pool = builder().use_current_thread().build().or_else(|_| builder().build());
        let pool = Some(pool.map_err(|source| WorkersError { count, source })?);
        Ok(Self { count, pool, busy_nanos: AtomicU64::new(0) })
    }

    /// How many there are.
    #[must_use]
    pub fn count(&self) -> usize {
        self.count
    }

    /// Processor time that work has taken since this was called last, of all threads together.
    pub fn take_busy(&self) -> Duration {
        // Relaxed: the caller has waited for the work, and joins order what it did.
        Duration::from_nanos(self.busy_nanos.swap(0, Ordering::Relaxed))
    }

    /// Does a part of the work on the calling thread, and counts its time.
    fn timed<T>(&self, work: impl FnOnce() -> T) -> T {
        let started = thread_nanos();
        let made = work();
        self.busy_nanos.fetch_add(thread_nanos().saturating_sub(started), Ordering::Relaxed);
        made
    }

    /// Lets each worker do `work(its number)`, waits for all, and adds up the results.
    pub fn run<T: Add<Output = T> + Send>(&self, work: impl Fn(usize) -> T + Sync) -> T {
        let work = |worker| self.timed(|| work(worker));
        match &self.pool {
            None => work(0),
            Some(pool) => pool.install(|| share(&work, 0, self.count)),
        }
    }

    /// Lets workers fill the parts of `out` that belong to `count` items; the part of item `i`
    /// begins at `at(i)`. Each worker gets neighbouring items and their parts.
    pub fn split<T: Send>(
        &self,
        count: usize,
        out: &mut [T],
        at: &(impl Fn(usize) -> usize + Sync),
        work: &(impl Fn(Range<usize>, &mut [T]) + Sync),
    ) {
        let work = |range: Range<usize>, out: &mut [T]| self.timed(|| work(range, out));
        match &self.pool {
            None => work(0..count, out),
            Some(pool) => pool.install(|| split(0..count, self.count, out, at, &work)),
        }
    }
}

/// Processor time of the calling thread.
fn thread_nanos() -> u64 {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    now.tv_sec.cast_unsigned() * 1_000_000_000 + now.tv_nsec.cast_unsigned()
}

/// Halves items and their parts of `out` until there are this many tasks.
fn split<T: Send>(
    range: Range<usize>,
    parts: usize,
    out: &mut [T],
    at: &(impl Fn(usize) -> usize + Sync),
    work: &(impl Fn(Range<usize>, &mut [T]) + Sync),
) {
    if parts < 2 || range.len() < 2 {
        return work(range, out);
    }
    let middle = range.start + range.len() / 2;
    let (before, after) = out.split_at_mut(at(middle) - at(range.start));
    rayon::join(
        || split(range.start..middle, parts / 2, before, at, work),
        || split(middle..range.end, parts - parts / 2, after, at, work),
    );
}

/// Halves the range of workers until one is left: joins live on the stack.
fn share<T: Add<Output = T> + Send>(work: &(impl Fn(usize) -> T + Sync), first: usize, end: usize) -> T {
    if end - first == 1 {
        return work(first);
    }
    let middle = first + (end - first) / 2;
    let (a, b) = rayon::join(|| share(work, first, middle), || share(work, middle, end));
    a + b
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_worker_does_its_part_once() {
        for count in [0, 1, 2, 3, 7] {
            let workers = Workers::new(count).unwrap();
            assert_eq!(workers.run(|n| 1u64 << (8 * n)), (0..count.max(1)).map(|n| 1u64 << (8 * n)).sum::<u64>());
            assert!(workers.take_busy() > Duration::ZERO && workers.take_busy() == Duration::ZERO);
        }
    }

    #[test]
    fn every_item_is_filled_once() {
        for (count, items) in [(1, 5), (2, 5), (3, 1), (5, 0), (7, 100)] {
            let ends: Vec<usize> = (0..=items).map(|n: usize| n * (n + 1) / 2).collect();
            let mut out = vec![0; ends[items]];
            Workers::new(count).unwrap().split(items, &mut out, &|item| ends[item], &|range, out| {
                assert_eq!(out.len(), ends[range.end] - ends[range.start]);
                out.iter_mut().for_each(|value| *value += 1);
            });
            assert!(out.iter().all(|value| *value == 1));
        }
    }
}
