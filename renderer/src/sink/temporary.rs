//! Files that appear complete or not at all: written under a temporary name in the same folder,
//! then renamed.

use super::SinkError;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// The temporary name beside `path`, with the same extension (ffmpeg goes by it).
pub(super) fn temporary_name(path: &Path) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!(".partial-{}-{name}", std::process::id()))
}

/// Writes a whole file with `write`, then gives it its name. On failure nothing is left.
pub(super) fn write_whole(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> Result<(), SinkError>,
) -> Result<(), SinkError> {
    // A device or a pipe (/dev/full, /dev/stdout) is written to as it is: it has no half content to
    // hide.
    if path.metadata().is_ok_and(|found| !found.is_file() && !found.is_dir()) {
        let file = File::options().write(true).open(path).map_err(|source| failure(path, source))?;
        let mut out = BufWriter::new(file);
        write(&mut out)?;
        return out.flush().map_err(|source| failure(path, source));
    }
    let temporary = temporary_name(path);
    let result = File::create(&temporary)
        .map_err(|source| failure(path, source))
        .and_then(|file| {
            let mut out = BufWriter::with_capacity(1 << 18, file);
            write(&mut out)?;
            out.flush().map_err(|source| failure(path, source))
        })
        .and_then(|()| fs::rename(&temporary, path).map_err(|source| failure(path, source)));
    if result.is_err() {
        // The error to tell of is the first; a leftover that cannot be removed either changes
        // nothing.
        let _removed = fs::remove_file(&temporary);
    }
    result
}

pub(super) fn failure(path: &Path, source: io::Error) -> SinkError {
    SinkError::Write { source, path: path.to_owned() }
}
