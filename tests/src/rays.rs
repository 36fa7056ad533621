//! One picture by ray casting, straight from a database: no process, no device.

use crate::worlds::TestWorld;
use std::time::{Duration, Instant};
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::database::Database;
use terravision_common::level::{LevelFunction, Measure};
use terravision_raycast::Sampling;
use terravision_raycast::model::world::{WorldTiles, ground_shape};
use terravision_raycast::model::{Filter, Ground};
use terravision_raycast::{CastOptions, CastTask, Caster, Counts, Method, Picture};

/// How a picture is cast.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RaySettings {
    /// Coherent voxel samples, or exact rays.
    pub method: Method,
    /// Metres from the eye within which tiles have voxels; the others are drawn by their heights.
    pub accurate_m: f64,
    /// Wanted size of an elevation cell on screen, pixels.
    pub cell_px: f64,
    /// Wanted size of a texel on screen, pixels.
    pub texel_px: f64,
    /// How densities are made.
    pub filter: Filter,
}

impl RaySettings {
    /// Voxels everywhere, a pixel wide.
    #[must_use]
    pub const fn accurate() -> Self {
        let filter = Filter::OrientedBox;
        Self { method: Method::Coherent, accurate_m: f64::INFINITY, cell_px: 1.0, texel_px: 0.7, filter }
    }

    /// No voxels: the boundary array, and heights within it.
    #[must_use]
    pub const fn approximate() -> Self {
        Self { accurate_m: -1.0, ..Self::accurate() }
    }

    /// One exact ray per pixel.
    #[must_use]
    pub const fn mipmap() -> Self {
        Self { method: Method::Mipmap, ..Self::approximate() }
    }
}

/// A picture that was cast.
#[derive(Debug)]
pub struct Cast {
    /// Colours, rows from the top.
    pub rgb: Vec<[u8; 3]>,
    /// Metres along the view axis, NaN for sky.
    pub depth: Vec<f32>,
    /// What it took.
    pub counts: Counts,
    /// Tiles of ground, and bytes of their models.
    pub tiles: (usize, usize),
    /// Time of the picture alone, all tiles there and their models made.
    pub elapsed: Duration,
    /// Time of making the models.
    pub models: Duration,
}

/// Casts the view of a camera, its eye in the world's CRS.
///
/// # Panics
/// When the database cannot be read.
#[must_use]
pub fn cast(world: &TestWorld, camera: &Camera, sky_rgb: [u8; 3], settings: &RaySettings) -> Cast {
    let database = Database::open(&world.database()).unwrap_or_else(|error| panic!("{error}"));
    let geometry = *database.world();
    let origin = geometry.fields().origin;
    let [x, y, z] = camera.fields().eye_in_world;
    let camera = Camera::new(CameraFields { eye_in_world: [x - origin[0], y - origin[1], z], ..*camera.fields() })
        .expect("valid");
    // Levels measure facets by the side of the square with a facet's area; cells are √2 wider.
    let r_z_px = settings.cell_px / std::f64::consts::SQRT_2;
    let level = LevelFunction::new(&camera, &geometry, 1.0, Measure::Max, r_z_px, settings.texel_px);
    let mut tiles = WorldTiles::new(&geometry, &database, database.ranges());
    let mut ground = Ground::new(ground_shape(&geometry, Some(settings.filter)));
    let mut fill = || tiles.fill(&mut ground, &camera, &level, settings.accurate_m).unwrap_or_else(|e| panic!("{e}"));
    fill();
    let start = Instant::now();
    fill();
    let models = start.elapsed();
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let mut caster = Caster::new(threads).unwrap_or_else(|error| panic!("{error}"));
    let sampling = Sampling { interval_voxels: 0.6, voxel_px: 1.0f32.min(settings.cell_px as f32) };
    let options = CastOptions { method: settings.method, sampling, sky_rgb, ..CastOptions::default() };
    let layers = tiles.layers();
    let picture = Picture::new([camera.width(), camera.height()]);
    caster.draw(&CastTask {
        ground: &ground,
        colors: &layers,
        heights: &[],
        camera: &camera,
        options: &options,
        picture: &picture,
    });
    let start = Instant::now();
    let counts = caster.draw(&CastTask {
        ground: &ground,
        colors: &layers,
        heights: &[],
        camera: &camera,
        options: &options,
        picture: &picture,
    });
    let elapsed = start.elapsed();
    let rgb = |texel: u32| {
        let [r, g, b, _] = texel.to_le_bytes();
        [r, g, b]
    };
    Cast {
        rgb: picture.rgba().map(rgb).collect(),
        depth: picture.depth().collect(),
        counts,
        tiles: (ground.tile_count(), ground.bytes()),
        elapsed,
        models,
    }
}
