//! What everything that draws has in common, as typed.

use super::database::DatabaseArgs;
use super::picture::PictureArgs;
use super::resources::ResourceArgs;
use clap::Args;
use std::path::PathBuf;

/// The world, how pictures of it are made, and what that may take; shared by `fly`, `still`, `view`
/// and `serve`.
#[derive(Debug, Args)]
pub struct DrawArgs {
    /// The terrain database: a folder that `terravision ingest` made, a .tar of it, or where a copy
    /// is: http://, https:// or s3://bucket/prefix (docs/databases.md)
    #[arg(value_name = "WORLD")]
    pub world: PathBuf,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub picture: PictureArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub resources: ResourceArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub database: DatabaseArgs,
}
