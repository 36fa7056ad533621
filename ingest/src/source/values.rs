//! The meaning of samples of elevation: no data, units. (For images: [`ColorValues`].)

pub use super::color_values::ColorValues;

use super::Note;
use super::crs::body_of;
use super::raster::{BandInfo, Raster, Shows};
use super::survey::{Stats, Survey};
use crate::error::IngestError;
use crate::work::Work;
use gdal::spatial_ref::SpatialRef;

/// Upper bound of heights on any solid body, metres; larger values are fill.
pub(super) const MAX_HEIGHT_M: f32 = 100_000.0;
/// Values that producers use for "no data" without saying so.
pub(super) const SENTINELS: [f32; 11] = [
    -32768.0,
    -32767.0,
    -9999.0,
    -99999.0,
    9999.0,
    32767.0,
    65535.0,
    99999.0,
    -10000.0,
    -2_147_483_648.0,
    2_147_483_647.0,
];
/// A sentinel is isolated: no other sample is within this many units of it.
pub(super) const SENTINEL_GAP: f32 = 300.0;
/// Ranges of the ground of bodies, metres, with a small margin. (Earth: Challenger Deep and
/// Everest; others: global grids of laser altimeters and radars.)
const GROUND: [(&str, [f64; 2]); 5] = [
    ("Earth", [-11_100.0, 9_000.0]),
    ("Mars", [-9_000.0, 22_000.0]),
    ("Moon", [-10_000.0, 11_000.0]),
    ("Mercury", [-6_000.0, 5_000.0]),
    ("Venus", [-4_000.0, 12_000.0]),
];

/// The user's choice of no data values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NodataChoice {
    /// Nothing: what files declare holds, and undeclared sentinels are looked for.
    FromFiles,
    /// This value means no data, and what files declare does too.
    Value(f64),
    /// What files declare holds, and nothing else: `--nodata none`.
    OnlyDeclared,
}

/// The conversion of samples of an elevation source to metres or voids.
#[derive(Debug, Clone)]
pub struct ElevationValues {
    nodata: Vec<f32>,
    scale: f64,
    offset: f64,
}

impl ElevationValues {
    /// The height of a sample; `None` for a void.
    #[must_use]
    pub fn height(&self, sample: f32) -> Option<f32> {
        if !sample.is_finite() || sample.abs() > 1e30 || self.is_declared_void(sample) {
            return None;
        }
        let height = self.meters(sample) as f32;
        (height.abs() <= MAX_HEIGHT_M).then_some(height)
    }

    pub(super) fn is_declared_void(&self, sample: f32) -> bool {
        self.nodata.contains(&sample)
    }

    pub(super) fn meters(&self, sample: f32) -> f64 {
        f64::from(sample) * self.scale + self.offset
    }

    /// Whether samples are metres already.
    pub(super) fn is_plain(&self) -> bool {
        self.scale == 1.0 && self.offset == 0.0
    }

    /// Determines the meaning of a source's samples. Reads all of it.
    ///
    /// # Errors
    /// [`IngestError::Source`] when it cannot be read, or its samples are not heights;
    /// interruption.
    pub fn of(
        raster: &Raster,
        choice: NodataChoice,
        unit_m: Option<f64>,
        work: &Work,
        note: &mut dyn FnMut(Note),
    ) -> Result<Self, IngestError> {
        let band = &raster.bands()[0];
        if band.palette.is_some() {
            note(Note::Warning(format!("{} has a palette: its indices are taken as heights", raster.path().display())));
        }
        let count = raster.bands().iter().filter(|b| b.shows != Shows::Alpha).count();
        if count > 1 {
            note(Note::Warning(format!(
                "{} has {count} bands: the first is taken as heights",
                raster.path().display()
            )));
        }
        let mut nodata: Vec<f32> = band.nodata.into_iter().map(|v| v as f32).collect();
        if let NodataChoice::Value(value) = choice {
            nodata.push(value as f32);
        }
        let unit = match unit_m {
            Some(unit) => unit,
            None => vertical_unit(raster, band, note)?,
        };
        let [scale, offset] = band.scale_offset;
        let mut values = Self { nodata, scale: scale * unit, offset: offset * unit };
        let srs = raster.srs()?;
        let body = body_of(&srs);
        let finds_fill = choice == NodataChoice::FromFiles;
        let survey = Survey::of(raster, &values, body.radius_m, finds_fill, work)?;
        for (value, count) in &survey.sentinels {
            note(Note::Warning(format!(
                "{} has {count} samples of {value}, which it does not declare as no data: they are taken as \
                 voids; --nodata {value} declares it, --nodata none keeps them as heights",
                raster.path().display()
            )));
            values.nodata.push(*value);
        }
        if values.take_radius_off(raster, &survey, body.radius_m, srs.semi_minor().ok(), note)? {
            return Ok(values);
        }
        check_beyond(raster, &survey, note)?;
        check_ground(raster, &survey.heights, &body.name, note);
        Ok(values)
    }

    /// Converts distances from the body's centre to heights, if most samples are such distances.
    fn take_radius_off(
        &mut self,
        raster: &Raster,
        survey: &Survey,
        radius_m: f64,
        semi_minor_m: Option<f64>,
        note: &mut dyn FnMut(Note),
    ) -> Result<bool, IngestError> {
        let found = survey.distances;
        if 2 * found.count <= survey.heights.count + survey.beyond.count {
            return Ok(false);
        }
        let (low, high, radius) = (grouped(found.low), grouped(found.high), grouped(radius_m));
        if semi_minor_m.is_some_and(|b| (radius_m - b).abs() > 1.0) {
            return Err(IngestError::source(
                raster.path(),
                format!(
                    "has distances from the centre of the body, {low} to {high} m, not heights; its ellipsoid is flattened, so \
                     that the radius to take off depends on the latitude: give heights above it (gdal_calc.py), or name the \
                     sphere that they are counted from with gdal_edit.py -a_srs"
                ),
            ));
        }
        note(Note::Info(format!(
            "{} has distances from the centre, {low} to {high} m: {radius} m are taken off",
            raster.path().display()
        )));
        self.offset -= radius_m;
        Ok(true)
    }
}

/// Samples that would be heights of more than 100 km: an error if there are no others.
fn check_beyond(raster: &Raster, survey: &Survey, note: &mut dyn FnMut(Note)) -> Result<(), IngestError> {
    let beyond = survey.beyond;
    if beyond.count == 0 {
        return Ok(());
    }
    let range = range_of(&beyond);
    if survey.heights.count == 0 {
        return Err(IngestError::source(
            raster.path(),
            format!(
                "has no heights that a body can have: its samples, {range}, lie beyond ±100 km; if they are not metres, \
                 --elevation-unit mm (or cm, ft, …) tells"
            ),
        ));
    }
    note(Note::Warning(format!(
        "{} has {} samples {range}, beyond ±100 km: they are taken as voids; if they are not metres, --elevation-unit mm (or cm, \
         ft, …) tells",
        raster.path().display(),
        grouped(beyond.count as f64)
    )));
    Ok(())
}

/// "from 590,000 to 1,100,000".
fn range_of(stats: &Stats) -> String {
    match stats.low == stats.high {
        true => format!("of {}", grouped(stats.low)),
        false => format!("from {} to {}", grouped(stats.low), grouped(stats.high)),
    }
}

/// Warns of heights that the ground of the body does not have.
fn check_ground(raster: &Raster, heights: &Stats, body: &str, note: &mut dyn FnMut(Note)) {
    let Some((_, [low, high])) = GROUND.iter().find(|(name, _)| *name == body) else { return };
    if heights.count > 0 && (heights.low < *low || heights.high > *high) {
        note(Note::Warning(format!(
            "{} has heights {} m, but the ground of {body} lies between {} and {} m: if they are not metres, \
             --elevation-unit cm (or mm, dm, ft, …) tells, and --nodata V if some of them mean \"no data\"",
            raster.path().display(),
            range_of(heights),
            grouped(*low),
            grouped(*high)
        )));
    }
}

/// A whole number for people: 1,100,000.
pub(super) fn grouped(value: f64) -> String {
    let digits = format!("{:.0}", value.abs());
    let mut text = String::new();
    for (at, digit) in digits.chars().enumerate() {
        if at > 0 && (digits.len() - at).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    if value < 0.0 && digits != "0" { format!("-{text}") } else { text }
}

/// Isolated sentinels, and their numbers of samples. `counts`: for each sentinel the number of
/// samples with its value, and near it. Two sentinels may be neighbours (-32768 and -32767): either
/// or both of them count as isolated.
pub(super) fn lone_sentinels(counts: &[[u64; 2]; SENTINELS.len()]) -> Vec<(f32, u64)> {
    let is_alone = |i: usize| {
        let others: u64 = (0..SENTINELS.len())
            .filter(|&j| j != i && (SENTINELS[j] - SENTINELS[i]).abs() <= SENTINEL_GAP)
            .map(|j| counts[j][0])
            .sum();
        counts[i][0] > 0 && counts[i][1] == others
    };
    (0..SENTINELS.len()).filter(|&i| is_alone(i)).map(|i| (SENTINELS[i], counts[i][0])).collect()
}

/// Metres in a unit of length, by the names that files use; `None` for other names.
#[must_use]
pub fn meters_in(unit: &str) -> Option<f64> {
    // International foot and US survey foot: 0.3048 m, 1200/3937 m (NIST Special Publication 811,
    // appendix B).
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

/// Heights without a unit are metres, but feet if the plane is in feet, as is usual for surveys in
/// feet.
fn unit_of_plane(raster: &Raster, srs: &SpatialRef, note: &mut dyn FnMut(Note)) -> f64 {
    let plane = srs.linear_units();
    if !srs.is_projected() || (plane / 0.3048 - 1.0).abs() > 1e-4 {
        return 1.0;
    }
    let name = srs.linear_units_name().unwrap_or_else(|| "foot".to_owned());
    note(Note::Info(format!(
        "{} does not tell the unit of its heights; its plane is in {name}, so they are taken as {name} too and converted to metres \
         (--elevation-unit m, if they are metres; us-ft or ft tells it)",
        raster.path().display()
    )));
    plane
}

fn vertical_unit(raster: &Raster, band: &BandInfo, note: &mut dyn FnMut(Note)) -> Result<f64, IngestError> {
    let srs = raster.srs()?;
    let attribute = |child| srs.get_attr_value("VERT_CS|UNIT", child).ok().flatten();
    if band.unit.trim().is_empty() {
        // A compound CRS has the unit of its heights as a name and in metres.
        let factor = attribute(1).and_then(|text| text.parse::<f64>().ok()).filter(|f| f.is_finite() && *f > 0.0);
        let Some(factor) = factor else { return Ok(unit_of_plane(raster, &srs, note)) };
        if factor != 1.0 {
            let name = attribute(0).unwrap_or_default();
            note(Note::Info(format!("{}: heights are converted from {name} to metres", raster.path().display())));
        }
        return Ok(factor);
    }
    let Some(factor) = meters_in(&band.unit) else {
        note(Note::Warning(format!(
            "{} gives the unit of its heights as \"{}\", which is not known: they are taken as metres (--elevation-unit tells)",
            raster.path().display(),
            band.unit
        )));
        return Ok(1.0);
    };
    if factor != 1.0 {
        note(Note::Info(format!("{}: heights are converted from {} to metres", raster.path().display(), band.unit)));
    }
    Ok(factor)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_of_length_by_their_many_names() {
        assert_eq!(meters_in("Metre"), Some(1.0));
        assert_eq!(meters_in("ft"), Some(0.3048));
        assert!((meters_in("US survey foot").unwrap() - 0.304_800_6).abs() < 1e-7);
        assert_eq!(meters_in("kelvin"), None);
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
}
