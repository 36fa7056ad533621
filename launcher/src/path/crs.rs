//! From a path's coordinates to the world's.
//!
//! The launcher does without GDAL: `proj4rs` knows the usual projections, and EPSG codes by their PROJ strings. Only
//! easting and northing are transformed; heights stay as they are.

use glam::DVec2;
use proj4rs::Proj;
use std::fmt;

/// Why coordinates cannot be brought into the world's CRS. Each is a whole sentence.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CrsError {
    /// The path's CRS is unknown.
    #[error(
        "the CRS {found:?} is not known here: expected EPSG:N or a PROJ string; or give the path in the world's CRS, {world}"
    )]
    Unknown {
        /// As the path has it.
        found: String,
        /// Name of the world's CRS.
        world: String,
    },
    /// The world's CRS has no form that this program can compute with.
    #[error(
        "the world's CRS, {world}, has no PROJ string, so a path in {found} cannot be brought into it; give the path in the world's CRS"
    )]
    NoWorldCrs {
        /// CRS of the path.
        found: String,
        /// Name of the world's CRS.
        world: String,
    },
    /// The world's PROJ string is wrong, or needs what is not here: grids of a datum.
    #[error("the world's PROJ string {text:?} is not understood ({source}); give the path in the world's own CRS")]
    BadWorldCrs {
        /// The string.
        text: String,
        /// Why.
        #[source]
        source: proj4rs::errors::Error,
    },
    /// A position has no place in the world's CRS.
    #[error("the position {x}, {y} ({from}) has no place in the world's CRS, {world}: {source}")]
    NoPlace {
        /// First coordinate as given.
        x: f64,
        /// Second coordinate as given.
        y: f64,
        /// CRS of the path.
        from: String,
        /// Name of the world's CRS.
        world: String,
        /// Why.
        #[source]
        source: proj4rs::errors::Error,
    },
}

/// The CRS that a world is in.
pub struct Georeference {
    name: String,
    epsg: Option<u32>,
    /// The PROJ string. Whether it is understood matters only to paths in another CRS: that of a datum with grids (NAD27) is not.
    proj4: Option<String>,
}

impl fmt::Debug for Georeference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, epsg, proj4 } = self;
        f.debug_struct("Georeference").field("name", name).field("epsg", epsg).field("proj4", proj4).finish()
    }
}

/// Brings positions and headings from another CRS into the world's.
pub struct Transform {
    from_name: String,
    from: Proj,
    to_name: String,
    to: Proj,
}

impl fmt::Debug for Transform {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Transform").field("from", &self.from_name).field("to", &self.to_name).finish()
    }
}

impl Georeference {
    /// The CRS of that name, given by a PROJ string or an EPSG code; without both no other CRS can be brought into it.
    #[must_use]
    pub fn new(name: String, epsg: Option<u32>, proj4: Option<&str>) -> Self {
        Self { name, epsg, proj4: proj4.map(str::to_owned) }
    }

    /// What it means; `None` when nothing tells.
    fn proj(&self) -> Result<Option<Proj>, CrsError> {
        match (&self.proj4, self.epsg) {
            (Some(text), _) => {
                let bad = |source| CrsError::BadWorldCrs { text: text.clone(), source };
                Proj::from_proj_string(text).map(Some).map_err(bad)
            }
            (None, Some(epsg)) => Ok(proj_from_epsg(epsg)),
            (None, None) => Ok(None),
        }
    }

    /// Name of the CRS, for messages.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// From longitude and latitude in degrees: WGS 84 on Earth, the body's own ellipsoid elsewhere.
    ///
    /// # Errors
    /// [`CrsError::NoWorldCrs`] or [`CrsError::BadWorldCrs`].
    pub fn from_lonlat(&self) -> Result<Transform, CrsError> {
        let name = "longitude and latitude";
        let lonlat = lonlat_of_body(self.proj4.as_deref().unwrap_or_default());
        let from = Proj::from_proj_string(&lonlat);
        self.transform_from(name, from.map_err(|source| CrsError::BadWorldCrs { text: lonlat, source })?)
    }

    /// Longitude and latitude, degrees, of a position in the world's CRS; `None` where it has none. WGS 84 on Earth as far as
    /// the world's datum is known, the body's own ellipsoid elsewhere.
    #[must_use]
    pub fn lonlat_at(&self, [x, y]: [f64; 2]) -> Option<[f64; 2]> {
        let from = self.proj().ok()??;
        let to = Proj::from_proj_string(&lonlat_of_body(self.proj4.as_deref().unwrap_or_default())).ok()?;
        let mut point = (x, y, 0.0);
        proj4rs::transform::transform(&from, &to, &mut point).ok()?;
        let found = [point.0.to_degrees(), point.1.to_degrees()];
        found.iter().all(|v| v.is_finite()).then_some(found)
    }

    /// From a CRS that a path names; `None` when it is the world's own.
    ///
    /// # Errors
    /// [`CrsError::Unknown`], [`CrsError::NoWorldCrs`] or [`CrsError::BadWorldCrs`].
    pub fn from_crs(&self, crs: &str) -> Result<Option<Transform>, CrsError> {
        let unknown = || CrsError::Unknown { found: super::shorten(crs), world: self.name.clone() };
        if crs.trim() == self.name || self.proj4.as_deref() == Some(crs.trim()) {
            return Ok(None);
        }
        let from = if let Some(epsg) = epsg_code(crs) {
            if self.epsg == Some(epsg) {
                return Ok(None);
            }
            proj_from_epsg(epsg).ok_or_else(unknown)?
        } else if crs.trim_start().starts_with('+') {
            match Proj::from_proj_string(crs.trim()) {
                Ok(proj) => proj,
                Err(_reason) => return Err(unknown()),
            }
        } else {
            return Err(unknown());
        };
        self.transform_from(crs, from).map(Some)
    }

    fn transform_from(&self, from_name: &str, from: Proj) -> Result<Transform, CrsError> {
        let from_name = super::shorten(from_name);
        match self.proj()? {
            Some(to) => Ok(Transform { from_name, from, to_name: self.name.clone(), to }),
            None => Err(CrsError::NoWorldCrs { found: from_name, world: self.name.clone() }),
        }
    }
}

impl Transform {
    /// A position in the world's CRS. Geographic coordinates are degrees, longitude first.
    ///
    /// # Errors
    /// [`CrsError::NoPlace`].
    pub fn position(&self, x: f64, y: f64) -> Result<DVec2, CrsError> {
        let no_place = |source| {
            let (from, world) = (self.from_name.clone(), self.to_name.clone());
            CrsError::NoPlace { x, y, from, world, source }
        };
        let mut point = if self.from.is_latlong() {
            if x.abs() > 540.0 || y.abs() > 90.0 {
                return Err(no_place(proj4rs::errors::Error::LatOrLongExceedLimit));
            }
            (x.to_radians(), y.to_radians())
        } else {
            (x, y)
        };
        proj4rs::transform::transform(&self.from, &self.to, &mut point).map_err(no_place)?;
        if self.to.is_latlong() {
            point = (point.0.to_degrees(), point.1.to_degrees());
        }
        if !(point.0.is_finite() && point.1.is_finite()) {
            return Err(no_place(proj4rs::errors::Error::NanCoordinateValue));
        }
        Ok(DVec2::new(point.0, point.1))
    }

    /// A heading in the world's CRS: what was north there is not quite north here (meridian convergence).
    ///
    /// # Errors
    /// [`CrsError::NoPlace`].
    pub fn heading(&self, x: f64, y: f64, heading_rad: f64) -> Result<f64, CrsError> {
        // A step of about a metre; along a geographic coordinate a degree is 111 km.
        let step = if self.from.is_latlong() { 1e-5 } else { 1.0 };
        // Away from the pole, so that the step never leaves the sphere.
        let sign = if self.from.is_latlong() && y > 89.9 { -1.0 } else { 1.0 };
        let north = (self.position(x, y + sign * step)? - self.position(x, y)?) * sign;
        Ok(heading_rad + north.x.atan2(north.y))
    }
}

fn proj_from_epsg(epsg: u32) -> Option<Proj> {
    Proj::from_epsg_code(u16::try_from(epsg).ok()?).ok()
}

/// The N of `EPSG:N`, `urn:ogc:def:crs:EPSG::N`, `OGC:CRS84` and their like.
fn epsg_code(text: &str) -> Option<u32> {
    let text = text.trim().to_ascii_uppercase();
    if text.ends_with("CRS84") {
        return Some(4326);
    }
    text.contains("EPSG").then(|| text.rsplit([':', '/']).next()?.parse().ok()).flatten()
}

/// PROJ string of longitude and latitude on the body of this PROJ string. A path's longitudes and latitudes on Earth
/// are WGS 84 whatever the world's datum; other bodies have one ellipsoid, the world's own.
fn lonlat_of_body(text: &str) -> String {
    let value = |key: &str| {
        text.split_whitespace().find_map(|word| word.strip_prefix('+')?.strip_prefix(key)?.strip_prefix('='))
    };
    let radius: Option<f64> = value("a").or(value("R")).and_then(|a| a.parse().ok());
    match radius {
        Some(radius) if !(6.3e6..6.4e6).contains(&radius) => {
            let shape: Vec<&str> = text
                .split_whitespace()
                .filter(|word| ["+a=", "+b=", "+R=", "+rf=", "+f=", "+es="].iter().any(|key| word.starts_with(key)))
                .collect();
            format!("+proj=longlat {} +no_defs", shape.join(" "))
        }
        _ => "+proj=longlat +datum=WGS84 +no_defs".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn utm10() -> Georeference {
        Georeference::new("WGS 84 / UTM zone 10N".into(), Some(32610), None)
    }

    #[test]
    fn utm_positions_agree_with_proj() {
        // echo -122 45 | proj +proj=utm +zone=10 +datum=WGS84 gives 578815.30 4983436.77
        let point = utm10().from_lonlat().unwrap().position(-122.0, 45.0).unwrap();
        assert!((point - DVec2::new(578_815.30, 4_983_436.77)).length() < 0.01, "{point}");
    }

    #[test]
    fn a_position_has_its_longitude_and_latitude() {
        let [lon, lat] = utm10().lonlat_at([578_815.30, 4_983_436.77]).unwrap();
        assert!((lon + 122.0).abs() < 1e-6 && (lat - 45.0).abs() < 1e-6, "{lon} {lat}");
    }

    #[test]
    fn north_turns_with_the_meridian() {
        // Convergence: (lon - central meridian) * sin(lat) = 1 * sin(45 deg) = 0.707 deg east of grid north... to the
        // first order; east of the central meridian true north lies to the west of grid north.
        let heading = utm10().from_lonlat().unwrap().heading(-122.0, 45.0, 0.0).unwrap();
        assert!((heading.to_degrees() + 0.707).abs() < 0.001, "{}", heading.to_degrees());
        let polar = utm10().from_lonlat().unwrap().heading(-123.0, 90.0, 0.5).unwrap();
        assert!((polar - 0.5).abs() < 1e-6);
    }

    #[test]
    fn the_own_crs_needs_no_transform_and_others_do() {
        let world = utm10();
        for own in ["EPSG:32610", "epsg:32610", "urn:ogc:def:crs:EPSG::32610", "WGS 84 / UTM zone 10N"] {
            assert!(world.from_crs(own).unwrap().is_none(), "{own}");
        }
        let zone11 = world.from_crs("EPSG:32611").unwrap().unwrap();
        let lonlat = world.from_lonlat().unwrap();
        let there = Georeference::new("11".into(), Some(32611), None).from_lonlat().unwrap();
        let p11 = there.position(-120.0, 40.0).unwrap();
        assert!((zone11.position(p11.x, p11.y).unwrap() - lonlat.position(-120.0, 40.0).unwrap()).length() < 1e-3);
    }

    #[test]
    fn another_body_has_its_own_longitudes() {
        let text = "+proj=eqc +lat_ts=0 +lat_0=0 +lon_0=137 +x_0=0 +y_0=0 +R=3396190 +units=m +no_defs";
        let mars = Georeference::new("Mars".into(), None, Some(text));
        let point = mars.from_lonlat().unwrap().position(138.0, -1.0).unwrap();
        let degree_m = 3_396_190.0 * std::f64::consts::PI / 180.0;
        assert!((point - DVec2::new(degree_m, -degree_m)).length() < 0.01, "{point}");
    }

    #[test]
    fn what_cannot_be_transformed_is_said_in_a_sentence() {
        let nameless = Georeference::new("local grid".into(), None, None);
        assert!(nameless.from_lonlat().unwrap_err().to_string().contains("has no PROJ string"));
        for crs in ["EPSG:1", "EPSG:99999999999", "EPSG:", "mars", "+proj=nonsense", ""] {
            assert!(utm10().from_crs(crs).unwrap_err().to_string().contains("not known here"), "{crs}");
        }
        assert!(utm10().from_lonlat().unwrap().position(10.0, 95.0).is_err());
        assert!(Georeference::new("x".into(), None, Some("+proj=rubbish")).from_lonlat().is_err());
        // A datum whose grids are not here is no obstacle to a path in the world's own CRS.
        let nad27 =
            Georeference::new("NAD27 / UTM zone 10N".into(), Some(26710), Some("+proj=utm +zone=10 +datum=NAD27"));
        assert!(nad27.from_crs("EPSG:26710").unwrap().is_none());
        let message = nad27.from_crs("EPSG:32610").unwrap_err().to_string();
        assert!(message.contains("the world's own CRS"), "{message}");
    }

    proptest! {
        #[test]
        fn foreign_positions_never_panic(x in proptest::num::f64::ANY, y in proptest::num::f64::ANY, crs in "\\PC{0,30}") {
            drop(utm10().from_lonlat().unwrap().position(x, y));
            drop(utm10().from_crs(&crs));
            drop(Georeference::new(String::new(), None, Some(&crs)).from_lonlat());
        }
    }
}
