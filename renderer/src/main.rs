//! `terravision-renderer --run JSON`: draws the frames of a run. `--doctor-json`: what Vulkan devices there are.
//! `--floor-json`: what the device can do at best.

use anyhow::{Context, bail};
use std::io::Write;
use std::process::ExitCode;
use terravision_common::database::Index;
use terravision_common::event::{Event, EventKind};
use terravision_common::run::{PlaneTarget, RaysChoice, RunConfig, SinkConfig};
use terravision_common::stage::{BAD_USAGE, StageRun, UsageError, set_up_process};
use terravision_common::terminal::complain;
use terravision_renderer::bench::floor;
use terravision_renderer::engine::{EngineOptions, ViewBounds};
use terravision_renderer::gpu::{DeviceChoice, Needs, describe_adapters};
use terravision_renderer::run::{RunError, run};
use terravision_renderer::sink::workers::SinkWorkers;
use terravision_renderer::sink::{
    AllOf, DepthSink, EachViewSink, FrameSink, GroundSink, NullSink, PngFileSink, PngFolderSink, RepeatSink,
    SharedSink, SinkError, StreamSink,
};
use terravision_renderer::source::LiveSource;

const HELP: &str = "\
terravision-renderer: the stage of TerraVision that draws. The launcher (terravision) starts it.

  --run JSON             draw the frames of this run; --run - reads it from standard input
  --doctor-json          print the Vulkan devices, and what they lack, as JSON
  --floor-json WxH N     draw N frames of full-screen grids of this size, textured and depth-tested, and print the
                         times as JSON: the floor that no renderer on this device gets below

The environment variable TERRAVISION_DEVICE chooses a device: its number, or a part of its name.
";

/// For tests: every device is lost when it is handed its so many-th frame.
const LOSE_DEVICE_AT: &str = "TERRAVISION_TEST_LOSE_DEVICE_AT";
/// Most threads that write pictures into a folder.
const MAX_WORKERS: usize = 4;
/// Most frames in flight: more only cost memory.
const MAX_FRAMES_IN_FLIGHT: u32 = 8;

fn main() -> ExitCode {
    terravision_common::bug::report_panics("");
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let result = match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["--run", run] => render(run),
        ["--doctor-json"] => doctor(),
        ["--floor-json", size, frames] => floors(size, frames),
        ["--help" | "-h"] => print(HELP),
        _ => {
            complain("terravision-renderer is started by terravision; see terravision-renderer --help");
            return ExitCode::from(BAD_USAGE);
        }
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            complain(&format!("{error:#}"));
            let of_usage = error.is::<UsageError>().then_some(BAD_USAGE);
            let of_run = error.downcast_ref::<RunError>().map(RunError::exit_code);
            ExitCode::from(of_usage.or(of_run).unwrap_or(1))
        }
    }
}

fn print(text: &str) -> anyhow::Result<()> {
    std::io::stdout().write_all(text.as_bytes()).context("standard output cannot be written")
}

fn doctor() -> anyhow::Result<()> {
    let choice = DeviceChoice::from_environment();
    let report = match describe_adapters(&choice, &Needs::LEAST) {
        Ok(devices) => serde_json::json!({ "devices": devices }),
        Err(error) => serde_json::json!({ "devices": [], "error": error.to_string() }),
    };
    print(&format!("{}\n", serde_json::to_string_pretty(&report)?))
}

/// Grids of the floor: columns and rows of a picture of 16:9. The last has cells of 7.5 pixels at 1280x720, so 33
/// thousand triangles: about what a frame of facets of 10 pixels has.
const GRIDS: [[u32; 2]; 3] = [[1, 1], [85, 48], [171, 96]];

fn floors(size: &str, frames: &str) -> anyhow::Result<()> {
    let size = size.split_once('x').and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]));
    let size = size.context("the size is not of the form 1280x720")?;
    let frames = frames.parse().context("the number of frames is none")?;
    let options = EngineOptions { size, ..EngineOptions::default() };
    let passes = GRIDS.map(|[columns, rows]| floor(&options, columns, rows, frames));
    let passes = passes.into_iter().collect::<Result<Vec<_>, _>>()?;
    print(&format!("{}\n", serde_json::to_string_pretty(&serde_json::json!({ "passes": passes }))?))
}

fn render(run_text: &str) -> anyhow::Result<()> {
    let stage_run = StageRun::parse(["--run".to_owned(), run_text.to_owned()])?;
    set_up_process().map_err(UsageError::from)?;
    let (config, run_id) = (stage_run.config(), *stage_run.id());
    let world = *Index::open(&config.world)?.world();
    let mut source =
        LiveSource::open(&run_id, world, config.texels, config.frames)?.with_gaps(config.realtime.is_some());
    if !matches!(config.render.samples, 1 | 4) {
        bail!("{} samples per pixel are not possible, 1 or 4 are", config.render.samples);
    }
    let render = &config.render;
    let is_depth_shared = render.share.as_ref().is_some_and(|share| share.has_depth || share.has_ground);
    let has_depth = !render.depth.is_empty() || !render.ground.is_empty() || is_depth_shared;
    let options = EngineOptions {
        technique: render.technique,
        // What exact frames look like must not depend on how fast the machine is.
        rays: if config.realtime.is_none() && render.rays == RaysChoice::Auto {
            RaysChoice::Mipmap
        } else {
            render.rays
        },
        workers: config.decoder_threads as usize,
        device: DeviceChoice::from_environment(),
        size: [config.width, config.height],
        views: config.rig.as_ref().map(|rig| ViewBounds { size: rig.view_size(), count: rig.views.len() }),
        samples: render.samples,
        sky_rgb: render.sky_rgb,
        skirt_low_m: render.skirt_low_m.filter(|low| low.is_finite()),
        has_tree_overlay: render.has_tree_overlay,
        has_validation: render.has_validation,
        has_depth,
        frames_in_flight: render.frames_in_flight.min(MAX_FRAMES_IN_FLIGHT) as usize,
        lose_device_at: std::env::var(LOSE_DEVICE_AT).ok().and_then(|at| at.parse().ok()),
        ..EngineOptions::default()
    };
    let written = source.control().written_frames();
    let workers = SinkWorkers::start(sinks(config, world.fields().origin, written).map_err(RunError::from)?)
        .map_err(RunError::from)?;
    run(
        options,
        &mut source,
        workers,
        &mut |engine, source| {
            let found = engine.describe();
            let texts = [
                (EventKind::DeviceName, found.device.as_str()),
                (EventKind::DriverName, &found.driver),
                (EventKind::TechniqueName, found.technique),
            ];
            for (kind, text) in texts {
                for event in Event::text(kind, text) {
                    source.event(&event);
                }
            }
        },
        &mut |_finished| {},
    )?;
    Ok(())
}

/// The sinks of a run, one for each worker. So many frames were written by renderers before this one.
fn sinks(config: &RunConfig, origin: [f64; 2], written: u64) -> Result<Vec<Box<dyn FrameSink>>, SinkError> {
    let render = &config.render;
    // Files may be written in any order. A stream and shared frames have one, and so have frames that stand in for those
    // before them.
    let is_in_any_order = render.share.is_none()
        && config.realtime.is_none()
        && match &render.sink {
            SinkConfig::PngFolder(_) | SinkConfig::EachView(_) => true,
            SinkConfig::Null => !render.depth.is_empty() || !render.ground.is_empty(),
            SinkConfig::PngFile(_) | SinkConfig::Stream(_) => false,
        };
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(MAX_WORKERS);
    (0..if is_in_any_order { threads } else { 1 }).map(|_lane| worker(config, origin, written)).collect()
}

/// The sinks of one worker.
fn worker(config: &RunConfig, origin: [f64; 2], written: u64) -> Result<Box<dyn FrameSink>, SinkError> {
    let render = &config.render;
    let picture = picture_sink(&render.sink, config, written)?;
    if render.depth.is_empty() && render.ground.is_empty() && render.share.is_none() {
        return Ok(picture);
    }
    let mut all = AllOf(Vec::new());
    if let Some(share) = &render.share {
        // First: who reads it waits for it, files can wait.
        let sink = SharedSink::open(share, [config.width, config.height], origin, config.exaggeration)?;
        all.0.push(Box::new(sink.with_made_up(render.made_up)));
    }
    let depth = |target: &PlaneTarget| -> Result<Box<dyn FrameSink>, SinkError> {
        Ok(Box::new(DepthSink::new(target)?.with_made_up(render.made_up)))
    };
    let ground = |target: &PlaneTarget| -> Result<Box<dyn FrameSink>, SinkError> {
        Ok(Box::new(GroundSink::new(target, origin, config.exaggeration)?.with_made_up(render.made_up)))
    };
    let depths = render.depth.iter().map(depth).collect::<Result<_, _>>()?;
    let grounds = render.ground.iter().map(ground).collect::<Result<_, _>>()?;
    all.0.extend([each_view(config, depths), each_view(config, grounds)].into_iter().flatten());
    // Last: where there is a picture of a frame, there is all of it.
    all.0.push(picture);
    Ok(Box::new(all))
}

/// The sink of pictures.
fn picture_sink(sink: &SinkConfig, config: &RunConfig, written: u64) -> Result<Box<dyn FrameSink>, SinkError> {
    let made: Box<dyn FrameSink> = match sink {
        SinkConfig::PngFolder(folder) => Box::new(PngFolderSink::new(folder)?),
        SinkConfig::PngFile(path) => Box::new(PngFileSink::new(path)),
        // What is left out of a stream the launcher makes up for.
        SinkConfig::Stream(encoding) => return Ok(Box::new(StreamSink::stdout(*encoding)?)),
        SinkConfig::Null => Box::new(NullSink),
        SinkConfig::EachView(sinks) => {
            let sinks = sinks.iter().map(|sink| picture_sink(sink, config, written)).collect::<Result<_, _>>()?;
            return Ok(each_view(config, sinks).unwrap_or_else(|| Box::new(NullSink)));
        }
    };
    // Files of frames that were left out show the frame before.
    Ok(if config.realtime.is_some() { Box::new(RepeatSink::new(made, config.frames, written)?) } else { made })
}

/// Sinks of all views, in the order of the rig, as one; `None` without any.
fn each_view(config: &RunConfig, mut sinks: Vec<Box<dyn FrameSink>>) -> Option<Box<dyn FrameSink>> {
    match &config.rig {
        None => sinks.pop(),
        Some(_) if sinks.is_empty() => None,
        Some(rig) => {
            let names = rig.views.iter().map(|view| view.name.clone());
            Some(Box::new(EachViewSink::new(names.zip(sinks).collect())))
        }
    }
}
