//! The job of a whole body.

use super::Job;
use super::output::Output;
use crate::body::{self, BodyJob, BodyPlan, Kind};
use crate::error::IngestError;
use crate::source::inputs::describe_all;
use crate::source::raster::Assumed;
use crate::source::values::{ColorValues, ElevationValues};
use crate::source::{Note, Raster};
use crate::work::Work;
use std::path::PathBuf;
use terravision_common::database::{COLOR_FILE, ELEVATION_FILE, Manifest, NODES_FILE};

impl Job {
    /// Describes rasters. `whole_body`: longitudes and latitudes of a body that those may cover that
    /// do not say where they are.
    pub(super) fn describe(
        &self,
        paths: &[PathBuf],
        whole_body: Option<&str>,
        note: &mut dyn FnMut(Note),
    ) -> Result<Vec<Raster>, IngestError> {
        let assumed = Assumed { source_crs: self.source_crs.as_deref(), whole_body };
        describe_all(paths, assumed, self.access, note)
    }

    /// The body that the elevation becomes; `None` for a plane.
    pub(super) fn chosen_body(
        &self,
        elevation: &[Raster],
        note: &mut dyn FnMut(Note),
    ) -> Result<Option<Kind>, IngestError> {
        let has_plane_options = self.crs.is_some() || self.region.is_some() || self.plan.spacing_m.is_some();
        body::choose(&self.body, elevation, has_plane_options, note)
    }

    /// Makes the database of a body.
    pub(super) fn run_body(
        &self,
        kind: Kind,
        elevation: Vec<Raster>,
        work: &Work,
        note: &mut dyn FnMut(Note),
    ) -> Result<Manifest, IngestError> {
        let color = self.describe(&self.color, Some(&kind.crs.wkt), note)?;
        if color.len() > 1 {
            return Err(IngestError::usage(format!(
                "{} colour files were given, expected one for a whole body: gdalbuildvrt joins them",
                color.len()
            )));
        }
        let plan = BodyPlan::new(kind, &elevation, &color, self.plan)?;
        self.check_node_memory(plan.nodes())?;
        let output = Output::begin(&self.output, self.may_overwrite)?;
        output.check_space(plan.disk_bytes())?;
        let values = |raster: Raster, note: &mut dyn FnMut(Note)| {
            let values = ElevationValues::of(&raster, self.nodata, self.elevation_unit_m, work, note)?;
            Ok((raster, values))
        };
        let elevation = elevation.into_iter().map(|r| values(r, note)).collect::<Result<Vec<_>, IngestError>>()?;
        let color_values = ColorValues::of_all(&color, self.bands, self.nodata, note)?;
        let color: Vec<_> = color.into_iter().zip(color_values).collect();
        let job = BodyJob {
            plan: &plan,
            elevation: &elevation,
            color: &color,
            name: self.name(),
            quality: self.color_quality,
            paths: [ELEVATION_FILE, COLOR_FILE, NODES_FILE].map(|name| output.part(name)),
            folder: output.folder(),
        };
        let manifest = job.build(work, note)?;
        output.finish(&manifest, work)?;
        Ok(manifest)
    }
}
