//! A bell that one waiter sleeps on and the other side rings: a futex word that is also the sign
//! that somebody sleeps, so that ringing costs no system call while nobody does.

use crate::sync::{AtomicU32, Ordering, fence};
use std::time::Duration;

const NOBODY: u32 = 0;
const SLEEPER: u32 = 1;

/// One waiter, in whichever process. A waiter that was killed in its sleep costs the other side one
/// needless system call and nothing else; a second waiter would only wake later, at the bound of
/// its sleep.
#[derive(Debug)]
#[repr(C)]
pub(crate) struct Bell {
    word: AtomicU32,
}

#[cfg(not(loom))]
const _: () = assert!(size_of::<Bell>() == 4);

/// How a sleep went.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Slept<R> {
    /// What was waited for was there.
    NotAtAll(R),
    /// Somebody rang, or the sleep was disturbed.
    UntilRung,
    /// The bound passed.
    Fully,
}

impl Bell {
    #[cfg(loom)]
    pub(crate) fn new() -> Self {
        Self { word: AtomicU32::new(NOBODY) }
    }

    /// One sleep, unless `attempt` finds what is waited for: announces the sleep, looks once more,
    /// and sleeps until rung, at most for `bound`. Wakes without cause are possible. Either the
    /// waiter sees what was published, or the publisher sees the announcement.
    pub(crate) fn sleep_unless<R, E>(
        &self,
        bound: Duration,
        attempt: impl FnOnce() -> Result<Option<R>, E>,
    ) -> Result<Slept<R>, E> {
        // Relaxed: the fence orders it. SYNC bell.sleep: pairs with the fence in `ring`, in one
        // total order of fences.
        self.word.store(SLEEPER, Ordering::Relaxed);
        fence(Ordering::SeqCst);
        let attempted = attempt();
        let slept = match attempted {
            Ok(None) if wait(&self.word, SLEEPER, bound) => Ok(Slept::Fully),
            Ok(None) => Ok(Slept::UntilRung),
            Ok(Some(found)) => Ok(Slept::NotAtAll(found)),
            Err(error) => Err(error),
        };
        // Relaxed: a late zero costs a needless wake, and an early one nothing.
        self.word.store(NOBODY, Ordering::Relaxed);
        slept
    }

    /// Wakes the sleeper, if there is one. Called after what it waits for was published.
    pub(crate) fn ring(&self) {
        // SYNC bell.sleep: what was published before this fence is seen by a waiter whose fence
        // comes later; a waiter whose fence came earlier has its announcement seen here.
        fence(Ordering::SeqCst);
        // Relaxed: the fence ordered it.
        if self.word.load(Ordering::Relaxed) == SLEEPER {
            self.word.store(NOBODY, Ordering::Relaxed);
            wake(&self.word);
        }
    }
}

/// A futex shared between processes: no `PRIVATE` flag, with which a wake stays within its process.
#[cfg(not(loom))]
fn wait(word: &AtomicU32, expected: u32, bound: Duration) -> bool {
    use rustix::thread::futex;
    let timeout = futex::Timespec {
        tv_sec: bound.as_secs().cast_signed(),
        tv_nsec: i64::from(bound.subsec_nanos()) as futex::Nsecs,
    };
    // Any other outcome (woken, value changed, signal) sends the caller to look again.
    futex::wait(word, futex::Flags::empty(), expected, Some(&timeout)) == Err(rustix::io::Errno::TIMEDOUT)
}

#[cfg(not(loom))]
fn wake(word: &AtomicU32) {
    // The only errors are of the address, which is a reference; and a sleeper that is not woken
    // wakes by its bound.
    rustix::thread::futex::wake(word, rustix::thread::futex::Flags::empty(), i32::MAX.cast_unsigned()).ok();
}

/// Under the model checker a sleep has no bound: a lost wake is a run that never ends, which the
/// checker reports.
#[cfg(loom)]
fn wait(word: &AtomicU32, expected: u32, _bound: Duration) -> bool {
    while word.load(Ordering::Relaxed) == expected {
        loom::thread::yield_now();
    }
    false
}

#[cfg(loom)]
fn wake(_word: &AtomicU32) {}
