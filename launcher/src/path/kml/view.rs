//! Views: `Camera` and `LookAt`. Values outside of what KML allows are taken as Google Earth takes
//! them: angles wrap, tilt ends at its bounds.

use super::super::crs::Transform;
use super::super::gpx::wrapped;
use super::super::xml::Node;
use super::super::{Ground, PathError, PathSettings, Pose, Remarks};
use super::bad;
use glam::DVec3;
use std::f64::consts::FRAC_PI_2;
use std::path::Path;

/// Fields of view that can be drawn, degrees.
const FIELDS_DEG: [f64; 2] = [1.0, 170.0];
/// What is out of range by less is a rounding error and not worth a word.
const ROUNDING: f64 = 1e-3;

/// Reads views, and remembers what is to be said about them.
pub(super) struct ViewReader<'a> {
    path: &'a Path,
    lonlat: &'a Transform,
    ground: &'a dyn Ground,
    /// The first view's field of view, when there was a view.
    field: Option<Field>,
    /// Views with another one.
    other_fields: usize,
    /// Values that were brought into their range, or replaced by their default; the line of the
    /// first.
    mended: usize,
    first_mended: u32,
}

/// A field of view, degrees.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Field {
    Unknown,
    Horizontal(f64),
    Vertical(f64),
}

impl<'a> ViewReader<'a> {
    pub(super) fn new(path: &'a Path, lonlat: &'a Transform, ground: &'a dyn Ground) -> Self {
        Self { path, lonlat, ground, field: None, other_fields: 0, mended: 0, first_mended: 0 }
    }

    /// The number in a child element; `absent` where there is no such element, or it is empty.
    pub(super) fn number(
        &self,
        node: Node<'_>,
        key: &str,
        expected: &'static str,
        absent: Option<f64>,
    ) -> Result<f64, PathError> {
        let child = node.child(key);
        let Some(value) = child.filter(|value| !value.text().is_empty()) else {
            return absent.ok_or_else(|| bad(self.path, child.unwrap_or(node), key, expected, ""));
        };
        let number = value.text().parse().ok().filter(|v: &f64| v.abs() <= 1e9);
        number.ok_or_else(|| bad(self.path, value, key, expected, value.text()))
    }

    /// Seconds that a step of a tour takes.
    pub(super) fn duration(&mut self, step: Node<'_>) -> Result<f64, PathError> {
        let seconds = self.number(step, "duration", "a number of seconds, 0 or more", Some(0.0))?;
        Ok(self.within(step, seconds, 0.0, 1e9))
    }

    fn mend(&mut self, node: Node<'_>) {
        self.mended += 1;
        if self.mended == 1 {
            self.first_mended = node.line();
        }
    }

    fn within(&mut self, node: Node<'_>, value: f64, low: f64, high: f64) -> f64 {
        if value < low - ROUNDING || value > high + ROUNDING {
            self.mend(node);
        }
        value.clamp(low, high)
    }

    /// One of some words; the first of them where the element is missing.
    pub(super) fn word(&mut self, node: Node<'_>, key: &str, words: &[&'static str]) -> &'static str {
        let found = node.child(key).map_or("", Node::text);
        let known = words.iter().find(|word| **word == found);
        if known.is_none() && !found.is_empty() {
            self.mend(node);
        }
        known.or(words.first()).copied().unwrap_or_default()
    }

    /// The pose of a Camera or a LookAt.
    pub(super) fn pose(&mut self, view: Node<'_>) -> Result<Pose, PathError> {
        let is_camera = view.name() == "Camera";
        let longitude = wrapped(self.number(view, "longitude", "degrees from -180 to 180", None)?);
        let latitude = self.number(view, "latitude", "degrees from -90 to 90", None)?;
        if latitude.abs() > 90.0 {
            let found = view.child("latitude").unwrap_or(view);
            return Err(bad(self.path, found, "latitude", "degrees from -90 to 90", found.text()));
        }
        let altitude = self.number(view, "altitude", "metres", Some(0.0))?;
        let heading = self.number(view, "heading", "degrees", Some(0.0))?.to_radians();
        let tilt = self.number(view, "tilt", "degrees", Some(0.0))?;
        let tilt = self.within(view, tilt, 0.0, if is_camera { 180.0 } else { 90.0 }).to_radians();
        let roll = wrapped(self.number(view, "roll", "degrees", Some(0.0))?).to_radians();
        self.note_field(view)?;
        let at = |source| super::super::PathError::Crs {
            path: self.path.to_owned(),
            place: format!("line {}", view.line()),
            source: Box::new(source),
        };
        let place = self.lonlat.position(longitude, latitude).map_err(at)?;
        let heading_rad = self.lonlat.heading(longitude, latitude, heading).map_err(at)?;

        // A camera clamped to the ground would see nothing: KML places it relative to the ground
        // then, and that is also its default. A point that is looked at is clamped to the ground by
        // default.
        let modes = ["clampToGround", "clampToSeaFloor", "relativeToGround", "relativeToSeaFloor", "absolute"];
        let height = match (self.word(view, "altitudeMode", &modes), is_camera) {
            ("absolute", _) => altitude,
            (mode, false) if mode.starts_with("clamp") => self.ground.height_m(place.x, place.y).unwrap_or(0.0),
            // Outside the terrain there is no ground: altitude is then above the datum.
            _ => self.ground.height_m(place.x, place.y).unwrap_or(0.0) + altitude,
        };
        let target = place.extend(height);
        let pitch_rad = tilt - FRAC_PI_2;
        if is_camera {
            return Ok(Pose { position: target, heading_rad, pitch_rad, roll_rad: roll });
        }
        let range = self.number(view, "range", "metres, 0 or more", Some(0.0))?;
        let range = self.within(view, range, 0.0, 1e9);
        let (sin, cos) = heading_rad.sin_cos();
        let back = DVec3::new(-sin * tilt.sin(), -cos * tilt.sin(), tilt.cos());
        Ok(Pose { position: target + back * range, heading_rad, pitch_rad, roll_rad: 0.0 })
    }

    fn note_field(&mut self, view: Node<'_>) -> Result<(), PathError> {
        const FIELD: &str = "degrees of a field of view";
        let [low, high] = FIELDS_DEG;
        let horizontal = self.number(view, "horizFov", FIELD, Some(0.0))?;
        let vertical = self.number(view, "fovy", FIELD, Some(0.0))?;
        let field = if horizontal != 0.0 {
            Field::Horizontal(self.within(view, horizontal, low, high))
        } else if vertical != 0.0 {
            Field::Vertical(self.within(view, vertical, low, high))
        } else {
            Field::Unknown
        };
        if *self.field.get_or_insert(field) != field {
            self.other_fields += 1;
        }
        Ok(())
    }

    /// What the views say about the picture; what is to be said about them goes into `remarks`.
    pub(super) fn finish(self, remarks: &mut Remarks) -> PathSettings {
        if self.mended > 0 {
            remarks.warnings.push(format!(
                "{} values outside of what KML allows (the first in line {}) were taken as Google Earth takes them: clamped, \
                 or replaced by their default",
                self.mended, self.first_mended
            ));
        }
        if self.other_fields > 0 {
            remarks.warnings.push(format!(
                "{} views have another field of view than the first: all are flown with that of the first",
                self.other_fields
            ));
        }
        match self.field {
            Some(Field::Horizontal(deg)) => {
                PathSettings { hfov_rad: Some(deg.to_radians()), ..PathSettings::default() }
            }
            Some(Field::Vertical(deg)) => PathSettings { vfov_rad: Some(deg.to_radians()), ..PathSettings::default() },
            _ => PathSettings::default(),
        }
    }
}
