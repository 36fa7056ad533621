//! Coordinate reference systems: the choice of the database's CRS, and its body.

use super::Note;
use super::raster::{Raster, traditional};
use crate::error::{IngestError, gdal_message};
use gdal::spatial_ref::{CoordTransform, SpatialRef};
use terravision_common::database::{Body, Crs};

/// Reads a definition (EPSG:N, WKT, PROJ string); `whose` names it in the error.
///
/// # Errors
/// [`IngestError::Usage`] when PROJ does not know it.
pub fn parse(whose: &str, text: &str) -> Result<SpatialRef, IngestError> {
    SpatialRef::from_definition(text).map(traditional).map_err(|e| {
        IngestError::usage(format!(
            "{whose} {text} is not a coordinate reference system that PROJ knows{}",
            match e {
                // The number of an error alone is meaningless.
                gdal::errors::GdalError::OgrError { .. } => String::new(),
                e => format!(": {}", gdal_message(&e)),
            }
        ))
    })
}

/// The definition as text that [`parse`] reads.
pub(crate) fn definition(srs: &SpatialRef) -> Option<String> {
    srs.to_wkt().ok().filter(|t| !t.is_empty()).or_else(|| srs.to_projjson().ok())
}

/// The EPSG code that a CRS states, if the code means this CRS. (GDAL matches user-defined systems
/// to codes a little too readily: the code's own definition has to give the same projection.)
pub(crate) fn epsg_of(srs: &SpatialRef) -> Option<u32> {
    if srs.auth_name().as_deref() != Some("EPSG") {
        return None;
    }
    let code = u32::try_from(srs.auth_code().ok()?).ok()?;
    let by_code = SpatialRef::from_epsg(code).ok()?;
    (by_code.to_proj4().ok()? == srs.to_proj4().ok()?).then_some(code)
}

/// Whether a CRS is a plane in metres.
fn is_metric_plane(srs: &SpatialRef) -> bool {
    srs.is_projected() && (srs.linear_units() - 1.0).abs() < 1e-9
}

/// Bodies, recognized by names and sizes of ellipsoids: name, key words, equatorial radius (IAU
/// WGCCRE 2015), metres.
const BODIES: [(&str, &[&str], f64); 8] = [
    ("Earth", &["wgs", "nad83", "nad27", "etrs", "grs 1980", "grs80"], 6_378_137.0),
    ("Mars", &["mars"], 3_396_190.0),
    ("Moon", &["moon", "lunar", "selen"], 1_737_400.0),
    ("Mercury", &["mercury"], 2_440_530.0),
    ("Venus", &["venus"], 6_051_800.0),
    ("Titan", &["titan"], 2_575_150.0),
    ("Ceres", &["ceres"], 482_000.0),
    ("Vesta", &["vesta"], 280_000.0),
];

/// The body that a CRS is on.
#[must_use]
pub fn body_of(srs: &SpatialRef) -> Body {
    let radius_m = srs.semi_major().unwrap_or(6_378_137.0);
    let attribute = |path: &str| srs.get_attr_value(path, 0).ok().flatten().unwrap_or_default();
    let words = [srs.name().unwrap_or_default(), attribute("GEOGCS"), attribute("DATUM"), attribute("SPHEROID")];
    let words = words.join(" ").to_lowercase();
    let is_size = |known: f64| (radius_m / known - 1.0).abs() < 0.005;
    let by_size = BODIES.iter().find(|(_, _, known)| is_size(*known));
    let by_word = BODIES.iter().skip(1).find(|(_, hints, _)| hints.iter().any(|w| words.contains(w)));
    let name = by_size.or(by_word).map_or("unknown", |(name, ..)| name);
    Body { name: name.to_owned(), radius_m }
}

/// The CRS of a database: a plane in metres that PROJ can write down.
#[derive(Debug, Clone)]
pub struct TargetCrs {
    crs: Crs,
    body: Body,
}

impl TargetCrs {
    /// A database's CRS; `named` is what the error calls it.
    ///
    /// # Errors
    /// It is not a plane in metres, or PROJ cannot write it down.
    pub fn new(srs: &SpatialRef, named: &str) -> Result<Self, IngestError> {
        if !is_metric_plane(srs) {
            let unit = match srs.is_geographic() {
                true => "degrees".to_owned(),
                false => srs.linear_units_name().unwrap_or_default(),
            };
            return Err(IngestError::usage(format!(
                "{named} is in {unit}, expected a projected system in metres (for example a UTM zone)"
            )));
        }
        let wkt = definition(srs)
            .ok_or_else(|| IngestError::usage("the coordinate reference system cannot be written down as WKT"))?;
        let name = srs.name().unwrap_or_else(|| "unnamed".to_owned());
        let proj4 = srs.to_proj4().ok().map(|t| t.trim().to_owned()).filter(|t| !t.is_empty());
        Ok(Self { crs: Crs { name, epsg: epsg_of(srs), wkt, proj4 }, body: body_of(srs) })
    }

    /// For the manifest.
    #[must_use]
    pub fn crs(&self) -> &Crs {
        &self.crs
    }

    /// The body that it is on.
    #[must_use]
    pub fn body(&self) -> &Body {
        &self.body
    }

    /// The CRS itself.
    ///
    /// # Errors
    /// Never, unless PROJ's database is gone.
    pub fn srs(&self) -> Result<SpatialRef, IngestError> {
        parse("the CRS of the database", &self.crs.wkt)
    }

    /// Latitude of a point of the plane, degrees, on Earth; `None` on other bodies, and where it
    /// cannot be transformed.
    #[must_use]
    pub fn latitude_deg(&self, [x, y]: [f64; 2]) -> Option<f64> {
        if self.body.name != "Earth" {
            return None;
        }
        let degrees = parse("WGS 84", "EPSG:4326").ok()?;
        let (mut lon, mut lat) = ([x], [y]);
        CoordTransform::new(&self.srs().ok()?, &degrees).ok()?.transform_coords(&mut lon, &mut lat, &mut []).ok()?;
        Some(lat[0]).filter(|lat| lat.is_finite())
    }

    /// Whether a source is in this CRS, so that nothing has to be transformed.
    #[must_use]
    pub fn is_of(&self, raster: &Raster) -> bool {
        raster.wkt() == self.crs.wkt || (raster.epsg().is_some() && raster.epsg() == self.crs.epsg)
    }

    /// Chooses the CRS: the one given by the user; otherwise that of the first source if it is a
    /// plane in metres; otherwise a plane for the data.
    ///
    /// # Errors
    /// [`IngestError`] when the given CRS is not a plane in metres, or the data cannot be located.
    pub fn choose(sources: &[Raster], given: Option<&str>, note: &mut dyn FnMut(Note)) -> Result<Self, IngestError> {
        if let Some(text) = given {
            return Self::new(&parse("--crs", text)?, &format!("--crs {text}"));
        }
        let first = sources.first().ok_or_else(|| IngestError::usage("no elevation was given"))?;
        let own = first.srs()?;
        if is_metric_plane(&own) {
            let target = Self::new(&own, "the CRS of the elevation")?;
            if let Some(worst) = worst_stretch(sources, &own).filter(|worst| (worst.factor - 1.0).abs() > TOLD_STRETCH)
            {
                let [lon, lat] = worst.lon_lat;
                note(Note::Warning(format!(
                    "distances in {}, the CRS of {}, are up to {:.2} times those on the ground (at longitude {lon:.1}, latitude \
                     {lat:.1}), while heights keep their size; --crs EPSG:N with a UTM zone gives true proportions",
                    target.crs().name,
                    first.path().display(),
                    worst.factor
                )));
            }
            return Ok(target);
        }
        let (srs, why) = plane_for(sources)?;
        let target = Self::new(&srs, why)?;
        note(Note::Info(format!("the database is in {} ({why}); --crs EPSG:N chooses another", target.crs().name)));
        Ok(target)
    }
}

/// The ratio of distances in a plane to those on the ground.
struct Stretch {
    factor: f64,
    lon_lat: [f64; 2],
}

/// A stretch is reported from this on.
const TOLD_STRETCH: f64 = 0.05;
/// Places along a side of the world where the stretch is computed: its corners, the middles of its
/// sides, its middle.
const JUDGED: usize = 3;

/// The worst stretch of a plane over the bounding rectangle of sources; `None` if it cannot be
/// computed.
fn worst_stretch(sources: &[Raster], plane: &SpatialRef) -> Option<Stretch> {
    let (mut low, mut high) = ([f64::MAX; 2], [f64::MIN; 2]);
    for raster in sources {
        let (mut x, mut y) = raster.grid(JUDGED, true);
        let srs = raster.srs().ok()?;
        // Points that cannot be transformed come back infinite and are left out.
        CoordTransform::new(&srs, plane).ok()?.transform_coords(&mut x, &mut y, &mut []).ok();
        for place in x.into_iter().zip(y).filter(|(x, y)| x.is_finite() && y.is_finite()).map(<[f64; 2]>::from) {
            (low, high) = ([0, 1].map(|k| low[k].min(place[k])), [0, 1].map(|k| high[k].max(place[k])));
        }
    }
    let to_degrees = CoordTransform::new(plane, &traditional(plane.geog_cs().ok()?)).ok()?;
    let along = |k: usize, axis: usize| low[axis] + (high[axis] - low[axis]) * k as f64 / (JUDGED - 1) as f64;
    let radius_m = plane.semi_major().ok()?;
    let places = (0..JUDGED * JUDGED).map(|k| [along(k % JUDGED, 0), along(k / JUDGED, 1)]);
    let all = places.filter_map(|place| stretch_at(place, &to_degrees, radius_m));
    let badness = |stretch: &Stretch| stretch.factor.ln().abs();
    all.max_by(|a, b| badness(a).total_cmp(&badness(b)))
}

fn stretch_at([x, y]: [f64; 2], to_degrees: &CoordTransform, radius_m: f64) -> Option<Stretch> {
    let step = 1000.0;
    let (mut xs, mut ys) = ([x, x + step, x], [y, y, y + step]);
    to_degrees.transform_coords(&mut xs, &mut ys, &mut []).ok()?;
    let distance = |i: usize| {
        let east = ((xs[i] - xs[0] + 540.0).rem_euclid(360.0) - 180.0).to_radians() * ys[0].to_radians().cos();
        radius_m * east.hypot((ys[i] - ys[0]).to_radians())
    };
    let factor = (step / distance(1) * (step / distance(2))).sqrt();
    (factor.is_finite() && factor > 0.0).then_some(Stretch { factor, lon_lat: [xs[0], ys[0]] })
}

/// Where sources lie: centre and half extents in degrees, and the angular radius around the centre.
struct Spread {
    lon: f64,
    lat: f64,
    half_width: f64,
    max_abs_lat: f64,
    radius: f64,
}

fn spread(sources: &[Raster]) -> Result<Spread, IngestError> {
    let mut points = Vec::new();
    for raster in sources {
        let srs = raster.srs()?;
        let nowhere = |why: String| {
            IngestError::source(
                raster.path(),
                format!("cannot be located on its body ({why}): give a plane with --crs EPSG:N"),
            )
        };
        let geographic = traditional(srs.geog_cs().map_err(|e| nowhere(gdal_message(&e)))?);
        if let Some(crop) = raster.crop().filter(|crop| !crop.lon_lat.is_empty()) {
            points.extend(crop.lon_lat.iter().copied());
            continue;
        }
        let (mut xs, mut ys) = raster.grid(21, true);
        if !raster.is_geographic() {
            let transform = CoordTransform::new(&srs, &geographic).map_err(|e| nowhere(gdal_message(&e)))?;
            // Points that cannot be transformed come back infinite and are left out.
            transform.transform_coords(&mut xs, &mut ys, &mut []).ok();
        }
        let unit = srs.angular_units().to_degrees();
        let unit = if raster.is_geographic() && unit.is_finite() && unit > 0.0 { unit } else { 1.0 };
        let before = points.len();
        let found = xs.iter().zip(&ys).map(|(x, y)| [x * unit, y * unit]);
        points.extend(found.filter(|[lon, lat]| lon.is_finite() && lat.abs() <= 90.5));
        if points.len() == before && raster.is_geographic() {
            let (south, north) = ys.iter().fold((f64::MAX, f64::MIN), |(lo, hi), y| (lo.min(*y), hi.max(*y)));
            return Err(IngestError::source(
                raster.path(),
                format!(
                    "has latitudes from {:.1} to {:.1} degrees, expected -90 to 90: are its axes exchanged, or is it in another \
                     CRS than {}?",
                    south * unit,
                    north * unit,
                    raster.crs_name()
                ),
            ));
        }
        if points.len() == before {
            return Err(nowhere("no pixel has a longitude and latitude".to_owned()));
        }
    }
    let unit_vector = |[lon, lat]: &[f64; 2]| {
        let (lon, lat) = (lon.to_radians(), lat.to_radians());
        [lat.cos() * lon.cos(), lat.cos() * lon.sin(), lat.sin()]
    };
    let mut sum = [0.0; 3];
    for point in &points {
        sum.iter_mut().zip(unit_vector(point)).for_each(|(s, v)| *s += v);
    }
    // Data all around the body have no middle: any meridian will do.
    let lon = if sum[0].hypot(sum[1]) < 0.05 * points.len() as f64 { 0.0 } else { sum[1].atan2(sum[0]).to_degrees() };
    let lats = points.iter().map(|p| p[1]);
    let (south, north) = lats.fold((f64::MAX, f64::MIN), |(lo, hi), v| (lo.min(v), hi.max(v)));
    let lat = 0.5 * (south + north);
    let offset = |p: &[f64; 2]| ((p[0] - lon + 540.0).rem_euclid(360.0) - 180.0).abs();
    let middle = unit_vector(&[lon, lat]);
    let cosine = |p: &[f64; 2]| unit_vector(p).iter().zip(middle).map(|(a, b)| a * b).sum::<f64>();
    Ok(Spread {
        lon,
        lat,
        half_width: points.iter().map(offset).fold(0.0, f64::max),
        max_abs_lat: south.abs().max(north.abs()),
        radius: points.iter().map(cosine).fold(1.0, f64::min).clamp(-1.0, 1.0).acos().to_degrees(),
    })
}

/// A plane for data that have none, and why this one.
fn plane_for(sources: &[Raster]) -> Result<(SpatialRef, &'static str), IngestError> {
    let at = spread(sources)?;
    let own = sources[0].srs()?;
    let body = body_of(&own);
    // A UTM zone is 6 degrees wide and good for a little more; it ends at 84 degrees north.
    if body.name == "Earth" && at.half_width <= 4.5 && at.max_abs_lat <= 84.0 {
        let zone = (((at.lon + 180.0) / 6.0).floor() as i64).rem_euclid(60) + 1;
        let code = if at.lat >= 0.0 { 32600 } else { 32700 } + zone;
        return Ok((parse("UTM zone", &format!("EPSG:{code}"))?, "the UTM zone of the data"));
    }
    let (a, b) = (own.semi_major().unwrap_or(body.radius_m), own.semi_minor().unwrap_or(body.radius_m));
    let (lon, lat) = ((at.lon * 10.0).round() / 10.0, (at.lat * 10.0).round() / 10.0);
    let (projection, why) =
        if at.half_width * at.lat.to_radians().cos() <= 10.0 && at.half_width <= 45.0 && at.max_abs_lat < 88.0 {
            (format!("+proj=tmerc +lat_0={lat} +lon_0={lon} +k=1"), "a transverse Mercator plane around the data")
        } else if at.radius <= 75.0 {
            (
                format!("+proj=laea +lat_0={lat} +lon_0={lon}"),
                "an equal-area plane around the data, they are too wide for a UTM zone",
            )
        } else {
            (format!("+proj=cea +lon_0={lon} +lat_ts=0"), "an equal-area cylinder: the data cover most of the body")
        };
    let text = format!("{projection} +x_0=0 +y_0=0 +a={a} +b={b} +units=m +no_defs");
    let srs = SpatialRef::from_proj4(&text)
        .map_err(|e| IngestError::usage(format!("no plane could be made for the data: {}", gdal_message(&e))))?;
    let mut srs = traditional(srs);
    let kind = projection.split([' ', '=']).nth(1).unwrap_or_default();
    let kind = match kind {
        "tmerc" => "Transverse Mercator",
        "laea" => "Lambert azimuthal equal-area",
        _ => "Lambert cylindrical equal-area",
    };
    srs.set_attr_value("PROJCS", Some(&format!("{} {kind} {lon} {lat}", body.name))).ok();
    Ok((srs, why))
}
