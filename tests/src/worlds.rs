//! Worlds to fly over, made once per build of the programs and shared by all tests.

use crate::folder::target_tmp;
use crate::geotiff::{read_colors, read_heights, write_colors, write_heights};
use crate::process::{Terravision, binary};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::{Duration, UNIX_EPOCH};
use terravision_testkit::reference::{Colors, Heights, Scene};

/// A terrain database together with the rasters that it was made from.
#[derive(Debug)]
pub struct TestWorld {
    folder: PathBuf,
    rasters: OnceLock<(Heights, Colors)>,
}

impl TestWorld {
    /// The world of a folder with `dem.tif`, `ortho.tif` and `world.tv`.
    #[must_use]
    pub fn at(folder: impl Into<PathBuf>) -> Self {
        Self { folder: folder.into(), rasters: OnceLock::new() }
    }

    /// The database's folder.
    #[must_use]
    pub fn database(&self) -> PathBuf {
        self.folder.join("world.tv")
    }

    /// The elevation that it was made from.
    #[must_use]
    pub fn dem(&self) -> PathBuf {
        self.folder.join("dem.tif")
    }

    /// The colour that it was made from.
    #[must_use]
    pub fn ortho(&self) -> PathBuf {
        self.folder.join("ortho.tif")
    }

    fn rasters(&self) -> &(Heights, Colors) {
        self.rasters.get_or_init(|| {
            let heights = read_heights(&self.dem()).unwrap_or_else(|error| panic!("{error}"));
            let colors = read_colors(&self.ortho()).unwrap_or_else(|error| panic!("{error}"));
            (heights, colors)
        })
    }

    /// The elevation raster, for the reference renderer.
    ///
    /// # Panics
    /// When it cannot be read.
    #[must_use]
    pub fn heights(&self) -> &Heights {
        &self.rasters().0
    }

    /// What the reference renderer looks at.
    ///
    /// # Panics
    /// When the rasters cannot be read.
    #[must_use]
    pub fn scene(&self) -> Scene<'_> {
        let (heights, colors) = self.rasters();
        Scene { heights, colors }
    }

    /// A point of the CRS, given as fractions of the extent east and north, and metres above the
    /// ground there.
    ///
    /// # Panics
    /// When the fractions are not from 0 to 1.
    #[must_use]
    pub fn above(&self, east: f64, north: f64, height_m: f64) -> [f64; 3] {
        let heights = self.heights();
        let ([x0, y0], [width, height]) = (heights.origin(), heights.extent_m());
        let (x, y) = (x0 + east * width, y0 + north * height);
        let ground = heights.at(x, y).expect("a fraction of the extent is inside");
        [x, y, ground + height_m]
    }
}

/// The synthetic world of `terravision synth --size SIZE`: 10 m posts, 5 m colour.
///
/// # Panics
/// When it cannot be made.
#[must_use]
pub fn synth_world(size: u32) -> TestWorld {
    TestWorld::at(cached(&format!("synth-{size}"), |folder| {
        Terravision::verb("synth")
            .args(["--size", &size.to_string(), "-o"])
            .arg(folder)
            .deadline(Duration::from_secs(600))
            .succeed();
        ingest(folder, &[]);
    }))
}

/// A world as rough as none is: noise of every wavelength, single spikes of hundreds of metres,
/// 1025 x 1025 posts at 10 m. Its colours are greys, so any saturated sky is a colour that no
/// texture has.
///
/// # Panics
/// When it cannot be made.
#[must_use]
pub fn rough_world() -> TestWorld {
    const POSTS: usize = 1025;
    TestWorld::at(cached("rough", |folder| {
        let mut heights = vec![0.0f32; POSTS * POSTS];
        for octave in 0..10u32 {
            let period = 1usize << octave;
            let amplitude = 1.2 * (period as f64).powf(0.8);
            for (k, height) in heights.iter_mut().enumerate() {
                let (i, j) = (k % POSTS, k / POSTS);
                let (u, v) = ((i % period) as f64 / period as f64, (j % period) as f64 / period as f64);
                let corner = |di, dj| noise((i / period + di) as u64, (j / period + dj) as u64, u64::from(octave));
                let low = corner(0, 0) + (corner(1, 0) - corner(0, 0)) * u;
                let high = corner(0, 1) + (corner(1, 1) - corner(0, 1)) * u;
                *height += ((low + (high - low) * v) * amplitude) as f32;
            }
        }
        for (k, height) in heights.iter_mut().enumerate() {
            if noise((k % POSTS) as u64, (k / POSTS) as u64, 99) > 0.997 {
                *height += 250.0;
            }
        }
        let side = 2 * (POSTS - 1);
        let colors: Vec<[u8; 3]> = (0..side * side)
            .map(|k| [(130.0 + 90.0 * noise((k % side) as u64, (k / side) as u64, 7)) as u8; 3])
            .collect();
        write_heights(&folder.join("dem.tif"), POSTS, POSTS, [500_000.0, 5_000_000.0], 10.0, &heights);
        write_colors(&folder.join("ortho.tif"), side, side, [500_000.0, 5_000_000.0], 5.0, &colors);
        ingest(folder, &[]);
    }))
}

/// The folder of a database every tile of which has the one colour that names its node
/// (`synthetic::name_color`): 256 x 256 nodes of level 0, a quarter of them mountains and the
/// others a plain.
///
/// # Panics
/// When it cannot be made.
#[must_use]
pub fn named_world() -> PathBuf {
    let make = |folder: &Path| {
        Terravision::program(binary("terravision-ingest"))
            .args(["sparse", "--named", "--detailed-nodes", "128", "--doublings", "1", "-o"])
            .arg(folder.join("world.tv"))
            .deadline(Duration::from_secs(600))
            .succeed();
    };
    cached("named", make).join("world.tv")
}

/// White noise from -1 to 1.
fn noise(i: u64, j: u64, seed: u64) -> f64 {
    let mut h = i.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ j.wrapping_mul(0xC2B2_AE3D_27D4_EB4F) ^ (seed << 32 | seed);
    h = (h ^ (h >> 33)).wrapping_mul(0xFF51_AFD7_ED55_8CCD);
    h = (h ^ (h >> 33)).wrapping_mul(0xC4CE_B9FE_1A85_EC53);
    ((h ^ (h >> 33)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

/// Ingests `dem.tif` and `ortho.tif` of a folder into its `world.tv`.
///
/// # Panics
/// When ingest fails or warns.
pub fn ingest(folder: &Path, more: &[&str]) {
    Terravision::verb("ingest")
        .arg("--elevation")
        .arg(folder.join("dem.tif"))
        .arg("--color")
        .arg(folder.join("ortho.tif"))
        .arg("-o")
        .arg(folder.join("world.tv"))
        .arg("--overwrite")
        .args(more)
        .deadline(Duration::from_secs(600))
        .succeed();
}

/// A folder of this name that `make` has filled, for this build of the ingest program. Other test
/// processes wait.
fn cached(name: &str, make: impl FnOnce(&Path)) -> PathBuf {
    let program = fs::metadata(binary("terravision-ingest")).expect("the program was just built");
    let changed = program.modified().ok().and_then(|t| t.duration_since(UNIX_EPOCH).ok()).map_or(0, |d| d.as_nanos());
    let worlds = target_tmp().join("worlds");
    let folder = worlds.join(format!("{name}-{:x}-{changed:x}", program.len()));
    fs::create_dir_all(&worlds).unwrap_or_else(|error| panic!("{}: {error}", worlds.display()));
    let lock = File::create(worlds.join(format!("{name}.lock"))).expect("a lock file can be made");
    rustix::fs::flock(&lock, rustix::fs::FlockOperation::LockExclusive).expect("a lock can be had");
    if !folder.join("done").exists() {
        for old in fs::read_dir(&worlds).into_iter().flatten().flatten() {
            if old.file_name().to_string_lossy().starts_with(&format!("{name}-")) {
                // An older build's world.
                drop(fs::remove_dir_all(old.path()));
            }
        }
        fs::create_dir_all(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
        make(&folder);
        File::create(folder.join("done")).expect("a mark can be made");
    }
    folder
}
