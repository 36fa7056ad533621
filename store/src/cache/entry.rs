//! One entry: `"TVx1"`, the crc32 of the content, the content.

use bytes::Bytes;
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;
use std::time::SystemTime;
use terravision_common::files::open_regular;

const MAGIC: &[u8; 4] = b"TVx1";
pub(super) const HEADER_BYTES: usize = 8;

/// Reads the content of an entry, and the time of its last use; `None` if the entry is damaged.
pub(super) fn read(path: &Path, length: u64) -> io::Result<Option<(Bytes, SystemTime)>> {
    let file = open_regular(path)?;
    let about = file.metadata()?;
    if about.len() != length + HEADER_BYTES as u64 {
        return Ok(None);
    }
    // Exactly the length of the requested piece; more is never read, even if the file grows.
    let mut bytes = Vec::with_capacity(about.len() as usize);
    file.take(about.len()).read_to_end(&mut bytes)?;
    let Some((header, content)) = bytes.split_first_chunk::<HEADER_BYTES>() else { return Ok(None) };
    let is_whole = content.len() as u64 == length
        && &header[..4] == MAGIC
        && header[4..] == crc32fast::hash(content).to_le_bytes();
    let modified = about.modified()?;
    Ok(is_whole.then(|| (Bytes::from(bytes).slice(HEADER_BYTES..), modified)))
}

pub(super) fn write(path: &Path, content: &[u8]) -> io::Result<()> {
    let mut file = File::create_new(path)?;
    file.write_all(MAGIC)?;
    file.write_all(&crc32fast::hash(content).to_le_bytes())?;
    // Not synced: after a power failure the checksum detects torn entries.
    file.write_all(content)
}
