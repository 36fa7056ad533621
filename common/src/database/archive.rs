//! Reads a PMTiles v3 archive with positioned reads: from any thread, without an async runtime, and
//! without trusting its content.

use super::archive_layout::{ARCHIVE_HEADER_BYTES, ArchiveLayout, Directory, Place};
use super::leaves::Leaves;
use super::manifest::ArchiveRecord;
use crate::files::open_regular;
use crate::node::NodeId;
use crate::world::World;
use pmtiles::{TileCoord, TileId};
use std::fs::File;
use std::io;
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::Arc;

/// What is wrong with an archive.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ArchiveError {
    /// It is not a PMTiles v3 archive.
    #[error("it is not a PMTiles archive of version 3")]
    NotPmtiles,
    /// Its content is not valid.
    #[error("it is damaged: {what}")]
    Damaged {
        /// What.
        what: &'static str,
    },
    /// Its length has changed since it was written.
    #[error("it has {found} bytes, expected {expected}")]
    Length {
        /// What the manifest says.
        expected: u64,
        /// What it has.
        found: u64,
    },
    /// Header or directories have changed since they were written.
    #[error("the checksum of its directories is {found:08x}, expected {expected:08x}")]
    Checksum {
        /// What the manifest says.
        expected: u32,
        /// What its bytes give.
        found: u32,
    },
    /// A tile is longer than a tile can be.
    #[error("a tile is {found} bytes long, expected at most {expected}")]
    TileLength {
        /// The most that is possible.
        expected: usize,
        /// What the directory says.
        found: u64,
    },
    /// It cannot be read.
    #[error("it cannot be read: {source}")]
    Read {
        /// Why.
        #[source]
        source: io::Error,
    },
}

impl From<io::Error> for ArchiveError {
    fn from(source: io::Error) -> Self {
        Self::Read { source }
    }
}

/// Where a node's tile is in an archive: zoom `levels - 1 - q`, column `m`, row from the north of
/// the root's square. Of a body, zooms begin with the one whose square holds all roots. `None` for a
/// node above the root or outside its square.
#[must_use]
pub fn tile_coord(world: &World, node: NodeId) -> Option<TileCoord> {
    let zoom = (world.levels() - 1).checked_sub(node.q())? + least_zoom(world);
    let row = (1u32 << zoom).checked_sub(node.n() + 1)?;
    TileCoord::new(zoom, node.m(), row).ok()
}

/// The zoom of the coarsest level: 0 of a plane.
#[must_use]
pub fn least_zoom(world: &World) -> u8 {
    let [columns, rows] = world.nodes_at(world.levels() - 1);
    columns.max(rows).next_power_of_two().ilog2() as u8
}

fn crc32_of(file: &File, range: Range<u64>, hasher: &mut crc32fast::Hasher) -> io::Result<()> {
    let mut buffer = vec![0; 1 << 16];
    let mut at = range.start;
    while at < range.end {
        let part = (range.end - at).min(buffer.len() as u64) as usize;
        file.read_exact_at(&mut buffer[..part], at)?;
        hasher.update(&buffer[..part]);
        at += part as u64;
    }
    Ok(())
}

fn open_layout(file: &File) -> Result<ArchiveLayout, ArchiveError> {
    let file_bytes = file.metadata()?.len();
    let mut header = [0; ARCHIVE_HEADER_BYTES];
    if file_bytes < ARCHIVE_HEADER_BYTES as u64 {
        return Err(ArchiveError::NotPmtiles);
    }
    file.read_exact_at(&mut header, 0)?;
    ArchiveLayout::parse(&header, file_bytes)
}

fn crc32_of_index(file: &File, layout: &ArchiveLayout) -> io::Result<u32> {
    let mut hasher = crc32fast::Hasher::new();
    crc32_of(file, layout.before_tiles(), &mut hasher)?;
    crc32_of(file, layout.leaves(), &mut hasher)?;
    Ok(hasher.finalize())
}

/// Checksum of everything in an archive that is not a tile: what lies before the tiles, then the
/// leaf directories. Called by ingest when it has written one.
///
/// # Errors
/// [`ArchiveError`] when it is not an archive or cannot be read.
pub fn index_crc32(path: &Path) -> Result<u32, ArchiveError> {
    let file = open_regular(path)?;
    let layout = open_layout(&file)?;
    Ok(crc32_of_index(&file, &layout)?)
}

/// A tile archive, open for reading.
#[derive(Debug)]
pub struct Archive {
    file: File,
    layout: ArchiveLayout,
    root: Directory,
    /// Leaf directories, read when they are needed.
    leaves: Leaves,
}

impl Archive {
    /// Opens an archive and checks its length, header and directories against the manifest.
    ///
    /// # Errors
    /// [`ArchiveError`].
    pub fn open(path: &Path, record: &ArchiveRecord) -> Result<Self, ArchiveError> {
        let file = open_regular(path)?;
        let found = file.metadata()?.len();
        if found != record.bytes {
            return Err(ArchiveError::Length { expected: record.bytes, found });
        }
        let layout = open_layout(&file)?;
        let found = crc32_of_index(&file, &layout)?;
        if found != record.index_crc32 {
            return Err(ArchiveError::Checksum { expected: record.index_crc32, found });
        }
        let root = layout.directory(&read_range(&file, layout.root())?)?;
        Ok(Self { file, layout, root, leaves: Leaves::default() })
    }

    fn leaf(&self, index: usize, range: Range<u64>) -> Result<Arc<Directory>, ArchiveError> {
        if let Some(leaf) = self.leaves.get(index) {
            return Ok(leaf);
        }
        let bytes = read_range(&self.file, range)?;
        self.leaves.get_or_parse(index, || self.layout.directory(&bytes))
    }

    /// Reads a tile into `out`, replacing its content; `false` when the archive does not contain
    /// it. A tile longer than `max_bytes` is not read.
    ///
    /// # Errors
    /// [`ArchiveError`].
    pub fn read(&self, tile: TileId, max_bytes: usize, out: &mut Vec<u8>) -> Result<bool, ArchiveError> {
        let range = match self.layout.place(&self.root, tile)? {
            Some(Place::Tile(range)) => Some(range),
            Some(Place::Leaf { index, range }) => self.layout.place_in_leaf(&*self.leaf(index, range)?, tile)?,
            None => None,
        };
        let Some(range) = range else { return Ok(false) };
        let length = range.end - range.start;
        if length > max_bytes as u64 {
            return Err(ArchiveError::TileLength { expected: max_bytes, found: length });
        }
        out.clear();
        out.resize(length as usize, 0);
        self.file.read_exact_at(out, range.start)?;
        Ok(true)
    }
}

fn read_range(file: &File, range: Range<u64>) -> io::Result<Vec<u8>> {
    let mut bytes = vec![0; (range.end - range.start) as usize];
    file.read_exact_at(&mut bytes, range.start)?;
    Ok(bytes)
}
