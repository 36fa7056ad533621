//! `terravision serve`, as typed.

use super::database::DatabaseArgs;
use super::picture::PictureArgs;
use super::resources::ResourceArgs;
use clap::parser::ValueSource;
use clap::{ArgMatches, Args, Command, FromArgMatches};
use std::ffi::OsString;
use std::net::SocketAddr;
use std::path::PathBuf;

/// `terravision serve`.
#[derive(Debug, Args)]
#[command(after_long_help = "\
EXAMPLES
  terravision serve w.tv
  terravision serve w.tv --addr 127.0.0.1:0 --open
  terravision serve w.tv --addr 0.0.0.0:8080 --token 3fK9qUw2bYc81

The first line on standard output is the address to open. Ctrl-C ends it. docs/viewer.md describes
what programs can ask of it.")]
pub struct ServeArgs {
    /// The terrain database: a folder that `terravision ingest` made, a .tar of it, or where a copy
    /// is: http://, https:// or s3://bucket/prefix (docs/databases.md)
    #[arg(value_name = "WORLD")]
    pub world: PathBuf,
    /// Where it listens; port 0 takes a free one. What other machines can reach needs --token
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8080")]
    pub addr: SocketAddr,
    /// Also open the page in this machine's browser
    #[arg(long)]
    pub open: bool,
    /// What every client has to know: 8 to 256 letters, digits, - and _
    #[arg(long, value_name = "TOKEN")]
    pub token: Option<String>,
    /// Nobody moves the camera or changes settings
    #[arg(long)]
    pub read_only: bool,
    /// Pages of this origin may show the page in a frame, e.g. `https://example.org`
    #[arg(long, value_name = "ORIGIN")]
    pub allow_embed: Vec<String>,
    /// Frames per second to hold [default: 30]
    #[arg(long, value_name = "N")]
    pub fps: Option<f64>,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub shared: SharedFlags,
}

/// Flags that flight and stills have in common, checked and as they were typed.
#[derive(Debug)]
pub struct SharedFlags {
    /// How the picture is made.
    pub picture: PictureArgs,
    /// What a run may use.
    pub resources: ResourceArgs,
    /// How the database is read.
    pub database: DatabaseArgs,
    /// Those that were given: the flag, and its values.
    pub given: Vec<(String, Vec<OsString>)>,
}

impl SharedFlags {
    /// The flags that were given, without some.
    #[must_use]
    pub fn without(&self, left_out: &[&str]) -> Vec<OsString> {
        let given = self.given.iter().filter(|(flag, _)| !left_out.contains(&flag.as_str()));
        given.flat_map(|(flag, values)| [OsString::from(flag)].into_iter().chain(values.iter().cloned())).collect()
    }

    /// The value that was given for a flag.
    #[must_use]
    pub fn value(&self, name: &str) -> Option<String> {
        let (_, values) = self.given.iter().find(|(flag, _)| flag == name)?;
        values.first().map(|value| value.to_string_lossy().into_owned())
    }
}

impl Args for SharedFlags {
    fn augment_args(command: Command) -> Command {
        DatabaseArgs::augment_args(ResourceArgs::augment_args(PictureArgs::augment_args(command)))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for SharedFlags {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let known = Self::augment_args(Command::new("shared"));
        let given = known.get_arguments().filter_map(|argument| {
            let id = argument.get_id().as_str();
            let is_given = matches.value_source(id) == Some(ValueSource::CommandLine);
            let flag = argument.get_long().filter(|_| is_given)?;
            let values = matches.get_raw(id).filter(|_| argument.get_action().takes_values());
            Some((format!("--{flag}"), values.into_iter().flatten().map(OsString::from).collect()))
        });
        Ok(Self {
            picture: PictureArgs::from_arg_matches(matches)?,
            resources: ResourceArgs::from_arg_matches(matches)?,
            database: DatabaseArgs::from_arg_matches(matches)?,
            given: given.collect(),
        })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::{Cli, Command};
    use clap::Parser;

    fn serve(words: &[&str]) -> ServeArgs {
        let words = ["terravision", "serve", "w.tv"].iter().chain(words);
        let Command::Serve(args) = Cli::try_parse_from(words).unwrap().command else { panic!("not serve") };
        *args
    }

    #[test]
    fn shared_flags_are_checked_and_kept_as_typed() {
        let args = serve(&["--facet-px=4", "--validation", "--requests", "3", "--token", "abcdefgh", "--fps", "20"]);
        assert_eq!(args.shared.picture.facet_px, Some(4.0));
        assert_eq!(args.shared.without(&["--facet-px"]), ["--validation", "--requests", "3"]);
        assert_eq!((args.shared.value("--facet-px"), args.shared.value("--texel-px")), (Some("4".into()), None));
        assert!(serve(&[]).shared.given.is_empty());
        assert!(Cli::try_parse_from(["terravision", "serve", "w.tv", "--facet-px", "x"]).is_err());
    }
}
