//! Tracks (`gx:Track`, `gx:MultiTrack`) and, without these, lines (`LineString`), as segments of a
//! way.

use super::super::crs::Transform;
use super::super::gpx::{MAX_POINTS, stamp, wrapped};
use super::super::recording::{Recorded, Segment, Stamp};
use super::super::xml::Node;
use super::super::{Ground, PathError};
use super::bad;
use std::path::Path;

/// All tracks of a file, or else all its lines.
pub(super) fn segments(
    path: &Path,
    root: Node<'_>,
    lonlat: &Transform,
    ground: &dyn Ground,
) -> Result<Vec<Segment>, PathError> {
    let named = |name: &'static str| root.with_descendants().filter(move |node| node.name() == name);
    let mut reader = Reader { path, lonlat, ground, count: 0 };
    let tracks = named("Track").map(|track| reader.track(track)).collect::<Result<Vec<Segment>, PathError>>()?;
    if tracks.iter().any(|segment| !segment.points.is_empty()) {
        return Ok(tracks);
    }
    named("LineString").map(|line| reader.line(line)).collect()
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
}

impl Reader<'_> {
    fn above(node: Node<'_>) -> Above {
        match node.child("altitudeMode").map_or("", Node::text) {
            "absolute" => Above::Datum,
            mode if mode.starts_with("relative") => Above::Ground,
            _ => Above::Nothing,
        }
    }

    fn line(&mut self, line: Node<'_>) -> Result<Segment, PathError> {
        let Some(coordinates) = line.child("coordinates") else { return Ok(Segment::default()) };
        let above = Self::above(line);
        let mut points = Vec::new();
        // Three numbers with commas between; some programs put blanks around the commas.
        let mut tuple = String::new();
        let mut words = coordinates.text().split_whitespace().peekable();
        while let Some(word) = words.next() {
            tuple.push_str(word);
            let goes_on = word.ends_with(',') || words.peek().is_some_and(|next| next.starts_with(','));
            // No tuple is longer: a text of commas must not become one.
            if !goes_on || tuple.len() > 200 {
                points.push(self.point(coordinates, tuple.split(','), &tuple, Stamp::Missing, above)?);
                tuple.clear();
            }
        }
        Ok(Segment { points })
    }

    fn track(&mut self, track: Node<'_>) -> Result<Segment, PathError> {
        let above = Self::above(track);
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
        const EXPECTED: &str = "longitude, latitude and height, e.g. 9.5,47.1,1200";
        self.count += 1;
        if self.count > MAX_POINTS {
            return Err(bad(self.path, node, node.name(), "at most 1000000 points in a file", "more"));
        }
        let mut number = |limit: f64| numbers.next()?.trim().parse().ok().filter(|v: &f64| v.abs() <= limit);
        let place = number(360.0).zip(number(90.0));
        let height: Option<f64> = number(1e9);
        let (lon, lat) = place.ok_or_else(|| bad(self.path, node, node.name(), EXPECTED, text))?;
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
        Ok(Recorded { stamp, place, height_m, line: node.line() })
    }
}
