//! The elevation pyramid: sampled, clipped, filtered, filled.

use crate::error::IngestError;
use crate::plan::Plan;
use crate::pyramid::{self, validity, voids as fill};
use crate::sample::{self, corners};
use crate::source::values::ElevationValues;
use crate::source::{Note, Raster, TargetCrs};
use crate::store::Level;
use crate::work::Work;
use std::collections::BTreeSet;
use std::path::Path;
use terravision_common::database::{HEIGHT_STEPS_PER_M, Voids};

/// The elevation pyramid.
pub(super) struct Elevation {
    /// All levels, without voids.
    pub(super) levels: Vec<Level<f32>>,
    /// Summary of the finest level.
    pub(super) summary: sample::elevation::Summary,
    /// The shares of all levels' posts; empty when the finest level has no voids.
    pub(super) validity: Vec<Level<validity::Shares>>,
    /// Posts of the finest level that have no ground.
    pub(super) holes: u64,
}

/// A loss at a summit is reported from this on, metres.
const TOLD_LOSS_M: f32 = 3.0;

/// Lowest and highest sample of the sources, if those of the world differ. Reports a summit that
/// was cut off.
pub(super) fn told_source_range(
    summary: &sample::elevation::Summary,
    plan: &Plan,
    note: &mut dyn FnMut(Note),
) -> Option<[f32; 2]> {
    let (source, world) = (summary.source_range, summary.range);
    let is_other = (0..2).any(|k| (source[k] - world[k]).abs() > 1.0 / HEIGHT_STEPS_PER_M);
    if source[1] - world[1] > TOLD_LOSS_M {
        let spacing = plan.elevation.step;
        note(Note::Info(format!(
            "the highest point of the elevation files is {:.0} m, that of the world {:.0} m: posts lie {spacing} m apart; \
             a smaller --spacing keeps more of the summits",
            source[1], world[1]
        )));
    }
    is_other.then_some(source)
}

pub(super) fn levels(
    plan: &Plan,
    target: &TargetCrs,
    sources: &[(Raster, ElevationValues)],
    voids: Voids,
    folder: &Path,
    work: &Work,
) -> Result<Elevation, IngestError> {
    let (finest, summary) = sample::elevation::sample(plan, target, sources, folder, work)?;
    if summary.voids == finest.size().iter().product::<u64>() {
        let file = sources[0].0.path();
        return Err(IngestError::source(file, "has no elevation data: every sample is \"no data\""));
    }
    let coarser_levels = plan.world.finest_elevation_level() + 1..plan.world.levels();
    let (mut validity, mut holes) = (Vec::new(), 0);
    if summary.voids > 0 {
        let corners = match voids {
            Voids::Clip => corners::outer_corners(plan, target, sources, &finest, folder)?,
            Voids::Fill | Voids::Keep => BTreeSet::new(),
        };
        let (shares, count) = validity::finest(&finest, voids, &corners, folder, work)?;
        holes = count;
        validity.push(shares);
        for q in coarser_levels.clone() {
            validity.push(validity::coarser(&validity[validity.len() - 1], plan.elevation_size(q), folder, work)?);
        }
    }
    let mut levels = vec![finest];
    for q in coarser_levels {
        let coarser = pyramid::elevation::coarser(&levels[levels.len() - 1], plan.elevation_size(q), folder, work)?;
        levels.push(coarser);
    }
    if summary.voids > 0 {
        levels = filled(levels, 0.5 * (summary.range[0] + summary.range[1]), folder, work)?;
    }
    Ok(Elevation { levels, summary, validity, holes })
}

/// Fills the voids of all levels, the coarsest first; `middle` is used for a level without any
/// data.
fn filled(levels: Vec<Level<f32>>, middle: f32, folder: &Path, work: &Work) -> Result<Vec<Level<f32>>, IngestError> {
    let mut filled: Vec<Level<f32>> = Vec::with_capacity(levels.len());
    for level in levels.into_iter().rev() {
        let level = match filled.last() {
            Some(coarser) => {
                let all: Vec<usize> = (0..level.blocks(pyramid::BLOCK).count()).collect();
                fill::fill(level, coarser, &all, folder, work)?
            }
            None => {
                fill::fill_coarsest(&level, middle)
                    .map_err(|source| IngestError::Output { source, path: folder.to_owned() })?;
                level
            }
        };
        filled.push(level);
    }
    filled.reverse();
    Ok(filled)
}
