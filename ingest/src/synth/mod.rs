//! A synthetic world: `dem.tif` and `ortho.tif`.
//!
//! Both are made block by block, each a pure function of position and seed; a block of the photo
//! covers a block of the DEM, whose heights it needs. The photo's edges are on the DEM's outer
//! posts; the DEM, whose pixels have an area, extends half a pixel beyond.

pub mod body;
pub mod noise;
pub mod ortho;
pub mod terrain;

use crate::error::{IngestError, gdal_message};
use crate::job::quieten_gdal;
use crate::sample::elevation::quantized;
use crate::work::Work;
use gdal::errors::CplErrType;
use gdal::raster::{Buffer, ColorInterpretation, GdalType, RasterCreationOptions};
use gdal::spatial_ref::SpatialRef;
use gdal::{Dataset, DriverManager};
use ortho::{Ground, Painter};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError};
use terrain::Terrain;

/// WGS 84 / UTM zone 32N: the Alps.
const EPSG: u32 = 32632;
/// Where the world's middle is, metres.
const MIDDLE: [f64; 2] = [500_000.0, 5_200_000.0];
/// The position of its south west corner in the infinite terrain, chosen so that small worlds have
/// a lake and mountains too.
const CORNER: [f64; 2] = [17_500.0, 16_500.0];
/// Posts along a block's side; the photo has twice as many pixels. Also the tile size of both
/// files.
const BLOCK: usize = 256;

/// What is asked for, checked.
#[derive(Debug, Clone)]
pub struct SynthOptions {
    /// Folder to write to.
    pub output: PathBuf,
    /// Intervals along a side.
    pub size: u32,
    /// Distance of posts, metres.
    pub spacing_m: f64,
    /// Which world.
    pub seed: u64,
    /// Threads.
    pub threads: usize,
    /// Whether files that are there are replaced.
    pub may_overwrite: bool,
}

/// What is made.
const FILES: [&str; 2] = ["dem.tif", "ortho.tif"];

/// A block as it is made: heights and colours, rows from the north.
struct Block {
    /// Column and row of its first post, from the north west.
    first: [usize; 2],
    posts: [usize; 2],
    heights: Vec<f32>,
    pixels: [usize; 2],
    colors: [Vec<u8>; 3],
}

/// Makes the world's blocks.
#[derive(Debug, Clone, Copy)]
struct Maker {
    terrain: Terrain,
    painter: Painter,
    size: usize,
    spacing_m: f64,
}

impl Maker {
    /// Metres east and north of the world's south west corner. Positions do not depend on the size:
    /// a smaller world is the south west of a larger one.
    fn place(&self, column: f64, row: f64) -> [f64; 2] {
        [CORNER[0] + column * self.spacing_m, CORNER[1] + (self.size as f64 - row) * self.spacing_m]
    }

    fn block(&self, first: [usize; 2]) -> Block {
        let posts = first.map(|f| BLOCK.min(self.size + 1 - f));
        // Two posts more on each side, so that slopes are the same on both sides of a block's edge.
        const MARGIN: usize = 2;
        let wide = posts.map(|n| n + 2 * MARGIN + 1);
        let mut heights = Vec::with_capacity(wide[0] * wide[1]);
        for j in 0..wide[1] {
            for i in 0..wide[0] {
                let at = [(first[0] + i) as f64 - MARGIN as f64, (first[1] + j) as f64 - MARGIN as f64];
                let [x, y] = self.place(at[0], at[1]);
                heights.push(quantized(self.terrain.height(x, y)));
            }
        }
        let own =
            (0..posts[1]).flat_map(|j| &heights[(j + MARGIN) * wide[0] + MARGIN..][..posts[0]]).copied().collect();
        let pixels = [0, 1].map(|a| posts[a].min(self.size - first[a]) * 2);
        let mut colors = [0, 1, 2].map(|_| Vec::with_capacity(pixels[0] * pixels[1]));
        let slope = |at: usize, step: usize| (heights[at + step] - heights[at - step]) * (0.5 / self.spacing_m) as f32;
        for row in 0..pixels[1] {
            for column in 0..pixels[0] {
                // Pixel centres are a quarter and three quarters of the way from post to post.
                let (u, v) = (0.25 + 0.5 * column as f32, 0.25 + 0.5 * row as f32);
                let (i, j) = (u as usize, v as usize);
                let (s, t) = (u - i as f32, v - j as f32);
                let at = (j + MARGIN) * wide[0] + i + MARGIN;
                let between = |f: &dyn Fn(usize) -> f32| {
                    let north = f(at) + s * (f(at + 1) - f(at));
                    let south = f(at + wide[0]) + s * (f(at + wide[0] + 1) - f(at + wide[0]));
                    north + t * (south - north)
                };
                let ground = Ground {
                    at: self.place(first[0] as f64 + f64::from(u), first[1] as f64 + f64::from(v)),
                    height: between(&|at| heights[at]),
                    slope: [between(&|at| slope(at, 1)), -between(&|at| slope(at, wide[0]))],
                };
                let color = self.painter.color(&ground);
                colors.iter_mut().zip(color).for_each(|(band, v)| band.push(v.round() as u8));
            }
        }
        Block { first, posts, heights: own, pixels, colors }
    }
}

/// Writes the world. Files get their names when they are complete.
///
/// # Errors
/// [`IngestError`].
pub fn write(options: &SynthOptions, stop: Arc<AtomicBool>, shows_progress: bool) -> Result<(), IngestError> {
    quieten_gdal(256 << 20);
    let complaints = Complaints::listen();
    let folder = &options.output;
    let fail = |path: &Path| {
        let path = path.to_owned();
        move |source| IngestError::Output { source, path }
    };
    check_free(folder, options.may_overwrite)?;
    let work = Work::new(options.threads, stop, shows_progress, folder.clone());
    let parts = Parts { paths: FILES.map(|name| folder.join(format!("{name}.part"))) };
    let size = options.size as usize;
    let span = f64::from(options.size) * options.spacing_m;
    let [west, north] = [MIDDLE[0] - 0.5 * span, MIDDLE[1] + 0.5 * span];
    let (s, half) = (options.spacing_m, 0.5 * options.spacing_m);
    let srs = SpatialRef::from_epsg(EPSG).map_err(|e| gdal_error(folder, &e))?;
    let mut dem = create::<f32>(&parts.paths[0], [size + 1; 2], 1, [west - half, s, 0.0, north + half, 0.0, -s], &srs)?;
    let mut photo = create::<u8>(&parts.paths[1], [2 * size; 2], 3, [west, half, 0.0, north, 0.0, -half], &srs)?;
    let terrain = Terrain::new(options.seed);
    let maker = Maker { terrain, painter: Painter::new(terrain, half), size, spacing_m: s };
    let columns = (size + 1).div_ceil(BLOCK);
    work.in_order(
        "synthetic world",
        columns * columns,
        || Ok(()),
        |(), index| Ok(maker.block([index % columns * BLOCK, index / columns * BLOCK])),
        |block| {
            put(&dem, &parts.paths[0], 1, block.first, block.posts, block.heights)?;
            if block.pixels[0] > 0 && block.pixels[1] > 0 {
                for (band, samples) in block.colors.into_iter().enumerate() {
                    put(&photo, &parts.paths[1], band + 1, block.first.map(|v| 2 * v), block.pixels, samples)?;
                }
            }
            Ok(())
        },
    )?;
    for (dataset, path) in [(&mut dem, &parts.paths[0]), (&mut photo, &parts.paths[1])] {
        dataset.flush_cache().map_err(|e| gdal_error(path, &e))?;
    }
    dem.close().map_err(|e| gdal_error(&parts.paths[0], &e))?;
    photo.close().map_err(|e| gdal_error(&parts.paths[1], &e))?;
    complaints.none(folder)?;
    for (path, name) in parts.paths.iter().zip(FILES) {
        fs::rename(path, folder.join(name)).map_err(fail(path))?;
    }
    Ok(())
}

/// Makes the folder for both files, unless they are there and may not be replaced.
fn check_free(folder: &Path, may_overwrite: bool) -> Result<(), IngestError> {
    if let Some(there) = FILES.iter().map(|name| folder.join(name)).find(|path| path.exists() && !may_overwrite) {
        return Err(IngestError::usage(format!(
            "{} is there already: --overwrite replaces it, or choose another folder",
            there.display()
        )));
    }
    if folder.exists() && !folder.is_dir() {
        return Err(IngestError::usage(format!("{} is a file, expected a folder to write to", folder.display())));
    }
    fs::create_dir_all(folder).map_err(|source| IngestError::Place { source, path: folder.to_owned() })
}

/// What GDAL complains of: blocks are written late, from its cache, and that a disk is full is then
/// no caller's error.
struct Complaints(Arc<Mutex<Option<String>>>);

impl Complaints {
    fn listen() -> Self {
        let first = Arc::new(Mutex::new(None));
        let heard = Arc::clone(&first);
        gdal::config::set_error_handler(move |class, _, text| {
            if matches!(class, CplErrType::Failure | CplErrType::Fatal) {
                let mut first = heard.lock().unwrap_or_else(PoisonError::into_inner);
                first.get_or_insert_with(|| text.split_whitespace().collect::<Vec<_>>().join(" "));
            }
        });
        Self(first)
    }

    fn none(&self, folder: &Path) -> Result<(), IngestError> {
        match self.0.lock().unwrap_or_else(PoisonError::into_inner).take() {
            Some(text) => Err(IngestError::Output { source: io::Error::other(text), path: folder.to_owned() }),
            None => Ok(()),
        }
    }
}

/// Unfinished files; whatever is left of them goes when it is dropped.
struct Parts {
    paths: [PathBuf; 2],
}

impl Drop for Parts {
    fn drop(&mut self) {
        for path in &self.paths {
            // Renamed already, when all went well.
            fs::remove_file(path).ok();
        }
    }
}

fn gdal_error(path: &Path, error: &gdal::errors::GdalError) -> IngestError {
    IngestError::Output { source: io::Error::other(gdal_message(error)), path: path.to_owned() }
}

fn create<T: GdalType>(
    path: &Path,
    size: [usize; 2],
    bands: usize,
    transform: [f64; 6],
    srs: &SpatialRef,
) -> Result<Dataset, IngestError> {
    let predictor = if T::datatype().is_floating() { "PREDICTOR=3" } else { "PREDICTOR=2" };
    let block = format!("BLOCKXSIZE={BLOCK}");
    let rows = format!("BLOCKYSIZE={BLOCK}");
    let options = ["TILED=YES", &block, &rows, "COMPRESS=DEFLATE", "ZLEVEL=3", predictor, "BIGTIFF=IF_SAFER"];
    let make = || -> gdal::errors::Result<Dataset> {
        let mut list = RasterCreationOptions::new();
        for option in options {
            list.add_string(option)?;
        }
        let driver = DriverManager::get_driver_by_name("GTiff")?;
        let mut dataset = driver.create_with_band_type_with_options::<T, _>(path, size[0], size[1], bands, &list)?;
        dataset.set_geo_transform(&transform)?;
        dataset.set_spatial_ref(srs)?;
        if bands == 3 {
            let shows = [ColorInterpretation::RedBand, ColorInterpretation::GreenBand, ColorInterpretation::BlueBand];
            for (band, shows) in (1..=3).zip(shows) {
                dataset.rasterband(band)?.set_color_interpretation(shows)?;
            }
        }
        Ok(dataset)
    };
    make().map_err(|e| gdal_error(path, &e))
}

fn put<T: GdalType + Copy>(
    dataset: &Dataset,
    path: &Path,
    band: usize,
    first: [usize; 2],
    size: [usize; 2],
    samples: Vec<T>,
) -> Result<(), IngestError> {
    let write = || -> gdal::errors::Result<()> {
        let mut buffer = Buffer::new((size[0], size[1]), samples);
        dataset.rasterband(band)?.write((first[0] as isize, first[1] as isize), (size[0], size[1]), &mut buffer)
    };
    write().map_err(|e| gdal_error(path, &e))
}
