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
use crate::path::orbit::{self, OrbitWishes};
use crate::path::{Course, Pose};
use crate::process::{interrupt, own_folder};
use crate::world::{self, open_world};
use crate::{ground::WorldGround, process::orphans};
use anyhow::{Context, anyhow};
use server::Server;
use std::fs::DirBuilder;
use std::io::{self, ErrorKind, Write};
use std::os::unix::fs::DirBuilderExt;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use terravision_common::shm::reap_dead_runs;
use terravision_common::terminal::complain;
use terravision_common::viewer::{FromViewer, ViewerPose, ViewerSetup};
use terravision_store::Store;

/// Vertical field of view of a camera that nobody has set.
const DEFAULT_VFOV_DEG: f64 = 60.0;

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
    if args.shared.picture.views.is_some() {
        return Err(Failure::bad_input(anyhow!("--views: a browser is shown one view; leave it out")));
    }
    let settings = flight::settings(args);
    if let Some(fault) = settings.fault() {
        return Err(Failure::bad_input(anyhow!("the page offers settings within limits: {fault}")));
    }
    let listener = address::listen(args)?;
    let database = open_world(&args.world, &args.shared.database)?;
    let start = start_pose(args, &database)?;
    let scratch = Scratch::create()?;
    let setup = ViewerSetup {
        share: format!("serve-{}", std::process::id()),
        world: args.world.display().to_string(),
        database: world::config(database.location(), &args.shared.database),
        still_flags: flight::still_flags(args),
        programs: own_folder()?,
        scratch: scratch.0.clone(),
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

/// Where the camera is when nobody has moved it: at the start of the orbit.
fn start_pose(args: &ServeArgs, database: &Store) -> Result<ViewerPose, Failure> {
    let (world, picture) = (database.world(), &args.shared.picture);
    let spacing = world.surface().end().max_element() / 200.0;
    let ground = WorldGround::coarse(database, world, picture.exaggeration, spacing).bounded(database.ranges());
    let wishes = OrbitWishes::usual(world.elevation_spacing_m(world.finest_elevation_level()));
    let orbit = orbit::orbit(&ground.extent(), &ground, &wishes);
    let first = match &orbit.path.course {
        Course::Round(poses) | Course::Frames(poses) => poses.first().copied(),
        Course::Timed(_) => None,
    };
    let Some(Pose { position, heading_rad, pitch_rad, roll_rad }) = first else {
        return Err(Failure::failed(anyhow!("the orbit of this world has no pose")));
    };
    // Numbers that people can read.
    let round = |value: f64, per_unit: f64| (value * per_unit).round() / per_unit;
    let degrees = |radians: f64| round(radians.to_degrees(), 100.0);
    Ok(ViewerPose {
        x: round(position.x, 10.0),
        y: round(position.y, 10.0),
        z: round(position.z, 10.0),
        heading: degrees(heading_rad).rem_euclid(360.0),
        pitch: degrees(pitch_rad),
        roll: degrees(roll_rad),
        vfov: start_vfov(picture.vfov)?,
    })
}

fn start_vfov(asked: Option<f64>) -> Result<f64, Failure> {
    let vfov = asked.unwrap_or(DEFAULT_VFOV_DEG);
    if !(1.0..=170.0).contains(&vfov) {
        return Err(Failure::bad_input(anyhow!("--vfov {vfov}: expected degrees from 1 to 170")));
    }
    Ok(vfov)
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
