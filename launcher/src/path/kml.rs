//! KML tours: `gx:FlyTo` with `Camera` or `LookAt`, and `gx:Wait` (OGC KML 2.3, 12-007r2, and Google's `gx` extension,
//! which it took over).
//!
//! A FlyTo of mode `smooth` is a knot of a curve without corner; one of mode `bounce` (KML's default) starts and ends at
//! rest and rises over the way between. The first FlyTo is where the flight begins, its duration has no meaning here. A
//! FlyTo of no duration is a cut.

use super::crs::{Georeference, Transform};
use super::spline::{Key, Spline};
use super::{CameraPath, Course, Ground, PathError, PathSettings, Pose, shorten};
use glam::DVec3;
use roxmltree::{Document, Node};
use std::path::Path;

/// How high a bounce rises half-way, as a part of the way's length.
const BOUNCE_RISE: f64 = 0.15;

/// Reads the first tour of a KML file.
///
/// # Errors
/// [`PathError`] with the line in it.
pub fn parse(
    path: &Path,
    document: &Document<'_>,
    world: &Georeference,
    ground: &dyn Ground,
) -> Result<CameraPath, PathError> {
    const EXPECTED: &str = "a gx:Tour with a gx:Playlist of gx:FlyTo elements";
    let empty = || PathError::Empty { path: path.to_owned(), expected: EXPECTED };
    let playlist = document
        .descendants()
        .find(|node| node.tag_name().name() == "Tour")
        .and_then(|tour| child(tour, "Playlist"))
        .ok_or_else(empty)?;
    let crs_error =
        |source| PathError::Crs { path: path.to_owned(), place: "the tour".into(), source: Box::new(source) };
    let reader = Reader { path, transform: &world.from_lonlat().map_err(crs_error)?, ground };

    let mut pieces = Vec::new();
    let mut keys: Vec<Key> = Vec::new();
    for step in playlist.children().filter(Node::is_element) {
        match step.tag_name().name() {
            "FlyTo" => {
                let duration = reader.number(step, "duration", "seconds, 0 or more", 0.0, 1e7, Some(0.0))?;
                let is_bounce = match child(step, "flyToMode").map(text) {
                    None | Some("bounce") => true,
                    Some("smooth") => false,
                    Some(other) => return Err(reader.bad(step, "flyToMode", "smooth or bounce", other)),
                };
                let view = step.children().find(|node| matches!(node.tag_name().name(), "Camera" | "LookAt"));
                let view = view.ok_or_else(|| reader.bad(step, "FlyTo", "a Camera or a LookAt in it", "neither"))?;
                let pose = reader.view(view)?;
                let Some(last) = keys.last_mut() else {
                    keys.push(Key { t: 0.0, pose, is_stop: is_bounce, hop_m: 0.0 });
                    continue;
                };
                if duration > 0.0 {
                    if is_bounce {
                        last.is_stop = true;
                        last.hop_m = BOUNCE_RISE * last.pose.position.distance(pose.position);
                    }
                    let t = last.t + duration;
                    keys.push(Key { t, pose, is_stop: is_bounce, hop_m: 0.0 });
                } else {
                    let t = last.t;
                    pieces.extend(Spline::new(&keys));
                    keys = vec![Key { t, pose, is_stop: is_bounce, hop_m: 0.0 }];
                }
            }
            "Wait" => {
                let duration = reader.number(step, "duration", "seconds, 0 or more", 0.0, 1e7, Some(0.0))?;
                if let Some(last) = keys.last_mut().filter(|_| duration > 0.0) {
                    last.is_stop = true;
                    let rest = Key { t: last.t + duration, hop_m: 0.0, ..*last };
                    keys.push(rest);
                }
            }
            // Sounds, pauses and balloons have no picture of the terrain.
            _ => {}
        }
    }
    pieces.extend(Spline::new(&keys));
    if pieces.is_empty() {
        return Err(empty());
    }
    Ok(CameraPath { settings: PathSettings::default(), course: Course::Timed(pieces) })
}

/// Child element of that name, in whatever namespace.
pub(super) fn child<'a, 'i>(node: Node<'a, 'i>, name: &str) -> Option<Node<'a, 'i>> {
    node.children().find(|child| child.is_element() && child.tag_name().name() == name)
}

/// The text of an element, without space around it.
pub(super) fn text<'a>(node: Node<'a, '_>) -> &'a str {
    node.text().unwrap_or("").trim()
}

struct Reader<'a> {
    path: &'a Path,
    transform: &'a Transform,
    ground: &'a dyn Ground,
}

impl Reader<'_> {
    fn place(&self, node: Node<'_, '_>) -> String {
        format!("line {}", node.document().text_pos_at(node.range().start).row)
    }

    fn bad(&self, node: Node<'_, '_>, key: &str, expected: &'static str, found: &str) -> PathError {
        let found = if found.is_empty() { "nothing".into() } else { format!("{:?}", shorten(found)) };
        PathError::BadValue { path: self.path.to_owned(), place: self.place(node), key: key.into(), expected, found }
    }

    fn number(
        &self,
        node: Node<'_, '_>,
        key: &str,
        expected: &'static str,
        low: f64,
        high: f64,
        absent: Option<f64>,
    ) -> Result<f64, PathError> {
        let Some(value) = child(node, key) else {
            return absent.ok_or_else(|| self.bad(node, key, expected, ""));
        };
        let number = text(value).parse().ok().filter(|v| (low..=high).contains(v));
        number.ok_or_else(|| self.bad(value, key, expected, text(value)))
    }

    /// The pose of a Camera or a LookAt.
    fn view(&self, view: Node<'_, '_>) -> Result<Pose, PathError> {
        let number = |key, expected, low, high, absent| self.number(view, key, expected, low, high, absent);
        let longitude = number("longitude", "degrees from -180 to 180", -180.0, 180.0, None)?;
        let latitude = number("latitude", "degrees from -90 to 90", -90.0, 90.0, None)?;
        let altitude = number("altitude", "metres", -1e7, 1e9, Some(0.0))?;
        let heading = number("heading", "degrees from -360 to 360", -360.0, 360.0, Some(0.0))?.to_radians();
        let tilt = number("tilt", "degrees from 0 to 180", 0.0, 180.0, Some(0.0))?.to_radians();
        let roll = number("roll", "degrees from -180 to 180", -180.0, 180.0, Some(0.0))?.to_radians();
        let at =
            |source| PathError::Crs { path: self.path.to_owned(), place: self.place(view), source: Box::new(source) };
        let place = self.transform.position(longitude, latitude).map_err(at)?;
        let heading_rad = self.transform.heading(longitude, latitude, heading).map_err(at)?;

        // A camera outside the terrain has no ground under it: its altitude is then above the datum.
        let ground = || self.ground.height_m(place.x, place.y).unwrap_or(0.0);
        let mode = child(view, "altitudeMode").map_or("clampToGround", text);
        let z = match mode {
            "absolute" => altitude,
            "relativeToGround" | "relativeToSeaFloor" => ground() + altitude,
            "clampToGround" | "clampToSeaFloor" | "" => ground(),
            other => {
                let expected = "absolute, relativeToGround or clampToGround";
                return Err(self.bad(view, "altitudeMode", expected, other));
            }
        };
        let target = place.extend(z);
        let pitch_rad = tilt - std::f64::consts::FRAC_PI_2;
        if view.tag_name().name() == "Camera" {
            return Ok(Pose { position: target, heading_rad, pitch_rad, roll_rad: roll });
        }
        let range = number("range", "metres, 0 or more", 0.0, 1e9, None)?;
        let (sin, cos) = heading_rad.sin_cos();
        let back = DVec3::new(-sin * tilt.sin(), -cos * tilt.sin(), tilt.cos());
        Ok(Pose { position: target + back * range, heading_rad, pitch_rad, roll_rad: 0.0 })
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{parse_text, utm10};
    use super::*;
    use proptest::prelude::*;

    fn tour(steps: &str) -> String {
        format!(
            r#"<?xml version="1.0" encoding="UTF-8"?>
<kml xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2"><Document>
<gx:Tour><name>t</name><gx:Playlist>{steps}</gx:Playlist></gx:Tour></Document></kml>"#
        )
    }

    fn camera(duration: f64, mode: &str, lon: f64, extra: &str) -> String {
        format!(
            "<gx:FlyTo><gx:duration>{duration}</gx:duration><gx:flyToMode>{mode}</gx:flyToMode><Camera><longitude>{lon}</longitude>\
             <latitude>45</latitude><altitude>3000</altitude>{extra}</Camera></gx:FlyTo>"
        )
    }

    const ABSOLUTE: &str = "<tilt>70</tilt><altitudeMode>absolute</altitudeMode>";

    #[test]
    fn a_smooth_tour_is_flown_in_its_time() {
        let text = tour(&[camera(9.0, "smooth", -122.0, ABSOLUTE), camera(4.0, "smooth", -121.9, ABSOLUTE)].concat());
        let course = parse_text(&text).unwrap().course;
        assert_eq!(course.frame_count(10.0, 1.0).unwrap(), Some(41));
        let first = course.pose(0, 10.0, 1.0).unwrap();
        assert!((first.position - DVec3::new(578_815.30, 4_983_436.77, 3000.0)).length() < 0.01);
        assert!((first.pitch_rad.to_degrees() + 20.0).abs() < 1e-9);
        let last = course.pose(40, 10.0, 1.0).unwrap();
        let there = utm10().from_lonlat().unwrap().position(-121.9, 45.0).unwrap();
        assert!((last.position.truncate() - there).length() < 1e-6);
    }

    #[test]
    fn a_bounce_rises_a_wait_waits_and_no_duration_cuts() {
        let steps = [
            camera(0.0, "bounce", -122.0, ABSOLUTE),
            camera(2.0, "bounce", -121.9, ABSOLUTE),
            "<gx:Wait><gx:duration>1</gx:duration></gx:Wait>".into(),
            camera(0.0, "smooth", -121.5, ABSOLUTE),
            camera(1.0, "smooth", -121.4, ABSOLUTE),
        ];
        let course = parse_text(&tour(&steps.concat())).unwrap().course;
        assert_eq!(course.frame_count(10.0, 1.0).unwrap(), Some(41));
        assert!(course.pose(10, 10.0, 1.0).unwrap().position.z > 4000.0);
        let (a, b) = (course.pose(22, 10.0, 1.0).unwrap(), course.pose(29, 10.0, 1.0).unwrap());
        assert!((a.position - b.position).length() < 1e-6);
        let jump = course.pose(30, 10.0, 1.0).unwrap().position.x - b.position.x;
        assert!(jump > 25_000.0, "{jump}");
    }

    #[test]
    fn a_look_at_looks_at_its_target_from_its_range() {
        let text = tour(
            "<gx:FlyTo><LookAt><longitude>-122</longitude><latitude>45</latitude><altitude>0</altitude><heading>0</heading>\
             <tilt>60</tilt><range>1000</range><gx:altitudeMode>relativeToGround</gx:altitudeMode></LookAt></gx:FlyTo>",
        );
        let pose = parse_text(&text).unwrap().course.pose(0, 30.0, 1.0).unwrap();
        let target = DVec3::new(578_815.30, 4_983_436.77, 100.0);
        assert!(((pose.position - target).length() - 1000.0).abs() < 0.02);
        let (sh, ch) = pose.heading_rad.sin_cos();
        let (sp, cp) = pose.pitch_rad.sin_cos();
        let seen = pose.position + DVec3::new(sh * cp, ch * cp, sp) * 1000.0;
        assert!((seen - target).length() < 0.02, "{seen}");
    }

    #[test]
    fn heights_follow_the_altitude_mode() {
        for (mode, z) in [("absolute", 3000.0), ("relativeToGround", 3100.0), ("clampToGround", 100.0)] {
            let extra = format!("<altitudeMode>{mode}</altitudeMode>");
            let pose = parse_text(&tour(&camera(1.0, "smooth", -122.0, &extra))).unwrap().course.pose(0, 30.0, 1.0);
            assert!((pose.unwrap().position.z - z).abs() < 1e-9, "{mode}");
        }
    }

    #[test]
    fn a_bad_tour_is_named_by_its_line() {
        for (steps, expected) in [
            (String::new(), "nothing to fly: expected a gx:Tour"),
            (camera(1.0, "jump", -122.0, ""), "line 3: flyToMode: expected smooth or bounce, found \"jump\""),
            (camera(-1.0, "smooth", -122.0, ""), "duration: expected seconds, 0 or more, found \"-1\""),
            (camera(1.0, "smooth", -200.0, ""), "longitude: expected degrees from -180 to 180"),
            (camera(1.0, "smooth", f64::NAN, ""), "longitude"),
            (camera(1.0, "smooth", -122.0, "<altitudeMode>up</altitudeMode>"), "altitudeMode"),
            ("<gx:FlyTo/>".into(), "a Camera or a LookAt in it, found \"neither\""),
            ("<gx:FlyTo><Camera/></gx:FlyTo>".into(), "longitude: expected degrees from -180 to 180, found nothing"),
        ] {
            let message = parse_text(&tour(&steps)).unwrap_err().to_string();
            assert!(message.contains(expected), "{steps}\n  {message}\n  {expected}");
        }
    }

    proptest! {
        #[test]
        fn any_values_never_panic(values in proptest::collection::vec("(-?[0-9]{1,4}(e[0-9]{1,3})?|NaN|inf|[a-z]{0,3}|&amp;)", 6)) {
            let extra = format!("<heading>{}</heading><tilt>{}</tilt><roll>{}</roll>", values[0], values[1], values[2]);
            let step = camera(1.0, "smooth", -122.0, &extra)
                .replace("<gx:duration>1<", &format!("<gx:duration>{}<", values[3]))
                .replace(">45<", &format!(">{}<", values[4]))
                .replace(">3000<", &format!(">{}<", values[5]));
            if let Ok(path) = parse_text(&tour(&format!("{step}{step}"))) {
                drop(path.course.frame_count(30.0, 1.0));
                prop_assert!(path.course.pose(0, 30.0, 1.0).is_some());
            }
        }
    }
}
