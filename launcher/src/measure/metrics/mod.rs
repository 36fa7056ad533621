//! Metrics of a run while it goes on, for Prometheus: plain HTTP, by default on loopback, from a
//! thread that reads the control block and what the launcher knows of frames. Nothing in the flight
//! waits for it.

mod answer;
mod tally;
mod text;
mod tiles;

pub use tally::FrameTally;

use crate::failure::Failure;
use crate::process::thread::in_thread;
use answer::{Clients, Page};
use anyhow::anyhow;
use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener};
use std::str::FromStr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;
use terravision_common::run::{OPEN_END, RunConfig};
use terravision_common::shm::{Control, Layout, RunId};
use text::Facts;
use tiles::TileMap;

/// How often the thread looks whether the run is over.
const TICK: Duration = Duration::from_millis(50);

/// Where metrics are served: a port of loopback, or an address with a port.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MetricsAddress(pub SocketAddr);

/// A text is neither.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "expected a port of this machine, e.g. 9464, or an address with a port, e.g. 127.0.0.1:9464 (0: any free port)"
)]
pub struct NoAddress;

impl FromStr for MetricsAddress {
    type Err = NoAddress;
    fn from_str(text: &str) -> Result<Self, NoAddress> {
        let port = text.parse::<u16>().map(|port| SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), port));
        port.or_else(|_| text.parse()).map(Self).map_err(|_neither| NoAddress)
    }
}

/// A socket that listens; nothing answers yet.
#[derive(Debug)]
pub struct MetricsSocket {
    listener: TcpListener,
    address: SocketAddr,
}

impl MetricsSocket {
    /// Listens at an address.
    ///
    /// # Errors
    /// Bad input: the address is taken, or not ours.
    pub fn open(MetricsAddress(asked): MetricsAddress) -> Result<Self, Failure> {
        let open = || -> io::Result<Self> {
            let listener = TcpListener::bind(asked)?;
            listener.set_nonblocking(true)?;
            let address = listener.local_addr()?;
            Ok(Self { listener, address })
        };
        open().map_err(|error| Failure::bad_input(anyhow!("--metrics {asked}: cannot listen there: {error}")))
    }

    /// What is told of a place that more than this machine can reach.
    #[must_use]
    pub fn warning(&self) -> Option<String> {
        let address = self.address;
        (!address.ip().is_loopback()).then(|| {
            format!(
                "--metrics {address}: everybody who can reach this machine can read the metrics of the run; --metrics {} is for \
                 this machine alone",
                address.port()
            )
        })
    }

    /// Where it listens.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

/// Answers as long as it lives.
#[derive(Debug)]
pub struct Metrics {
    ends: Arc<AtomicBool>,
    tally: Arc<Mutex<FrameTally>>,
    thread: Option<JoinHandle<()>>,
}

impl Metrics {
    /// Begins to answer about a run.
    ///
    /// # Errors
    /// The control block does not open, or there is no thread for it.
    pub fn start(socket: MetricsSocket, run: &RunId, config: &RunConfig, layout: &Layout) -> anyhow::Result<Self> {
        let [first, end] = config.frames;
        let facts = Facts {
            control: Control::open(run)?,
            pool_slots: [layout.elevation_slots(), layout.color_slots()],
            asked_frames: if end == OPEN_END { 0 } else { end.saturating_sub(first) },
        };
        let mut tiles = TileMap::open(run)?;
        let tally = Arc::new(Mutex::new(FrameTally::new(config)));
        let ends = Arc::new(AtomicBool::new(false));
        let (is_over, frames) = (Arc::clone(&ends), Arc::clone(&tally));
        let serve = move || {
            let mut clients = Clients::default();
            // Relaxed: a flag.
            while !is_over.load(Ordering::Relaxed) {
                clients.serve(&socket.listener, TICK, &mut |page| match page {
                    Page::Metrics => text::write(&facts, &lock(&frames)),
                    Page::Tiles => tiles.write(),
                });
            }
        };
        Ok(Self { ends, tally, thread: Some(in_thread("metrics", serve)?) })
    }

    /// What is known of frames.
    pub fn tally(&self) -> MutexGuard<'_, FrameTally> {
        lock(&self.tally)
    }
}

impl Drop for Metrics {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // It has nothing that can panic.
            drop(thread.join());
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_that_others_reach_is_warned_of() {
        let warning = |text: &str| MetricsSocket::open(text.parse().unwrap()).unwrap().warning();
        assert_eq!((warning("0"), warning("127.0.0.1:0")), (None, None));
        let told = warning("0.0.0.0:0").unwrap();
        assert!(told.contains("everybody who can reach this machine"), "{told}");
    }

    #[test]
    fn a_port_is_one_of_loopback() {
        let parsed = |text: &str| text.parse::<MetricsAddress>().map(|address| address.0.to_string());
        assert_eq!(parsed("9464").unwrap(), "127.0.0.1:9464");
        assert_eq!(parsed("0.0.0.0:80").unwrap(), "0.0.0.0:80");
        assert_eq!(parsed("[::1]:80").unwrap(), "[::1]:80");
        for text in ["", "localhost", "99999", "127.0.0.1"] {
            assert_eq!(parsed(text), Err(NoAddress), "{text}");
        }
    }
}
