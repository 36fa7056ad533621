//! What the tests of ingest share: rasters made on the spot, folders that go away, the program run
//! with a deadline.

#![allow(dead_code, clippy::unwrap_used, reason = "each test binary uses its own part; a test fails by panicking")]

use gdal::raster::{Buffer, ColorInterpretation, GdalType, RasterCreationOptions};
use gdal::spatial_ref::SpatialRef;
use gdal::{Dataset, DriverManager, Metadata};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};
use terravision_common::database::{Database, TileScratch, TileSource, color_tile_bytes};
use terravision_common::node::NodeId;
use terravision_common::world::COLOR_BORDER;
use terravision_ingest::IngestError;
use terravision_ingest::job::Job;
use terravision_ingest::plan::PlanOptions;
use terravision_ingest::source::Note;

/// A folder of its own that is removed in the end.
#[derive(Debug)]
pub(crate) struct TestFolder(PathBuf);

impl TestFolder {
    pub(crate) fn new() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let name = format!("tv-ingest-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
        let path = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }
}

impl Drop for TestFolder {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.0).ok();
    }
}

/// A GeoTIFF to be made.
pub(crate) struct Tiff<'a, T> {
    pub(crate) size: [usize; 2],
    pub(crate) transform: Option<[f64; 6]>,
    pub(crate) crs: Option<&'a str>,
    pub(crate) bands: Vec<Vec<T>>,
    pub(crate) nodata: Option<f64>,
    pub(crate) options: &'a [&'a str],
    pub(crate) is_point: bool,
    pub(crate) has_alpha: bool,
    pub(crate) unit: &'a str,
}

pub(crate) const UTM: &str = "EPSG:32632";

impl<T: GdalType + Copy + 'static> Tiff<'_, T> {
    /// One band of `f(column, row)` in UTM, spacing 10, north up from easting 500000, northing
    /// 5000000.
    pub(crate) fn utm(size: [usize; 2], f: impl Fn(usize, usize) -> T) -> Self {
        let band = (0..size[0] * size[1]).map(|k| f(k % size[0], k / size[0])).collect();
        Self {
            size,
            transform: Some([500_000.0, 10.0, 0.0, 5_000_000.0, 0.0, -10.0]),
            crs: Some(UTM),
            bands: vec![band],
            nodata: None,
            options: &[],
            is_point: false,
            has_alpha: false,
            unit: "",
        }
    }

    pub(crate) fn write(self, path: &Path) -> PathBuf {
        let mut options = RasterCreationOptions::new();
        self.options.iter().for_each(|o| options.add_string(o).unwrap());
        let driver = DriverManager::get_driver_by_name("GTiff").unwrap();
        let (w, h) = (self.size[0], self.size[1]);
        let mut dataset: Dataset =
            driver.create_with_band_type_with_options::<T, _>(path, w, h, self.bands.len(), &options).unwrap();
        if self.is_point {
            dataset.set_metadata_item("AREA_OR_POINT", "Point", "").unwrap();
        }
        if let Some(transform) = self.transform {
            dataset.set_geo_transform(&transform).unwrap();
        }
        if let Some(crs) = self.crs {
            dataset.set_spatial_ref(&SpatialRef::from_definition(crs).unwrap()).unwrap();
        }
        let count = self.bands.len();
        for (index, band) in self.bands.into_iter().enumerate() {
            let mut raster = dataset.rasterband(index + 1).unwrap();
            if self.nodata.is_some() {
                raster.set_no_data_value(self.nodata).unwrap();
            }
            if !self.unit.is_empty() {
                raster.set_metadata_item("units", self.unit, "").ok();
            }
            if self.has_alpha && index + 1 == count {
                raster.set_color_interpretation(ColorInterpretation::AlphaBand).unwrap();
            }
            raster.write((0, 0), (w, h), &mut Buffer::new((w, h), band)).unwrap();
        }
        dataset.close().unwrap();
        path.to_owned()
    }
}

/// A job with small tiles, so that small rasters make several levels.
pub(crate) fn job(elevation: &[PathBuf], color: &[PathBuf], output: PathBuf) -> Job {
    Job {
        plan: PlanOptions { elevation_tile: 8, color_tile: 32, spacing_m: None },
        threads: 2,
        memory_bytes: 512 << 20,
        color_quality: 98,
        ..Job::new(elevation.to_vec(), color.to_vec(), output)
    }
}

/// Runs a job; the database and what was said.
pub(crate) fn run(job: &Job) -> Result<(Database, Vec<Note>), IngestError> {
    let mut notes = Vec::new();
    job.run(Arc::default(), false, &mut |note| notes.push(note))?;
    Ok((Database::open(&job.output).unwrap(), notes))
}

/// Heights of all posts of a level, row 0 in the south, and columns of them.
pub(crate) fn heights(database: &Database, q: u8) -> (Vec<f32>, usize) {
    let world = database.world();
    let [columns, rows] = world.nodes_at(q).map(|n| n as usize);
    let (side, posts) = (world.elevation_tile() as usize, world.elevation_posts() as usize);
    let width = columns * side + 1;
    let mut all = vec![f32::NAN; width * (rows * side + 1)];
    let (mut tile, mut scratch) = (vec![0.0; world.elevation_values()], TileScratch::default());
    for (m, n) in (0..rows).flat_map(|n| (0..columns).map(move |m| (m, n))) {
        let node = NodeId::new(m as u32, n as u32, q).unwrap();
        database.read_elevation(node, &mut tile, &mut scratch).unwrap();
        for (k, height) in tile[..posts * posts].iter().enumerate() {
            let at = (n * side + k / posts) * width + m * side + k % posts;
            assert!(all[at].is_nan() || all[at].to_bits() == height.to_bits(), "borders of {node} differ at {k}");
            all[at] = *height;
        }
    }
    (all, width)
}

/// Colours of all texels of a level, row 0 in the **south**, and columns of them.
pub(crate) fn colors(database: &Database, q: u8) -> (Vec<[u8; 3]>, usize) {
    let world = database.world();
    let [columns, rows] = world.nodes_at(q).map(|n| n as usize);
    let (side, stored, border) = (world.color_tile() as usize, world.color_stored() as usize, COLOR_BORDER as usize);
    let width = columns * side;
    let mut all = vec![[0; 3]; width * rows * side];
    let (mut tile, mut scratch) = (vec![0; color_tile_bytes(world)], TileScratch::default());
    for (m, n) in (0..rows).flat_map(|n| (0..columns).map(move |m| (m, n))) {
        database.read_color(NodeId::new(m as u32, n as u32, q).unwrap(), &mut tile, &mut scratch).unwrap();
        for k in 0..side * side {
            let at = ((stored - 1 - border - k / side) * stored + border + k % side) * 4;
            all[(n * side + k / side) * width + m * side + k % side] = [tile[at], tile[at + 1], tile[at + 2]];
        }
    }
    (all, width)
}

/// Whether two colours are within `by` of one another: tiles are JPEGs.
pub(crate) fn is_near(a: [u8; 3], b: [u8; 3], by: u8) -> bool {
    a.iter().zip(b).all(|(a, b)| a.abs_diff(b) <= by)
}

/// Starts the program.
pub(crate) fn command(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_terravision-ingest"));
    command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// Runs the program; kills it and fails when it takes longer than any of these tests should.
pub(crate) fn program(arguments: &[&str]) -> Output {
    finish(command(arguments).spawn().unwrap())
}

/// Waits for the program with a deadline.
pub(crate) fn finish(mut child: std::process::Child) -> Output {
    let deadline = Instant::now() + Duration::from_secs(300);
    while child.try_wait().unwrap().is_none() {
        if Instant::now() > deadline {
            child.kill().unwrap();
            panic!("the program did not end within its deadline");
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    child.wait_with_output().unwrap()
}

/// The error of a failed run: one line that begins so; nothing else looks like one.
pub(crate) fn error_line(output: &Output) -> String {
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!text.contains("panicked") && !text.contains("internal error"), "{text}");
    let errors: Vec<&str> = text.lines().filter(|l| !l.starts_with("note: ") && !l.starts_with("warning: ")).collect();
    assert_eq!(errors.len(), 1, "{text}");
    errors[0].strip_prefix("terravision: ").unwrap_or_else(|| panic!("no error line in {text}")).to_owned()
}
