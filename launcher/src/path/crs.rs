//! From a path's coordinates to the world's.
//!
//! The launcher does without GDAL: `proj4rs` knows the usual projections, and EPSG codes by their
//! PROJ strings. How the world's datum lies to WGS 84 only PROJ knows for sure: ingest asked it,
//! and the manifest has the answer ([`LonLatTable`]). Only easting and northing are transformed;
//! heights stay as they are.
//!
//! What had to be guessed (a datum that nothing tells of) is said in [`Georeference::take_doubts`].

use super::datum::{
    Datum, ELLIPSOID_WORDS, datum_of, datum_words, definition, is_on_wgs84, shift_of_named_datum, with_nad27_shift,
};
use super::ecef::Ellipsoid;
use glam::DVec2;
use proj4rs::errors::Error;
use std::cell::RefCell;
use std::fmt;
use terravision_common::lonlat::{LonLatTable, Projection, WGS84_LONLAT, lonlat_of_body, proj_value, without_datum};

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
        source: Error,
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
        source: Error,
    },
}

/// The CRS that a world is in.
pub struct Georeference {
    name: String,
    epsg: Option<u32>,
    /// The PROJ string. Whether it is understood matters only to paths in another CRS.
    proj4: Option<String>,
    /// PROJ's way from longitude and latitude, where the string alone does not tell.
    table: Option<LonLatTable>,
    /// A place in the world, in its CRS: where the size of a doubt is measured.
    place: [f64; 2],
    doubts: RefCell<Vec<String>>,
}

impl fmt::Debug for Georeference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, epsg, proj4, .. } = self;
        f.debug_struct("Georeference").field("name", name).field("epsg", epsg).field("proj4", proj4).finish()
    }
}

/// Steps of [`Transform::source_of`]: three find a place that is kilometres away.
const MOST_NEWTON_STEPS: u32 = 20;

/// The way of a path's coordinates into the world's CRS.
#[expect(clippy::large_enum_variant, reason = "a path has one")]
enum Way {
    /// By the planes alone.
    Planes { from: Projection, to: Projection },
    /// By longitude and latitude, and PROJ's table.
    Table { from: Projection, lonlat: Projection, plane: Projection, table: LonLatTable },
}

/// Brings positions and headings from another CRS into the world's.
pub struct Transform {
    from_name: String,
    to_name: String,
    way: Way,
}

impl fmt::Debug for Transform {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Transform").field("from", &self.from_name).field("to", &self.to_name).finish()
    }
}

impl Georeference {
    /// The CRS of that name, given by a PROJ string or an EPSG code; without both no other CRS can
    /// be brought into it.
    #[must_use]
    pub fn new(name: String, epsg: Option<u32>, proj4: Option<&str>) -> Self {
        let proj4 = proj4.map(str::to_owned);
        Self { name, epsg, proj4, table: None, place: [0.0; 2], doubts: RefCell::default() }
    }

    /// With what PROJ said at ingest, if it had to say anything, and a place in the world.
    #[must_use]
    pub fn with_table(self, table: Option<LonLatTable>, place: [f64; 2]) -> Self {
        Self { table: table.filter(LonLatTable::is_valid), place, ..self }
    }

    /// Name of the CRS, for messages.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// What had to be guessed until now, a sentence each; each is said once.
    #[must_use]
    pub fn take_doubts(&self) -> Vec<String> {
        std::mem::take(&mut self.doubts.borrow_mut())
    }

    fn doubt(&self, sentence: String) {
        let mut doubts = self.doubts.borrow_mut();
        if !doubts.contains(&sentence) {
            doubts.push(sentence);
        }
    }

    /// From longitude and latitude in degrees: WGS 84 on Earth, the body's own ellipsoid elsewhere.
    ///
    /// # Errors
    /// [`CrsError::NoWorldCrs`] or [`CrsError::BadWorldCrs`].
    pub fn from_lonlat(&self) -> Result<Transform, CrsError> {
        let text = self
            .table
            .as_ref()
            .map_or_else(|| lonlat_of_body(self.proj4.as_deref().unwrap_or_default()), |table| table.lonlat.clone());
        let from = Projection::parse(&text).map_err(|source| CrsError::BadWorldCrs { text, source })?;
        self.transform_from("longitude and latitude", from)
    }

    /// The ellipsoid of the longitudes and latitudes of [`Georeference::from_lonlat`].
    pub(super) fn lonlat_ellipsoid(&self) -> Ellipsoid {
        let text = self.table.as_ref().map(|table| table.lonlat.clone());
        Ellipsoid::of_lonlat(&text.unwrap_or_else(|| lonlat_of_body(self.proj4.as_deref().unwrap_or_default())))
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
        let text = if let Some(epsg) = epsg_code(crs) {
            if self.epsg == Some(epsg) {
                return Ok(None);
            }
            definition(epsg).ok_or_else(unknown)?.to_owned()
        } else if crs.trim_start().starts_with('+') {
            crs.trim().to_owned()
        } else {
            return Err(unknown());
        };
        let name = super::shorten(crs);
        if let Some(transform) = self.on_own_datum(&name, &text) {
            return Ok(Some(transform));
        }
        let from = match datum_of(&text) {
            Datum::Known => Projection::parse(&text),
            Datum::Nad27 => {
                self.doubt(format!(
                    "{name} is on NAD27, whose grids are not here: its mean shift is used, good to some 10 m in the \
                     contiguous United States and to 50 m elsewhere; a path in the world's CRS, {}, has no such doubt",
                    self.name
                ));
                Projection::parse(&with_nad27_shift(&text))
            }
            Datum::Unknown => {
                self.doubt(format!(
                    "{name} does not tell how its datum lies to WGS 84: it is taken for WGS 84, and the path may be off by \
                     some hundred metres; give it in longitude and latitude or in the world's CRS, {} (gdaltransform converts)",
                    self.name
                ));
                Projection::parse(&without_datum(&text))
            }
        };
        let Ok(from) = from else { return Err(unknown()) };
        self.transform_from(&name, from).map(Some)
    }

    /// From a system on the world's own datum: nothing shifts then. `None` when the other's datum
    /// is another one, or the world's projection is not known here.
    fn on_own_datum(&self, name: &str, text: &str) -> Option<Transform> {
        let own = self.proj4.as_deref().or_else(|| definition(self.epsg?))?;
        // On WGS 84 the common way is the exact one.
        if self.table.is_some() && is_on_wgs84(text) {
            return None;
        }
        // The database of codes names the datum of most; GDAL's strings leave it out.
        let named = self.epsg.and_then(definition).unwrap_or(own);
        let is_same = datum_words(text) == datum_words(named) || datum_words(text) == datum_words(own);
        let is_known_as_same = is_same && datum_words(text).len() > ELLIPSOID_WORDS;
        let is_taken_for_same = is_same && datum_of(text) == Datum::Unknown;
        if !(is_known_as_same || is_taken_for_same) {
            return None;
        }
        // What the world's table adds to its plane beyond the datum cannot be told from it.
        if self.table.as_ref().is_some_and(|table| table.plane != without_datum(own)) {
            return None;
        }
        let (from, to) = (Projection::parse(&without_datum(text)).ok()?, Projection::parse(&without_datum(own)).ok()?);
        if !is_known_as_same {
            self.doubt(format!(
                "{name} does not tell how its datum lies to WGS 84: it is taken for that of the world's CRS, {}, which has the \
                 same ellipsoid; where it is another one, the path is off by some hundred metres",
                self.name
            ));
        }
        Some(Transform { from_name: name.to_owned(), to_name: self.name.clone(), way: Way::Planes { from, to } })
    }

    fn transform_from(&self, from_name: &str, from: Projection) -> Result<Transform, CrsError> {
        let (from_name, to_name) = (super::shorten(from_name), self.name.clone());
        let bad = |text: &str, source| CrsError::BadWorldCrs { text: text.to_owned(), source };
        let way = match (&self.table, &self.proj4) {
            (Some(table), _) => Way::Table {
                from,
                lonlat: Projection::parse(&table.lonlat).map_err(|source| bad(&table.lonlat, source))?,
                plane: Projection::parse(&table.plane).map_err(|source| bad(&table.plane, source))?,
                table: table.clone(),
            },
            (None, Some(text)) => {
                let to = self.plane_of_old_database(text).map_err(|source| bad(text, source))?;
                Way::Planes { from, to }
            }
            (None, None) => match self.epsg.and_then(Projection::of_epsg) {
                Some(to) => Way::Planes { from, to },
                None => return Err(CrsError::NoWorldCrs { found: from_name, world: to_name }),
            },
        };
        Ok(Transform { from_name, to_name, way })
    }

    /// The plane of a world whose manifest has no table: it needs none, or was made before there
    /// were any.
    fn plane_of_old_database(&self, text: &str) -> Result<Projection, Error> {
        let known = self.epsg.and_then(definition);
        let (datum, shifted) = match (datum_of(text), known) {
            (Datum::Nad27, _) => (Datum::Nad27, Some(with_nad27_shift(text))),
            // Israel's grid, for one, is on the ellipsoid of GRS 80 and yet far from WGS 84.
            (datum, Some(known)) if datum_of(known) == Datum::Known && proj_value(text, "towgs84").is_none() => {
                let shift = proj_value(known, "towgs84").or_else(|| shift_of_named_datum(known));
                let is_zero = is_on_wgs84(known);
                let shifted =
                    shift.filter(|_| !is_zero).map(|shift| format!("{} +towgs84={shift}", without_datum(text)));
                (if is_zero { datum } else { Datum::Unknown }, shifted)
            }
            (datum, _) => (datum, None),
        };
        let remedy = "made by an earlier TerraVision, does not say how its datum lies to WGS 84";
        match (datum, shifted) {
            (Datum::Known, _) => Projection::parse(text),
            (_, Some(shifted)) => {
                let (shifted, plain) = (Projection::parse(&shifted)?, Projection::parse(&without_datum(text))?);
                let size = self.shift_between(&plain, &shifted).map_or_else(String::new, |m| format!("of {m:.0} m "));
                self.doubt(format!(
                    "the database ({}), {remedy}: a mean shift {size}is used, and paths may be off by some 10 to 50 m; ingest \
                     again (as it is, or into UTM with --crs EPSG:326NN), then they are exact",
                    self.name
                ));
                Ok(shifted)
            }
            (_, None) => {
                self.doubt(format!(
                    "the database ({}), {remedy}: it is taken for WGS 84, and paths may be off by some hundred metres (up to \
                     500 m); ingest again (as it is, or into UTM with --crs EPSG:326NN), or give the path in the world's own CRS",
                    self.name
                ));
                Projection::parse(&without_datum(text))
            }
        }
    }

    /// How far a place of the world is from itself in two planes of one longitude and latitude,
    /// metres.
    fn shift_between(&self, plain: &Projection, shifted: &Projection) -> Option<f64> {
        let wgs84 = Projection::parse(WGS84_LONLAT).ok()?;
        let lonlat = shifted.to(&wgs84, self.place).ok()?;
        let [x, y] = wgs84.to(plain, lonlat).ok()?;
        Some((x - self.place[0]).hypot(y - self.place[1])).filter(|m| m.is_finite())
    }
}

impl Transform {
    /// Whether positions are longitude and latitude, degrees.
    pub(super) fn is_from_lonlat(&self) -> bool {
        let (Way::Planes { from, .. } | Way::Table { from, .. }) = &self.way;
        from.is_lonlat()
    }

    /// A position in the world's CRS. Geographic coordinates are degrees, longitude first.
    ///
    /// # Errors
    /// [`CrsError::NoPlace`].
    pub fn position(&self, x: f64, y: f64) -> Result<DVec2, CrsError> {
        let found = match &self.way {
            Way::Planes { from, to } => from.to(to, [x, y]),
            Way::Table { from, lonlat, plane, table } => from
                .to(lonlat, [x, y])
                .and_then(|place| lonlat.to(plane, place))
                .map(|place| table.world_from_plane(place)),
        };
        found.map(DVec2::from_array).map_err(|source| {
            let (from, world) = (self.from_name.clone(), self.to_name.clone());
            CrsError::NoPlace { x, y, from, world, source }
        })
    }

    /// The coordinates that [`Transform::position`] brings to a place in the world's CRS, found from
    /// others that are not far from them; `None` where no such coordinates are found.
    #[must_use]
    pub fn source_of(&self, place: DVec2, near: [f64; 2]) -> Option<[f64; 2]> {
        // A step of about a metre, as in `heading`.
        let step = if self.is_from_lonlat() { 1e-5 } else { 1.0 };
        let at = |x: f64, y: f64| self.position(x, y).ok();
        let [mut x, mut y] = near;
        for _ in 0..MOST_NEWTON_STEPS {
            let found = at(x, y)?;
            let missing = place - found;
            // A hundredth of a millimetre.
            if missing.length() < 1e-5 {
                return Some([x, y]);
            }
            // Away from the pole, so that the step never leaves the sphere.
            let north = if y > 0.0 { -step } else { step };
            let per_x = (at(x + step, y)? - found) / step;
            let per_y = (at(x, y + north)? - found) / north;
            let determinant = per_x.perp_dot(per_y);
            x += missing.perp_dot(per_y) / determinant;
            y += per_x.perp_dot(missing) / determinant;
        }
        None
    }

    /// A heading in the world's CRS: what was north there is not quite north here (meridian
    /// convergence).
    ///
    /// # Errors
    /// [`CrsError::NoPlace`].
    pub fn heading(&self, x: f64, y: f64, heading_rad: f64) -> Result<f64, CrsError> {
        let is_lonlat = self.is_from_lonlat();
        // A step of about a metre; along a geographic coordinate a degree is 111 km.
        let step = if is_lonlat { 1e-5 } else { 1.0 };
        // Away from the pole, so that the step never leaves the sphere.
        let sign = if is_lonlat && y > 89.9 { -1.0 } else { 1.0 };
        let north = (self.position(x, y + sign * step)? - self.position(x, y)?) * sign;
        Ok(heading_rad + north.x.atan2(north.y))
    }
}

/// The N of `EPSG:N`, `urn:ogc:def:crs:EPSG::N`, `OGC:CRS84` and their like.
fn epsg_code(text: &str) -> Option<u32> {
    let text = text.trim().to_ascii_uppercase();
    if text.ends_with("CRS84") {
        return Some(4326);
    }
    text.contains("EPSG").then(|| text.rsplit([':', '/']).next()?.parse().ok()).flatten()
}

#[cfg(test)]
mod tests;
