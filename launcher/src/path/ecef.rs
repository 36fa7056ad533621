//! Places in Earth-fixed coordinates, in degrees as files give them, on the ellipsoid of a PROJ string.

use glam::{DMat3, DVec3};
use terravision_common::lonlat::proj_value;
use terravision_common::surface::globe;

/// The ellipsoid of a file's longitudes and latitudes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ellipsoid(globe::Ellipsoid);

/// A place: degrees, and metres above the ellipsoid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Geodetic {
    pub(super) longitude_deg: f64,
    pub(super) latitude_deg: f64,
    pub(super) height_m: f64,
}

impl Ellipsoid {
    pub(super) const WGS84: Self = Self(globe::Ellipsoid::EARTH);

    /// The ellipsoid of longitudes and latitudes in a PROJ string, where it is given by its size;
    /// else that of WGS 84.
    pub(super) fn of_lonlat(text: &str) -> Self {
        let number = |key| proj_value(text, key).and_then(|value| value.parse::<f64>().ok());
        let Some(a) = number("a").or(number("R")).filter(|a| *a > 0.0 && a.is_finite()) else { return Self::WGS84 };
        let inverse = number("rf").map(|rf| 1.0 / rf);
        let flattening = number("b").map(|b| 1.0 - b / a).or(inverse).or(number("f")).unwrap_or(0.0);
        Self(globe::Ellipsoid::new(a, if (0.0..0.5).contains(&flattening) { flattening } else { 0.0 }))
    }

    /// The place of a position; `None` within a tenth of the radius around the middle, where there
    /// is no sensible one.
    pub(super) fn geodetic_from_ecef(&self, position: DVec3) -> Option<Geodetic> {
        if !position.is_finite() || position.length() < 0.1 * self.0.semi_major_m() {
            return None;
        }
        let globe::Geodetic { longitude, latitude, height_m } = self.0.place(position);
        Some(Geodetic { longitude_deg: longitude.to_degrees(), latitude_deg: latitude.to_degrees(), height_m })
    }

    /// The position of a place.
    #[cfg(test)]
    pub(super) fn ecef_from_geodetic(&self, Geodetic { longitude_deg, latitude_deg, height_m }: Geodetic) -> DVec3 {
        self.0.position(globe::Geodetic { height_m, ..on_ellipsoid(longitude_deg, latitude_deg) })
    }
}

fn on_ellipsoid(longitude_deg: f64, latitude_deg: f64) -> globe::Geodetic {
    globe::Geodetic { longitude: longitude_deg.to_radians(), latitude: latitude_deg.to_radians(), height_m: 0.0 }
}

/// The directions east, north and up at a place, Earth-fixed, as columns.
pub(super) fn east_north_up(longitude_deg: f64, latitude_deg: f64) -> DMat3 {
    globe::Ellipsoid::east_north_up(on_ellipsoid(longitude_deg, latitude_deg))
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
        assert_eq!(Ellipsoid::of_lonlat("+proj=longlat +R=1737400 +no_defs"), Ellipsoid(globe::Ellipsoid::MOON));
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
