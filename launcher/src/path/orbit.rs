//! The built-in path: around the point of the world with the strongest relief, or around a place
//! that was asked for.
//!
//! Radius, height and pitch follow from the relief, so that the mountain fills the picture, and
//! from the distance of elevation posts, so that these do not. The path depends on the world and on
//! what was asked for alone.
//!
//! The camera stays over the world: where a whole round would leave it, the camera swings to and
//! fro on the side that does not.

use super::{CameraPath, Course, Ground, PathSettings, Pose};
use crate::machine::grouped;
use glam::{DVec2, DVec3};
use std::f64::consts::TAU;
use terravision_common::surface;

/// Frames of one round.
pub const ROUND_FRAMES: usize = 240;
/// Lattice on which relief is looked for: this many points along the longer side of the world.
const GRID: usize = 96;
/// Points of the camera's round at which it is held above ground and over the world.
const ROUND_POINTS: usize = 72;
/// A round of which less than this share lies over the world is flown whole, partly outside.
const LEAST_SWING: f64 = 0.15;
/// Share of the part of a round over the world that is swung through.
const SWING_SHARE: f64 = 0.55;
/// Near the border a mountain is taken if its relief is this many times that of the best one
/// farther in.
const BORDER_FACTOR: f64 = 1.25;
/// Of mountains near the border the highest is taken whose relief is at least this share of the
/// strongest.
const NEARLY_STRONGEST: f64 = 0.8;
/// Posts are at most this many pixels apart where the camera looks, in a picture of 720 lines and
/// 60 degrees.
const MAX_POST_PX: f64 = 20.0;
/// Focal length of that picture, pixels.
const REFERENCE_FOCAL_PX: f64 = 360.0 * 1.732_050_807_568_877_2;
/// Where a round begins, turns counted counter-clockwise from east: in the south west, where the
/// light comes from behind.
const FIRST_TURN: f64 = 0.625;

/// The extent of a world: south west and north east corner in its CRS.
#[derive(Debug, Clone, Copy)]
pub struct Extent {
    /// South west corner.
    pub low: DVec2,
    /// North east corner.
    pub high: DVec2,
}

impl Extent {
    /// Width and height.
    #[must_use]
    pub fn size(&self) -> DVec2 {
        self.high - self.low
    }

    /// How far a position lies outside, metres; 0 inside.
    #[must_use]
    pub fn distance(&self, place: DVec2) -> f64 {
        (self.low - place).max(place - self.high).max(DVec2::ZERO).length()
    }

    /// How far a position inside is from the border, metres; negative outside.
    fn depth(&self, place: DVec2) -> f64 {
        (place - self.low).min(self.high - place).min_element()
    }
}

/// What is asked of an orbit.
#[derive(Debug, Clone, Copy)]
pub struct OrbitWishes {
    /// What it turns around, in the world's CRS; else the strongest relief.
    pub around: Option<DVec2>,
    /// Distance of the camera from there, level, metres; else it follows from the relief.
    pub radius_m: Option<f64>,
    /// Height of the camera above the ground there, metres; else it follows from the radius.
    pub height_m: Option<f64>,
    /// Rounds, counter-clockwise; clockwise if negative.
    pub turns: f64,
    /// Distance of the world's finest elevation posts, metres.
    pub post_spacing_m: f64,
}

impl OrbitWishes {
    /// Nothing is asked; posts are so far apart.
    #[must_use]
    pub fn usual(post_spacing_m: f64) -> Self {
        Self { around: None, radius_m: None, height_m: None, turns: 1.0, post_spacing_m }
    }
}

/// What an orbit turns around.
#[derive(Debug, Clone, Copy)]
struct Mountain {
    /// The ground in its middle.
    summit: DVec3,
    /// How much heights differ around it, metres.
    relief: f64,
}

/// An orbit, and why it is this one.
#[derive(Debug)]
pub struct Orbit {
    /// The path.
    pub path: CameraPath,
    /// Where it turns and why, a sentence.
    pub note: String,
}

/// The orbit of a world.
#[must_use]
pub fn orbit(extent: &Extent, ground: &dyn Ground, wishes: &OrbitWishes) -> Orbit {
    let shorter = extent.size().min_element();
    // The camera flies inside the world, and sees enough of it behind the target.
    let largest = 0.22 * shorter;
    let survey = Survey::new(extent, ground, 0.5 * largest);
    let (mountain, why) = match wishes.around {
        Some(place) => {
            let height = ground.height_m(place.x, place.y).unwrap_or(0.0);
            (Mountain { summit: place.extend(height), relief: survey.relief_at(place) }, String::new())
        }
        None => survey.strongest(ground, 1.1 * largest),
    };
    let Mountain { summit, relief } = mountain;
    // Half-way up the mountain is the middle of the picture; a place that was asked for is it
    // itself.
    let target = if wishes.around.is_some() { summit } else { summit - DVec3::Z * 0.45 * relief };
    let eye_z = |radius: f64| match wishes.height_m {
        Some(height) => summit.z + height,
        None => usual_height(ground, target, relief, radius),
    };
    // Six reliefs away a mountain is some 10 degrees high: with the slopes before it, it fills the
    // picture.
    let wanted = wishes.radius_m.unwrap_or((6.0 * relief).clamp(0.4 * largest, largest));
    let mut radius = wanted;
    let mut notes = why;
    if wishes.radius_m.is_none() {
        let nearest = wishes.post_spacing_m * REFERENCE_FOCAL_PX / MAX_POST_PX;
        let slant = |radius: f64| radius.hypot(eye_z(radius) - target.z);
        if slant(radius) < nearest {
            radius *= nearest / slant(radius);
            notes += &format!("; {} away, as elevation posts are {} m apart", metres(radius), wishes.post_spacing_m);
        }
    }
    let round = Round { centre: target.truncate(), radius };
    let swing = round.swing(extent, ground);
    notes += &match swing {
        Swing::Whole => String::new(),
        Swing::Outside => "; parts of it are outside of the world, which is too small for it".to_owned(),
        Swing::Arc { middle, .. } => format!(
            "; it swings to and fro in the {} of it, as the world ends {} from there",
            compass(middle),
            metres(extent.depth(round.centre).max(0.0))
        ),
    };
    let eye_z = eye_z(radius);
    let frames = (ROUND_FRAMES as f64 * wishes.turns.abs()).round().max(1.0) as usize;
    let poses = (0..frames).map(|frame| {
        let turn = frame as f64 / ROUND_FRAMES as f64 * wishes.turns.signum();
        let eye = round.at(swing.turn(turn)).extend(eye_z);
        let sight = target - eye;
        Pose { position: eye, heading_rad: surface::heading(sight), pitch_rad: surface::pitch(sight), roll_rad: 0.0 }
    });
    let path = CameraPath { settings: PathSettings::default(), course: Course::Round(poses.collect()) };
    let note = format!(
        "the orbit turns around {:.0}, {:.0} ({} high), {} from it and {} above it{notes}{}",
        summit.x,
        summit.y,
        metres(summit.z),
        metres(radius),
        metres(eye_z - summit.z),
        if wishes.around.is_some() { "" } else { "; --around X,Y chooses another place" }
    );
    Orbit { path, note }
}

/// High enough to look into the valleys behind, never lower than a third of the relief above what
/// is flown over.
fn usual_height(ground: &dyn Ground, target: DVec3, relief: f64, radius: f64) -> f64 {
    let round = Round { centre: target.truncate(), radius };
    let clearance = (0..ROUND_POINTS)
        .filter_map(|i| {
            let place = round.at(i as f64 / ROUND_POINTS as f64);
            ground.height_m(place.x, place.y)
        })
        .fold(target.z, f64::max);
    (target.z + 0.55 * radius).max(clearance + 0.33 * relief).max(clearance + 0.1 * radius)
}

/// The circle that the camera is on. Turns count from east, counter-clockwise.
struct Round {
    centre: DVec2,
    radius: f64,
}

/// Which part of it is flown.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Swing {
    /// All of it, over the world.
    Whole,
    /// All of it, though parts are outside.
    Outside,
    /// To and fro around a turn, by half the arc to both sides.
    Arc { middle: f64, half: f64 },
}

impl Round {
    fn at(&self, turn: f64) -> DVec2 {
        self.centre + DVec2::from_angle(turn * TAU) * self.radius
    }

    fn swing(&self, extent: &Extent, ground: &dyn Ground) -> Swing {
        let is_over: Vec<bool> = (0..ROUND_POINTS)
            .map(|i| {
                let place = self.at(i as f64 / ROUND_POINTS as f64);
                // Over ground that was made up within the data, too: mountains in radar data are
                // full of it.
                extent.distance(place) == 0.0 && ground.height_m(place.x, place.y).is_some()
            })
            .collect();
        if is_over.iter().all(|over| *over) {
            return Swing::Whole;
        }
        // The longest run of points over the world, around the end of the list too.
        let run_from = |first: usize| (0..ROUND_POINTS).take_while(|k| is_over[(first + k) % ROUND_POINTS]).count();
        let longest = (0..ROUND_POINTS)
            .map(|first| (run_from(first), first))
            .max_by_key(|(run, first)| (*run, ROUND_POINTS - first));
        match longest {
            Some((run, first)) if run as f64 >= LEAST_SWING * ROUND_POINTS as f64 => {
                // Well inside of the first point and the last: there half the picture would lie
                // beyond the border.
                let half = 0.5 * (run - 1) as f64 / ROUND_POINTS as f64;
                Swing::Arc { middle: (first as f64 / ROUND_POINTS as f64 + half).fract(), half: SWING_SHARE * half }
            }
            _ => Swing::Outside,
        }
    }
}

impl Swing {
    /// The turn of the circle at which the camera is, after this many turns of the flight.
    fn turn(self, turn: f64) -> f64 {
        match self {
            Self::Whole | Self::Outside => turn + FIRST_TURN,
            Self::Arc { middle, half } => middle - half * (turn * TAU).cos(),
        }
    }
}

/// Heights on a lattice over the world.
struct Survey<'a> {
    extent: &'a Extent,
    columns: usize,
    rows: usize,
    spacing: DVec2,
    heights: Vec<f64>,
    /// Half the side of the window in which relief is measured, lattice steps.
    window: usize,
    window_m: f64,
}

impl<'a> Survey<'a> {
    fn new(extent: &'a Extent, ground: &dyn Ground, window_m: f64) -> Self {
        let size = extent.size();
        let step = size.max_element() / (GRID - 1) as f64;
        let count = |length: f64| ((length / step).floor() as usize).max(1) + 1;
        let (columns, rows) = (count(size.x), count(size.y));
        let spacing = DVec2::new(size.x / (columns - 1) as f64, size.y / (rows - 1) as f64);
        let mut survey = Self { extent, columns, rows, spacing, heights: Vec::new(), window: 0, window_m };
        survey.window = ((window_m / step).round() as usize).max(1);
        survey.heights = (0..rows * columns)
            .map(|k| {
                let place = survey.place(k % columns, k / columns).min(extent.high);
                let is_measured = ground.is_measured(place.x, place.y);
                ground.height_m(place.x, place.y).filter(|_| is_measured).unwrap_or(f64::NAN)
            })
            .collect();
        survey
    }

    fn place(&self, i: usize, j: usize) -> DVec2 {
        self.extent.low + DVec2::new(i as f64, j as f64) * self.spacing
    }

    /// The lowest and the highest height around a lattice point, and where the highest is; infinite
    /// without heights.
    fn around(&self, i: usize, j: usize) -> (f64, f64, (usize, usize)) {
        let (mut low, mut high, mut peak) = (f64::INFINITY, f64::NEG_INFINITY, (i, j));
        for y in j.saturating_sub(self.window)..self.rows.min(j + self.window + 1) {
            for x in i.saturating_sub(self.window)..self.columns.min(i + self.window + 1) {
                let height = self.heights[y * self.columns + x];
                low = low.min(height);
                if height > high {
                    (high, peak) = (height, (x, y));
                }
            }
        }
        (low, high, peak)
    }

    /// How much heights differ around a place, metres.
    fn relief_at(&self, place: DVec2) -> f64 {
        let at = ((place - self.extent.low) / self.spacing).round().max(DVec2::ZERO);
        let (low, high, _) = self.around((at.x as usize).min(self.columns - 1), (at.y as usize).min(self.rows - 1));
        if (high - low).is_finite() { high - low } else { 0.0 }
    }

    /// The summits: points that are the highest of what is around them.
    fn summits(&self) -> Vec<Mountain> {
        let points = (0..self.rows * self.columns).map(|k| (k % self.columns, k / self.columns));
        points
            .filter_map(|(i, j)| {
                let (low, high, peak) = self.around(i, j);
                let summit = self.place(i, j).extend(self.heights[j * self.columns + i]);
                (peak == (i, j) && (high - low).is_finite()).then_some(Mountain { summit, relief: high - low })
            })
            .collect()
    }

    /// The mountain to fly around, and why. One at least `reach` inside of the border is preferred,
    /// round which there is ground to see behind it.
    fn strongest(&self, ground: &dyn Ground, reach: f64) -> (Mountain, String) {
        let summits = self.summits();
        let shorter = self.extent.size().min_element();
        let depth = |m: &Mountain| self.extent.depth(m.summit.truncate());
        let mut inner: Option<(f64, Mountain)> = None;
        for mountain in summits.iter().filter(|m| depth(m) >= reach) {
            let score = mountain.relief * (0.5 + depth(mountain) / shorter);
            if inner.is_none_or(|(other, _)| score > other) {
                inner = Some((score, *mountain));
            }
        }
        let strongest = summits.iter().map(|m| m.relief).fold(0.0, f64::max);
        let within = |m: &Mountain| format!("{} within {}", metres(m.relief), metres(self.window_m));
        let mountain = match inner {
            Some((_, mountain)) if mountain.relief * BORDER_FACTOR >= strongest => mountain,
            _ => {
                let near = summits.iter().filter(|m| m.relief >= NEARLY_STRONGEST * strongest && m.relief > 0.0);
                match near.max_by(|a, b| a.summit.z.total_cmp(&b.summit.z)) {
                    Some(mountain) => self.climbed(*mountain, ground),
                    None => {
                        let middle = (self.extent.low + self.extent.high) * 0.5;
                        let height = ground.height_m(middle.x, middle.y).unwrap_or(0.0);
                        let why = ", the middle of the world, as no mountain stands out".to_owned();
                        return (Mountain { summit: middle.extend(height), relief: 0.0 }, why);
                    }
                }
            }
        };
        let mut why = format!(", for the relief around it ({})", within(&mountain));
        let highest = summits.iter().max_by(|a, b| a.summit.z.total_cmp(&b.summit.z));
        if let Some(highest) = highest.filter(|h| h.summit.z > mountain.summit.z + 1.0) {
            let at = highest.summit;
            let place = format!("{:.0}, {:.0} ({} high)", at.x, at.y, metres(at.z));
            why += &format!("; {place} is higher, but has {} only or lies nearer to the border", within(highest));
        }
        (mountain, why)
    }

    /// A mountain with its summit where the ground is highest within a lattice step of it.
    fn climbed(&self, mountain: Mountain, ground: &dyn Ground) -> Mountain {
        const STEPS: i32 = 20;
        let mut best = mountain.summit;
        for k in 0..(2 * STEPS + 1) * (2 * STEPS + 1) {
            let offset = DVec2::new(f64::from(k % (2 * STEPS + 1) - STEPS), f64::from(k / (2 * STEPS + 1) - STEPS));
            let place = mountain.summit.truncate() + offset / f64::from(STEPS) * self.spacing;
            let place = place.clamp(self.extent.low, self.extent.high);
            if let Some(height) = ground.height_m(place.x, place.y).filter(|height| *height > best.z) {
                best = place.extend(height);
            }
        }
        Mountain { summit: best, relief: mountain.relief + best.z - mountain.summit.z }
    }
}

/// A length for people.
fn metres(length: f64) -> String {
    if length.abs() >= 20_000.0 { format!("{:.0} km", length / 1e3) } else { format!("{} m", grouped(length)) }
}

/// The part of the compass in which a turn, counted counter-clockwise from east, lies.
fn compass(turn: f64) -> &'static str {
    const NAMES: [&str; 8] = ["east", "north east", "north", "north west", "west", "south west", "south", "south east"];
    NAMES[(turn.rem_euclid(1.0) * 8.0).round() as usize % 8]
}

#[cfg(test)]
mod tests;
