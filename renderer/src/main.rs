//! `terravision-renderer --run JSON`: draws the frames of a run. `--doctor-json`: what Vulkan
//! devices there are. `--floor-json`: what the device can do at best.

use anyhow::Context;
use std::io::Write;
use std::process::ExitCode;
use terravision_common::stage::BAD_USAGE;
use terravision_common::terminal::complain;
use terravision_renderer::bench::floor;
use terravision_renderer::engine::EngineOptions;
use terravision_renderer::gpu::{DeviceChoice, Needs, describe_adapters};

const HELP: &str = "\
terravision-renderer: the stage of TerraVision that draws. The launcher (terravision) starts it.

  --run JSON             draw the frames of this run; --run - reads it from standard input
  --doctor-json          print the Vulkan devices, and what they lack, as JSON
  --window-check         say whether a window can be opened here
  --floor-json WxH N     draw N frames of full-screen grids of this size, textured and depth-tested, and print the
                         times as JSON: the floor that no renderer on this device gets below

The environment variable TERRAVISION_DEVICE chooses a device: its number, or a part of its name.
";

fn main() -> ExitCode {
    terravision_common::bug::report_panics("");
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let result = match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["--run", _] => return terravision_common::stage::main(terravision_renderer::stage::run),
        ["--doctor-json"] => doctor(),
        ["--window-check"] => check_window(),
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
            ExitCode::FAILURE
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

#[cfg(feature = "window")]
fn check_window() -> anyhow::Result<()> {
    terravision_window::desktop::check()?;
    Ok(terravision_renderer::gpu::check_showing()?)
}

#[cfg(not(feature = "window"))]
fn check_window() -> anyhow::Result<()> {
    anyhow::bail!(terravision_renderer::NO_WINDOW)
}

/// Grids of the floor: columns and rows of a picture of 16:9. The last has cells of 7.5 pixels at
/// 1280x720, so 33 thousand triangles: about what a frame of facets of 10 pixels has.
const GRIDS: [[u32; 2]; 3] = [[1, 1], [85, 48], [171, 96]];

fn floors(size: &str, frames: &str) -> anyhow::Result<()> {
    let size = size.split_once('x').and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]));
    let size = size.context("the size is not of the form 1280x720")?;
    let frames = frames.parse().context("the number of frames is not a whole number")?;
    let options = EngineOptions { size, ..EngineOptions::default() };
    let passes = GRIDS.map(|[columns, rows]| floor(&options, columns, rows, frames));
    let passes = passes.into_iter().collect::<Result<Vec<_>, _>>()?;
    print(&format!("{}\n", serde_json::to_string_pretty(&serde_json::json!({ "passes": passes }))?))
}
