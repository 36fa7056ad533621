//! The command line, as typed. Nothing here is interpreted beyond single values ([`values`]); [`crate::plan`] turns it
//! into a validated plan.

pub mod course;
pub mod database;
pub mod film;
pub mod fly;
pub mod live;
pub mod measurements;
pub mod path;
pub mod picture;
pub mod planes;
pub mod pose;
pub mod realtime;
pub mod resources;
pub mod still;
pub mod supervision;
pub mod technique;
pub mod values;

use clap::{Args, Parser, Subcommand};
use database::DatabaseArgs;
use fly::FlyArgs;
use path::PathArgs;
use std::ffi::OsString;
use std::path::PathBuf;
use still::StillArgs;
use values::MemorySize;

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

#[cfg(test)]
mod tests;
