//! Vehicles of CZML and GeoJSON: where each is over time, and what it looks like
//! (docs/vehicles.md).

use super::crs::Georeference;
use super::spline::{Spline, slerp};
use super::{PathError, Remarks, czml, file, geojson, what_is};
use glam::{DQuat, DVec3};
use std::path::{Path, PathBuf};

/// A direction is that of the way this long before and after a moment, seconds.
const AROUND_S: f64 = 0.25;
/// A way that is shorter, metres, has no direction.
const SHORTEST_M: f64 = 1e-3;

/// What a vehicle's heights are above.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HeightReference {
    /// The world's vertical datum: an aircraft.
    Datum,
    /// It stands on the ground, whatever its file says of its height, and leans as the ground does.
    OnGround,
    /// The ground below it.
    AboveGround,
}

/// What a vehicle looks like.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Appearance {
    /// Its model, a file.
    pub model: Option<PathBuf>,
    /// Factor on the model's size.
    pub scale: Option<f64>,
    /// Side of the point that it is drawn as, pixels.
    pub point_px: Option<f64>,
    /// Colour of that point.
    pub rgb: Option<[u8; 3]>,
}

/// A vehicle.
#[derive(Debug, Clone)]
pub struct Vehicle {
    /// The vehicle, for messages: its place in its file.
    pub place: String,
    /// Its ways, in the order of time, with breaks between them.
    pub ways: Vec<Way>,
    /// What its heights are above.
    pub height: HeightReference,
    /// What it looks like.
    pub appearance: Appearance,
}

/// Where a vehicle is at a moment that its file tells of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moment {
    /// Seconds.
    pub t: f64,
    /// In the world's CRS.
    pub position: DVec3,
    /// The rotation from its axes (ahead, left, up) to east, north and up of the world's grid, if
    /// its file says it.
    pub attitude: Option<DQuat>,
}

/// A way without a break.
#[derive(Debug, Clone)]
pub struct Way {
    /// In the order of time, at least one.
    moments: Vec<Moment>,
    /// A smooth curve through them, of the time since the first number.
    curve: Option<(f64, Spline)>,
    /// It is there at all times.
    is_always: bool,
}

/// Where a vehicle is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placed {
    /// In the world's CRS.
    pub position: DVec3,
    /// As in [`Moment`].
    pub attitude: Option<DQuat>,
    /// Where it goes, not of length 1; `None` where it stands still all the way.
    pub ahead: Option<DVec3>,
}

impl Way {
    /// A way through these moments, in the order of time; `None` without any.
    #[must_use]
    pub fn new(moments: Vec<Moment>, curve: Option<(f64, Spline)>, is_always: bool) -> Option<Self> {
        (!moments.is_empty()).then_some(Self { moments, curve, is_always })
    }

    /// Its moments.
    #[must_use]
    pub fn moments(&self) -> &[Moment] {
        &self.moments
    }

    /// When it begins; `None` where it is there at all times.
    #[must_use]
    pub fn start(&self) -> Option<f64> {
        if self.is_always { None } else { self.moments.first().map(|moment| moment.t) }
    }

    fn span(&self) -> [f64; 2] {
        [self.moments.first(), self.moments.last()].map(|moment| moment.map_or(0.0, |moment| moment.t))
    }

    fn holds(&self, t: f64) -> bool {
        let [from, to] = self.span();
        self.is_always || (from..=to).contains(&t)
    }

    /// The moments before and after a time, and the share of the way between them.
    fn around(&self, t: f64) -> (usize, usize, f64) {
        let after = self.moments.partition_point(|moment| moment.t <= t).min(self.moments.len() - 1);
        let before = after.saturating_sub(1);
        let (from, to) = (self.moments[before].t, self.moments[after].t);
        (before, after, if to > from { ((t - from) / (to - from)).clamp(0.0, 1.0) } else { 0.0 })
    }

    fn position(&self, t: f64) -> DVec3 {
        if let Some((start, curve)) = &self.curve {
            return curve.pose(t - start).position;
        }
        let (before, after, share) = self.around(t);
        self.moments[before].position.lerp(self.moments[after].position, share)
    }

    fn attitude(&self, t: f64) -> Option<DQuat> {
        let (before, after, share) = self.around(t);
        let (from, to) = (self.moments[before].attitude?, self.moments[after].attitude?);
        Some(if share > 0.0 { slerp(from, to, share) } else { from })
    }

    /// The direction of the way at a time: where it rests, that in which it came, else in which it
    /// will go.
    fn ahead(&self, t: f64) -> Option<DVec3> {
        let [from, to] = self.span();
        let way = self.position((t + AROUND_S).min(to)) - self.position((t - AROUND_S).max(from));
        let has_length = |way: &DVec3| way.x.hypot(way.y) >= SHORTEST_M;
        if has_length(&way) {
            return Some(way);
        }
        let (_, after, _) = self.around(t);
        let step = |pair: &[Moment]| pair[1].position - pair[0].position;
        let before = self.moments[..=after].windows(2).rev().map(step).find(has_length);
        before.or_else(|| self.moments[after..].windows(2).map(step).find(has_length))
    }
}

impl Vehicle {
    /// Where it is at a time; `None` where it is not there.
    #[must_use]
    pub fn at(&self, t: f64) -> Option<Placed> {
        let way = self.ways.iter().find(|way| way.holds(t))?;
        Some(Placed { position: way.position(t), attitude: way.attitude(t), ahead: way.ahead(t) })
    }
}

/// Reads the vehicles of a file; what is to be said about it goes into `remarks`.
///
/// # Errors
/// [`PathError`], a sentence with the file and the place in it.
pub fn load(path: &Path, world: &Georeference, remarks: &mut Remarks) -> Result<Vec<Vehicle>, PathError> {
    let source = file::read(path)?;
    remarks.notes.extend(source.note);
    parse(&source.path, &source.text, world, remarks)
}

/// Reads a text; `path` is for messages, and what the file names is beside it.
///
/// # Errors
/// As [`load`].
pub fn parse(path: &Path, text: &str, world: &Georeference, remarks: &mut Remarks) -> Result<Vec<Vehicle>, PathError> {
    match text.trim_start().chars().next() {
        Some('[') => czml::read_vehicles(path, text, world, remarks),
        Some('{') if geojson::is_geojson(text) => geojson::read_vehicles(path, text, world, remarks),
        _ => Err(PathError::NoVehicles { path: path.to_owned(), found: what_is(text) }),
    }
}

#[cfg(test)]
mod tests;
