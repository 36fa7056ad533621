//! Errors of segments, and why a wait ended without success.

use super::kind::{SegmentKind, Stage};

/// A segment could not be made or opened, or its content is not valid.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ShmError {
    /// `/dev/shm` cannot hold the run.
    #[error(
        "shared memory has too little room: the run needs {needed} bytes and /dev/shm has {available} bytes free \
         (ask for less with --memory, or enlarge it: mount -o remount,size=… /dev/shm, docker run --shm-size=…)"
    )]
    NotEnoughSpace {
        /// Bytes that the run needs.
        needed: u64,
        /// Bytes that are free.
        available: u64,
    },
    /// The memory that the user allows is too little for the smallest tile pools.
    #[error("{available} bytes of memory are too little for the tile pools, which need {needed} at least")]
    MemoryTooSmall {
        /// Bytes that the smallest pools need.
        needed: u64,
        /// Bytes that were allowed.
        available: u64,
    },
    /// A segment of this name exists already.
    #[error("the shared-memory segment {name} exists already")]
    AlreadyExists {
        /// Its name below `/dev/shm`.
        name: String,
    },
    /// The segment did not become ready before the deadline.
    #[error("the shared-memory segment {name} was not ready after {waited_ms} ms")]
    NotReady {
        /// Its name below `/dev/shm`.
        name: String,
        /// The time waited, milliseconds.
        waited_ms: u64,
    },
    /// The launcher of the run is dead.
    #[error("the launcher of run {run} is gone, so its segment {name} will never be ready")]
    PeerGone {
        /// The run.
        run: String,
        /// The segment's name below `/dev/shm`.
        name: String,
    },
    /// The segment was not made by this program, or its first bytes were overwritten.
    #[error("{name} is not a TerraVision segment: it begins with {found:#018x} instead of {expected:#018x}")]
    NotOurs {
        /// Its name below `/dev/shm`.
        name: String,
        /// The first eight bytes.
        found: u64,
        /// The magic number.
        expected: u64,
    },
    /// The segment was made by another build.
    #[error(
        "segment {name} has layout version {theirs}, this program has {ours}: launcher and stages are of different builds"
    )]
    VersionMismatch {
        /// Its name below `/dev/shm`.
        name: String,
        /// Version of this program.
        ours: u32,
        /// Version in the segment.
        theirs: u32,
    },
    /// The mapping is smaller than the layout that it should hold.
    #[error("segment {name} has {found} bytes, expected {needed}")]
    TooSmall {
        /// Its name below `/dev/shm`.
        name: String,
        /// Bytes that the layout needs.
        needed: u64,
        /// Bytes that are mapped.
        found: u64,
    },
    /// Another program has changed the length of a segment's file.
    #[error("/dev/shm/{name} was cut by another program: it has {found} bytes, expected {expected}")]
    CutShort {
        /// Its name below `/dev/shm`.
        name: String,
        /// Bytes that it has.
        found: u64,
        /// Its original size, bytes.
        expected: u64,
    },
    /// A number in the segment is not one that a healthy peer writes.
    #[error("segment {name} is corrupt: {field} is {found}, expected {expected}")]
    Corrupt {
        /// The segment (its name, or its kind once it is open).
        name: String,
        /// What was read.
        field: &'static str,
        /// Its value.
        found: u64,
        /// What it should have been, in words.
        expected: &'static str,
    },
    /// Each segment has one writer and one reader, and another process has this role.
    #[error("the {role} of segment {name} is process {pid} already, which lives")]
    RoleTaken {
        /// Its name below `/dev/shm`.
        name: String,
        /// `writer` or `reader`.
        role: &'static str,
        /// The process that has the role.
        pid: u32,
    },
    /// The text is not the id of a run.
    #[error("{text:?} is not the id of a run, expected tv-<pid>-<start time>")]
    BadRunId {
        /// The text.
        text: String,
    },
    /// The text is not a valid name for sharing.
    #[error(
        "{text:?} is not a name to share frames by, expected 1 to 64 letters, digits, dots, dashes or underscores, with a \
         letter or digit first and not -camera last"
    )]
    BadSharedName {
        /// The text.
        text: String,
    },
    /// Another run has this name.
    #[error("the name /dev/shm/{name} is taken by another flight, process {pid}; choose another one")]
    NameTaken {
        /// The segment's name below `/dev/shm`.
        name: String,
        /// Process id of its launcher.
        pid: u32,
    },
    /// The segment's kind does not fit the handle.
    #[error("segment {name} is a {kind}, which is not what it was opened as")]
    WrongKind {
        /// Its name below `/dev/shm`.
        name: String,
        /// Its kind.
        kind: SegmentKind,
    },
    /// The operating system refused.
    #[error("cannot {action} {name}: {source}")]
    Os {
        /// The action that failed, a verb.
        action: &'static str,
        /// The segment or path.
        name: String,
        /// The system's reason.
        source: rustix::io::Errno,
    },
    /// The segment could not be mapped.
    #[error("cannot {action} the shared-memory segment {name}: {source}")]
    Map {
        /// The action that failed, a verb.
        action: &'static str,
        /// Its name below `/dev/shm`.
        name: String,
        /// The reason.
        source: shared_memory::ShmemError,
    },
}

impl ShmError {
    /// An invalid number in an open segment; off the hot path.
    #[cold]
    pub(crate) fn corrupt(kind: SegmentKind, field: &'static str, found: u64, expected: &'static str) -> Self {
        Self::Corrupt { name: kind.name().to_owned(), field, found, expected }
    }
}

/// Why a blocking call ended without success. The caller ends its work.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WaitError {
    /// The flight is over, after a number of frames that was not known before: end; all output is
    /// written.
    #[error("the flight is over")]
    Finished,
    /// The run is being stopped in good order (Ctrl-C, end of flight): end, and exit as after a
    /// signal.
    #[error("the run is stopping")]
    Stopping,
    /// The run has failed: another stage died or gave up.
    #[error("the run has failed")]
    Failed,
    /// The launcher is dead, so that the run cannot be finished.
    #[error("the launcher is gone")]
    LauncherGone,
    /// The stage on the other side is dead, and the launcher has not restarted it.
    #[error("the {stage} is gone")]
    PeerGone {
        /// The stage.
        stage: Stage,
    },
    /// The other side wrote invalid data.
    #[error(transparent)]
    PeerCorrupt {
        /// What was found.
        #[from]
        source: ShmError,
    },
}

impl WaitError {
    /// Whether this is the orderly end of a run, which is not a failure of the stage.
    #[must_use]
    pub fn is_stopping(&self) -> bool {
        matches!(self, Self::Finished | Self::Stopping)
    }

    /// Whether the flight is over and all of its frames are written.
    #[must_use]
    pub fn is_finished(&self) -> bool {
        matches!(self, Self::Finished)
    }
}
