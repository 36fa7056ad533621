//! A surface as seen from an eye.

use super::globe::GlobeFrame;
use super::{Column, NodeBounds, PlaneFrame, Row, Sight, WorldBox};
use glam::{DMat3, DVec3, Vec3};

/// Distances and depths of points of the surface from an eye. The same inputs give the same bits in
/// every process.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum EyeFrame {
    /// Of a plane.
    Plane(PlaneFrame),
    /// Of a body.
    Globe(GlobeFrame),
}

/// The space that the ground of a node may fill, relative to an eye: metres along its directions east,
/// north and up.
#[derive(Debug, Clone, Copy)]
pub enum EyeBox {
    /// A box along these directions.
    Aligned(WorldBox),
    /// A box along others.
    Turned {
        /// Where they begin.
        middle: DVec3,
        /// The directions.
        axes: DMat3,
        /// Along these.
        bounds: WorldBox,
    },
    /// Without bounds.
    Everywhere,
}

impl EyeBox {
    /// The largest coordinate of its corners along a direction.
    #[inline]
    #[must_use]
    pub fn most_along(&self, direction: DVec3) -> f64 {
        match self {
            Self::Aligned(bounds) => bounds.most_along(direction),
            Self::Turned { middle, axes, bounds } => {
                direction.dot(*middle) + bounds.most_along(axes.transpose() * direction)
            }
            Self::Everywhere => f64::INFINITY,
        }
    }
}

impl EyeFrame {
    /// The eye, world coordinates.
    #[inline]
    #[must_use]
    pub fn eye(&self) -> DVec3 {
        match self {
            Self::Plane(frame) => frame.eye(),
            Self::Globe(frame) => frame.eye(),
        }
    }

    /// Depth and distances of the point at a row, a column and a height (exaggerated).
    #[inline(always)]
    #[must_use]
    pub fn sight(&self, row: &Row, column: &Column, height_m: f64) -> Sight {
        match self {
            Self::Plane(frame) => frame.sight(frame.row(row.x), column.x, height_m),
            Self::Globe(frame) => frame.sight(row, column, height_m),
        }
    }

    /// Bounds over the points of a node: the smallest depth and distances, and the largest difference
    /// in height.
    #[must_use]
    pub fn bound(&self, bounds: &NodeBounds) -> Sight {
        match (self, bounds) {
            (Self::Plane(frame), NodeBounds::Plane(bounds, _)) => frame.bound(bounds),
            (Self::Globe(frame), NodeBounds::Globe(bounds)) => frame.bound(bounds),
            _ => Sight { depth: 0.0, horizontal2: 0.0, vertical2: 0.0, distance2: 0.0 },
        }
    }

    /// Levels by which a node may be coarser than its bounds tell, because its posts are closer
    /// together where it is near.
    #[must_use]
    pub fn narrower_by_levels(&self, bounds: &NodeBounds) -> f64 {
        match (self, bounds) {
            (Self::Globe(frame), NodeBounds::Globe(bounds)) => -frame.narrowing(bounds).max(1e-30).log2(),
            _ => 0.0,
        }
    }

    /// The bounds of a node relative to the eye.
    #[inline]
    #[must_use]
    pub fn box_from_eye(&self, bounds: &NodeBounds) -> EyeBox {
        match (self, bounds) {
            (Self::Plane(frame), NodeBounds::Plane(bounds, _)) => EyeBox::Aligned(bounds.seen_from(frame.eye())),
            (Self::Globe(frame), NodeBounds::Globe(bounds)) => frame.box_from_eye(bounds),
            _ => EyeBox::Everywhere,
        }
    }

    /// Whether the body itself hides all ground of a node, if none of its ground is lower than this.
    #[must_use]
    pub fn is_behind_limb(&self, bounds: &NodeBounds, lowest_m: f64) -> bool {
        match (self, bounds) {
            (Self::Globe(frame), NodeBounds::Globe(bounds)) => frame.is_behind_limb(bounds, lowest_m),
            _ => false,
        }
    }

    /// A height (exaggerated) as stored in elevation arrays: metres above the eye.
    #[inline(always)]
    #[must_use]
    pub fn height_from_eye(&self, height_m: f64) -> f32 {
        match self {
            Self::Plane(frame) => frame.height_from_eye(height_m),
            Self::Globe(frame) => (height_m - frame.eye().z) as f32,
        }
    }

    /// A position in single precision, metres from the eye.
    #[inline(always)]
    #[must_use]
    pub fn from_eye(&self, position: DVec3) -> Vec3 {
        match self {
            Self::Plane(frame) => frame.from_eye(position),
            Self::Globe(frame) => frame.from_eye(position),
        }
    }

    /// The way to a position, metres east, north and up of the eye.
    #[must_use]
    pub fn way_to(&self, position: DVec3) -> DVec3 {
        match self {
            Self::Plane(frame) => position - frame.eye(),
            Self::Globe(frame) => frame.way_to(position),
        }
    }

    /// How much higher a position is than the eye is over it, along the position's own vertical: of a
    /// way to it, metres.
    #[must_use]
    pub fn rise_of(&self, position: DVec3, way: DVec3) -> f64 {
        match self {
            Self::Plane(_) => way.z,
            Self::Globe(frame) => way.dot(frame.up_at(position)),
        }
    }
}
