//! Finds the place of a tile in an archive: from the head and root directory, then from a leaf
//! directory, each read when first needed.

use super::{Remote, damaged};
use crate::cache::Key;
use crate::error::FetchError;
use crate::etags::Etags;
use bytes::Bytes;
use pmtiles::TileId;
use std::ops::Range;
use std::sync::{Arc, Mutex};
use terravision_common::database::{
    ARCHIVE_HEADER_BYTES, ArchiveError, ArchiveLayout, ArchiveRecord, Directory, Layer, Leaves, Place,
};
use tokio::sync::OnceCell;

/// The header and the root directory of a PMTiles archive are within its first bytes (specification
/// v3, section 3).
const HEAD_BYTES: u64 = 16_384;

/// An archive of the database, and the parts of it that have been read.
#[derive(Debug)]
pub(super) struct RemoteArchive {
    pub(super) layer: Layer,
    pub(super) file: &'static str,
    pub(super) record: ArchiveRecord,
    pub(super) head: OnceCell<Head>,
    leaves: Leaves,
    pub(super) etags: Mutex<Etags>,
}

/// The beginning of an archive: header and root directory.
#[derive(Debug)]
pub(super) struct Head {
    pub(super) first: Bytes,
    layout: ArchiveLayout,
    root: Directory,
}

impl RemoteArchive {
    pub(super) fn new(layer: Layer, file: &'static str, record: ArchiveRecord) -> Self {
        Self { layer, file, record, head: OnceCell::new(), leaves: Leaves::default(), etags: Mutex::default() }
    }
}

impl Remote {
    pub(super) async fn place_of(
        self: &Arc<Self>,
        archive: &RemoteArchive,
        tile: TileId,
    ) -> Result<Option<Range<u64>>, FetchError> {
        let broken = |error: ArchiveError| damaged(error.into());
        let head = self.head(archive).await?;
        match head.layout.place(&head.root, tile).map_err(broken)? {
            None => Ok(None),
            Some(Place::Tile(range)) => Ok(Some(range)),
            Some(Place::Leaf { index, range }) => {
                let leaf = self.leaf(archive, head, index, range).await?;
                head.layout.place_in_leaf(&leaf, tile).map_err(broken)
            }
        }
    }

    pub(super) async fn head<'a>(self: &Arc<Self>, archive: &'a RemoteArchive) -> Result<&'a Head, FetchError> {
        archive.head.get_or_try_init(|| self.read_head(archive)).await
    }

    async fn read_head(self: &Arc<Self>, archive: &RemoteArchive) -> Result<Head, FetchError> {
        let bytes = archive.record.bytes;
        let range = 0..HEAD_BYTES.min(bytes);
        if range.end < ARCHIVE_HEADER_BYTES as u64 {
            return Err(damaged(ArchiveError::NotPmtiles.into()));
        }
        let key = Key { file: archive.file, range: range.clone() };
        let parse = |first: &Bytes| {
            let layout = ArchiveLayout::parse(first, bytes)?;
            let root = layout.root();
            let inside = (root.end <= first.len() as u64).then(|| first.slice(root.start as usize..root.end as usize));
            let root = inside.map(|root| layout.directory(&root)).transpose()?;
            Ok((first.clone(), layout, root))
        };
        let (first, layout, root) = self.verified(archive, &[key], &range, true, parse).await?.content;
        let root = match root {
            Some(root) => root,
            None => self.directory(archive, &layout, layout.root()).await?,
        };
        Ok(Head { first, layout, root })
    }

    async fn leaf(
        self: &Arc<Self>,
        archive: &RemoteArchive,
        head: &Head,
        index: usize,
        range: Range<u64>,
    ) -> Result<Arc<Directory>, FetchError> {
        if let Some(leaf) = archive.leaves.get(index) {
            return Ok(leaf);
        }
        let key = Key { file: archive.file, range: range.clone() };
        let parse = |bytes: &Bytes| archive.leaves.get_or_parse(index, || Ok(head.layout.directory(bytes)?));
        Ok(self.verified(archive, &[key], &range, true, parse).await?.content)
    }

    async fn directory(
        self: &Arc<Self>,
        archive: &RemoteArchive,
        layout: &ArchiveLayout,
        range: Range<u64>,
    ) -> Result<Directory, FetchError> {
        let key = Key { file: archive.file, range: range.clone() };
        let read = self.verified(archive, &[key], &range, true, |bytes| Ok(layout.directory(bytes)?)).await?;
        Ok(read.content)
    }
}
