//! Where a point of the ground with a height is, and what is under a position.

use super::{Column, Plane, Row};
use crate::surface::LatticePoint;
use glam::{DVec2, DVec3};

/// Positions, world coordinates: metres.
impl Plane {
    /// The term that the vertices of a column share.
    #[inline(always)]
    #[must_use]
    pub fn column(&self, lattice: u64) -> Column {
        lattice as f64 * self.unit_m
    }

    /// The term that the vertices of a row share.
    #[inline(always)]
    #[must_use]
    pub fn row(&self, lattice: u64) -> Row {
        lattice as f64 * self.unit_m
    }

    /// The position of a vertex: of its column, its row, and its height.
    #[inline(always)]
    #[must_use]
    pub fn vertex(&self, point: LatticePoint, height_m: f64) -> DVec3 {
        DVec3::new(self.column(point.x), self.row(point.y), height_m)
    }

    /// The foot of a place on the lattice, in lattice units.
    #[inline(always)]
    #[must_use]
    pub fn foot_of_lattice(&self, lattice: DVec2) -> DVec2 {
        lattice * self.unit_m
    }

    /// The place of a foot on the lattice, in lattice units.
    #[inline(always)]
    #[must_use]
    pub fn lattice_of_foot(&self, foot: DVec2) -> DVec2 {
        foot / self.unit_m
    }

    /// The vector from the foot of an eye to a place on the lattice, in lattice units.
    #[inline(always)]
    #[must_use]
    pub fn lattice_from_eye(&self, lattice: DVec2, eye: DVec3) -> DVec2 {
        self.foot_of_lattice(lattice) - self.foot(eye)
    }

    /// The place on the lattice, in lattice units, at this vector from the foot of an eye.
    #[inline(always)]
    #[must_use]
    pub fn lattice_of_way(&self, way: DVec2, eye: DVec3) -> DVec2 {
        self.lattice_of_foot(way + self.foot(eye))
    }

    /// The point of the surface under (or over) a position.
    #[inline(always)]
    #[must_use]
    pub fn foot(&self, position: DVec3) -> DVec2 {
        position.truncate()
    }

    /// The height of a position.
    #[inline(always)]
    #[must_use]
    pub fn height_m(&self, position: DVec3) -> f64 {
        position.z
    }

    /// Height of a position above ground of this height below it.
    #[inline(always)]
    #[must_use]
    pub fn height_above(&self, position: DVec3, ground_m: f64) -> f64 {
        position.z - ground_m
    }

    /// The position over a foot at a height.
    #[inline(always)]
    #[must_use]
    pub fn position(&self, foot: DVec2, height_m: f64) -> DVec3 {
        foot.extend(height_m)
    }

    /// The direction in which height grows.
    #[inline(always)]
    #[must_use]
    pub fn up(&self, _position: DVec3) -> DVec3 {
        DVec3::Z
    }

    /// The unit normal of ground at a foot that rises by this much over a cell of level `q`, metres
    /// east and north: east, north and up in the local frame of the foot.
    #[inline]
    #[must_use]
    pub fn normal(&self, _foot: DVec2, q: u8, [per_east, per_north]: [f64; 2]) -> DVec3 {
        let spacing_m = self.spacing_m(q);
        DVec3::new(-per_east, -per_north, spacing_m).normalize()
    }

    /// The lattice point south west of a position, clamped to the extent.
    #[inline]
    #[must_use]
    pub fn lattice_under(&self, position: DVec3) -> LatticePoint {
        // Casts of negative numbers give 0.
        let [x, y] = [position.x, position.y].map(|v| (v / self.unit_m) as u64);
        LatticePoint { x, y }
    }

    /// The corner of the world that is farthest from its origin.
    #[inline]
    #[must_use]
    pub fn end(&self) -> DVec2 {
        DVec2::from_array(self.extent.map(|e| f64::from(e) * self.unit_m))
    }

    /// Whether there is ground, or a hole in it, at a foot.
    #[inline]
    #[must_use]
    pub fn holds(&self, foot: DVec2) -> bool {
        let end = self.end();
        foot.x >= 0.0 && foot.y >= 0.0 && foot.x <= end.x && foot.y <= end.y
    }

    /// Whether a position is over (or under) the world. An eye beside the world may look below its
    /// edge.
    #[inline]
    #[must_use]
    pub fn is_over(&self, position: DVec3) -> bool {
        self.holds(self.foot(position))
    }
}
