//! The predicted view, and the tiles that it wants. [`CameraTrack`] predicts it from recent
//! cameras, or [`Oracle`] knows it from the path; [`WantedTiles`] searches the tree.

mod camera_track;
mod oracle;
mod wanted_tiles;

pub use camera_track::{CameraTrack, widened_views};
pub use oracle::Oracle;
pub use wanted_tiles::{Resolution, WantedTiles};

use crate::scheduler::{CYCLE_NANOS, Scheduler};
use std::collections::HashSet;
use terravision_common::camera::Camera;
use terravision_common::database::Tile;
use terravision_common::rig::Views;
use terravision_common::run::{Prediction, RunConfig};
use terravision_common::shm::{CameraRecord, Consumer, Control, Gauge, ShmError};
use terravision_common::traversal::{HeightRanges, TreeLimits};
use terravision_common::world::World;

/// Limits for the trees of predicted views: those of the generator.
const LIMITS: TreeLimits = TreeLimits { nodes: 65536, elevation_leaves: 65536 };
/// The shortest and the longest time by which the view is predicted ahead.
const AHEAD_SECS: [f64; 2] = [0.4, 4.0];

/// The predicted view, and the tiles that it wants.
pub(crate) struct Ahead<R> {
    prediction: Prediction,
    config: RunConfig,
    track: CameraTrack,
    oracle: Option<Oracle>,
    wanted_tiles: Option<WantedTiles<R>>,
    tiles: Vec<Tile>,
}

impl<R: HeightRanges> Ahead<R> {
    pub(crate) fn new(world: &World, ranges: R, config: &RunConfig, path: Option<Consumer<CameraRecord>>) -> Self {
        let prediction = config.prefetch.prediction;
        let wanted_tiles = (prediction != Prediction::Off).then(|| WantedTiles::new(world, ranges, LIMITS));
        let track = CameraTrack::default();
        let oracle = path.map(Oracle::new);
        Self { prediction, config: config.clone(), track, oracle, wanted_tiles, tiles: Vec::new() }
    }

    pub(crate) fn see(&mut self, control: &Control, now: u64) {
        if let (Some(_), Some(camera)) = (&self.wanted_tiles, control.camera()) {
            self.track.see(&camera, now);
        }
    }

    pub(crate) fn look(
        &mut self,
        scheduler: &Scheduler,
        control: &Control,
        now: u64,
    ) -> Result<Option<&[Tile]>, ShmError> {
        let Some(wanted_tiles) = &mut self.wanted_tiles else { return Ok(None) };
        let ahead_secs = ahead_secs(scheduler.latency_nanos());
        let ahead_nanos = (ahead_secs * 1e9) as u64;
        control.set_gauge(Gauge::PredictedAheadNanos, ahead_nanos);
        let cameras: Vec<Camera> = match &mut self.oracle {
            // Before the clock starts, the camera waits for the first frame.
            Some(oracle) => oracle.cameras(now.saturating_sub(control.clock_start().unwrap_or(now)), ahead_nanos)?,
            None => self.track.predict(now, ahead_secs, self.prediction).into_iter().collect(),
        };
        if cameras.is_empty() {
            return Ok(None);
        }
        let resolution = Resolution {
            r_z_px: control.r_z_px().unwrap_or(self.config.r_z_px),
            r_c_px: control.r_c_px().unwrap_or(self.config.r_c_px),
            exaggeration: self.config.exaggeration,
            measure: self.config.measure,
        };
        self.tiles.clear();
        let mut seen = HashSet::new();
        // The views of a known path are exact; a prediction may be wrong.
        let unsure_secs = if self.oracle.is_some() { 0.0 } else { ahead_secs };
        for camera in &cameras {
            let views = match &self.config.rig {
                // From a predicted pose a rig may have no valid camera: it is passed over.
                Some(rig) => rig.views_from(camera).map(|views| widened_views(&views, unsure_secs)),
                None => Ok(Views::single(camera)),
            };
            let Ok(views) = views else { continue };
            let of_view = wanted_tiles.tiles(camera, &views, &resolution).iter().copied();
            self.tiles.extend(of_view.filter(|tile| cameras.len() == 1 || seen.insert(*tile)));
        }
        Ok(Some(&self.tiles))
    }
}

/// How far ahead the view is predicted when a tile takes this long: until the arrival of a tile
/// that is requested at the end of the next cycle.
#[must_use]
pub fn ahead_secs(latency_nanos: Option<u64>) -> f64 {
    let latency = latency_nanos.unwrap_or(0) as f64 / 1e9;
    (2.0 * latency + CYCLE_NANOS as f64 / 1e9).clamp(AHEAD_SECS[0], AHEAD_SECS[1])
}
