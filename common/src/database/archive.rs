//! Reading a PMTiles v3 archive with positioned reads: any thread, no async runtime, nothing trusted.

use super::directory::{Entry, find, parse_directory};
use super::manifest::ArchiveRecord;
use crate::node::NodeId;
use crate::world::World;
use flate2::read::GzDecoder;
use pmtiles::{TileCoord, TileId};
use std::fs::File;
use std::io::{self, Read};
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::OnceLock;

/// Length of the fixed header (PMTiles v3 specification, section 3).
const HEADER_BYTES: usize = 127;
/// No directory or index is larger: a hundred million tiles need less.
const MAX_INDEX_BYTES: u64 = 1 << 30;
/// No single directory is larger, decompressed.
const MAX_DIRECTORY_BYTES: u64 = 64 << 20;

/// What is wrong with an archive.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ArchiveError {
    /// It is not a PMTiles v3 archive.
    #[error("it is not a PMTiles archive of version 3")]
    NotPmtiles,
    /// Something in it cannot be.
    #[error("it is damaged: {what}")]
    Damaged {
        /// What.
        what: &'static str,
    },
    /// It is not as long as it was when it was written.
    #[error("it has {found} bytes, expected {expected}")]
    Length {
        /// What the manifest says.
        expected: u64,
        /// What it has.
        found: u64,
    },
    /// Header or directories are not what was written.
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
        found: u32,
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

/// Where a node's tile is in an archive: zoom `levels - 1 - q`, column `m`, row from the north of the root's square.
/// `None` for a node above the root or outside its square.
#[must_use]
pub fn tile_coord(world: &World, node: NodeId) -> Option<TileCoord> {
    let zoom = (world.levels() - 1).checked_sub(node.q())?;
    let row = (1u32 << zoom).checked_sub(node.n() + 1)?;
    TileCoord::new(zoom, node.m(), row).ok()
}

/// The sections of an archive, from its header.
#[derive(Debug, Clone, Copy)]
struct Sections {
    root: [u64; 2],
    leaf: [u64; 2],
    data: [u64; 2],
    is_gzip: bool,
}

impl Sections {
    fn parse(header: &[u8; HEADER_BYTES], file_bytes: u64) -> Result<Self, ArchiveError> {
        if &header[..7] != b"PMTiles" || header[7] != 3 {
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
        let sections = Self { root: section(8)?, leaf: section(40)?, data: section(56)?, is_gzip };
        if sections.root[1] > MAX_DIRECTORY_BYTES
            || sections.leaf[1] > MAX_INDEX_BYTES
            || sections.data[0] > MAX_INDEX_BYTES
        {
            return Err(ArchiveError::Damaged { what: "its directories are impossibly large" });
        }
        Ok(sections)
    }

    fn directory(&self, bytes: &[u8]) -> Result<Box<[Entry]>, ArchiveError> {
        if !self.is_gzip {
            return parse_directory(bytes);
        }
        let mut plain = Vec::new();
        let unpacked = GzDecoder::new(bytes).take(MAX_DIRECTORY_BYTES).read_to_end(&mut plain);
        if unpacked.is_err() || plain.len() as u64 == MAX_DIRECTORY_BYTES {
            return Err(ArchiveError::Damaged { what: "a directory does not decompress" });
        }
        parse_directory(&plain)
    }
}

fn crc32_of(file: &File, [offset, length]: [u64; 2], hasher: &mut crc32fast::Hasher) -> io::Result<()> {
    let mut buffer = vec![0; 1 << 16];
    let mut done = 0;
    while done < length {
        let part = (length - done).min(buffer.len() as u64) as usize;
        file.read_exact_at(&mut buffer[..part], offset + done)?;
        hasher.update(&buffer[..part]);
        done += part as u64;
    }
    Ok(())
}

fn open_sections(file: &File) -> Result<Sections, ArchiveError> {
    let file_bytes = file.metadata()?.len();
    let mut header = [0; HEADER_BYTES];
    if file_bytes < HEADER_BYTES as u64 {
        return Err(ArchiveError::NotPmtiles);
    }
    file.read_exact_at(&mut header, 0)?;
    Sections::parse(&header, file_bytes)
}

fn crc32_of_index(file: &File, sections: &Sections) -> io::Result<u32> {
    let mut hasher = crc32fast::Hasher::new();
    crc32_of(file, [0, sections.data[0]], &mut hasher)?;
    crc32_of(file, sections.leaf, &mut hasher)?;
    Ok(hasher.finalize())
}

/// Checksum of everything in an archive that is not a tile: what lies before the tiles, then the leaf directories.
/// Called by ingest when it has written one.
///
/// # Errors
/// [`ArchiveError`] when it is no archive or cannot be read.
pub fn index_crc32(path: &Path) -> Result<u32, ArchiveError> {
    let file = File::open(path)?;
    let sections = open_sections(&file)?;
    Ok(crc32_of_index(&file, &sections)?)
}

/// A tile archive, open for reading.
#[derive(Debug)]
pub struct Archive {
    file: File,
    sections: Sections,
    root: Box<[Entry]>,
    /// Leaf directories, by their index in the root, read when first needed.
    leaves: Box<[OnceLock<Box<[Entry]>>]>,
}

impl Archive {
    /// Opens an archive and checks its length, header and directories against the manifest.
    ///
    /// # Errors
    /// [`ArchiveError`].
    pub fn open(path: &Path, record: &ArchiveRecord) -> Result<Self, ArchiveError> {
        let file = File::open(path)?;
        let found = file.metadata()?.len();
        if found != record.bytes {
            return Err(ArchiveError::Length { expected: record.bytes, found });
        }
        let sections = open_sections(&file)?;
        let found = crc32_of_index(&file, &sections)?;
        if found != record.index_crc32 {
            return Err(ArchiveError::Checksum { expected: record.index_crc32, found });
        }
        let mut bytes = vec![0; sections.root[1] as usize];
        file.read_exact_at(&mut bytes, sections.root[0])?;
        let root = sections.directory(&bytes)?;
        let leaves = root.iter().map(|_| OnceLock::new()).collect();
        Ok(Self { file, sections, root, leaves })
    }

    fn leaf(&self, index: usize, entry: Entry) -> Result<&[Entry], ArchiveError> {
        if let Some(leaf) = self.leaves[index].get() {
            return Ok(leaf);
        }
        let end = entry.offset.checked_add(u64::from(entry.length));
        if u64::from(entry.length) > MAX_DIRECTORY_BYTES || end.is_none_or(|end| end > self.sections.leaf[1]) {
            return Err(ArchiveError::Damaged { what: "a leaf directory lies beyond its end" });
        }
        let mut bytes = vec![0; entry.length as usize];
        self.file.read_exact_at(&mut bytes, self.sections.leaf[0] + entry.offset)?;
        let leaf = self.sections.directory(&bytes)?;
        Ok(self.leaves[index].get_or_init(|| leaf))
    }

    /// Reads a tile into `out` (replacing what is there); false when the archive has none. A tile longer than
    /// `max_bytes` is not read.
    ///
    /// # Errors
    /// [`ArchiveError`].
    pub fn read(&self, tile: TileId, max_bytes: usize, out: &mut Vec<u8>) -> Result<bool, ArchiveError> {
        let Some((index, mut entry)) = find(&self.root, tile.value()) else { return Ok(false) };
        if entry.run_length == 0 {
            match find(self.leaf(index, entry)?, tile.value()) {
                Some((_, found)) => entry = found,
                None => return Ok(false),
            }
        }
        if entry.run_length == 0 {
            return Err(ArchiveError::Damaged { what: "its directories are nested too deeply" });
        }
        if entry.length as usize > max_bytes {
            return Err(ArchiveError::TileLength { expected: max_bytes, found: entry.length });
        }
        let end = entry.offset.checked_add(u64::from(entry.length));
        if end.is_none_or(|end| end > self.sections.data[1]) {
            return Err(ArchiveError::Damaged { what: "a tile lies beyond its end" });
        }
        out.clear();
        out.resize(entry.length as usize, 0);
        self.file.read_exact_at(out, self.sections.data[0] + entry.offset)?;
        Ok(true)
    }
}
