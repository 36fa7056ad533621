//! GeoJSON (RFC 7946): its lines, else its points with times, flown as the track of a receiver is
//! ([`super::track`]).
//!
//! The format has no times of its own. Of a line they are read where programs that convert tracks
//! write them, in a list beside its coordinates ([`TIME_LISTS`]); of a point in a property
//! ([`TIMES`]).

mod shapes;
mod vehicles;

pub(super) use vehicles::read as read_vehicles;

use super::crs::{Georeference, Transform};
use super::gpx::{MAX_POINTS, wrapped};
use super::raw_json::{self, fields, number};
use super::recording::{At, Recorded, Segment, Stamp};
use super::times::seconds_from_iso8601;
use super::{CameraPath, CourseOptions, Ground, PathError, Remarks, printable, track};
use serde_json::value::RawValue;
use shapes::Shapes;
pub(super) use shapes::list;
use std::path::Path;

/// Types of objects of the format.
const TYPES: [&str; 9] = [
    "FeatureCollection",
    "Feature",
    "GeometryCollection",
    "LineString",
    "MultiLineString",
    "Point",
    "MultiPoint",
    "Polygon",
    "MultiPolygon",
];
/// Geometries within each other; deeper ones are not looked at.
const MAX_DEPTH: usize = 4;
/// Properties with the times of a line's points.
const TIME_LISTS: [&str; 5] = ["coordTimes", "times", "timestamps", "time", "timestamp"];
/// Properties with the time of a point.
const TIMES: [&str; 4] = ["time", "timestamp", "datetime", "when"];
/// Properties that tell the tracks of points apart, as GDAL writes them.
const TRACKS: [&str; 2] = ["track_fid", "track_seg_id"];
/// A number that is larger is one of milliseconds since 1970 (3 March 1973), else of seconds (the
/// year 5138).
const FIRST_MILLISECONDS: f64 = 1e11;

/// Whether a JSON object is of this format, and not a path of poses.
pub(super) fn is_geojson(text: &str) -> bool {
    let Ok([kind, frames, keyframes]) = fields(text, &["type", "frames", "keyframes"]) else { return false };
    let is_type = kind.and_then(raw_json::text).is_some_and(|kind| TYPES.contains(&kind.as_str()));
    is_type && frames.is_none() && keyframes.is_none()
}

/// Reads the lines of a file, or else its points with times.
///
/// # Errors
/// [`PathError`] with the feature in it.
pub(super) fn parse(
    path: &Path,
    text: &str,
    world: &Georeference,
    ground: &dyn Ground,
    options: CourseOptions,
    remarks: &mut Remarks,
) -> Result<CameraPath, PathError> {
    let json = |source| PathError::Json { path: path.to_owned(), source };
    let [crs, features] = fields(text, &["crs", "features"]).map_err(json)?;
    let (transform, is_lonlat) = transform(path, crs, world)?;
    let mut reader = Reader { path, transform, is_lonlat, shapes: Shapes::default(), warnings: Vec::new() };
    match features {
        Some(list) if !raw_json::is_list(list) => {
            return Err(reader.bad("the file", "\"features\"", "a list", list));
        }
        Some(list) => {
            let each = |i, feature: &RawValue| reader.object(feature.get(), &format!("feature {i}"), None, MAX_DEPTH);
            raw_json::each(list.get(), each).map_err(json)??;
        }
        None => reader.object(text, "the file", None, MAX_DEPTH)?,
    }
    let Reader { shapes, warnings, .. } = reader;
    remarks.warnings.extend(warnings);
    let (has_heights, chosen) = (shapes.has_heights, shapes.choose(&mut remarks.notes));
    let segments = chosen.map_err(|found| PathError::Empty {
        path: path.to_owned(),
        expected: "a line (LineString), or points with a time",
        found,
    })?;
    if has_heights && options.agl_m.is_none() {
        remarks.notes.push(super::ELLIPSOIDAL.into());
    }
    track::course(path, segments, ground, options, remarks)
}

/// From the file's coordinates to the world's; whether these are longitudes and latitudes. Files of
/// before 2016 may name a CRS.
fn transform(
    path: &Path,
    crs: Option<&RawValue>,
    world: &Georeference,
) -> Result<(Option<Transform>, bool), PathError> {
    let name = crs
        .and_then(|crs| fields(crs.get(), &["properties"]).ok()?[0])
        .and_then(|properties| fields(properties.get(), &["name"]).ok()?[0])
        .and_then(raw_json::text);
    let fail = |source| PathError::Crs { path: path.to_owned(), place: "\"crs\"".into(), source: Box::new(source) };
    match name {
        Some(name) if !["CRS84", ":4326", ":4979"].iter().any(|lonlat| name.to_uppercase().contains(lonlat)) => {
            let transform = world.from_crs(&name).map_err(fail)?;
            let is_lonlat = transform.as_ref().is_some_and(Transform::is_from_lonlat);
            Ok((transform, is_lonlat))
        }
        _ => Ok((Some(world.from_lonlat().map_err(fail)?), true)),
    }
}

struct Reader<'a> {
    path: &'a Path,
    /// None where the file is in the world's own CRS.
    transform: Option<Transform>,
    is_lonlat: bool,
    shapes: Shapes,
    warnings: Vec<String>,
}

/// The times of a line's points, in the order of the points: of each part those of its own, or all
/// in one list.
struct Times {
    parts: Vec<Vec<Stamp>>,
    is_nested: bool,
}

impl Reader<'_> {
    fn bad(&self, place: &str, key: &str, expected: &'static str, found: &RawValue) -> PathError {
        PathError::BadValue {
            path: self.path.to_owned(),
            place: place.into(),
            key: key.into(),
            expected,
            found: printable(found.get()),
        }
    }

    /// A feature or a geometry. `properties`: of the feature that a geometry is of.
    fn object(
        &mut self,
        text: &str,
        place: &str,
        properties: Option<&RawValue>,
        depth: usize,
    ) -> Result<(), PathError> {
        const KEYS: [&str; 5] = ["type", "geometry", "properties", "geometries", "coordinates"];
        const EXPECTED: &str = "a feature or a geometry of GeoJSON, an object with a \"type\"";
        let wrong = |found: &str| PathError::BadValue {
            path: self.path.to_owned(),
            place: place.into(),
            key: "the entry".into(),
            expected: EXPECTED,
            found: printable(found),
        };
        let Ok([kind, geometry, own_properties, geometries, coordinates]) = fields(text, &KEYS) else {
            return Err(wrong(text));
        };
        let Some(kind) = kind.and_then(raw_json::text) else { return Err(wrong(text)) };
        let is_null = |raw: &&RawValue| raw.get() == "null";
        match (kind.as_str(), depth.checked_sub(1)) {
            ("Feature", Some(depth)) => match geometry.filter(|raw| !is_null(raw)) {
                Some(geometry) => self.object(geometry.get(), place, own_properties, depth),
                None => Ok(()),
            },
            ("GeometryCollection", Some(depth)) => {
                let Some(list) = geometries.filter(|raw| raw_json::is_list(raw)) else { return Ok(()) };
                let path = self.path;
                let each = |_, geometry: &RawValue| self.object(geometry.get(), place, properties, depth);
                raw_json::each(list.get(), each).map_err(|source| PathError::Json { path: path.to_owned(), source })?
            }
            ("LineString" | "MultiLineString" | "Point" | "MultiPoint", _) => {
                let list = coordinates.filter(|raw| raw_json::is_list(raw));
                let Some(list) = list else {
                    let found = coordinates.map_or("nothing", RawValue::get);
                    return Err(PathError::BadValue {
                        path: self.path.to_owned(),
                        place: place.into(),
                        key: "\"coordinates\"".into(),
                        expected: "a list",
                        found: printable(found),
                    });
                };
                match kind.as_str() {
                    "Point" => self.point(list, place, properties),
                    kind => self.line(list, place, properties, kind),
                }
            }
            _ => {
                self.shapes.others += 1;
                Ok(())
            }
        }
    }

    fn point(&mut self, list: &RawValue, place: &str, properties: Option<&RawValue>) -> Result<(), PathError> {
        let stamp = properties
            .and_then(|raw| fields(raw.get(), &TIMES).ok())
            .and_then(|times| times.into_iter().flatten().map(stamp).find(|stamp| *stamp != Stamp::Missing));
        let Some(stamp) = stamp else {
            self.shapes.timeless += 1;
            return Ok(());
        };
        let point = self.recorded(list, place, stamp, || "\"coordinates\"".into())?;
        let track = properties.and_then(|raw| fields(raw.get(), &TRACKS).ok());
        self.shapes.add_point(point, track.map(|ids| ids.map(|id| id.map_or(String::new(), |id| printable(id.get())))));
        Ok(())
    }

    /// A line, or several, or points of several times.
    fn line(
        &mut self,
        list: &RawValue,
        place: &str,
        properties: Option<&RawValue>,
        kind: &str,
    ) -> Result<(), PathError> {
        let times = properties.map_or(Ok(None), |raw| self.times(raw))?;
        if kind == "MultiPoint" && times.is_none() {
            self.shapes.timeless += 1;
            return Ok(());
        }
        let Times { parts, is_nested } = times.unwrap_or(Times { parts: Vec::new(), is_nested: false });
        let given: usize = parts.iter().map(Vec::len).sum();
        let mut flat = parts.iter().flatten().copied();
        let path = self.path;
        let points = if kind == "MultiLineString" {
            let mut points = 0;
            let each = |i: usize, part: &RawValue| {
                if !raw_json::is_list(part) {
                    return Err(self.bad(place, &format!("\"coordinates\" {i}"), "a list of points", part));
                }
                let mut own = parts.get(i).into_iter().flatten().copied();
                points += self.part(part, place, if is_nested { &mut own } else { &mut flat })?;
                Ok(())
            };
            raw_json::each(list.get(), each).map_err(|source| PathError::Json { path: path.to_owned(), source })??;
            points
        } else {
            self.part(list, place, &mut flat)?
        };
        if given > 0 && given != points {
            self.warnings.push(format!(
                "{place}: the line has {given} times for {points} points: points without one are flown between their \
                 neighbours, times without a point are left out"
            ));
        }
        Ok(())
    }

    /// One line; the number of its points.
    fn part(
        &mut self,
        list: &RawValue,
        place: &str,
        stamps: &mut dyn Iterator<Item = Stamp>,
    ) -> Result<usize, PathError> {
        let mut segment = Segment::default();
        let path = self.path;
        let each = |i: usize, point: &RawValue| {
            let stamp = stamps.next().unwrap_or(Stamp::Missing);
            segment.points.push(self.recorded(point, place, stamp, || format!("\"coordinates\" {i}"))?);
            Ok(())
        };
        raw_json::each(list.get(), each).map_err(|source| PathError::Json { path: path.to_owned(), source })??;
        let count = segment.points.len();
        self.shapes.lines.push(segment);
        Ok(count)
    }

    /// The times of a line's points, where the feature has a list of them.
    fn times(&self, properties: &RawValue) -> Result<Option<Times>, PathError> {
        let json = |source| PathError::Json { path: self.path.to_owned(), source };
        let own = fields(properties.get(), &TIME_LISTS).unwrap_or_default();
        let nested = fields(properties.get(), &["coordinateProperties"]).ok().and_then(|found| found[0]);
        let nested = nested.and_then(|raw| fields(raw.get(), &["times"]).ok()?[0]);
        let Some(list) = own.into_iter().chain([nested]).flatten().find(|raw| raw_json::is_list(raw)) else {
            return Ok(None);
        };
        let mut times = Times { parts: Vec::new(), is_nested: false };
        let mut flat = Vec::new();
        let each = |_, entry: &RawValue| {
            if raw_json::is_list(entry) {
                let mut part = Vec::new();
                let keep = |_, time: &RawValue| {
                    part.push(stamp(time));
                    Ok(())
                };
                raw_json::each(entry.get(), keep)??;
                times.parts.push(part);
            } else {
                flat.push(stamp(entry));
            }
            Ok::<(), serde_json::Error>(())
        };
        raw_json::each(list.get(), each).and_then(|outcome| outcome).map_err(json)?;
        times.is_nested = !times.parts.is_empty();
        if !times.is_nested {
            times.parts.push(flat);
        }
        Ok(Some(times))
    }

    fn recorded(
        &mut self,
        point: &RawValue,
        place: &str,
        stamp: Stamp,
        key: impl Fn() -> String,
    ) -> Result<Recorded, PathError> {
        const DEGREES: &str = "[longitude, latitude] or [longitude, latitude, height], in degrees and metres";
        const METRES: &str = "[x, y] or [x, y, height], in metres";
        if self.shapes.count >= MAX_POINTS {
            return Err(self.bad(place, &key(), "at most 1000000 points in a file", point));
        }
        let wrong = || self.bad(place, &key(), if self.is_lonlat { DEGREES } else { METRES }, point);
        let mut numbers = [None; 3];
        let each = |i: usize, raw: &RawValue| {
            // What follows the height is of no meaning here.
            if let Some(slot) = numbers.get_mut(i) {
                *slot = if raw.get() == "null" { None } else { Some(number(raw).ok_or(())?) };
            }
            Ok::<(), ()>(())
        };
        if !raw_json::is_list(point) || !matches!(raw_json::each(point.get(), each), Ok(Ok(()))) {
            return Err(wrong());
        }
        let [Some(x), Some(y), height_m] = numbers else { return Err(wrong()) };
        let most = if self.is_lonlat { [360.0, 90.0] } else { [1e11; 2] };
        if x.abs() > most[0] || y.abs() > most[1] || height_m.is_some_and(|height| height.abs() > 1e9) {
            return Err(wrong());
        }
        let x = if self.is_lonlat { wrapped(x) } else { x };
        let found = self.transform.as_ref().map_or(Ok(glam::DVec2::new(x, y)), |transform| transform.position(x, y));
        let found = found.map_err(|source| PathError::Crs {
            path: self.path.to_owned(),
            place: format!("{place}: {}", key()),
            source: Box::new(source),
        })?;
        let at = At::Point(u32::try_from(self.shapes.count).unwrap_or(u32::MAX));
        self.shapes.count += 1;
        self.shapes.has_heights |= height_m.is_some();
        Ok(Recorded { stamp, place: found, height_m, at })
    }
}

/// The time of a point: a text, or a number of seconds or milliseconds since 1970.
fn stamp(raw: &RawValue) -> Stamp {
    if let Some(number) = number(raw) {
        return Stamp::At(if number.abs() >= FIRST_MILLISECONDS { number / 1000.0 } else { number });
    }
    match raw_json::text(raw) {
        None if raw.get() == "null" => Stamp::Missing,
        None => Stamp::Unreadable,
        Some(text) if text.is_empty() => Stamp::Missing,
        // GDAL writes 2019/12/15 19:34:34+00 where it does not know better.
        Some(text) => seconds_from_iso8601(&text.replace('/', "-")).map_or(Stamp::Unreadable, Stamp::At),
    }
}

#[cfg(test)]
mod tests;
