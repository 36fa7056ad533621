//! Conversion between a database's CRS and world coordinates.

use glam::{DVec2, DVec3};

/// The position of a world in its database's CRS. A place in the CRS is easting, northing and
/// height.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CrsFrame {
    /// The world's origin.
    origin: DVec2,
}

impl CrsFrame {
    /// For a world whose origin has this easting and northing.
    #[inline]
    #[must_use]
    pub const fn new([easting, northing]: [f64; 2]) -> Self {
        Self { origin: DVec2::new(easting, northing) }
    }

    /// Easting and northing of the world's origin.
    #[inline]
    #[must_use]
    pub const fn origin(&self) -> [f64; 2] {
        [self.origin.x, self.origin.y]
    }

    /// The foot of a place.
    #[inline]
    #[must_use]
    pub fn foot(&self, place: DVec2) -> DVec2 {
        place - self.origin
    }

    /// The place of a foot.
    #[inline]
    #[must_use]
    pub fn place_of_foot(&self, foot: DVec2) -> DVec2 {
        self.origin + foot
    }

    /// The position of a place with its height.
    #[inline]
    #[must_use]
    pub fn position(&self, place: DVec3) -> DVec3 {
        place - self.origin.extend(0.0)
    }

    /// The place of a position, with its height.
    #[inline]
    #[must_use]
    pub fn place(&self, position: DVec3) -> DVec3 {
        self.origin.extend(0.0) + position
    }
}
