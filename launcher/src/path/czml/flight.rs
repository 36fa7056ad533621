//! The flight of an object of which positions and orientations over time are known.

use super::super::crs::Transform;
use super::super::ecef::{Geodetic, east_north_up};
use super::super::gpx::{MAX_POINTS, wrapped};
use super::super::recording::{At, Recorded, Segment, Stamp};
use super::super::spline::{Key, Spline, pose_from_attitude, slerp};
use super::super::{CameraPath, Course, CourseOptions, Ground, PathError, PathSettings, Pose, Remarks, track};
use super::samples::Piece;
use glam::{DQuat, DVec3};
use std::f64::consts::FRAC_PI_2;
use std::path::Path;

/// Moments that are nearer to each other, seconds, are one.
const SHORTEST_STEP: f64 = 1e-6;
/// Two pieces with less time between them, and less way, are one.
const JOINED_SECONDS: f64 = 1e-3;
const JOINED_M: f64 = 1.0;
/// A way that is not straight between its samples has this many points between two of them at most,
/// and one in half a second.
const MOST_BETWEEN: f64 = 16.0;
const STEP_SECONDS: f64 = 0.5;

/// A place, in both systems.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    pub(super) geodetic: Geodetic,
    /// In the world's CRS.
    pub(super) position: DVec3,
}

pub(super) fn between(a: &Place, b: &Place, s: f64) -> Place {
    let east = wrapped(b.geodetic.longitude_deg - a.geodetic.longitude_deg);
    let mix = |a: f64, b: f64| a + (b - a) * s;
    Place {
        geodetic: Geodetic {
            longitude_deg: wrapped(a.geodetic.longitude_deg + east * s),
            latitude_deg: mix(a.geodetic.latitude_deg, b.geodetic.latitude_deg),
            height_m: mix(a.geodetic.height_m, b.geodetic.height_m),
        },
        position: a.position.lerp(b.position, s),
    }
}

/// The parts of a way in which the object is there, in the order of time.
pub(super) fn parts(positions: &[Piece<Place>], availability: &[[f64; 2]]) -> Vec<Piece<Place>> {
    let mut parts = Vec::new();
    for piece in positions {
        // The first span that is not over when the piece begins: all work is in proportion to what
        // comes of it.
        let first = availability.partition_point(|span| span[1] < piece.interval[0]);
        for span in availability[first..].iter().take_while(|span| span[0] <= piece.interval[1]) {
            let mut part = piece.within(*span, between);
            // One that stands still for a while does so between two moments.
            if let Some(part) = &mut part
                && part.times.is_empty()
                && part.interval.iter().all(|end| end.is_finite())
                && let Some(value) = part.values.first().copied()
            {
                part.times = part.interval.to_vec();
                part.values = vec![value; 2];
            }
            parts.extend(part.filter(|part| !part.values.is_empty()));
        }
    }
    parts
}

/// The way as a curve; the camera on it looks north.
pub(super) fn curve(part: &Piece<Place>) -> Option<(f64, Spline)> {
    let start = part.times.first().copied().unwrap_or(0.0);
    let pose = |position| Pose { position, heading_rad: 0.0, pitch_rad: 0.0, roll_rad: 0.0 };
    let mut keys: Vec<Key> = Vec::with_capacity(part.values.len());
    for (i, place) in part.values.iter().enumerate() {
        let t = part.times.get(i).copied().unwrap_or(start) - start;
        if keys.last().is_none_or(|last| t >= last.t + SHORTEST_STEP) {
            keys.push(Key::passing(t, pose(place.position)));
        }
    }
    Some((start, Spline::new(&keys)?))
}

fn note_curve(parts: &[Piece<Place>], what: &str, remarks: &mut Remarks) {
    if let Some(polynomial) = parts.iter().find_map(|part| part.polynomial.as_ref()) {
        remarks.notes.push(format!("its {what} are joined by a smooth curve through them, not by {polynomial}"));
    }
}

/// The flight of a camera that looks ahead along its way.
pub(super) fn ahead(
    path: &Path,
    parts: &[Piece<Place>],
    ground: &dyn Ground,
    options: CourseOptions,
    remarks: &mut Remarks,
) -> Result<CameraPath, PathError> {
    note_curve(parts, "positions", remarks);
    let mut count = 0;
    let mut segments = Vec::with_capacity(parts.len());
    for part in parts {
        let mut segment = Segment::default();
        let curve = part.polynomial.as_ref().and_then(|_| curve(part));
        for (i, place) in part.values.iter().enumerate() {
            let recorded = |stamp, position: DVec3| {
                let at = At::Point(u32::try_from(i).unwrap_or(u32::MAX));
                Recorded { stamp, place: position.truncate(), height_m: Some(position.z), at }
            };
            let t = part.times.get(i).copied();
            segment.points.push(recorded(t.map_or(Stamp::Missing, Stamp::At), place.position));
            count += 1;
            let Some(((start, curve), (t, next))) = curve.as_ref().zip(t.zip(part.times.get(i + 1).copied())) else {
                continue;
            };
            let steps = ((next - t) / STEP_SECONDS).floor().min(MOST_BETWEEN);
            for step in (1..steps as usize).take(MAX_POINTS.saturating_sub(count)) {
                let moment = t + (next - t) * step as f64 / steps;
                segment.points.push(recorded(Stamp::At(moment), curve.pose(moment - start).position));
                count += 1;
            }
        }
        segments.push(segment);
    }
    track::course(path, segments, ground, options, remarks)
}

/// The flight of a camera that looks as the body is turned: along its x axis, z up.
pub(super) fn oriented(
    path: &Path,
    place: &str,
    parts: &[Piece<Place>],
    orientations: &[Piece<DQuat>],
    lonlat: &Transform,
    remarks: &mut Remarks,
) -> Result<CameraPath, PathError> {
    note_curve(parts, "positions", remarks);
    let mut flight = Flight { pieces: Vec::new(), keys: Vec::new(), end: 0.0, gaps: 0, held: 0 };
    for part in parts {
        let curve = curve(part);
        let mut keys = Vec::new();
        for t in moments(part, orientations) {
            let Some(there) = part.value(t, between) else { continue };
            let position = match &curve {
                Some((start, curve)) if !part.times.is_empty() => curve.pose(t - start).position,
                _ => there.position,
            };
            let pose = flight.pose(Place { position, ..there }, t, orientations, lonlat);
            let pose = pose.map_err(|source| PathError::Crs {
                path: path.to_owned(),
                place: place.to_owned(),
                source: Box::new(source),
            })?;
            keys.push(Key::passing(t, pose));
        }
        flight.add(keys);
    }
    let Flight { pieces, gaps, held, .. } = flight.finished();
    if gaps > 0 {
        let plural =
            if gaps == 1 { "1 gap in its times is a cut".into() } else { format!("{gaps} gaps in its times are cuts") };
        remarks.notes.push(plural);
    }
    if held > 0 {
        remarks.notes.push(format!(
            "at {held} of its moments it has no orientation: it keeps the first one before its samples, the last one behind them"
        ));
    }
    Ok(CameraPath { settings: PathSettings::default(), course: Course::Timed(pieces) })
}

/// The moments of a part at which its position or its orientation is known, in order.
pub(super) fn moments(part: &Piece<Place>, orientations: &[Piece<DQuat>]) -> Vec<f64> {
    let [from, to] = match (part.times.first(), part.times.last()) {
        (Some(first), Some(last)) => [*first, *last],
        _ => part.interval,
    };
    let first = orientations.partition_point(|turns| turns.interval[1] < from);
    let turns = orientations[first..].iter().take_while(|turns| turns.interval[0] <= to).flat_map(|turns| {
        let [low, high] = [turns.interval[0].max(from), turns.interval[1].min(to)];
        let times = &turns.times;
        let range = times.partition_point(|t| *t < low)..times.partition_point(|t| *t <= high);
        times.get(range).unwrap_or_default()
    });
    let mut moments: Vec<f64> = part.times.iter().chain(turns).copied().collect();
    moments.sort_by(f64::total_cmp);
    // The position's own moments stay: where one of the orientation is as good as at one, it goes.
    let is_own = |t: f64| part.times.binary_search_by(|own| own.total_cmp(&t)).is_ok();
    moments.dedup_by(|next, first| *next == *first);
    let mut kept: Vec<f64> = Vec::with_capacity(moments.len());
    for t in moments {
        match kept.last_mut() {
            Some(last) if t - *last < SHORTEST_STEP => {
                if is_own(t) && !is_own(*last) {
                    *last = t;
                }
            }
            _ => kept.push(t),
        }
    }
    if kept.is_empty() {
        kept.push(if from.is_finite() { from } else { 0.0 });
    }
    kept
}

/// The rotation from the body's axes to east, north and up at a place, at a moment; and whether it
/// is that of another moment. There is at least one orientation.
pub(super) fn local_turn(there: Geodetic, t: f64, orientations: &[Piece<DQuat>]) -> (DQuat, bool) {
    let after = orientations.partition_point(|turns| turns.interval[0] <= t);
    let turns = &orientations[after.saturating_sub(1)];
    let is_there = turns.times.is_empty()
        || turns.times.first().is_some_and(|first| *first <= t) && turns.times.last().is_some_and(|last| t <= *last);
    let is_held = !is_there || !(turns.interval[0]..=turns.interval[1]).contains(&t);
    let turn = turns.value(t, |a, b, s| slerp(*a, *b, s)).unwrap_or(DQuat::IDENTITY);
    (DQuat::from_mat3(&east_north_up(there.longitude_deg, there.latitude_deg).transpose()) * turn, is_held)
}

/// A flight in the making.
struct Flight {
    pieces: Vec<Spline>,
    /// Keys since the last cut, in the flight's own time.
    keys: Vec<Key>,
    /// The moment of the last key, in the file's time.
    end: f64,
    gaps: usize,
    /// Moments at which the orientation is that of another moment.
    held: usize,
}

impl Flight {
    fn pose(
        &mut self,
        there: Place,
        t: f64,
        orientations: &[Piece<DQuat>],
        lonlat: &Transform,
    ) -> Result<Pose, super::super::crs::CrsError> {
        let (turn, is_held) = local_turn(there.geodetic, t, orientations);
        self.held += usize::from(is_held);
        let (longitude, latitude) = (there.geodetic.longitude_deg, there.geodetic.latitude_deg);
        // The body's axes are ahead, left and up; the camera's are right, ahead and up.
        let attitude = (turn * DQuat::from_rotation_z(-FRAC_PI_2)).normalize();
        let pose = pose_from_attitude(there.position, attitude);
        Ok(Pose { heading_rad: lonlat.heading(longitude, latitude, pose.heading_rad)?, ..pose })
    }

    /// Flies a part behind those before it, without the time between them.
    fn add(&mut self, keys: Vec<Key>) {
        let (Some(first), Some(last)) = (keys.first().copied(), keys.last().copied()) else { return };
        let mut start = 0.0;
        if let Some(before) = self.keys.last().copied() {
            let is_joined = (first.t - self.end).abs() <= JOINED_SECONDS
                && before.pose.position.distance(first.pose.position) <= JOINED_M;
            if !is_joined {
                self.gaps += usize::from(first.t - self.end > JOINED_SECONDS);
                self.cut();
            }
            start = before.t;
        }
        for key in keys {
            let t = start + key.t - first.t;
            if self.keys.last().is_none_or(|last| t >= last.t + SHORTEST_STEP) {
                self.keys.push(Key { t, ..key });
            }
        }
        self.end = last.t;
    }

    fn cut(&mut self) {
        self.pieces.extend(Spline::new(&self.keys));
        self.keys.clear();
    }

    fn finished(mut self) -> Self {
        self.cut();
        self
    }
}
