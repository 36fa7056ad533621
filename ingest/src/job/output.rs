//! The output folder: files are written under other names and renamed when all is done, the
//! manifest last.

use crate::IngestError;
use crate::work::Work;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use terravision_common::database::{COLOR_FILE, ELEVATION_FILE, MANIFEST_FILE, Manifest, NODES_FILE};

const FILES: [&str; 4] = [MANIFEST_FILE, ELEVATION_FILE, COLOR_FILE, NODES_FILE];
const PART: &str = ".part";

/// The folder of a database that is being made. If dropped before [`Output::finish`], the previous
/// content remains.
#[derive(Debug)]
pub(super) struct Output {
    folder: PathBuf,
    /// Held locked: two ingests into one folder would mix their files.
    _lock: File,
    is_new: bool,
    is_finished: bool,
}

impl Output {
    /// Creates the folder, or checks that its content may be replaced.
    pub(super) fn begin(folder: &Path, may_overwrite: bool) -> Result<Self, IngestError> {
        let fail = |source| IngestError::Place { source, path: folder.to_owned() };
        if folder.join(MANIFEST_FILE).exists() && !may_overwrite {
            return Err(IngestError::usage(format!(
                "{} is a finished terrain database; --overwrite replaces it",
                folder.display()
            )));
        }
        let is_new = !folder.exists();
        if is_new {
            fs::create_dir_all(folder).map_err(fail)?;
        } else if !folder.is_dir() {
            return Err(IngestError::usage(format!("{} is a file, expected a folder to write to", folder.display())));
        } else {
            for entry in fs::read_dir(folder).map_err(fail)? {
                let name = entry.map_err(fail)?.file_name().to_string_lossy().into_owned();
                let is_ours = FILES.contains(&name.strip_suffix(PART).unwrap_or(&name));
                if !is_ours && !name.starts_with(".level-") {
                    return Err(IngestError::usage(format!(
                        "{} has {name} in it, which is not of a terrain database; give a folder of its own",
                        folder.display()
                    )));
                }
            }
        }
        let lock = File::open(folder).map_err(fail)?;
        if rustix::fs::flock(&lock, rustix::fs::FlockOperation::NonBlockingLockExclusive).is_err() {
            return Err(IngestError::usage(format!("another ingest is writing to {}", folder.display())));
        }
        let output = Self { folder: folder.to_owned(), _lock: lock, is_new, is_finished: false };
        output.remove_parts();
        Ok(output)
    }

    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Where a file is written until it is finished.
    pub(super) fn part(&self, name: &str) -> PathBuf {
        self.folder.join(format!("{name}{PART}"))
    }

    /// Fails when the file system has less than what is needed.
    pub(super) fn check_space(&self, needed_bytes: u64) -> Result<(), IngestError> {
        let path = self.folder.clone();
        let space = rustix::fs::statvfs(&self.folder)
            .map_err(|e| IngestError::Output { source: io::Error::from(e), path: path.clone() })?;
        let free_bytes = space.f_bavail.saturating_mul(space.f_frsize);
        if needed_bytes > free_bytes {
            return Err(IngestError::DiskSpace { needed_bytes, free_bytes, path });
        }
        Ok(())
    }

    /// Gives all files their names, the manifest last.
    pub(super) fn finish(mut self, manifest: &Manifest, work: &Work) -> Result<(), IngestError> {
        let at = |path: &Path| {
            let path = path.to_owned();
            move |source| IngestError::Output { source, path }
        };
        let path = self.part(MANIFEST_FILE);
        let text = manifest.fields().to_text().map_err(|e| at(&path)(io::Error::other(e)))?;
        let mut file = File::create(&path).map_err(at(&path))?;
        file.write_all(text.as_bytes()).and_then(|()| file.sync_all()).map_err(at(&path))?;
        work.check()?;
        // From here on it is quick; the manifest of an old database is removed before its other
        // files change.
        let old = self.folder.join(MANIFEST_FILE);
        match fs::remove_file(&old) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(at(&old)(e)),
            _ => {}
        }
        for name in [ELEVATION_FILE, COLOR_FILE, NODES_FILE, MANIFEST_FILE] {
            let to = self.folder.join(name);
            fs::rename(self.part(name), &to).map_err(at(&to))?;
        }
        self.is_finished = true;
        let folder = File::open(&self.folder).map_err(at(&self.folder))?;
        folder.sync_all().map_err(at(&self.folder))
    }

    fn remove_parts(&self) {
        for name in FILES {
            // A missing file need not be removed.
            fs::remove_file(self.part(name)).ok();
        }
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        if !self.is_finished {
            self.remove_parts();
            if self.is_new {
                // Fails, as it should, if another program has put files there.
                fs::remove_dir(&self.folder).ok();
            }
        }
    }
}
