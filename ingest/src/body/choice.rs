//! Whether data become a whole body, and of which.

use super::place::Degrees;
use crate::error::IngestError;
use crate::source::crs::{body_of, definition, epsg_of, parse};
use crate::source::raster::traditional;
use crate::source::{Note, Raster};
use gdal::spatial_ref::SpatialRef;
use terravision_common::database::{Body, Crs};

/// What the user chose.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub enum BodyChoice {
    /// Data of a whole body become one, all others a plane.
    #[default]
    Auto,
    /// `--plane`.
    Plane,
    /// `--geographic`: a body, of the ellipsoid that the CRS names.
    Geographic,
    /// `--body`: of this ellipsoid.
    Body {
        /// Its name, if it is known by name.
        name: Option<&'static str>,
        /// Semi-major axis, metres.
        semi_major_m: f64,
        /// Flattening.
        flattening: f64,
    },
}

/// Bodies that `--body` knows by name: semi-major axis, metres, and flattening (WGS 84; spheres of IAU
/// 2015, from which the heights of planets are mostly counted).
const NAMED: [(&str, f64, f64); 6] = [
    ("Earth", 6_378_137.0, 1.0 / 298.257_223_563),
    ("Mars", 3_396_190.0, 0.0),
    ("Moon", 1_737_400.0, 0.0),
    ("Mercury", 2_439_400.0, 0.0),
    ("Venus", 6_051_800.0, 0.0),
    ("Titan", 2_575_000.0, 0.0),
];

impl BodyChoice {
    /// Of the text after `--body`.
    ///
    /// # Errors
    /// A sentence.
    pub fn parse(text: &str) -> Result<Self, String> {
        if let Some((name, semi_major_m, flattening)) =
            NAMED.into_iter().find(|(name, ..)| name.eq_ignore_ascii_case(text.trim()))
        {
            return Ok(Self::Body { name: Some(name), semi_major_m, flattening });
        }
        let numbers: Vec<f64> = text.split(',').filter_map(|n| n.trim().parse().ok()).collect();
        match (numbers.as_slice(), text.split(',').count()) {
            ([a, f], 2) if (1e3..1e9).contains(a) && (0.0..0.5).contains(f) => {
                Ok(Self::Body { name: None, semi_major_m: *a, flattening: *f })
            }
            _ => Err(format!(
                "{text} is not a body: expected earth, mars, moon, mercury, venus or titan, or the semi-major axis in metres and \
                 the flattening, such as 3396190,0.00589"
            )),
        }
    }

    /// The CRS of rasters of the body that have none.
    #[must_use]
    pub fn assumed_crs(&self) -> Option<String> {
        match self {
            Self::Auto | Self::Plane | Self::Geographic => None,
            Self::Body { name: Some("Earth"), .. } => Some("EPSG:4326".to_owned()),
            Self::Body { semi_major_m, flattening, .. } => {
                Some(format!("+proj=longlat +a={semi_major_m} +b={} +no_defs", semi_major_m * (1.0 - flattening)))
            }
        }
    }
}

/// A body: its ellipsoid, and how it is described.
#[derive(Debug, Clone, PartialEq)]
pub struct Kind {
    /// Semi-major axis, metres.
    pub semi_major_m: f64,
    /// Flattening.
    pub flattening: f64,
    /// Longitudes and latitudes on it.
    pub crs: Crs,
    /// For the manifest.
    pub body: Body,
}

/// Data that cover so much become a body of their own accord.
const ALL_AROUND_DEG: f64 = 359.0;
const POLE_TO_POLE_DEG: f64 = 160.0;
/// Geographic data of a smaller part are told nothing.
const SMALL_DEG: f64 = 10.0;
/// A raster's ellipsoid may differ so much from that of the body that the user named.
const SAME_BODY: f64 = 0.005;

/// The body that these elevation sources become; `None` for a plane.
pub(crate) fn choose(
    choice: &BodyChoice,
    elevation: &[Raster],
    has_plane_options: bool,
    note: &mut dyn FnMut(Note),
) -> Result<Option<Kind>, IngestError> {
    let first = elevation.first().ok_or_else(|| IngestError::usage("no elevation was given"))?;
    let is_body = match choice {
        BodyChoice::Plane => false,
        BodyChoice::Geographic | BodyChoice::Body { .. } => true,
        BodyChoice::Auto => !has_plane_options && covers_body(elevation, note)?,
    };
    if !is_body {
        return Ok(None);
    }
    if has_plane_options {
        return Err(IngestError::usage(
            "a body is not made with --crs, --bounds or --spacing, whose meaning is a plane's: leave them or --body out",
        ));
    }
    let srs = first.srs()?;
    let own = srs.geog_cs().map(traditional).unwrap_or_else(|_| srs.clone());
    let (semi_major_m, flattening, name) = match choice {
        BodyChoice::Body { name, semi_major_m, flattening } => (*semi_major_m, *flattening, *name),
        _ => {
            let a = srs.semi_major().unwrap_or(0.0);
            (a, 1.0 - srs.semi_minor().unwrap_or(a) / a, None)
        }
    };
    for raster in elevation {
        let found = raster.srs()?.semi_major().unwrap_or(0.0);
        if (found / semi_major_m - 1.0).abs() > SAME_BODY {
            return Err(IngestError::source(
                raster.path(),
                format!(
                    "is on a body of {:.0} km radius ({}), expected {:.0} km: name the right --body",
                    found / 1e3,
                    raster.crs_name(),
                    semi_major_m / 1e3
                ),
            ));
        }
    }
    kind(&own, semi_major_m, if flattening.abs() < 1e-9 { 0.0 } else { flattening }, name).map(Some)
}

fn kind(own: &SpatialRef, semi_major_m: f64, flattening: f64, name: Option<&str>) -> Result<Kind, IngestError> {
    let b = semi_major_m * (1.0 - flattening);
    let is_own = (own.semi_major().unwrap_or(0.0) - semi_major_m).abs() < 1e-3
        && (own.semi_minor().unwrap_or(0.0) - b).abs() < 1e-3;
    let made;
    let srs = if is_own {
        own
    } else {
        made = parse("the body", &format!("+proj=longlat +a={semi_major_m} +b={b} +no_defs"))?;
        &made
    };
    let wkt = definition(srs)
        .ok_or_else(|| IngestError::usage("the body's longitudes and latitudes cannot be written down"))?;
    let proj4 = srs.to_proj4().ok().map(|t| t.trim().to_owned()).filter(|t| !t.is_empty());
    let crs_name = srs.name().unwrap_or_else(|| "unnamed".to_owned());
    let mut body = Body { radius_m: semi_major_m, ..body_of(srs) };
    if let Some(name) = name {
        name.clone_into(&mut body.name);
    }
    Ok(Kind { semi_major_m, flattening, crs: Crs { name: crs_name, epsg: epsg_of(srs), wkt, proj4 }, body })
}

/// Whether sources cover a whole body. Reports what else is large.
fn covers_body(elevation: &[Raster], note: &mut dyn FnMut(Note)) -> Result<bool, IngestError> {
    let (mut around, mut south, mut north, mut widest) = (0.0f64, 90.0f64, -90.0f64, 0.0f64);
    let mut rows: Vec<(f64, f64)> = Vec::new();
    for raster in elevation {
        if !raster.is_geographic() {
            return Ok(false);
        }
        let Some(at) = Degrees::of(raster)? else { return Ok(false) };
        let [low, high] = at.latitudes();
        let half = 0.5 * at.step[1].abs();
        (south, north) = (south.min(low - half), north.max(high + half));
        widest = widest.max(at.cover()[0]).max(at.cover()[1]);
        rows.push((low, at.cover()[0]));
    }
    // Tiles beside each other.
    for (low, _) in &rows {
        let beside = rows.iter().filter(|(other, _)| (other - low).abs() < 1e-3).map(|(_, width)| width).sum::<f64>();
        around = around.max(beside);
    }
    if around >= ALL_AROUND_DEG && north - south >= POLE_TO_POLE_DEG {
        return Ok(true);
    }
    if widest.max(around) > SMALL_DEG {
        note(Note::Info(format!(
            "{} is over longitude and latitude and covers a part of its body: it becomes a plane; elevation from pole to pole and \
             all around becomes a whole body",
            elevation[0].path().display()
        )));
    }
    Ok(false)
}
