//! Lowest and highest ground under every node, for bounding boxes.

use super::Layer;
use super::body_ranges::{self, BODY_MAGIC, BodyLevel};
use super::manifest::NodesRecord;
use super::sparse_ranges::{self, NODE_BYTES, SparseLevel};
use crate::files::open_regular;
use crate::node::NodeId;
use crate::world::World;
use std::fs::File;
use std::io::{self, Read, Seek, Write};
use std::ops::RangeInclusive;
use std::path::Path;

pub use super::sparse_ranges::{Layers, NodeRange};

const MAGIC: &[u8; 8] = b"TVnodes1";
/// For worlds with sparse levels.
const SPARSE_MAGIC: &[u8; 8] = b"TVnodes2";
/// Upper bound of a file of ranges: 134 million nodes, for some terabytes of colour. All of it is
/// kept in memory.
pub const MOST_NODES_BYTES: u64 = 1 << 30;

/// Why ranges cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RangesError {
    /// It is not a file of ranges.
    #[error("it is not a file of height ranges")]
    NotRanges,
    /// It does not have the expected length.
    #[error("it has {found} bytes, expected {expected}")]
    Length {
        /// What manifest and world say.
        expected: u64,
        /// What it has.
        found: u64,
    },
    /// Its world has more nodes than fit into memory.
    #[error("the manifest's world needs {found} bytes of height ranges, and at most {most} are read")]
    TooLarge {
        /// The most that is read.
        most: u64,
        /// What the world needs.
        found: u64,
    },
    /// It has changed since it was written.
    #[error("its checksum is {found:08x}, expected {expected:08x}")]
    Checksum {
        /// What the manifest says.
        expected: u32,
        /// What its bytes give.
        found: u32,
    },
    /// It belongs to another world.
    #[error("level {level} has {found} nodes, expected {expected}")]
    Level {
        /// The level.
        level: u8,
        /// What the world has.
        expected: u64,
        /// What it has.
        found: u64,
    },
    /// It names a node that the world does not have.
    #[error("level {level} has a node in column {} and row {}, which the world does not have", place[0], place[1])]
    NoNode {
        /// The level.
        level: u8,
        /// Column and row.
        place: [u32; 2],
    },
    /// The nodes do not form a tree.
    #[error("node {node} does not fit the nodes around it")]
    Order {
        /// The node.
        node: NodeId,
    },
    /// The manifest gives another level from which on all nodes exist.
    #[error("all nodes exist from level {found} on, and the manifest says from level {expected}")]
    Complete {
        /// What the manifest says.
        expected: u8,
        /// What the nodes are.
        found: u8,
    },
    /// A range is not valid.
    #[error("the range of node {node} is {} to {}", range[0], range[1])]
    Range {
        /// The node.
        node: NodeId,
        /// Lowest and highest as found.
        range: [f32; 2],
    },
    /// It cannot be read.
    #[error("it cannot be read: {source}")]
    Read {
        /// Why.
        #[source]
        source: io::Error,
    },
}

impl From<io::Error> for RangesError {
    fn from(source: io::Error) -> Self {
        Self::Read { source }
    }
}

/// Lowest and highest ground, metres, under each node of a world: bounds of the posts of the node,
/// of all its descendants, and of all its ancestors within the node's area. So they bound the
/// ground at every level.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeRanges {
    world: World,
    levels: Levels,
}

#[derive(Debug, Clone, PartialEq)]
enum Levels {
    /// Ranges of all nodes, by row, then column.
    All(Vec<Vec<[f32; 2]>>),
    /// Ranges of the nodes that exist.
    Sparse(Vec<SparseLevel>),
    /// Ranges of the nodes of a body, by row, then column.
    Body(Vec<BodyLevel>),
}

impl NodeRanges {
    /// Ranges by level (0 first), each by row from the south, then column from the west; of a body,
    /// of the nodes that exist.
    ///
    /// # Errors
    /// [`RangesError`] when the lengths do not fit the world, or a range is empty or not finite.
    pub fn from_parts(world: &World, levels: Vec<Vec<[f32; 2]>>) -> Result<Self, RangesError> {
        if levels.len() != usize::from(world.levels()) {
            let [expected, found] = [u64::from(world.levels()), levels.len() as u64];
            return Err(RangesError::Length { expected, found });
        }
        if world.globe().is_some() {
            let levels = body_ranges::levels_of(world, levels)?;
            return Ok(Self { world: *world, levels: Levels::Body(levels) });
        }
        for (level, ranges) in (0..world.levels()).zip(&levels) {
            let [columns, rows] = world.nodes_at(level);
            let expected = u64::from(columns) * u64::from(rows);
            if ranges.len() as u64 != expected {
                return Err(RangesError::Level { level, expected, found: ranges.len() as u64 });
            }
            let is_bad = |r: &[f32; 2]| !(r[0].is_finite() && r[1].is_finite() && r[0] <= r[1]);
            if let Some(at) = ranges.iter().position(is_bad) {
                let at32 = at as u32;
                let node = NodeId::new(at32 % columns, at32 / columns, level).unwrap_or(world.root());
                return Err(RangesError::Range { node, range: ranges[at] });
            }
        }
        Ok(Self { world: *world, levels: Levels::All(levels) })
    }

    /// Ranges of a world whose finest levels are sparse, in any order.
    ///
    /// # Errors
    /// [`RangesError`] when a range is empty or not finite, or the nodes do not form a tree that
    /// can be searched: each node needs its parent and all of its siblings, and, if it has
    /// elevation below it, neighbours on all sides.
    pub fn from_nodes(world: &World, nodes: Vec<NodeRange>) -> Result<Self, RangesError> {
        let levels = sparse_ranges::levels_of(world, nodes)?;
        let world = world.with_complete_level(sparse_ranges::complete_level(world, &levels));
        Ok(Self { world, levels: Levels::Sparse(levels) })
    }

    /// Their world, which has the level from which on all nodes exist.
    #[must_use]
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Whether a node has a tile of a layer.
    #[must_use]
    pub fn has_tile(&self, layer: Layer, node: NodeId) -> bool {
        match &self.levels {
            Levels::Sparse(levels) => {
                let level = levels.get(usize::from(node.q()));
                level.and_then(|level| level.find(node)).is_some_and(|(_, layers)| layers.has(layer))
            }
            Levels::All(_) | Levels::Body(_) => match layer {
                Layer::Elevation => self.world.has_elevation(node),
                Layer::Color => self.world.has_color(node),
            },
        }
    }

    /// Whether the children of a node have tiles of a layer that its world has at their level:
    /// either all existing children do, or none.
    #[must_use]
    pub fn has_children(&self, layer: Layer, node: NodeId) -> bool {
        match &self.levels {
            // The south western child exists whenever the node does.
            Levels::Sparse(_) => node.child(0).is_some_and(|child| self.has_tile(layer, child)),
            Levels::All(_) => true,
            Levels::Body(_) => self.world.children(node).next().is_some(),
        }
    }

    /// The nodes of a level that exist, by row from the south, then column from the west.
    pub fn nodes(&self, q: u8) -> Box<dyn Iterator<Item = NodeId> + '_> {
        match &self.levels {
            Levels::All(_) => {
                let [columns, rows] = self.world.nodes_at(q);
                Box::new((0..rows).flat_map(move |n| (0..columns).filter_map(move |m| NodeId::new(m, n, q))))
            }
            Levels::Body(_) => {
                let world = self.world;
                let rows = 0..world.nodes_at(q)[1];
                Box::new(
                    rows.flat_map(move |n| (0..world.columns_of_row(q, n)).filter_map(move |m| NodeId::new(m, n, q))),
                )
            }
            Levels::Sparse(levels) => {
                Box::new(levels.get(usize::from(q)).into_iter().flat_map(move |level| level.nodes(q)).map(|at| at.node))
            }
        }
    }

    /// Lowest and highest ground under a node, metres; `None` when the node does not exist.
    #[must_use]
    pub fn range(&self, node: NodeId) -> Option<[f32; 2]> {
        if !self.world.contains(node) {
            return None;
        }
        match &self.levels {
            Levels::All(levels) => {
                let columns = self.world.nodes_at(node.q())[0] as usize;
                levels[usize::from(node.q())].get(node.n() as usize * columns + node.m() as usize).copied()
            }
            Levels::Sparse(levels) => levels[usize::from(node.q())].find(node).map(|(range, _)| range),
            Levels::Body(levels) => levels[usize::from(node.q())].range(node),
        }
    }

    /// The possible sizes of the file of a world's ranges: exactly what its nodes need, or, with
    /// sparse levels, at most what all nodes would need.
    #[must_use]
    pub fn file_bytes(world: &World, is_sparse: bool) -> RangeInclusive<u64> {
        let nodes: u64 = (0..world.levels()).map(|q| world.node_count(q)).sum();
        let magic = MAGIC.len() as u64;
        if is_sparse {
            let counts = magic + 8 * u64::from(world.levels());
            return counts..=counts.saturating_add(NODE_BYTES.saturating_mul(nodes));
        }
        magic + 8 * nodes..=magic + 8 * nodes
    }

    /// The size of the file of a world's ranges, checked against the manifest and against the
    /// bound, before anything is read or allocated.
    ///
    /// # Errors
    /// [`RangesError::TooLarge`], [`RangesError::Length`].
    pub fn checked_bytes(world: &World, record: &NodesRecord, is_sparse: bool) -> Result<u64, RangesError> {
        let needed = Self::file_bytes(world, is_sparse);
        let bytes = record.bytes.clamp(*needed.start(), *needed.end());
        if bytes > MOST_NODES_BYTES {
            return Err(RangesError::TooLarge { most: MOST_NODES_BYTES, found: bytes });
        }
        if bytes != record.bytes {
            return Err(RangesError::Length { expected: bytes, found: record.bytes });
        }
        Ok(bytes)
    }

    /// Writes them to a file. Returns the record for the manifest.
    ///
    /// # Errors
    /// The error of the file system.
    pub fn write(&self, path: &Path) -> io::Result<NodesRecord> {
        let mut file = io::BufWriter::new(File::create(path)?);
        let mut hasher = crc32fast::Hasher::new();
        let mut put = |bytes: &[u8]| {
            hasher.update(bytes);
            file.write_all(bytes)
        };
        match &self.levels {
            Levels::All(levels) => {
                put(MAGIC)?;
                put_ranges(levels.iter().map(Vec::as_slice), &mut put)?;
            }
            Levels::Body(levels) => {
                put(BODY_MAGIC)?;
                put_ranges(levels.iter().map(BodyLevel::all), &mut put)?;
            }
            Levels::Sparse(levels) => {
                put(SPARSE_MAGIC)?;
                sparse_ranges::encode(levels, put)?;
            }
        }
        file.into_inner().map_err(io::IntoInnerError::into_error)?.sync_all()?;
        let bytes = match &self.levels {
            Levels::All(_) | Levels::Body(_) => *Self::file_bytes(&self.world, false).end(),
            Levels::Sparse(levels) => SPARSE_MAGIC.len() as u64 + sparse_ranges::encoded_bytes(levels),
        };
        Ok(NodesRecord { bytes, crc32: hasher.finalize() })
    }

    /// Reads the file and checks it against the world and the manifest, which says whether the
    /// finest levels are sparse.
    ///
    /// # Errors
    /// [`RangesError`].
    pub fn read(path: &Path, world: &World, record: &NodesRecord, is_sparse: bool) -> Result<Self, RangesError> {
        let mut file = open_regular(path)?;
        let found = file.metadata()?.len();
        let expected = Self::checked_bytes(world, record, is_sparse)?;
        // Check the length of the file before anything is allocated.
        if found != expected {
            return Err(RangesError::Length { expected, found });
        }
        let mut hasher = crc32fast::Hasher::new();
        let mut magic = [0; MAGIC.len()];
        file.read_exact(&mut magic)?;
        let expected_magic = match world.globe() {
            Some(_) => BODY_MAGIC,
            None if is_sparse => SPARSE_MAGIC,
            None => MAGIC,
        };
        if &magic != expected_magic {
            return Err(RangesError::NotRanges);
        }
        hasher.update(&magic);
        if is_sparse {
            return Self::read_sparse(file, world, record, hasher);
        }
        let mut levels = Vec::with_capacity(usize::from(world.levels()));
        for q in 0..world.levels() {
            let count = world.node_count(q) as usize;
            let mut ranges = vec![[0f32; 2]; count];
            for part in ranges.chunks_mut(1 << 16) {
                let bytes: &mut [u8] = bytemuck::cast_slice_mut(part);
                file.read_exact(bytes)?;
                hasher.update(bytes);
            }
            if cfg!(target_endian = "big") {
                ranges.iter_mut().flatten().for_each(|v| *v = f32::from_bits(v.to_bits().swap_bytes()));
            }
            levels.push(ranges);
        }
        let found = hasher.finalize();
        if found != record.crc32 {
            return Err(RangesError::Checksum { expected: record.crc32, found });
        }
        Self::from_parts(world, levels)
    }

    fn read_sparse(
        file: File,
        world: &World,
        record: &NodesRecord,
        mut hasher: crc32fast::Hasher,
    ) -> Result<Self, RangesError> {
        // The checksum first: after that, errors in the nodes are errors of the writer.
        let mut file = io::BufReader::with_capacity(1 << 16, file);
        let mut part = [0; 1 << 14];
        loop {
            match file.read(&mut part)? {
                0 => break,
                count => hasher.update(&part[..count]),
            }
        }
        let found = hasher.finalize();
        if found != record.crc32 {
            return Err(RangesError::Checksum { expected: record.crc32, found });
        }
        let magic = SPARSE_MAGIC.len() as u64;
        file.seek(io::SeekFrom::Start(magic))?;
        let levels = sparse_ranges::decode(world, &mut file, record.bytes.saturating_sub(magic))?;
        let (expected, found) = (world.complete_level(), sparse_ranges::complete_level(world, &levels));
        if expected != found {
            return Err(RangesError::Complete { expected, found });
        }
        Ok(Self { world: *world, levels: Levels::Sparse(levels) })
    }
}

/// Ranges as bytes.
fn put_ranges<'a>(
    levels: impl Iterator<Item = &'a [[f32; 2]]>,
    put: &mut impl FnMut(&[u8]) -> io::Result<()>,
) -> io::Result<()> {
    let mut buffer = Vec::new();
    for part in levels.flat_map(|level| level.chunks(4096)) {
        buffer.clear();
        buffer.extend(part.iter().flatten().flat_map(|v| v.to_le_bytes()));
        put(&buffer)?;
    }
    Ok(())
}
