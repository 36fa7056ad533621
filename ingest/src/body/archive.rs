//! Archives of a body's tiles: level after level, row after row.

use crate::IngestError;
use crate::archive::{ArchiveInfo, Tile};
use pmtiles::{CallerKey, Compression, PmTilesStreamWriter, PmTilesWriter, TileType};
use std::fs::File;
use std::io;
use std::path::Path;
use terravision_common::database::{ArchiveRecord, index_crc32, least_zoom};
use terravision_common::world::World;

/// Where an archive goes, and what it says of itself.
#[derive(Debug)]
pub(super) struct ArchivePlan<'a> {
    pub(super) path: &'a Path,
    pub(super) world: &'a World,
    pub(super) info: &'a ArchiveInfo,
}

/// An archive that is being written.
pub(super) struct Archive<'a> {
    plan: &'a ArchivePlan<'a>,
    file: File,
    writer: PmTilesStreamWriter<File, CallerKey<u64>>,
    tiles: u64,
}

impl<'a> Archive<'a> {
    /// For levels down to `finest`.
    pub(super) fn create(plan: &'a ArchivePlan<'a>, kind: TileType, finest: u8) -> Result<Self, IngestError> {
        let fail = |source| IngestError::Output { source, path: plan.path.to_owned() };
        let file = File::create(plan.path).map_err(fail)?;
        let (least, top) = (least_zoom(plan.world), plan.world.levels() - 1);
        let [west, south, east, north] = plan.info.bounds_deg;
        let writer = PmTilesWriter::new(kind)
            .tile_compression(Compression::None)
            .internal_compression(Compression::Gzip)
            .min_zoom(least)
            .max_zoom(least + top - finest)
            .bounds(west, south, east, north)
            .center(0.5 * (west + east), 0.5 * (south + north))
            .center_zoom(least + (top - finest) / 2)
            .metadata(plan.info.metadata.clone())
            .dedup_by_key::<u64>()
            .create(file.try_clone().map_err(fail)?)
            .map_err(|e| fail(io::Error::other(e)))?;
        Ok(Self { plan, file, writer, tiles: 0 })
    }

    fn fails(&self, error: impl std::error::Error + Send + Sync + 'static) -> IngestError {
        IngestError::Output { source: io::Error::other(error), path: self.plan.path.to_owned() }
    }

    /// Adds a tile.
    pub(super) fn add(&mut self, (coord, bytes, key): Tile) -> Result<(), IngestError> {
        self.tiles += 1;
        match self.writer.add_tile(coord, &bytes, key) {
            Ok(()) => Ok(()),
            Err(error) => Err(self.fails(error)),
        }
    }

    /// Completes it.
    pub(super) fn finish(self) -> Result<ArchiveRecord, IngestError> {
        let Self { plan, file, writer, tiles } = self;
        let fail = |source| IngestError::Output { source, path: plan.path.to_owned() };
        writer.finalize().map_err(|e| fail(io::Error::other(e)))?;
        file.sync_all().map_err(fail)?;
        let index_crc32 = index_crc32(plan.path).map_err(|e| fail(io::Error::other(e)))?;
        Ok(ArchiveRecord { bytes: file.metadata().map_err(fail)?.len(), index_crc32, tiles })
    }
}
