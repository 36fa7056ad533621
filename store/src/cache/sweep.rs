//! Makes room by removing the least recently used entries.

use super::disk_bytes;
use super::ledger::Ledger;
use crate::mirror::is_name;
use std::ffi::OsStr;
use std::fs::{self, DirEntry, File};
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};
use terravision_common::database::{MANIFEST_FILE, NODES_FILE};

/// Prefix of the names of entries that are being written.
pub(super) const TEMPORARY: &str = ".new-";
/// A sweep reduces the cache to this percentage of its bound, so that sweeps are rare.
const KEPT_PERCENT: u64 = 80;
/// A temporary file that is older than this was left by a process that died.
const TEMPORARY_AGE: Duration = Duration::from_secs(600);
/// The index of a database is kept for this time after it was opened: a process that starts may
/// need it.
const INDEX_AGE: Duration = Duration::from_secs(24 * 3600);

struct Found {
    used: SystemTime,
    bytes: u64,
    path: PathBuf,
    /// Whether it may be removed.
    is_loose: bool,
}

/// Opens the file whose lock is shared by all writers, and exclusive for the process that makes
/// room.
pub(super) fn open_gate(folder: &Path) -> io::Result<File> {
    File::options().write(true).create(true).truncate(false).open(folder.join("gate"))
}

/// Removes entries down to 80 % of the bound and corrects the ledger, unless another process has
/// just made room for `size` bytes.
pub(super) fn sweep(folder: &Path, ledger: &Ledger, size: u64, most_bytes: u64) -> io::Result<()> {
    let gate = open_gate(folder)?;
    gate.lock()?;
    if ledger.has_room(size, most_bytes)? {
        return Ok(());
    }
    let mut found = Vec::new();
    let now = SystemTime::now();
    let age = |used: SystemTime| now.duration_since(used).unwrap_or_default();
    for_each_database(&folder.join("tiles"), &mut |database| {
        for_each(database, &mut |shard| {
            if !shard.file_type().is_ok_and(|kind| kind.is_dir()) {
                return;
            }
            for_each(&shard.path(), &mut |entry| {
                let Some(is_temporary) = kind_of_entry(&entry.file_name()) else { return };
                if let Some((used, bytes)) = file_of(entry) {
                    let is_loose = !is_temporary || age(used) > TEMPORARY_AGE;
                    found.push(Found { used, bytes, path: entry.path(), is_loose });
                }
            });
        });
    });
    for_each_database(&folder.join("index"), &mut |database| {
        for_each(database, &mut |entry| {
            if let Some((used, bytes)) = file_of(entry).filter(|_| is_of_an_index(&entry.file_name())) {
                found.push(Found { used, bytes, path: entry.path(), is_loose: age(used) > INDEX_AGE });
            }
        });
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
            // Removes the folder if this was its last entry.
            found.path.parent().map_or(Ok(()), fs::remove_dir).unwrap_or_default();
        }
    }
    ledger.settle(left)
}

/// Calls `each` for each entry of a folder; skips unreadable ones.
fn for_each(folder: &Path, each: &mut dyn FnMut(&DirEntry)) {
    fs::read_dir(folder).into_iter().flatten().flatten().for_each(|entry| each(&entry));
}

/// Calls `each` for each subfolder with the name of a database. Does not follow links.
fn for_each_database(folder: &Path, each: &mut dyn FnMut(&Path)) {
    for_each(folder, &mut |entry| {
        let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
        if is_folder && entry.file_name().to_str().is_some_and(is_name) {
            each(&entry.path());
        }
    });
}

/// The time of last use and the size on disk of a file; `None` for anything else, including links.
fn file_of(entry: &DirEntry) -> Option<(SystemTime, u64)> {
    let about = entry.metadata().ok().filter(fs::Metadata::is_file)?;
    let bytes = disk_bytes(about.len().saturating_sub(super::entry::HEADER_BYTES as u64));
    Some((about.modified().unwrap_or(SystemTime::UNIX_EPOCH), bytes))
}

/// `true` for the name of an entry that is being written, `false` for that of a complete entry,
/// `None` for other names.
fn kind_of_entry(name: &OsStr) -> Option<bool> {
    let name = name.to_str()?;
    if name.starts_with(TEMPORARY) {
        return Some(true);
    }
    let mut parts = name.rsplitn(3, '-');
    let is_number = |part: Option<&str>| part.is_some_and(|part| part.parse::<u64>().is_ok());
    let is_entry = is_number(parts.next()) && is_number(parts.next()) && parts.next().is_some();
    is_entry.then_some(false)
}

/// Whether a file with this name belongs to the index of a database, complete or being written.
fn is_of_an_index(name: &OsStr) -> bool {
    let is_new = |name: &str| ["nodes.new-", "manifest.new-"].iter().any(|start| name.starts_with(start));
    name.to_str().is_some_and(|name| [MANIFEST_FILE, NODES_FILE].contains(&name) || is_new(name))
}
