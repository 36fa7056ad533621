//! A recorded or drawn way (GPX, and tracks and lines of KML) as a flight: resampled in time,
//! smoothed as receivers tremble, set above the smoothed ground, with the camera looking at the
//! ground where it will be a few seconds later.
//!
//! Where nothing was recorded for long, between segments or within one, there is a cut, or a short
//! hop when the way goes on nearby. A rest within a segment is shortened. Both are told.

use super::recording::{self, DEFAULT_SPEED, Segment, Tally, Timed};
use super::spline::{Key, Spline};
use super::times::for_people;
use super::{CameraPath, Course, CourseOptions, Ground, PathError, PathSettings, Pose, Remarks};
use glam::{DVec2, DVec3};
use std::path::Path;
use terravision_common::surface;

/// Default height above ground, metres.
pub(super) const DEFAULT_AGL_M: f64 = 150.0;
/// Seconds between two knots of the resampled way; longer ones are sampled more coarsely, to
/// [`MAX_KNOTS`] knots.
const KNOT_SECONDS: f64 = 0.5;
/// Most knots of a resampled way, and some for each piece of it.
const MAX_KNOTS: f64 = 400_000.0;
/// Half the width of the smoothing of the way, seconds.
const SMOOTH_SECONDS: f64 = 3.0;
/// Half the width of the smoothing of the height, seconds: hills should not shake the camera.
const SMOOTH_HEIGHT_SECONDS: f64 = 6.0;
/// How far ahead the camera looks, seconds...
const AHEAD_SECONDS: f64 = 8.0;
/// ... but at least this many heights above ground, so that it does not stare at the ground when it
/// is slow.
const AHEAD_HEIGHTS: f64 = 3.0;
/// Boxes of places that are looked at for one look ahead, so that a camera that never gets anywhere
/// costs no more than others.
const AHEAD_BOXES: usize = 4096;

/// Between segments, a gap of at most this many seconds is flown as it was.
const GAP_SECONDS: f64 = 60.0;
/// Within a segment a gap is longer than that...
const SILENCE_SECONDS: f64 = 600.0;
/// ... and longer than this many usual steps: a ship writes a point in ten minutes.
const SILENCE_STEPS: f64 = 50.0;
/// Over a gap the camera hops when the way goes on not farther than that, metres; else there is a
/// cut.
const HOP_M: f64 = 500.0;
/// Nothing that is recorded is faster, metres per second: two devices, or a point that is wrong.
const FASTEST: f64 = 1000.0;
/// A rest lasts at least this long, seconds, stays within this distance of where it begins, metres,
/// and is shortened to no less than this, seconds.
const REST_SECONDS: f64 = 120.0;
const REST_M: f64 = 30.0;
const SHORTENED_SECONDS: f64 = 2.0;
/// A way whose heights are less above ground, metres (their median), was recorded on the ground.
const FLOWN_M: f64 = 20.0;

/// The flight along these segments. `path` is for messages.
///
/// # Errors
/// [`PathError::BadValue`] when most of the times cannot be used.
pub(super) fn course(
    path: &Path,
    mut segments: Vec<Segment>,
    ground: &dyn Ground,
    options: CourseOptions,
    remarks: &mut Remarks,
) -> Result<CameraPath, PathError> {
    segments.retain(|segment| !segment.points.is_empty());
    let mut tally = Tally::default();
    let timed: Vec<Vec<Timed>> = segments.iter().map(|segment| recording::with_times(segment, &mut tally)).collect();
    if tally.is_hopeless() {
        let place = tally.first.map_or("the track".into(), |at| at.to_string());
        return Err(PathError::BadValue {
            path: path.to_owned(),
            place,
            key: "time".into(),
            expected: "times like 2024-05-01T10:00:00Z that grow from point to point (without any times it is flown at 25 m/s)",
            found: format!("{} of {} that do not", tally.stamped - tally.used, tally.stamped),
        });
    }
    remarks.warnings.extend(tally.warning());
    let mut parts: Vec<Part> = Vec::new();
    for (points, segment) in timed.into_iter().zip(&segments) {
        let has_times = segment.points.iter().any(|point| matches!(point.stamp, recording::Stamp::At(_)));
        // One without times stays behind the one that it stands behind.
        let (Some(first), Some(last)) = (points.first().map(|point| point.t), points.last().map(|point| point.t))
        else {
            continue;
        };
        let order = if has_times { first } else { parts.last().map_or(f64::NEG_INFINITY, |part| part.order) };
        parts.push(Part { order, times: has_times.then_some([first, last]), points });
    }
    parts.sort_by(|a, b| a.order.total_cmp(&b.order));
    let mut breaks = Breaks::default();
    let pieces = pieces(parts, options.keeps_rests, &mut breaks);
    remarks.notes.extend(breaks.note());

    let seconds: f64 = pieces.iter().map(|piece| duration(piece)).sum();
    let step = KNOT_SECONDS.max(seconds / MAX_KNOTS);
    let mut flight = Flight { step, ground, under: None, agl_m: options.agl_m, splines: Vec::new(), end: 0.0 };
    if options.agl_m.is_none() {
        flight.choose_heights(&pieces, &mut remarks.notes);
    }
    let moves = pieces.iter().any(|piece| piece.len() > 1);
    for piece in pieces.iter().filter(|piece| piece.len() > 1 || !moves) {
        flight.add(piece);
        if !moves {
            break;
        }
    }
    Ok(CameraPath { settings: PathSettings::default(), course: Course::Timed(flight.splines) })
}

/// A segment that is flown.
struct Part {
    /// When it begins; of one without times, when the one before begins.
    order: f64,
    /// When it was begun and ended, if it has times.
    times: Option<[f64; 2]>,
    points: Vec<Timed>,
}

fn duration(points: &[Timed]) -> f64 {
    points.last().map_or(0.0, |last| last.t - points[0].t)
}

/// How two points are joined.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Link {
    /// In the time that it took.
    Follow,
    /// In this many seconds.
    Hop(f64),
    /// Not at all.
    Cut,
}

/// What was taken out.
#[derive(Debug, Default)]
struct Breaks {
    gaps: usize,
    gap_seconds: f64,
    rests: usize,
    rest_seconds: f64,
}

impl Breaks {
    fn note(&self) -> Option<String> {
        let plural = |count: usize, what: &str| format!("{count} {what}{}", if count == 1 { "" } else { "s" });
        let mut said = Vec::new();
        if self.gaps > 0 {
            let seconds = if self.gap_seconds > 0.0 {
                format!(" ({} in all)", for_people(self.gap_seconds))
            } else {
                String::new()
            };
            said.push(format!("{} in the recording{seconds} became cuts or short hops", plural(self.gaps, "gap")));
        }
        if self.rests > 0 {
            let seconds = for_people(self.rest_seconds);
            said.push(format!(
                "{} were shortened by {seconds} in all (--rests keep flies them)",
                plural(self.rests, "rest")
            ));
        }
        (!said.is_empty()).then(|| said.join("; "))
    }

    fn over(&mut self, dt: f64, distance: f64) -> Link {
        self.gaps += 1;
        self.gap_seconds += dt.max(0.0);
        if distance <= HOP_M { Link::Hop((distance / DEFAULT_SPEED).max(1.0)) } else { Link::Cut }
    }
}

/// The points in pieces with cuts between them; times grow within each.
fn pieces(parts: Vec<Part>, keeps_rests: bool, breaks: &mut Breaks) -> Vec<Vec<Timed>> {
    let mut pieces: Vec<Vec<Timed>> = Vec::new();
    // What was taken out of the time since the last cut.
    let mut shift = 0.0;
    // The last point, and when the part before was ended.
    let (mut last, mut ended): (Option<Timed>, Option<f64>) = (None, None);
    for mut part in parts {
        let steps = part.points.windows(2).map(|pair| pair[1].t - pair[0].t).collect();
        let silence = SILENCE_SECONDS.max(SILENCE_STEPS * recording::median(steps).unwrap_or(0.0));
        if part.times.is_some() && !keeps_rests {
            shorten_rests(&mut part.points, breaks);
        }
        for (i, point) in part.points.into_iter().enumerate() {
            let link = match last {
                None => Link::Cut,
                Some(last) => {
                    let distance = last.place.distance(point.place);
                    if i == 0 {
                        join(ended, part.times.map(|times| times[0]), distance, breaks)
                    } else if part.times.is_some() && !keeps_rests && point.t - last.t > silence {
                        breaks.over(point.t - last.t, distance)
                    } else {
                        Link::Follow
                    }
                }
            };
            match link {
                Link::Follow => {}
                Link::Hop(seconds) => shift += point.t - last.map_or(point.t, |last| last.t) - seconds,
                Link::Cut => {
                    shift = 0.0;
                    pieces.push(Vec::new());
                }
            }
            last = Some(point);
            let t = point.t - shift;
            if let Some(piece) = pieces.last_mut()
                && piece.last().is_none_or(|last| last.t < t)
            {
                piece.push(Timed { t, ..point });
            }
        }
        ended = part.times.map(|times| times[1]);
    }
    pieces
}

/// How a part follows the one before: when that was ended, when this is begun, if they have times.
fn join(ended: Option<f64>, begun: Option<f64>, distance: f64, breaks: &mut Breaks) -> Link {
    let recorded = ended.zip(begun).map(|(ended, begun)| begun - ended);
    let seconds = recorded.unwrap_or(distance / DEFAULT_SPEED);
    if seconds > 0.0 && seconds <= GAP_SECONDS && distance <= seconds * FASTEST {
        Link::Hop(seconds)
    } else {
        breaks.over(recorded.unwrap_or(0.0), distance)
    }
}

/// Where a recording stays at a place for long, it does so for a short while.
fn shorten_rests(points: &mut Vec<Timed>, breaks: &mut Breaks) {
    // Windows that stay near their first point, one behind the other: as many steps as there are
    // points.
    let mut windows: Vec<[usize; 2]> = Vec::new();
    for i in 0..points.len() {
        match windows.last_mut() {
            Some([first, last]) if points[*first].place.distance(points[i].place) <= REST_M => *last = i,
            _ => windows.push([i, i]),
        }
    }
    let is_rest = |window: &[usize; 2]| points[window[1]].t - points[window[0]].t >= REST_SECONDS;
    let (mut way, mut seconds) = (0.0, 0.0);
    for pair in windows.windows(2).filter(|pair| !is_rest(&pair[0])) {
        way += points[pair[0][0]].place.distance(points[pair[1][0]].place);
        seconds += points[pair[1][0]].t - points[pair[0][0]].t;
    }
    // All of it creeps: a glacier, a ship at anchor.
    if way <= 0.0 {
        return;
    }
    let speed = way / seconds;
    let mut shift = 0.0;
    let mut flown = Vec::with_capacity(points.len());
    for window in &windows {
        let [first, last] = *window;
        if !is_rest(window) {
            flown.extend(points[first..=last].iter().map(|point| Timed { t: point.t - shift, ..*point }));
            continue;
        }
        let long = points[last].t - points[first].t;
        let short = (points[first].place.distance(points[last].place) / speed).max(SHORTENED_SECONDS).min(long);
        flown.push(Timed { t: points[first].t - shift, ..points[first] });
        shift += long - short;
        flown.push(Timed { t: points[last].t - shift, ..points[last] });
        breaks.rests += 1;
        breaks.rest_seconds += long - short;
    }
    *points = flown;
}

/// A flight in the making.
struct Flight<'a> {
    /// Seconds between knots.
    step: f64,
    ground: &'a dyn Ground,
    /// The last ground that there was.
    under: Option<f64>,
    /// Height above ground; none where the way has heights of its own that are flown.
    agl_m: Option<f64>,
    splines: Vec<Spline>,
    /// When the last piece ends.
    end: f64,
}

impl Flight<'_> {
    /// Whether the way's own heights are flown: they are there, and are those of something that
    /// flies.
    fn choose_heights(&mut self, pieces: &[Vec<Timed>], warnings: &mut Vec<String>) {
        let points = pieces.iter().flatten();
        let above: Option<Vec<f64>> = points
            .map(|point| {
                let height = point.height_m?;
                Some(height - self.ground.height_m(point.place.x, point.place.y).unwrap_or(0.0))
            })
            .collect();
        match above.and_then(recording::median) {
            Some(median) if median >= FLOWN_M => {
                warnings.push(format!(
                    "it is flown at its own heights, {median:.0} m above ground in the middle (--agl sets another height)"
                ));
            }
            _ => self.agl_m = Some(DEFAULT_AGL_M),
        }
    }

    /// Flies a piece behind those before it.
    fn add(&mut self, points: &[Timed]) {
        let step = self.step;
        let sampled = resample(points, step);
        let radius = (SMOOTH_SECONDS / step).round() as usize;
        let places: Vec<DVec2> = sampled.iter().map(|(place, _)| *place).collect();
        let places = smooth(&places, radius);
        // Outside the terrain the camera keeps the last ground that it had.
        let mut floor: Vec<f64> = places
            .iter()
            .map(|place| {
                self.under = self.ground.height_m(place.x, place.y).or(self.under);
                self.under.unwrap_or(0.0)
            })
            .collect();
        // A height that is the mean of its neighbourhood would cut into ridges: widen them first.
        let wide = (SMOOTH_HEIGHT_SECONDS / step).round() as usize;
        floor = smooth(&highest(&floor, wide), wide);
        let eyes: Vec<f64> = match self.agl_m {
            Some(agl_m) => floor.iter().map(|floor| floor + agl_m).collect(),
            None => smooth(&sampled.iter().map(|(_, height)| *height).collect::<Vec<_>>(), radius),
        };
        let ahead = Ahead::new(&places, (AHEAD_SECONDS / step).ceil() as usize);
        let mut heading = 0.0;
        let keys: Vec<Key> = (0..places.len())
            .map(|i| {
                let eye = places[i].extend(eyes[i]);
                let metres = self.agl_m.unwrap_or((eyes[i] - floor[i]).max(FLOWN_M)) * AHEAD_HEIGHTS;
                let (place, at) = ahead.look(i, metres);
                let sight: DVec3 = place.extend(floor[at]) - eye;
                if sight.truncate().length() > 1.0 {
                    heading = surface::heading(sight);
                }
                let pitch_rad = surface::pitch(sight).clamp(-0.6, 0.3);
                let pose = Pose { position: eye, heading_rad: heading, pitch_rad, roll_rad: 0.0 };
                Key::passing(self.end + i as f64 * step, pose)
            })
            .collect();
        let spline = Spline::new(&keys);
        self.end = spline.as_ref().map_or(self.end, Spline::end);
        self.splines.extend(spline);
    }
}

/// Places and heights at even steps of time.
fn resample(points: &[Timed], step: f64) -> Vec<(DVec2, f64)> {
    let Some(first) = points.first() else { return Vec::new() };
    let count = (duration(points) / step).floor() as usize + 1;
    let mut sampled = Vec::with_capacity(count);
    let mut segment = 0;
    let height = |point: &Timed| point.height_m.unwrap_or(0.0);
    for i in 0..count {
        let t = first.t + i as f64 * step;
        while segment + 2 < points.len() && points[segment + 1].t <= t {
            segment += 1;
        }
        let from = &points[segment];
        sampled.push(match points.get(segment + 1) {
            Some(next) => {
                let s = ((t - from.t) / (next.t - from.t)).clamp(0.0, 1.0);
                (from.place.lerp(next.place, s), height(from) + (height(next) - height(from)) * s)
            }
            None => (from.place, height(from)),
        });
    }
    sampled
}

/// Finds the place that the camera looks at: some knots ahead and some metres away; past the end of
/// the way, along its last direction.
struct Ahead<'a> {
    places: &'a [DVec2],
    knots: usize,
    /// Boxes around 1, 2, 4, ... places: whole stretches that stay near are passed over at once.
    boxes: Vec<Vec<[DVec2; 2]>>,
    direction: DVec2,
}

impl<'a> Ahead<'a> {
    fn new(places: &'a [DVec2], knots: usize) -> Self {
        let mut boxes = vec![places.iter().map(|place| [*place, *place]).collect::<Vec<_>>()];
        while let Some(finer) = boxes.last().filter(|finer| finer.len() > 1) {
            let union = |pair: &[[DVec2; 2]]| pair.iter().fold(pair[0], |a, b| [a[0].min(b[0]), a[1].max(b[1])]);
            boxes.push(finer.chunks(2).map(union).collect());
        }
        let end = places.last().copied().unwrap_or_default();
        let towards = places.iter().rev().map(|place| end - *place).find(|way| way.length() > 1.0);
        Self { places, knots, boxes, direction: towards.map_or(DVec2::Y, DVec2::normalize) }
    }

    /// The place, and the knot whose ground is there.
    fn look(&self, i: usize, metres: f64) -> (DVec2, usize) {
        let from = self.places[i];
        let last = self.places.len() - 1;
        match self.first_away(from, i + self.knots, metres) {
            Some(j) => (self.places[j], j),
            None => (self.places[last] + self.direction * metres, last),
        }
    }

    fn first_away(&self, from: DVec2, start: usize, metres: f64) -> Option<usize> {
        let (mut level, mut index) = (0, start);
        for _ in 0..AHEAD_BOXES {
            let [low, high] = *self.boxes[level].get(index)?;
            let may_be = (from - low).abs().max((from - high).abs()).length() >= metres;
            if level == 0 && may_be {
                return Some(index);
            }
            if may_be {
                (level, index) = (level - 1, index * 2);
                continue;
            }
            index += 1;
            while index % 2 == 0 && level + 1 < self.boxes.len() {
                (level, index) = (level + 1, index / 2);
            }
        }
        None
    }
}

/// Twice the mean over a window, which is nearly a bell; the window shrinks towards both ends, so
/// that these stay.
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

#[cfg(test)]
#[path = "track_tests.rs"]
mod tests;
