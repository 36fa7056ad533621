//! A bell on which one waiter sleeps and which the other side rings. It is a futex word that also
//! records whether the waiter sleeps, so that ringing costs no system call when it does not.

use crate::sync::{AtomicU32, Ordering, fence};
use std::time::Duration;

const NOBODY: u32 = 0;
const SLEEPER: u32 = 1;

/// For one waiter, in any process. A waiter that was killed in its sleep costs the other side one
/// needless system call and nothing else; a second waiter would only wake later, at the bound of
/// its sleep.
#[derive(Debug)]
#[repr(C)]
pub(crate) struct Bell {
    word: AtomicU32,
}

#[cfg(not(loom))]
const _: () = assert!(size_of::<Bell>() == 4);

/// The result of a sleep.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Slept<R> {
    /// The condition was already met.
    NotAtAll(R),
    /// The bell was rung, or the sleep was interrupted.
    UntilRung,
    /// The bound passed.
    Fully,
}

impl Bell {
    #[cfg(loom)]
    pub(crate) fn new() -> Self {
        Self { word: AtomicU32::new(NOBODY) }
    }

    /// Sleeps once, unless `attempt` succeeds: announces the sleep, tries once more, and sleeps
    /// until rung, at most for `bound`. Spurious wake-ups are possible. Either the waiter sees what
    /// was published, or the publisher sees the announcement.
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

    /// Wakes the sleeper, if there is one. To be called after publishing.
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
    // After any other outcome (woken, value changed, signal) the caller tries again.
    futex::wait(word, futex::Flags::empty(), expected, Some(&timeout)) == Err(rustix::io::Errno::TIMEDOUT)
}

#[cfg(not(loom))]
fn wake(word: &AtomicU32) {
    // Errors only concern the address, which is a valid reference; and a sleeper that is not woken
    // wakes at its bound.
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
