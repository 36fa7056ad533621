//! GPX tracks: flown at a height above ground, looking ahead along the way (GPX 1.1).
//!
//! The track is resampled by time, smoothed (receivers tremble), and set above the smoothed ground. The camera looks
//! at where it will be a few seconds later, at the ground there.

use super::crs::Georeference;
use super::kml::text;
use super::spline::{Key, Spline};
use super::{CameraPath, Course, CourseOptions, Ground, PathError, PathSettings, Pose, shorten};
use glam::{DVec2, DVec3};
use roxmltree::{Document, Node};
use std::path::Path;

/// Most points that are read.
const MAX_POINTS: usize = 1_000_000;
/// Seconds between two knots of the resampled track; longer tracks are sampled more coarsely, to [`MAX_KNOTS`] knots.
const KNOT_SECONDS: f64 = 0.5;
/// Most knots of a resampled track.
const MAX_KNOTS: f64 = 400_000.0;
/// Half the width of the smoothing of the way, seconds.
const SMOOTH_SECONDS: f64 = 3.0;
/// Half the width of the smoothing of the height, seconds: hills should not shake the camera.
const SMOOTH_HEIGHT_SECONDS: f64 = 6.0;
/// How far ahead the camera looks, seconds...
const AHEAD_SECONDS: f64 = 8.0;
/// ... but at least so many heights above ground, so that it does not stare at the ground when it is slow.
const AHEAD_HEIGHTS: f64 = 3.0;
/// Speed of a track without times, metres per second.
const DEFAULT_SPEED: f64 = 25.0;

/// A point of the track: when and where.
#[derive(Debug, Clone, Copy)]
struct Point {
    t: f64,
    place: DVec2,
}

/// Reads all tracks of a GPX file as one (or all routes, if it has no track).
///
/// # Errors
/// [`PathError`] with the line in it.
pub fn parse(
    path: &Path,
    document: &Document<'_>,
    world: &Georeference,
    ground: &dyn Ground,
    options: CourseOptions,
) -> Result<CameraPath, PathError> {
    let points = read_points(path, document, world)?;
    let (Some(first), Some(last)) = (points.first(), points.last()) else {
        return Err(PathError::Empty { path: path.to_owned(), expected: "a track (trkpt) or a route (rtept)" });
    };
    let seconds = last.t - first.t;
    let step = KNOT_SECONDS.max(seconds / MAX_KNOTS);
    let count = (seconds / step).floor() as usize + 1;
    let mut places: Vec<DVec2> = Vec::with_capacity(count);
    let mut segment = 0;
    for i in 0..count {
        let t = first.t + i as f64 * step;
        while segment + 2 < points.len() && points[segment + 1].t <= t {
            segment += 1;
        }
        places.push(match points.get(segment + 1) {
            Some(next) => {
                let s = ((t - points[segment].t) / (next.t - points[segment].t)).clamp(0.0, 1.0);
                points[segment].place.lerp(next.place, s)
            }
            None => points[segment].place,
        });
    }
    let places = smooth(&places, (SMOOTH_SECONDS / step).round() as usize);
    // Outside the terrain the camera keeps the last ground that it had.
    let mut under = None;
    let mut floor: Vec<f64> = places
        .iter()
        .map(|place| {
            under = ground.height_m(place.x, place.y).or(under);
            under.unwrap_or(0.0)
        })
        .collect();
    // A height that is the mean of its neighbourhood would cut into ridges: widen them first.
    let radius = (SMOOTH_HEIGHT_SECONDS / step).round() as usize;
    floor = smooth(&highest(&floor, radius), radius);

    let mut heading = 0.0;
    let keys: Vec<Key> = (0..count)
        .map(|i| {
            let eye = places[i].extend(floor[i] + options.agl_m);
            let target =
                look_ahead(&places, &floor, i, (AHEAD_SECONDS / step).ceil() as usize, options.agl_m * AHEAD_HEIGHTS);
            let sight = target - eye;
            if sight.truncate().length() > 1.0 {
                heading = sight.x.atan2(sight.y);
            }
            let pitch_rad = sight.z.atan2(sight.truncate().length()).clamp(-0.6, 0.3);
            let pose = Pose { position: eye, heading_rad: heading, pitch_rad, roll_rad: 0.0 };
            Key::passing(i as f64 * step, pose)
        })
        .collect();
    Ok(CameraPath {
        settings: PathSettings::default(),
        course: Course::Timed(Spline::new(&keys).into_iter().collect()),
    })
}

/// The ground point that the camera looks at: some knots ahead and some metres away; past the end of the track, along
/// its last direction.
fn look_ahead(places: &[DVec2], floor: &[f64], i: usize, knots: usize, metres: f64) -> DVec3 {
    let from = places[i];
    let found = (i..places.len()).find(|&j| j >= i + knots && places[j].distance(from) >= metres);
    if let Some(j) = found {
        return places[j].extend(floor[j]);
    }
    let last = places.len() - 1;
    let towards = places[..last].iter().rev().map(|p| places[last] - *p).find(|d| d.length() > 1.0);
    let direction = towards.map_or(DVec2::Y, DVec2::normalize);
    (places[last] + direction * metres).extend(floor[last])
}

/// Twice the mean over a window, which is nearly a bell; the window shrinks towards both ends, so that these stay.
fn smooth<T>(values: &[T], radius: usize) -> Vec<T>
where
    T: Copy + Default + std::ops::Add<Output = T> + std::ops::Sub<Output = T> + std::ops::Mul<f64, Output = T>,
{
    let once = |values: &[T]| -> Vec<T> {
        let mut out = Vec::with_capacity(values.len());
        for i in 0..values.len() {
            let r = radius.min(i).min(values.len() - 1 - i);
            let window = &values[i - r..=i + r];
            // Relative to the middle: sums of coordinates of millions of metres would cost digits.
            let mut sum = T::default();
            for value in window {
                sum = sum + (*value - values[i]);
            }
            out.push(values[i] + sum * (1.0 / window.len() as f64));
        }
        out
    };
    once(&once(values))
}

/// The highest value in a window around each.
fn highest(values: &[f64], radius: usize) -> Vec<f64> {
    (0..values.len())
        .map(|i| {
            let window = &values[i.saturating_sub(radius)..values.len().min(i + radius + 1)];
            window.iter().copied().fold(f64::NEG_INFINITY, f64::max)
        })
        .collect()
}

fn read_points(path: &Path, document: &Document<'_>, world: &Georeference) -> Result<Vec<Point>, PathError> {
    let place_of = |node: Node<'_, '_>| format!("line {}", document.text_pos_at(node.range().start).row);
    let bad = |node: Node<'_, '_>, key: &str, expected: &'static str, found: &str| PathError::BadValue {
        path: path.to_owned(),
        place: place_of(node),
        key: key.into(),
        expected,
        found: if found.is_empty() { "nothing".into() } else { format!("{:?}", shorten(found)) },
    };
    let named = |name: &'static str| document.descendants().filter(move |node| node.tag_name().name() == name);
    let nodes: Vec<Node<'_, '_>> = match named("trkpt").next() {
        Some(_) => named("trkpt").collect(),
        None => named("rtept").collect(),
    };
    if nodes.len() > MAX_POINTS {
        return Err(bad(nodes[MAX_POINTS], "trkpt", "at most 1000000 points", &nodes.len().to_string()));
    }
    let crs_error =
        |place: String| move |source| PathError::Crs { path: path.to_owned(), place, source: Box::new(source) };
    let lonlat = world.from_lonlat().map_err(crs_error("the track".into()))?;
    let mut points: Vec<Point> = Vec::with_capacity(nodes.len());
    // A track has times at all points or is flown at an even speed.
    let is_timed = !nodes.is_empty() && nodes.iter().all(|node| super::kml::child(*node, "time").is_some());
    for node in nodes {
        let degrees = |key: &str, expected, limit: f64| {
            let value = node.attribute(key).unwrap_or("").trim();
            let number = value.parse().ok().filter(|v: &f64| v.abs() <= limit);
            number.ok_or_else(|| bad(node, key, expected, value))
        };
        let lat = degrees("lat", "degrees from -90 to 90", 90.0)?;
        let lon = degrees("lon", "degrees from -180 to 180", 180.0)?;
        let place = lonlat.position(lon, lat).map_err(crs_error(place_of(node)))?;
        let t = if is_timed {
            let stamp = super::kml::child(node, "time").map_or("", text);
            seconds_from_iso8601(stamp).ok_or_else(|| bad(node, "time", "a time like 2024-05-01T10:00:00Z", stamp))?
        } else {
            points.last().map_or(0.0, |last: &Point| last.t + last.place.distance(place) / DEFAULT_SPEED)
        };
        match points.last() {
            // A receiver that stood still, or wrote a point twice.
            Some(last) if t == last.t => continue,
            Some(last) if t < last.t => {
                return Err(bad(
                    node,
                    "time",
                    "a time after that of the point before",
                    &format!("{} s earlier", last.t - t),
                ));
            }
            _ => points.push(Point { t, place }),
        }
    }
    if let (Some(first), Some(last)) = (points.first(), points.last()) {
        // A year: a wrong date in the middle of a track would make a flight of that length.
        if last.t - first.t > 3.2e7 {
            return Err(PathError::TooLong { frames: (last.t - first.t) * 30.0, fps: 30.0 });
        }
    }
    Ok(points)
}

/// Seconds since 1970 of a time like `2024-05-01T10:00:00.5Z` or `...+02:00` (the profile of ISO 8601 that XML Schema's
/// dateTime is).
fn seconds_from_iso8601(text: &str) -> Option<f64> {
    let (date, time) = text.split_once(['T', 't'])?;
    let digits = |text: &str, len: usize| -> Option<i64> {
        (text.len() == len && text.bytes().all(|b| b.is_ascii_digit())).then(|| text.parse().ok()).flatten()
    };
    let mut parts = date.split('-');
    let (year, month, day) = (digits(parts.next()?, 4)?, digits(parts.next()?, 2)?, digits(parts.next()?, 2)?);
    let zone_at = time.find(['Z', 'z', '+', '-']).unwrap_or(time.len());
    let (clock, zone) = time.split_at(zone_at);
    let mut parts = clock.split(':');
    let (hour, minute) = (digits(parts.next()?, 2)?, digits(parts.next()?, 2)?);
    let second = parts.next()?;
    let is_plain = second.len() <= 20 && second.bytes().all(|b| b.is_ascii_digit() || b == b'.');
    let second: f64 = is_plain.then(|| second.parse().ok()).flatten()?;
    let offset_minutes = match zone.as_bytes().first() {
        None | Some(b'Z' | b'z') => 0,
        Some(sign) => {
            let (hours, minutes) = zone[1..].split_once(':')?;
            let minutes = digits(hours, 2)? * 60 + digits(minutes, 2)?;
            if *sign == b'-' { -minutes } else { minutes }
        }
    };
    let is_valid = (1..=12).contains(&month) && (1..=31).contains(&day) && hour < 25 && minute < 60 && second < 61.0;
    if !is_valid || parts.next().is_some() {
        return None;
    }
    // Days from the civil calendar; H. Hinnant, "chrono-compatible low-level date algorithms", days_from_civil.
    let shifted = if month <= 2 { year - 1 } else { year };
    let era = shifted.div_euclid(400);
    let year_of_era = shifted.rem_euclid(400);
    let day_of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    let day_of_era = year_of_era * 365 + year_of_era / 4 - year_of_era / 100 + day_of_year;
    let days = era * 146_097 + day_of_era - 719_468;
    Some((days * 86_400 + hour * 3600 + (minute - offset_minutes) * 60) as f64 + second)
}

#[cfg(test)]
mod tests {
    use super::super::tests::parse_text;
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
    }

    #[test]
    fn a_track_without_times_and_a_route_are_flown_at_an_even_speed() {
        let text = gpx("<trkpt lat=\"45\" lon=\"-122\"/><trkpt lat=\"45\" lon=\"-121.99\"/>");
        let route = text.replace("trkseg", "rte").replace("trkpt", "rtept");
        for text in [text, route] {
            let frames = parse_text(&text).unwrap().course.frame_count(1.0, 1.0).unwrap().unwrap();
            assert!((30..34).contains(&frames), "{frames}");
        }
    }

    #[test]
    fn a_single_point_is_a_still_picture() {
        let course = parse_text(&gpx(&point(-122.0, "2024-05-01T10:00:00Z"))).unwrap().course;
        assert_eq!(course.frame_count(30.0, 1.0).unwrap(), Some(1));
        assert!(course.pose(0, 30.0, 1.0).unwrap().heading_rad.is_finite());
    }

    #[test]
    fn times_are_read() {
        assert_eq!(seconds_from_iso8601("1970-01-01T00:00:00Z"), Some(0.0));
        assert_eq!(seconds_from_iso8601("2000-03-01T12:00:00.25Z"), Some(951_912_000.25));
        assert_eq!(seconds_from_iso8601("2000-03-01T14:00:00+02:00"), Some(951_912_000.0));
        for text in ["", "T", "2000-13-01T00:00:00Z", "2000-01-01", "2000-01-01T1:00:00Z", "2000-01-01T00:00:00+é:00"]
        {
            assert_eq!(seconds_from_iso8601(text), None, "{text}");
        }
    }

    #[test]
    fn a_bad_track_is_named_by_its_line() {
        let late = [point(-122.0, "2024-05-01T10:00:10Z"), point(-121.0, "2024-05-01T10:00:00Z")].concat();
        for (points, expected) in [
            (String::new(), "nothing to fly: expected a track"),
            (point(-200.0, "2024-05-01T10:00:00Z"), "line 2: lon: expected degrees from -180 to 180, found \"-200\""),
            (point(f64::NAN, "2024-05-01T10:00:00Z"), "lon"),
            (point(-122.0, "noon"), "time: expected a time like 2024-05-01T10:00:00Z, found \"noon\""),
            (late, "line 3: time: expected a time after"),
            ("<trkpt/>".into(), "lat: expected degrees from -90 to 90, found nothing"),
            (
                [point(-122.0, "1999-05-01T10:00:10Z"), point(-121.0, "2024-05-01T10:00:00Z")].concat(),
                "at most 2000000",
            ),
        ] {
            let message = parse_text(&gpx(&points)).unwrap_err().to_string();
            assert!(message.contains(expected), "{points}\n  {message}\n  {expected}");
        }
    }

    proptest! {
        #[test]
        fn any_values_never_panic(
            lon in "(-?[0-9]{1,3}(\\.[0-9]{1,3})?|NaN|[a-z]{0,3})",
            time in "([0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}:[0-9]{2}(Z|[+-][0-9]{2}:[0-9]{2})?|\\PC{0,10})",
        ) {
            let _read: Option<f64> = seconds_from_iso8601(&time);
            let time: String = time.chars().filter(|c| !"<&".contains(*c)).collect();
            let text = gpx(&format!("<trkpt lat=\"45\" lon=\"{lon}\"><time>{time}</time></trkpt>").repeat(2));
            drop(parse_text(&text));
        }

        #[test]
        fn smoothing_keeps_straight_lines(n in 1usize..50, radius in 0usize..20) {
            let line: Vec<f64> = (0..n).map(|i| i as f64 * 2.0 + 1e6).collect();
            for (a, b) in smooth(&line, radius).iter().zip(&line) {
                prop_assert!((a - b).abs() < 1e-6);
            }
        }
    }
}
