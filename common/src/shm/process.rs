//! Whether a process is alive. A process is identified by its id and its start time, because ids
//! are reused.

use super::error::ShmError;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::OwnedFd;
use rustix::io::Errno;
use rustix::process::{Pid, PidfdFlags, pidfd_open};
use std::ffi::CStr;
use std::io::{Cursor, Write as _};

/// A process, identified so that a later one with the same id is not mistaken for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) struct ProcessId {
    pub(crate) pid: u32,
    /// Clock ticks from boot to its start.
    pub(crate) start_time: u64,
}

impl ProcessId {
    /// This process.
    pub(crate) fn own() -> Result<Self, ShmError> {
        let pid = std::process::id();
        match read_stat(pid) {
            Ok(Some(stat)) => Ok(Self { pid, start_time: stat.start_time }),
            Ok(None) => Err(ShmError::Os { action: "read", name: "/proc/self/stat".into(), source: Errno::NOENT }),
            Err(source) => Err(ShmError::Os { action: "read", name: "/proc/self/stat".into(), source }),
        }
    }

    /// Whether it runs (a zombie does not). If the system does not tell, it counts as running:
    /// nothing is ever removed on a guess.
    pub(crate) fn is_alive(self) -> bool {
        match read_stat(self.pid) {
            Ok(Some(stat)) => stat.start_time == self.start_time && !stat.has_exited,
            Ok(None) => false,
            Err(_) => true,
        }
    }

    /// A number that identifies it and is never 0: the id, and the low half of the start time
    /// (which wraps after 497 days).
    pub(crate) fn word(self) -> u64 {
        u64::from(self.pid) << 32 | (self.start_time & 0xffff_ffff)
    }

    /// Whether the process that [`ProcessId::word`] named runs.
    pub(crate) fn is_word_alive(word: u64) -> bool {
        match read_stat((word >> 32) as u32) {
            Ok(Some(stat)) => stat.start_time & 0xffff_ffff == word & 0xffff_ffff && !stat.has_exited,
            Ok(None) => false,
            Err(_) => true,
        }
    }
}

/// Watches whether a process is alive, at low cost.
#[derive(Debug)]
pub(crate) struct Watch {
    id: ProcessId,
    /// Reports its end reliably; absent where the kernel does not support it, and for this process
    /// itself.
    pidfd: Option<OwnedFd>,
    is_own: bool,
}

impl Watch {
    pub(crate) fn of(id: ProcessId) -> Result<Self, ShmError> {
        let is_own = ProcessId::own()? == id;
        let raw = i32::try_from(id.pid).ok().and_then(Pid::from_raw);
        let pidfd = raw.filter(|_| !is_own).and_then(|pid| pidfd_open(pid, PidfdFlags::empty()).ok());
        // The id may have been reused before the open: check the start time.
        let pidfd = pidfd.filter(|_| id.is_alive());
        Ok(Self { id, pidfd, is_own })
    }

    pub(crate) fn is_alive(&self) -> bool {
        if self.is_own {
            return true;
        }
        let Some(pidfd) = &self.pidfd else { return self.id.is_alive() };
        let mut fds = [PollFd::new(pidfd, PollFlags::IN)];
        // Readable means that it has exited. After an interrupted poll it counts as alive until the
        // next check.
        !matches!(poll(&mut fds, Some(&Timespec::default())), Ok(1..))
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Stat {
    start_time: u64,
    has_exited: bool,
}

/// Reads `/proc/<pid>/stat`; `None` when there is no such process. Allocates nothing, because waits
/// call it.
fn read_stat(pid: u32) -> Result<Option<Stat>, Errno> {
    let mut path = [0u8; 32];
    let mut cursor = Cursor::new(&mut path[..]);
    if write!(cursor, "/proc/{pid}/stat\0").is_err() {
        return Err(Errno::NAMETOOLONG);
    }
    let Ok(path) = CStr::from_bytes_until_nul(&path) else { return Err(Errno::INVAL) };
    let flags = rustix::fs::OFlags::RDONLY | rustix::fs::OFlags::CLOEXEC;
    let file = match rustix::fs::open(path, flags, rustix::fs::Mode::empty()) {
        Ok(file) => file,
        Err(Errno::NOENT | Errno::SRCH) => return Ok(None),
        Err(error) => return Err(error),
    };
    let mut bytes = [0u8; 1024];
    let mut len = 0;
    while len < bytes.len() {
        match rustix::io::read(&file, &mut bytes[len..]) {
            Ok(0) => break,
            Ok(count) => len += count,
            Err(Errno::INTR) => {}
            Err(Errno::SRCH) => return Ok(None),
            Err(error) => return Err(error),
        }
    }
    parse_stat(&bytes[..len]).map(Some).ok_or(Errno::INVAL)
}

/// Fields 3 (state) and 22 (start time) of proc(5); the second field, the name in brackets, may
/// contain any characters.
fn parse_stat(bytes: &[u8]) -> Option<Stat> {
    let after_name = bytes.iter().rposition(|&b| b == b')')? + 1;
    let text = std::str::from_utf8(&bytes[after_name..]).ok()?;
    let mut fields = text.split_ascii_whitespace();
    let state = fields.next()?;
    let start_time = fields.nth(18)?.parse().ok()?;
    Some(Stat { start_time, has_exited: matches!(state, "Z" | "X" | "x") })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_process_lives_and_its_namesake_of_another_time_does_not() {
        let own = ProcessId::own().unwrap();
        assert!(own.is_alive() && ProcessId::is_word_alive(own.word()));
        let other = ProcessId { start_time: own.start_time + 1, ..own };
        assert!(!other.is_alive() && !ProcessId::is_word_alive(other.word()));
    }

    #[test]
    fn a_child_that_has_exited_does_not_live_even_before_it_is_waited_for() {
        let mut child = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        let start_time = read_stat(child.id()).unwrap().unwrap().start_time;
        let id = ProcessId { pid: child.id(), start_time };
        assert!(id.is_alive());
        child.kill().unwrap();
        let deadline = std::time::Instant::now() + std::time::Duration::from_secs(20);
        while id.is_alive() && std::time::Instant::now() < deadline {
            std::thread::yield_now();
        }
        assert!(!id.is_alive());
        child.wait().unwrap();
        assert!(!id.is_alive());
    }

    #[test]
    fn names_with_brackets_and_spaces_do_not_confuse_the_fields() {
        let line = b"77 (a ) Z (b) S 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 4242 23";
        assert_eq!(parse_stat(line), Some(Stat { start_time: 4242, has_exited: false }));
        assert_eq!(parse_stat(b"77 (x) Z 1"), None);
        assert_eq!(parse_stat(b""), None);
    }
}
