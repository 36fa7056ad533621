//! `terravision serve`: the world in web browsers. Starts a flight and a viewer, two programs of
//! their own, and starts each again when it dies (docs/viewer.md).
//!
//! ```text
//! terravision serve ── terravision fly --mode realtime ── the four stages
//!        │  ▲                 │ frame ring  ▲ poses
//!   setup│  │wishes           ▼             │
//!        └──┴───────── terravision-viewer ──┴── browsers
//! ```
//!
//! * [`address`]: where the page is served. [`child`]: a program that is watched. [`flight`],
//!   [`viewer`]: the two.
//! * [`server`]: what becomes of them.

mod address;
mod child;
mod flight;
mod server;
mod viewer;

use crate::cli::serve::ServeArgs;
use crate::failure::{ExitStatus, Failure};
use crate::plan::{check_hands, start_pose};
use crate::process::{interrupt, orphans, own_folder};
use crate::world::{self, open_world};
use anyhow::{Context, anyhow};
use server::Server;
use std::fs::DirBuilder;
use std::io::{self, ErrorKind, Write};
use std::os::unix::fs::DirBuilderExt;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use terravision_common::shm::reap_dead_runs;
use terravision_common::terminal::complain;
use terravision_common::viewer::{FromViewer, ViewerSetup};

/// What happens while it serves.
#[derive(Debug)]
enum Event {
    /// The flight of this number has written a line.
    FlightSaid {
        /// The flight.
        number: u32,
        /// The line.
        line: String,
    },
    /// The viewer has written a line.
    ViewerSaid {
        /// The line.
        line: String,
    },
    /// The viewer wants something.
    Viewer(FromViewer),
}

/// Serves until Ctrl-C.
///
/// # Errors
/// Bad input: the world does not open, the address is taken or needs a token. Failed: the flight
/// does not start.
pub fn serve(args: &ServeArgs) -> Result<(), Failure> {
    if args.shared.draw.picture.views.is_some() {
        return Err(Failure::bad_input(anyhow!("--views: a browser is shown one view; leave it out")));
    }
    if let Some(fault) = args.shared.draw.picture.light.fault() {
        return Err(Failure::bad_input(anyhow!(fault)));
    }
    let listener = address::listen(args)?;
    let database = open_world(&args.shared.draw.world, &args.shared.draw.database)?;
    check_hands("serve", database.world())?;
    let (start, convergence_m) = start_pose(&args.shared.draw.picture, &database)?;
    let settings = flight::settings(args, convergence_m);
    if let Some(fault) = settings.fault() {
        return Err(Failure::bad_input(anyhow!("the page offers settings within limits: {fault}")));
    }
    let scratch = Scratch::create()?;
    let setup = ViewerSetup {
        share: format!("serve-{}", std::process::id()),
        world: args.shared.draw.world.display().to_string(),
        database: world::config(database.location(), &args.shared.draw.database),
        still_flags: flight::still_flags(args),
        database_flags: flight::texts(&args.shared.of_database()),
        programs: own_folder()?,
        scratch: scratch.0.clone(),
        film_bytes: args.film_bytes.0,
        token: args.token.clone(),
        is_read_only: args.read_only,
        embedders: args.allow_embed.clone(),
        start,
        defaults: settings,
    };
    // The index of a database elsewhere is in the cache now, where flight and viewer find it.
    drop(database);
    interrupt::listen().context("cannot listen for Ctrl-C").map_err(Failure::failed)?;
    orphans::adopt_orphans();
    drop(reap_dead_runs());
    let listening = listener.local_addr().context("cannot listen").map_err(Failure::failed)?;
    let page = address::page_address(listening, args.token.as_deref());
    say_address(&page).context("cannot write to standard output").map_err(Failure::failed)?;
    if args.open {
        open_browser(&page);
    }
    let served = Server::new(args, setup, &listener).run();
    // What a flight that was killed has left.
    orphans::end_orphans();
    drop(reap_dead_runs());
    served
}

fn say_address(page: &str) -> io::Result<()> {
    let mut out = io::stdout().lock();
    writeln!(out, "{page}")?;
    out.flush()
}

fn open_browser(page: &str) {
    let mut command = Command::new("xdg-open");
    let started = command.arg(page).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
    if let Err(error) = started {
        complain(&format!("terravision: warning: --open: xdg-open does not start ({error}); open {page} yourself"));
    }
}

/// A folder for files of a moment, removed when it is dropped.
#[derive(Debug)]
struct Scratch(PathBuf);

impl Scratch {
    fn create() -> Result<Self, Failure> {
        let folder = std::env::temp_dir();
        for attempt in 0..100 {
            let path = folder.join(format!("terravision-serve-{}-{attempt}", std::process::id()));
            match DirBuilder::new().mode(0o700).create(&path) {
                Ok(()) => return Ok(Self(path)),
                // Of a server that was killed.
                Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
                Err(error) => return Err(Failure::failed(anyhow!("cannot create {}: {error}", path.display()))),
            }
        }
        Err(Failure { status: ExitStatus::Failed, error: anyhow!("no folder can be created in {}", folder.display()) })
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.0).ok();
    }
}
