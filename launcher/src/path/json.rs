//! Camera paths in JSON: one pose per frame (`"frames"`), or poses at moments (`"keyframes"`).
//!
//! Numbers are read one by one, so that a wrong one is named by its frame and key. Unknown keys are
//! ignored, and cost no memory: of a file there is the text, and what is flown of it.

use super::crs::{CrsError, Georeference, Transform};
use super::spline::{self, Spline};
use super::{CameraPath, Course, MAX_FRAMES, PathError, PathSettings, Pose, printable};
use glam::DVec3;
use serde::de::{DeserializeSeed, Deserializer, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde_json::value::RawValue;
use std::fmt;
use std::path::Path;
use terravision_common::camera::MAX_SIDE_PX;

/// Most keyframes that are read.
const MAX_KEYFRAMES: usize = 1_000_000;

/// Keyframes are at least so far apart, seconds, and not farther from 0 than that: the speeds
/// between them are finite.
const SHORTEST_STEP: f64 = 1e-6;
const MAX_TIME: f64 = 1e10;

/// The keys that are read.
const KEYS: [&str; 16] = [
    "x",
    "y",
    "z",
    "heading",
    "pitch",
    "roll",
    "t",
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
    fn get(&self, key: &str) -> Option<&'a RawValue> {
        self.values[KEYS.iter().position(|known| *known == key)?]
    }
}

impl<'de> serde::Deserialize<'de> for Object<'de> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Values;
        impl<'de> Visitor<'de> for Values {
            type Value = Object<'de>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
                let mut object = Object::default();
                while let Some(Key(key)) = map.next_key()? {
                    match key {
                        Some(key) => object.values[key] = Some(map.next_value()?),
                        None => drop(map.next_value::<IgnoredAny>()?),
                    }
                }
                Ok(object)
            }
        }
        deserializer.deserialize_map(Values)
    }
}

/// The place of a key in [`KEYS`].
struct Key(Option<usize>);

impl<'de> serde::Deserialize<'de> for Key {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Name;
        impl Visitor<'_> for Name {
            type Value = Key;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a key")
            }

            fn visit_str<E>(self, name: &str) -> Result<Key, E> {
                Ok(Key(KEYS.iter().position(|known| *known == name)))
            }
        }
        deserializer.deserialize_str(Name)
    }
}

/// A list that is handed on entry by entry, however long it is; ends at the first error of `each`,
/// which is kept.
struct EachOf<'e, F, E> {
    each: F,
    error: &'e mut Option<E>,
}

impl<'de, E, F: FnMut(usize, &'de RawValue) -> Result<(), E>> DeserializeSeed<'de> for EachOf<'_, F, E> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de, E, F: FnMut(usize, &'de RawValue) -> Result<(), E>> Visitor<'de> for EachOf<'_, F, E> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list")
    }

    fn visit_seq<A: SeqAccess<'de>>(mut self, mut list: A) -> Result<(), A::Error> {
        let mut count = 0;
        while let Some(entry) = list.next_element::<&RawValue>()? {
            if let Err(error) = (self.each)(count, entry) {
                *self.error = Some(error);
                return Err(serde::de::Error::custom("an entry cannot be used"));
            }
            count += 1;
        }
        Ok(())
    }
}

/// Reads a path.
///
/// # Errors
/// [`PathError`] with the frame and the key in it.
pub fn parse(path: &Path, text: &str, world: &Georeference) -> Result<CameraPath, PathError> {
    let file: Object<'_> =
        serde_json::from_str(text).map_err(|source| PathError::Json { path: path.to_owned(), source })?;
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
        (None, Some(list)) => Course::Timed(Spline::new(&reads.keyframes(&reader, list)?).into_iter().collect()),
        (None, None) if file.get("type").is_some() => {
            return Err(empty("GeoJSON (it has a \"type\"); ogr2ogr -f GPX FILE.gpx FILE makes a GPX of its lines"));
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
            let (pose, _) = self.pose(raw, format!("frame {i}"), false)?;
            poses.push(pose);
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
            let (pose, t) = self.pose(raw, place.clone(), true)?;
            if let Some(last) = keys.last().filter(|last| t < last.t + SHORTEST_STEP) {
                let expected = "more seconds than the keyframe before, by 0.000001 at least";
                let found = format!("{t} after {}", last.t);
                return Err(PathError::BadValue {
                    path: self.path.to_owned(),
                    place,
                    key: "\"t\"".into(),
                    expected,
                    found,
                });
            }
            keys.push(spline::Key::passing(t, pose));
            Ok(())
        })?;
        Ok(keys)
    }

    fn each(
        &self,
        list: &RawValue,
        each: impl FnMut(usize, &RawValue) -> Result<(), PathError>,
    ) -> Result<(), PathError> {
        let mut text = serde_json::Deserializer::from_str(list.get());
        let mut error = None;
        let outcome = EachOf { each, error: &mut error }.deserialize(&mut text);
        match error {
            Some(error) => Err(error),
            // Its syntax was checked with the whole file's.
            None => outcome.map_err(|source| PathError::Json { path: self.path.to_owned(), source }),
        }
    }

    fn pose(&self, raw: &RawValue, place: String, has_time: bool) -> Result<(Pose, f64), PathError> {
        let object: Object<'_> = match serde_json::from_str(raw.get()) {
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
        Ok((pose, t))
    }
}

fn number(raw: &RawValue) -> Option<f64> {
    serde_json::from_str::<f64>(raw.get()).ok().filter(|v| v.is_finite())
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
mod tests {
    use super::super::tests::parse_text;
    use super::*;
    use proptest::prelude::*;

    const FRAME: &str = r#"{"x":500000,"y":4980000,"z":3000,"heading":90,"pitch":-10}"#;

    #[test]
    fn frames_are_read_and_unknown_keys_ignored() {
        let text = format!(
            r#"{{"crs":"EPSG:32610","width":640,"height":360.0,"vfov_deg":60,"fps":25,"sky_rgb":[1,2,3],"note":{{"a":[1]}},
               "frames":[{FRAME},{{"x":1,"y":2,"z":3,"heading":-10,"pitch":5,"roll":7,"label":"b"}}]}}"#
        );
        let path = parse_text(&text).unwrap();
        assert_eq!(path.settings.width, Some(640));
        assert_eq!(path.settings.height, Some(360));
        assert_eq!(path.settings.sky_rgb, Some([1, 2, 3]));
        let Course::Frames(poses) = &path.course else { panic!("not frames") };
        assert_eq!(poses[0].position, DVec3::new(500_000.0, 4_980_000.0, 3000.0));
        assert!((poses[1].roll_rad - 7f64.to_radians()).abs() < 1e-12 && poses[0].roll_rad == 0.0);
        assert_eq!(path.course.frame_count(25.0, 1.0).unwrap(), Some(2));
    }

    #[test]
    fn keyframes_become_frames_at_any_rate() {
        let text = r#"{"keyframes":[{"t":1,"x":0,"y":0,"z":0,"heading":0,"pitch":0},
                                    {"t":3,"x":100,"y":0,"z":0,"heading":0,"pitch":0}]}"#;
        let course = parse_text(text).unwrap().course;
        assert_eq!(course.frame_count(30.0, 1.0).unwrap(), Some(61));
        assert_eq!(course.frame_count(30.0, 2.0).unwrap(), Some(31));
        let middle = course.pose(30, 30.0, 1.0).unwrap();
        assert!((middle.position.x - 50.0).abs() < 1e-9);
        assert!(course.frame_count(1e9, 1.0).unwrap_err().to_string().contains("at most 2000000"));
    }

    #[test]
    fn a_bad_value_is_named_by_file_frame_and_key() {
        for (text, expected) in [
            (
                r#"{"frames":[{"x":1,"y":2,"z":3,"heading":0,"pitch":"down"}]}"#,
                r#"p: frame 0: "pitch": expected degrees from -90 to 90, found "down""#,
            ),
            (
                r#"{"frames":[{"x":1,"y":2,"heading":0,"pitch":0}]}"#,
                r#"p: frame 0: "z": expected a coordinate in metres, found nothing"#,
            ),
            (r#"{"frames":[{"x":1,"y":2,"z":3,"heading":0,"pitch":91}]}"#, "found 91"),
            (r#"{"frames":[{"x":1e999,"y":2,"z":3,"heading":0,"pitch":0}]}"#, "found 1e999"),
            (r#"{"frames":[7]}"#, "frame 0: the entry: expected an object"),
            (r#"{"frames":{}}"#, r#""frames": expected a list, found {}"#),
            (r#"{"frames":[]}"#, "nothing to fly"),
            (r#"{}"#, "nothing to fly"),
            (r#"{"frames":[],"keyframes":[]}"#, "found both"),
            (r#"{"width":0,"frames":[]}"#, r#""width": expected a whole number of pixels from 1 to 65536, found 0"#),
            (r#"{"fps":-1,"frames":[]}"#, "frames per second"),
            (r#"{"sky_rgb":[1,2,256],"frames":[]}"#, "from 0 to 255"),
            (r#"{"crs":7,"frames":[]}"#, "EPSG:32610"),
            (r#"{"crs":"moon","frames":[]}"#, "not known here"),
            (
                r#"{"keyframes":[{"x":1,"y":2,"z":3,"heading":0,"pitch":0}]}"#,
                r#"keyframe 0: "t": expected seconds from -10000000000 to 10000000000, found nothing"#,
            ),
            (
                r#"{"keyframes":[{"t":1,"x":1,"y":2,"z":3,"heading":0,"pitch":0},{"t":1,"x":1,"y":2,"z":3,"heading":0,"pitch":0}]}"#,
                "keyframe 1",
            ),
            (
                r#"{"keyframes":[{"t":1e300,"x":1,"y":2,"z":3,"heading":0,"pitch":0}]}"#,
                "\"t\": expected seconds from -10000000000 to 10000000000, found 1e300",
            ),
            (
                r#"{"keyframes":[{"t":0,"x":1,"y":2,"z":3,"heading":0,"pitch":0},{"t":1e-320,"x":9,"y":2,"z":3,"heading":0,"pitch":0}]}"#,
                "by 0.000001 at least",
            ),
            (r#"{"type":"FeatureCollection","features":[]}"#, "found GeoJSON"),
        ] {
            let message = parse_text(text).unwrap_err().to_string();
            assert!(message.contains(expected), "{text}\n  {message}\n  {expected}");
        }
    }

    #[test]
    fn what_is_not_read_costs_nothing_and_what_is_has_a_bound() {
        let keys: String = (0..100_000).map(|i| format!("\"k{i}\":[[{{}}]],")).collect();
        let deep = format!("{}{}", "[".repeat(300_000), "]".repeat(300_000));
        let text = format!("{{{keys}\"deep\":{deep},\"frames\":[{FRAME}]}}");
        assert_eq!(parse_text(&text).unwrap().course.frame_count(1.0, 1.0).unwrap(), Some(1));
        let message = parse_text(&format!("{{\"frames\":{deep}}}")).unwrap_err().to_string();
        assert!(message.contains("frame 0: the entry: expected an object"), "{message}");
        let many = format!("{{\"keyframes\":[{}{FRAME}]}}", "{},".repeat(1_000_001));
        assert!(parse_text(&many).unwrap_err().to_string().contains("keyframe 0"));
        let key = |t: usize| FRAME.replacen('{', &format!("{{\"t\":{t},"), 1) + ",";
        let keyframes: String = (0..=MAX_KEYFRAMES).map(key).collect();
        let message = parse_text(&format!("{{\"keyframes\":[{}]}}", keyframes.trim_end_matches(','))).unwrap_err();
        assert!(message.to_string().contains("at most 1000000 keyframes, found more"), "{message}");
    }

    #[test]
    fn another_crs_is_transformed_with_its_headings() {
        let text = r#"{"crs":"EPSG:4326","frames":[{"x":-122,"y":45,"z":3000,"heading":0,"pitch":-10}]}"#;
        let Course::Frames(poses) = parse_text(text).unwrap().course else { panic!("not frames") };
        assert!((poses[0].position - DVec3::new(578_815.30, 4_983_436.77, 3000.0)).length() < 0.01);
        assert!((poses[0].heading_rad.to_degrees() + 0.707).abs() < 0.001);
    }

    proptest! {
        #[test]
        fn any_json_values_never_panic(
            key in "(x|y|z|t|heading|pitch|roll|crs|fps|width|frames|keyframes)",
            value in "(null|true|-?[0-9]{1,3}(e[0-9]{1,3})?|\"[a-z]{0,5}\"|\\[\\]|\\{\\}|\\[\\{\\}\\])",
            outer: bool,
        ) {
            let text = if outer {
                format!("{{\"frames\":[{FRAME}],\"{key}\":{value}}}")
            } else {
                format!("{{\"keyframes\":[{{\"t\":0,\"x\":1,\"y\":1,\"z\":1,\"heading\":0,\"pitch\":0,\"{key}\":{value}}}]}}")
            };
            if let Ok(path) = parse_text(&text) {
                prop_assert!(path.course.pose(0, 30.0, 1.0).is_some());
            }
        }
    }
}
