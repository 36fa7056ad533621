//! CZML (the language of Cesium, <https://github.com/AnalyticalGraphicsInc/czml-writer/wiki>): the
//! first object of a document that moves, or else one that stands still and has an orientation.
//!
//! Read are `position`, `orientation`, `availability` and the clock's `multiplier`. With an
//! orientation the camera looks along the body's x axis with its z axis up, as Cesium orients its
//! models; without one it looks ahead along its way ([`super::track`]).

mod flight;
mod objects;
mod samples;
mod time;
mod vehicles;

pub(super) use vehicles::read as read_vehicles;

use super::crs::Georeference;
use super::ecef::{Ellipsoid, Geodetic};
use super::gpx::wrapped;
use super::raw_json::{self, fields, number};
use super::{CameraPath, CourseOptions, Ground, PathError, Remarks, printable};
use flight::Place;
use glam::{DQuat, DVec3};
use objects::{Object, Objects};
use samples::{Extent, Piece, Property, PropertyReader, in_order};
use serde_json::value::RawValue;
use std::path::Path;

const POSITION: Property = Property {
    name: "position",
    forms: &[("cartographicDegrees", 3), ("cartographicRadians", 3), ("cartesian", 3), ("cartesianVelocity", 6)],
};
const ORIENTATION: Property = Property { name: "orientation", forms: &[("unitQuaternion", 4)] };

/// Reads a document.
///
/// # Errors
/// [`PathError`] with the packet in it.
pub(super) fn parse(
    path: &Path,
    text: &str,
    world: &Georeference,
    ground: &dyn Ground,
    options: CourseOptions,
    remarks: &mut Remarks,
) -> Result<CameraPath, PathError> {
    let objects = Objects::read(path, text)?;
    let flown = objects.flown(path)?;
    objects.note(flown, &mut remarks.notes);
    let lonlat = world.from_lonlat();
    let lonlat = lonlat.map_err(|source| PathError::Crs {
        path: path.to_owned(),
        place: "the document".into(),
        source: Box::new(source),
    })?;
    let ellipsoid = world.lonlat_ellipsoid();
    let positions = positions(path, flown, &ellipsoid)?;
    let orientations = orientations(path, flown)?;
    let availability = availability(path, flown)?;
    let placed = |place: Geodetic| -> Result<Place, PathError> {
        let position = lonlat.position(place.longitude_deg, place.latitude_deg);
        let position = position.map_err(|source| PathError::Crs {
            path: path.to_owned(),
            place: flown.place(),
            source: Box::new(source),
        })?;
        Ok(Place { geodetic: place, position: position.extend(place.height_m) })
    };
    let positions: Vec<Piece<Place>> = positions
        .into_iter()
        .map(|piece| {
            let values = piece.values.into_iter().map(placed).collect::<Result<_, _>>()?;
            Ok(Piece { interval: piece.interval, times: piece.times, values, polynomial: piece.polynomial })
        })
        .collect::<Result<_, PathError>>()?;
    let parts = flight::parts(&positions, &availability);
    if parts.is_empty() {
        return Err(PathError::BadValue {
            path: path.to_owned(),
            place: flown.place(),
            key: "position".into(),
            expected: "samples within its intervals and within its availability",
            found: "none".into(),
        });
    }
    if options.agl_m.is_none() {
        remarks.notes.push(super::ELLIPSOIDAL.into());
    }
    if orientations.is_empty() {
        return flight::ahead(path, &parts, ground, options, remarks);
    }
    if options.agl_m.is_some() {
        return Err(PathError::HasHeights { path: path.to_owned(), kind: "a packet of CZML with an orientation" });
    }
    flight::oriented(path, &flown.place(), &parts, &orientations, &lonlat, remarks)
}

fn reader<'a>(path: &'a Path, object: &Object<'_>, property: &'a Property) -> PropertyReader<'a> {
    PropertyReader { path, place: object.place(), property, count: 0 }
}

fn positions(path: &Path, object: &Object<'_>, ellipsoid: &Ellipsoid) -> Result<Vec<Piece<Geodetic>>, PathError> {
    let read = |form: &str, numbers: &[f64]| {
        let &[x, y, z, ..] = numbers else { return Err("3 numbers") };
        let (expected, place) = match form {
            "cartographicDegrees" => (
                "[longitude from -180 to 180, latitude from -90 to 90, height in metres]",
                Some(Geodetic { longitude_deg: x, latitude_deg: y, height_m: z }),
            ),
            "cartographicRadians" => (
                "[longitude from -π to π, latitude from -π/2 to π/2, height in metres]",
                Some(Geodetic { longitude_deg: x.to_degrees(), latitude_deg: y.to_degrees(), height_m: z }),
            ),
            _ => (
                "[x, y, z] in metres from the middle of the Earth, near its surface or above it",
                ellipsoid.geodetic_from_ecef(DVec3::new(x, y, z)),
            ),
        };
        let is_valid = |place: &Geodetic| {
            // A right angle in radians may be rounded up.
            let limits = [(place.longitude_deg, 360.0), (place.latitude_deg, 90.0 + 1e-9), (place.height_m, 1e9)];
            limits.iter().all(|(value, limit)| value.abs() <= *limit)
        };
        let place = place.filter(is_valid).ok_or(expected)?;
        let (longitude_deg, latitude_deg) = (wrapped(place.longitude_deg), place.latitude_deg.clamp(-90.0, 90.0));
        Ok(Geodetic { longitude_deg, latitude_deg, ..place })
    };
    let mut reader = reader(path, object, &POSITION);
    let mut pieces = Vec::new();
    for raw in &object.positions {
        if objects::is_inertial(raw) {
            let expected = "FIXED (an inertial frame turns against the ground; export the positions in the fixed one)";
            return Err(reader.bad("referenceFrame", expected, "\"INERTIAL\"".into()));
        }
        pieces.extend(reader.pieces(raw, &read)?);
    }
    Ok(in_order(pieces))
}

/// Rotations from the body's axes to Earth-fixed ones.
fn orientations(path: &Path, object: &Object<'_>) -> Result<Vec<Piece<DQuat>>, PathError> {
    let read = |_: &str, numbers: &[f64]| {
        let expected = "a quaternion [x, y, z, w] of length 1";
        let turn = numbers.try_into().map(DQuat::from_array).map_err(|_other_count| expected)?;
        // Programs round: what is not quite of length 1 is meant so.
        if (0.5..2.0).contains(&turn.length()) { Ok(turn.normalize()) } else { Err(expected) }
    };
    let mut reader = reader(path, object, &ORIENTATION);
    let mut pieces = Vec::new();
    for raw in &object.orientations {
        pieces.extend(reader.pieces(raw, &read)?);
    }
    Ok(in_order(pieces))
}

/// The spans of time in which the object is there, in order; all the time if it does not say.
fn availability(path: &Path, object: &Object<'_>) -> Result<Vec<[f64; 2]>, PathError> {
    let Some(raw) = object.availability else { return Ok(vec![[f64::NEG_INFINITY, f64::INFINITY]]) };
    let mut spans = Vec::new();
    let mut each = |_, raw: &RawValue| {
        let span = raw_json::text(raw).and_then(|text| time::interval(&text));
        let span = span.ok_or_else(|| PathError::BadValue {
            path: path.to_owned(),
            place: object.place(),
            key: "availability".into(),
            expected: "an interval like 2024-05-01T10:00:00Z/2024-05-01T11:00:00Z, or a list of them",
            found: printable(raw.get()),
        })?;
        spans.push(span);
        Ok(())
    };
    if raw_json::is_list(raw) {
        raw_json::each(raw.get(), each).map_err(|source| PathError::Json { path: path.to_owned(), source })??;
    } else {
        each(0, raw)?;
    }
    spans.sort_by(|a, b| a[0].total_cmp(&b[0]));
    Ok(spans)
}

#[cfg(test)]
mod tests;
