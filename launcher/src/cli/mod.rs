//! The command line, as typed. Nothing here is interpreted beyond single values ([`values`]); [`crate::plan`] turns it
//! into a validated plan.

pub mod database;
pub mod film;
pub mod planes;
pub mod pose;
pub mod supervision;
pub mod technique;
pub mod values;

use crate::input::CameraSource;
use crate::measure::metrics::MetricsAddress;
use clap::{Args, Parser, Subcommand, ValueEnum};
use database::DatabaseArgs;
use film::FilmArgs;
use planes::PlaneArgs;
use pose::{AglArgs, OrbitArgs, PoseArgs};
use std::ffi::OsString;
use std::path::PathBuf;
use supervision::SupervisionArgs;
use technique::{CompressionArg, MadeUpArg, MeasureChoice, RaysArg, TechniqueArg};
use terravision_common::run::Prediction;
use values::{FrameRange, MemorySize, PictureSize, Rgb};

const AFTER_HELP: &str = "\
A world from nothing, flown:
  terravision synth -o w
  terravision ingest --elevation w/dem.tif --color w/ortho.tif -o w.tv
  terravision fly w.tv -o film.mp4

EXIT STATUS
  0    done
  1    the run failed (a stage died, no space left, no Vulkan device for --technique mesh)
  2    bad usage or bad input: something that the command names cannot be used
       (wrong, not there, damaged, out of reach); nothing was made
  3    the flight finished, but some tiles were missing or damaged and were drawn
       from coarser ones; the report lists them
  101  an internal error: a fault of TerraVision itself, please report it
  130  interrupted by Ctrl-C or TERM

ENVIRONMENT
  TERRAVISION_LOG     'stages' passes on what the stages say while they run
  RAYON_NUM_THREADS   default of --threads
  AWS_…, HTTPS_PROXY… for databases on servers: docs/databases.md
  VK_ICD_FILENAMES    which Vulkan drivers the loader sees

Messages go to standard error, results to standard output.";

/// Flies over terrain that is far larger than memory: turns a DEM and an orthophoto into films, stills, depth and
/// ground positions, on a GPU or on none.
///
/// Four processes work hand in hand through shared memory: the generator searches the quad tree for what the camera
/// sees, the prefetcher brings tiles into memory, the preparer makes elevation without cracks, the renderer draws it
/// with Vulkan, or on the processor alone. This program starts them, flies the camera, watches over them and cleans up after them.
#[derive(Debug, Parser)]
#[command(name = "terravision", version, after_long_help = AFTER_HELP, max_term_width = 100)]
#[command(propagate_version = true, subcommand_required = true, arg_required_else_help = true)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Make a believable mountain world: dem.tif and ortho.tif
    #[command(disable_help_flag = true)]
    Synth(ExecArgs),
    /// Turn rasters into a terrain database
    #[command(disable_help_flag = true)]
    Ingest(ExecArgs),
    /// Say what a terrain database holds
    Info(InfoArgs),
    /// Say whether this machine has what a flight needs, and what to install if not
    Doctor(DoctorArgs),
    /// Fly a camera path over a terrain database, into a film, a folder of pictures or a pipe
    Fly(Box<FlyArgs>),
    /// Draw one picture from one pose; on request also depth and ground position of every pixel
    Still(Box<StillArgs>),
    /// Write the poses of a camera path, one per frame, as a JSON path that can be edited and flown
    Path(Box<PathArgs>),
    /// Measure the stages, the queues between them, rays against the mesh, and ingest
    #[command(disable_help_flag = true)]
    Bench(ExecArgs),
}

/// Arguments that go to another program as they are.
#[derive(Debug, Args)]
pub struct ExecArgs {
    /// Passed on as typed; `--help` explains them.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
    pub arguments: Vec<OsString>,
}

/// `terravision info`.
#[derive(Debug, Args)]
pub struct InfoArgs {
    /// The terrain database: a folder that `terravision ingest` made, a .tar of it, or where a copy is: http://, https:// or
    /// s3://bucket/prefix (docs/databases.md)
    #[arg(value_name = "WORLD")]
    pub world: PathBuf,
    /// Print one JSON object in place of text
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub database: DatabaseArgs,
}

/// `terravision doctor`.
#[derive(Debug, Args)]
pub struct DoctorArgs {
    /// The `--memory` of the flight to check for
    #[arg(long, value_name = "SIZE", default_value = "512MiB")]
    pub memory: MemorySize,
    /// Print one JSON object in place of text
    #[arg(long)]
    pub json: bool,
}

/// How the picture is made; shared by `fly` and `still`.
#[derive(Debug, Args)]
#[command(next_help_heading = "Picture")]
pub struct PictureArgs {
    /// How the ground is drawn [default: mesh, or rays where there is no Vulkan device]
    ///
    /// 'mesh' draws triangles with a Vulkan device. 'rays' casts one ray per pixel on the processor's cores and needs no
    /// device, or with '--rays compute' on one. All draw the same surface (docs/techniques.md).
    #[arg(long, value_enum, value_name = "WHICH")]
    pub technique: Option<TechniqueArg>,
    /// How rays are cast [default: mipmap; in real time: auto]
    ///
    /// Without --technique it means '--technique rays'. 'auto' takes 'compute' where there is a GPU; else 'mipmap', until both it and 'coherent' have been tried on one of the first frames, unseen, and
    /// from then on the faster one, which is told. In exact mode, whose pictures must not depend on a machine's speed, it is
    /// always 'mipmap'.
    #[arg(long, value_enum, value_name = "HOW")]
    pub rays: Option<RaysArg>,
    /// Width and height of the picture, pixels [default: the path's own, else 1280x720]
    #[arg(long, value_name = "WxH")]
    pub size: Option<PictureSize>,
    /// Vertical field of view, degrees [default: the path's own, else 60, which is 91.5 across at 16:9]
    #[arg(long, value_name = "DEGREES", conflicts_with = "hfov")]
    pub vfov: Option<f64>,
    /// Horizontal field of view, degrees, in place of --vfov
    #[arg(long, value_name = "DEGREES")]
    pub hfov: Option<f64>,
    /// Colour of the sky, three numbers from 0 to 255 or #RRGGBB [default: the path's own, else the body's: 150,190,235 on Earth,
    /// butterscotch on Mars, black on the Moon]
    #[arg(long, value_name = "R,G,B")]
    pub sky: Option<Rgb>,
    /// Factor on all heights of the terrain
    ///
    /// 2 makes mountains twice as high. The camera's height is not changed.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, allow_negative_numbers = true)]
    pub exaggeration: f64,
    /// A preset of --facet-px and --samples [default: default; still: finest]
    ///
    /// 'default' draws facets of 10 pixels (7 for voxels, '--technique rays --rays coherent'), one sample a pixel. 'best' draws facets of 3 pixels with four samples a
    /// pixel: nearer to the true picture at several times the cost. 'finest' draws facets of 1 pixel (more above 1920x1080, where there
    /// would be too many), four samples: what a pixel shows is right to the pixel. Rays have one sample. A flag given as well wins over the preset.
    #[arg(long, value_enum, overrides_with = "quality")]
    pub quality: Option<Quality>,
    /// Wanted size of the terrain's facets on screen, pixels [default: 10, with --rays coherent 7; best: 3; finest, which still has: 1]
    ///
    /// The side of a square with a facet's area, where the ground is seen in full. Smaller shows finer relief and costs more: time grows with the square of its inverse.
    #[arg(long, value_name = "PIXELS")]
    pub facet_px: Option<f64>,
    /// Wanted size of the colour texels on screen, pixels [default: 1]
    ///
    /// Smaller sharpens until the source has no more to give, and needs more tiles; larger blurs and loads less.
    #[arg(long, value_name = "PIXELS")]
    pub texel_px: Option<f64>,
    /// Whether colour tiles are compressed in memory
    ///
    /// Compressed (BC1) a tile takes an eighth of its memory, here and on the device, so that --memory holds more of them;
    /// the picture loses a little (docs/quality.md), and loading a tile takes longer. The database is not touched. A device
    /// that is the processor itself (lavapipe) is slower at such tiles: there, 'auto' leaves them as they are. 'on' where no
    /// device can do it is an error. The same frames come out on every run either way.
    #[arg(long, value_enum, value_name = "WHEN", default_value_t = CompressionArg::Auto)]
    pub texture_compression: CompressionArg,
    /// Samples per pixel: 1, or 4 for smooth edges [default: 1; best, finest: 4]
    #[arg(long, value_name = "1|4", value_parser = values::parse_samples)]
    pub samples: Option<u32>,
    /// How the size of a facet or texel on screen is measured where the ground is seen at a glancing angle
    #[arg(long, value_enum, default_value_t = MeasureChoice::Max)]
    pub measure: MeasureChoice,
    /// What is drawn where the world ends, for an eye beside it
    #[arg(long, value_enum, value_name = "HOW", default_value_t = Edge::Skirt)]
    pub edge: Edge,
    /// Draw the leaves of the quad tree over the picture
    #[arg(long, value_enum, value_name = "WHAT")]
    pub overlay: Option<Overlay>,
    /// What depth and ground say where the world's sources had no data and the ground was made up from around it
    ///
    /// 'nan': not a number, as for sky. 'mark': the values that are drawn, and a band more in files: 1 where the ground was measured,
    /// 0 where it was made up. Shared frames tell it in any case (docs/frame-ring.md).
    #[arg(long, value_enum, value_name = "HOW", default_value_t = MadeUpArg::Nan)]
    pub made_up: MadeUpArg,
}

/// What a run may use; shared by `fly` and `still`.
#[derive(Debug, Args)]
#[command(next_help_heading = "Resources")]
pub struct ResourceArgs {
    /// Memory for the pools of tiles, e.g. 256MiB or 2GiB
    ///
    /// The picture does not depend on it, as long as it suffices. More saves loading when a flight comes back to where
    /// it has been. All processes together use about 300 MB more than this. Half of it is shared memory: see
    /// 'terravision doctor'.
    #[arg(long, value_name = "SIZE", default_value = "512MiB")]
    pub memory: MemorySize,
    /// Threads that load and decode tiles, and that cast rays [default: RAYON_NUM_THREADS, else one per core]
    ///
    /// The picture does not depend on it.
    #[arg(long, value_name = "N")]
    pub threads: Option<u32>,
    /// Ask for the Vulkan validation layer; its first complaint ends the run (for developers)
    #[arg(long)]
    pub validation: bool,
    /// Say nothing but warnings and errors
    #[arg(short, long)]
    pub quiet: bool,
}

/// Where the camera goes; shared by `fly` and `path`.
#[derive(Debug, Args)]
#[command(next_help_heading = "Flight")]
pub struct CourseArgs {
    /// The camera path: a file (JSON, KML or KMZ, GPX), or 'orbit'
    ///
    /// 'orbit' circles the point of the world with the strongest relief, or --around, once in 240 frames. The formats of files
    /// are in docs/camera-paths.md. With --eye or --look-at there is no path: the camera stands there (one frame, or --frames).
    #[arg(long, value_name = "FILE|orbit", default_value = "orbit")]
    pub path: PathBuf,
    /// Only frames A up to, not including, B
    ///
    /// They are the same bytes that these frames have in the whole flight, so that a film can be made in pieces.
    #[arg(long, value_name = "A..B")]
    pub frames: Option<FrameRange>,
    /// Frames per second of the film; of a path that is given in time also how many are made [default: the path's own,
    /// else 30]
    #[arg(long, value_name = "N")]
    pub fps: Option<f64>,
    /// Fly a path that is given in time N times as fast
    #[arg(long, value_name = "N")]
    pub speed: Option<f64>,
    /// Whether rests and silence within a segment of a recorded track are flown in full
    ///
    /// 'shorten' makes seconds of two minutes and more within 30 m, and leaves out silence of more than ten minutes. Gaps between
    /// segments and tracks are left out either way.
    #[arg(long, value_enum, default_value_t = Rests::Shorten)]
    pub rests: Rests,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub agl: AglArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub orbit: OrbitArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub pose: PoseArgs,
}

/// What becomes of the rests of a recorded track.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Rests {
    /// They become seconds
    Shorten,
    /// They are flown as they were
    Keep,
}

/// How other programs take part in a flight.
#[derive(Debug, Default, Args)]
#[command(next_help_heading = "Other programs (docs/frame-ring.md)")]
pub struct LiveArgs {
    /// Also put every frame into shared memory, /dev/shm/terravision-NAME, where any number of programs read it
    #[arg(long, value_name = "NAME")]
    pub share: Option<String>,
    /// Fly the poses that another program sends, one frame for each, in place of a path
    ///
    /// shm:NAME is a record in shared memory, /dev/shm/terravision-NAME-camera; udp:127.0.0.1:PORT takes JSON lines.
    /// The flight ends when the sender says so, at Ctrl-C, or after --idle-timeout.
    #[arg(long, value_name = "shm:NAME|udp:ADDRESS", conflicts_with_all = ["path", "frames", "agl", "speed", "rests", "eye", "look_at", "from", "heading", "pitch", "roll", "lonlat", "around", "radius", "height", "turns"])]
    pub camera: Option<CameraSource>,
    /// End the flight when no pose has come for so many seconds [default: wait for ever]
    #[arg(long, value_name = "SECONDS", requires = "camera")]
    pub idle_timeout: Option<f64>,
}

/// A flight against the clock; of `fly`.
#[derive(Debug, Args)]
#[command(next_help_heading = "Real time")]
pub struct RealtimeArgs {
    /// Whether frames wait for their tiles, or for nothing
    ///
    /// 'exact' draws every frame with all that it wants, however long it takes. 'realtime' plays the path against the
    /// clock: frames show what is there, and those that come too late are left out (docs/realtime.md).
    #[arg(long, value_enum, default_value_t = Mode::Exact)]
    pub mode: Mode,
    /// Whether facets and texels grow when frames take too long [default: on]
    #[arg(long, value_enum, value_name = "on|off")]
    pub feedback: Option<Switch>,
    /// Largest size that facets may grow to, pixels [default: four times --facet-px]
    #[arg(long, value_name = "PIXELS")]
    pub coarsest_facet_px: Option<f64>,
    /// Largest size that texels may grow to, pixels [default: four times --texel-px]
    #[arg(long, value_name = "PIXELS")]
    pub coarsest_texel_px: Option<f64>,
    /// Size that facets may shrink to while the camera rests and there is time, pixels [default: 3, at most --facet-px]
    #[arg(long, value_name = "PIXELS")]
    pub rest_facet_px: Option<f64>,
    /// Size that texels may shrink to while the camera rests and there is time, pixels [default: --texel-px]
    #[arg(long, value_name = "PIXELS")]
    pub rest_texel_px: Option<f64>,
    /// How the camera is predicted, to have its tiles before it comes (docs/prefetch.md) [default: linear]
    #[arg(long, value_enum, value_name = "HOW")]
    pub prediction: Option<PredictionChoice>,
}

/// [`Prediction`] as typed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PredictionChoice {
    /// Not at all: tiles are asked for when a frame lacks them
    Off,
    /// It goes on and turns as it does
    Linear,
    /// It also goes on to gain or lose speed as it does: better in long bends, worse on jerky paths
    Quadratic,
    /// The path is known: what the others are measured against
    Oracle,
}

impl From<PredictionChoice> for Prediction {
    fn from(choice: PredictionChoice) -> Self {
        match choice {
            PredictionChoice::Off => Self::Off,
            PredictionChoice::Linear => Self::Linear,
            PredictionChoice::Quadratic => Self::Quadratic,
            PredictionChoice::Oracle => Self::Oracle,
        }
    }
}

/// What a run says about itself; shared by `fly` and `still`.
#[derive(Debug, Args)]
#[command(next_help_heading = "Measurements")]
pub struct MeasurementArgs {
    /// Write a report of the run, JSON (docs/report.md)
    #[arg(long, value_name = "FILE.json")]
    pub report: Option<PathBuf>,
    /// Write what every process did when, as a trace that Perfetto (ui.perfetto.dev) opens
    #[arg(long, value_name = "FILE.json")]
    pub trace: Option<PathBuf>,
    /// Serve figures of the run while it goes on, for Prometheus: http://ADDRESS/metrics
    ///
    /// A port alone is one of loopback, 127.0.0.1, where only this machine can read it; 0 is any free port, and the run says
    /// which. docs/report.md lists the figures.
    #[arg(long, value_name = "ADDRESS")]
    pub metrics: Option<MetricsAddress>,
}

/// Whether frames wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Mode {
    /// Every frame waits for its tiles: the same input gives the same bytes
    Exact,
    /// Frames follow the clock and wait for nothing
    Realtime,
}

/// On or off.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Switch {
    /// On
    On,
    /// Off
    Off,
}

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

The ground under the camera is never entered: a pose below ground + 2 m is lifted, and the
number of lifted frames is told.")]
pub struct FlyArgs {
    /// The terrain database: a folder that `terravision ingest` made, a .tar of it, or where a copy is: http://, https:// or
    /// s3://bucket/prefix (docs/databases.md)
    #[arg(value_name = "WORLD")]
    pub world: PathBuf,
    /// Where the frames go: a film (.mp4, .mov, .mkv, .webm, .gif), a folder DIR/ for frame-000000.png and so on, - for Y4M on standard output, or
    /// shared:NAME for other programs; /dev/null to measure only
    ///
    /// A folder is made if need be; frames in it are replaced one by one, other files stay. A film replaces the file of
    /// that name when it is complete, never before. shared:NAME is --share NAME and nothing else.
    #[arg(short, long, value_name = "FILM|DIR/|-|shared:NAME")]
    pub output: PathBuf,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub live: LiveArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub planes: PlaneArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub film: FilmArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub course: CourseArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub picture: PictureArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub resources: ResourceArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub realtime: RealtimeArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub supervision: SupervisionArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub database: DatabaseArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub measurements: MeasurementArgs,
}

/// `terravision still`.
#[derive(Debug, Args)]
#[command(after_long_help = "\
EXAMPLES
  terravision still w.tv --look-at 560000,4980000 --from 180,30,5000 -o a.png
  terravision still w.tv --lonlat --eye -121.5,44.9,1500 --agl --look-at -121.7,45.37 -o b.png
  terravision still w.tv --eye 560000,4980000,3500 --heading 90 --pitch -20 --size 640x480 \\
      --quality best -o a.png --depth depth.tif --ground ground.tif")]
pub struct StillArgs {
    /// The terrain database: a folder that `terravision ingest` made, a .tar of it, or where a copy is: http://, https:// or
    /// s3://bucket/prefix (docs/databases.md)
    #[arg(value_name = "WORLD")]
    pub world: PathBuf,
    /// The picture, a PNG file
    #[arg(short, long, value_name = "FILE.png")]
    pub output: PathBuf,
    /// Also write the depth of every pixel: float32 TIFF, metres along the view axis, NaN for sky
    #[arg(long, value_name = "FILE.tif")]
    pub depth: Option<PathBuf>,
    /// Also write what every pixel sees: float64 TIFF of easting, northing and height, NaN for sky
    #[arg(long, value_name = "FILE.tif")]
    pub ground: Option<PathBuf>,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub pose: PoseArgs,
    /// The Z of --eye and --look-at are heights above the ground
    #[arg(long, help_heading = "Pose")]
    pub agl: bool,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub picture: PictureArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub resources: ResourceArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub database: DatabaseArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub measurements: MeasurementArgs,
}

/// `terravision path`.
#[derive(Debug, Args)]
pub struct PathArgs {
    /// The terrain database: a folder that `terravision ingest` made, a .tar of it, or where a copy is: http://, https:// or
    /// s3://bucket/prefix (docs/databases.md)
    #[arg(value_name = "WORLD")]
    pub world: PathBuf,
    /// Where the poses go: a JSON file, or - for standard output
    #[arg(short, long, value_name = "FILE.json|-", default_value = "-")]
    pub output: PathBuf,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub course: CourseArgs,
    /// Vertical field of view, degrees, written into the path [default: the path's own, else none: it is then flown with 60]
    #[arg(long, value_name = "DEGREES")]
    pub vfov: Option<f64>,
    /// Factor on all heights of the terrain, for heights above ground
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, allow_negative_numbers = true)]
    pub exaggeration: f64,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub database: DatabaseArgs,
}

/// A preset of how fine the picture is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Quality {
    /// Facets of 10 pixels, one sample a pixel
    Default,
    /// Facets of 3 pixels, four samples a pixel
    Best,
    /// Facets of 1 pixel, four samples a pixel
    Finest,
}

/// What is drawn where the world ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Edge {
    /// Plain walls down to the world's lowest height, and a floor there
    Skirt,
    /// Nothing: the ground is a sheet
    None,
}

/// What is drawn over the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Overlay {
    /// The leaves of the quad tree
    Tree,
}

#[cfg(test)]
mod tests;
