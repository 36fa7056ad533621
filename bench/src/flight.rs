//! The flight that the benches fly: once around the middle of the world, looking down into it,
//! closed, so that a second round sees exactly what the first one saw.

use anyhow::{Context, ensure};
use glam::DVec2;
use std::f64::consts::TAU;
use std::path::Path;
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::database::{Database, TileScratch};
use terravision_common::ground::ground_height;
use terravision_common::shm::CameraRecord;

/// Height of the camera above the ground below it, as a share of the world's shorter side, and at
/// least this many metres.
const HEIGHT_SHARE: f64 = 0.025;
const HEIGHT_M: f64 = 150.0;
/// Vertical field of view.
const VFOV_DEG: f64 = 60.0;

/// A database and the poses of one round over it.
#[derive(Debug)]
pub struct Flight {
    /// The database.
    pub database: Database,
    /// Poses of one round.
    pub round: Vec<Camera>,
}

impl Flight {
    /// A round of `frames` poses of pictures of `size` over the database in a folder.
    ///
    /// # Errors
    /// When the database does not open or the ground cannot be read.
    pub fn open(folder: &Path, frames: u64, size: [u32; 2]) -> anyhow::Result<Self> {
        ensure!(frames > 0, "a flight has one frame at least");
        let database = Database::open(folder).with_context(|| format!("cannot open {}", folder.display()))?;
        let world = *database.world();
        let [width, height] = world.extent_m();
        let mut scratch = TileScratch::default();
        let radius = 0.28 * width.min(height);
        let up = (HEIGHT_SHARE * width.min(height)).max(HEIGHT_M);
        // The ground below is smoothed along the way by taking the highest of its surroundings: no
        // jumps.
        let mut below = Vec::new();
        for k in 0..frames {
            let angle = TAU * k as f64 / frames as f64;
            let (x, y) = (0.5 * width + radius * angle.sin(), 0.5 * height + radius * angle.cos());
            let ground = ground_height(&database, &world, x, y, &mut scratch).context("cannot read the ground")?;
            below.push((angle, x, y, ground.unwrap_or_default()));
        }
        let reach = (frames as usize / 12).max(1);
        let highest = |k: usize| {
            let around = (k + below.len() - reach.min(below.len()))..=(k + below.len() + reach);
            let heights: Vec<f64> = around.map(|i| below[i % below.len()].3).collect();
            heights.iter().copied().fold(f64::NEG_INFINITY, f64::max)
        };
        let tops: Vec<f64> = (0..below.len()).map(highest).collect();
        let smooth = |k: usize| {
            let around = (k + below.len() - reach.min(below.len()))..=(k + below.len() + reach);
            let count = around.clone().count() as f64;
            around.map(|i| tops[i % tops.len()]).sum::<f64>() / count
        };
        let round = below
            .iter()
            .enumerate()
            .map(|(k, &(angle, x, y, _))| CameraFields {
                eye_in_world: world.plane().position(DVec2::new(x, y), smooth(k) + up).to_array(),
                // Along the way, turned inwards by a third of a right angle.
                heading_rad: angle + TAU / 4.0 + TAU / 12.0,
                pitch_rad: -22f64.to_radians(),
                roll_rad: 0.0,
                vfov_rad: VFOV_DEG.to_radians(),
                width: size[0],
                height: size[1],
                timestamp_nanos: 0,
            })
            .map(Camera::new)
            .collect::<Result<_, _>>()?;
        Ok(Self { database, round })
    }

    /// The records of this many rounds, frames counted from 0.
    #[must_use]
    pub fn records(&self, rounds: u64) -> Vec<CameraRecord> {
        let cameras = (0..rounds).flat_map(|_| self.round.iter().copied());
        cameras.zip(0..).map(|(camera, frame)| CameraRecord { frame, camera: *camera.fields() }).collect()
    }
}
