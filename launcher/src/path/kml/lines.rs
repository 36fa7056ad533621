//! Tracks (`gx:Track`, `gx:MultiTrack`) and, without these, lines (`LineString`), as segments of a
//! way.

use super::super::crs::Transform;
use super::super::gpx::{MAX_POINTS, stamp, wrapped};
use super::super::recording::{At, Recorded, Segment, Stamp};
use super::super::xml::Node;
use super::super::{Ground, PathError, Remarks, shorten};
use super::bad;
use super::unflown::Flown;
use std::path::Path;

/// Of a point: longitude, latitude, height.
const NUMBERS: usize = 3;

/// All tracks of a file, or else all its lines; `None` where there is no point of either.
pub(super) fn segments<'d>(
    path: &Path,
    root: Node<'d>,
    lonlat: &Transform,
    ground: &dyn Ground,
    remarks: &mut Remarks,
) -> Result<Option<(Flown<'d>, Vec<Segment>)>, PathError> {
    let mut reader = Reader { path, lonlat, ground, count: 0, unknown: None, warnings: Vec::new() };
    let is_there = |segments: &[Segment]| segments.iter().any(|segment| !segment.points.is_empty());
    let (flown, segments) = match reader.tracks(root)? {
        tracks if is_there(&tracks) => (Flown::Tracks, tracks),
        _ => {
            let lines = root.with_descendants().filter(|node| node.name() == "LineString");
            (Flown::Lines, lines.map(|line| reader.line(line)).collect::<Result<_, _>>()?)
        }
    };
    remarks.warnings.extend(reader.warnings);
    remarks.warnings.extend(reader.unknown);
    Ok(is_there(&segments).then_some((flown, segments)))
}

/// What a height of a line is above.
#[derive(Clone, Copy)]
enum Above {
    Datum,
    Ground,
    /// It is not looked at.
    Nothing,
}

struct Reader<'a> {
    path: &'a Path,
    lonlat: &'a Transform,
    ground: &'a dyn Ground,
    count: usize,
    /// What to say about the first unknown altitude mode.
    unknown: Option<String>,
    warnings: Vec<String>,
}

impl Reader<'_> {
    fn above(&mut self, mode: Option<Node<'_>>) -> Above {
        let Some(mode) = mode else { return Above::Nothing };
        match mode.text() {
            "absolute" => Above::Datum,
            "relativeToGround" | "relativeToSeaFloor" => Above::Ground,
            "" | "clampToGround" | "clampToSeaFloor" => Above::Nothing,
            other => {
                self.unknown.get_or_insert_with(|| {
                    format!(
                        "line {}: altitudeMode: expected absolute, relativeToGround or clampToGround, found {:?}: taken as \
                         clampToGround",
                        mode.line(),
                        shorten(other)
                    )
                });
                Above::Nothing
            }
        }
    }

    /// All tracks; those of a MultiTrack have its altitude mode where they have none.
    fn tracks(&mut self, root: Node<'_>) -> Result<Vec<Segment>, PathError> {
        let mut outer = None;
        let mut segments = Vec::new();
        for node in root.with_descendants() {
            match node.name() {
                "Placemark" => outer = None,
                "MultiTrack" => outer = node.child("altitudeMode"),
                "Track" => segments.push(self.track(node, outer)?),
                _ => {}
            }
        }
        Ok(segments)
    }

    fn line(&mut self, line: Node<'_>) -> Result<Segment, PathError> {
        let Some(coordinates) = line.child("coordinates") else { return Ok(Segment::default()) };
        let above = self.above(line.child("altitudeMode"));
        let mut points = Vec::new();
        // Numbers with commas between; some programs put blanks around the commas, or a comma
        // behind each point.
        let mut tuple = String::new();
        let mut words = coordinates.text().split_whitespace().peekable();
        while let Some(word) = words.next() {
            let is_between = tuple.is_empty() && !points.is_empty();
            tuple.push_str(if is_between { word.trim_start_matches(',') } else { word });
            let is_whole = tuple.split(',').filter(|number| !number.is_empty()).count() >= NUMBERS;
            let goes_on = word.ends_with(',') || words.peek().is_some_and(|next| next.starts_with(','));
            if is_whole || !goes_on {
                if !tuple.is_empty() {
                    let numbers = tuple.trim_end_matches(',').split(',');
                    points.push(self.point(coordinates, numbers, &tuple, Stamp::Missing, above)?);
                }
                tuple.clear();
            }
        }
        Ok(Segment { points })
    }

    fn track(&mut self, track: Node<'_>, outer_mode: Option<Node<'_>>) -> Result<Segment, PathError> {
        let above = self.above(track.child("altitudeMode").or(outer_mode));
        let count = |name: &str| track.children().filter(|node| node.name() == name).count();
        let (whens, coords) = (count("when"), count("coord"));
        if whens > coords {
            self.warnings.push(format!(
                "line {}: the track has {whens} times (when) for {coords} places (gx:coord): the last times are left out",
                track.line()
            ));
        }
        let mut times = track.children().filter(|node| node.name() == "when");
        let mut points = Vec::new();
        // The n-th time is that of the n-th place, wherever they stand.
        for place in track.children().filter(|node| node.name() == "coord") {
            let stamp = times.next().map_or(Stamp::Missing, |time| stamp(time.text()));
            if !place.text().is_empty() {
                points.push(self.point(place, place.text().split_whitespace(), place.text(), stamp, above)?);
            }
        }
        Ok(Segment { points })
    }

    fn point<'t>(
        &mut self,
        node: Node<'_>,
        mut numbers: impl Iterator<Item = &'t str>,
        text: &str,
        stamp: Stamp,
        above: Above,
    ) -> Result<Recorded, PathError> {
        const EXPECTED: &str =
            "longitude,latitude,height, and a blank before the next point: 9.5,47.1,1200 9.6,47.2,1250";
        self.count += 1;
        if self.count > MAX_POINTS {
            return Err(bad(self.path, node, node.name(), "at most 1000000 points in a file", "more"));
        }
        let wrong = || bad(self.path, node, node.name(), EXPECTED, text);
        let mut number = |limit: f64| numbers.next()?.trim().parse().ok().filter(|v: &f64| v.abs() <= limit);
        let (lon, lat) = number(360.0).zip(number(90.0)).ok_or_else(wrong)?;
        let height: Option<f64> = match numbers.next().map(str::trim) {
            // What programs write where they know none.
            None | Some("") => None,
            Some(text) if text.eq_ignore_ascii_case("nan") => None,
            Some(text) => Some(text.parse().ok().filter(|v: &f64| v.abs() <= 1e9).ok_or_else(wrong)?),
        };
        if numbers.next().is_some() {
            return Err(wrong());
        }
        let place = self.lonlat.position(wrapped(lon), lat).map_err(|source| PathError::Crs {
            path: self.path.to_owned(),
            place: format!("line {}", node.line()),
            source: Box::new(source),
        })?;
        let height_m = match above {
            Above::Datum => height,
            Above::Ground => height.map(|height| height + self.ground.height_m(place.x, place.y).unwrap_or(0.0)),
            Above::Nothing => None,
        };
        Ok(Recorded { stamp, place, height_m, at: At::Line(node.line()) })
    }
}
