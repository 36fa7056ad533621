//! The finest colour level: from its sources; without data, a tint of the elevation.

use super::kernel::Kernel;
use super::{BLOCK, Sampled, SourceSet};
use crate::IngestError;
use crate::plan::Plan;
use crate::source::readers::ColorReader;
use crate::source::values::ColorValues;
use crate::source::{Raster, TargetCrs};
use crate::store::{Level, Rgb};
use crate::tint::Tint;
use crate::work::Work;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// A colour in whole numbers, rounded.
pub(crate) fn eight_bits(color: [f32; 3]) -> Rgb {
    // A cast truncates. In double precision the sum is exact, so that values just below a half are
    // not rounded up. `round` would be a function call on processors without SSE 4.1.
    color.map(|v| (f64::from(v.clamp(0.0, 255.0)) + 0.5) as u8)
}

/// Samples the finest level; returns it and the number of texels without a source. The first source
/// that has data at a texel gives its colour.
///
/// # Errors
/// [`IngestError`].
pub fn sample(
    plan: &Plan,
    target: &TargetCrs,
    sources: &[(Raster, ColorValues)],
    tint: &Tint<'_>,
    folder: &Path,
    work: &Work,
) -> Result<(Level<Rgb>, u64), IngestError> {
    let fail = |source| IngestError::Output { source, path: folder.to_owned() };
    let level = Level::create(folder, plan.color_size(plan.world.finest_color_level())).map_err(fail)?;
    let blocks = level.blocks(BLOCK);
    let voids = AtomicU64::new(0);
    work.each(
        "colour",
        blocks.count(),
        || Ok(SourceSet::new(sources, &plan.color_bounds, target, plan.color, ColorReader::open, Kernel::new)),
        |set, index| {
            let block = blocks.rect(index);
            let texels = set.sample::<3>(block)?;
            let color = |texel: Sampled<3>| texel.known().map(|(_, color)| eight_bits(color));
            let mut texels: Vec<Option<Rgb>> = texels.into_iter().map(color).collect();
            let missing = texels.iter().filter(|t| t.is_none()).count();
            if missing > 0 {
                // Relaxed: read when all threads have ended.
                voids.fetch_add(missing as u64, Ordering::Relaxed);
                let tinted = tint.block(block).map_err(fail)?;
                texels.iter_mut().zip(tinted).for_each(|(texel, tint)| *texel = texel.or(Some(tint)));
            }
            let texels: Vec<Rgb> = texels.into_iter().flatten().collect();
            level.write(block, &texels).map_err(fail)
        },
    )?;
    Ok((level, voids.into_inner()))
}
