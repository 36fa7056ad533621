//! The part of a plan that other programs have in the flight.

use super::checks::in_range;
use super::picture_choice;
use crate::cli::draw::DrawArgs;
use crate::cli::fly::FlyArgs;
use crate::cli::planes::PlaneArgs;
use crate::cli::values::PictureSize;
use crate::failure::Failure;
use crate::ground::WorldGround;
use crate::input::gate::{Gate, GateSettings};
use crate::input::{CameraInput, CameraSource, LiveCamera};
use crate::world::open_world;
use anyhow::anyhow;
use std::path::Path;
use std::time::Duration;
use terravision_common::run::{RunConfig, ShareConfig, SinkConfig};
use terravision_common::shm::SharedName;

/// The name in `-o shared:NAME`.
pub(super) fn shared_name(output: &Path) -> Option<&str> {
    output.to_str()?.strip_prefix("shared:")
}

/// The frame ring that is asked for, by `-o shared:NAME` or by `--share NAME`.
pub(super) fn share(args: &FlyArgs) -> Result<Option<ShareConfig>, Failure> {
    let name = match (shared_name(&args.output), args.live.share.as_deref()) {
        (Some(_), Some(second)) => {
            return Err(Failure::bad_input(anyhow!(
                "--share {second}: frames already go to -o {}; leave one out",
                args.output.display()
            )));
        }
        (Some(name), None) | (None, Some(name)) => name,
        (None, None) => return Ok(None),
    };
    let name = SharedName::parse(name).map_err(Failure::bad_input)?.to_string();
    let PlaneArgs { depth, ground } = &args.planes;
    Ok(Some(ShareConfig { name, has_depth: depth.is_some(), has_ground: ground.is_some() }))
}

/// Whether frames may differ in size: those of files and of films have one.
fn takes_any_size(config: &RunConfig) -> bool {
    let render = &config.render;
    config.rig.is_none() && render.sink == SinkConfig::Null && render.depth.is_empty() && render.ground.is_empty()
}

/// The input that `--camera` asks for, listening.
pub(super) fn camera(args: &FlyArgs, config: &RunConfig) -> Result<Option<LiveCamera>, Failure> {
    let Some(source) = &args.live.camera else { return Ok(None) };
    let idle = |seconds| in_range("--idle-timeout", seconds, 0.01, 1e6, "seconds from 0.01 to 1000000");
    let idle_timeout = args.live.idle_timeout.map(idle).transpose()?.map(Duration::from_secs_f64);
    input(source, &args.draw, idle_timeout, config).map(Some)
}

/// An input of poses over this world, listening.
pub(super) fn input(
    source: &CameraSource,
    args: &DrawArgs,
    idle_timeout: Option<Duration>,
    config: &RunConfig,
) -> Result<LiveCamera, Failure> {
    // The pilot looks at the ground on a thread of its own.
    let database = open_world(&args.world, &args.database)?;
    let extent = WorldGround::finest(&database, database.world(), config.exaggeration).extent();
    let RunConfig { width, height, .. } = *config;
    let vfov_rad = picture_choice::vfov_rad(&args.picture, None, PictureSize { width, height })?;
    let gate = Gate::new(GateSettings { size: [width, height], has_sizes: takes_any_size(config), vfov_rad, extent });
    let input = CameraInput::open(source, gate).map_err(Failure::bad_input)?;
    Ok(LiveCamera { input, database, exaggeration: config.exaggeration, idle_timeout })
}
