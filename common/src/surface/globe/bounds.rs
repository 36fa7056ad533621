//! What space the ground of a node may fill, and whether the body itself hides it.

use super::{Ellipsoid, Geodetic, Globe};
use crate::node::NodeId;
use crate::surface::WorldBox;
use glam::{DMat3, DVec3};
use std::f64::consts::{FRAC_PI_2, PI};

/// A box along the directions east, north and up of a node's middle, body-fixed, that all ground of
/// the node lies in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GlobeBounds {
    /// The node's middle on the ellipsoid.
    pub(super) middle: DVec3,
    /// Directions east, north and up there.
    pub(super) axes: DMat3,
    /// Lower and upper corner, along these.
    pub(super) low: DVec3,
    pub(super) high: DVec3,
    /// The largest angle between the direction of the middle and that of ground of the node, as seen
    /// from the body's own middle, radians.
    reach: f64,
    /// The highest ground, metres above the ellipsoid.
    pub(super) highest_m: f64,
    /// Distance from the axis of the ground that is farthest from it, metres, where the node is cut
    /// along longitude alone.
    pub(super) cut_by_columns: Option<f64>,
}

/// No body is as flat as this many times its own eccentricity makes directions differ.
const FLATTENING_MARGIN: f64 = 2.0;

/// Boxes are this much wider than they need to be, metres, because their corners are rounded.
const ROUNDING_M: f64 = 1e-6;

impl GlobeBounds {
    /// Of a node whose heights lie between these two, metres above the ellipsoid.
    #[must_use]
    pub fn new(globe: &Globe, node: NodeId, heights: [f64; 2]) -> Self {
        let [columns, rows] = globe.lattice().span(node);
        let made = Self::of_rectangle(globe, [columns.start, columns.end], [rows.start, rows.end], heights);
        let from_axis = [rows.start, rows.end].map(|row| globe.body().meridian(globe.latitude(row))[0]);
        let is_cut = node.q() <= globe.lattice().rows_level();
        Self { cut_by_columns: is_cut.then_some(from_axis[0].max(from_axis[1])), ..made }
    }

    /// Of a rectangle of the lattice within a node: columns and rows from, to.
    #[must_use]
    pub fn of_rectangle(globe: &Globe, columns: [u64; 2], rows: [u64; 2], [a, b]: [f64; 2]) -> Self {
        let body = globe.body();
        let heights = [a.min(b), a.max(b)];
        let [west, east] = columns.map(|column| globe.longitude(column));
        let latitudes = rows.map(|row| globe.latitude(row));
        let half_width = 0.5 * (east - west);
        let place =
            Geodetic { longitude: 0.5 * (west + east), latitude: 0.5 * (latitudes[0] + latitudes[1]), height_m: 0.0 };
        let (middle, axes) = (body.position(place), Ellipsoid::east_north_up(place));
        // No node is wider than half the body or in both hemispheres. So east is an edge where
        // parallels are longest, north is at corners or half way between them, up is highest above the
        // middle and lowest at corners.
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for latitude in latitudes {
            for height_m in heights {
                for longitude in [west, place.longitude, place.longitude + half_width.min(FRAC_PI_2)] {
                    let at = body.position(Geodetic { longitude, latitude, height_m });
                    let local = axes.transpose() * (at - middle);
                    (low, high) = (low.min(local), high.max(local));
                }
            }
        }
        (low.x, high.z) = (-high.x, high.z.max(heights[1]));
        let corner = |latitude: f64| {
            let up = Ellipsoid::up(Geodetic { longitude: east, latitude, height_m: 0.0 });
            up.angle_between(axes.z_axis)
        };
        // Directions from the middle of the body differ by a little more than verticals do.
        let widen = 1.0 + FLATTENING_MARGIN * body.e2();
        let reach = (widen * corner(latitudes[0]).max(corner(latitudes[1]))).min(PI);
        Self {
            middle,
            axes,
            low: low - ROUNDING_M,
            high: high + ROUNDING_M,
            reach,
            highest_m: heights[1],
            cut_by_columns: None,
        }
    }

    /// The middle of the node on the ellipsoid, body-fixed.
    #[must_use]
    pub fn middle(&self) -> DVec3 {
        self.middle
    }

    /// The largest coordinate of its corners along a body-fixed direction, from a body-fixed eye.
    #[must_use]
    pub fn most_along(&self, direction: DVec3, eye: DVec3) -> f64 {
        let along = self.axes.transpose() * direction;
        direction.dot(self.middle - eye) + (along * self.low).max(along * self.high).element_sum()
    }

    /// The smallest one.
    #[must_use]
    pub fn least_along(&self, direction: DVec3, eye: DVec3) -> f64 {
        -self.most_along(-direction, eye)
    }

    /// At most the distance from an eye, body-fixed and at this height above the ellipsoid, to the
    /// nearest place where ground may be, metres.
    #[must_use]
    pub fn distance_m(&self, eye: DVec3, eye_height_m: f64) -> f64 {
        let local = self.axes.transpose() * (eye - self.middle);
        let beside = (self.low - local).max(local - self.high).max(DVec3::ZERO);
        // Nothing is nearer than it is lower.
        beside.length().max(eye_height_m - self.highest_m)
    }

    /// Where a straight way, body-fixed, meets the box, widened by a margin on all sides.
    #[must_use]
    pub fn met_by(&self, start: DVec3, way: DVec3, margin: f64) -> Option<f64> {
        let to_box = self.axes.transpose();
        let bounds = WorldBox { min: self.low, max: self.high };
        bounds.met_by(to_box * (start - self.middle), to_box * way, margin)
    }

    /// How much narrower than nominally, 0 to 1, the node's cells need to be taken to be, for a
    /// body-fixed eye at this distance from it. Towards a pole the columns of a node that is cut along
    /// longitude alone are the closer together the nearer they are to the axis, and ground that is
    /// farther from the axis than the eye is at least as far away.
    #[must_use]
    pub fn narrowing(&self, eye: DVec3, distance_m: f64) -> f64 {
        let Some(widest) = self.cut_by_columns else { return 1.0 };
        let near = eye.truncate().length() + distance_m;
        if near < widest { near / widest } else { 1.0 }
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
        self.middle.angle_between(eye) - self.reach > seen
    }
}
