//! `terravision fly`, as typed.

use super::course::CourseArgs;
use super::draw::DrawArgs;
use super::film::FilmArgs;
use super::labels::LabelArgs;
use super::live::LiveArgs;
use super::measurements::MeasurementArgs;
use super::planes::PlaneArgs;
use super::realtime::RealtimeArgs;
use super::supervision::SupervisionArgs;
use super::vehicles::VehicleArgs;
use clap::Args;
use std::path::PathBuf;

/// `terravision fly`.
#[derive(Debug, Args)]
#[command(after_long_help = "\
EXAMPLES
  terravision fly w.tv -o film.mp4
  terravision fly w.tv --path tour.kml --quality best -o frames/ --report report.json
  terravision fly w.tv --around 560000,4980000 --radius 4000 --height 1500 --turns 2 -o round.mp4
  terravision fly w.tv --path track.gpx --agl 80 --speed 20 -o ride.mp4
  terravision fly w.tv --path path.json --frames 100..200 -o part2/
  terravision fly w.tv -o film.webm --crf 30
  terravision fly w.tv --path tour.json -o frames/ --depth frames/depth --ground frames/ground
  terravision fly w.tv -o - | ffplay -
  terravision fly w.tv --camera shm:uav -o shared:uav --depth --size 640x480

The camera stays at least 2 m above the ground: lower poses are lifted, and a warning says how
many frames that were.")]
pub struct FlyArgs {
    /// Where the frames go: a film (.mp4, .mov, .mkv, .webm, .gif), a folder DIR/ for
    /// frame-000000.png and so on, - for Y4M on standard output, or shared:NAME for other programs;
    /// /dev/null draws and discards them
    ///
    /// A folder is created if it does not exist. Frames in it are replaced one by one, and other
    /// files stay. A film replaces an older one of its name only when it is complete. shared:NAME
    /// is --share NAME without any files.
    #[arg(short, long, value_name = "FILM|DIR/|-|shared:NAME")]
    pub output: PathBuf,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub course: CourseArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub draw: DrawArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub labels: LabelArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub vehicles: VehicleArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub film: FilmArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub planes: PlaneArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub live: LiveArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub realtime: RealtimeArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub supervision: SupervisionArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub measurements: MeasurementArgs,
}
