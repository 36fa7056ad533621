//! Shows a flight in web browsers: the program `terravision-viewer`, which `terravision serve`
//! starts and starts again (docs/viewer.md).
//!
//! ```text
//! frame ring ─▶ flight_link ─▶ hub (newest picture) ─▶ encoder ─▶ socket, one a client ─▶ browser
//! poses      ◀─ flight_link ◀─ hub (pilot, settings) ◀──────────┘
//! launcher  ◀─▶ launcher_link: which flight there is, and which one is wanted
//! ```
//!
//! * [`hub`]: what all sessions share. [`flight_link`]: frame ring and poses, from a thread that
//!   waits for no client. [`picture`]: a frame, and its header for clients.
//! * [`encoder`]: JPEG and PNG, once for all clients. [`stills`]: exact pictures, by `terravision
//!   still`. [`rest`]: when they are drawn.
//! * [`hub::films`]: films of paths, by `terravision fly`. [`hub::conversion`]: path files, by
//!   `terravision path`. [`command`]: these commands while they run.
//! * [`video`]: H.264 for clients over slow links, by an ffmpeg for each.
//! * [`http`]: routes, and who may use them. [`socket`]: the WebSocket of a client.
//! * [`sight`]: the ground that a picture shows. [`terrain`]: heights, and what there is to know of the world.

mod command;
mod encoder;
mod error;
mod flight_link;
mod http;
mod hub;
mod jpeg;
mod launcher_link;
mod picture;
mod rest;
mod sight;
mod socket;
mod stills;
mod terrain;
mod video;

use error::ViewerError;
use hub::Hub;
use launcher_link::LauncherLink;
use rustix::fd::AsFd;
use std::io;
use std::net::TcpListener;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};
use terrain::Terrain;
use terravision_common::bug::report_panics;
use terravision_common::log::start_stage;
use terravision_common::stage::set_up_process;
use terravision_common::terminal::complain;

/// Threads that serve clients; encoding has others.
const WORKERS: usize = 2;
/// Longest time to take leave of all clients.
const LEAVE_WITHIN: Duration = Duration::from_secs(1);
/// Most threads that encode, read heights and the like.
const BLOCKING_THREADS: usize = 8;

/// The whole program: returns its exit code.
#[must_use]
pub fn main() -> ExitCode {
    report_panics("");
    start_stage();
    match serve() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            complain(&error.to_string());
            ExitCode::FAILURE
        }
    }
}

fn serve() -> Result<(), ViewerError> {
    set_up_process().map_err(ViewerError::Os)?;
    let listener = io::stdin().as_fd().try_clone_to_owned().map(TcpListener::from).map_err(ViewerError::NotServed)?;
    listener.set_nonblocking(true).map_err(ViewerError::NotServed)?;
    listener.local_addr().map_err(ViewerError::NotServed)?;
    let (link, events) = LauncherLink::open()?;
    let terrain = Terrain::open(&link.setup.database)?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(WORKERS)
        .max_blocking_threads(BLOCKING_THREADS)
        .enable_all()
        .build()
        .map_err(ViewerError::Os)?;
    let hub = Arc::new(Hub::new(link, terrain));
    let _of_flight = flight_link::start(Arc::clone(&hub)).map_err(ViewerError::Os)?;
    let _of_launcher = hub::launcher_events::listen(events, Arc::clone(&hub)).map_err(ViewerError::Os)?;
    let served = runtime.block_on(async {
        let listener = tokio::net::TcpListener::from_std(listener)?;
        tokio::spawn(rest::draw_exact_pictures(Arc::clone(&hub)));
        tokio::spawn(hub::flight_metrics::watch(Arc::clone(&hub)));
        tokio::spawn(hub::tile_map::watch(Arc::clone(&hub)));
        tokio::spawn(hub::orders::tell_launcher(Arc::clone(&hub)));
        http::serve(listener, Arc::clone(&hub)).await;
        // Clients are told why; the rest of their sessions ends with the runtime.
        let end = Instant::now() + LEAVE_WITHIN;
        while hub.clients() > 0 && Instant::now() < end {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        Ok(())
    });
    // Stills that are being drawn are told to end when they are dropped.
    runtime.shutdown_timeout(Duration::from_millis(300));
    served.map_err(ViewerError::Os)
}
