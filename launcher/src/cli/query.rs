//! `terravision query`, as typed.

use super::database::DatabaseArgs;
use super::values::MemorySize;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// `terravision query`.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Each line of standard input is a question, and each line of standard output its answer:
  x y [z] ...        ok HEIGHT NORMAL-EAST NORMAL-NORTH NORMAL-UP [ABOVE]
                     made-up ... (no data there), hole, outside, unreadable, bad WHY
  --sight            visible DISTANCE | hidden DISTANCE X Y Z
  --sphere           free | touch DISTANCE CENTRE-X Y Z CONTACT-X Y Z NORMAL-EAST NORTH UP

  echo 560000 4980000 | terravision query valley.tv
  echo 560000 4980000 2000 561000 4985000 1500 | terravision query valley.tv --sight

A line that begins with { is a request of JSON, as on a socket (docs/query.md).")]
pub struct QueryArgs {
    /// The terrain database: a folder that `terravision ingest` made, a .tar of it, or where a copy
    /// is: http://, https:// or s3://bucket/prefix (docs/databases.md)
    #[arg(value_name = "WORLD")]
    pub world: PathBuf,
    /// What x and y are: easting and northing in the world's CRS, or longitude and latitude,
    /// degrees (WGS 84; on other bodies the body's own)
    #[arg(long, value_enum, value_name = "CRS", default_value_t = QueryCrs::World)]
    pub crs: QueryCrs,
    /// How heights between posts are found; lines of sight and spheres always meet facets
    #[arg(long, value_enum, value_name = "HOW", default_value_t = InterpolationChoice::Bilinear)]
    pub interpolation: InterpolationChoice,
    /// Ask whether two places see each other: lines of x1 y1 z1 x2 y2 z2
    #[arg(long, conflicts_with = "sphere")]
    pub sight: bool,
    /// Ask where a sphere of this radius, metres, touches the ground first when its centre moves
    /// straight from one place to another: lines of x1 y1 z1 x2 y2 z2
    #[arg(long, value_name = "RADIUS")]
    pub sphere: Option<f64>,
    /// Heights (z) are above the ground
    #[arg(long)]
    pub agl: bool,
    /// Answer on this Unix socket until Ctrl-C, in place of standard input (docs/query.md)
    #[arg(long, value_name = "SOCKET")]
    pub listen: Option<PathBuf>,
    /// Memory for tiles; more of it reads less again
    #[arg(long, value_name = "SIZE", default_value = "256MiB")]
    pub memory: MemorySize,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub database: DatabaseArgs,
}

/// What coordinates are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum QueryCrs {
    /// Easting and northing in the world's CRS
    World,
    /// Longitude and latitude, degrees
    Lonlat,
}

/// How heights between posts are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum InterpolationChoice {
    /// Bilinear, as GIS programs read the raster
    Bilinear,
    /// Linear on facets: the surface that is drawn
    Facet,
}
