//! `terravision path`, as typed.

use super::course::CourseArgs;
use super::database::DatabaseArgs;
use clap::Args;
use std::path::PathBuf;

/// `terravision path`.
#[derive(Debug, Args)]
pub struct PathArgs {
    /// The terrain database: a folder that `terravision ingest` made, a .tar of it, or where a copy
    /// is: http://, https:// or s3://bucket/prefix (docs/databases.md)
    #[arg(value_name = "WORLD")]
    pub world: PathBuf,
    /// Where the poses go: a JSON file, or - for standard output
    #[arg(short, long, value_name = "FILE.json|-", default_value = "-")]
    pub output: PathBuf,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub course: CourseArgs,
    /// Write keyframes where the path has them (keyframes of JSON, tours and views of
    /// KML, CZML), not a
    /// pose for every frame
    #[arg(long, conflicts_with_all = ["frames", "fps", "speed"])]
    pub keyframes: bool,
    /// Vertical field of view, degrees, written into the path [default: the path's own, else none:
    /// it is then flown with 60]
    #[arg(long, value_name = "DEGREES")]
    pub vfov: Option<f64>,
    /// Factor on all heights of the terrain, for heights above ground
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, allow_negative_numbers = true)]
    pub exaggeration: f64,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub database: DatabaseArgs,
}
