//! The small part of a database that every process needs: manifest, geometry and height ranges.

use super::manifest::{self, Manifest};
use super::{DatabaseError, MANIFEST_FILE, NODES_FILE, NodeRanges};
use crate::world::World;
use std::io;
use std::path::{Path, PathBuf};

/// Manifest, geometry and height ranges of a database. Its folder need not contain the tiles.
#[derive(Debug)]
pub struct Index {
    path: PathBuf,
    manifest: Manifest,
    ranges: NodeRanges,
}

impl Index {
    /// Reads the index in a folder and checks it.
    ///
    /// # Errors
    /// [`DatabaseError`]: missing, unfinished, of another version, damaged.
    pub fn open(path: &Path) -> Result<Self, DatabaseError> {
        Self::of_manifest(path, open_manifest(path)?)
    }

    /// Reads the rest of the index for a manifest.
    pub(super) fn of_manifest(path: &Path, manifest: Manifest) -> Result<Self, DatabaseError> {
        let nodes_path = path.join(NODES_FILE);
        let ranges = NodeRanges::read(&nodes_path, manifest.world(), &manifest.fields().nodes, manifest.is_sparse())
            .map_err(|source| DatabaseError::Ranges { source, path: nodes_path })?;
        Ok(Self { path: path.to_owned(), manifest, ranges })
    }

    /// The folder that it is in.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The manifest.
    #[must_use]
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// The database's geometry.
    #[must_use]
    pub fn world(&self) -> &World {
        self.manifest.world()
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
/// [`DatabaseError`]: missing, unfinished, of another version, damaged.
pub fn read_world(path: &Path) -> Result<World, DatabaseError> {
    open_manifest(path).map(|manifest| *manifest.world())
}

/// Reads the manifest in a folder.
pub(super) fn open_manifest(path: &Path) -> Result<Manifest, DatabaseError> {
    let manifest_path = path.join(MANIFEST_FILE);
    let text = match manifest::read_text(&manifest_path) {
        Ok(text) => text,
        Err(e) if e.kind() == io::ErrorKind::NotFound || e.kind() == io::ErrorKind::NotADirectory => {
            return Err(DatabaseError::NotADatabase { path: path.to_owned() });
        }
        Err(source) => return Err(DatabaseError::Read { source, path: manifest_path }),
    };
    Manifest::parse(&text).map_err(|source| DatabaseError::Manifest { source, path: manifest_path })
}
