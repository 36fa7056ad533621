//! What space the ground of a node may fill, and whether the body itself hides it.

use super::{Ellipsoid, Globe};
use crate::node::NodeId;
use glam::DVec3;
use std::f64::consts::PI;

/// A ball that all ground of a node lies in, body-fixed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NodeBall {
    /// Its middle, metres from the body's.
    pub middle: DVec3,
    /// Metres.
    pub radius_m: f64,
    /// Direction of its middle, and the largest angle between that and ground of the node, radians.
    direction: DVec3,
    reach: f64,
    /// The highest ground, metres above the ellipsoid.
    highest_m: f64,
}

/// No body is as flat as this many times its own eccentricity makes directions differ.
const FLATTENING_MARGIN: f64 = 2.0;

impl NodeBall {
    /// Of a node whose heights lie between these two, metres above the ellipsoid.
    #[must_use]
    pub fn new(globe: &Globe, node: NodeId, [a, b]: [f64; 2]) -> Self {
        let body = globe.body();
        let (lowest, highest) = (a.min(b), a.max(b));
        let [columns, rows] = globe.lattice().span(node);
        let [west, east] = [columns.start, columns.end].map(|column| globe.longitude(column));
        let latitudes = [rows.start, rows.end].map(|row| globe.latitude(row));
        let longitude = 0.5 * (west + east);
        let mut place = super::Geodetic { longitude, latitude: 0.5 * (latitudes[0] + latitudes[1]), height_m: 0.0 };
        place.height_m = 0.5 * (lowest + highest);
        let middle = body.position(place);
        // The direction of a point is furthest from the middle's at a corner, or, of a node that is
        // wider than half the body, beyond the pole.
        let up = Ellipsoid::up(place);
        let half_width = 0.5 * (east - west);
        let corner = latitudes.map(|latitude| {
            let at = super::Geodetic { longitude: east, latitude, height_m: 0.0 };
            Ellipsoid::up(at).angle_between(up)
        });
        // Directions from the middle of the body differ by a little more than verticals do.
        let widen = 1.0 + FLATTENING_MARGIN * body.e2();
        let widest = if half_width < 0.5 * PI { corner[0].max(corner[1]) } else { PI };
        let reach = (widen * widest).min(PI);
        let from_middle = middle.length();
        let [inner, outer] = [body.semi_minor_m() + lowest, body.semi_major_m() + highest];
        let spans = latitudes.map(|latitude| body.position(super::Geodetic { latitude, ..place }).length());
        let flat = (spans[0] - spans[1]).abs().max(body.e2() * body.semi_major_m() * reach.min(1.0));
        let half_height = 0.5 * (highest - lowest);
        let [near, far] =
            [(from_middle - half_height - flat).max(inner), (from_middle + half_height + flat).min(outer)];
        let cos = reach.cos();
        let square = |length: f64| from_middle * from_middle + length * length - 2.0 * from_middle * length * cos;
        let radius_m = square(near).max(square(far)).max(0.0).sqrt();
        Self { middle, radius_m, direction: middle.normalize_or(DVec3::Z), reach, highest_m: highest }
    }

    /// At most the distance from a body-fixed eye to the nearest place where ground may be, metres.
    #[must_use]
    pub fn distance_m(&self, body: &Ellipsoid, eye: DVec3) -> f64 {
        // Nothing is nearer than it is lower.
        let above = body.place(eye).height_m - self.highest_m;
        ((eye - self.middle).length() - self.radius_m).max(above).max(0.0)
    }

    /// Whether the body hides the node from a body-fixed eye, whatever its ground is like, as long as
    /// no ground of the body is lower than `lowest_m` above the ellipsoid.
    #[must_use]
    pub fn is_behind_limb(&self, body: &Ellipsoid, eye: DVec3, lowest_m: f64) -> bool {
        let inscribed = body.semi_minor_m() + lowest_m;
        let eye_m = eye.length();
        if inscribed <= 0.0 || eye_m <= inscribed {
            return false;
        }
        // Tangents to the inscribed ball reach so far beyond the horizon, in the eye's direction and
        // in that of the highest ground.
        let outer = (body.semi_major_m() + self.highest_m).max(inscribed);
        let seen = (inscribed / eye_m).acos() + (inscribed / outer).acos();
        self.direction.angle_between(eye) - self.reach > seen
    }
}
