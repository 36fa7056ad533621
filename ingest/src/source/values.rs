//! What samples mean: no data, units, bands of a picture, the stretch of more than eight bits.

use super::Note;
use super::open::open_raster;
use super::raster::Shows;
use super::raster::{BandInfo, Raster};
use crate::error::{IngestError, gdal_message};
use crate::work::Work;
use gdal::raster::GdalDataType;

/// No height on any solid body is beyond it, metres; larger values are fill.
const MAX_HEIGHT_M: f32 = 100_000.0;
/// Values that producers use for "no data" without saying so.
const SENTINELS: [f32; 9] =
    [-32768.0, -32767.0, -9999.0, -99999.0, 9999.0, 32767.0, 65535.0, -2_147_483_648.0, 2_147_483_647.0];
/// A sentinel stands alone: no other sample is within so many units of it.
const SENTINEL_GAP: f32 = 300.0;

/// What the user says about no data.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NodataChoice {
    /// Nothing: what files declare holds, and undeclared sentinels are looked for.
    FromFiles,
    /// This value means no data, and what files declare does too.
    Value(f64),
    /// What files declare holds, and nothing else: `--nodata none`.
    OnlyDeclared,
}

/// How samples of an elevation source become metres or void.
#[derive(Debug, Clone)]
pub struct ElevationValues {
    nodata: Vec<f32>,
    scale: f64,
    offset: f64,
}

impl ElevationValues {
    /// The height that a sample stands for; `None` for a void.
    #[must_use]
    pub fn height(&self, sample: f32) -> Option<f32> {
        if !sample.is_finite() || sample.abs() > 1e30 || self.nodata.contains(&sample) {
            return None;
        }
        let height = (f64::from(sample) * self.scale + self.offset) as f32;
        (height.abs() <= MAX_HEIGHT_M).then_some(height)
    }

    /// Works out what a source's samples mean. Reads all of it when nobody says what "no data" is.
    ///
    /// # Errors
    /// [`IngestError::Source`] when it cannot be read; interruption.
    pub fn of(
        raster: &Raster,
        choice: NodataChoice,
        unit_m: Option<f64>,
        work: &Work,
        note: &mut dyn FnMut(Note),
    ) -> Result<Self, IngestError> {
        let band = &raster.bands[0];
        if band.palette.is_some() {
            note(Note::Warning(format!("{} has a palette: its indices are taken as heights", raster.path.display())));
        }
        if raster.bands.len() > 1 {
            let count = raster.bands.len();
            note(Note::Warning(format!("{} has {count} bands: the first is taken as heights", raster.path.display())));
        }
        let mut nodata: Vec<f32> = band.nodata.into_iter().map(|v| v as f32).collect();
        match choice {
            NodataChoice::Value(value) => nodata.push(value as f32),
            NodataChoice::FromFiles if nodata.is_empty() && !band.has_mask => {
                for (value, count) in find_sentinels(raster, work)? {
                    note(Note::Warning(format!(
                        "{} has {count} samples of {value}, which it does not declare as no data: they are taken as \
                         voids; --nodata {value} declares it, --nodata none keeps them as heights",
                        raster.path.display()
                    )));
                    nodata.push(value);
                }
            }
            NodataChoice::FromFiles | NodataChoice::OnlyDeclared => {}
        }
        let unit = match unit_m {
            Some(unit) => unit,
            None => vertical_unit(raster, band, note)?,
        };
        let [scale, offset] = band.scale_offset;
        Ok(Self { nodata, scale: scale * unit, offset: offset * unit })
    }
}

/// Metres in a unit of length, by the names that files use; `None` for other names.
#[must_use]
pub fn metres_in(unit: &str) -> Option<f64> {
    // International foot and US survey foot: 0.3048 m, 1200/3937 m (NIST Special Publication 811, appendix B).
    Some(match unit.trim().to_ascii_lowercase().as_str() {
        "" | "m" | "metre" | "metres" | "meter" | "meters" | "mètre" => 1.0,
        "ft" | "foot" | "feet" | "international foot" | "foot_international" => 0.3048,
        "us-ft" | "ftus" | "us survey foot" | "foot_us" | "us_survey_foot" | "sft" => 1200.0 / 3937.0,
        "km" | "kilometre" | "kilometer" => 1000.0,
        "dm" | "decimetre" | "decimeter" => 0.1,
        "cm" | "centimetre" | "centimeter" => 0.01,
        "mm" | "millimetre" | "millimeter" => 0.001,
        _ => return None,
    })
}

fn vertical_unit(raster: &Raster, band: &BandInfo, note: &mut dyn FnMut(Note)) -> Result<f64, IngestError> {
    let srs = raster.srs()?;
    let attribute = |child| srs.get_attr_value("VERT_CS|UNIT", child).ok().flatten();
    if band.unit.trim().is_empty() {
        // A compound CRS tells the unit of its heights in words and as metres.
        let factor = attribute(1).and_then(|text| text.parse::<f64>().ok()).filter(|f| f.is_finite() && *f > 0.0);
        if let Some(factor) = factor.filter(|f| *f != 1.0) {
            let name = attribute(0).unwrap_or_default();
            note(Note::Info(format!("{}: heights are converted from {name} to metres", raster.path.display())));
            return Ok(factor);
        }
        return Ok(1.0);
    }
    let Some(factor) = metres_in(&band.unit) else {
        note(Note::Warning(format!(
            "{} gives the unit of its heights as \"{}\", which is not known: they are taken as metres (--elevation-unit tells)",
            raster.path.display(),
            band.unit
        )));
        return Ok(1.0);
    };
    if factor != 1.0 {
        note(Note::Info(format!("{}: heights are converted from {} to metres", raster.path.display(), band.unit)));
    }
    Ok(factor)
}

/// Undeclared sentinel values of a source and how many samples have them. Reads all of it.
fn find_sentinels(raster: &Raster, work: &Work) -> Result<Vec<(f32, u64)>, IngestError> {
    if raster.bands[0].data_type == GdalDataType::UInt8 {
        return Ok(Vec::new());
    }
    let dataset = open_raster(raster)?;
    let fail =
        |e: gdal::errors::GdalError| IngestError::source(&raster.path, format!("cannot be read: {}", gdal_message(&e)));
    let band = dataset.rasterband(1).map_err(fail)?;
    let [columns, rows] = raster.size;
    let (_, block_rows) = band.block_size();
    let step = (block_rows * (4usize << 20).div_ceil(columns * block_rows).max(1)).min(rows);
    let mut counts = [[0u64; 2]; SENTINELS.len()];
    let mut huge = (0.0f32, 0u64);
    let starts: Vec<usize> = (0..rows).step_by(step).collect();
    let bar = work.progress("looking for voids", starts.len() as u64);
    for start in starts {
        work.check()?;
        let height = step.min(rows - start);
        // A strip of rows that would not fit is read in pieces.
        let width = (16usize << 20).div_ceil(height).min(columns);
        for column in (0..columns).step_by(width) {
            let size = (width.min(columns - column), height);
            let samples = band.read_as::<f32>((column as isize, start as isize), size, size, None).map_err(fail)?;
            for &value in samples.data() {
                if !value.is_finite() {
                    continue;
                }
                if value.abs() > 1e30 {
                    huge = (value, huge.1 + 1);
                }
                for (sentinel, count) in SENTINELS.iter().zip(&mut counts) {
                    let distance = (value - sentinel).abs();
                    if distance <= SENTINEL_GAP {
                        count[usize::from(distance > 0.0)] += 1;
                    }
                }
            }
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    // Two sentinels may be neighbours (-32768 and -32767): each alone counts, both together do too.
    let is_alone = |i: usize| {
        let others: u64 = (0..SENTINELS.len())
            .filter(|&j| j != i && (SENTINELS[j] - SENTINELS[i]).abs() <= SENTINEL_GAP)
            .map(|j| counts[j][0])
            .sum();
        counts[i][0] > 0 && counts[i][1] == others
    };
    let mut found: Vec<(f32, u64)> =
        (0..SENTINELS.len()).filter(|&i| is_alone(i)).map(|i| (SENTINELS[i], counts[i][0])).collect();
    if huge.1 > 0 {
        found.push(huge);
    }
    Ok(found)
}

/// Which bands make the picture and how samples become eight bits.
#[derive(Debug, Clone)]
pub struct ColorValues {
    /// Bands (from 1) of red, green, blue; the same band thrice for grey or a palette.
    pub bands: [usize; 3],
    /// Band that says what is opaque, and the least sample that is.
    pub alpha: Option<(usize, f32)>,
    /// Samples become `(sample - black)·gain`.
    black: f32,
    gain: f32,
}

impl ColorValues {
    /// A sample in eight bits, not yet rounded.
    #[must_use]
    pub fn eight_bits(&self, sample: f32) -> f32 {
        ((sample - self.black) * self.gain).clamp(0.0, 255.0)
    }

    /// Works out what the samples of colour sources mean: one stretch for all that need one, so that no edge shows
    /// between files.
    ///
    /// # Errors
    /// [`IngestError`]: a band that does not exist, a file that cannot be read.
    pub fn of_all(
        rasters: &[Raster],
        chosen: Option<[usize; 3]>,
        note: &mut dyn FnMut(Note),
    ) -> Result<Vec<Self>, IngestError> {
        let mut all = rasters.iter().map(|r| Self::choose_bands(r, chosen, note)).collect::<Result<Vec<_>, _>>()?;
        let is_wide = |r: &Raster| r.bands[0].data_type != GdalDataType::UInt8 && r.bands[0].palette.is_none();
        let mut samples = Vec::new();
        for (raster, values) in rasters.iter().zip(&all).filter(|(r, _)| is_wide(r)) {
            for band in values.color_bands() {
                samples.extend(thin_samples(raster, band)?.into_iter().filter(|v| raster.is_data(band, *v)));
            }
        }
        let stretch = stretch(&mut samples);
        for (raster, values) in rasters.iter().zip(&mut all) {
            if is_wide(raster) {
                (values.black, values.gain) = (stretch.black, 255.0 / (stretch.white - stretch.black));
                let file = raster.path.display();
                note(Note::Info(format!(
                    "{file} has {} samples: {} to {} become 0 to 255 ({})",
                    raster.data_type, stretch.black, stretch.white, stretch.why
                )));
            }
            if let Some((band, least)) = &mut values.alpha {
                let most = thin_samples(raster, *band)?.into_iter().fold(0.0, f32::max);
                *least = (0.5 * most).max(f32::MIN_POSITIVE);
            }
        }
        Ok(all)
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
        let shows = |what| raster.bands.iter().position(|b| b.shows == what).map(|i| i + 1);
        let count = raster.bands.len();
        let alpha = shows(Shows::Alpha).map(|band| (band, f32::MIN_POSITIVE));
        let color_count = count - usize::from(alpha.is_some());
        let declared = [Shows::Red, Shows::Green, Shows::Blue].map(shows);
        let bands = match (chosen, declared) {
            (Some(bands), _) => {
                if let Some(band) = bands.iter().find(|b| **b == 0 || **b > count) {
                    return Err(IngestError::source(
                        &raster.path,
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
                        raster.path.display()
                    )));
                }
                [1, 2, 3]
            }
        };
        Ok(Self { bands, alpha, black: 0.0, gain: 1.0 })
    }
}

impl Raster {
    /// Whether a sample of a band is data, as far as its nodata value tells.
    #[must_use]
    pub fn is_data(&self, band: usize, sample: f32) -> bool {
        sample.is_finite() && self.bands[band - 1].nodata.is_none_or(|nodata| sample != nodata as f32)
    }
}

/// At most a million samples of a band, evenly spread.
fn thin_samples(raster: &Raster, band: usize) -> Result<Vec<f32>, IngestError> {
    let dataset = open_raster(raster)?;
    let size = (raster.size[0], raster.size[1]);
    let shape = (size.0.min(1024), size.1.min(1024));
    let samples = dataset.rasterband(band).and_then(|band| band.read_as::<f32>((0, 0), size, shape, None));
    let samples =
        samples.map_err(|e| IngestError::source(&raster.path, format!("cannot be read: {}", gdal_message(&e))))?;
    Ok(samples.data().to_vec())
}

struct Stretch {
    black: f32,
    white: f32,
    why: &'static str,
}

/// How samples of more than eight bits become eight.
fn stretch(samples: &mut [f32]) -> Stretch {
    samples.sort_unstable_by(f32::total_cmp);
    let (Some(&least), Some(&most)) = (samples.first(), samples.last()) else {
        return Stretch { black: 0.0, white: 255.0, why: "there are no samples" };
    };
    if least >= 0.0 && most <= 1.0 && samples.iter().any(|v| v.fract() != 0.0) {
        return Stretch { black: 0.0, white: 1.0, why: "they are fractions" };
    }
    if least >= 0.0 && most <= 255.0 {
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
    fn units_of_length_by_their_many_names() {
        assert_eq!(metres_in("Metre"), Some(1.0));
        assert_eq!(metres_in("ft"), Some(0.3048));
        assert!((metres_in("US survey foot").unwrap() - 0.304_800_6).abs() < 1e-7);
        assert_eq!(metres_in("kelvin"), None);
    }

    #[test]
    fn samples_become_heights_or_voids() {
        let values = ElevationValues { nodata: vec![-9999.0], scale: 0.3048, offset: 10.0 };
        assert_eq!(values.height(100.0), Some(40.48));
        assert_eq!(values.height(-9999.0), None);
        assert_eq!(values.height(f32::NAN), None);
        assert_eq!(values.height(-3.402_823e38), None);
        assert_eq!(values.height(1e9), None);
    }

    #[test]
    fn the_stretch_depends_on_the_samples() {
        let mut fractions = [0.0, 0.25, 0.5];
        assert_eq!(stretch(&mut fractions).white, 1.0);
        let mut eight = [0.0, 3.0, 200.0];
        assert_eq!(stretch(&mut eight).white, 255.0);
        let mut twelve: Vec<f32> = (0..=1000).map(|v| v as f32 * 4.0).collect();
        let found = stretch(&mut twelve);
        assert_eq!((found.black, found.white), (80.0, 3920.0));
        assert_eq!(stretch(&mut [700.0; 4]).black, 700.0);
    }
}
