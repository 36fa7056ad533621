//! Reading a terrain database: the folder that ingest writes.
//!
//! ```text
//! world.tv/
//!   manifest.json       what it is, written last: a folder without it is an ingest that did not finish
//!   elevation.pmtiles   elevation tiles, our own lossless codec     (elevation)
//!   color.pmtiles       colour tiles, JPEG and a checksum           (color)
//!   nodes.tvn           lowest and highest ground under every node  (ranges)
//! ```
//!
//! Archives are PMTiles v3: zoom = levels - 1 - q (of a body, whose level of roots has several nodes,
//! more), x = m, y counts from the north of the root's square. Content of these files is not trusted: lengths are checked before memory is allocated,
//! each tile has a checksum, and the manifest has the checksums of everything else. The error for a
//! damaged database says which file or which tile is damaged.
//!
//! Several threads may read a [`Database`] at once; each has its own [`TileScratch`].

mod archive;
mod archive_layout;
mod body_ranges;
mod color;
mod directory;
mod elevation;
mod index;
mod leaves;
mod manifest;
mod ranges;
mod sparse_ranges;
mod tile;

pub use archive::{Archive, ArchiveError, index_crc32, least_zoom, tile_coord};
pub use archive_layout::{
    ARCHIVE_HEADER_BYTES, ArchiveLayout, Directory, MOST_DIRECTORY_BYTES, MOST_INDEX_BYTES, Place,
};
pub use color::{
    ColorCodecError, color_tile_bytes, decode_color_picture, decode_color_tile, make_color_mips, seal_color_tile,
};
pub use elevation::{
    ElevationCodecError, HEIGHT_STEPS_PER_M, decode_elevation_planes, decode_elevation_tile, encode_elevation_tile,
    encode_elevation_tile_with_validity,
};
pub use index::{Index, read_world};
pub use leaves::{Leaves, MOST_LEAF_BYTES};
pub use manifest::{
    ArchiveRecord, Body, ColorLayer, Crs, ElevationLayer, FEATURE_BODY, FEATURE_SPARSE_LEVELS, FEATURE_VALIDITY,
    FEATURES_VERSION, FORMAT_VERSION, MOST_MANIFEST_BYTES, Manifest, ManifestError, ManifestFields, NodesRecord,
    Source, Voids, VoidsRecord,
};
pub use ranges::{Layers, MOST_NODES_BYTES, NodeRange, NodeRanges, RangesError};
pub use tile::Tile;

use crate::files::kind_of;
use crate::node::NodeId;
use crate::world::World;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Name of the manifest in a database's folder.
pub const MANIFEST_FILE: &str = "manifest.json";
/// Name of the archive of elevation tiles.
pub const ELEVATION_FILE: &str = "elevation.pmtiles";
/// Name of the archive of colour tiles.
pub const COLOR_FILE: &str = "color.pmtiles";
/// Name of the file of height ranges.
pub const NODES_FILE: &str = "nodes.tvn";

/// What is at the path instead of a database.
fn why_no_database(path: &Path) -> String {
    match std::fs::metadata(path).map(|about| about.file_type()) {
        Err(_) => "nothing of that name exists".to_owned(),
        Ok(kind) if kind.is_dir() => {
            format!("the folder has no {MANIFEST_FILE}; an ingest that was interrupted can be run again")
        }
        Ok(kind) if kind.is_file() => "it is a file; terravision ingest makes databases of rasters".to_owned(),
        Ok(kind) => format!("it is {}, expected a folder or a tar archive", kind_of(kind)),
    }
}

/// Why a database cannot be opened.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DatabaseError {
    /// No manifest: there is no database, or it was never finished.
    #[error("there is no finished terrain database ({}): {}", why_no_database(path), path.display())]
    NotADatabase {
        /// The folder.
        path: PathBuf,
    },
    /// The manifest cannot be used.
    #[error("the manifest cannot be used: {source}, in {}", path.display())]
    Manifest {
        /// What is wrong.
        #[source]
        source: ManifestError,
        /// The manifest.
        path: PathBuf,
    },
    /// An archive is damaged.
    #[error("the tile archive cannot be used: {source}, in {}", path.display())]
    Archive {
        /// What is wrong.
        #[source]
        source: ArchiveError,
        /// The archive.
        path: PathBuf,
    },
    /// The file of height ranges is damaged.
    #[error("the file of height ranges cannot be used: {source}, in {}", path.display())]
    Ranges {
        /// What is wrong.
        #[source]
        source: RangesError,
        /// The file.
        path: PathBuf,
    },
    /// A file cannot be read.
    #[error("cannot read: {source}: {}", path.display())]
    Read {
        /// Why.
        #[source]
        source: io::Error,
        /// The file.
        path: PathBuf,
    },
}

/// Which of the two pyramids.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Layer {
    /// Elevation.
    Elevation,
    /// Colour.
    Color,
}

impl std::fmt::Display for Layer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Elevation => "elevation",
            Self::Color => "colour",
        })
    }
}

/// Why a tile cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TileError {
    /// The database does not contain it.
    #[error("the {layer} tile of node {node} is missing")]
    Missing {
        /// The pyramid.
        layer: Layer,
        /// The node.
        node: NodeId,
    },
    /// Its bytes have changed since they were written.
    #[error("the {layer} tile of node {node} is damaged: {reason}")]
    Corrupt {
        /// The pyramid.
        layer: Layer,
        /// The node.
        node: NodeId,
        /// What is wrong with it.
        reason: TileDamage,
    },
    /// It cannot be read.
    #[error("the {layer} tile of node {node} cannot be read: {source}")]
    Read {
        /// The pyramid.
        layer: Layer,
        /// The node.
        node: NodeId,
        /// Why.
        #[source]
        source: io::Error,
    },
}

/// What is wrong with a damaged tile.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TileDamage {
    /// The archive's directory is.
    #[error(transparent)]
    Directory {
        /// How.
        #[from]
        source: ArchiveError,
    },
    /// The elevation payload is.
    #[error(transparent)]
    Elevation {
        /// How.
        #[from]
        source: ElevationCodecError,
    },
    /// The colour payload is.
    #[error(transparent)]
    Color {
        /// How.
        #[from]
        source: ColorCodecError,
    },
    /// Damage that is reported to several readers.
    #[error("{damage}")]
    Shared {
        /// What.
        damage: Arc<TileDamage>,
    },
}

/// Verifies the checksum of a stored tile, without decoding it.
///
/// # Errors
/// [`TileDamage`].
pub fn check_tile(layer: Layer, bytes: &[u8]) -> Result<(), TileDamage> {
    match layer {
        Layer::Elevation => elevation::check_elevation_tile(bytes)?,
        Layer::Color => color::open_color_tile(bytes).map(drop)?,
    }
    Ok(())
}

/// Upper bound of the bytes of a stored tile of a layer.
#[must_use]
pub fn max_payload_bytes(world: &World, layer: Layer) -> usize {
    match layer {
        Layer::Elevation => elevation::max_payload_bytes(world),
        Layer::Color => color_tile_bytes(world),
    }
}

/// The place in an archive of the tile of a node; `None` if a world of this geometry has no such
/// tile.
#[must_use]
pub fn tile_place(world: &World, layer: Layer, node: NodeId) -> Option<pmtiles::TileId> {
    let has_place = match layer {
        Layer::Elevation => world.has_elevation(node),
        Layer::Color => world.has_color(node),
    };
    has_place.then(|| tile_coord(world, node)).flatten().map(Into::into)
}

/// Buffers that a thread reuses, so that reading a tile allocates (almost) nothing.
#[derive(Default)]
pub struct TileScratch {
    pub(crate) payload: Vec<u8>,
    pub(crate) planes: Vec<u8>,
    pub(crate) zstd: zstd::bulk::Decompressor<'static>,
}

impl std::fmt::Debug for TileScratch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("TileScratch").field("payload", &self.payload.len()).finish_non_exhaustive()
    }
}

/// A source of tiles: [`Database`], or a fake in tests. Calls block on storage; any thread may
/// call.
pub trait TileSource: Send + Sync {
    /// Heights of a node's posts, metres: `(Nz + 1)²` values, row 0 in the south; behind them the
    /// planes of validity of a world that has them ([`World::elevation_values`]).
    ///
    /// # Errors
    /// [`TileError`]; the content of `out` is then undefined.
    fn read_elevation(&self, node: NodeId, out: &mut [f32], scratch: &mut TileScratch) -> Result<(), TileError>;

    /// Colour of a node: RGBA8 of three mip levels back to back (`(Nc + 8)²`, a quarter, a
    /// sixteenth), row 0 in the north, borders included. `out` holds at least [`color_tile_bytes`].
    ///
    /// # Errors
    /// [`TileError`]; the content of `out` is then undefined.
    fn read_color(&self, node: NodeId, out: &mut [u8], scratch: &mut TileScratch) -> Result<(), TileError>;
}

/// A terrain database, open for reading.
#[derive(Debug)]
pub struct Database {
    index: Index,
    elevation: Archive,
    color: Archive,
}

impl Database {
    /// Opens the database in a folder and checks everything except the tiles.
    ///
    /// # Errors
    /// [`DatabaseError`]: not there, not finished, of another version, damaged.
    pub fn open(path: &Path) -> Result<Self, DatabaseError> {
        let manifest = index::open_manifest(path)?;
        let open = |name, record: &ArchiveRecord| {
            let path = path.join(name);
            Archive::open(&path, record).map_err(|source| DatabaseError::Archive { source, path })
        };
        let elevation = open(ELEVATION_FILE, &manifest.fields().elevation.archive)?;
        let color = open(COLOR_FILE, &manifest.fields().color.archive)?;
        let index = Index::of_manifest(path, manifest)?;
        Ok(Self { index, elevation, color })
    }

    /// Its manifest, geometry and height ranges.
    #[must_use]
    pub fn index(&self) -> &Index {
        &self.index
    }

    /// The folder that it is in.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.index.path()
    }

    /// What the manifest says.
    #[must_use]
    pub fn manifest(&self) -> &Manifest {
        self.index.manifest()
    }

    /// Its geometry.
    #[must_use]
    pub fn world(&self) -> &World {
        self.index.world()
    }

    /// Lowest and highest ground under each node.
    #[must_use]
    pub fn ranges(&self) -> &NodeRanges {
        self.index.ranges()
    }

    /// Reads a stored tile, without checks, into `out`, replacing its content.
    ///
    /// # Errors
    /// [`TileError`].
    pub fn read_payload(&self, layer: Layer, node: NodeId, out: &mut Vec<u8>) -> Result<(), TileError> {
        let archive = match layer {
            Layer::Elevation => &self.elevation,
            Layer::Color => &self.color,
        };
        let damaged = |reason: ArchiveError| match reason {
            ArchiveError::Read { source } => TileError::Read { layer, node, source },
            reason => TileError::Corrupt { layer, node, reason: reason.into() },
        };
        let place = tile_place(self.world(), layer, node).filter(|_| self.ranges().has_tile(layer, node));
        let tile = place.ok_or(TileError::Missing { layer, node })?;
        match archive.read(tile, max_payload_bytes(self.world(), layer), out).map_err(damaged)? {
            true => Ok(()),
            false => Err(TileError::Missing { layer, node }),
        }
    }
}

/// Decodes a stored elevation tile of a world; see [`TileSource::read_elevation`].
///
/// # Errors
/// [`TileError::Corrupt`].
pub fn decode_elevation(
    world: &World,
    node: NodeId,
    payload: &[u8],
    out: &mut [f32],
    scratch: &mut TileScratch,
) -> Result<(), TileError> {
    decode_elevation_planes(world, payload, out, scratch).map_err(|e| TileError::Corrupt {
        layer: Layer::Elevation,
        node,
        reason: e.into(),
    })
}

/// Decodes a stored colour tile of a world; see [`TileSource::read_color`].
///
/// # Errors
/// [`TileError::Corrupt`].
pub fn decode_color(world: &World, node: NodeId, payload: &[u8], out: &mut [u8]) -> Result<(), TileError> {
    decode_color_tile(payload, world.color_stored(), out).map_err(|e| TileError::Corrupt {
        layer: Layer::Color,
        node,
        reason: e.into(),
    })
}

impl TileSource for Database {
    fn read_elevation(&self, node: NodeId, out: &mut [f32], scratch: &mut TileScratch) -> Result<(), TileError> {
        let mut payload = std::mem::take(&mut scratch.payload);
        let read = self.read_payload(Layer::Elevation, node, &mut payload);
        let result = read.and_then(|()| decode_elevation(self.world(), node, &payload, out, scratch));
        scratch.payload = payload;
        result
    }

    fn read_color(&self, node: NodeId, out: &mut [u8], scratch: &mut TileScratch) -> Result<(), TileError> {
        self.read_payload(Layer::Color, node, &mut scratch.payload)?;
        decode_color(self.world(), node, &scratch.payload, out)
    }
}
