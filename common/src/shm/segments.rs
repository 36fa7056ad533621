//! Creates, opens and removes the segments of a run.
//!
//! The launcher creates all of them before it starts a stage, and only the launcher removes them.
//! Stages open them by name. Segments of a killed launcher are removed at the next start
//! ([`reap_dead_runs`]).

use super::error::ShmError;
use super::header::{NotUsable, Segment, begins_like_a_segment};
use super::kind::SegmentKind;
use super::layout::Layout;
use super::region::Region;
use super::run_id::RunId;
use rustix::fd::OwnedFd;
use rustix::fs::{FallocateFlags, FileType, FlockOperation, Mode, OFlags};
use rustix::io::Errno;
use rustix::shm;
use shared_memory::{ShmemConf, ShmemError};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Where POSIX shared memory lives on Linux.
pub(crate) const SHM_FOLDER: &str = "/dev/shm";
/// How long to wait for a segment that is not ready. The launcher creates segments before it starts
/// a stage.
const OPEN_DEADLINE: Duration = Duration::from_secs(2);

/// All segments of a run, held by the launcher as long as the run lasts. When dropped, removes
/// them.
#[derive(Debug)]
pub struct RunSegments {
    run: RunId,
    /// The mappings own the names. An open mapping keeps its pages, even if its name is removed.
    segments: Vec<Arc<Segment>>,
    /// Locked as long as the launcher is alive. So these segments are never mistaken for those of a
    /// dead run, even where process ids mean nothing (containers that share /dev/shm).
    locks: Vec<OwnedFd>,
}

impl RunSegments {
    /// Creates the segments of a run and reserves all their memory, so that no stage dies of a
    /// missing page.
    ///
    /// # Errors
    /// [`ShmError::NotEnoughSpace`] with the required bytes; then nothing is left behind.
    pub fn create(run: &RunId, layout: &Layout) -> Result<Self, ShmError> {
        let needed = layout.total_bytes();
        let available = free_bytes()?;
        if available < needed {
            return Err(ShmError::NotEnoughSpace { needed, available });
        }
        let mut made = Self { run: *run, segments: Vec::new(), locks: Vec::new() };
        // The control block last, because stages open it first.
        for &kind in SegmentKind::ALL.iter().rev() {
            made.create_one(kind, layout)?;
        }
        Ok(made)
    }

    fn create_one(&mut self, kind: SegmentKind, layout: &Layout) -> Result<(), ShmError> {
        let geometry = layout.geometry(kind);
        let name = self.run.segment_name(kind);
        let too_large = || ShmError::NotEnoughSpace { needed: geometry.total_bytes, available: isize::MAX as u64 };
        let size = usize::try_from(geometry.total_bytes).map_err(|_too_large| too_large())?;
        let shmem = ShmemConf::new().size(size).os_id(&name).create().map_err(|source| match source {
            ShmemError::MappingIdExists => ShmError::AlreadyExists { name: name.clone() },
            source => ShmError::Map { action: "create", name: name.clone(), source },
        })?;
        // From here on a failure drops the mapping, which owns the name and removes it.
        let os = |action| {
            let name = name.clone();
            move |source| ShmError::Os { action, name, source }
        };
        let file = shm::open(&*name, shm::OFlags::RDWR, Mode::empty()).map_err(os("open"))?;
        reserve(&file, geometry.total_bytes).map_err(|source| match source {
            Errno::NOSPC => {
                ShmError::NotEnoughSpace { needed: layout.total_bytes(), available: free_bytes().unwrap_or(0) }
            }
            source => os("reserve the memory of")(source),
        })?;
        rustix::fs::flock(&file, FlockOperation::NonBlockingLockExclusive).map_err(os("lock"))?;
        let segment = Segment::create(Region::mapping(shmem, &name)?, geometry)?;
        self.segments.push(Arc::new(segment));
        self.locks.push(file);
        Ok(())
    }

    /// The run.
    #[must_use]
    pub fn run(&self) -> &RunId {
        &self.run
    }

    /// The files of the segments.
    #[must_use]
    pub fn paths(&self) -> Vec<PathBuf> {
        let names = self.segments.iter().map(|segment| self.run.segment_name(segment.kind()));
        names.map(|name| Path::new(SHM_FOLDER).join(name)).collect()
    }

    /// Name below `/dev/shm` of a segment whose file another process has truncated: processes that
    /// map it die of SIGBUS.
    #[must_use]
    pub fn cut_short(&self) -> Option<String> {
        let is_cut = |file: &OwnedFd, segment: &Segment| {
            rustix::fs::fstat(file).is_ok_and(|found| found.st_size.unsigned_abs() < segment.geometry().total_bytes)
        };
        let mut all = self.locks.iter().zip(&self.segments);
        all.find(|(file, segment)| is_cut(file, segment)).map(|(_, segment)| self.run.segment_name(segment.kind()))
    }

    /// Bytes of shared memory that the run takes.
    #[must_use]
    pub fn total_bytes(&self) -> u64 {
        self.segments.iter().map(|segment| segment.geometry().total_bytes).sum()
    }
}

/// `fallocate`, repeated when interrupted by a signal.
pub(crate) fn reserve(file: &OwnedFd, bytes: u64) -> Result<(), Errno> {
    loop {
        match rustix::fs::fallocate(file, FallocateFlags::empty(), 0, bytes) {
            Err(Errno::INTR) => {}
            other => return other,
        }
    }
}

/// Bytes that `/dev/shm` has free.
///
/// # Errors
/// [`ShmError::Os`] when it does not exist.
pub fn free_bytes() -> Result<u64, ShmError> {
    let stat = rustix::fs::statvfs(SHM_FOLDER);
    let stat = stat.map_err(|source| ShmError::Os { action: "examine", name: SHM_FOLDER.to_owned(), source })?;
    Ok(stat.f_bavail.saturating_mul(stat.f_frsize))
}

/// Opens a segment of a run, and waits a short time if it is not ready.
pub(crate) fn open_segment(run: &RunId, kind: SegmentKind) -> Result<Arc<Segment>, ShmError> {
    open_before(run, kind, OPEN_DEADLINE)
}

pub(crate) fn open_before(run: &RunId, kind: SegmentKind, deadline: Duration) -> Result<Arc<Segment>, ShmError> {
    let name = run.segment_name(kind);
    let start = Instant::now();
    loop {
        match try_open(&name, kind) {
            Ok(segment) => return Ok(Arc::new(segment)),
            Err(NotUsable::Never(error)) => return Err(error),
            Err(NotUsable::NotYet) => {}
        }
        if !run.is_alive() {
            return Err(ShmError::PeerGone { run: run.to_string(), name });
        }
        if start.elapsed() >= deadline {
            return Err(ShmError::NotReady { name, waited_ms: deadline.as_millis() as u64 });
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn try_open(name: &str, kind: SegmentKind) -> Result<Segment, NotUsable> {
    let mut shmem = match ShmemConf::new().os_id(name).open() {
        Ok(shmem) => shmem,
        // The crate returns the errno. Either the name does not exist yet, or the file has no size
        // yet and cannot be mapped.
        Err(ShmemError::MapOpenFailed(errno))
            if errno == Errno::NOENT.raw_os_error().cast_unsigned()
                || errno == Errno::INVAL.raw_os_error().cast_unsigned() =>
        {
            return Err(NotUsable::NotYet);
        }
        Err(source) => return Err(NotUsable::Never(ShmError::Map { action: "open", name: name.to_owned(), source })),
    };
    shmem.set_owner(false);
    let region = Region::mapping(shmem, name).map_err(NotUsable::Never)?;
    Segment::check(region, kind, name)
}

/// Removes the segments of runs whose launcher is dead. Leaves those of other runs, and all other
/// files in `/dev/shm`. Returns the removed names.
#[must_use]
pub fn reap_dead_runs() -> Vec<String> {
    let Ok(entries) = std::fs::read_dir(SHM_FOLDER) else { return Vec::new() };
    let mut removed: Vec<String> = entries
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter(|name| RunId::of_segment(name).is_some_and(|(run, _)| !run.is_alive()))
        .filter(|name| remove_unlocked(name))
        .chain(super::named::reap())
        .collect();
    removed.sort();
    removed
}

/// Removes a file that is certainly one of our segments, unless a live launcher holds its lock. Its
/// name is that of a run whose launcher is dead; it also has to be a file (not a link) of this
/// user, with no other name, and to begin like a segment, or be blank.
fn remove_unlocked(name: &str) -> bool {
    let Some(file) = open_own(name) else { return false };
    let mut first = [0u8; 64];
    let Ok(count) = rustix::io::pread(&file, &mut first, 0) else { return false };
    begins_like_a_segment(&first[..count])
        && rustix::fs::flock(&file, FlockOperation::NonBlockingLockExclusive).is_ok()
        && is_named(&file, name)
        && shm::unlink(name).is_ok()
}

/// Opens a file below `/dev/shm` if it belongs to this user and has no other name.
pub(crate) fn open_own(name: &str) -> Option<OwnedFd> {
    let flags = OFlags::RDWR | OFlags::CLOEXEC | OFlags::NOFOLLOW | OFlags::NONBLOCK;
    let file = rustix::fs::open(format!("{SHM_FOLDER}/{name}"), flags, Mode::empty()).ok()?;
    let about = rustix::fs::fstat(&file).ok()?;
    let is_own = FileType::from_raw_mode(about.st_mode) == FileType::RegularFile
        && about.st_uid == rustix::process::geteuid().as_raw()
        && about.st_nlink == 1;
    is_own.then_some(file)
}

/// Whether the name refers to this very file.
pub(crate) fn is_named(file: &OwnedFd, name: &str) -> bool {
    let named = rustix::fs::lstat(format!("{SHM_FOLDER}/{name}"));
    let (Ok(file), Ok(named)) = (rustix::fs::fstat(file), named) else { return false };
    (file.st_dev, file.st_ino) == (named.st_dev, named.st_ino)
}

/// The memory of a whole segment, mapped while this value lives, for import into a device.
#[derive(Debug, Clone)]
pub struct SegmentMemory {
    segment: Arc<Segment>,
}

impl SegmentMemory {
    pub(crate) fn new(segment: &Arc<Segment>) -> Self {
        Self { segment: Arc::clone(segment) }
    }

    /// Address of the first byte, a multiple of 4096. Other processes may write these bytes at any
    /// time.
    #[must_use]
    pub fn as_ptr(&self) -> *mut u8 {
        self.segment.region().as_ptr()
    }

    /// Length in bytes, a multiple of 4096.
    #[must_use]
    pub fn len(&self) -> u64 {
        self.segment.geometry().total_bytes
    }

    /// Never: a segment has a header.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}
