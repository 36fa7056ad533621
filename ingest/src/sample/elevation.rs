//! The finest elevation level, from its sources.

use super::mapper::{Lattice, Mapper};
use super::{BLOCK, Sampler};
use crate::IngestError;
use crate::plan::Plan;
use crate::source::open::ElevationReader;
use crate::source::values::ElevationValues;
use crate::source::{Raster, TargetCrs};
use crate::store::Level;
use crate::work::Work;
use std::path::Path;
use std::sync::Mutex;
use terravision_common::database::HEIGHT_STEPS_PER_M;

/// What a level holds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Summary {
    /// Posts without data.
    pub voids: u64,
    /// Lowest and highest height, metres.
    pub range: [f32; 2],
}

/// Rounds a height to what tiles can hold.
#[must_use]
pub fn quantised(height: f32) -> f32 {
    (height * HEIGHT_STEPS_PER_M).round() / HEIGHT_STEPS_PER_M
}

/// Samplers of all sources for one thread, in order of precedence.
fn samplers<'a>(
    target: &TargetCrs,
    lattice: &Lattice,
    sources: &'a [(Raster, ElevationValues)],
) -> Result<Vec<Sampler<ElevationReader<'a>>>, IngestError> {
    let open = |(raster, values): &'a (Raster, ElevationValues)| {
        let mapper = Mapper::new(target, raster)?;
        let middle = super::middle_of(raster, target)?;
        Ok(Sampler::new(ElevationReader::open(raster, values)?, mapper, middle, lattice.step))
    };
    sources.iter().map(open).collect()
}

/// Samples the finest level; voids are NaN. The first source that has data at a post gives its height.
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
    let summary = Mutex::new(Summary { voids: 0, range: [f32::MAX, f32::MIN] });
    work.each(
        "elevation",
        blocks.count(),
        || samplers(target, &plan.elevation, sources),
        |samplers, index| {
            let block = blocks.rect(index);
            let heights = std::cell::RefCell::new(vec![f32::NAN; block.area()]);
            for sampler in samplers {
                let is_done = |at: usize| !heights.borrow()[at].is_nan();
                sampler.sample::<1>(&plan.elevation, block, &is_done, &mut |at, [height]| {
                    heights.borrow_mut()[at] = quantised(height);
                })?;
            }
            let heights = heights.into_inner();
            let part = summarise(&heights);
            if let Ok(mut all) = summary.lock() {
                all.voids += part.voids;
                all.range = [all.range[0].min(part.range[0]), all.range[1].max(part.range[1])];
            }
            level.write(block, &heights).map_err(fail)
        },
    )?;
    let summary = summary.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    Ok((level, summary))
}

fn summarise(heights: &[f32]) -> Summary {
    let mut summary = Summary { voids: 0, range: [f32::MAX, f32::MIN] };
    for &height in heights {
        if height.is_nan() {
            summary.voids += 1;
        } else {
            summary.range = [summary.range[0].min(height), summary.range[1].max(height)];
        }
    }
    summary
}
