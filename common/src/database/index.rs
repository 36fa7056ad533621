//! The part of a database that is small and that every process needs: what it is, and where its
//! ground lies.

use super::manifest::{self, Manifest, ManifestError};
use super::{DatabaseError, MANIFEST_FILE, NODES_FILE, NodeRanges};
use crate::world::World;
use std::io;
use std::path::{Path, PathBuf};

/// Manifest, geometry and height ranges of a database: of a folder that need not have the tiles.
#[derive(Debug)]
pub struct Index {
    path: PathBuf,
    manifest: Manifest,
    world: World,
    ranges: NodeRanges,
}

impl Index {
    /// Reads the index in a folder and checks it.
    ///
    /// # Errors
    /// [`DatabaseError`]: not there, not finished, of another version, damaged.
    pub fn open(path: &Path) -> Result<Self, DatabaseError> {
        let (manifest, world) = open_manifest(path)?;
        Self::of_manifest(path, manifest, world)
    }

    /// Reads what belongs to a manifest that has been read.
    pub(super) fn of_manifest(path: &Path, manifest: Manifest, world: World) -> Result<Self, DatabaseError> {
        let nodes_path = path.join(NODES_FILE);
        let ranges = NodeRanges::read(&nodes_path, &world, &manifest.nodes, manifest.is_sparse())
            .map_err(|source| DatabaseError::Ranges { source, path: nodes_path })?;
        Ok(Self { path: path.to_owned(), manifest, world, ranges })
    }

    /// The folder that it is in.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What the manifest says.
    #[must_use]
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// The database's geometry.
    #[must_use]
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Lowest and highest ground under each node.
    #[must_use]
    pub fn ranges(&self) -> &NodeRanges {
        &self.ranges
    }
}

/// The geometry of the database in a folder, for a process that reads no tiles.
///
/// # Errors
/// [`DatabaseError`]: not there, not finished, of another version, damaged.
pub fn read_world(path: &Path) -> Result<World, DatabaseError> {
    open_manifest(path).map(|(_, world)| world)
}

/// Reads the manifest in a folder, and the geometry in it.
pub(super) fn open_manifest(path: &Path) -> Result<(Manifest, World), DatabaseError> {
    let manifest_path = path.join(MANIFEST_FILE);
    let text = match manifest::read_text(&manifest_path) {
        Ok(text) => text,
        Err(e) if e.kind() == io::ErrorKind::NotFound || e.kind() == io::ErrorKind::NotADirectory => {
            return Err(DatabaseError::NotADatabase { path: path.to_owned() });
        }
        Err(source) => return Err(DatabaseError::Read { source, path: manifest_path }),
    };
    let manifest =
        Manifest::parse(&text).map_err(|source| DatabaseError::Manifest { source, path: manifest_path.clone() })?;
    let world = manifest
        .geometry()
        .map_err(|source| DatabaseError::Manifest { source: ManifestError::World { source }, path: manifest_path })?;
    Ok((manifest, world))
}
