//! Making room: the entries that were not used for longest go.

use super::disk_bytes;
use super::ledger::Ledger;
use std::fs::{self, DirEntry, File};
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

/// Names of entries that are being written begin so.
pub(super) const TEMPORARY: &str = ".new-";
/// A sweep goes on until so much of the bound is left, in percent: sweeps are then rare.
const KEPT_PERCENT: u64 = 80;
/// What is being written for longer than this was left by a process that died.
const TEMPORARY_AGE: Duration = Duration::from_secs(600);
/// The index of a database that was opened within this time may be needed by a process that starts.
const INDEX_AGE: Duration = Duration::from_secs(24 * 3600);

struct Found {
    used: SystemTime,
    bytes: u64,
    path: PathBuf,
    /// May be removed.
    is_loose: bool,
}

/// The file whose lock all that write share, and that the one that makes room has alone.
pub(super) fn open_gate(folder: &Path) -> io::Result<File> {
    File::options().write(true).create(true).truncate(false).open(folder.join("gate"))
}

/// Removes entries until 80 % of the bound are left and the ledger is right, unless another process just made room for
/// `size` bytes.
pub(super) fn sweep(folder: &Path, ledger: &Ledger, size: u64, most_bytes: u64) -> io::Result<()> {
    let gate = open_gate(folder)?;
    gate.lock()?;
    if ledger.has_room(size, most_bytes)? {
        return Ok(());
    }
    let mut found = Vec::new();
    let now = SystemTime::now();
    let age = |used: SystemTime| now.duration_since(used).unwrap_or_default();
    for_each_file(&folder.join("tiles"), 3, &mut |entry, used, bytes| {
        let is_temporary = entry.file_name().as_encoded_bytes().starts_with(TEMPORARY.as_bytes());
        let is_loose = !is_temporary || age(used) > TEMPORARY_AGE;
        found.push(Found { used, bytes, path: entry.path(), is_loose });
    });
    for_each_file(&folder.join("index"), 2, &mut |entry, used, bytes| {
        found.push(Found { used, bytes, path: entry.path(), is_loose: age(used) > INDEX_AGE });
    });
    found.sort_by(|a, b| a.used.cmp(&b.used).then_with(|| a.path.cmp(&b.path)));
    let mut left: u64 = found.iter().map(|found| found.bytes).sum();
    let target = most_bytes / 100 * KEPT_PERCENT;
    for found in found.iter().filter(|found| found.is_loose) {
        if left <= target {
            break;
        }
        if fs::remove_file(&found.path).is_ok() {
            left -= found.bytes;
            // An empty folder goes with its last entry; one that is not empty stays.
            found.path.parent().map_or(Ok(()), fs::remove_dir).unwrap_or_default();
        }
    }
    ledger.settle(left)
}

/// Each file below a folder, `depth` folders down at most. What cannot be read is left out.
fn for_each_file(folder: &Path, depth: u32, each: &mut dyn FnMut(&DirEntry, SystemTime, u64)) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let Ok(about) = entry.metadata() else { continue };
        if about.is_dir() {
            if depth > 1 {
                for_each_file(&entry.path(), depth - 1, each);
            }
        } else {
            let bytes = disk_bytes(about.len().saturating_sub(super::entry::HEADER_BYTES as u64));
            each(&entry, about.modified().unwrap_or(SystemTime::UNIX_EPOCH), bytes);
        }
    }
}
