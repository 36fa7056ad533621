//! `terravision still`, as typed.

use super::draw::DrawArgs;
use super::labels::LabelArgs;
use super::measurements::MeasurementArgs;
use super::planes::PLANES_HEADING;
use super::pose::PoseArgs;
use super::vehicles::VehicleArgs;
use clap::Args;
use std::path::PathBuf;

/// `terravision still`.
#[derive(Debug, Args)]
#[command(after_long_help = "\
EXAMPLES
  terravision still w.tv --look-at 560000,4980000 --from 180,30,5000 -o a.png
  terravision still w.tv --lonlat --eye -121.5,44.9,1500 --agl --look-at -121.7,45.37 -o b.png
  terravision still w.tv --eye 560000,4980000,3500 --heading 90 --pitch -20 --size 640x480 \\
      --quality best -o a.png --depth depth.tif --ground ground.tif")]
pub struct StillArgs {
    /// The picture, a PNG file
    #[arg(short, long, value_name = "FILE.png")]
    pub output: PathBuf,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub pose: PoseArgs,
    /// The Z of --eye and --look-at are heights above the ground
    #[arg(long, help_heading = "Pose")]
    pub agl: bool,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub draw: DrawArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub labels: LabelArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub vehicles: VehicleArgs,
    /// Also write the depth of every pixel: float32 TIFF, metres along the view axis, NaN for sky
    #[arg(long, value_name = "FILE.tif", help_heading = PLANES_HEADING)]
    pub depth: Option<PathBuf>,
    /// Also write the ground position that every pixel shows: float64 TIFF of easting, northing and
    /// height, NaN for sky
    #[arg(long, value_name = "FILE.tif", help_heading = PLANES_HEADING)]
    pub ground: Option<PathBuf>,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub measurements: MeasurementArgs,
}
