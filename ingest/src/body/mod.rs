//! Databases of whole bodies, over longitude and latitude.
//!
//! ```text
//! sources ─heights─▶ lattice ─base─▶ low-passed levels ─posts─▶ posts of all levels ─tiles─▶ elevation.pmtiles, nodes.tvn
//! sources ─picture─▶ image and its halves ─────────────────────────────────────────color─▶ color.pmtiles
//!    └ none: a tint of the lattice
//! ```
//!
//! The finest level has the samples of the sources, where the sources have them ([`place`],
//! [`heights`]). All work is done by whole parallels ([`ring`]), so that there is no seam; beyond a
//! pole lies what is half a turn away.

mod archive;
mod base;
mod choice;
mod color;
mod grid;
mod heights;
mod image;
mod picture;
mod place;
mod posts;
mod record;
mod ring;
#[cfg(test)]
mod tests;
mod tiles;

pub(crate) use choice::choose;
pub use choice::{BodyChoice, Kind};

use crate::IngestError;
use crate::plan::PlanOptions;
use crate::source::values::{ColorValues, ElevationValues};
use crate::source::{Note, Raster};
use crate::work::Work;
use archive::ArchivePlan;
use base::Base;
use grid::Grid;
use place::{Degrees, LatticePlace};
use posts::Posts;
use std::path::{Path, PathBuf};
use terravision_common::database::Manifest;
use terravision_common::surface::globe::GlobeLattice;
use terravision_common::world::{BodyGrid, World, WorldFields};

/// A body's world before its data are read.
#[derive(Debug)]
pub(crate) struct BodyPlan {
    kind: Kind,
    place: LatticePlace,
    grid: Grid,
}

/// How many levels the finest colour is above the finest level that cuts rows: texels as fine as the
/// picture's pixels around the equator, or up to 7 % coarser, as of planes.
fn color_above(grid_columns: u32, tiles: [u32; 2], color_columns: Option<f64>, most: u8) -> u8 {
    let texel = f64::from(tiles[0]) / f64::from(tiles[1]);
    let pixel = color_columns.map_or(1.0, |columns| f64::from(grid_columns) / columns);
    ((pixel / texel).log2() + 0.1).floor().clamp(0.0, f64::from(most)) as u8
}

impl BodyPlan {
    /// Plans the world of these sources.
    pub(crate) fn new(
        kind: Kind,
        elevation: &[Raster],
        color: &[Raster],
        options: PlanOptions,
    ) -> Result<Self, IngestError> {
        let first = elevation.first().ok_or_else(|| IngestError::usage("no elevation was given"))?;
        let at = Degrees::of(first)?.ok_or_else(|| {
            IngestError::source(
                first.path(),
                "is not over longitude and latitude, as a body's elevation is: gdalwarp -t_srs EPSG:4326 makes it so",
            )
        })?;
        if options.spacing_m.is_some() {
            return Err(IngestError::usage("--spacing has no meaning for a body, whose samples stay where they are"));
        }
        let place = LatticePlace::of(&at, first.path())?;
        let columns = match color.first() {
            Some(raster) => Degrees::of(raster)?.map(|at| 360.0 / at.step[0].abs()),
            None => None,
        };
        let grid = Self::grid(&kind, &place, columns, options)?;
        Ok(Self { kind, place, grid })
    }

    fn grid(kind: &Kind, place: &LatticePlace, color: Option<f64>, options: PlanOptions) -> Result<Grid, IngestError> {
        let (columns, rows) = (place.columns, place.rows);
        let lattice = GlobeLattice::new(columns, rows, options.elevation_tile).ok_or_else(|| {
            IngestError::usage(format!(
                "a body of {columns} columns around and {rows} rows from pole to pole is too small or too large: expected at least \
                 a few tiles of {} around its poles",
                options.elevation_tile
            ))
        })?;
        let q0 = lattice.rows_level();
        let above = color_above(columns, [options.elevation_tile, options.color_tile], color, q0);
        let row_rad = place.row_step_deg.to_radians();
        let fields = WorldFields {
            origin: [place.west_deg, -90.0],
            lattice_unit_m: kind.semi_major_m * row_rad / f64::from(1u32 << q0),
            extent: [columns, rows],
            elevation_tile: options.elevation_tile,
            color_tile: options.color_tile,
            levels: lattice.top() + 1,
            finest_elevation_level: 0,
            finest_color_level: q0 + above,
            body: Some(BodyGrid {
                semi_major_m: kind.semi_major_m,
                flattening: kind.flattening,
                west_deg: place.west_deg,
                first_row_deg: place.first_row_deg,
                row_step_deg: place.row_step_deg,
            }),
        };
        let world = World::new(fields)
            .map_err(|e| IngestError::usage(format!("the data make no body that can be stored: {e}")))?;
        Grid::of(world).ok_or_else(|| IngestError::usage("the data make no body"))
    }

    /// Number of nodes, for the bound of memory.
    pub(crate) fn nodes(&self) -> u64 {
        (0..self.grid.world.levels()).map(|q| self.grid.world.node_count(q)).sum()
    }

    /// Bytes that the levels need on disk while the database is made, and the database itself at
    /// most.
    pub(crate) fn disk_bytes(&self) -> u64 {
        let samples = u64::from(self.grid.columns()) * (u64::from(self.grid.rows()) + 1);
        let world = &self.grid.world;
        let texels_per_column = f64::from(world.color_tile())
            / (f64::from(world.elevation_tile()) * f64::from(1u32 << self.grid.log_rows(world.finest_color_level())));
        let texels = (samples as f64 * texels_per_column * texels_per_column) as u64;
        samples.saturating_mul(4 + 3 + 2).saturating_add(texels.saturating_mul(4)).saturating_mul(4) / 3
    }
}

/// What a body is made of, and where it goes.
pub(crate) struct BodyJob<'a> {
    pub(crate) plan: &'a BodyPlan,
    pub(crate) elevation: &'a [(Raster, ElevationValues)],
    pub(crate) color: &'a [(Raster, ColorValues)],
    pub(crate) name: String,
    pub(crate) quality: u8,
    /// Elevation, colour, ranges.
    pub(crate) paths: [PathBuf; 3],
    pub(crate) folder: &'a Path,
}

impl BodyJob<'_> {
    /// Writes the files of the database. Returns its manifest.
    pub(crate) fn build(&self, work: &Work, note: &mut dyn FnMut(Note)) -> Result<Manifest, IngestError> {
        let BodyPlan { kind, place, grid } = self.plan;
        let folder = self.folder;
        let heights = heights::read(grid, place, self.elevation, folder, work, note)?;
        let range = heights.range;
        let base = Base::of(*grid, heights.level, folder, work)?;
        let infos = record::archive_infos(&self.name, grid, &kind.crs);
        let (image, tint) = match self.color.first() {
            Some(source) => (picture::of_source(source, folder, work, note)?, None),
            None => {
                let (image, tint) = picture::tint(&base, &kind.body.name, folder, work)?;
                (image, Some(tint))
            }
        };
        let plan = ArchivePlan { path: &self.paths[1], world: &grid.world, info: &infos[1] };
        let color = color::write(grid, &image, self.quality, &plan, work)?;
        drop(image);
        let posts = Posts::of(&base, folder, work)?;
        let plan = ArchivePlan { path: &self.paths[0], world: &grid.world, info: &infos[0] };
        let (elevation, ranges) = tiles::write(&posts, &plan, work)?;
        let fail = |source| IngestError::Output { source, path: self.paths[2].clone() };
        let nodes = ranges.write(&self.paths[2]).map_err(fail)?;
        let parts = record::Parts {
            name: self.name.clone(),
            grid,
            kind,
            elevation: self.elevation.iter().map(|(raster, _)| raster).collect(),
            color: self.color.iter().map(|(raster, _)| raster).collect(),
            range,
            quality: self.quality,
            archives: [elevation, color],
            nodes,
            tint,
        };
        record::manifest(parts).map_err(|e| IngestError::usage(format!("the body cannot be described: {e}")))
    }
}
