//! The vehicles of a file: each line with times is one, and so are the points with times of one
//! name.

use super::super::crs::Georeference;
use super::super::recording::{Recorded, Segment, Stamp, Tally, with_times};
use super::super::vehicles::{Appearance, HeightReference, Moment, Vehicle, Way};
use super::super::{PathError, Remarks, printable};
use super::shapes::Shapes;
use super::{MAX_DEPTH, Reader, fields, number, raw_json, transform};
use serde_json::value::RawValue;
use std::collections::HashMap;
use std::path::Path;
use terravision_common::vehicle::MOST_VEHICLES;

/// Properties that tell vehicles apart.
const NAMES: [&str; 4] = ["vehicle", "name", "id", "track_fid"];

/// A vehicle in the making.
struct Found<'a> {
    place: String,
    segments: Vec<Segment>,
    properties: Option<&'a RawValue>,
}

/// Reads the vehicles of a file.
///
/// # Errors
/// [`PathError`] with the feature in it.
pub(in super::super) fn read(
    path: &Path,
    text: &str,
    world: &Georeference,
    remarks: &mut Remarks,
) -> Result<Vec<Vehicle>, PathError> {
    let json = |source| PathError::Json { path: path.to_owned(), source };
    let [crs, features] = fields(text, &["crs", "features"]).map_err(json)?;
    let (mut way, is_lonlat) = transform(path, crs, world)?;
    let mut found: Vec<Found<'_>> = Vec::new();
    let mut named: HashMap<String, usize> = HashMap::new();
    let (mut count, mut timeless) = (0, 0);
    let mut each = |place: String, text| {
        let mut shapes = Shapes::default();
        shapes.count = count;
        let mut reader = Reader { path, transform: way.take(), is_lonlat, shapes, warnings: Vec::new() };
        let read = reader.object(text, &place, None, MAX_DEPTH);
        let Reader { transform, shapes, warnings, .. } = reader;
        (way, count) = (transform, shapes.count);
        read?;
        remarks.warnings.extend(warnings);
        timeless += shapes.timeless + shapes.others;
        let properties = fields(text, &["properties"]).ok().and_then(|found| found[0]);
        let [lines, tracks] = shapes.moving();
        let has_times = |segment: &Segment| segment.points.iter().any(|point| point.stamp != Stamp::Missing);
        let (timed, plain): (Vec<_>, Vec<_>) = lines.into_iter().partition(has_times);
        timeless += plain.len();
        if !timed.is_empty() {
            found.push(Found { place: place.clone(), segments: timed, properties });
        }
        for track in tracks {
            let name = name_of(properties).unwrap_or_default();
            let at = *named.entry(name).or_insert_with(|| {
                found.push(Found { place: place.clone(), segments: vec![Segment::default()], properties });
                found.len() - 1
            });
            if let Some(segment) = found[at].segments.last_mut() {
                segment.points.extend(track.points);
            }
        }
        Ok(())
    };
    match features.filter(|list| raw_json::is_list(list)) {
        Some(list) => {
            raw_json::each(list.get(), |i, feature| each(format!("feature {i}"), feature.get())).map_err(json)??;
        }
        None => each("the file".into(), text)?,
    }
    if found.is_empty() || found.len() > MOST_VEHICLES {
        let what = format!("GeoJSON with {} lines and points that have times, of 1 to {MOST_VEHICLES}", found.len());
        return Err(PathError::NoVehicles { path: path.to_owned(), found: what });
    }
    if timeless > 0 {
        let file = path.display();
        remarks.notes.push(format!("{file}: shapes without times are not drawn; there are {timeless}"));
    }
    found.into_iter().map(|found| vehicle(path, found, remarks)).collect()
}

fn name_of(properties: Option<&RawValue>) -> Option<String> {
    let names = properties.and_then(|raw| fields(raw.get(), &NAMES).ok())?;
    names.into_iter().flatten().find(|raw| raw.get() != "null").map(|raw| raw.get().to_owned())
}

fn vehicle(path: &Path, found: Found<'_>, remarks: &mut Remarks) -> Result<Vehicle, PathError> {
    let Found { place, segments, properties } = found;
    let mut tally = Tally::default();
    let has_heights =
        segments.iter().flat_map(|segment| &segment.points).any(|point: &Recorded| point.height_m.is_some());
    let mut ways = Vec::new();
    for segment in &segments {
        let mut height_m = 0.0;
        let moment = |point: super::super::recording::Timed| {
            height_m = point.height_m.unwrap_or(height_m);
            Moment { t: point.t, position: point.place.extend(height_m), attitude: None }
        };
        ways.extend(Way::new(with_times(segment, &mut tally).into_iter().map(moment).collect(), None, false));
    }
    if tally.is_hopeless() || ways.is_empty() {
        return Err(PathError::BadValue {
            path: path.to_owned(),
            place,
            key: "its times".into(),
            expected: "times that grow from point to point",
            found: format!("{} of {} that can be used", tally.used, tally.stamped),
        });
    }
    remarks.warnings.extend(tally.warning().map(|warning| format!("{}: {place}: {warning}", path.display())));
    let look = Look { path, place: &place, properties };
    let usual = if has_heights { HeightReference::Datum } else { HeightReference::OnGround };
    let height = look.height()?.unwrap_or(usual);
    Ok(Vehicle { height, appearance: look.appearance()?, ways, place })
}

/// What the properties of a feature say of its vehicle.
struct Look<'a> {
    path: &'a Path,
    place: &'a str,
    properties: Option<&'a RawValue>,
}

impl Look<'_> {
    fn value<T>(
        &self,
        key: &str,
        expected: &'static str,
        read: impl FnOnce(&RawValue) -> Option<T>,
    ) -> Result<Option<T>, PathError> {
        let raw = self.properties.and_then(|raw| fields(raw.get(), &[key]).ok()?[0]);
        let Some(raw) = raw.filter(|raw| raw.get() != "null") else { return Ok(None) };
        read(raw).map(Some).ok_or_else(|| PathError::BadValue {
            path: self.path.to_owned(),
            place: self.place.to_owned(),
            key: format!("{key:?}"),
            expected,
            found: printable(raw.get()),
        })
    }

    fn height(&self) -> Result<Option<HeightReference>, PathError> {
        let expected = "NONE, CLAMP_TO_GROUND or RELATIVE_TO_GROUND";
        self.value("heightReference", expected, |raw| match raw_json::text(raw)?.as_str() {
            "NONE" => Some(HeightReference::Datum),
            "CLAMP_TO_GROUND" => Some(HeightReference::OnGround),
            "RELATIVE_TO_GROUND" => Some(HeightReference::AboveGround),
            _ => None,
        })
    }

    fn appearance(&self) -> Result<Appearance, PathError> {
        let size = |raw: &RawValue| number(raw).filter(|number| (1e-6..=1e6).contains(number));
        let model = |raw: &RawValue| {
            let name = raw_json::text(raw).filter(|name| !name.is_empty() && !name.contains("://"))?;
            Some(self.path.parent().unwrap_or(Path::new("")).join(name))
        };
        let color = |raw: &RawValue| {
            let text = raw_json::text(raw)?;
            let digits = text.strip_prefix('#').filter(|digits| digits.len() == 6)?;
            let number = u32::from_str_radix(digits, 16).ok()?;
            let [_, rgb @ ..] = number.to_be_bytes();
            Some(rgb)
        };
        Ok(Appearance {
            model: self.value("model", "the name of a glTF file beside this one", model)?,
            scale: self.value("scale", "a number from 0.000001 to 1000000", size)?,
            point_px: self.value("pixelSize", "a number from 0.000001 to 1000000", size)?,
            rgb: self.value("marker-color", "a colour like #ff8800", color)?,
        })
    }
}
