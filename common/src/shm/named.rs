//! Segments for programs outside of a run: `/dev/shm/terravision-NAME`.
//!
//! Their layouts are public (docs/frame-ring.md), fixed and little-endian. The launcher creates a
//! segment as a file without a name, fills and locks it, and only then gives it its name: programs
//! always find it complete, and a segment that is not locked belongs to a dead run. It is removed
//! at the end of the run; if the launcher was killed, the next start removes it.

use super::error::ShmError;
use super::public_file::PublicFile;
use super::region::{Region, SharedWords};
use super::segments::{SHM_FOLDER, free_bytes, is_named, open_own, reserve};
use crate::sync::{AtomicU32, AtomicU64, Ordering, fence};
use memmap2::MmapOptions;
use rustix::fd::{AsRawFd, OwnedFd};
use rustix::fs::{AtFlags, CWD, FileType, FlockOperation, Mode, OFlags};
use rustix::io::Errno;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

/// Prefix of the names of such segments.
const PREFIX: &str = "terravision-";
/// Suffix of the name of the segment for poses.
const CAMERA_SUFFIX: &str = "-camera";
const LONGEST_NAME: usize = 64;
/// Attempts to take over the name of a dead run, because another start may try the same.
const TRIES: u32 = 8;
const TRY_AGAIN_AFTER: Duration = Duration::from_millis(5);

/// A run is making frames.
const LIVE: u32 = 1;
/// The run has ended.
const ENDED: u32 = 2;

/// The name by which other programs find a run: letters, digits, dots, dashes and underscores.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct SharedName(String);

impl SharedName {
    /// Checks a name.
    ///
    /// # Errors
    /// [`ShmError::BadSharedName`].
    pub fn parse(text: &str) -> Result<Self, ShmError> {
        let is_good = (1..=LONGEST_NAME).contains(&text.len())
            && text.bytes().all(|b| b.is_ascii_alphanumeric() || matches!(b, b'.' | b'-' | b'_'))
            && text.as_bytes()[0].is_ascii_alphanumeric()
            && !text.ends_with(CAMERA_SUFFIX);
        if is_good { Ok(Self(text.to_owned())) } else { Err(ShmError::BadSharedName { text: text.to_owned() }) }
    }

    /// The frame ring's name below `/dev/shm`.
    #[must_use]
    pub fn ring_file(&self) -> String {
        format!("{PREFIX}{}", self.0)
    }

    /// The name below `/dev/shm` of the segment for poses.
    #[must_use]
    pub fn camera_file(&self) -> String {
        format!("{PREFIX}{}{CAMERA_SUFFIX}", self.0)
    }
}

impl fmt::Display for SharedName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// The first 64 bytes of every such segment.
#[derive(Debug)]
#[repr(C)]
pub(crate) struct NamedHeader {
    magic: AtomicU64,
    version: AtomicU32,
    /// The launcher.
    pid: AtomicU32,
    total_bytes: AtomicU64,
    state: AtomicU32,
    reserved: [AtomicU32; 9],
}

const _: () = assert!(size_of::<NamedHeader>() == 64);

const STATE_OFFSET: u64 = std::mem::offset_of!(NamedHeader, state) as u64;

// SAFETY: atomics alone, repr(C), aligned to 8.
unsafe impl SharedWords for NamedHeader {}
// SAFETY: an atomic, aligned to 8.
unsafe impl SharedWords for AtomicU64 {}

/// Kind and version of such a segment.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NamedKind {
    pub(crate) magic: [u8; 8],
    pub(crate) version: u32,
}

/// The frame ring.
pub(crate) const FRAMES: NamedKind = NamedKind { magic: *b"TVFRAMES", version: 1 };
/// The segment for poses.
pub(crate) const CAMERA: NamedKind = NamedKind { magic: *b"TVCAMERA", version: 1 };

/// A segment that this process has created. When dropped, it is marked as ended and its name is
/// removed.
#[derive(Debug)]
pub(crate) struct NamedSegment {
    /// Locked as long as this lives.
    pub(crate) file: Arc<PublicFile>,
}

impl NamedSegment {
    /// Creates a segment of this name (below `/dev/shm`) with all its memory; `fill` writes the
    /// content after the header.
    ///
    /// # Errors
    /// [`ShmError::NameTaken`] while another run has the name, [`ShmError::NotEnoughSpace`].
    pub(crate) fn create(
        name: &str,
        kind: NamedKind,
        bytes: u64,
        fill: impl FnOnce(&Region),
    ) -> Result<Self, ShmError> {
        let available = free_bytes()?;
        if available < bytes {
            return Err(ShmError::NotEnoughSpace { needed: bytes, available });
        }
        let os = |action| move |source| ShmError::Os { action, name: name.to_owned(), source };
        let mode = Mode::RUSR | Mode::WUSR;
        let file = rustix::fs::open(SHM_FOLDER, OFlags::TMPFILE | OFlags::RDWR | OFlags::CLOEXEC, mode)
            .map_err(os("create"))?;
        reserve(&file, bytes).map_err(|source| match source {
            Errno::NOSPC => ShmError::NotEnoughSpace { needed: bytes, available },
            source => os("reserve the memory of")(source),
        })?;
        rustix::fs::flock(&file, FlockOperation::NonBlockingLockExclusive).map_err(os("lock"))?;
        // As long as it has no name, no other process can open it.
        let region = map(&file, name, true)?;
        fill(&region);
        let header: &NamedHeader = region.words(0);
        // Relaxed: the name, which is set last, publishes all of it.
        header.magic.store(u64::from_ne_bytes(kind.magic), Ordering::Relaxed);
        header.version.store(kind.version, Ordering::Relaxed);
        header.pid.store(std::process::id(), Ordering::Relaxed);
        header.total_bytes.store(bytes, Ordering::Relaxed);
        header.state.store(LIVE, Ordering::Relaxed);
        drop(region);
        for attempt in 1..=TRIES {
            let unnamed = format!("/proc/self/fd/{}", file.as_raw_fd());
            match rustix::fs::linkat(CWD, &unnamed, CWD, path(name), AtFlags::SYMLINK_FOLLOW) {
                Ok(()) => return Ok(Self { file: Arc::new(PublicFile::new(file, name, bytes)) }),
                Err(Errno::EXIST) => match remove_dead(name) {
                    Ok(_) => {}
                    // Another start may hold the lock for a moment, to remove dead segments.
                    Err(ShmError::NameTaken { .. }) if attempt < TRIES => std::thread::sleep(TRY_AGAIN_AFTER),
                    Err(error) => return Err(error),
                },
                Err(source) => return Err(os("name")(source)),
            }
        }
        Err(ShmError::AlreadyExists { name: name.to_owned() })
    }
}

impl NamedSegment {
    /// Its name below `/dev/shm`.
    pub(crate) fn name(&self) -> &str {
        self.file.name()
    }
}

impl Drop for NamedSegment {
    fn drop(&mut self) {
        // SYNC named.ended: all that was written comes before.
        fence(Ordering::Release);
        // There is no one left to report this to.
        self.file.write_at(STATE_OFFSET, &ENDED.to_ne_bytes()).ok();
        if is_named(self.file.file(), self.name()) {
            rustix::fs::unlink(path(self.name())).ok();
        }
    }
}

pub(crate) fn path(name: &str) -> String {
    format!("{SHM_FOLDER}/{name}")
}

fn map(file: &OwnedFd, name: &str, is_writable: bool) -> Result<Region, ShmError> {
    let options = MmapOptions::new();
    let mapped = if is_writable { options.map_raw(file) } else { options.map_raw_read_only(file) };
    let failed = |source: std::io::Error| ShmError::Os {
        action: "map",
        name: name.to_owned(),
        source: Errno::from_io_error(&source).unwrap_or(Errno::NOMEM),
    };
    Region::file(mapped.map_err(failed)?, name)
}

/// Opens a segment, maps it and checks its header: for other programs, which accept the risk that
/// it is truncated. If not `is_writable`, it is mapped read-only, and must not be stored to.
pub(crate) fn open(name: &str, kind: NamedKind, is_writable: bool) -> Result<Region, ShmError> {
    let (file, size) = open_file(name, is_writable)?;
    let region = map(&file, name, is_writable)?;
    check_header(&region, name, kind, size)?;
    Ok(region)
}

/// Opens a segment for reading and writing as a file, and checks its header. Also returns its
/// current first `head` bytes.
pub(crate) fn open_unmapped(name: &str, kind: NamedKind, head: usize) -> Result<(PublicFile, Region), ShmError> {
    let (file, size) = open_file(name, true)?;
    let file = PublicFile::new(file, name, size);
    let mut bytes = vec![0; head];
    file.read_at(0, &mut bytes)?;
    let region = Region::heap(head as u64)?;
    // SAFETY: no other reference to this memory exists yet.
    unsafe { region.slice_mut::<u8>(0, head as u64) }.copy_from_slice(&bytes);
    check_header(&region, name, kind, size)?;
    Ok((file, region))
}

/// The file of a segment, and its length.
fn open_file(name: &str, is_writable: bool) -> Result<(OwnedFd, u64), ShmError> {
    let os = |action| move |source| ShmError::Os { action, name: name.to_owned(), source };
    let access = if is_writable { OFlags::RDWR } else { OFlags::RDONLY };
    let flags = access | OFlags::CLOEXEC | OFlags::NOFOLLOW | OFlags::NONBLOCK;
    let file = rustix::fs::open(path(name), flags, Mode::empty()).map_err(os("open"))?;
    let found = rustix::fs::fstat(&file).map_err(os("examine"))?;
    let least = size_of::<NamedHeader>() as u64;
    let size = found.st_size.unsigned_abs();
    if FileType::from_raw_mode(found.st_mode) != FileType::RegularFile || size < least {
        return Err(ShmError::TooSmall { name: name.to_owned(), needed: least, found: size });
    }
    Ok((file, size))
}

/// Whether this is the header of a segment of this kind, in a file of this size.
fn check_header(region: &Region, name: &str, kind: NamedKind, size: u64) -> Result<(), ShmError> {
    let header: &NamedHeader = region.words(0);
    let (found, expected) = (header.magic.load(Ordering::Relaxed), u64::from_ne_bytes(kind.magic));
    if found != expected {
        return Err(ShmError::NotOurs { name: name.to_owned(), found, expected });
    }
    let theirs = header.version.load(Ordering::Relaxed);
    if theirs != kind.version {
        return Err(ShmError::VersionMismatch { name: name.to_owned(), ours: kind.version, theirs });
    }
    let total = header.total_bytes.load(Ordering::Relaxed);
    if total != size {
        let (name, field, expected) = (name.to_owned(), "the layout size", "the size of the file");
        return Err(ShmError::Corrupt { name, field, found: total, expected });
    }
    Ok(())
}

/// Whether the run that created the segment has ended in order. After a killed launcher this is not
/// set: see [`launcher_pid`].
pub(crate) fn is_ended(region: &Region) -> bool {
    // Acquire: SYNC named.ended.
    region.words::<NamedHeader>(0).state.load(Ordering::Acquire) == ENDED
}

/// The process that created the segment.
pub(crate) fn launcher_pid(region: &Region) -> u32 {
    region.words::<NamedHeader>(0).pid.load(Ordering::Relaxed)
}

/// Removes the segment of this name if its creator is dead. Returns whether it existed.
///
/// # Errors
/// [`ShmError::NameTaken`] when it is alive, [`ShmError::NotOurs`] when the file is not one of
/// ours.
fn remove_dead(name: &str) -> Result<bool, ShmError> {
    let flags = OFlags::RDWR | OFlags::CLOEXEC | OFlags::NOFOLLOW | OFlags::NONBLOCK;
    let file = match rustix::fs::open(path(name), flags, Mode::empty()) {
        Ok(file) => file,
        Err(Errno::NOENT) => return Ok(false),
        // It belongs to another user, or is not a file.
        Err(source) => return Err(ShmError::Os { action: "take over", name: name.to_owned(), source }),
    };
    let mut first = [0u8; 16];
    let count = rustix::io::pread(&file, &mut first, 0).unwrap_or(0);
    let magic: [u8; 8] = std::array::from_fn(|i| first[i]);
    if count < first.len() || ![FRAMES.magic, CAMERA.magic].contains(&magic) {
        let (found, expected) = (u64::from_ne_bytes(magic), u64::from_ne_bytes(FRAMES.magic));
        return Err(ShmError::NotOurs { name: name.to_owned(), found, expected });
    }
    if rustix::fs::flock(&file, FlockOperation::NonBlockingLockExclusive).is_err() {
        let pid = u32::from_ne_bytes(std::array::from_fn(|i| first[12 + i]));
        return Err(ShmError::NameTaken { name: name.to_owned(), pid });
    }
    // A name is only removed while the lock of its file is held: so no other process does so now,
    // unless it has done so before.
    Ok(is_named(&file, name) && rustix::fs::unlink(path(name)).is_ok())
}

/// Removes the segments of dead runs. Returns their names.
pub(crate) fn reap() -> Vec<String> {
    let Ok(entries) = std::fs::read_dir(SHM_FOLDER) else { return Vec::new() };
    entries
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter(|name| name.starts_with(PREFIX))
        .filter(|name| open_own(name).is_some() && matches!(remove_dead(name), Ok(true)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unique(what: &str) -> String {
        format!("{PREFIX}test-{what}-{}", std::process::id())
    }

    #[test]
    fn names_are_checked() {
        for good in ["a", "cam-1", "uav_2.left", &"x".repeat(64)] {
            assert_eq!(SharedName::parse(good).unwrap().ring_file(), format!("terravision-{good}"));
        }
        for bad in ["", "-a", ".a", "a/b", "a b", "ä", "x-camera", &"x".repeat(65)] {
            let message = SharedName::parse(bad).unwrap_err().to_string();
            assert!(message.contains("letters"), "{message}");
        }
    }

    #[test]
    fn a_name_belongs_to_one_living_run() {
        let name = unique("one");
        let first = NamedSegment::create(&name, FRAMES, 4096, |_| {}).unwrap();
        let error = NamedSegment::create(&name, FRAMES, 4096, |_| {}).unwrap_err();
        assert!(matches!(error, ShmError::NameTaken { pid, .. } if pid == std::process::id()), "{error}");
        let region = open(&name, FRAMES, false).unwrap();
        assert!(!is_ended(&region) && launcher_pid(&region) == std::process::id());
        assert!(matches!(open(&name, CAMERA, false), Err(ShmError::NotOurs { .. })));
        assert!(!reap().contains(&name));
        drop(first);
        assert!(is_ended(&region));
        assert!(open(&name, FRAMES, false).is_err());
    }

    #[test]
    fn what_a_dead_run_left_is_taken_over_and_foreign_files_stay() {
        let name = unique("dead");
        let left = NamedSegment::create(&name, FRAMES, 4096, |_| {}).unwrap();
        // As after a kill: the lock is gone, the name remains.
        rustix::fs::flock(left.file.file(), FlockOperation::Unlock).unwrap();
        let next = NamedSegment::create(&name, FRAMES, 8192, |_| {}).unwrap();
        assert_eq!(open(&name, FRAMES, false).unwrap().len(), 8192);
        // The name belongs to another segment now: it must not be removed with the old one.
        drop(left);
        assert!(open(&name, FRAMES, false).is_ok());
        drop(next);

        let foreign = unique("foreign");
        std::fs::write(path(&foreign), "a user's own notes, longer than a header's first words").unwrap();
        assert!(matches!(NamedSegment::create(&foreign, FRAMES, 4096, |_| {}), Err(ShmError::NotOurs { .. })));
        assert!(!reap().contains(&foreign));
        std::fs::remove_file(path(&foreign)).unwrap();
    }

    #[test]
    fn files_that_are_no_segments_are_refused() {
        let name = unique("short");
        for content in [&b""[..], &b"TVFRAMES"[..], &[0; 4096][..], &[255; 100][..]] {
            std::fs::write(path(&name), content).unwrap();
            assert!(open(&name, FRAMES, false).is_err());
        }
        std::fs::remove_file(path(&name)).unwrap();
    }
}
