//! The meaning of samples of images: bands, alpha, undeclared fill, the stretch of more than eight
//! bits.

use super::Note;
use super::raster::{Raster, Shows};
use super::readers::open_raster;
use super::values::{NodataChoice, SENTINEL_GAP, SENTINELS, lone_sentinels};
use crate::error::IngestError;
use gdal::raster::GdalDataType;

/// The bands of the image, and the conversion of samples to eight bits.
#[derive(Debug, Clone)]
pub struct ColorValues {
    /// Bands (from 1) of red, green, blue; the same band thrice for grey or a palette.
    pub bands: [usize; 3],
    /// The alpha band, and the smallest opaque sample.
    pub alpha: Option<(usize, f32)>,
    /// Samples become `(sample - black)·gain`.
    black: f32,
    gain: f32,
    /// Undeclared values that mean "no picture".
    fill: Vec<f32>,
}

impl ColorValues {
    /// A sample in eight bits, not yet rounded.
    #[must_use]
    pub fn eight_bits(&self, sample: f32) -> f32 {
        ((sample - self.black) * self.gain).clamp(0.0, 255.0)
    }

    /// Whether a sample of a band is part of the image, judged by its value.
    #[must_use]
    pub fn is_data(&self, raster: &Raster, band: usize, sample: f32) -> bool {
        raster.is_data(band, sample) && !self.fill.contains(&sample)
    }

    /// Determines the meaning of samples of colour sources: one stretch for all that need one, so
    /// that no edges are visible between files.
    ///
    /// # Errors
    /// [`IngestError`]: a band that does not exist, a file that cannot be read.
    pub fn of_all(
        rasters: &[Raster],
        chosen: Option<[usize; 3]>,
        nodata: NodataChoice,
        note: &mut dyn FnMut(Note),
    ) -> Result<Vec<Self>, IngestError> {
        let mut all = rasters.iter().map(|r| Self::choose_bands(r, chosen, note)).collect::<Result<Vec<_>, _>>()?;
        let is_wide = |r: &Raster| r.bands()[0].data_type != GdalDataType::UInt8 && r.bands()[0].palette.is_none();
        let mut samples = Vec::new();
        for (raster, values) in rasters.iter().zip(&mut all) {
            let alpha = values.find_least_alpha(raster)?;
            if is_wide(raster) {
                samples.extend(values.shown_samples(raster, alpha, nodata, note)?);
            }
        }
        let is_float = rasters.iter().any(|r| is_wide(r) && r.bands()[0].data_type.is_floating());
        let stretch = stretch(&mut samples, is_float);
        for (raster, values) in rasters.iter().zip(&mut all).filter(|(r, _)| is_wide(r)) {
            (values.black, values.gain) = (stretch.black, 255.0 / (stretch.white - stretch.black));
            let file = raster.path().display();
            note(Note::Info(format!(
                "{file} has {} samples: {} to {} become 0 to 255 ({})",
                raster.data_type(),
                stretch.black,
                stretch.white,
                stretch.why
            )));
        }
        Ok(all)
    }

    /// Determines the smallest opaque alpha. Returns samples of alpha.
    fn find_least_alpha(&mut self, raster: &Raster) -> Result<Option<Vec<f32>>, IngestError> {
        let Some((band, least)) = &mut self.alpha else { return Ok(None) };
        let samples = thin_samples(raster, *band)?;
        let most = samples.iter().copied().fold(0.0, f32::max);
        *least = (0.5 * most).max(f32::MIN_POSITIVE);
        Ok(Some(samples))
    }

    /// Samples of the image, without those hidden by alpha, a mask, "no data" or undeclared fill.
    fn shown_samples(
        &mut self,
        raster: &Raster,
        alpha: Option<Vec<f32>>,
        nodata: NodataChoice,
        note: &mut dyn FnMut(Note),
    ) -> Result<Vec<f32>, IngestError> {
        let bands = self.color_bands();
        let bands: Vec<(usize, Vec<f32>)> =
            bands.into_iter().map(|b| Ok((b, thin_samples(raster, b)?))).collect::<Result<_, IngestError>>()?;
        let shown = match (alpha, self.alpha) {
            (Some(alpha), Some((_, least))) => Some(alpha.into_iter().map(|a| a >= least).collect::<Vec<_>>()),
            _ => thin_mask(raster)?,
        };
        let is_shown = |at: usize| shown.as_ref().is_none_or(|s| s.get(at).copied().unwrap_or(true));
        let is_data = |band: usize, at: usize, v: f32| is_shown(at) && raster.is_data(band, v);
        if nodata == NodataChoice::FromFiles {
            self.fill = fill_of(bands.iter().flat_map(|(band, samples)| {
                samples.iter().enumerate().filter(|(at, v)| is_data(*band, *at, **v)).map(|(_, v)| *v)
            }));
            for value in &self.fill {
                note(Note::Warning(format!(
                    "{} has samples of {value} apart from all others, which it does not declare as no data: pixels that have it in \
                     all bands are taken as no picture; gdal_edit.py -a_nodata {value} declares it, --nodata none keeps them",
                    raster.path().display()
                )));
            }
        }
        let fill = &self.fill;
        let of_band = |(band, samples): &(usize, Vec<f32>)| {
            let values = samples.iter().enumerate();
            values.filter(|(at, v)| is_data(*band, *at, **v) && !fill.contains(v)).map(|(_, v)| *v).collect::<Vec<_>>()
        };
        Ok(bands.iter().flat_map(of_band).collect())
    }

    /// The bands that are read for colour, each once.
    #[must_use]
    pub fn color_bands(&self) -> Vec<usize> {
        let mut bands = self.bands.to_vec();
        bands.dedup();
        bands
    }

    fn choose_bands(
        raster: &Raster,
        chosen: Option<[usize; 3]>,
        note: &mut dyn FnMut(Note),
    ) -> Result<Self, IngestError> {
        let shows = |what| raster.bands().iter().position(|b| b.shows == what).map(|i| i + 1);
        let count = raster.bands().len();
        let alpha = shows(Shows::Alpha).map(|band| (band, f32::MIN_POSITIVE));
        let color_count = count - usize::from(alpha.is_some());
        let declared = [Shows::Red, Shows::Green, Shows::Blue].map(shows);
        let bands = match (chosen, declared) {
            (Some(bands), _) => {
                if let Some(band) = bands.iter().find(|b| **b == 0 || **b > count) {
                    return Err(IngestError::source(
                        raster.path(),
                        format!("has {count} bands, but --bands asks for band {band}"),
                    ));
                }
                bands
            }
            (None, _) if color_count < 3 => [1; 3],
            (None, [Some(red), Some(green), Some(blue)]) => [red, green, blue],
            (None, _) => {
                if color_count > 3 {
                    note(Note::Info(format!(
                        "{} has {count} bands: 1, 2, 3 are shown as red, green, blue (--bands R,G,B chooses)",
                        raster.path().display()
                    )));
                }
                [1, 2, 3]
            }
        };
        Ok(Self { bands, alpha, black: 0.0, gain: 1.0, fill: Vec::new() })
    }
}

impl Raster {
    /// Whether a sample of a band is data, as far as its nodata value tells.
    #[must_use]
    pub fn is_data(&self, band: usize, sample: f32) -> bool {
        sample.is_finite() && self.bands()[band - 1].nodata.is_none_or(|nodata| sample != nodata as f32)
    }
}

/// At most a million samples of a band, evenly spread.
fn thin_samples(raster: &Raster, band: usize) -> Result<Vec<f32>, IngestError> {
    let dataset = open_raster(raster)?;
    let size = (raster.size()[0], raster.size()[1]);
    let first = (raster.first()[0] as isize, raster.first()[1] as isize);
    let samples = dataset.rasterband(band).and_then(|band| band.read_as::<f32>(first, size, thin(raster), None));
    let samples = samples.map_err(|e| raster.fails("cannot be read", &e))?;
    Ok(samples.data().to_vec())
}

/// Columns and rows of thin samples.
fn thin(raster: &Raster) -> (usize, usize) {
    (raster.size()[0].min(1024), raster.size()[1].min(1024))
}

/// Which of the thinned samples a mask band shows; `None` without a mask band.
fn thin_mask(raster: &Raster) -> Result<Option<Vec<bool>>, IngestError> {
    if !raster.bands()[0].has_mask {
        return Ok(None);
    }
    let dataset = open_raster(raster)?;
    let (size, shape) = ((raster.size()[0], raster.size()[1]), thin(raster));
    let first = (raster.first()[0] as isize, raster.first()[1] as isize);
    let mask = dataset
        .rasterband(1)
        .and_then(|band| band.open_mask_band()?.read_as::<u8>(first, size, shape, None))
        .map_err(|e| raster.fails("has a mask that cannot be read", &e))?;
    Ok(Some(mask.data().iter().map(|m| *m != 0).collect()))
}

/// Undeclared fill among samples: values that producers use for it and that stand alone, and absurd
/// ones.
fn fill_of(samples: impl Iterator<Item = f32>) -> Vec<f32> {
    let mut counts = [[0; 2]; SENTINELS.len()];
    let mut huge = None;
    for sample in samples {
        if sample.abs() > 1e30 {
            huge = Some(sample);
        }
        for (sentinel, count) in SENTINELS.iter().zip(&mut counts) {
            let distance = (sample - sentinel).abs();
            if distance <= SENTINEL_GAP {
                count[usize::from(distance > 0.0)] += 1;
            }
        }
    }
    lone_sentinels(&counts).into_iter().map(|(value, _)| value).chain(huge).collect()
}

struct Stretch {
    black: f32,
    white: f32,
    why: &'static str,
}

/// The stretch of samples with more than eight bits, by almost all samples, so that single glints
/// do not matter.
fn stretch(samples: &mut [f32], is_float: bool) -> Stretch {
    samples.sort_unstable_by(f32::total_cmp);
    let (Some(&least), Some(&most)) = (samples.first(), samples.last()) else {
        return Stretch { black: 0.0, white: 255.0, why: "there are no samples" };
    };
    let share_of = |above: f32| samples.partition_point(|v| *v <= above) as f64 / samples.len() as f64;
    let has_fractions = || samples.iter().any(|v| v.fract() != 0.0);
    if is_float && least >= -0.1 && share_of(1.0) >= 0.98 && share_of(-f32::MIN_POSITIVE) <= 0.02 && has_fractions() {
        return Stretch { black: 0.0, white: 1.0, why: "they are fractions" };
    }
    // Floats that hardly exceed 1 are fractions, never eight bits.
    if least >= 0.0 && most <= 255.0 && !(is_float && share_of(2.0) >= 0.98) {
        return Stretch { black: 0.0, white: 255.0, why: "they fit already" };
    }
    // The usual "2 % stretch" of remote sensing viewers; one for all bands, so that hues stay.
    let at = |share: f64| samples[((samples.len() - 1) as f64 * share) as usize];
    let (black, white) = (at(0.02), at(0.98));
    if white > black {
        Stretch { black, white, why: "all but 2 % at either end, the same for all bands" }
    } else {
        Stretch {
            black: least,
            white: if most > least { most } else { least + 1.0 },
            why: "from the least to the most",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stretch_depends_on_the_samples() {
        let mut fractions = [0.0, 0.25, 0.5];
        assert_eq!(stretch(&mut fractions, true).white, 1.0);
        let mut eight = [0.0, 3.0, 200.0];
        assert_eq!(stretch(&mut eight, false).white, 255.0);
        let mut twelve: Vec<f32> = (0..=1000).map(|v| v as f32 * 4.0).collect();
        let found = stretch(&mut twelve, false);
        assert_eq!((found.black, found.white), (80.0, 3920.0));
        assert_eq!(stretch(&mut [700.0; 4], false).black, 700.0);
    }
}
