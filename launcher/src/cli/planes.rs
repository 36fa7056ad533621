//! Depth and ground of every frame of a flight.

use clap::Args;
use std::ffi::{OsStr, OsString};
use std::path::PathBuf;

/// Heading of the flags about depth and ground, of `fly` and `still`.
pub(super) const PLANES_HEADING: &str = "Depth and ground (docs/data-sets.md)";

/// Depth and ground; of `fly`.
#[derive(Debug, Default, Args)]
#[command(next_help_heading = PLANES_HEADING)]
pub struct PlaneArgs {
    /// Write the depth of every frame into this folder, as frame-000000.tif and so on: float32,
    /// metres along the view axis, NaN for sky. Without a folder: add the depth to shared frames
    ///
    /// frames.json beside them has poses and intrinsics of all frames; with pictures in a folder
    /// (-o DIR/) so has transforms.json, for nerfstudio. With a folder, shared frames have the
    /// depth too.
    #[arg(long, value_name = "DIR")]
    pub depth: Option<Option<PathBuf>>,
    /// Write the ground position that every pixel shows into this folder: float64 easting, northing
    /// and height, NaN for sky. Without a folder: add it to shared frames
    #[arg(long, value_name = "DIR")]
    pub ground: Option<Option<PathBuf>>,
}

/// The command line with `--depth` and `--ground` of `fly` at its end, where they take nothing for
/// their folder: in `fly --depth WORLD -o shared:NAME`, which was written before they had one,
/// WORLD is the world. `None` where that changes nothing.
#[must_use]
pub fn with_planes_last(arguments: &[OsString]) -> Option<Vec<OsString>> {
    if arguments.get(1).is_none_or(|verb| verb != "fly") {
        return None;
    }
    let is_plane =
        |argument: &OsString| [OsStr::new("--depth"), OsStr::new("--ground")].contains(&argument.as_os_str());
    let (planes, others): (Vec<_>, Vec<_>) = arguments.iter().cloned().partition(is_plane);
    (!planes.is_empty()).then(|| [others, planes].concat())
}
