//! Vertices relative to an eye, of terms of their columns and their rows.
//!
//! In the eye's frame of directions east, north and up a point of the ellipsoid is separable: with `Δλ`
//! its longitude from the eye's, `φ` its latitude and `h` its height,
//!
//! ```text
//! per column: u = sin Δλ    v = 2 sin²(Δλ/2)
//! per row:    c = N cos φ   aₙ, aᵤ: the point at Δλ = 0, h = 0, north and up of the eye's foot
//!             k = cos φ     s = sin(φ − φₑ)   w = 2 sin²((φ − φₑ)/2)
//!
//! east  = c·u + h·k·u
//! north = aₙ + sin φₑ·c·v + h·(s + sin φₑ·k·v)
//! up    = aᵤ − cos φₑ·c·v + (h − hₑ) − h·(w + cos φₑ·k·v)
//! ```
//!
//! Terms are made in double precision and kept in single: nothing in these sums is a difference of
//! large numbers, so that a vertex is as exact as its distance from the eye in single precision.

use super::{Ellipsoid, Geodetic, Globe};
use glam::Vec3;

/// The terms that the vertices of a column share.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GlobeColumn {
    u: f32,
    v: f32,
}

/// The terms that the vertices of a row share, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GlobeRow {
    c: f32,
    a_north: f32,
    a_up: f32,
    k: f32,
    s: f32,
    w: f32,
}

/// A body as seen from an eye.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GlobeEye {
    body: Ellipsoid,
    eye: Geodetic,
    sin: f32,
    cos: f32,
}

impl GlobeColumn {
    /// Its numbers, for devices: u and v.
    #[must_use]
    pub const fn numbers(&self) -> [f32; 2] {
        [self.u, self.v]
    }
}

impl GlobeRow {
    /// Its numbers, for devices: c, aₙ, aᵤ, k, s and w.
    #[must_use]
    pub const fn numbers(&self) -> [f32; 6] {
        [self.c, self.a_north, self.a_up, self.k, self.s, self.w]
    }

    /// The same of a row all of whose points are one, on the axis.
    #[must_use]
    pub(crate) const fn on_axis(self) -> Self {
        Self { c: 0.0, k: 0.0, ..self }
    }
}

impl GlobeEye {
    /// Sine and cosine of its latitude, and its height above the ellipsoid.
    #[must_use]
    pub const fn numbers(&self) -> [f32; 3] {
        [self.sin, self.cos, self.eye.height_m as f32]
    }

    /// A body seen from a place.
    #[must_use]
    pub fn new(body: Ellipsoid, eye: Geodetic) -> Self {
        let (sin, cos) = eye.latitude.sin_cos();
        Self { body, eye, sin: sin as f32, cos: cos as f32 }
    }

    /// The terms of a longitude, radians.
    #[must_use]
    pub fn column(&self, longitude: f64) -> GlobeColumn {
        let by = longitude - self.eye.longitude;
        GlobeColumn { u: by.sin() as f32, v: versine(by) as f32 }
    }

    /// The terms of a latitude, radians.
    #[must_use]
    pub fn row(&self, latitude: f64) -> GlobeRow {
        let [from_axis, z] = self.body.meridian(latitude);
        let [eye_from_axis, eye_z] = self.body.meridian(self.eye.latitude);
        let (sin, cos) = self.eye.latitude.sin_cos();
        let (out, along) = (from_axis - eye_from_axis, z - eye_z);
        let by = latitude - self.eye.latitude;
        GlobeRow {
            c: from_axis as f32,
            a_north: (cos * along - sin * out) as f32,
            a_up: (cos * out + sin * along) as f32,
            k: latitude.cos() as f32,
            s: by.sin() as f32,
            w: versine(by) as f32,
        }
    }

    /// A vertex at a height above the ellipsoid: metres east, north and up of the eye.
    #[inline(always)]
    #[must_use]
    pub fn vertex(&self, column: GlobeColumn, row: GlobeRow, height_m: f32) -> Vec3 {
        self.vertex_above(column, row, (f64::from(height_m) - self.eye.height_m) as f32)
    }

    /// A vertex at a height above the eye: metres east, north and up of the eye.
    #[inline(always)]
    #[must_use]
    pub fn vertex_above(&self, column: GlobeColumn, row: GlobeRow, above: f32) -> Vec3 {
        let (u, v, h) = (column.u, column.v, above + self.eye.height_m as f32);
        let (around, leans) = (row.c * v, row.k * v);
        Vec3::new(
            row.c * u + h * (row.k * u),
            row.a_north + self.sin * around + h * (row.s + self.sin * leans),
            (row.a_up - self.cos * around) + above - h * (row.w + self.cos * leans),
        )
    }

    /// The same of a lattice point of a globe of this body: equal to the bit, whichever node names it.
    #[must_use]
    pub fn lattice_vertex(&self, globe: &Globe, point: [u64; 2], height_m: f32) -> Vec3 {
        self.vertex(globe.eye_column(self, point[0]), globe.eye_row(self, point[1]), height_m)
    }
}

/// 1 − cos, exact for small angles.
fn versine(angle: f64) -> f64 {
    let half = (0.5 * angle).sin();
    2.0 * half * half
}
