//! GPX (1.0 and 1.1): tracks, otherwise routes; flown at a height above ground ([`super::track`]).

use super::crs::{Georeference, Transform};
use super::recording::{At, Recorded, Segment, Stamp};
use super::times::seconds_from_iso8601;
use super::xml::{Document, Node};
use super::{CameraPath, CourseOptions, Ground, PathError, Remarks, shorten, track};
use glam::DVec2;
use std::path::Path;

/// Most points that are read.
pub(super) const MAX_POINTS: usize = 1_000_000;

/// Reads all tracks of a GPX file as one (or all routes, if it has no track).
///
/// # Errors
/// [`PathError`] with the line in it.
pub(super) fn parse(
    path: &Path,
    document: &Document<'_>,
    world: &Georeference,
    ground: &dyn Ground,
    options: CourseOptions,
    remarks: &mut Remarks,
) -> Result<CameraPath, PathError> {
    let root = document.root();
    let count = |name: &str| root.with_descendants().filter(|node| node.name() == name).count();
    let kinds: [&str; 4] = match (count("trkpt"), count("rtept")) {
        (0, 0) => {
            let found = match count("wpt") {
                0 => "none of them".into(),
                points => format!(
                    "{points} waypoints (wpt), which have no order; make a route or a track of them (gpsbabel -i gpx -f FILE \
                     -x transform,rte=wpt -o gpx -F FILE.gpx)"
                ),
            };
            let expected = "a track (trkpt) or a route (rtept)";
            return Err(PathError::Empty { path: path.to_owned(), expected, found });
        }
        (0, _) => ["rte", "rte", "rtept", "rpt"],
        _ => ["trk", "trkseg", "trkpt", "trkpt"],
    };
    let crs_error =
        |source| PathError::Crs { path: path.to_owned(), place: "the track".into(), source: Box::new(source) };
    let mut reader = Reader { path, lonlat: &world.from_lonlat().map_err(crs_error)?, points: 0, bad: 0, first: None };
    let mut segments = vec![Segment::default()];
    for node in root.with_descendants() {
        if kinds[..2].contains(&node.name()) {
            segments.push(Segment::default());
        } else if kinds[2..].contains(&node.name())
            && let (Some(point), Some(segment)) = (reader.point(node)?, segments.last_mut())
        {
            segment.points.push(point);
        }
    }
    if let Some(error) = reader.first {
        // Most of them: this is not a track.
        if 2 * reader.bad >= reader.points {
            return Err(error);
        }
        remarks.warnings.push(format!(
            "{} of {} points have no usable place and are passed over, the first of them: {error}",
            reader.bad, reader.points
        ));
    }
    track::course(path, segments, ground, options, remarks)
}

struct Reader<'a> {
    path: &'a Path,
    lonlat: &'a Transform,
    points: usize,
    /// Points without a usable place, and what is wrong with the first.
    bad: usize,
    first: Option<PathError>,
}

impl Reader<'_> {
    /// A point; none, and counted, where it has no usable place.
    fn point(&mut self, node: Node<'_>) -> Result<Option<Recorded>, PathError> {
        self.points += 1;
        if self.points > MAX_POINTS {
            return Err(self.bad(node, "trkpt", "at most 1000000 points in a file", "more"));
        }
        match self.place(node) {
            Ok(place) => {
                let stamp = node.child("time").map_or(Stamp::Missing, |time| stamp(time.text()));
                Ok(Some(Recorded { stamp, place, height_m: None, at: At::Line(node.line()) }))
            }
            Err(error) => {
                self.bad += 1;
                self.first.get_or_insert(error);
                Ok(None)
            }
        }
    }

    fn place(&self, node: Node<'_>) -> Result<DVec2, PathError> {
        let degrees = |key: &str, expected, limit: f64| {
            let value = node.attribute(key).unwrap_or("");
            let number = value.parse().ok().filter(|v: &f64| v.abs() <= limit);
            number.ok_or_else(|| self.bad(node, key, expected, value))
        };
        let lat = degrees("lat", "degrees from -90 to 90", 90.0)?;
        let lon = wrapped(degrees("lon", "degrees from -180 to 180", 360.0)?);
        self.lonlat.position(lon, lat).map_err(|source| PathError::Crs {
            path: self.path.to_owned(),
            place: format!("line {}", node.line()),
            source: Box::new(source),
        })
    }

    fn bad(&self, node: Node<'_>, key: &str, expected: &'static str, found: &str) -> PathError {
        PathError::BadValue {
            path: self.path.to_owned(),
            place: format!("line {}", node.line()),
            key: key.into(),
            expected,
            found: if found.is_empty() { "nothing".into() } else { format!("{:?}", shorten(found)) },
        }
    }
}

/// Degrees of longitude from -180 to 180.
pub(super) fn wrapped(degrees: f64) -> f64 {
    // What is in range stays the same number.
    if degrees.abs() <= 180.0 { degrees } else { (degrees + 180.0).rem_euclid(360.0) - 180.0 }
}

/// The time of a point, as it is written.
pub(super) fn stamp(text: &str) -> Stamp {
    match text {
        "" => Stamp::Missing,
        text => seconds_from_iso8601(text).map_or(Stamp::Unreadable, Stamp::At),
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{parse_text, parse_with};
    use super::*;
    use proptest::prelude::*;

    fn gpx(points: &str) -> String {
        format!(
            r#"<?xml version="1.0"?><gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>
{points}</trkseg></trk></gpx>"#
        )
    }

    fn point(lon: f64, time: &str) -> String {
        format!("<trkpt lat=\"45\" lon=\"{lon}\"><ele>5</ele><time>{time}</time></trkpt>\n")
    }

    /// A track through these parts: seconds of the day and longitudes.
    fn track(parts: &[&[(u32, f64)]]) -> String {
        let parts: Vec<String> = parts
            .iter()
            .map(|part| {
                let stamp = |s: u32| {
                    format!("2024-05-{:02}T{:02}:{:02}:{:02}Z", 1 + s / 86_400, s / 3600 % 24, s / 60 % 60, s % 60)
                };
                part.iter().map(|(s, lon)| point(*lon, &stamp(*s))).collect()
            })
            .collect();
        gpx(&parts.join("</trkseg><trkseg>"))
    }

    fn frames(text: &str, options: CourseOptions) -> (u64, Remarks) {
        let (path, remarks) = parse_with(text, options);
        (path.unwrap().course.frame_count(1.0, 1.0).unwrap().unwrap(), remarks)
    }

    #[test]
    fn a_track_is_flown_in_its_time_above_ground_looking_ahead() {
        let points = [point(-122.0, "2024-05-01T10:00:00Z"), point(-121.99, "2024-05-01T10:01:00Z")].concat();
        let course = parse_text(&gpx(&points)).unwrap().course;
        assert_eq!(course.frame_count(30.0, 1.0).unwrap(), Some(1801));
        assert_eq!(course.frame_count(30.0, 20.0).unwrap(), Some(91));
        let pose = course.pose(900, 30.0, 1.0).unwrap();
        assert!((pose.position.z - 250.0).abs() < 1e-6, "{pose:?}");
        assert!((pose.heading_rad.to_degrees() - 90.0).abs() < 2.0, "{pose:?}");
        assert!(pose.pitch_rad < -0.1, "{pose:?}");
        let low = CourseOptions { agl_m: Some(20.0), ..CourseOptions::default() };
        let pose = parse_with(&gpx(&points), low).0.unwrap().course.pose(900, 30.0, 1.0).unwrap();
        assert!((pose.position.z - 120.0).abs() < 1e-6, "{pose:?}");
    }

    #[test]
    fn a_track_without_times_and_routes_are_flown_at_an_even_speed() {
        let text = gpx("<trkpt lat=\"45\" lon=\"-122\"/><trkpt lat=\"45\" lon=\"-121.99\"/>");
        let route = text.replace("trkseg", "rte").replace("trkpt", "rtept");
        // Two points that were set, with the road between them as Garmin's planner writes it.
        let planned = text
            .replace("trkseg", "rte")
            .replace("<trkpt lat=\"45\" lon=\"-122\"/>", "<rtept lat=\"45\" lon=\"-122\"><extensions><x:e><x:rpt lat=\"45\" lon=\"-121.995\"/></x:e></extensions></rtept>")
            .replace("trkpt", "rtept");
        for text in [text, route, planned] {
            let (frames, remarks) = frames(&text, CourseOptions::default());
            assert!((30..34).contains(&frames), "{frames}");
            assert_eq!(remarks, Remarks::default());
        }
    }

    #[test]
    fn a_single_point_is_a_still_picture() {
        let course = parse_text(&gpx(&point(-122.0, "2024-05-01T10:00:00Z"))).unwrap().course;
        assert_eq!(course.frame_count(30.0, 1.0).unwrap(), Some(1));
        assert!(course.pose(0, 30.0, 1.0).unwrap().heading_rad.is_finite());
    }

    #[test]
    fn a_bad_track_is_named_by_its_line() {
        for (points, expected) in [
            (String::new(), "nothing to fly: expected a track (trkpt) or a route (rtept), found none of them"),
            ("<wpt lat=\"1\" lon=\"2\"/>".into(), "found 1 waypoints (wpt), which have no order"),
            (point(-400.0, "2024-05-01T10:00:00Z"), "line 2: lon: expected degrees from -180 to 180, found \"-400\""),
            (point(f64::NAN, "2024-05-01T10:00:00Z"), "lon"),
            (point(-122.0, "noon"), "line 2: time: expected times like 2024-05-01T10:00:00Z"),
            ("<trkpt/>".into(), "lat: expected degrees from -90 to 90, found nothing"),
        ] {
            let message = parse_text(&gpx(&points)).unwrap_err().to_string();
            assert!(message.contains(expected), "{points}\n  {message}\n  {expected}");
        }
    }

    #[test]
    fn a_point_without_a_place_is_passed_over_and_counted() {
        let points: String =
            (0..10).map(|i| point(-122.0 + 0.001 * f64::from(i), &format!("2024-05-01T10:00:{i:02}Z"))).collect();
        let text = gpx(&points.replace("lon=\"-121.995\"", "lon=\"\""));
        let (count, remarks) = frames(&text, CourseOptions::default());
        assert_eq!(count, 10);
        assert!(remarks.warnings[0].starts_with("1 of 10 points have no usable place"), "{remarks:?}");
        assert!(remarks.warnings[0].contains("line 7: lon"), "{remarks:?}");
    }

    #[test]
    fn three_days_are_three_pieces_of_their_own_time() {
        let day = |day: u32| -> Vec<(u32, f64)> {
            (0..60)
                .map(|i| (86_400 * day + 8 * 3600 + 10 * i, -122.0 + 0.05 * f64::from(day) + 0.0003 * f64::from(i)))
                .collect()
        };
        let (one, two, three) = (day(0), day(1), day(2));
        // Also when they stand in another order, and in one segment.
        for text in [
            track(&[&one, &two, &three]),
            track(&[&three, &one, &two]),
            track(&[&[one.clone(), two.clone(), three.clone()].concat()]),
        ] {
            let (path, remarks) = parse_with(&text, CourseOptions::default());
            let course = path.unwrap().course;
            assert_eq!(course.frame_count(30.0, 20.0).unwrap(), Some(2656));
            assert!(
                remarks.notes[0].starts_with("2 gaps in the recording (47 h 40 min in all) became cuts"),
                "{remarks:?}"
            );
            assert_eq!(remarks.warnings, [] as [String; 0]);
            // The camera never flies from day to day.
            let xs: Vec<f64> = (0..1771).map(|frame| course.pose(frame, 1.0, 1.0).unwrap().position.x).collect();
            let far: Vec<usize> = (1..xs.len()).filter(|&i| (xs[i] - xs[i - 1]).abs() > 100.0).collect();
            assert_eq!(far, [590, 1180]);
            assert!(xs.windows(2).filter(|pair| (pair[1] - pair[0]).abs() < 0.5).count() < 10);
        }
    }

    #[test]
    fn a_rest_is_shortened_unless_it_is_wanted() {
        let walk = |from: u32, lon: f64| (0..30).map(move |i| (from + 10 * i, lon + 0.0003 * f64::from(i)));
        // Half an hour of trembling between two walks of five minutes.
        let rest = (0..180).map(|i| (300 + 10 * i, -122.0 + 0.009 + if i % 2 == 0 { 0.0 } else { 0.0001 }));
        let points: Vec<(u32, f64)> = walk(0, -122.0).chain(rest).chain(walk(2100, -122.0 + 0.0093)).collect();
        let (count, remarks) = frames(&track(&[&points]), CourseOptions::default());
        assert!((590..620).contains(&count), "{count}");
        assert!(remarks.notes[0].starts_with("1 rest were shortened by 30 min in all (--rests keep"), "{remarks:?}");
        let keep = CourseOptions { keeps_rests: true, ..CourseOptions::default() };
        assert_eq!(frames(&track(&[&points]), keep), (2391, Remarks::default()));
        // Silence is a rest too.
        let points: Vec<(u32, f64)> = walk(0, -122.0).chain(walk(2100, -122.0 + 0.0090)).collect();
        assert!((580..600).contains(&frames(&track(&[&points]), CourseOptions::default()).0));
        // What never moves is left alone.
        let still: Vec<(u32, f64)> = (0..100).map(|i| (10 * i, -122.0)).collect();
        assert_eq!(frames(&track(&[&still]), CourseOptions::default()), (991, Remarks::default()));
    }

    #[test]
    fn a_short_loss_of_reception_is_flown_as_it_was() {
        let first: Vec<(u32, f64)> = (0..30).map(|i| (10 * i, -122.0 + 0.0003 * f64::from(i))).collect();
        let second: Vec<(u32, f64)> = first.iter().map(|(s, lon)| (s + 340, lon + 0.0102)).collect();
        let whole = [first.clone(), second.clone()].concat();
        let (text, joined) = (track(&[&first, &second]), track(&[&whole]));
        let (split, one) = (parse_text(&text).unwrap(), parse_text(&joined).unwrap());
        assert_eq!(split, one);
    }

    proptest! {
        #[test]
        fn any_values_never_panic(
            lon in "(-?[0-9]{1,3}(\\.[0-9]{1,3})?|NaN|[a-z]{0,3})",
            time in "([0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}:[0-9]{2}(Z|[+-][0-9]{2}:[0-9]{2})?|\\PC{0,10})",
        ) {
            let time: String = time.chars().filter(|c| !"<&".contains(*c)).collect();
            let text = gpx(&format!("<trkpt lat=\"45\" lon=\"{lon}\"><time>{time}</time></trkpt>").repeat(2));
            drop(parse_text(&text));
        }
    }
}
