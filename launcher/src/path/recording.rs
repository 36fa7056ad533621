//! A recorded way as it is in a file, and the times at which it is flown.
//!
//! Receivers write wrong times: before they know the date (1980), after a rollover, when their
//! clock is set. One wrong time must not cost the whole recording. So of each segment the longest
//! sequence of growing times is kept, also when its parts stand out of order; few points that are
//! far from all others in time are passed over; a point without time lies between its neighbours,
//! by distance. Nothing of it is silent: [`Tally`] counts.

use glam::DVec2;
use std::cmp::Ordering;
use std::fmt;

/// Speed of a way without times, metres per second.
pub(super) const DEFAULT_SPEED: f64 = 25.0;
/// Slowest and fastest at which points without time before the first or behind the last time are
/// flown, metres per second.
const SPEEDS: [f64; 2] = [1.0, 300.0];
/// A few points that are so far from all others in time have a wrong date, seconds...
const FAR_SECONDS: f64 = 6.0 * 3600.0;
/// ... or this many times the usual step, of a recording with a point a day.
const FAR_STEPS: f64 = 100.0;

/// The time of a point, as it was written.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Stamp {
    /// None.
    Missing,
    /// Something that is not a time.
    Unreadable,
    /// Seconds since 1970.
    At(f64),
}

/// Where in its file a point is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum At {
    /// A line of the file, from 1.
    Line(u32),
    /// A point of the file, from 0: JSON is often written without line ends.
    Point(u32),
}

impl fmt::Display for At {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line(line) => write!(f, "line {line}"),
            Self::Point(point) => write!(f, "point {point}"),
        }
    }
}

/// A point of a recording.
#[derive(Debug, Clone, Copy)]
pub(super) struct Recorded {
    pub(super) stamp: Stamp,
    /// In the world's CRS.
    pub(super) place: DVec2,
    /// In the world's vertical datum, where the file says it.
    pub(super) height_m: Option<f64>,
    pub(super) at: At,
}

/// What was recorded without a break, so far as the file says.
#[derive(Debug, Default)]
pub(super) struct Segment {
    pub(super) points: Vec<Recorded>,
}

/// A point with the time at which it is flown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Timed {
    pub(super) t: f64,
    pub(super) place: DVec2,
    pub(super) height_m: Option<f64>,
}

/// What a recording lacked.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub(super) struct Tally {
    /// All points.
    pub(super) points: usize,
    /// Points with a time of whatever kind.
    pub(super) stamped: usize,
    /// Points whose time was used.
    pub(super) used: usize,
    /// Points without a readable time, which now lie between their neighbours.
    pub(super) placed: usize,
    /// Points that were passed over.
    pub(super) dropped: usize,
    /// Where the first one is whose time is not usable.
    pub(super) first: Option<At>,
}

/// The points of a segment with growing times; without any times, at [`DEFAULT_SPEED`] from 0.
pub(super) fn with_times(segment: &Segment, tally: &mut Tally) -> Vec<Timed> {
    let points = &segment.points;
    tally.points += points.len();
    let mut given: Vec<(usize, f64)> = Vec::new();
    for (i, point) in points.iter().enumerate() {
        match point.stamp {
            Stamp::Missing => {}
            Stamp::Unreadable => tally.doubt(point.at),
            Stamp::At(t) => given.push((i, t)),
        }
    }
    // A receiver of five points a second writes whole seconds: of points of one time the first
    // counts, as always.
    let all_given = given.len();
    given.dedup_by(|next, first| next.1 == first.1);
    let repeated = all_given - given.len();
    let unreadable = points.iter().filter(|point| point.stamp == Stamp::Unreadable).count();
    tally.stamped += given.len() + unreadable;
    let kept = in_order(&given);
    tally.used += kept.len();
    if let Some(&(i, _)) = first_missing(&given, &kept) {
        tally.doubt(points[i].at);
    }
    if given.is_empty() {
        tally.placed += unreadable;
        return at_even_speed(points);
    }
    let timed = between(points, &given, &kept, tally);
    tally.dropped += points.len() - timed.len() - repeated;
    let mut flown: Vec<Timed> = Vec::with_capacity(timed.len());
    for point in timed {
        // A receiver that stood still, or wrote a point twice.
        if flown.last().is_none_or(|last| last.t < point.t) {
            flown.push(point);
        }
    }
    flown
}

impl Tally {
    fn doubt(&mut self, at: At) {
        self.first = Some(self.first.map_or(at, |first| first.min(at)));
    }

    /// Whether too many times are unusable for a recording.
    pub(super) fn is_hopeless(&self) -> bool {
        2 * self.used < self.stamped
    }

    /// What was done about it, for people.
    pub(super) fn warning(&self) -> Option<String> {
        let Self { points, placed, dropped, .. } = *self;
        let first = self.first.map_or(String::new(), |at| format!(" (the first in {at})"));
        let of = |count: usize| format!("{count} of {points} points");
        match (placed, dropped) {
            (0, 0) => None,
            (_, 0) => Some(format!("{} have no time{first}: they are flown between their neighbours", of(placed))),
            (0, _) => Some(format!("{} have a time out of order{first}: passed over", of(dropped))),
            _ => Some(format!(
                "{} have no time or one out of order{first}: {dropped} are passed over, {placed} are flown between their \
                 neighbours",
                of(placed + dropped)
            )),
        }
    }
}

fn first_missing<'a>(given: &'a [(usize, f64)], kept: &[(usize, f64)]) -> Option<&'a (usize, f64)> {
    if given.len() == kept.len() {
        return None;
    }
    let mut indices: Vec<usize> = kept.iter().map(|(i, _)| *i).collect();
    indices.sort_unstable();
    let mut indices = indices.into_iter().peekable();
    given.iter().find(|(i, _)| indices.next_if_eq(i).is_none())
}

fn at_even_speed(points: &[Recorded]) -> Vec<Timed> {
    let mut timed: Vec<Timed> = Vec::with_capacity(points.len());
    for point in points {
        let t = timed.last().map_or(0.0, |last: &Timed| last.t + last.place.distance(point.place) / DEFAULT_SPEED);
        if timed.last().is_none_or(|last| last.t < t) {
            timed.push(Timed { t, place: point.place, height_m: point.height_m });
        }
    }
    timed
}

/// The points whose times are kept, in the order of their times, and those without time between
/// them.
fn between(points: &[Recorded], given: &[(usize, f64)], kept: &[(usize, f64)], tally: &mut Tally) -> Vec<Timed> {
    let timed = |i: usize, t: f64| Timed { t, place: points[i].place, height_m: points[i].height_m };
    let has_time = |i: usize| matches!(points[i].stamp, Stamp::At(_));
    let (Some(&first), Some(&last)) = (kept.first(), kept.last()) else { return Vec::new() };
    let way: f64 = kept.windows(2).map(|pair| points[pair[0].0].place.distance(points[pair[1].0].place)).sum();
    let seconds = last.1 - first.1;
    let speed = if seconds > 0.0 { (way / seconds).clamp(SPEEDS[0], SPEEDS[1]) } else { DEFAULT_SPEED };
    let mut out = Vec::with_capacity(points.len());
    // How many points up to each are kept: parts that were sorted have others of them between their
    // ends.
    let mut kept_before = vec![0u32; points.len() + 1];
    kept.iter().for_each(|(i, _)| kept_before[i + 1] = 1);
    (0..points.len()).for_each(|i| kept_before[i + 1] += kept_before[i]);

    // Before the first time, backwards.
    if given.first() == Some(&first) {
        let mut next = timed(first.0, first.1);
        for i in (0..first.0).rev() {
            next = timed(i, next.t - points[i].place.distance(next.place) / speed);
            out.push(next);
        }
        out.reverse();
    }
    for (k, &(i, t)) in kept.iter().enumerate() {
        out.push(timed(i, t));
        match kept.get(k + 1) {
            Some(&(next, until)) if next > i && kept_before[next] == kept_before[i + 1] => {
                let inner: Vec<usize> = (i + 1..next).filter(|&j| !has_time(j)).collect();
                place_by_distance(points, i, next, [t, until], &inner, &mut out);
            }
            // A part of the file ends here: what stands behind it without time has no place.
            Some(_) => {}
            None if given.last() == Some(&(i, t)) => {
                let mut before = timed(i, t);
                for (j, point) in points.iter().enumerate().skip(i + 1) {
                    before = timed(j, before.t + point.place.distance(before.place) / speed);
                    out.push(before);
                }
            }
            None => {}
        }
    }
    tally.placed += out.len() - kept.len();
    out
}

/// Points without time between two with one: by the distance along the way.
fn place_by_distance(
    points: &[Recorded],
    from: usize,
    to: usize,
    times: [f64; 2],
    inner: &[usize],
    out: &mut Vec<Timed>,
) {
    let stations: Vec<usize> = [&[from], inner, &[to]].concat();
    let steps: Vec<f64> = stations.windows(2).map(|p| points[p[0]].place.distance(points[p[1]].place)).collect();
    let all: f64 = steps.iter().sum();
    let mut way = 0.0;
    for (k, &i) in inner.iter().enumerate() {
        way += steps[k];
        let share = if all > 0.0 { way / all } else { (k + 1) as f64 / (inner.len() + 1) as f64 };
        let t = times[0] + (times[1] - times[0]) * share;
        out.push(Timed { t, place: points[i].place, height_m: points[i].height_m });
    }
}

/// The points whose times can be used, in the order of their times.
fn in_order(given: &[(usize, f64)]) -> Vec<(usize, f64)> {
    let mut points: Vec<(usize, f64)> = given.to_vec();
    without_far_ones(&mut points);
    let growing = longest_growing(&points);
    if growing.len() == points.len() {
        return growing;
    }
    // The parts between steps back, by their first times.
    let mut parts: Vec<&[(usize, f64)]> = points.chunk_by(|a, b| a.1 <= b.1).collect();
    if parts.len() > (points.len() / 10).max(2) {
        return growing;
    }
    parts.sort_by(|a, b| a[0].1.total_cmp(&b[0].1));
    let sorted = longest_growing(&parts.concat());
    if sorted.len() > growing.len() { sorted } else { growing }
}

/// Takes away the few points that are far in time from all the many others.
fn without_far_ones(points: &mut Vec<(usize, f64)>) {
    let mut sorted: Vec<f64> = points.iter().map(|(_, t)| *t).collect();
    sorted.sort_by(f64::total_cmp);
    let Some(step) = median(sorted.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0).collect())
    else {
        return;
    };
    let far = FAR_SECONDS.max(FAR_STEPS * step);
    let clusters: Vec<&[f64]> = sorted.chunk_by(|a, b| b - a <= far).collect();
    let largest = clusters.iter().map(|cluster| cluster.len()).max().unwrap_or(0);
    let few = (points.len() / 100).max(3);
    let bad: Vec<[f64; 2]> = clusters
        .iter()
        .filter(|cluster| cluster.len() <= few && 10 * cluster.len() < largest)
        .map(|cluster| [cluster[0], cluster[cluster.len() - 1]])
        .collect();
    if bad.is_empty() {
        return;
    }
    points.retain(|(_, t)| {
        let after = bad.partition_point(|range| range[1] < *t);
        bad.get(after).is_none_or(|range| *t < range[0])
    });
}

/// The middle value; `None` of no values.
pub(super) fn median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// The longest part, in this order, whose times grow; of points of one time the first (M. L.
/// Fredman, "On computing the length of longest increasing subsequences", 1975).
fn longest_growing(points: &[(usize, f64)]) -> Vec<(usize, f64)> {
    // Of each length the sequence that ends earliest, as the place of its last point.
    let mut ends: Vec<usize> = Vec::new();
    let mut before: Vec<Option<usize>> = Vec::with_capacity(points.len());
    for (i, (_, t)) in points.iter().enumerate() {
        let length = ends.partition_point(|&end| points[end].1.total_cmp(t) == Ordering::Less);
        before.push(length.checked_sub(1).map(|shorter| ends[shorter]));
        match ends.get_mut(length) {
            // One that ends at the same time already was there first.
            Some(end) if points[*end].1 == *t => {}
            Some(end) => *end = i,
            None => ends.push(i),
        }
    }
    let mut growing = Vec::with_capacity(ends.len());
    let mut at = ends.last().copied();
    while let Some(i) = at {
        growing.push(points[i]);
        at = before[i];
    }
    growing.reverse();
    growing
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A point every 10 s, 30 m apart.
    fn walk(count: usize) -> Vec<Recorded> {
        let point = |i: usize| Recorded {
            stamp: Stamp::At(1e9 + 10.0 * i as f64),
            place: DVec2::new(30.0 * i as f64, 0.0),
            height_m: None,
            at: At::Line(i as u32 + 1),
        };
        (0..count).map(point).collect()
    }

    fn timed(points: Vec<Recorded>) -> (Vec<Timed>, Tally) {
        let mut tally = Tally::default();
        let timed = with_times(&Segment { points }, &mut tally);
        assert!(timed.windows(2).all(|pair| pair[0].t < pair[1].t));
        (timed, tally)
    }

    fn seconds(timed: &[Timed]) -> f64 {
        timed.last().unwrap().t - timed[0].t
    }

    #[test]
    fn a_good_recording_is_kept_as_it_is() {
        let (points, tally) = timed(walk(60));
        assert_eq!((points.len(), seconds(&points), tally.warning()), (60, 590.0, None));
    }

    #[test]
    fn single_wrong_times_cost_their_points_alone() {
        let wrong: [(usize, f64); 6] =
            [(30, 1e9 + 289.0), (30, 1e9 + 350.0), (30, 2.3e9), (0, 3.2e8), (59, 4e9), (30, 1e9 + 300.0 + 3600.0)];
        for (i, t) in wrong {
            let mut points = walk(60);
            points[i].stamp = Stamp::At(t);
            let (points, tally) = timed(points);
            assert_eq!(points.len(), 59, "{i} {t}");
            assert!((580.0..=590.0).contains(&seconds(&points)), "{i} {t}: {}", seconds(&points));
            // Of two points that contradict each other alone, either may be the wrong one.
            assert!(
                tally.dropped == 1
                    && tally.first.is_some_and(|(At::Line(line) | At::Point(line))| line.abs_diff(i as u32 + 1) <= 1),
                "{i} {t}"
            );
            assert!(tally.warning().unwrap().contains("1 of 60 points have a time out of order"), "{tally:?}");
        }
    }

    #[test]
    fn points_without_time_lie_between_their_neighbours() {
        for (range, stamp) in
            [(0..31, Stamp::Missing), (5..6, Stamp::Unreadable), (20..40, Stamp::Missing), (50..60, Stamp::Missing)]
        {
            let mut points = walk(60);
            let count = range.len();
            points[range.clone()].iter_mut().for_each(|point| point.stamp = stamp);
            let (points, tally) = timed(points);
            assert_eq!((points.len(), tally.placed, tally.is_hopeless()), (60, count, false));
            assert!((seconds(&points) - 590.0).abs() < 1e-6, "{range:?}");
            assert!((points[range.start].t - points[0].t - 10.0 * range.start as f64).abs() < 1e-6);
        }
    }

    #[test]
    fn parts_out_of_order_are_sorted() {
        let mut points = walk(60);
        points.rotate_left(30);
        let (points, tally) = timed(points);
        assert_eq!((points.len(), seconds(&points), tally.warning()), (60, 590.0, None));
        assert!(points.windows(2).all(|pair| pair[0].place.x < pair[1].place.x));
    }

    #[test]
    fn no_times_are_an_even_speed_and_bad_ones_are_hopeless() {
        let mut points = walk(11);
        points.iter_mut().for_each(|point| point.stamp = Stamp::Missing);
        assert!((seconds(&timed(points.clone()).0) - 300.0 / DEFAULT_SPEED).abs() < 1e-9);
        points.iter_mut().for_each(|point| point.stamp = Stamp::Unreadable);
        assert!(timed(points).1.is_hopeless());
        let mut shuffled = walk(60);
        for (i, point) in shuffled.iter_mut().enumerate() {
            point.stamp = Stamp::At(1e9 + (i * 37 % 60) as f64);
        }
        let tally = timed(shuffled).1;
        assert!(tally.is_hopeless() && tally.first.is_some(), "{tally:?}");
    }

    #[test]
    fn a_point_a_day_is_a_recording_too() {
        let mut points = walk(30);
        for (i, point) in points.iter_mut().enumerate() {
            point.stamp = Stamp::At(1e9 + 86_400.0 * i as f64);
        }
        assert_eq!(timed(points).0.len(), 30);
    }

    proptest! {
        #[test]
        fn any_stamps_give_growing_finite_times(stamps in proptest::collection::vec((0u8..8, -1e10f64..1e10, 0f64..500.0), 0..80)) {
            let points: Vec<Recorded> = stamps.iter().enumerate().map(|(i, (kind, t, x))| Recorded {
                stamp: match kind { 0 => Stamp::Missing, 1 => Stamp::Unreadable, 2 => Stamp::At(*t), _ => Stamp::At(1e9 + 10.0 * i as f64) },
                place: DVec2::new(*x, 0.0),
                height_m: None,
                at: At::Line(1),
            }).collect();
            let count = points.len();
            let (timed, tally) = timed(points);
            prop_assert!(timed.iter().all(|point| point.t.is_finite()) && timed.len() <= count);
            prop_assert!(tally.dropped + tally.placed <= count && tally.used <= tally.stamped);
        }

        #[test]
        fn the_longest_growing_part_grows_and_none_is_longer(times in proptest::collection::vec(0u8..20, 0..12)) {
            let points: Vec<(usize, f64)> = times.iter().enumerate().map(|(i, t)| (i, f64::from(*t))).collect();
            let growing = longest_growing(&points);
            prop_assert!(growing.windows(2).all(|pair| pair[0].1 < pair[1].1 && pair[0].0 < pair[1].0));
            let mut best = vec![1; points.len()];
            for i in 0..points.len() {
                best[i] = 1 + (0..i).filter(|&j| points[j].1 < points[i].1).map(|j| best[j]).max().unwrap_or(0);
            }
            prop_assert_eq!(growing.len(), best.into_iter().max().unwrap_or(0));
        }
    }
}
