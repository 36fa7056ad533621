//! A static web server on loopback that honours byte ranges, and misbehaves on demand: a slow link,
//! lost connections, wrong answers of every kind. For tests and benches: not a server for
//! production.
//!
//! ```no_run
//! use terravision_testkit::fault_server::{Fault, FaultServer, Rule};
//!
//! let server = FaultServer::serve("/data".as_ref());
//! let url = server.url("world.tv");
//! // Three requests in ten, for tiles alone, are dropped.
//! server.misbehave([Rule::new(Fault::Drop).of("color.pmtiles").percent(30)]);
//! ```

mod connection;
mod fault;

pub use fault::{Fault, Rule};

use std::collections::BTreeMap;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How often threads look whether the server ends.
const TICK: Duration = Duration::from_millis(20);

/// The link between server and clients, shared by all connections.
#[derive(Debug, Clone, Copy, Default)]
pub struct Link {
    /// Wait before each answer.
    pub latency: Duration,
    /// Bits a second for all answers together; as many as possible when `None`.
    pub bits_per_s: Option<u64>,
}

/// A request as the server saw it, and what came of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Asked {
    /// Path below the root.
    pub path: String,
    /// First byte and one past the last, when a range was asked for.
    pub range: Option<[u64; 2]>,
    /// What it did instead of answering.
    pub fault: Option<Fault>,
}

#[derive(Debug)]
pub(crate) struct Shared {
    root: PathBuf,
    ends: AtomicBool,
    is_down: AtomicBool,
    connections: AtomicU64,
    bytes: AtomicU64,
    rules: Mutex<Vec<(Rule, u64)>>,
    link: Mutex<(Link, Instant)>,
    asked: Mutex<Vec<Asked>>,
    etag: Mutex<String>,
}

/// A server on loopback. Dropped, it ends.
#[derive(Debug)]
pub struct FaultServer {
    address: SocketAddr,
    shared: Arc<Shared>,
    acceptor: Option<JoinHandle<()>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl FaultServer {
    /// Serves the files below a folder, on a port that the system chooses.
    ///
    /// # Panics
    /// When there is no port to be had.
    #[must_use]
    pub fn serve(root: &Path) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("loopback has a free port");
        listener.set_nonblocking(true).expect("a listener can be polled");
        let address = listener.local_addr().expect("a listener has an address");
        let shared = Arc::new(Shared {
            root: root.to_owned(),
            ends: AtomicBool::new(false),
            is_down: AtomicBool::new(false),
            connections: AtomicU64::new(0),
            bytes: AtomicU64::new(0),
            rules: Mutex::default(),
            link: Mutex::new((Link::default(), Instant::now())),
            asked: Mutex::default(),
            etag: Mutex::new("1".to_owned()),
        });
        let accepting = Arc::clone(&shared);
        let acceptor = std::thread::spawn(move || accept(&listener, &accepting));
        Self { address, shared, acceptor: Some(acceptor) }
    }

    /// The URL of something below the root.
    #[must_use]
    pub fn url(&self, path: &str) -> String {
        format!("http://{}/{path}", self.address)
    }

    /// From now on it answers by these rules; the first that fits a request counts. None: it
    /// behaves.
    pub fn misbehave(&self, rules: impl IntoIterator<Item = Rule>) {
        *lock(&self.shared.rules) = rules.into_iter().map(|rule| (rule, 0)).collect();
    }

    /// From now on its link is like this.
    pub fn set_link(&self, link: Link) {
        *lock(&self.shared.link) = (link, Instant::now());
    }

    /// From now on files have other marks, whether they changed or not.
    pub fn set_etag(&self, etag: &str) {
        etag.clone_into(&mut lock(&self.shared.etag));
    }

    /// Down, it closes all connections, new ones too.
    pub fn set_down(&self, is_down: bool) {
        // Relaxed, here and below: flags and figures that order nothing else.
        self.shared.is_down.store(is_down, Ordering::Relaxed);
    }

    /// All that was asked since the last call.
    #[must_use]
    pub fn take_asked(&self) -> Vec<Asked> {
        std::mem::take(&mut lock(&self.shared.asked))
    }

    /// Requests by path, of what was asked since it was taken last.
    #[must_use]
    pub fn asked_by_path(&self) -> BTreeMap<String, usize> {
        let mut counts = BTreeMap::new();
        for asked in lock(&self.shared.asked).iter() {
            *counts.entry(asked.path.clone()).or_default() += 1;
        }
        counts
    }

    /// Connections so far.
    #[must_use]
    pub fn connections(&self) -> u64 {
        self.shared.connections.load(Ordering::Relaxed)
    }

    /// Bytes of content sent so far.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.shared.bytes.load(Ordering::Relaxed)
    }
}

impl Drop for FaultServer {
    fn drop(&mut self) {
        self.shared.ends.store(true, Ordering::Relaxed);
        if let Some(acceptor) = self.acceptor.take() {
            // A thread that panicked has said so.
            drop(acceptor.join());
        }
    }
}

impl Shared {
    fn ends(&self) -> bool {
        self.ends.load(Ordering::Relaxed)
    }

    fn is_down(&self) -> bool {
        self.is_down.load(Ordering::Relaxed)
    }

    /// What to do with a request.
    fn fault(&self, path: &str) -> Option<Fault> {
        for (rule, seen) in lock(&self.rules).iter_mut().filter(|(rule, _)| rule.fits(path)) {
            *seen += 1;
            if rule.strikes(*seen - 1) {
                return Some(rule.fault());
            }
        }
        None
    }

    /// Waits until the link has carried this many bytes more.
    fn carry(&self, bytes: usize) {
        self.bytes.fetch_add(bytes as u64, Ordering::Relaxed);
        let until = {
            let mut link = lock(&self.link);
            let Some(rate) = link.0.bits_per_s else { return };
            let took = Duration::from_secs_f64(bytes as f64 * 8.0 / rate as f64);
            link.1 = link.1.max(Instant::now()) + took;
            link.1
        };
        std::thread::sleep(until.saturating_duration_since(Instant::now()));
    }
}

fn accept(listener: &TcpListener, shared: &Arc<Shared>) {
    let mut threads: Vec<JoinHandle<()>> = Vec::new();
    while !shared.ends() {
        match listener.accept() {
            Ok((stream, _)) if shared.is_down() => drop(stream),
            Ok((stream, _)) => {
                shared.connections.fetch_add(1, Ordering::Relaxed);
                let shared = Arc::clone(shared);
                threads.retain(|thread| !thread.is_finished());
                threads.push(std::thread::spawn(move || talk(stream, &shared)));
            }
            Err(_none) => std::thread::sleep(TICK / 10),
        }
    }
    for thread in threads {
        drop(thread.join());
    }
}

fn talk(stream: TcpStream, shared: &Shared) {
    // A connection that breaks is the client's affair.
    drop(connection::talk(stream, shared));
}
