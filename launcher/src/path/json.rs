//! Camera paths in JSON: one pose per frame (`"frames"`), or poses at moments (`"keyframes"`).
//!
//! Numbers are read one by one, so that a wrong one is named by its frame and key. Unknown keys are ignored.

use super::crs::{CrsError, Georeference, Transform};
use super::spline::{Key, Spline};
use super::{CameraPath, Course, MAX_FRAMES, PathError, PathSettings, Pose, shorten};
use glam::DVec3;
use serde_json::value::RawValue;
use std::collections::BTreeMap;
use std::path::Path;

/// Most keyframes that are read.
const MAX_KEYFRAMES: usize = 1_000_000;

type Object<'a> = BTreeMap<String, &'a RawValue>;

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
    let poses = |key: &'static str, limit: usize| -> Result<Option<Vec<&RawValue>>, PathError> {
        let list = reader.optional(key, "a list", |raw| serde_json::from_str::<Vec<&RawValue>>(raw.get()).ok())?;
        match list {
            Some(list) if list.len() > limit => Err(reader.bad(
                key,
                "a list of at most 2000000 frames or 1000000 keyframes",
                format!("{} of them", list.len()),
            )),
            other => Ok(other),
        }
    };
    let (frames, keyframes) = (poses("frames", MAX_FRAMES as usize)?, poses("keyframes", MAX_KEYFRAMES)?);
    let pose = |raw: &RawValue, place: String| -> Result<(Pose, f64), PathError> {
        let object: Object<'_> = match serde_json::from_str(raw.get()) {
            Ok(object) => object,
            Err(_not_an_object) => {
                let reader = Reader { path, place, object: &file };
                return Err(reader.bad("the entry", "an object with x, y, z, heading and pitch", shorten(raw.get())));
            }
        };
        let reader = Reader { path, place, object: &object };
        let pose = reader.pose(transform.as_ref())?;
        let t = if keyframes.is_some() && frames.is_none() {
            reader.required("t", "a number of seconds", number)?
        } else {
            0.0
        };
        Ok((pose, t))
    };
    const EXPECTED: &str = "\"frames\" or \"keyframes\", a list with at least one pose";
    let course = match (&frames, &keyframes) {
        (Some(_), Some(_)) => {
            return Err(reader.bad("\"frames\"", "either \"frames\" or \"keyframes\"", "both".into()));
        }
        (Some(list), None) => {
            let poses: Result<Vec<Pose>, PathError> =
                list.iter().enumerate().map(|(i, raw)| Ok(pose(raw, format!("frame {i}"))?.0)).collect();
            Course::Frames(poses?)
        }
        (None, Some(list)) => {
            let mut keys: Vec<Key> = Vec::new();
            for (i, raw) in list.iter().enumerate() {
                let (pose, t) = pose(raw, format!("keyframe {i}"))?;
                if let Some(last) = keys.last().filter(|last| last.t >= t) {
                    let reader = Reader { path, place: format!("keyframe {i}"), object: &file };
                    let found = format!("{t} after {}", last.t);
                    return Err(reader.bad("\"t\"", "more seconds than the keyframe before", found));
                }
                keys.push(Key::passing(t, pose));
            }
            Course::Timed(Spline::new(&keys).into_iter().collect())
        }
        (None, None) => return Err(PathError::Empty { path: path.to_owned(), expected: EXPECTED }),
    };
    if matches!(&course, Course::Frames(poses) if poses.is_empty())
        || matches!(&course, Course::Timed(s) if s.is_empty())
    {
        return Err(PathError::Empty { path: path.to_owned(), expected: EXPECTED });
    }
    Ok(CameraPath { settings, course })
}

fn number(raw: &RawValue) -> Option<f64> {
    serde_json::from_str::<f64>(raw.get()).ok().filter(|v| v.is_finite())
}

fn pixels(raw: &RawValue) -> Option<u32> {
    // A whole number, also written as 1280.0, as some programs do.
    number(raw)
        .filter(|v| v.fract() == 0.0 && (1.0..=f64::from(crate::cli::values::MAX_SIDE_PX)).contains(v))
        .map(|v| v as u32)
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
                None => Err(self.bad(&format!("{key:?}"), expected, shorten(raw.get()))),
            },
        }
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
                r#"keyframe 0: "t": expected a number of seconds, found nothing"#,
            ),
            (
                r#"{"keyframes":[{"t":1,"x":1,"y":2,"z":3,"heading":0,"pitch":0},{"t":1,"x":1,"y":2,"z":3,"heading":0,"pitch":0}]}"#,
                "keyframe 1",
            ),
        ] {
            let message = parse_text(text).unwrap_err().to_string();
            assert!(message.contains(expected), "{text}\n  {message}\n  {expected}");
        }
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
