//! The flight that is shown: `terravision fly` in real time, steered by the viewer.

use super::Event;
use super::child::Watched;
use crate::cli::light::Visibility;
use crate::cli::serve::ServeArgs;
use std::ffi::OsString;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::mpsc::SyncSender;
use terravision_common::log;
use terravision_common::viewer::StreamSettings;

/// What the viewer decides, and where the flight says what it has to say.
const DECIDED: [&str; 15] = [
    "--size",
    "--vfov",
    "--hfov",
    "--facet-px",
    "--texel-px",
    "--technique",
    "--exaggeration",
    "--overlay",
    "--sun",
    "--shadows",
    "--haze",
    "--stereo",
    "--eye-separation",
    "--convergence",
    "--quiet",
];

/// The settings that the command line asks for. `convergence_m`: how far away the pictures of two
/// eyes meet, unless it says so.
pub(super) fn settings(args: &ServeArgs, convergence_m: f64) -> StreamSettings {
    let picture = &args.shared.draw.picture;
    StreamSettings {
        facet_px: picture.facet_px,
        texel_px: picture.texel_px,
        fps: args.fps,
        technique: args.shared.value("--technique"),
        exaggeration: args.shared.value("--exaggeration").map(|_| picture.exaggeration),
        overlay: args.shared.value("--overlay"),
        sun: args.shared.value("--sun").map(|sun| sun.trim().to_owned()),
        shadows: picture.light.shadows.then_some(true),
        haze: picture.light.haze.map(|Visibility(metres)| metres),
        stereo: args.shared.value("--stereo"),
        eye_separation: picture.stereo.eye_separation,
        convergence: picture.stereo.convergence.or(Some(convergence_m)),
    }
}

/// Flags that a still has in common with the flight.
pub(super) fn still_flags(args: &ServeArgs) -> Vec<String> {
    texts(&args.shared.without(&DECIDED))
}

/// Flags as the viewer is told them.
pub(super) fn texts(flags: &[OsString]) -> Vec<String> {
    flags.iter().map(|flag| flag.to_string_lossy().into_owned()).collect()
}

/// Starts the flight of this number.
pub(super) fn start(
    args: &ServeArgs,
    programs: &Path,
    share: &str,
    number: u32,
    size: [u32; 2],
    settings: &StreamSettings,
    events: SyncSender<Event>,
) -> anyhow::Result<Watched> {
    let [width, height] = settings.eye_size(size);
    let mut command = Command::new(programs.join("terravision"));
    command.arg("fly").arg(&args.shared.draw.world).args(args.shared.without(&DECIDED)).args(settings.flags());
    command.args(["--mode", "realtime", "--depth", "--metrics", "0"]);
    command.args([OsString::from("-o"), format!("shared:{share}").into()]);
    command
        .args(["--camera".to_owned(), format!("shm:{share}")])
        .args(["--size".to_owned(), format!("{width}x{height}")]);
    command.args(["--child-of".to_owned(), std::process::id().to_string()]);
    command.stdin(Stdio::null()).stdout(Stdio::null()).envs(log::environment());
    // Ctrl-C of a terminal ends this program, which ends the flight.
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    Watched::start(&mut command, move |line| Event::FlightSaid { number, line }, events)
}
