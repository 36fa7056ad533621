//! One source file: everything about it that does not need an open handle.

use super::crs;
use super::georef::{Affine, affine_of, bent};
use super::inputs::Found;
use super::region::Crop;
use crate::error::{IngestError, gdal_message};
use gdal::Dataset;
use gdal::raster::{ColorInterpretation, GdalDataType};
use gdal::spatial_ref::{AxisMappingStrategy, SpatialRef};
use std::path::PathBuf;

/// No raster is larger along a side; absurd sizes of damaged files end here.
const MAX_SIDE: usize = 1 << 27;

/// A source raster.
#[derive(Debug, Clone)]
pub struct Raster {
    /// As the user named it.
    pub path: PathBuf,
    /// As GDAL opens it (`/vsizip/…` for what lies in a zip).
    pub open_name: String,
    /// The driver that opened it.
    pub driver: String,
    /// Columns and rows; of the part that is used, when the user gave bounds.
    pub size: [usize; 2],
    /// First column and row of the part that is used.
    pub first: [usize; 2],
    /// The part of the world that it may give data to, when the user gave bounds.
    pub crop: Option<Crop>,
    /// From pixels to its CRS.
    pub affine: Affine,
    /// Its CRS.
    pub wkt: String,
    /// The CRS's name.
    pub crs_name: String,
    /// The CRS's EPSG code, when it has one.
    pub epsg: Option<u32>,
    /// Whether the CRS is in degrees.
    pub is_geographic: bool,
    /// What is known of its bands.
    pub bands: Vec<BandInfo>,
    /// GDAL's name of the sample type.
    pub data_type: String,
}

/// What is known of a band.
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
    /// Looks at what was opened. `source_crs` is for files that lack a CRS.
    pub(super) fn of(found: &Found, source_crs: Option<&str>) -> Result<Self, IngestError> {
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
        let srs = match (own, source_crs) {
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
                return Err(fail("has no coordinate reference system: give it with --source-crs EPSG:N".to_owned()));
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
            data_type: bands[0].data_type.name(),
            bands,
        })
    }

    /// What GDAL says about it, as an error: `what` continues the sentence that begins with the
    /// file. Without its full name, which may have a password in it.
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

/// What a band shows, as far as it matters here.
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
    /// Anything else, or nobody knows.
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
