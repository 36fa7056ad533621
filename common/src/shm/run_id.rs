//! The id of a run, from which the names of its segments are derived.

use super::error::ShmError;
use super::kind::SegmentKind;
use super::process::ProcessId;
use std::fmt;
use std::sync::atomic::{AtomicU32, Ordering};

/// The id of a run of the pipeline: `tv-<pid>-<start time>` of its launcher. It is unique over
/// time, and shows whether the run is alive, so that the next launcher can remove the segments of a
/// killed one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct RunId {
    launcher: ProcessId,
    /// Distinguishes several runs of one process, in tests; 0 in a real run.
    serial: u32,
}

impl RunId {
    /// The id of the run that this process launches.
    ///
    /// # Errors
    /// [`ShmError::Os`] when `/proc` cannot be read.
    pub fn new_for_this_process() -> Result<Self, ShmError> {
        Ok(Self { launcher: ProcessId::own()?, serial: 0 })
    }

    /// A run id that this process has not used before.
    ///
    /// # Panics
    /// When `/proc` cannot be read.
    #[must_use]
    pub fn unique_for_tests() -> Self {
        static SERIAL: AtomicU32 = AtomicU32::new(1);
        let launcher = ProcessId::own().expect("a test can read its own /proc/self/stat");
        // Relaxed: only uniqueness matters.
        Self { launcher, serial: SERIAL.fetch_add(1, Ordering::Relaxed) }
    }

    /// Parses the output of [`fmt::Display`].
    ///
    /// # Errors
    /// [`ShmError::BadRunId`].
    pub fn parse(text: &str) -> Result<Self, ShmError> {
        Self::parse_option(text).ok_or_else(|| ShmError::BadRunId { text: text.to_owned() })
    }

    fn parse_option(text: &str) -> Option<Self> {
        let (pid, rest) = text.strip_prefix("tv-")?.split_once('-')?;
        let (start_time, serial) = match rest.split_once('.') {
            Some((start_time, serial)) => (start_time, number(serial)?),
            None => (rest, 0),
        };
        let pid = u32::try_from(number(pid)?).ok()?;
        let launcher = ProcessId { pid, start_time: number(start_time)? };
        let id = Self { launcher, serial: u32::try_from(serial).ok()? };
        // The text of an id is unique: no leading zeros, no ".0".
        (id.to_string() == text).then_some(id)
    }

    /// The run and the kind of the segment with this name; `None` if it is not one of ours.
    pub(crate) fn of_segment(name: &str) -> Option<(Self, SegmentKind)> {
        SegmentKind::ALL.iter().find_map(|&kind| {
            let run = name.strip_suffix(kind.name())?.strip_suffix('-')?;
            Some((Self::parse_option(run)?, kind))
        })
    }

    /// Name of a segment of the run, below `/dev/shm`.
    #[must_use]
    pub fn segment_name(&self, kind: SegmentKind) -> String {
        format!("{self}-{}", kind.name())
    }

    /// Whether the launcher of the run is alive.
    #[must_use]
    pub fn is_alive(&self) -> bool {
        self.launcher.is_alive()
    }

    /// Process id of the launcher.
    #[must_use]
    pub fn launcher_pid(&self) -> u32 {
        self.launcher.pid
    }

    pub(crate) fn launcher(&self) -> ProcessId {
        self.launcher
    }
}

fn number(text: &str) -> Option<u64> {
    text.bytes().all(|b| b.is_ascii_digit()).then(|| text.parse().ok())?
}

impl fmt::Display for RunId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "tv-{}-{}", self.launcher.pid, self.launcher.start_time)?;
        if self.serial == 0 { Ok(()) } else { write!(f, ".{}", self.serial) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn names_read_back(pid: u32, start_time: u64, serial: u32, kind in 0usize..10) {
            let run = RunId { launcher: ProcessId { pid, start_time }, serial };
            prop_assert_eq!(RunId::parse(&run.to_string()).unwrap(), run);
            let kind = SegmentKind::ALL[kind];
            prop_assert_eq!(RunId::of_segment(&run.segment_name(kind)), Some((run, kind)));
        }

        #[test]
        fn any_text_is_an_id_or_an_error(text in "(tv-)?[0-9a-z.+-]{0,24}") {
            if let Ok(run) = RunId::parse(&text) {
                prop_assert_eq!(run.to_string(), text);
            }
        }
    }

    #[test]
    fn other_names_are_none_of_ours() {
        for name in
            ["tv-1-2", "tv-1-2-", "tv-1-2-rings", "tv-1-2-ring.bak", "tv-a-2-ring", "sem.tv-1-2-ring", "tv-01-2-ring"]
        {
            assert_eq!(RunId::of_segment(name), None, "{name}");
        }
        assert!(RunId::of_segment("tv-1-2-elevation-ring").is_some_and(|(_, kind)| kind == SegmentKind::ElevationRing));
    }

    #[test]
    fn ids_for_tests_differ() {
        assert_ne!(RunId::unique_for_tests(), RunId::unique_for_tests());
    }
}
