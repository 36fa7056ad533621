//! Reads sources: each thread has its own handles, because those of GDAL cannot be shared.

use super::access::Access;
use super::raster::{Raster, Shows};
use super::values::{ColorValues, ElevationValues};
use super::window::Window;
use crate::error::IngestError;
use gdal::Dataset;
use gdal::raster::RasterBand;

/// Opens a described source again.
pub(crate) fn open_raster(raster: &Raster) -> Result<Dataset, IngestError> {
    // The driver was determined when it was described; no other driver may open it now.
    Access::default()
        .open(raster.open_name(), Some(raster.driver()))
        .or_else(|_| Access::default().open(raster.open_name(), None))
        .map_err(|e| raster.fails("cannot be opened again", &e))
}

/// A source whose samples have `C` channels.
pub trait Reader<const C: usize> {
    /// Columns and rows of the source.
    fn size(&self) -> [usize; 2];

    /// Reads a rectangle that lies inside the source.
    ///
    /// # Errors
    /// [`IngestError::Source`] when it cannot be read.
    fn read(&self, origin: [usize; 2], size: [usize; 2]) -> Result<Window<C>, IngestError>;
}

fn read_band<T: Copy + gdal::raster::GdalType>(
    raster: &Raster,
    band: &gdal::errors::Result<RasterBand<'_>>,
    [x, y]: [usize; 2],
    [w, h]: [usize; 2],
) -> Result<Vec<T>, IngestError> {
    let fail = |e: &gdal::errors::GdalError| raster.fails("cannot be read (it may be damaged or cut short)", e);
    let band = band.as_ref().map_err(fail)?;
    let first = [raster.first()[0] + x, raster.first()[1] + y].map(|v| v as isize);
    let buffer = band.read_as::<T>((first[0], first[1]), (w, h), (w, h), None).map_err(|e| fail(&e))?;
    Ok(buffer.into_shape_and_vec().1)
}

/// Which pixels of a rectangle a mask band shows; `None` where there is no mask band.
pub(super) fn read_mask(
    raster: &Raster,
    dataset: &Dataset,
    origin: [usize; 2],
    size: [usize; 2],
) -> Result<Option<Vec<bool>>, IngestError> {
    if !raster.bands()[0].has_mask {
        return Ok(None);
    }
    let first = [0, 1].map(|axis| (raster.first()[axis] + origin[axis]) as isize);
    let mask = dataset.rasterband(1).and_then(|band| {
        let mask = band.open_mask_band()?;
        mask.read_as::<u8>((first[0], first[1]), (size[0], size[1]), (size[0], size[1]), None)
    });
    let mask = mask.map_err(|e| raster.fails("has a mask that cannot be read", &e))?;
    Ok(Some(mask.data().iter().map(|m| *m != 0).collect()))
}

/// Which samples of a rectangle of elevation an alpha band shows at all; `None` where there is no
/// alpha band.
pub(super) fn read_alpha(
    raster: &Raster,
    dataset: &Dataset,
    origin: [usize; 2],
    size: [usize; 2],
) -> Result<Option<Vec<bool>>, IngestError> {
    let Some(index) = raster.bands().iter().skip(1).position(|b| b.shows == Shows::Alpha) else { return Ok(None) };
    let alpha = read_band::<f32>(raster, &dataset.rasterband(index + 2), origin, size)?;
    Ok(Some(alpha.into_iter().map(|a| a > 0.0).collect()))
}

/// An elevation source, open.
#[derive(Debug)]
pub struct ElevationReader<'a> {
    raster: &'a Raster,
    values: &'a ElevationValues,
    dataset: Dataset,
}

impl<'a> ElevationReader<'a> {
    /// Opens it.
    ///
    /// # Errors
    /// [`IngestError::Source`].
    pub fn open(raster: &'a Raster, values: &'a ElevationValues) -> Result<Self, IngestError> {
        Ok(Self { raster, values, dataset: open_raster(raster)? })
    }
}

impl Reader<1> for ElevationReader<'_> {
    fn size(&self) -> [usize; 2] {
        self.raster.size()
    }

    fn read(&self, origin: [usize; 2], size: [usize; 2]) -> Result<Window<1>, IngestError> {
        let band = self.dataset.rasterband(1);
        let samples = read_band::<f32>(self.raster, &band, origin, size)?;
        let mut window = Window::new(origin, size);
        for (at, sample) in samples.into_iter().enumerate() {
            match self.values.height(sample) {
                Some(height) => window.pixels[at] = [height],
                None => window.mask(at),
            }
        }
        for shown in [
            read_mask(self.raster, &self.dataset, origin, size)?,
            read_alpha(self.raster, &self.dataset, origin, size)?,
        ] {
            shown.iter().flatten().enumerate().filter(|(_, s)| !**s).for_each(|(at, _)| window.mask(at));
        }
        Ok(window)
    }
}

/// A colour source, open.
#[derive(Debug)]
pub struct ColorReader<'a> {
    raster: &'a Raster,
    values: &'a ColorValues,
    dataset: Dataset,
}

impl<'a> ColorReader<'a> {
    /// Opens it.
    ///
    /// # Errors
    /// [`IngestError::Source`].
    pub fn open(raster: &'a Raster, values: &'a ColorValues) -> Result<Self, IngestError> {
        Ok(Self { raster, values, dataset: open_raster(raster)? })
    }
}

impl Reader<3> for ColorReader<'_> {
    fn size(&self) -> [usize; 2] {
        self.raster.size()
    }

    fn read(&self, origin: [usize; 2], size: [usize; 2]) -> Result<Window<3>, IngestError> {
        let mut window = Window::new(origin, size);
        let samples = |band: usize| read_band::<f32>(self.raster, &self.dataset.rasterband(band), origin, size);
        let bands = self.values.color_bands();
        // A pixel is void only when all its bands are.
        let mut voids = vec![0u8; window.pixels.len()];
        for band in &bands {
            let palette = self.raster.bands()[band - 1].palette.as_deref();
            let channels: Vec<usize> = (0..3).filter(|&c| self.values.bands[c] == *band).collect();
            for (at, sample) in samples(*band)?.into_iter().enumerate() {
                if !self.values.is_data(self.raster, *band, sample) {
                    voids[at] += 1;
                    continue;
                }
                let Some(palette) = palette else {
                    let value = self.values.eight_bits(sample);
                    channels.iter().for_each(|channel| window.pixels[at][*channel] = value);
                    continue;
                };
                let entry = palette.get(sample as usize).copied().unwrap_or([0, 0, 0, 0]);
                channels.iter().for_each(|channel| window.pixels[at][*channel] = f32::from(entry[*channel]));
                voids[at] += u8::from(entry[3] == 0);
            }
        }
        let count = bands.len() as u8;
        voids.iter().enumerate().filter(|(_, v)| **v == count).for_each(|(at, _)| window.mask(at));
        if let Some((band, least)) = self.values.alpha {
            samples(band)?.into_iter().enumerate().filter(|(_, a)| *a < least).for_each(|(at, _)| window.mask(at));
        } else {
            let shown = read_mask(self.raster, &self.dataset, origin, size)?;
            shown.iter().flatten().enumerate().filter(|(_, s)| !**s).for_each(|(at, _)| window.mask(at));
        }
        Ok(window)
    }
}
