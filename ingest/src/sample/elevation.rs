//! The finest elevation level, from its sources.

use super::kernel::Kernel;
use super::{BLOCK, Sampled, SourceSet};
use crate::IngestError;
use crate::plan::Plan;
use crate::source::readers::ElevationReader;
use crate::source::values::ElevationValues;
use crate::source::{Raster, TargetCrs};
use crate::store::Level;
use crate::work::Work;
use std::path::Path;
use std::sync::Mutex;
use terravision_common::database::HEIGHT_STEPS_PER_M;

/// Summary of a level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Summary {
    /// Posts without data.
    pub voids: u64,
    /// Lowest and highest height, metres.
    pub range: [f32; 2],
    /// Lowest and highest sample of the sources where they were used, metres.
    pub source_range: [f32; 2],
}

pub(crate) const EMPTY: [f32; 2] = [f32::MAX, f32::MIN];

pub(crate) fn union(a: [f32; 2], b: [f32; 2]) -> [f32; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

/// Rounds a height to the steps that tiles store.
#[must_use]
pub fn quantized(height: f32) -> f32 {
    (height * HEIGHT_STEPS_PER_M).round() / HEIGHT_STEPS_PER_M
}

/// A post that lies in no file: also NaN, but with different bits, which levels preserve.
pub(crate) const OUTSIDE: f32 = f32::from_bits(f32::NAN.to_bits() | 1);

/// Whether a post of the finest level that [`sample`] made lies in no file.
pub(crate) fn is_outside(height: f32) -> bool {
    height.to_bits() == OUTSIDE.to_bits()
}

fn height_of(sampled: Sampled<1>) -> f32 {
    match sampled {
        Sampled::Value(_, [height]) => quantized(height),
        Sampled::Void => f32::NAN,
        Sampled::Outside => OUTSIDE,
    }
}

/// Samples the finest level; voids are NaN. The first source that has data at a post gives its
/// height.
///
/// # Errors
/// [`IngestError`].
pub fn sample(
    plan: &Plan,
    target: &TargetCrs,
    sources: &[(Raster, ElevationValues)],
    folder: &Path,
    work: &Work,
) -> Result<(Level<f32>, Summary), IngestError> {
    let size = plan.elevation_size(plan.world.finest_elevation_level());
    let fail = |source| IngestError::Output { source, path: folder.to_owned() };
    let level = Level::create(folder, size).map_err(fail)?;
    let blocks = level.blocks(BLOCK);
    let summary = Mutex::new(Summary { voids: 0, range: EMPTY, source_range: EMPTY });
    work.each(
        "elevation",
        blocks.count(),
        || {
            Ok(SourceSet::new(
                sources,
                &plan.elevation_bounds,
                target,
                plan.elevation,
                ElevationReader::open,
                Kernel::of_heights,
            ))
        },
        |set, index| {
            let block = blocks.rect(index);
            let heights = set.sample::<1>(block)?;
            let heights: Vec<f32> = heights.into_iter().map(height_of).collect();
            let part = summarize(&heights);
            if let Ok(mut all) = summary.lock() {
                all.voids += part.voids;
                all.range = union(all.range, part.range);
                // Includes earlier blocks of the thread, which does not matter for a union.
                all.source_range = union(all.source_range, set.range());
            }
            level.write(block, &heights).map_err(fail)
        },
    )?;
    let summary = summary.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    Ok((level, summary))
}

fn summarize(heights: &[f32]) -> Summary {
    let mut summary = Summary { voids: 0, range: EMPTY, source_range: EMPTY };
    for &height in heights {
        if height.is_nan() {
            summary.voids += 1;
        } else {
            summary.range = union(summary.range, [height; 2]);
        }
    }
    summary
}
