//! A body as seen from an eye: distances and depths of points.

use super::{Geodetic, Globe, GlobeBounds, GlobeEye};
use crate::surface::{Column, EyeBox, Row, Sight, WorldBox};
use glam::{DMat3, DVec3, Vec3};

/// Distances and depths of points of a body's ground from an eye. The same inputs give the same bits
/// in every process.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GlobeFrame {
    globe: Globe,
    /// The eye: longitude and latitude, degrees, and height.
    eye: DVec3,
    /// Body-fixed.
    position: DVec3,
    /// Directions east, north and up at the eye, body-fixed.
    axes: DMat3,
    forward: DVec3,
    terms: GlobeEye,
}

impl GlobeFrame {
    /// Of an eye (degrees and metres) that looks along a unit vector of its directions east, north
    /// and up.
    #[must_use]
    pub fn new(globe: &Globe, eye: DVec3, forward: DVec3) -> Self {
        let place = Geodetic::of_degrees(eye);
        let axes = super::Ellipsoid::east_north_up(place);
        let body = *globe.body();
        Self {
            globe: *globe,
            eye,
            position: body.position(place),
            axes,
            forward: axes * forward,
            terms: GlobeEye::new(body, place),
        }
    }

    /// The eye: longitude and latitude, degrees, and height.
    #[inline]
    #[must_use]
    pub fn eye(&self) -> DVec3 {
        self.eye
    }

    /// Vertices relative to the eye.
    #[inline]
    #[must_use]
    pub fn terms(&self) -> &GlobeEye {
        &self.terms
    }

    /// Depth and distances of the point at a row, a column and a height.
    #[inline(always)]
    #[must_use]
    pub fn sight(&self, row: &Row, column: &Column, height_m: f64) -> Sight {
        let from_axis = row.x + height_m * row.from_axis;
        let way = DVec3::new(from_axis * column.x, from_axis * column.y, row.y + height_m * row.along) - self.position;
        let up = way.dot(self.axes.z_axis);
        let (vertical2, distance2) = (up * up, way.length_squared());
        Sight { depth: way.dot(self.forward), horizontal2: (distance2 - vertical2).max(0.0), vertical2, distance2 }
    }

    /// Bounds over the points of a box: the smallest depth and distances, and the largest difference
    /// in height.
    #[must_use]
    pub fn bound(&self, bounds: &GlobeBounds) -> Sight {
        let distance_m = bounds.distance_m(self.position, self.eye.z);
        let up = |at: f64| at * at;
        let (least, most) =
            (bounds.least_along(self.axes.z_axis, self.position), bounds.most_along(self.axes.z_axis, self.position));
        let vertical2 = up(least).max(up(most));
        let distance2 = distance_m * distance_m;
        Sight {
            depth: bounds.least_along(self.forward, self.position),
            horizontal2: (distance2 - vertical2).max(0.0),
            vertical2,
            distance2,
        }
    }

    /// [`GlobeBounds::narrowing`] for this eye.
    #[must_use]
    pub fn narrowing(&self, bounds: &GlobeBounds) -> f64 {
        bounds.narrowing(self.position, bounds.distance_m(self.position, self.eye.z))
    }

    /// A box relative to the eye.
    #[must_use]
    pub fn box_from_eye(&self, bounds: &GlobeBounds) -> EyeBox {
        let to_eye = self.axes.transpose();
        EyeBox::Turned {
            middle: to_eye * (bounds.middle - self.position),
            axes: to_eye * bounds.axes,
            bounds: WorldBox { min: bounds.low, max: bounds.high },
        }
    }

    /// [`GlobeBounds::is_behind_limb`] for this eye.
    #[must_use]
    pub fn is_behind_limb(&self, bounds: &GlobeBounds, lowest_m: f64) -> bool {
        bounds.is_behind_limb(self.globe.body(), self.position, lowest_m)
    }

    /// The way to a position (degrees and metres), metres east, north and up of the eye.
    #[must_use]
    pub fn way_to(&self, position: DVec3) -> DVec3 {
        self.axes.transpose() * (self.globe.body().position(Geodetic::of_degrees(position)) - self.position)
    }

    /// The same in single precision.
    #[must_use]
    pub fn from_eye(&self, position: DVec3) -> Vec3 {
        self.way_to(position).as_vec3()
    }

    /// The vertical of a position, in the eye's directions.
    #[must_use]
    pub fn up_at(&self, position: DVec3) -> DVec3 {
        self.axes.transpose() * super::Ellipsoid::up(Geodetic::of_degrees(position))
    }
}
