//! Description of a source file, without an open handle.

use super::crs;
use super::georef::{Affine, affine_of, bent};
use super::inputs::Found;
use super::region::Crop;
use crate::error::{IngestError, gdal_message};
use gdal::Dataset;
use gdal::raster::{ColorInterpretation, GdalDataType};
use gdal::spatial_ref::{AxisMappingStrategy, SpatialRef};
use std::path::{Path, PathBuf};

/// Upper bound of the side of a raster: rejects absurd sizes of damaged files.
const MAX_SIDE: usize = 1 << 27;

/// A source raster. Valid by construction: it has pixels, bands, and a place on the ground.
#[derive(Debug, Clone)]
pub struct Raster {
    path: PathBuf,
    open_name: String,
    driver: String,
    size: [usize; 2],
    first: [usize; 2],
    crop: Option<Crop>,
    affine: Affine,
    wkt: String,
    crs_name: String,
    epsg: Option<u32>,
    is_geographic: bool,
    is_assumed_whole: bool,
    bands: Vec<BandInfo>,
    data_type: String,
}

/// What is assumed of files that do not say where they are.
#[derive(Debug, Clone, Copy, Default)]
pub struct Assumed<'a> {
    /// The CRS of those that have none.
    pub source_crs: Option<&'a str>,
    /// Longitudes and latitudes of a body, all of which a file without any position covers that is
    /// twice as wide as high.
    pub whole_body: Option<&'a str>,
}

/// Description of a band. Plain data: any of it may be true of a file.
#[derive(Debug, Clone)]
pub struct BandInfo {
    /// Sample type.
    pub data_type: GdalDataType,
    /// The value that the file declares as no data.
    pub nodata: Option<f64>,
    /// What the band shows, if the file says.
    pub shows: Shows,
    /// `value·scale + offset` is what the sample means.
    pub scale_offset: [f64; 2],
    /// Unit of the samples, as the file writes it.
    pub unit: String,
    /// Whether a mask band (not a nodata value, not an alpha band) says which samples are data.
    pub has_mask: bool,
    /// Colours of a palette, RGBA.
    pub palette: Option<Vec<[u8; 4]>>,
}

impl Raster {
    /// Describes an opened dataset.
    pub(super) fn of(found: &Found, assumed: Assumed<'_>) -> Result<Self, IngestError> {
        let (dataset, path) = (&found.dataset, found.shown.as_path());
        let fail = |reason: String| IngestError::source(path, reason);
        let (columns, rows) = dataset.raster_size();
        if dataset.raster_count() == 0 || columns == 0 || rows == 0 {
            return Err(fail("has no raster bands".to_owned()));
        }
        if columns > MAX_SIDE || rows > MAX_SIDE {
            return Err(fail(format!("claims {columns} x {rows} pixels, expected at most {MAX_SIDE} along a side")));
        }
        let own = dataset.spatial_ref().ok().or_else(|| dataset.gcp_spatial_ref());
        let own = own.filter(|srs| !srs.is_local());
        let affine = match (affine_of(dataset), bent(dataset, path, own.as_ref())) {
            (Some(affine), _) => Some(affine),
            (None, Some(reason)) => return Err(fail(reason)),
            (None, None) => None,
        };
        let whole = assumed.whole_body.filter(|_| affine.is_none() && own.is_none() && columns == 2 * rows);
        let step = 360.0 / columns as f64;
        let affine = affine.or_else(|| whole.map(|_| Affine([-180.0, step, 0.0, 90.0, 0.0, -step])));
        // With coordinates that can be degrees, but no CRS, it is taken to be on the body as well.
        let is_in_degrees = affine.is_some_and(|affine| {
            let [x, y] = affine.apply(0.0, 0.0);
            x.abs() <= 361.0 && y.abs() <= 91.0 && affine.0[1].abs() * columns as f64 <= 361.0
        });
        let of_body = assumed.whole_body.filter(|_| is_in_degrees);
        let srs = match (own, assumed.source_crs.or(of_body)) {
            (Some(srs), _) => srs,
            (None, Some(text)) => crs::parse("--source-crs", text)?,
            (None, None) if affine.is_none() => {
                return Err(fail(
                    "lies nowhere on the ground: it has neither a coordinate reference system (--source-crs EPSG:N gives \
                     one) nor a geotransform (gdal_translate -a_ullr … writes one)"
                        .to_owned(),
                ));
            }
            (None, None) => {
                return Err(fail("has no coordinate reference system: give it with --source-crs EPSG:N, or name the --body whose longitudes and \
                     latitudes it has"
                        .to_owned()));
            }
        };
        let srs = traditional(srs);
        let affine = affine.ok_or_else(|| {
            fail(
                "has no position on the ground: no geotransform and no control points (gdal_translate -a_ullr … writes \
                 a geotransform)"
                    .to_owned(),
            )
        })?;
        let bands = (1..=dataset.raster_count())
            .map(|index| BandInfo::of(dataset, index))
            .collect::<Result<Vec<_>, _>>()
            .map_err(|e| fail(format!("cannot be read: {}", gdal_message(&e))))?;
        Ok(Self {
            path: path.to_owned(),
            open_name: found.name.clone(),
            driver: dataset.driver().short_name(),
            size: [columns, rows],
            first: [0, 0],
            crop: None,
            affine,
            wkt: crs::definition(&srs).ok_or_else(|| {
                fail("has a coordinate reference system that PROJ cannot write down: give one with --source-crs".into())
            })?,
            crs_name: srs.name().unwrap_or_else(|| "unnamed".to_owned()),
            epsg: crs::epsg_of(&srs),
            is_geographic: srs.is_geographic(),
            is_assumed_whole: whole.is_some(),
            data_type: bands[0].data_type.name(),
            bands,
        })
    }

    /// The part of it whose first pixel is `first`, counted from its own, and that has `size`
    /// pixels, at least one a side; `None` when it does not lie within.
    pub(super) fn part(&self, first: [usize; 2], size: [usize; 2]) -> Option<Self> {
        let is_within = |axis: usize| {
            size[axis] > 0 && first[axis].checked_add(size[axis]).is_some_and(|end| end <= self.size[axis])
        };
        if !is_within(0) || !is_within(1) {
            return None;
        }
        let [x, y] = self.affine.apply(first[0] as f64, first[1] as f64);
        let c = self.affine.0;
        let affine = Affine([x, c[1], c[2], y, c[4], c[5]]);
        let first = [0, 1].map(|axis| self.first[axis] + first[axis]);
        Some(Self { size, first, affine, ..self.clone() })
    }

    /// The same raster, giving data to a part of the world alone.
    pub(super) fn with_crop(self, crop: Crop) -> Self {
        Self { crop: Some(crop), ..self }
    }

    /// As the user named it.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// As GDAL opens it (`/vsizip/…` for what lies in a zip).
    #[must_use]
    pub fn open_name(&self) -> &str {
        &self.open_name
    }

    /// The driver that opened it.
    #[must_use]
    pub fn driver(&self) -> &str {
        &self.driver
    }

    /// Columns and rows; of the part that is used, when the user gave bounds.
    #[must_use]
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// First column and row of the part that is used.
    #[must_use]
    pub fn first(&self) -> [usize; 2] {
        self.first
    }

    /// The part of the world that it may give data to, when the user gave bounds.
    #[must_use]
    pub fn crop(&self) -> Option<&Crop> {
        self.crop.as_ref()
    }

    /// From pixels to its CRS.
    #[must_use]
    pub fn affine(&self) -> &Affine {
        &self.affine
    }

    /// Its CRS, as text.
    #[must_use]
    pub fn wkt(&self) -> &str {
        &self.wkt
    }

    /// The CRS's name.
    #[must_use]
    pub fn crs_name(&self) -> &str {
        &self.crs_name
    }

    /// The CRS's EPSG code, when it has one.
    #[must_use]
    pub fn epsg(&self) -> Option<u32> {
        self.epsg
    }

    /// Whether the CRS is in degrees.
    #[must_use]
    pub fn is_geographic(&self) -> bool {
        self.is_geographic
    }

    /// Whether it was taken to cover a whole body, because it says nothing of its place.
    #[must_use]
    pub fn is_assumed_whole(&self) -> bool {
        self.is_assumed_whole
    }

    /// Descriptions of its bands, of which it has at least one.
    #[must_use]
    pub fn bands(&self) -> &[BandInfo] {
        &self.bands
    }

    /// GDAL's name of the sample type.
    #[must_use]
    pub fn data_type(&self) -> &str {
        &self.data_type
    }

    /// An error with GDAL's message: `what` continues the sentence that begins with the file.
    /// Without its full name, which may contain a password.
    pub(crate) fn fails(&self, what: &str, error: &gdal::errors::GdalError) -> IngestError {
        let reason = gdal_message(error).replace(&self.open_name, &self.path.to_string_lossy());
        IngestError::source(&self.path, format!("{what}: {reason}"))
    }

    /// File name without folders.
    #[must_use]
    pub fn file_name(&self) -> String {
        self.path.file_name().map_or_else(String::new, |n| n.to_string_lossy().replace('"', ""))
    }

    /// Its CRS.
    ///
    /// # Errors
    /// Never for a described raster, unless PROJ's database is gone.
    pub fn srs(&self) -> Result<SpatialRef, IngestError> {
        crs::parse("the CRS of a source", &self.wkt)
    }

    /// Pixel positions (corner convention) on a grid over the raster, `side`² of them, along the
    /// outermost pixel centres when `at_centers`, else along the edge.
    pub(crate) fn grid(&self, side: usize, at_centers: bool) -> (Vec<f64>, Vec<f64>) {
        let inset = if at_centers { 0.5 } else { 0.0 };
        let along = |k: usize, count: usize| {
            let length = count as f64 - 2.0 * inset;
            inset + length * k as f64 / (side - 1) as f64
        };
        let positions =
            (0..side * side).map(|i| self.affine.apply(along(i % side, self.size[0]), along(i / side, self.size[1])));
        positions.map(|[x, y]| (x, y)).unzip()
    }
}

#[cfg(test)]
impl Raster {
    /// A raster of which nothing but its place matters, of a CRS that all of them share.
    pub(crate) fn without_file(size: [usize; 2], affine: Affine, is_geographic: bool) -> Self {
        Self {
            path: "a.tif".into(),
            open_name: String::new(),
            driver: "GTiff".into(),
            size,
            first: [0, 0],
            crop: None,
            affine,
            wkt: "the same".to_owned(),
            crs_name: String::new(),
            epsg: None,
            is_geographic,
            is_assumed_whole: false,
            bands: Vec::new(),
            data_type: String::new(),
        }
    }
}

/// The meaning of a band.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shows {
    /// Red.
    Red,
    /// Green.
    Green,
    /// Blue.
    Blue,
    /// How opaque a pixel is.
    Alpha,
    /// Anything else, or unknown.
    Other,
}

impl Shows {
    fn of(declared: &ColorInterpretation) -> Self {
        match declared {
            ColorInterpretation::RedBand => Self::Red,
            ColorInterpretation::GreenBand => Self::Green,
            ColorInterpretation::BlueBand => Self::Blue,
            ColorInterpretation::AlphaBand => Self::Alpha,
            _ => Self::Other,
        }
    }
}

impl BandInfo {
    fn of(dataset: &Dataset, index: usize) -> gdal::errors::Result<Self> {
        let band = dataset.rasterband(index)?;
        let flags = band.mask_flags()?;
        let palette = band.color_table().map(|table| {
            let entry =
                |i| table.entry_as_rgb(i).map_or([0, 0, 0, 0], |e| [e.r, e.g, e.b, e.a].map(|v| v.clamp(0, 255) as u8));
            (0..table.entry_count()).map(entry).collect()
        });
        Ok(Self {
            data_type: band.band_type(),
            nodata: band.no_data_value(),
            shows: Shows::of(&band.color_interpretation()),
            scale_offset: [band.scale().unwrap_or(1.0), band.offset().unwrap_or(0.0)],
            unit: band.unit(),
            has_mask: !flags.is_all_valid() && !flags.is_nodata() && !flags.is_alpha(),
            palette,
        })
    }
}

/// An owned CRS in easting, northing order.
pub(crate) fn traditional(mut srs: SpatialRef) -> SpatialRef {
    srs.set_axis_mapping_strategy(AxisMappingStrategy::TraditionalGisOrder);
    srs
}
