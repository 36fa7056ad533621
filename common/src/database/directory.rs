//! The directory of a PMTiles v3 archive. (The `pmtiles` crate does not expose offsets, so these 60
//! lines are our own; ids of tiles along the Hilbert curve come from the crate.)

use super::archive::ArchiveError;
use pmtiles::MAX_TILE_ID;

/// One entry: a run of tiles with one content, or, when `run_length` is 0, a leaf directory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Entry {
    pub(crate) tile_id: u64,
    pub(crate) offset: u64,
    pub(crate) length: u32,
    pub(crate) run_length: u32,
}

fn damaged(what: &'static str) -> ArchiveError {
    ArchiveError::Damaged { what }
}

fn read_u64(bytes: &mut &[u8]) -> Result<u64, ArchiveError> {
    let mut value = 0u64;
    for shift in (0..64).step_by(7) {
        let (&byte, rest) = bytes.split_first().ok_or(damaged("its directory ends early"))?;
        *bytes = rest;
        let part = u64::from(byte & 0x7f);
        if part << shift >> shift != part {
            return Err(damaged("its directory has a number that is too large"));
        }
        value |= part << shift;
        if byte < 0x80 {
            return Ok(value);
        }
    }
    Err(damaged("its directory has a number that is too large"))
}

fn read_u32(bytes: &mut &[u8]) -> Result<u32, ArchiveError> {
    u32::try_from(read_u64(bytes)?).ok().ok_or(damaged("its directory has a number that is too large"))
}

/// Parses a directory (decompressed).
pub(crate) fn parse_directory(mut bytes: &[u8]) -> Result<Box<[Entry]>, ArchiveError> {
    let bytes = &mut bytes;
    let count = read_u64(bytes)?;
    // Each entry has four numbers of at least one byte each: this bounds the allocation by a small
    // multiple of the input.
    if count > bytes.len() as u64 / 4 {
        return Err(damaged("its directory claims more entries than it has bytes for"));
    }
    let mut entries = vec![Entry { tile_id: 0, offset: 0, length: 0, run_length: 0 }; count as usize];
    let mut id = 0u64;
    let mut is_first = true;
    for entry in &mut entries {
        let step = read_u64(bytes)?;
        id = id.checked_add(step).ok_or(damaged("its directory has a tile number that is too large"))?;
        if (step == 0 && !is_first) || id > MAX_TILE_ID {
            return Err(damaged("its directory's tile numbers do not ascend"));
        }
        (entry.tile_id, is_first) = (id, false);
    }
    for entry in &mut entries {
        entry.run_length = read_u32(bytes)?;
    }
    for entry in &mut entries {
        entry.length = read_u32(bytes)?;
        if entry.length == 0 {
            return Err(damaged("its directory has an empty tile"));
        }
    }
    let mut next = None;
    for entry in &mut entries {
        entry.offset = match (read_u64(bytes)?, next) {
            (0, Some(next)) => next,
            (0, None) => return Err(damaged("its directory begins without an offset")),
            (offset, _) => offset - 1,
        };
        let end = entry.offset.checked_add(u64::from(entry.length));
        next = Some(end.ok_or(damaged("its directory points beyond the end"))?);
    }
    Ok(entries.into_boxed_slice())
}

/// The entry that covers a tile: its run, or the leaf directory that would have it.
pub(crate) fn find(entries: &[Entry], tile_id: u64) -> Option<(usize, Entry)> {
    let index = entries.partition_point(|e| e.tile_id <= tile_id).checked_sub(1)?;
    let entry = entries[index];
    (entry.run_length == 0 || tile_id - entry.tile_id < u64::from(entry.run_length)).then_some((index, entry))
}
