//! Bodies: ellipsoids of revolution.

use glam::{DMat3, DVec3};

/// An ellipsoid of revolution. Body-fixed positions are metres from its middle: x towards longitude 0
/// and y towards 90 degrees east, in the plane of the equator, z towards the north pole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ellipsoid {
    semi_major_m: f64,
    /// Square of the first eccentricity.
    e2: f64,
}

/// A place on a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Geodetic {
    /// Longitude, radians east.
    pub longitude: f64,
    /// Geodetic latitude, radians north: the angle of the vertical, not of the line to the middle.
    pub latitude: f64,
    /// Height above the ellipsoid, metres.
    pub height_m: f64,
}

impl Geodetic {
    /// Of longitude and latitude in degrees, and height.
    #[must_use]
    pub fn of_degrees(position: DVec3) -> Self {
        Self { longitude: position.x.to_radians(), latitude: position.y.to_radians(), height_m: position.z }
    }

    /// Longitude and latitude in degrees, and height.
    #[must_use]
    pub fn degrees(&self) -> DVec3 {
        DVec3::new(self.longitude.to_degrees(), self.latitude.to_degrees(), self.height_m)
    }
}

impl Ellipsoid {
    /// WGS 84.
    pub const EARTH: Self = Self::new(6_378_137.0, 1.0 / 298.257_223_563);
    /// The sphere of Mars of IAU 2015, above which its heights are mostly given.
    pub const MARS: Self = Self::new(3_396_190.0, 0.0);
    /// The Moon's sphere of IAU 2015.
    pub const MOON: Self = Self::new(1_737_400.0, 0.0);

    /// Of a semi-major axis, metres, and a flattening.
    #[must_use]
    pub const fn new(semi_major_m: f64, flattening: f64) -> Self {
        Self { semi_major_m, e2: flattening * (2.0 - flattening) }
    }

    /// The semi-major axis, metres: the radius of the equator.
    #[must_use]
    pub const fn semi_major_m(&self) -> f64 {
        self.semi_major_m
    }

    /// Distance from the middle to a pole, metres: no point of the ellipsoid is nearer.
    #[must_use]
    pub fn semi_minor_m(&self) -> f64 {
        self.semi_major_m * (1.0 - self.e2).sqrt()
    }

    /// Square of the first eccentricity.
    pub(super) const fn e2(&self) -> f64 {
        self.e2
    }

    /// Radius of curvature across the meridian, metres.
    #[must_use]
    pub fn prime_vertical_m(&self, latitude: f64) -> f64 {
        let sin = latitude.sin();
        self.semi_major_m / (1.0 - self.e2 * sin * sin).sqrt()
    }

    /// Radius of curvature along the meridian, metres.
    #[must_use]
    pub fn meridional_m(&self, latitude: f64) -> f64 {
        let sin = latitude.sin();
        self.semi_major_m * (1.0 - self.e2) / (1.0 - self.e2 * sin * sin).powf(1.5)
    }

    /// Distance from the axis and from the plane of the equator of the ellipsoid's point at a
    /// latitude, metres.
    #[must_use]
    pub(super) fn meridian(&self, latitude: f64) -> [f64; 2] {
        let (sin, cos) = latitude.sin_cos();
        let across = self.prime_vertical_m(latitude);
        [across * cos, across * (1.0 - self.e2) * sin]
    }

    /// The body-fixed position of a place.
    #[must_use]
    pub fn position(&self, place: Geodetic) -> DVec3 {
        let [from_axis, z] = self.meridian(place.latitude);
        let (sin, cos) = place.longitude.sin_cos();
        DVec3::new(from_axis * cos, from_axis * sin, z) + place.height_m * Self::up(place)
    }

    /// The direction in which height grows at a place, body-fixed.
    #[must_use]
    pub fn up(place: Geodetic) -> DVec3 {
        let ((sin_lon, cos_lon), (sin_lat, cos_lat)) = (place.longitude.sin_cos(), place.latitude.sin_cos());
        DVec3::new(cos_lat * cos_lon, cos_lat * sin_lon, sin_lat)
    }

    /// The directions east, north and up at a place, body-fixed: its columns. At a pole, where every
    /// direction is north or south, those of the place's longitude.
    #[must_use]
    pub fn east_north_up(place: Geodetic) -> DMat3 {
        let (sin, cos) = place.longitude.sin_cos();
        let (east, up) = (DVec3::new(-sin, cos, 0.0), Self::up(place));
        DMat3::from_cols(east, up.cross(east), up)
    }

    /// The place of a body-fixed position, to a nanometre and a billionth of a second of arc within
    /// a tenth of the radius below the ellipsoid and at any height above it; longitude within
    /// -180 to 180 degrees.
    #[must_use]
    pub fn place(&self, position: DVec3) -> Geodetic {
        // Bowring's formula, repeated: each time the parametric latitude's error shrinks by some
        // three orders.
        const REPEATS: usize = 4;
        let from_axis = position.x.hypot(position.y);
        let minor = self.semi_minor_m();
        let second_e2 = self.e2 / (1.0 - self.e2);
        let mut parametric = position.z.atan2(from_axis * (1.0 - self.e2).sqrt());
        let mut latitude = parametric;
        for _ in 0..REPEATS {
            let (sin, cos) = parametric.sin_cos();
            let rise = position.z + second_e2 * minor * sin.powi(3);
            let run = from_axis - self.e2 * self.semi_major_m * cos.powi(3);
            latitude = rise.atan2(run.max(0.0));
            parametric = ((1.0 - self.e2).sqrt() * latitude.sin()).atan2(latitude.cos());
        }
        let (sin, cos) = latitude.sin_cos();
        let height_m = from_axis * cos + position.z * sin - self.semi_major_m * (1.0 - self.e2 * sin * sin).sqrt();
        Geodetic { longitude: position.y.atan2(position.x), latitude, height_m }
    }
}
