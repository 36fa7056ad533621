//! The command line of `terravision bench`.

use clap::{Args, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;
use terravision_common::level::Measure;
use terravision_common::run::Prediction;

/// Pictures of each kind that `rays` draws when nothing is said.
pub const RAYS_ROUNDS: u32 = 15;

/// Measures the stages, the queues between them, the whole pipeline, and ingest.
///
/// The results that count are ratios of two measurements of the same run, because times on a shared
/// machine say little by themselves. Results with a target get a verdict; a missed target is an
/// error only with --strict.
#[derive(Debug, Parser)]
#[command(name = "terravision bench", bin_name = "terravision bench", version, max_term_width = 100)]
pub struct Cli {
    /// What to measure [default: everything that takes no minutes]
    #[command(subcommand)]
    pub verb: Option<Verb>,
    /// Log what the bench does to standard error: error, warn, info, debug, trace, or a filter
    /// [default: TERRAVISION_LOG]
    #[arg(long, global = true, value_name = "LEVEL|FILTER")]
    pub log: Option<String>,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub options: Options,
}

/// What to measure.
#[derive(Debug, Clone, Subcommand)]
pub enum Verb {
    /// Each stage alone: trees, elevation samples, slots, frames, pixels, triangles per second
    Stages,
    /// The whole pipeline against the renderer alone, fed with the frames that the pipeline had
    /// recorded
    Replay,
    /// The queues between the processes: time of a hand-over, things per second
    Queues,
    /// Questions to the ground: heights, lines of sight and spheres per second on one core
    Query,
    /// Vehicles: what one of 400 costs, and a flight with them against the same without
    Vehicles,
    /// Ingest: megabytes of source pixels per second
    Ingest,
    /// The same views over databases of 1, 16 and 256 times the area: whether a frame costs more
    Flat,
    /// A real-time flight, with and without feedback, while another process occupies a core for a
    /// while
    Realtime(RealtimeArgs),
    /// A fast flight over a database behind a slow link: what prediction gains
    Link(LinkArgs),
    /// A long random flight: whether memory and open files grow
    LongRun(LongRunArgs),
    /// Voxel ray casting in the set-up of its paper (coherence, roll, workers), and rays against
    /// the mesh over the same frames
    Rays(RaysArgs),
    /// How true pictures are, by default and with --quality best: how far ground is drawn from where
    /// it should be, holes, PSNR and SSIM, against plain rays on the finest heights. With --output
    /// also the pictures and maps of their displacement
    Quality(QualityArgs),
    /// Keeps one core busy, a process of its own
    #[command(hide = true)]
    Load(LoadArgs),
    /// The other end of the queues, a process of its own
    #[command(hide = true)]
    Reader(ReaderArgs),
}

/// Arguments of `realtime`.
#[derive(Debug, Clone, Args)]
pub struct RealtimeArgs {
    /// Length of the flight, seconds
    #[arg(long, value_name = "S", default_value_t = 120.0)]
    pub seconds: f64,
    /// How long a core is occupied in the middle of it, seconds
    #[arg(long, value_name = "S", default_value_t = 20.0)]
    pub load_seconds: f64,
    /// Frame rate of the flight, as a share of the rate that is reached without a clock
    #[arg(long, value_name = "SHARE", default_value_t = 0.6)]
    pub share: f64,
}

/// Arguments of `link`.
#[derive(Debug, Clone, Args)]
pub struct LinkArgs {
    /// Length of each flight, seconds
    #[arg(long, value_name = "S", default_value_t = 60.0)]
    pub seconds: f64,
    /// Frames per second
    #[arg(long, value_name = "N", default_value_t = 10.0)]
    pub fps: f64,
    /// Bandwidth of the link, Mbit/s
    #[arg(long, value_name = "N", default_value_t = 20.0)]
    pub mbit_per_s: f64,
    /// Delay before each answer of the server, milliseconds
    #[arg(long, value_name = "MS", default_value_t = 80)]
    pub latency_ms: u64,
    /// Predictions to fly with
    #[arg(long, value_name = "HOW", value_delimiter = ',', value_parser = parse_prediction,
        default_values = ["off", "linear", "quadratic", "oracle"])]
    pub predictions: Vec<Prediction>,
}

/// Arguments of `long-run`.
#[derive(Debug, Clone, Args)]
pub struct LongRunArgs {
    /// Length of the flight, seconds
    #[arg(long, value_name = "S", default_value_t = 1800.0)]
    pub seconds: f64,
    /// Frames per second
    #[arg(long, value_name = "N", default_value_t = 10.0)]
    pub fps: f64,
    /// Seed of the random flight
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
}

/// Arguments of `rays`.
#[derive(Debug, Clone, Args)]
pub struct RaysArgs {
    /// Pictures of each kind
    #[arg(long, value_name = "N", default_value_t = RAYS_ROUNDS)]
    pub rounds: u32,
}

/// Arguments of `quality`.
#[derive(Debug, Clone, Args)]
pub struct QualityArgs {
    /// The terrain database [default: that of --world]
    #[arg(value_name = "WORLD")]
    pub database: Option<PathBuf>,
    /// Views, evenly of a round over the world
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=240))]
    pub views: u32,
    /// Draw by every technique that needs no GPU, and print a table of how true each is and what a
    /// frame of it costs
    ///
    /// The cost is processor time of all processes, of a flight around the strongest relief whose
    /// pictures go to a pipe: measure it on a machine that does nothing else.
    #[arg(long)]
    pub techniques: bool,
    /// More arguments for 'terravision still' (and 'fly'), e.g. -- --technique rays
    #[arg(last = true, value_name = "ARGUMENTS")]
    pub still: Vec<String>,
}

/// Arguments of the hidden load.
#[derive(Debug, Clone, Args)]
pub struct LoadArgs {
    /// How long.
    #[arg(long)]
    pub seconds: f64,
}

/// Arguments of the hidden reader.
#[derive(Debug, Clone, Args)]
pub struct ReaderArgs {
    /// The run.
    #[arg(long)]
    pub run: String,
    /// What to read.
    #[arg(long, value_enum)]
    pub queue: Queue,
    /// How much.
    #[arg(long)]
    pub count: u64,
    /// Say by an event that a thing was read.
    #[arg(long)]
    pub acknowledge: bool,
}

/// The two queues that are measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Queue {
    /// The ring of slots.
    Ring,
    /// The ping-pong buffer.
    PingPong,
}

impl Queue {
    /// As `--queue` and measurements name it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Ring => "ring",
            Self::PingPong => "ping-pong",
        }
    }
}

/// Options of all verbs.
#[derive(Debug, Clone, Args)]
pub struct Options {
    /// Print one JSON object in place of a table
    #[arg(long, global = true)]
    pub json: bool,
    /// End with exit code 1 when a target is missed
    #[arg(long, global = true)]
    pub strict: bool,
    /// Also draw plots (SVG) into this folder
    #[arg(short, long, global = true, value_name = "DIR")]
    pub output: Option<PathBuf>,
    /// Fly over this terrain database [default: a synthetic world, made once and kept under the
    /// cache folder]
    #[arg(long, global = true, value_name = "WORLD")]
    pub world: Option<PathBuf>,
    /// Posts along a side of the synthetic world
    #[arg(long, global = true, value_name = "N", default_value_t = 2048)]
    pub world_size: u32,
    /// Frames of the flight
    #[arg(long, global = true, value_name = "N", default_value_t = 240)]
    pub frames: u64,
    /// Size of the picture
    #[arg(long, global = true, value_name = "WxH", default_value = "1280x720", value_parser = parse_size)]
    pub size: [u32; 2],
    /// Wanted size of facets on screen, pixels
    #[arg(long, global = true, value_name = "PIXELS", default_value_t = 10.0)]
    pub facet_px: f64,
    /// Wanted size of texels on screen, pixels
    #[arg(long, global = true, value_name = "PIXELS", default_value_t = 1.0)]
    pub texel_px: f64,
    /// How screen resolution is measured: min, area or max [default: that of 'fly']
    #[arg(long, global = true, value_parser = parse_measure, default_value = "default", hide_default_value = true)]
    pub measure: Measure,
    /// Samples per pixel, 1 or 4
    #[arg(long, global = true, value_name = "N", default_value_t = 1)]
    pub samples: u32,
    /// Memory for the pools of tiles, MiB
    #[arg(long, global = true, value_name = "MIB", default_value_t = 1024)]
    pub memory_mib: u64,
}

fn parse_measure(text: &str) -> Result<Measure, String> {
    match text {
        "default" => Ok(Measure::default()),
        "min" => Ok(Measure::Min),
        "area" => Ok(Measure::Area),
        "max" => Ok(Measure::Max),
        _ => Err("expected min, area or max".to_owned()),
    }
}

fn parse_prediction(text: &str) -> Result<Prediction, String> {
    let all = [Prediction::Off, Prediction::Linear, Prediction::Quadratic, Prediction::Oracle];
    let found = all.into_iter().find(|prediction| prediction.name() == text);
    found.ok_or_else(|| "expected off, linear, quadratic or oracle".to_owned())
}

fn parse_size(text: &str) -> Result<[u32; 2], String> {
    let side = |text: &str| text.parse::<u32>().ok().filter(|side| (16..=16_384).contains(side));
    text.split_once('x')
        .and_then(|(width, height)| Some([side(width)?, side(height)?]))
        .ok_or_else(|| "expected two numbers of pixels like 1280x720".to_owned())
}
