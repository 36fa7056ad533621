//! Camera paths in JSON: one pose per frame (`"frames"`), or poses at moments (`"keyframes"`).
//!
//! Numbers are read one by one, so that a wrong one is named by its frame and key. Unknown keys are
//! ignored, and cost no memory: of a file there is the text, and what is flown of it.

use super::crs::{CrsError, Georeference, Transform};
use super::raw_json::{self, fields, number};
use super::spline::{self, Spline};
use super::{CameraPath, Course, MAX_FRAMES, PathError, PathSettings, Pose, printable};
use glam::DVec3;
use serde_json::value::RawValue;
use std::path::Path;
use terravision_common::camera::MAX_SIDE_PX;

/// Most keyframes that are read.
const MAX_KEYFRAMES: usize = 1_000_000;

/// Keyframes are at least so far apart, seconds, and not farther from 0 than that: the speeds
/// between them are finite.
const SHORTEST_STEP: f64 = 1e-6;
const MAX_TIME: f64 = 1e10;

/// The keys that are read.
const KEYS: [&str; 18] = [
    "x",
    "y",
    "z",
    "heading",
    "pitch",
    "roll",
    "t",
    "rest",
    "target",
    "width",
    "height",
    "vfov_deg",
    "fps",
    "sky_rgb",
    "crs",
    "frames",
    "keyframes",
    "type",
];

/// An object: of each key that is read its value, as it is written.
#[derive(Default)]
struct Object<'a> {
    values: [Option<&'a RawValue>; KEYS.len()],
}

impl<'a> Object<'a> {
    fn parse(text: &'a str) -> Result<Self, serde_json::Error> {
        Ok(Self { values: fields(text, &KEYS)? })
    }

    fn get(&self, key: &str) -> Option<&'a RawValue> {
        self.values[KEYS.iter().position(|known| *known == key)?]
    }
}

/// Reads a path.
///
/// # Errors
/// [`PathError`] with the frame and the key in it.
pub fn parse(path: &Path, text: &str, world: &Georeference) -> Result<CameraPath, PathError> {
    let file: Object<'_> = Object::parse(text).map_err(|source| PathError::Json { path: path.to_owned(), source })?;
    let reader = Reader { path, place: "the path".into(), object: &file };
    let settings = PathSettings {
        width: reader.optional("width", "a whole number of pixels from 1 to 65536", pixels)?,
        height: reader.optional("height", "a whole number of pixels from 1 to 65536", pixels)?,
        vfov_rad: reader
            .optional("vfov_deg", "degrees between 1 and 170", |raw| number(raw).filter(|v| (1.0..=170.0).contains(v)))?
            .map(f64::to_radians),
        hfov_rad: None,
        fps: reader.optional("fps", "frames per second, more than 0 and at most 1000", |raw| {
            number(raw).filter(|v| *v > 0.0 && *v <= 1000.0)
        })?,
        sky_rgb: reader.optional("sky_rgb", "three whole numbers from 0 to 255", |raw| {
            serde_json::from_str::<[u8; 3]>(raw.get()).ok()
        })?,
    };
    let crs =
        reader.optional("crs", "a text like \"EPSG:32610\"", |raw| serde_json::from_str::<String>(raw.get()).ok())?;
    let crs_error = |place: &str, source: CrsError| PathError::Crs {
        path: path.to_owned(),
        place: place.into(),
        source: Box::new(source),
    };
    let transform = match crs {
        Some(crs) => world.from_crs(&crs).map_err(|source| crs_error("\"crs\"", source))?,
        None => None,
    };
    let (frames, keyframes) = (reader.list("frames")?, reader.list("keyframes")?);
    let reads = Poses { path, transform: transform.as_ref() };
    const EXPECTED: &str = "\"frames\" or \"keyframes\", a list with at least one pose";
    let empty = |found: &str| PathError::Empty { path: path.to_owned(), expected: EXPECTED, found: found.into() };
    let course = match (frames, keyframes) {
        (Some(_), Some(_)) => {
            return Err(reader.bad("\"frames\"", "either \"frames\" or \"keyframes\"", "both".into()));
        }
        (Some(list), None) => Course::Frames(reads.frames(&reader, list)?),
        (None, Some(list)) => {
            let spline = Spline::new(&reads.keyframes(&reader, list)?);
            let target = reads.target(&reader)?;
            Course::Timed(spline.map(|spline| spline.looking_at(target)).into_iter().collect())
        }
        (None, None) if file.get("type").is_some() => {
            let kind = file.get("type").map_or("", RawValue::get);
            return Err(empty(&format!("an object of type {}, which is not of GeoJSON", printable(kind))));
        }
        (None, None) => return Err(empty("neither")),
    };
    let is_empty = match &course {
        Course::Frames(poses) | Course::Round(poses) => poses.is_empty(),
        Course::Timed(pieces) => pieces.is_empty(),
    };
    if is_empty { Err(empty("an empty list")) } else { Ok(CameraPath { settings, course }) }
}

/// Reads lists of poses.
struct Poses<'p> {
    path: &'p Path,
    transform: Option<&'p Transform>,
}

impl Poses<'_> {
    fn frames(&self, file: &Reader<'_>, list: &RawValue) -> Result<Vec<Pose>, PathError> {
        let mut poses = Vec::new();
        self.each(list, |i, raw| {
            if i as u64 >= MAX_FRAMES {
                return Err(file.bad("\"frames\"", "a list of at most 2000000 frames", "more".into()));
            }
            poses.push(self.pose(raw, format!("frame {i}"), false)?.pose);
            Ok(())
        })?;
        Ok(poses)
    }

    fn keyframes(&self, file: &Reader<'_>, list: &RawValue) -> Result<Vec<spline::Key>, PathError> {
        let mut keys: Vec<spline::Key> = Vec::new();
        self.each(list, |i, raw| {
            if i >= MAX_KEYFRAMES {
                return Err(file.bad("\"keyframes\"", "a list of at most 1000000 keyframes", "more".into()));
            }
            let place = format!("keyframe {i}");
            let key = self.pose(raw, place.clone(), true)?;
            if let Some(last) = keys.last().filter(|last| key.t < last.t + SHORTEST_STEP) {
                let expected = "more seconds than the keyframe before, by 0.000001 at least";
                let found = format!("{} after {}", key.t, last.t);
                return Err(PathError::BadValue {
                    path: self.path.to_owned(),
                    place,
                    key: "\"t\"".into(),
                    expected,
                    found,
                });
            }
            keys.push(key);
            Ok(())
        })?;
        Ok(keys)
    }

    fn each(
        &self,
        list: &RawValue,
        each: impl FnMut(usize, &RawValue) -> Result<(), PathError>,
    ) -> Result<(), PathError> {
        // Its syntax was checked with the whole file's.
        raw_json::each(list.get(), each).map_err(|source| PathError::Json { path: self.path.to_owned(), source })?
    }

    /// What the camera looks at all the time, if that is said.
    fn target(&self, file: &Reader<'_>) -> Result<Option<DVec3>, PathError> {
        let expected = "a place to look at, three coordinates in metres like [560000, 4980000, 1200]";
        let place = file.optional("target", expected, |raw| {
            let place = serde_json::from_str::<[f64; 3]>(raw.get()).ok();
            place.filter(|place| place.iter().all(|value| value.abs() < 1e11)).map(DVec3::from)
        })?;
        let (Some(place), Some(transform)) = (place, self.transform) else { return Ok(place) };
        let moved = transform.position(place.x, place.y).map_err(|source| PathError::Crs {
            path: self.path.to_owned(),
            place: "\"target\"".into(),
            source: Box::new(source),
        })?;
        Ok(Some(moved.extend(place.z)))
    }

    fn pose(&self, raw: &RawValue, place: String, has_time: bool) -> Result<spline::Key, PathError> {
        let object: Object<'_> = match Object::parse(raw.get()) {
            Ok(object) => object,
            Err(_not_an_object) => {
                let reader = Reader { path: self.path, place, object: &Object::default() };
                return Err(reader.bad("the entry", "an object with x, y, z, heading and pitch", printable(raw.get())));
            }
        };
        let reader = Reader { path: self.path, place, object: &object };
        let pose = reader.pose(self.transform)?;
        let time = |raw: &RawValue| number(raw).filter(|t| t.abs() <= MAX_TIME);
        let t = if has_time { reader.required("t", "seconds from -10000000000 to 10000000000", time)? } else { 0.0 };
        let is_stop = reader.optional("rest", "true or false", |raw| serde_json::from_str(raw.get()).ok())?;
        Ok(spline::Key { is_stop: is_stop.unwrap_or(false), ..spline::Key::passing(t, pose) })
    }
}

fn pixels(raw: &RawValue) -> Option<u32> {
    // A whole number, also written as 1280.0, as some programs do.
    number(raw).filter(|v| v.fract() == 0.0 && (1.0..=f64::from(MAX_SIDE_PX)).contains(v)).map(|v| v as u32)
}

/// Reads the values of one object.
struct Reader<'a> {
    path: &'a Path,
    place: String,
    object: &'a Object<'a>,
}

impl<'a> Reader<'a> {
    fn bad(&self, key: &str, expected: &'static str, found: String) -> PathError {
        PathError::BadValue { path: self.path.to_owned(), place: self.place.clone(), key: key.into(), expected, found }
    }

    /// A value that may be absent; `null` counts as absent.
    fn optional<T>(
        &self,
        key: &str,
        expected: &'static str,
        read: impl Fn(&'a RawValue) -> Option<T>,
    ) -> Result<Option<T>, PathError> {
        match self.object.get(key) {
            None => Ok(None),
            Some(raw) if raw.get() == "null" => Ok(None),
            Some(raw) => match read(raw) {
                Some(value) => Ok(Some(value)),
                None => Err(self.bad(&format!("{key:?}"), expected, printable(raw.get()))),
            },
        }
    }

    /// The text of a list that may be absent.
    fn list(&self, key: &str) -> Result<Option<&'a RawValue>, PathError> {
        self.optional(key, "a list", |raw| raw.get().starts_with('[').then_some(raw))
    }

    fn required<T>(
        &self,
        key: &str,
        expected: &'static str,
        read: impl Fn(&'a RawValue) -> Option<T>,
    ) -> Result<T, PathError> {
        self.optional(key, expected, read)?.ok_or_else(|| self.bad(&format!("{key:?}"), expected, "nothing".into()))
    }

    fn pose(&self, transform: Option<&Transform>) -> Result<Pose, PathError> {
        const METRES: &str = "a coordinate in metres";
        let coordinate = |key| self.required(key, METRES, |raw| number(raw).filter(|v| v.abs() < 1e11));
        let (x, y, z) = (coordinate("x")?, coordinate("y")?, coordinate("z")?);
        let angle = |raw: &RawValue| number(raw).filter(|v| v.abs() <= 1e6);
        let heading = self.required("heading", "degrees clockwise from grid north", angle)?.to_radians();
        let pitch =
            self.required("pitch", "degrees from -90 to 90", |raw| number(raw).filter(|v| (-90.0..=90.0).contains(v)))?;
        let roll = self.optional("roll", "degrees", angle)?.unwrap_or(0.0);
        let (position, heading_rad) = match transform {
            None => (DVec3::new(x, y, z), heading),
            Some(transform) => {
                let at = |source| PathError::Crs {
                    path: self.path.to_owned(),
                    place: self.place.clone(),
                    source: Box::new(source),
                };
                (transform.position(x, y).map_err(at)?.extend(z), transform.heading(x, y, heading).map_err(at)?)
            }
        };
        Ok(Pose { position, heading_rad, pitch_rad: pitch.to_radians(), roll_rad: roll.to_radians() })
    }
}

#[cfg(test)]
mod tests;
