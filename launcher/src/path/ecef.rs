//! Places in Earth-fixed coordinates: metres from the middle of the ellipsoid, x towards longitude
//! 0, y towards 90 degrees east, z towards the north pole.

use glam::{DMat3, DVec3};
use terravision_common::lonlat::proj_value;

/// An ellipsoid of revolution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ellipsoid {
    semi_major_m: f64,
    /// Square of the first eccentricity.
    e2: f64,
}

/// A place: degrees, and metres above the ellipsoid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Geodetic {
    pub(super) longitude_deg: f64,
    pub(super) latitude_deg: f64,
    pub(super) height_m: f64,
}

impl Ellipsoid {
    pub(super) const WGS84: Self = Self::new(6_378_137.0, 1.0 / 298.257_223_563);

    const fn new(semi_major_m: f64, flattening: f64) -> Self {
        Self { semi_major_m, e2: flattening * (2.0 - flattening) }
    }

    /// The ellipsoid of longitudes and latitudes in a PROJ string, where it is given by its size;
    /// else that of WGS 84.
    pub(super) fn of_lonlat(text: &str) -> Self {
        let number = |key| proj_value(text, key).and_then(|value| value.parse::<f64>().ok());
        let Some(a) = number("a").or(number("R")).filter(|a| *a > 0.0 && a.is_finite()) else { return Self::WGS84 };
        let inverse = number("rf").map(|rf| 1.0 / rf);
        let flattening = number("b").map(|b| 1.0 - b / a).or(inverse).or(number("f")).unwrap_or(0.0);
        Self::new(a, if (0.0..0.5).contains(&flattening) { flattening } else { 0.0 })
    }

    /// The place of a position; `None` within a tenth of the radius around the middle, where there
    /// is no sensible one.
    pub(super) fn geodetic_from_ecef(&self, position: DVec3) -> Option<Geodetic> {
        // Bowring, "Transformation from spatial to geographical coordinates", 1976; each repetition
        // shrinks the error some thousand times.
        const REPEATS: usize = 4;
        if !position.is_finite() || position.length() < 0.1 * self.semi_major_m {
            return None;
        }
        let from_axis = position.x.hypot(position.y);
        let minor_ratio = (1.0 - self.e2).sqrt();
        let mut parametric = position.z.atan2(from_axis * minor_ratio);
        let mut latitude = parametric;
        for _ in 0..REPEATS {
            let (sin, cos) = parametric.sin_cos();
            let rise = position.z + self.e2 / minor_ratio * self.semi_major_m * sin.powi(3);
            let run = from_axis - self.e2 * self.semi_major_m * cos.powi(3);
            latitude = rise.atan2(run.max(0.0));
            parametric = (minor_ratio * latitude.sin()).atan2(latitude.cos());
        }
        let (sin, cos) = latitude.sin_cos();
        let height_m = from_axis * cos + position.z * sin - self.semi_major_m * (1.0 - self.e2 * sin * sin).sqrt();
        let longitude_deg = position.y.atan2(position.x).to_degrees();
        Some(Geodetic { longitude_deg, latitude_deg: latitude.to_degrees(), height_m })
    }

    /// The position of a place.
    #[cfg(test)]
    pub(super) fn ecef_from_geodetic(&self, place: Geodetic) -> DVec3 {
        let up = east_north_up(place.longitude_deg, place.latitude_deg).z_axis;
        let across = self.semi_major_m / (1.0 - self.e2 * up.z * up.z).sqrt();
        up * DVec3::new(across, across, across * (1.0 - self.e2)) + up * place.height_m
    }
}

/// The directions east, north and up at a place, Earth-fixed, as columns.
pub(super) fn east_north_up(longitude_deg: f64, latitude_deg: f64) -> DMat3 {
    let (sin_lon, cos_lon) = longitude_deg.to_radians().sin_cos();
    let (sin_lat, cos_lat) = latitude_deg.to_radians().sin_cos();
    let east = DVec3::new(-sin_lon, cos_lon, 0.0);
    let up = DVec3::new(cos_lat * cos_lon, cos_lat * sin_lon, sin_lat);
    DMat3::from_cols(east, up.cross(east), up)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_known_place_is_found() {
        // The example of EPSG's guidance note 7-2, geographic/geocentric conversions.
        let place = Ellipsoid::WGS84.geodetic_from_ecef(DVec3::new(3_771_793.968, 140_253.342, 5_124_304.349)).unwrap();
        assert!((place.latitude_deg - (53.0 + 48.0 / 60.0 + 33.82 / 3600.0)).abs() < 1e-7, "{place:?}");
        assert!((place.longitude_deg - (2.0 + 7.0 / 60.0 + 46.38 / 3600.0)).abs() < 1e-7, "{place:?}");
        assert!((place.height_m - 73.0).abs() < 2e-3, "{place:?}");
        let pole = Ellipsoid::WGS84.geodetic_from_ecef(DVec3::new(0.0, 0.0, -6_356_752.314_245)).unwrap();
        assert!((pole.latitude_deg + 90.0).abs() < 1e-12 && pole.height_m.abs() < 1e-6, "{pole:?}");
        assert_eq!(Ellipsoid::WGS84.geodetic_from_ecef(DVec3::new(1000.0, 0.0, 0.0)), None);
    }

    #[test]
    fn a_body_has_its_own_ellipsoid() {
        assert_eq!(Ellipsoid::of_lonlat("+proj=longlat +datum=WGS84 +no_defs"), Ellipsoid::WGS84);
        assert_eq!(Ellipsoid::of_lonlat("+proj=longlat +R=1737400 +no_defs"), Ellipsoid::new(1_737_400.0, 0.0));
        let mars = Ellipsoid::of_lonlat("+proj=longlat +a=3396190 +b=3376200 +no_defs");
        let pole = mars.geodetic_from_ecef(DVec3::new(0.0, 0.0, 3_376_300.0)).unwrap();
        assert!((pole.height_m - 100.0).abs() < 1e-6, "{pole:?}");
    }

    proptest! {
        #[test]
        fn there_and_back(lon in -180.0..180.0, lat in -90.0..=90.0, height in -5e5..5e7) {
            let place = Geodetic { longitude_deg: lon, latitude_deg: lat, height_m: height };
            let position = Ellipsoid::WGS84.ecef_from_geodetic(place);
            let found = Ellipsoid::WGS84.geodetic_from_ecef(position).unwrap();
            let back = Ellipsoid::WGS84.ecef_from_geodetic(found);
            prop_assert!(back.distance(position) < 1e-6, "{place:?} {found:?}");
            prop_assert!((found.latitude_deg - lat).abs() < 1e-10 && (found.height_m - height).abs() < 1e-6);
        }

        #[test]
        fn east_north_and_up_are_a_right_handed_frame(lon in -180.0..180.0, lat in -90.0..90.0) {
            let frame = east_north_up(lon, lat);
            prop_assert!((frame.determinant() - 1.0).abs() < 1e-12);
            prop_assert!((frame.transpose() * frame).abs_diff_eq(DMat3::IDENTITY, 1e-12));
            prop_assert!(frame.y_axis.z >= 0.0);
        }
    }
}
