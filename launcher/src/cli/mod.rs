//! The command line, as typed. Nothing here is interpreted beyond single values ([`values`]);
//! [`crate::plan`] turns it into a validated plan.

pub mod course;
pub mod database;
pub mod draw;
pub mod film;
pub mod fly;
pub mod labels;
pub mod light;
pub mod live;
pub mod measurements;
pub mod path;
pub mod picture;
pub mod planes;
pub mod pose;
pub mod query;
pub mod realtime;
pub mod resources;
pub mod serve;
pub mod stereo;
pub mod still;
pub mod supervision;
pub mod technique;
pub mod values;
pub mod vehicles;
pub mod view;

use clap::{Args, Parser, Subcommand};
use database::DatabaseArgs;
use fly::FlyArgs;
use path::PathArgs;
use query::QueryArgs;
use serve::ServeArgs;
use std::ffi::OsString;
use std::path::PathBuf;
use still::StillArgs;
use values::MemorySize;
use view::ViewArgs;

const AFTER_HELP: &str = "\
A world from nothing, flown:
  terravision synth -o w
  terravision ingest --elevation w/dem.tif --color w/ortho.tif -o w.tv
  terravision fly w.tv -o film.mp4

EXIT STATUS
  0    done
  1    the run failed (a stage died, no space left, no Vulkan device for --technique mesh)
  2    bad usage or bad input: an argument is wrong, or what it names is missing, damaged
       or out of reach; nothing was written
  3    the flight finished, but some tiles were missing or damaged, and coarser ones
       were drawn in their place; the report lists them
  101  an internal error of TerraVision: please report it
  130  interrupted by Ctrl-C or TERM

ENVIRONMENT
  TERRAVISION_LOG     default of --log; 'stages' shows only what stages write to standard error
  RAYON_NUM_THREADS   default of --threads
  AWS_…, HTTPS_PROXY… for databases on servers: docs/databases.md
  VK_ICD_FILENAMES    which Vulkan drivers the loader sees

Messages go to standard error, results to standard output.";

/// Flies over terrain that is far larger than memory: turns a DEM and an orthophoto into films,
/// stills, depth and ground positions, with or without a GPU.
///
/// Four processes work together through shared memory: the generator searches the quad tree for
/// what the camera sees, the prefetcher loads tiles, the preparer makes a surface of them without
/// cracks, and the renderer draws it, with Vulkan or on the processor. This program starts them,
/// moves the camera, restarts what fails and cleans up at the end.
#[derive(Debug, Parser)]
#[command(name = "terravision", version, after_long_help = AFTER_HELP, max_term_width = 100)]
#[command(propagate_version = true, subcommand_required = true, arg_required_else_help = true)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
    /// Log what every process does to standard error [default: TERRAVISION_LOG, else off]
    ///
    /// A level (error, warn, info, debug, trace) for all of TerraVision, or a filter of levels by
    /// target, e.g. info,terravision_store=trace. docs/report.md says what is logged.
    #[arg(long, global = true, value_name = "LEVEL|FILTER", help_heading = "Log")]
    pub log: Option<String>,
    /// End in order when the process of this id, which started this one, ends.
    #[arg(long, global = true, hide = true, value_name = "PID")]
    pub child_of: Option<u32>,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Make a synthetic mountain world to try things with: dem.tif and ortho.tif
    #[command(disable_help_flag = true)]
    Synth(ExecArgs),
    /// Make a terrain database from rasters
    #[command(disable_help_flag = true)]
    Ingest(ExecArgs),
    /// Show what a terrain database contains
    Info(InfoArgs),
    /// Check whether this machine has what a flight needs, and say what to install
    Doctor(DoctorArgs),
    /// Fly a camera path over a terrain database, into a film, a folder of pictures or a pipe
    Fly(Box<FlyArgs>),
    /// Draw one picture, and on request the depth and the ground position of every pixel
    Still(Box<StillArgs>),
    /// Show the world in web browsers: look around, with live pictures over one WebSocket
    Serve(Box<ServeArgs>),
    /// Open a window and fly in it
    View(Box<ViewArgs>),
    /// Write the poses of a camera path, one per frame, as JSON that can be edited and flown
    Path(Box<PathArgs>),
    /// Answer questions about the ground: heights, normals, lines of sight, swept spheres; by lines
    /// of text, or on a socket
    Query(Box<QueryArgs>),
    /// Measure how fast the stages, the queues between them, both techniques and ingest are
    #[command(disable_help_flag = true)]
    Bench(ExecArgs),
}

/// Arguments of a subcommand that is a program of its own.
#[derive(Debug, Args)]
pub struct ExecArgs {
    /// Arguments of the subcommand: see its `--help`.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
    pub arguments: Vec<OsString>,
}

/// `terravision info`.
#[derive(Debug, Args)]
pub struct InfoArgs {
    /// The terrain database: a folder that `terravision ingest` made, a .tar of it, or where a copy
    /// is: http://, https:// or s3://bucket/prefix (docs/databases.md)
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

#[cfg(test)]
mod tests;
