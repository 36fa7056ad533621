//! Whether a process does anything, by what `/proc` says of it.

use std::fs;
use std::time::Duration;

/// Processor time of a process is told in ticks of this many a second, on every Linux.
const TICKS_PER_SECOND: f64 = 100.0;
/// A process that computes gets this share of a core at least, also on a machine with far too much
/// to do. Loops that only look whether there is something to do stay below.
const LEAST_SHARE: f64 = 0.05;

/// A process that computes is slow and does not hang: it has this many times as long. A frame may
/// be very large, and the machine have other work.
pub(crate) const BUSY: u32 = 20;
/// A process is marked when it has shown no progress for this long.
pub(crate) const MARK_AFTER: Duration = Duration::from_millis(500);
/// Longest time that counts between two looks: more means that this program was stopped itself
/// (Ctrl-Z).
pub(crate) const LONGEST_TICK: Duration = Duration::from_secs(1);

/// What a process had done at a moment.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Mark {
    cpu_s: f64,
    io_bytes: u64,
    at: Duration,
}

impl Mark {
    /// Of now; `at` is a time on the caller's clock. `None` when the process is gone.
    pub(crate) fn of(pid: u32, at: Duration) -> Option<Self> {
        Some(Self { cpu_s: cpu_s(pid)?, io_bytes: io_bytes(pid).unwrap_or(0), at })
    }

    /// Whether the process has computed since, or waits for a disk now.
    pub(crate) fn is_busy(&self, pid: u32, now: Duration) -> bool {
        let wanted_s = LEAST_SHARE * now.saturating_sub(self.at).as_secs_f64();
        cpu_s(pid).is_some_and(|cpu_s| cpu_s - self.cpu_s >= wanted_s && cpu_s > self.cpu_s) || awaits_disk(pid)
    }

    /// Whether it has read or written anything since.
    pub(crate) fn has_moved_bytes(&self, pid: u32) -> bool {
        io_bytes(pid).is_some_and(|bytes| bytes != self.io_bytes)
    }
}

/// The fields of a `stat` file behind the name of the program, from the state on.
fn fields(path: &str) -> Option<Vec<String>> {
    let text = fs::read_to_string(path).ok()?;
    let (_, rest) = text.rsplit_once(')')?;
    Some(rest.split_whitespace().map(str::to_owned).collect())
}

/// Processor time of all threads, seconds (proc(5): utime and stime, 12th and 13th from the state
/// on).
fn cpu_s(pid: u32) -> Option<f64> {
    let fields = fields(&format!("/proc/{pid}/stat"))?;
    let ticks = |index: usize| fields.get(index)?.parse::<f64>().ok();
    Some((ticks(11)? + ticks(12)?) / TICKS_PER_SECOND)
}

/// Bytes that it has read and written, wherever from and to.
fn io_bytes(pid: u32) -> Option<u64> {
    let text = fs::read_to_string(format!("/proc/{pid}/io")).ok()?;
    let of = |name: &str| text.lines().find_map(|line| line.strip_prefix(name)?.trim().parse::<u64>().ok());
    Some(of("rchar:")?.wrapping_add(of("wchar:")?))
}

/// Whether one of its threads is in a wait that no signal ends: for a disk, or a file system over a
/// network.
fn awaits_disk(pid: u32) -> bool {
    let Ok(threads) = fs::read_dir(format!("/proc/{pid}/task")) else { return false };
    let mut states =
        threads.filter_map(|thread| fields(thread.ok()?.path().join("stat").to_str()?)?.into_iter().next());
    states.any(|state| state == "D")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Instant;

    #[test]
    fn a_process_that_computes_is_busy_and_one_that_sleeps_is_not() {
        let own = std::process::id();
        let mark = Mark::of(own, Duration::ZERO).unwrap();
        let start = Instant::now();
        let mut sum = 0u64;
        while cpu_s(own).unwrap() - mark.cpu_s < 0.1 && start.elapsed() < Duration::from_secs(60) {
            sum = std::hint::black_box(sum.wrapping_mul(31).wrapping_add(7));
        }
        assert!(mark.is_busy(own, Duration::from_millis(200)) && mark.has_moved_bytes(own));
        let mut sleeper = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        // It reads the libraries that it is linked with, and then nothing.
        std::thread::sleep(Duration::from_millis(500));
        let mark = Mark::of(sleeper.id(), Duration::ZERO).unwrap();
        std::thread::sleep(Duration::from_millis(50));
        assert!(!mark.is_busy(sleeper.id(), Duration::from_secs(1)));
        sleeper.kill().unwrap();
        sleeper.wait().unwrap();
        assert!(Mark::of(sleeper.id(), Duration::ZERO).is_none());
    }
}
