//! Opening the world that a command is about, wherever it is.

use crate::cli::database::DatabaseArgs;
use crate::failure::Failure;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{self, IsTerminal};
use std::path::Path;
use terravision_common::run::DatabaseConfig;
use terravision_store::{Location, Store, StoreOptions};

/// An index that is smaller than this needs no bar.
const BAR_BYTES: u64 = 4 << 20;

/// Opens a world and says in one sentence why it cannot be flown.
///
/// # Errors
/// Bad input: not there, half written, newer, damaged, out of reach. Failed: no room or no threads
/// for it on this machine.
pub fn open_world(world: &Path, args: &DatabaseArgs) -> Result<Store, Failure> {
    let location = Location::parse_os(world.as_os_str()).map_err(Failure::bad_input)?;
    let options = StoreOptions::of(&config(&location, args));
    tracing::debug!(%location, "opens the database");
    let mut bar: Option<ProgressBar> = None;
    let opened = Store::open_with_progress(&location, &options, &mut |done, all| {
        if all >= BAR_BYTES && io::stderr().is_terminal() {
            let bar = bar.get_or_insert_with(|| {
                let bar = ProgressBar::with_draw_target(Some(all), ProgressDrawTarget::stderr_with_hz(5));
                let template = "{wide_bar} {bytes}/{total_bytes} of the index, {eta} left";
                bar.set_style(ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()));
                bar
            });
            bar.set_position(done);
        }
    });
    if let Some(bar) = bar {
        bar.finish_and_clear();
    }
    opened.map_err(|error| match error.is_bad_input() {
        true => Failure::bad_input(error),
        false => Failure::failed(error),
    })
}

/// What the stages are told of a world's tiles.
#[must_use]
pub fn config(location: &Location, args: &DatabaseArgs) -> DatabaseConfig {
    let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    DatabaseConfig {
        location: location
            .as_path()
            .map_or_else(|| location.to_argument(), |path| absolute(path).display().to_string()),
        cache: args.cache.as_deref().map(absolute),
        cache_bytes: args.cache_size.0,
        is_offline: args.offline,
        request_timeout_ms: u64::try_from(args.timeout.as_millis()).unwrap_or(u64::MAX),
        parallel_requests: args.requests,
    }
}
