//! `terravision serve`, as typed.

use super::database::DatabaseArgs;
use super::draw::DrawArgs;
use super::values::{self, MemorySize};
use clap::parser::ValueSource;
use clap::{ArgMatches, Args, Command, FromArgMatches};
use std::ffi::OsString;
use std::net::SocketAddr;
use std::time::Duration;

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
    /// Where it listens; port 0 takes a free one. What other machines can reach needs --token
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8080", value_parser = parse_address)]
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
    /// Most bytes that films may take, which are made from the page and kept until the server ends
    #[arg(long, value_name = "SIZE", default_value = "4GiB")]
    pub film_bytes: MemorySize,
    /// End the flight when nobody has looked for this many seconds; it is started again for the next
    /// one who does
    #[arg(long, value_name = "SECONDS", default_value = "60", value_parser = values::parse_timeout)]
    pub rest_after: Duration,
    /// Frames per second to hold [default: 30]
    #[arg(long, value_name = "N")]
    pub fps: Option<f64>,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub shared: SharedFlags,
}

/// Where to listen, as typed.
fn parse_address(text: &str) -> Result<SocketAddr, String> {
    let typed = text.strip_prefix("localhost:").map(|port| format!("127.0.0.1:{port}"));
    let address = typed.as_deref().unwrap_or(text).parse();
    address.map_err(|_error| "expected an IP address and a port, e.g. 127.0.0.1:8080 or [::1]:8080".to_owned())
}

/// Flags that flight and stills have in common, checked and as they were typed.
#[derive(Debug)]
pub struct SharedFlags {
    /// What the flight draws, and how.
    pub draw: DrawArgs,
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

    /// Those of them that say how the database is read.
    #[must_use]
    pub fn of_database(&self) -> Vec<OsString> {
        let known = DatabaseArgs::augment_args(Command::new("database"));
        let is_of_it =
            |flag: &str| known.get_arguments().filter_map(|argument| argument.get_long()).any(|long| long == flag);
        let others: Vec<&str> = self
            .given
            .iter()
            .map(|(flag, _)| flag.as_str())
            .filter(|flag| !is_of_it(flag.trim_start_matches('-')))
            .collect();
        self.without(&others)
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
        DrawArgs::augment_args(command)
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
        Ok(Self { draw: DrawArgs::from_arg_matches(matches)?, given: given.collect() })
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
        assert_eq!(args.shared.draw.picture.facet_px, Some(4.0));
        assert_eq!(args.shared.without(&["--facet-px"]), ["--validation", "--requests", "3"]);
        assert_eq!(args.shared.of_database(), ["--requests", "3"]);
        assert_eq!((args.shared.value("--facet-px"), args.shared.value("--texel-px")), (Some("4".into()), None));
        assert!(serve(&[]).shared.given.is_empty());
        assert_eq!(serve(&["--addr", "localhost:7"]).addr, serve(&["--addr", "127.0.0.1:7"]).addr);
        assert!(Cli::try_parse_from(["terravision", "serve", "w.tv", "--addr", "127.0.0.1"]).is_err());
        assert!(Cli::try_parse_from(["terravision", "serve", "w.tv", "--facet-px", "x"]).is_err());
    }
}
