//! Converts longitude and latitude to a world's plane like PROJ, but without PROJ.
//!
//! `proj4rs` implements projections, but has neither PROJ's database of datum shifts nor its grids.
//! Where that matters, ingest, which uses PROJ, tabulates the difference ([`LonLatTable`]), and the
//! launcher adds it to the result of `proj4rs` ([`Projection`]).

use crate::bug::contained;
use proj4rs::Proj;
use proj4rs::errors::Error;
use serde::{Deserialize, Serialize};

/// Longitude and latitude of WGS 84, as a PROJ string.
pub const WGS84_LONLAT: &str = "+proj=longlat +datum=WGS84 +no_defs";
/// Maximum number of nodes of a table along one side.
pub const MAX_SIDE: usize = 33;
/// The error of a PROJ string at which `proj4rs` panics.
const NO_NUMBER: Error = Error::InvalidParameterValue("a value is not a number");

/// A coordinate system that `proj4rs` supports.
#[derive(Clone)]
pub struct Projection(Proj);

impl std::fmt::Debug for Projection {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Projection").field(&self.0.projname()).finish()
    }
}

impl Projection {
    /// Reads a PROJ string.
    ///
    /// # Errors
    /// When `proj4rs` does not support it.
    pub fn parse(text: &str) -> Result<Self, Error> {
        // `proj4rs` 0.3.0 panics at characters of several bytes within an angle, such as 45°30'.
        // Others have no meaning in a number and do no harm in a name.
        let ascii = |letter: char| match letter {
            '°' => 'd',
            _ if letter.is_ascii() => letter,
            _ => '?',
        };
        let text: String = text.chars().map(ascii).collect();
        contained(|| Proj::from_proj_string(&text)).unwrap_or(Err(NO_NUMBER)).map(Self)
    }

    /// The system of an EPSG code; `None` when `proj4rs` does not know it.
    #[must_use]
    pub fn of_epsg(epsg: u32) -> Option<Self> {
        Proj::from_epsg_code(u16::try_from(epsg).ok()?).ok().map(Self)
    }

    /// Whether coordinates are longitude and latitude.
    #[must_use]
    pub fn is_lonlat(&self) -> bool {
        self.0.is_latlong()
    }

    /// Coordinates of this system in another one. Longitude and latitude are degrees, longitude
    /// first.
    ///
    /// # Errors
    /// When they cannot be converted.
    pub fn to(&self, other: &Self, [x, y]: [f64; 2]) -> Result<[f64; 2], Error> {
        let mut point = if self.is_lonlat() {
            if !(x.abs() <= 540.0 && y.abs() <= 90.0) {
                return Err(Error::LatOrLongExceedLimit);
            }
            (x.to_radians(), y.to_radians())
        } else {
            (x, y)
        };
        // Parameters are foreign, too.
        contained(|| proj4rs::transform::transform(&self.0, &other.0, &mut point))
            .unwrap_or(Err(Error::NanCoordinateValue))?;
        if other.is_lonlat() {
            point = (point.0.to_degrees(), point.1.to_degrees());
        }
        if point.0.is_finite() && point.1.is_finite() { Ok([point.0, point.1]) } else { Err(Error::NanCoordinateValue) }
    }
}

/// The difference between PROJ and `proj4rs`: a lattice of offsets, linear between its nodes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LonLatTable {
    /// PROJ string of the longitudes and latitudes: WGS 84 on Earth, the body's own elsewhere.
    pub lonlat: String,
    /// PROJ string of the plane of the lattice: that of the world without its datum, or one nearby.
    pub plane: String,
    /// The plane's coordinates of the first node.
    pub first: [f64; 2],
    /// Distance of nodes along both axes, metres.
    pub step: [f64; 2],
    /// Nodes along both axes, 2 to [`MAX_SIDE`] each.
    pub size: [usize; 2],
    /// What is added to the plane's coordinates to get the world's, metres: x and y of each node,
    /// rows from the first.
    pub offsets_m: Vec<f64>,
    /// Largest error of places without the table, metres.
    pub shift_m: f64,
    /// Largest error with the table, metres, measured between the nodes.
    pub error_m: f64,
}

impl LonLatTable {
    /// Whether its numbers are consistent; manifests are not trusted.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        self.size.iter().all(|n| (2..=MAX_SIDE).contains(n))
            && self.offsets_m.len() == 2 * self.size[0] * self.size[1]
            && self.step.iter().all(|s| s.is_finite() && *s > 0.0)
            && self.first.iter().chain(&self.offsets_m).all(|v| v.is_finite())
    }

    /// The plane's coordinates of a node.
    #[must_use]
    pub fn node(&self, i: usize, j: usize) -> [f64; 2] {
        [self.first[0] + i as f64 * self.step[0], self.first[1] + j as f64 * self.step[1]]
    }

    /// The world's coordinates of a place in the plane. Outside the lattice, offsets are
    /// extrapolated from the cells at the border, up to one width of the lattice, and are constant
    /// beyond. The offset is zero when the table is not valid.
    #[must_use]
    pub fn world_from_plane(&self, place: [f64; 2]) -> [f64; 2] {
        let cell_of = |axis: usize| {
            let cells = self.size[axis].saturating_sub(1).max(1) as f64;
            let at = ((place[axis] - self.first[axis]) / self.step[axis]).clamp(-cells, 2.0 * cells);
            let cell = at.floor().clamp(0.0, cells - 1.0);
            (cell as usize, at - cell)
        };
        let ((i, s), (j, t)) = (cell_of(0), cell_of(1));
        let offset = |axis: usize| {
            let at = |i: usize, j: usize| self.offsets_m.get(2 * (j * self.size[0] + i) + axis).copied().unwrap_or(0.0);
            let south = at(i, j) + s * (at(i + 1, j) - at(i, j));
            let north = at(i, j + 1) + s * (at(i + 1, j + 1) - at(i, j + 1));
            south + t * (north - south)
        };
        [place[0] + offset(0), place[1] + offset(1)]
    }
}

/// The value of `+key=` in a PROJ string.
#[must_use]
pub fn proj_value<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    text.split_whitespace().find_map(|word| word.strip_prefix('+')?.strip_prefix(key)?.strip_prefix('='))
}

/// A PROJ string without the relation of its datum to WGS 84. A datum that `proj4rs` knows by name
/// is replaced by its ellipsoid.
#[must_use]
pub fn without_datum(text: &str) -> String {
    let ellipsoid = match proj_value(text, "datum").map(str::to_ascii_lowercase).as_deref() {
        None => None,
        Some("wgs84") => Some("WGS84"),
        Some("nad83" | "ggrs87") => Some("GRS80"),
        Some("nad27") => Some("clrk66"),
        Some("potsdam" | "hermannskogel") => Some("bessel"),
        Some("carthage") => Some("clrk80ign"),
        Some("ire65") => Some("mod_airy"),
        Some("nzgd49") => Some("intl"),
        Some("osgb36" | "osni52") => Some("airy"),
        // An unknown datum is left in place, so that the parser reports it.
        Some(_) => return text.to_owned(),
    };
    let mut words: Vec<String> = text
        .split_whitespace()
        .filter(|word| !["+datum=", "+towgs84=", "+nadgrids="].iter().any(|key| word.starts_with(key)))
        .map(str::to_owned)
        .collect();
    if let Some(ellipsoid) = ellipsoid.filter(|_| proj_value(text, "ellps").is_none()) {
        words.push(format!("+ellps={ellipsoid}"));
    }
    words.join(" ")
}

/// PROJ string of longitude and latitude on the body of this PROJ string. On Earth, longitudes and
/// latitudes of paths are always WGS 84; other bodies have a single ellipsoid, that of the world.
#[must_use]
pub fn lonlat_of_body(text: &str) -> String {
    let radius: Option<f64> = proj_value(text, "a").or(proj_value(text, "R")).and_then(|a| a.parse().ok());
    match radius {
        Some(radius) if !(6.3e6..6.4e6).contains(&radius) => {
            let shape: Vec<&str> = text
                .split_whitespace()
                .filter(|word| ["+a=", "+b=", "+R=", "+rf=", "+f=", "+es="].iter().any(|key| word.starts_with(key)))
                .collect();
            format!("+proj=longlat {} +no_defs", shape.join(" "))
        }
        _ => WGS84_LONLAT.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn table() -> LonLatTable {
        // Offsets x = 1 + 2·i + 10·j, y = 5 − i.
        let offsets_m =
            (0..6).flat_map(|k| [1.0 + f64::from(k % 3) * 2.0 + f64::from(k / 3) * 10.0, 5.0 - f64::from(k % 3)]);
        LonLatTable {
            lonlat: WGS84_LONLAT.into(),
            plane: "+proj=utm +zone=10 +ellps=GRS80".into(),
            first: [100.0, 200.0],
            step: [10.0, 100.0],
            size: [3, 2],
            offsets_m: offsets_m.collect(),
            shift_m: 0.0,
            error_m: 0.0,
        }
    }

    #[test]
    fn angles_may_have_degree_signs_and_other_letters_are_an_error() {
        let places = ["45d30'", "45°30'", "45.5"].map(|angle| {
            let plane =
                Projection::parse(&format!("+proj=lcc +lat_1={angle} +lat_2=50 +lon_0=9 +datum=WGS84")).unwrap();
            Projection::parse(WGS84_LONLAT).unwrap().to(&plane, [10.0, 46.0]).unwrap()
        });
        let is_equal = |[x, y]: [f64; 2]| (x - places[0][0]).abs() < 1e-6 && (y - places[0][1]).abs() < 1e-6;
        assert!(places.into_iter().all(is_equal), "{places:?}");
        for angle in ["1\u{fffd}2'", "4é5\"", "1東2'"] {
            assert!(Projection::parse(&format!("+proj=lcc +lat_1={angle} +lat_2=45 +datum=NAD83")).is_err(), "{angle}");
        }
    }

    #[test]
    fn offsets_are_linear_between_and_beyond_the_nodes() {
        let table = table();
        assert!(table.is_valid());
        for (place, offset) in [
            ([100.0, 200.0], [1.0, 5.0]),
            ([115.0, 250.0], [1.0 + 3.0 + 5.0, 3.5]),
            ([120.0, 300.0], [15.0, 3.0]),
            ([90.0, 200.0], [-1.0, 6.0]),
            ([-1e9, 200.0], [-3.0, 7.0]),
        ] {
            let [x, y] = table.world_from_plane(place);
            assert!(
                (x - place[0] - offset[0]).abs() < 1e-6 && (y - place[1] - offset[1]).abs() < 1e-6,
                "{place:?} {x} {y}"
            );
        }
        assert!(!LonLatTable { size: [3, 3], ..table.clone() }.is_valid());
        assert!(!LonLatTable { step: [0.0, 1.0], ..table }.is_valid());
    }

    #[test]
    fn a_datum_is_taken_out_of_a_proj_string() {
        let text = "+proj=utm +zone=17 +datum=NAD27 +units=m +no_defs";
        assert_eq!(without_datum(text), "+proj=utm +zone=17 +units=m +no_defs +ellps=clrk66");
        assert!(Projection::parse(text).is_err() && Projection::parse(&without_datum(text)).is_ok());
        let text = "+proj=tmerc +ellps=bessel +towgs84=1,2,3 +nadgrids=x.gsb +units=m";
        assert_eq!(without_datum(text), "+proj=tmerc +ellps=bessel +units=m");
        let text = "+proj=tmerc +datum=moon2000";
        assert_eq!(without_datum(text), text);
    }

    proptest! {
        #[test]
        fn tables_of_any_numbers_never_panic(
            size in proptest::array::uniform2(0usize..40), numbers in proptest::collection::vec(proptest::num::f64::ANY, 0..40),
            place in proptest::array::uniform2(proptest::num::f64::ANY), step in proptest::array::uniform2(proptest::num::f64::ANY),
        ) {
            let table = LonLatTable { size, step, offsets_m: numbers, ..table() };
            let _is_valid: bool = table.is_valid();
            let _place: [f64; 2] = table.world_from_plane(place);
        }
    }
}
