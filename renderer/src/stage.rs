//! The renderer as a stage of a run: from its configuration to an engine, a source and sinks.

use crate::air::Air;
use crate::engine::{EngineOptions, ViewBounds};
use crate::gpu::DeviceChoice;
use crate::ports::Ports;
use crate::run::{self, RunError};
use crate::sink::workers::{Over, SinkWorkers};
use crate::sink::{SinkError, sinks_of};
use crate::vehicles::VehicleFeed;
use terravision_common::database::{DatabaseError, Index};
use terravision_common::event::{Event, TextKind};
use terravision_common::run::{RaysChoice, RunConfig};
use terravision_common::stage::{StageError, StageRun};

/// For tests: every device is lost when it is handed the frame of this number, counted from 1.
const LOSE_DEVICE_AT: &str = "TERRAVISION_TEST_LOSE_DEVICE_AT";
/// Most frames in flight: more only cost memory.
const MAX_FRAMES_IN_FLIGHT: u32 = 8;

/// Why the renderer gave up.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RendererError {
    /// The database cannot be opened.
    #[error(transparent)]
    Database {
        /// Why.
        #[from]
        source: DatabaseError,
    },
    /// The frames could not be drawn or written.
    #[error(transparent)]
    Run {
        /// Why.
        #[from]
        source: RunError,
    },
    /// This number of samples per pixel is not supported.
    #[error("{samples} samples per pixel were asked for, expected 1 or 4")]
    Samples {
        /// What was asked for.
        samples: u32,
    },
}

impl StageError for RendererError {
    fn is_stopping(&self) -> bool {
        matches!(self, Self::Run { source } if source.is_stopping())
    }

    fn is_bad_input(&self) -> bool {
        matches!(self, Self::Run { source } if source.is_bad_input())
    }
}

/// Draws the frames of a run.
///
/// # Errors
/// [`RendererError`].
pub fn run(run: &StageRun) -> Result<(), RendererError> {
    let config = run.config();
    let index = Index::open(&config.world)?;
    let world = *index.world();
    let ports = Ports::open(run).map_err(RunError::from)?;
    let mut source = ports.into_source(run, world).map_err(RunError::from)?;
    let written = source.control().written_frames();
    let sinks = sinks_of(run, source.control(), &index, written).map_err(RunError::from)?;
    let air = config.render.air.as_ref().map(|air| Air::new(air, config.render.sky_rgb));
    let sun = config.light.as_ref().map(|light| light.sun);
    let vehicles = config.render.vehicles.as_ref();
    let vehicles = vehicles.map(|vehicles| VehicleFeed::open(run.id(), vehicles, sun, config.realtime.is_some()));
    let vehicles = vehicles.transpose().map_err(SinkError::from).map_err(RunError::from)?;
    let workers = SinkWorkers::start_over(sinks, Over { air, vehicles }).map_err(RunError::from)?;
    run::run(
        options(config)?,
        &mut source,
        workers,
        &mut |engine, source| {
            let found = engine.describe();
            tracing::info!(technique = found.technique, reason = %found.reason, device = %found.device, driver = %found.driver, "draws with");
            let texts = [
                (TextKind::Device, found.device.as_str()),
                (TextKind::Driver, &found.driver),
                (TextKind::TechniqueReason, &found.reason),
                (TextKind::Technique, found.technique),
            ];
            for event in texts.into_iter().flat_map(|(kind, text)| Event::text(kind, text)) {
                source.event(&event);
            }
        },
        &mut |_finished| {},
    )?;
    Ok(())
}

/// How the frames of a run are drawn.
fn options(config: &RunConfig) -> Result<EngineOptions, RendererError> {
    let render = &config.render;
    if !matches!(render.samples, 1 | 4) {
        return Err(RendererError::Samples { samples: render.samples });
    }
    let is_depth_shared = render.share.as_ref().is_some_and(|share| share.has_depth || share.has_ground);
    // What exact frames look like must not depend on how fast the machine is.
    let is_open = config.realtime.is_some() || render.rays != RaysChoice::Auto;
    Ok(EngineOptions {
        technique: render.technique,
        reason: render.technique_reason.clone(),
        rays: if is_open { render.rays } else { RaysChoice::Mipmap },
        workers: config.decoder_threads as usize,
        device: DeviceChoice::from_environment(),
        size: [config.width, config.height],
        views: config.rig.as_ref().map(|rig| ViewBounds { size: rig.view_size(), count: rig.views().len() }),
        samples: render.samples,
        exaggeration: config.exaggeration,
        sky_rgb: render.sky_rgb,
        skirt_low_m: render.skirt_low_m.filter(|low| low.is_finite()),
        has_tree_overlay: render.has_tree_overlay,
        has_validation: render.has_validation,
        has_air: render.air.is_some(),
        has_depth: render.vehicles.is_some()
            || render.air.as_ref().is_some_and(Air::needs_depth)
            || render.labels.as_ref().is_some_and(|labels| labels.has_scale_bar)
            || !render.depth.is_empty()
            || !render.ground.is_empty()
            || is_depth_shared,
        frames_in_flight: render.frames_in_flight.min(MAX_FRAMES_IN_FLIGHT) as usize,
        lose_device_at: std::env::var(LOSE_DEVICE_AT).ok().and_then(|at| at.parse().ok()),
        ..EngineOptions::default()
    })
}
