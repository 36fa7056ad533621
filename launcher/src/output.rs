//! Where results go: written under a temporary name beside the final one, and renamed when all is
//! well, so that an interrupted run leaves no half film.

use crate::process::interrupt;
use rustix::fs::{FlockOperation, OFlags, flock};
use rustix::io::Errno;
use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};
use terravision_common::database::MANIFEST_FILE;
use terravision_common::shm::RunId;

/// Longest wait for the lock of a folder, which is held for moments.
const LOCK_PATIENCE: Duration = Duration::from_secs(2);
/// Between two tries.
const LOCK_TICK: Duration = Duration::from_millis(5);
/// How long a reader of a FIFO is waited for.
const READER_PATIENCE: Duration = Duration::from_secs(30);

/// Why a result cannot be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OutputError {
    /// The file cannot be made.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        #[source]
        source: io::Error,
    },
    /// The folder cannot be made or written to.
    #[error("cannot write into the folder {}: {source}", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// Why.
        #[source]
        source: io::Error,
    },
    /// The folder is a terrain database.
    #[error("{} is a terrain database; choose another folder for frames", path.display())]
    IsWorld {
        /// The folder.
        path: PathBuf,
    },
    /// Another run writes this file.
    #[error(
        "{} is being written by another terravision, process {pid}; wait for its end, or write to another file",
        path.display()
    )]
    Taken {
        /// The file.
        path: PathBuf,
        /// Process id of the other run's launcher.
        pid: u32,
    },
    /// There is something else of that name.
    #[error("cannot write {}: it is a folder; for frames in a folder end its name with a slash", path.display())]
    IsFolder {
        /// The folder.
        path: PathBuf,
    },
}

/// A file under its temporary name. Dropped before [`TemporaryFile::finish`] it is removed.
#[derive(Debug)]
pub struct TemporaryFile {
    temporary: PathBuf,
    path: PathBuf,
    is_finished: bool,
}

impl TemporaryFile {
    /// Makes an empty file beside `path`, of the same extension; `run` makes its name unique. It
    /// shows at once whether the place can be written to.
    ///
    /// # Errors
    /// [`OutputError`].
    pub fn create(path: &Path, run: &str) -> Result<Self, OutputError> {
        // So that of two runs that begin at once one sees the other.
        Self::create_under(&FolderLock::wait(folder_of(path)), path, run)
    }

    /// The same, for a caller that already holds the lock of the file's folder.
    ///
    /// # Errors
    /// [`OutputError`].
    pub fn create_under(_lock: &FolderLock, path: &Path, run: &str) -> Result<Self, OutputError> {
        let fail = |source| OutputError::Write { path: path.to_owned(), source };
        if path.is_dir() {
            return Err(OutputError::IsFolder { path: path.to_owned() });
        }
        // A device or a pipe (/dev/full, /dev/stdout) is written to as it is: it has no half
        // content to hide.
        if path.metadata().is_ok_and(|found| !found.is_file()) {
            return Ok(Self { temporary: path.to_owned(), path: path.to_owned(), is_finished: true });
        }
        let Some(stem) = path.file_stem() else {
            return Err(fail(io::Error::new(io::ErrorKind::InvalidInput, "it is not a file name")));
        };
        if let Some(pid) = other_writer(path, &stem.to_string_lossy(), run) {
            return Err(OutputError::Taken { path: path.to_owned(), pid });
        }
        let mut name = OsString::from(".");
        name.push(stem);
        name.push(format!(".{run}.part"));
        if let Some(extension) = path.extension() {
            name.push(".");
            name.push(extension);
        }
        let temporary = path.with_file_name(name);
        // New: a link of that name, which another user may have put there, is not followed.
        File::create_new(&temporary).map_err(fail)?;
        Ok(Self { temporary, path: path.to_owned(), is_finished: false })
    }

    /// The folder that both names are in.
    #[must_use]
    pub fn folder(&self) -> &Path {
        folder_of(&self.path)
    }

    /// The temporary name.
    #[must_use]
    pub fn temporary(&self) -> &Path {
        &self.temporary
    }

    /// What is to be removed when the run fails; `None` of a device or a pipe, which was there
    /// before.
    #[must_use]
    pub fn to_remove(&self) -> Option<&Path> {
        (!self.is_finished).then_some(self.temporary.as_path())
    }

    /// The final name.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Gives the file its final name, in place of one that has it.
    ///
    /// # Errors
    /// [`OutputError::Write`].
    pub fn finish(mut self) -> Result<(), OutputError> {
        if !self.is_finished {
            fs::rename(&self.temporary, &self.path)
                .map_err(|source| OutputError::Write { path: self.path.clone(), source })?;
            self.is_finished = true;
        }
        Ok(())
    }

    /// Writes the whole content and gives the file its final name.
    ///
    /// # Errors
    /// [`OutputError::Write`].
    pub fn finish_with(
        self,
        write: impl FnOnce(&mut io::BufWriter<File>) -> io::Result<()>,
    ) -> Result<(), OutputError> {
        let fail = |source| OutputError::Write { path: self.path.clone(), source };
        let file = open(&self.temporary, !self.is_finished).map_err(fail)?;
        let mut writer = io::BufWriter::new(file);
        write(&mut writer).and_then(|()| writer.flush()).map_err(fail)?;
        drop(writer);
        self.finish()
    }
}

/// Whether standard output was closed when this program was started (`>&-`), or leads nowhere. A
/// Rust program finds the null device in place of one that is closed, open for reading and writing,
/// as nobody opens it to write.
#[must_use]
pub fn is_stdout_closed() -> bool {
    let stdout = io::stdout();
    let is_null = rustix::fs::fstat(&stdout).is_ok_and(|found| found.st_rdev == rustix::fs::makedev(1, 3));
    is_null && rustix::fs::fcntl_getfl(&stdout).is_ok_and(|flags| flags.contains(OFlags::RDWR))
}

/// Opens a file to be written. Waits a while for the reader of a FIFO.
fn open(path: &Path, is_truncated: bool) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.write(true).truncate(is_truncated);
    if !path.metadata()?.file_type().is_fifo() {
        return options.open(path);
    }
    let end = Instant::now() + READER_PATIENCE;
    loop {
        match options.clone().custom_flags(OFlags::NONBLOCK.bits().cast_signed()).open(path) {
            Ok(file) => {
                // Who reads slowly is waited for.
                rustix::fs::fcntl_setfl(&file, OFlags::empty())?;
                return Ok(file);
            }
            Err(error) if error.raw_os_error() != Some(Errno::NXIO.raw_os_error()) => return Err(error),
            Err(_nobody) if Instant::now() >= end || interrupt::is_interrupted() => {
                return Err(io::Error::new(io::ErrorKind::TimedOut, "it is a FIFO that no program reads"));
            }
            Err(_nobody) => std::thread::sleep(Duration::from_millis(20)),
        }
    }
}

impl Drop for TemporaryFile {
    fn drop(&mut self) {
        if !self.is_finished {
            // Errors cannot be reported any more, and the file may not exist.
            drop(fs::remove_file(&self.temporary));
        }
    }
}

/// Removes what a killed stage left of the files that it was writing in a folder: it names them
/// `.partial-<its pid>-…`.
pub fn remove_partials(folder: &Path, pid: u32) {
    let prefix = format!(".partial-{pid}-");
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries.flatten().filter(|entry| entry.file_name().to_string_lossy().starts_with(&prefix)) {
        // What cannot be removed stays; the run has other things to tell.
        drop(fs::remove_file(entry.path()));
    }
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Process id of the launcher of another run that writes `path`, if there is one. Removes temporary
/// files of runs whose launcher was killed.
fn other_writer(path: &Path, stem: &str, own: &str) -> Option<u32> {
    let extension = path.extension().map_or(String::new(), |extension| format!(".{}", extension.to_string_lossy()));
    let mut writer = None;
    for entry in fs::read_dir(folder_of(path)).ok()?.flatten() {
        let name = entry.file_name();
        let run = name.to_str().and_then(|name| name.strip_prefix(&format!(".{stem}."))?.split_once(".part"));
        let Some((run, kind)) = run.and_then(|(run, kind)| Some((RunId::parse(run).ok()?, kind))) else { continue };
        if !run.is_alive() {
            drop(fs::remove_file(entry.path()));
        } else if kind == extension && run.to_string() != own {
            writer = Some(run.launcher_pid());
        }
    }
    writer
}

/// Keeps other runs from a folder for a moment. Where it cannot be read (some network file systems
/// have none) the moment passes without it.
#[derive(Debug)]
pub struct FolderLock {
    /// Closed, it is given back.
    _folder: Option<File>,
}

impl FolderLock {
    /// Waits for it, some seconds at most.
    #[must_use]
    pub fn wait(folder: &Path) -> Self {
        let until = Instant::now() + LOCK_PATIENCE;
        let Ok(file) = File::open(folder) else { return Self { _folder: None } };
        loop {
            match flock(&file, FlockOperation::NonBlockingLockExclusive) {
                Ok(()) => return Self { _folder: Some(file) },
                Err(rustix::io::Errno::WOULDBLOCK) if Instant::now() < until => std::thread::sleep(LOCK_TICK),
                Err(_none_here) => return Self { _folder: None },
            }
        }
    }
}

/// A folder for frames. Dropped while it is empty and of our making, it is removed, and so are
/// those above it.
#[derive(Debug)]
pub struct FrameFolder {
    path: PathBuf,
    /// What was made for it, itself first.
    made: Vec<PathBuf>,
    /// When it was taken into use, by the clock of its file system.
    since: SystemTime,
}

impl FrameFolder {
    /// Makes the folder, and those above it, if need be; tries whether it can be written to.
    ///
    /// # Errors
    /// [`OutputError::Folder`].
    pub fn create(path: &Path, run: &str) -> Result<Self, OutputError> {
        let fail = |source| OutputError::Folder { path: path.to_owned(), source };
        if path.join(MANIFEST_FILE).exists() {
            return Err(OutputError::IsWorld { path: path.to_owned() });
        }
        let missing = path.ancestors().take_while(|folder| !folder.as_os_str().is_empty() && !folder.exists());
        let made = missing.map(Path::to_owned).collect();
        let mut folder = Self { path: path.to_owned(), made, since: SystemTime::now() };
        fs::create_dir_all(path).map_err(fail)?;
        let probe = path.join(format!(".{run}.part"));
        let since = File::create(&probe).and_then(|file| file.metadata()?.modified());
        fs::remove_file(&probe).and(since.map(|since| folder.since = since)).map_err(fail)?;
        Ok(folder)
    }

    /// The folder.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Numbers of the frames of a range whose files in the folder, of this extension, were written
    /// since it was created. Files have their names only when they are whole.
    #[must_use]
    pub fn whole_frames(&self, extension: &str, [first, end]: [u64; 2]) -> BTreeSet<u64> {
        let number = |name: &str| -> Option<u64> {
            name.strip_prefix("frame-")?.strip_suffix(extension)?.strip_suffix('.')?.parse().ok()
        };
        let Ok(entries) = fs::read_dir(&self.path) else { return BTreeSet::new() };
        let whole = entries.flatten().filter_map(|entry| {
            let frame = number(entry.file_name().to_str()?).filter(|frame| (first..end).contains(frame))?;
            let found = entry.metadata().ok()?;
            (found.is_file() && found.modified().ok()? >= self.since).then_some(frame)
        });
        whole.collect()
    }
}

impl Drop for FrameFolder {
    fn drop(&mut self) {
        for folder in &self.made {
            // Fails, as it should, when there is a frame in it.
            drop(fs::remove_dir(folder));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scratch(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("terravision-output-{}-{name}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        folder
    }

    #[test]
    fn a_file_appears_whole_or_not_at_all() {
        let folder = scratch("file");
        let path = folder.join("film.mp4");
        fs::write(&path, "old").unwrap();
        let file = TemporaryFile::create(&path, "tv-1-2").unwrap();
        assert_eq!(file.temporary().extension(), path.extension());
        fs::write(file.temporary(), "half").unwrap();
        drop(file);
        assert_eq!(fs::read_to_string(&path).unwrap(), "old");
        TemporaryFile::create(&path, "tv-1-2").unwrap().finish_with(|w| w.write_all(b"new")).unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "new");
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1);
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn what_cannot_be_written_is_said_before_the_run() {
        let folder = scratch("bad");
        for path in [folder.join("missing/film.mp4"), PathBuf::from("/proc/film.mp4"), PathBuf::from("/")] {
            let message = TemporaryFile::create(&path, "r").unwrap_err().to_string();
            assert!(message.starts_with("cannot write"), "{message}");
        }
        assert!(TemporaryFile::create(&folder, "r").unwrap_err().to_string().contains("end its name with a slash"));
        fs::write(folder.join("file"), "").unwrap();
        assert!(FrameFolder::create(&folder.join("file/frames"), "r").is_err());
        fs::write(folder.join(MANIFEST_FILE), "").unwrap();
        let message = FrameFolder::create(&folder, "r").unwrap_err().to_string();
        assert!(message.contains("is a terrain database"), "{message}");
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn what_dead_runs_and_killed_stages_left_is_removed_and_nothing_else() {
        let folder = scratch("dead");
        let alive = RunId::new_for_this_process().unwrap();
        // No process of that id starts in this very tick.
        let dead = format!("tv-{}-1", std::process::id());
        let keep = [
            format!(".film.{alive}.part.webm"),
            format!(".other.{dead}.part.mp4"),
            ".partial-77-a.png".into(),
            "film.mp4".into(),
        ];
        let go = [format!(".film.{dead}.part.mp4"), ".partial-7-a.png".into()];
        for name in keep.iter().chain(&go) {
            fs::write(folder.join(name), "").unwrap();
        }
        remove_partials(&folder, 7);
        drop(TemporaryFile::create(&folder.join("film.mp4"), "tv-1-2").unwrap());
        let mut left: Vec<String> =
            fs::read_dir(&folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        left.sort();
        let mut keep = keep.to_vec();
        keep.sort();
        assert_eq!(left, keep);
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_file_that_another_run_writes_is_told_by_its_process() {
        let folder = scratch("taken");
        let path = folder.join("film.mp4");
        let other = RunId::new_for_this_process().unwrap().to_string();
        let writing = TemporaryFile::create(&path, &other).unwrap();
        let told = TemporaryFile::create(&path, "tv-1-2").unwrap_err().to_string();
        assert!(
            told.contains("is being written by another terravision") && told.contains(&std::process::id().to_string())
        );
        assert!(writing.temporary().exists());
        // Another kind of file of that name is another file.
        drop(TemporaryFile::create(&folder.join("film.webm"), "tv-1-2").unwrap());
        drop(writing);
        drop(TemporaryFile::create(&path, "tv-1-2").unwrap());
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn frames_of_this_run_are_counted_and_no_others() {
        let folder = scratch("count");
        fs::write(folder.join("frame-000001.png"), "").unwrap();
        let old = File::options().write(true).open(folder.join("frame-000001.png")).unwrap();
        old.set_modified(SystemTime::UNIX_EPOCH).unwrap();
        let frames = FrameFolder::create(&folder, "r").unwrap();
        for name in [
            "frame-000002.png",
            "frame-000003.tif",
            "frame-1000000.png",
            "frame-000009.png",
            ".partial-7-frame-000004.png",
        ] {
            fs::write(folder.join(name), "").unwrap();
        }
        assert_eq!(frames.whole_frames("png", [0, 9]), BTreeSet::from([2]));
        assert_eq!(frames.whole_frames("png", [2, 2_000_000]), BTreeSet::from([2, 9, 1_000_000]));
        assert_eq!(frames.whole_frames("tif", [0, 9]), BTreeSet::from([3]));
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_device_is_written_to_as_it_is() {
        let file = TemporaryFile::create(Path::new("/dev/full"), "r").unwrap();
        assert_eq!(file.temporary(), Path::new("/dev/full"));
        assert!(file.finish_with(|w| w.write_all(b"x")).unwrap_err().to_string().contains("No space left"));
        assert!(Path::new("/dev/full").exists());
    }

    #[test]
    fn an_empty_folder_of_ours_goes_away_and_others_stay() {
        let folder = scratch("frames");
        drop(FrameFolder::create(&folder.join("a/deep"), "r").unwrap());
        assert!(!folder.join("a").exists());
        let made = FrameFolder::create(&folder.join("b"), "r").unwrap();
        fs::write(made.path().join("frame-000000.png"), "").unwrap();
        drop(made);
        assert!(folder.join("b").exists());
        drop(FrameFolder::create(&folder, "r").unwrap());
        assert!(folder.exists());
        fs::remove_dir_all(folder).unwrap();
    }
}
