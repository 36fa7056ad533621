//! The layout of a PMTiles v3 archive. The caller provides the bytes, from a file or a network;
//! their content is not trusted.

use super::archive::ArchiveError;
use super::directory::{Entry, find, parse_directory};
use crate::bug::contained;
use flate2::read::GzDecoder;
use pmtiles::TileId;
use std::io::Read;
use std::ops::Range;

/// Length of the fixed header (PMTiles v3 specification, section 3).
pub const ARCHIVE_HEADER_BYTES: usize = 127;
/// Upper bound of the bytes of all leaf directories of an archive, and of everything before its
/// tiles: a hundred million tiles need less.
pub const MOST_INDEX_BYTES: u64 = 1 << 30;
/// Upper bound of the bytes of a directory, stored and decompressed: for a hundred million tiles a
/// fifth suffices. In memory its entries take at most six times as much.
pub const MOST_DIRECTORY_BYTES: u64 = 2 << 20;

/// The sections of an archive, from its header.
#[derive(Debug, Clone, Copy)]
pub struct ArchiveLayout {
    root: [u64; 2],
    leaf: [u64; 2],
    data: [u64; 2],
    is_gzip: bool,
}

/// A directory of an archive: the root, or a leaf.
#[derive(Debug, Clone)]
pub struct Directory(Box<[Entry]>);

impl Directory {
    /// Number of its entries.
    #[must_use]
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Bytes that it takes in memory.
    #[must_use]
    pub fn memory_bytes(&self) -> usize {
        size_of_val(&*self.0)
    }

    #[cfg(test)]
    pub(super) fn of_entries(count: usize) -> Self {
        Self(vec![Entry { tile_id: 0, offset: 0, length: 1, run_length: 1 }; count].into())
    }

    /// Whether it has none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

/// The entry of a directory for a tile; ranges are bytes of the archive.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Place {
    /// The bytes of the tile.
    Tile(Range<u64>),
    /// The leaf directory that may contain the tile.
    Leaf {
        /// The entry in the root directory, counted from 0.
        index: usize,
        /// Where it is.
        range: Range<u64>,
    },
}

impl ArchiveLayout {
    /// Reads the header, the first [`ARCHIVE_HEADER_BYTES`] bytes of an archive of `file_bytes`
    /// bytes.
    ///
    /// # Errors
    /// [`ArchiveError`] when it is not an archive, or its numbers contradict each other.
    pub fn parse(header: &[u8], file_bytes: u64) -> Result<Self, ArchiveError> {
        if header.len() < ARCHIVE_HEADER_BYTES || &header[..7] != b"PMTiles" || header[7] != 3 {
            return Err(ArchiveError::NotPmtiles);
        }
        let number = |at: usize| {
            let mut bytes = [0; 8];
            bytes.copy_from_slice(&header[at..at + 8]);
            u64::from_le_bytes(bytes)
        };
        let section = |at: usize| {
            let [offset, length] = [number(at), number(at + 8)];
            match offset.checked_add(length) {
                Some(end) if end <= file_bytes => Ok([offset, length]),
                _ => Err(ArchiveError::Damaged { what: "a section of it lies beyond its end" }),
            }
        };
        let is_gzip = match header[97] {
            1 => false,
            2 => true,
            _ => return Err(ArchiveError::Damaged { what: "its directories are compressed in an unknown way" }),
        };
        let layout = Self { root: section(8)?, leaf: section(40)?, data: section(56)?, is_gzip };
        if layout.root[1] > MOST_DIRECTORY_BYTES
            || layout.leaf[1] > MOST_INDEX_BYTES
            || layout.data[0] > MOST_INDEX_BYTES
        {
            return Err(ArchiveError::Damaged { what: "its directories are impossibly large" });
        }
        Ok(layout)
    }

    /// Where the root directory is.
    #[must_use]
    pub fn root(&self) -> Range<u64> {
        range(self.root)
    }

    /// Everything before the tiles: header, root directory, metadata.
    #[must_use]
    pub fn before_tiles(&self) -> Range<u64> {
        0..self.data[0]
    }

    /// Where the leaf directories are.
    #[must_use]
    pub fn leaves(&self) -> Range<u64> {
        range(self.leaf)
    }

    /// Where the tiles are.
    #[must_use]
    pub fn tiles(&self) -> Range<u64> {
        range(self.data)
    }

    /// Reads a directory from its bytes.
    ///
    /// # Errors
    /// [`ArchiveError`] when it does not decompress or is not a directory.
    pub fn directory(&self, bytes: &[u8]) -> Result<Directory, ArchiveError> {
        if !self.is_gzip {
            return parse_directory(bytes).map(Directory);
        }
        let mut plain = Vec::new();
        // One byte more than allowed distinguishes a directory that is too large from one that just
        // fits.
        let unpack = || GzDecoder::new(bytes).take(MOST_DIRECTORY_BYTES + 1).read_to_end(&mut plain);
        if !matches!(contained(unpack), Ok(Ok(_))) {
            return Err(ArchiveError::Damaged { what: "a directory does not decompress" });
        }
        if plain.len() as u64 > MOST_DIRECTORY_BYTES {
            return Err(ArchiveError::Damaged { what: "a directory is impossibly large when it is decompressed" });
        }
        parse_directory(&plain).map(Directory)
    }

    /// Looks up a tile in a directory; `None` when the archive does not contain it.
    ///
    /// # Errors
    /// [`ArchiveError`] when the entry points beyond its section.
    pub fn place(&self, directory: &Directory, tile: TileId) -> Result<Option<Place>, ArchiveError> {
        let Some((index, entry)) = find(&directory.0, tile.value()) else { return Ok(None) };
        let inside = |section: [u64; 2], what| match entry.offset.checked_add(u64::from(entry.length)) {
            Some(end) if end <= section[1] => Ok(section[0] + entry.offset..section[0] + end),
            _ => Err(ArchiveError::Damaged { what }),
        };
        if entry.run_length > 0 {
            return inside(self.data, "a tile lies beyond its end").map(|range| Some(Place::Tile(range)));
        }
        const LEAF: &str = "a leaf directory lies beyond its end";
        if u64::from(entry.length) > MOST_DIRECTORY_BYTES {
            return Err(ArchiveError::Damaged { what: "a leaf directory is impossibly large" });
        }
        inside(self.leaf, LEAF).map(|range| Some(Place::Leaf { index, range }))
    }

    /// Looks up a tile in a leaf directory, which contains only tiles.
    ///
    /// # Errors
    /// [`ArchiveError`].
    pub fn place_in_leaf(&self, leaf: &Directory, tile: TileId) -> Result<Option<Range<u64>>, ArchiveError> {
        match self.place(leaf, tile)? {
            Some(Place::Tile(range)) => Ok(Some(range)),
            Some(Place::Leaf { .. }) => Err(ArchiveError::Damaged { what: "its directories are nested too deeply" }),
            None => Ok(None),
        }
    }
}

fn range([offset, length]: [u64; 2]) -> Range<u64> {
    offset..offset + length
}
