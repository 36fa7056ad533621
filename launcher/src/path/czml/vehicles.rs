//! The vehicles of a document: its packets with a position.

use super::super::crs::Georeference;
use super::super::vehicles::{Appearance, HeightReference, Moment, Vehicle, Way};
use super::super::{PathError, Remarks, printable};
use super::flight::{self, Place, between, curve, local_turn, moments};
use super::objects::{Object, Objects};
use super::samples::Piece;
use super::{Geodetic, availability, fields, number, orientations, positions, raw_json};
use glam::DQuat;
use serde_json::value::RawValue;
use std::path::Path;
use terravision_common::vehicle::MOST_VEHICLES;

/// What packets are drawn as that a height reference is looked for in.
const WITH_HEIGHTS: [&str; 4] = ["model", "point", "billboard", "label"];

/// Reads the vehicles of a document.
///
/// # Errors
/// [`PathError`] with the packet in it.
pub(in super::super) fn read(
    path: &Path,
    text: &str,
    world: &Georeference,
    remarks: &mut Remarks,
) -> Result<Vec<Vehicle>, PathError> {
    let objects = Objects::read(path, text)?;
    let placed: Vec<&Object<'_>> = objects.all().iter().filter(|object| object.is_placed()).collect();
    let without = objects.all().len() - placed.len();
    if placed.is_empty() {
        return Err(PathError::NoVehicles {
            path: path.to_owned(),
            found: "CZML without a packet that has one".into(),
        });
    }
    if placed.len() > MOST_VEHICLES {
        let found = format!("CZML with {} packets that have one, of at most {MOST_VEHICLES}", placed.len());
        return Err(PathError::NoVehicles { path: path.to_owned(), found });
    }
    if without > 0 {
        let file = path.display();
        remarks.notes.push(format!("{file}: {without} packets have no position over the ground and are not drawn"));
    }
    placed.into_iter().map(|object| vehicle(path, object, world)).collect()
}

fn vehicle(path: &Path, object: &Object<'_>, world: &Georeference) -> Result<Vehicle, PathError> {
    let at_place = |source| PathError::Crs { path: path.to_owned(), place: object.place(), source: Box::new(source) };
    let lonlat = world.from_lonlat().map_err(at_place)?;
    let placed = |place: Geodetic| -> Result<Place, PathError> {
        let position = lonlat.position(place.longitude_deg, place.latitude_deg).map_err(at_place)?;
        Ok(Place { geodetic: place, position: position.extend(place.height_m) })
    };
    let mut known: Vec<Piece<Place>> = Vec::new();
    for Piece { interval, times, values, polynomial } in positions(path, object, &world.lonlat_ellipsoid())? {
        let values = values.into_iter().map(placed).collect::<Result<_, _>>()?;
        known.push(Piece { interval, times, values, polynomial });
    }
    let turns = orientations(path, object)?;
    let mut ways = Vec::new();
    for part in flight::parts(&known, &availability(path, object)?) {
        let is_always = part.times.is_empty();
        let mut found = Vec::new();
        for t in moments(&part, &turns) {
            let Some(there) = part.value(t, between) else { continue };
            let Geodetic { longitude_deg, latitude_deg, .. } = there.geodetic;
            let attitude = if turns.is_empty() {
                None
            } else {
                // From true north to the grid's.
                let north = lonlat.heading(longitude_deg, latitude_deg, 0.0).map_err(at_place)?;
                let (turn, _) = local_turn(there.geodetic, t, &turns);
                Some((DQuat::from_rotation_z(-north) * turn).normalize())
            };
            found.push(Moment { t, position: there.position, attitude });
        }
        let curve = part.polynomial.as_ref().filter(|_| !is_always).and_then(|_| curve(&part));
        ways.extend(Way::new(found, curve, is_always));
    }
    if ways.is_empty() {
        return Err(PathError::BadValue {
            path: path.to_owned(),
            place: object.place(),
            key: "position".into(),
            expected: "samples within its intervals and within its availability",
            found: "none".into(),
        });
    }
    let look = Look { path, object };
    Ok(Vehicle { place: object.place(), ways, height: look.height()?, appearance: look.appearance()? })
}

/// What an object is drawn as.
struct Look<'a> {
    path: &'a Path,
    object: &'a Object<'a>,
}

impl Look<'_> {
    fn bad(&self, key: &str, expected: &'static str, found: &RawValue) -> PathError {
        PathError::BadValue {
            path: self.path.to_owned(),
            place: self.object.place(),
            key: key.into(),
            expected,
            found: printable(found.get()),
        }
    }

    /// A value of what it is drawn as.
    fn value(&self, drawn: &str, key: &str) -> Option<&RawValue> {
        fields(self.object.drawn_as(drawn)?.get(), &[key]).ok()?[0]
    }

    fn height(&self) -> Result<HeightReference, PathError> {
        const EXPECTED: &str = "NONE, CLAMP_TO_GROUND or RELATIVE_TO_GROUND";
        let mut found = WITH_HEIGHTS.iter().filter_map(|drawn| self.value(drawn, "heightReference"));
        let Some(raw) = found.next() else { return Ok(HeightReference::Datum) };
        let inner = fields(raw.get(), &["heightReference"]).ok().and_then(|found| found[0]);
        let text = raw_json::text(inner.unwrap_or(raw));
        match text.as_deref() {
            Some("NONE") => Ok(HeightReference::Datum),
            Some("CLAMP_TO_GROUND" | "CLAMP_TO_TERRAIN") => Ok(HeightReference::OnGround),
            Some("RELATIVE_TO_GROUND" | "RELATIVE_TO_TERRAIN") => Ok(HeightReference::AboveGround),
            _ => Err(self.bad("heightReference", EXPECTED, raw)),
        }
    }

    /// A number, by itself or as an object's.
    fn number(&self, drawn: &str, key: &str) -> Result<Option<f64>, PathError> {
        let Some(raw) = self.value(drawn, key) else { return Ok(None) };
        let inner = fields(raw.get(), &["number"]).ok().and_then(|found| found[0]);
        let found = number(inner.unwrap_or(raw)).filter(|number| (1e-6..=1e6).contains(number));
        found.map(Some).ok_or_else(|| self.bad(&format!("{drawn}: {key}"), "a number from 0.000001 to 1000000", raw))
    }

    fn appearance(&self) -> Result<Appearance, PathError> {
        Ok(Appearance {
            model: self.value("model", "gltf").map(|raw| self.model(raw)).transpose()?,
            scale: self.number("model", "scale")?,
            point_px: self.number("point", "pixelSize")?,
            rgb: self.value("point", "color").map(|raw| self.color(raw)).transpose()?,
        })
    }

    fn model(&self, raw: &RawValue) -> Result<std::path::PathBuf, PathError> {
        let inner = fields(raw.get(), &["uri"]).ok().and_then(|found| found[0]);
        let name = raw_json::text(inner.unwrap_or(raw));
        let name = name.filter(|name| !name.is_empty() && !name.contains("://") && !name.starts_with("data:"));
        let expected = "the name of a glTF file beside this one";
        let name = name.ok_or_else(|| self.bad("model: gltf", expected, raw))?;
        Ok(self.path.parent().unwrap_or(Path::new("")).join(name))
    }

    fn color(&self, raw: &RawValue) -> Result<[u8; 3], PathError> {
        let [whole, share] = fields(raw.get(), &["rgba", "rgbaf"]).unwrap_or_default();
        let list = |raw: &RawValue| serde_json::from_str::<Vec<f64>>(raw.get()).ok().filter(|list| list.len() == 4);
        let found = whole.and_then(list).or_else(|| Some(share.and_then(list)?.iter().map(|v| v * 255.0).collect()));
        let found = found.filter(|list| list.iter().all(|v| (0.0..=255.0).contains(v)));
        let expected = "{\"rgba\": [red, green, blue, alpha]}, numbers from 0 to 255";
        let found = found.ok_or_else(|| self.bad("point: color", expected, raw))?;
        Ok([0, 1, 2].map(|channel| found[channel].round() as u8))
    }
}
