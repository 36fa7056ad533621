//! A terrain database, wherever it is.

use crate::cache::{CacheFigures, DiskCache, claim_cache};
use crate::error::{Cause, Fault, FetchError, StoreError};
use crate::error_log::ErrorLog;
use crate::location::Location;
use crate::mirror::{self, OnProgress, TemporaryFolder};
use crate::network::Network;
use crate::options::{StoreOptions, default_cache_dir};
use crate::remote::Remote;
use crate::resting::Resting;
use crate::transport::Transport;
use bytes::Bytes;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};
use terravision_common::database::{
    Database, Index, Layer, MANIFEST_FILE, MOST_MANIFEST_BYTES, Manifest, NodeRanges, TileError, TileScratch,
    TileSource, check_tile, decode_color, decode_elevation,
};
use terravision_common::files::read_bounded;
use terravision_common::node::NodeId;
use terravision_common::threads::ensure;
use terravision_common::top_levels::top_levels;
use terravision_common::world::World;
use tokio::runtime::{Builder, Runtime};
use tokio::task::{JoinError, JoinHandle};

/// Threads that drive the network; they decode nothing.
const NETWORK_THREADS: usize = 2;
/// Threads that read and write the disk cache.
const DISK_THREADS: usize = 8;
/// Longest wait for what is still being written to the disk cache, at the end.
const CLOSE_WAIT: Duration = Duration::from_secs(5);

/// What a store has done so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Figures {
    /// Requests to the server, those for credentials included.
    pub requests: u64,
    /// Of these, asked again after a failure.
    pub repeated: u64,
    /// Bytes of content that came.
    pub bytes: u64,
    /// Pieces being read now.
    pub under_way: usize,
    /// The disk cache.
    pub cache: CacheFigures,
}

/// A terrain database, open for reading, wherever it is. Used by any thread; reads are shared, and their results are
/// checked by the checksums that tiles carry.
///
/// It has threads of its own for the network. Dropped, it waits a moment for what is still being written to its cache.
#[derive(Debug)]
pub struct Store {
    location: Location,
    log: Arc<ErrorLog>,
    backend: Backend,
}

#[derive(Debug)]
enum Backend {
    Local(Arc<Database>),
    Remote(Box<Elsewhere>),
}

#[derive(Debug)]
struct Elsewhere {
    index: Index,
    remote: Arc<Remote>,
    resting: Arc<Resting>,
    /// Always there, but at the end.
    runtime: Option<Runtime>,
    _temporary: Option<TemporaryFolder>,
}

impl Store {
    /// Opens a database: reads its manifest, mirrors its index, looks whether its archives are there. Blocks; not for
    /// threads of an async runtime.
    ///
    /// # Errors
    /// [`StoreError`], one sentence: not there, not reachable, damaged, of another version.
    pub fn open(location: &Location, options: &StoreOptions) -> Result<Self, StoreError> {
        Self::open_with_progress(location, options, &mut |_, _| {})
    }

    /// [`Store::open`], telling how far the index has come, which may be megabytes.
    ///
    /// # Errors
    /// See [`Store::open`].
    pub fn open_with_progress(
        location: &Location,
        options: &StoreOptions,
        on_progress: OnProgress<'_>,
    ) -> Result<Self, StoreError> {
        let log = Arc::new(ErrorLog::default());
        let backend = match (location.as_folder(), Transport::new(location, options)?) {
            (None, Some(transport)) => {
                Backend::Remote(Box::new(Elsewhere::open(transport, location, options, &log, on_progress)?))
            }
            (folder, _) => Backend::Local(Arc::new(Database::open(folder.unwrap_or(Path::new(".")))?)),
        };
        Ok(Self { location: location.clone(), log, backend })
    }

    /// Where it is.
    #[must_use]
    pub fn location(&self) -> &Location {
        &self.location
    }

    /// What it is and where its ground lies. Its path is a folder of this machine with manifest and height ranges: that
    /// of the database itself, or a mirror that stays as long as this store.
    #[must_use]
    pub fn index(&self) -> &Index {
        match &self.backend {
            Backend::Local(database) => database.index(),
            Backend::Remote(elsewhere) => &elsewhere.index,
        }
    }

    /// What the manifest says.
    #[must_use]
    pub fn manifest(&self) -> &Manifest {
        self.index().manifest()
    }

    /// Its geometry.
    #[must_use]
    pub fn world(&self) -> &World {
        self.index().world()
    }

    /// Lowest and highest ground under each node.
    #[must_use]
    pub fn ranges(&self) -> &NodeRanges {
        self.index().ranges()
    }

    /// Failures so far, folded; those that a later request made good are among them.
    #[must_use]
    pub fn errors(&self) -> &ErrorLog {
        &self.log
    }

    /// What it has done so far; all zeros for a folder of this machine.
    #[must_use]
    pub fn figures(&self) -> Figures {
        let Backend::Remote(elsewhere) = &self.backend else { return Figures::default() };
        let remote = &elsewhere.remote;
        let wire = |read: fn(&Network) -> u64| remote.network().map_or(0, read);
        Figures {
            requests: wire(|network| network.transport().wire().requests()),
            repeated: wire(Network::repeated),
            bytes: wire(|network| network.transport().wire().bytes()),
            under_way: remote.under_way().0,
            cache: remote.cache_figures(),
        }
    }

    /// A tile as it is stored, its checksum verified. Dropping the future cancels the read, in the queue and on the
    /// wire, unless another one waits for the same bytes. Any executor may drive it.
    ///
    /// A tile that could not be had is not asked for again for a while: the same error comes at once.
    ///
    /// # Errors
    /// [`FetchError`].
    pub async fn payload(&self, layer: Layer, node: NodeId) -> Result<Bytes, FetchError> {
        match &self.backend {
            Backend::Local(database) => match tokio::runtime::Handle::try_current() {
                Ok(runtime) => {
                    let (database, log) = (Arc::clone(database), Arc::clone(&self.log));
                    let task = runtime.spawn_blocking(move || local_payload(&database, layer, node, &log));
                    task.await.unwrap_or_else(|error| Err(unfinished(&error)))
                }
                Err(_no_runtime) => local_payload(database, layer, node, &self.log),
            },
            Backend::Remote(elsewhere) => elsewhere.payload(layer, node).await,
        }
    }

    /// [`Store::payload`] for threads of no async runtime.
    fn payload_blocking(&self, layer: Layer, node: NodeId) -> Result<Bytes, TileError> {
        let read = match &self.backend {
            Backend::Local(database) => local_payload(database, layer, node, &self.log),
            Backend::Remote(elsewhere) => match &elsewhere.runtime {
                Some(runtime) => runtime.block_on(elsewhere.payload(layer, node)),
                None => Err(closed()),
            },
        };
        read.map_err(|error| error.into_tile_error(layer, node))
    }
}

impl Elsewhere {
    fn open(
        transport: Transport,
        location: &Location,
        options: &StoreOptions,
        log: &Arc<ErrorLog>,
        on_progress: OnProgress<'_>,
    ) -> Result<Self, StoreError> {
        // The runtime panics without them.
        ensure(NETWORK_THREADS + DISK_THREADS).map_err(|source| StoreError::Threads { source })?;
        let runtime = Builder::new_multi_thread()
            .worker_threads(NETWORK_THREADS)
            .max_blocking_threads(DISK_THREADS)
            .thread_name("store")
            .enable_all()
            .build()
            .map_err(|source| StoreError::Threads { source })?;
        let network = (!options.is_offline).then(|| Network::new(transport, options, Arc::clone(log)));
        let cache_dir = options.cache_dir.clone().unwrap_or_else(default_cache_dir);
        let unusable = claim_cache(&cache_dir).err();
        let (open, index, added, temporary) = if let Some(folder) = &options.index {
            let index = Index::open(folder)?;
            let path = folder.join(MANIFEST_FILE);
            let text = read_bounded(&path, MOST_MANIFEST_BYTES);
            let text = text.map_err(|source| StoreError::Mirror { source, path })?;
            (mirror::parse(text.into(), location)?, index, Vec::new(), None)
        } else {
            let open = match &network {
                Some(network) => runtime.block_on(mirror::read_manifest(network, location))?,
                None => match &unusable {
                    None => mirror::cached_manifest(&cache_dir, location)?,
                    Some(error) => {
                        let why = format!("the disk cache cannot be used ({error}), and offline nobody is asked");
                        return Err(FetchError::failed(Cause::Offline, why, cache_dir.display().to_string()).into());
                    }
                },
            };
            let note = |error: &std::io::Error| {
                let why = format!("the disk cache cannot keep the index ({error}), a temporary folder does");
                log.note(&Fault { cause: Cause::Cache, why, place: cache_dir.display().to_string() });
            };
            if let Some(error) = &unusable {
                note(error);
            }
            let usable = unusable.is_none().then_some(cache_dir.as_path());
            let mirrored = mirror::mirror(&open, location, usable, network.as_ref(), on_progress, note);
            let mirrored = runtime.block_on(mirrored)?;
            (open, mirrored.index, mirrored.added, mirrored.temporary)
        };
        let name = mirror::database_name(location, &open.text);
        // What is on this machine already is not kept twice.
        let cache_bytes = if location.as_path().is_some() { 0 } else { options.cache_bytes };
        let cache = DiskCache::open(&cache_dir, &name, cache_bytes, Arc::clone(log));
        added.into_iter().for_each(|bytes| cache.account(bytes));
        let place = location.to_string();
        let remote = Remote::new(&open.manifest, open.text, open.world, network, cache, place, Arc::clone(log));
        let remote = Arc::new(remote);
        if options.index.is_none() && !options.is_offline {
            runtime.block_on(remote.open_archives())?;
        }
        let (vital, _) = top_levels(index.world());
        let resting = Arc::new(Resting::new(index.world().root(), vital));
        Ok(Self { index, remote, resting, runtime: Some(runtime), _temporary: temporary })
    }

    async fn payload(&self, layer: Layer, node: NodeId) -> Result<Bytes, FetchError> {
        let Some(runtime) = &self.runtime else { return Err(closed()) };
        if let Some(error) = self.resting.find(layer, node) {
            return Err(error);
        }
        let (remote, resting) = (Arc::clone(&self.remote), Arc::clone(&self.resting));
        // On the store's own threads, whoever waits: connections live where they were made.
        let task = runtime.spawn(async move {
            let read = remote.payload(layer, node, resting.is_vital(layer, node)).await;
            resting.note(layer, node, read.as_ref().err());
            read
        });
        Cancelling(task).await.unwrap_or_else(|error| Err(unfinished(&error)))
    }
}

/// A task that ends with the one that waits for it.
struct Cancelling<T>(JoinHandle<T>);

impl<T> Future for Cancelling<T> {
    type Output = Result<T, tokio::task::JoinError>;

    fn poll(mut self: std::pin::Pin<&mut Self>, context: &mut std::task::Context<'_>) -> std::task::Poll<Self::Output> {
        std::pin::Pin::new(&mut self.0).poll(context)
    }
}

impl<T> Drop for Cancelling<T> {
    fn drop(&mut self) {
        self.0.abort();
    }
}

impl Drop for Elsewhere {
    fn drop(&mut self) {
        let end = Instant::now() + CLOSE_WAIT;
        while self.remote.under_way().1 > 0 && Instant::now() < end {
            std::thread::sleep(Duration::from_millis(1));
        }
        if let Some(runtime) = self.runtime.take() {
            // The other ways to end a runtime are not for threads of another one.
            runtime.shutdown_background();
        }
    }
}

/// Why a task has not ended by itself.
fn unfinished(error: &JoinError) -> FetchError {
    match error.is_panic() {
        true => FetchError::failed(Cause::Disk, "a fault of TerraVision itself; please report it", ""),
        false => closed(),
    }
}

fn closed() -> FetchError {
    FetchError::failed(Cause::Closed, "the database was closed while it was read", "")
}

fn local_payload(database: &Database, layer: Layer, node: NodeId, log: &ErrorLog) -> Result<Bytes, FetchError> {
    let read = read_local(database, layer, node);
    match read {
        Err(FetchError::Damaged { .. } | FetchError::Failed(_)) if has_changed(database) => {
            let why =
                "the database is not the one that was opened (its manifest is another one); open it anew".to_owned();
            let fault = Fault { cause: Cause::Changed, why, place: database.path().display().to_string() };
            log.note(&fault);
            Err(FetchError::Failed(Arc::new(fault)))
        }
        read => read,
    }
}

/// Whether another database lies in the folder by now.
fn has_changed(database: &Database) -> bool {
    let text = read_bounded(&database.path().join(MANIFEST_FILE), MOST_MANIFEST_BYTES).ok();
    let manifest = text.and_then(|text| Manifest::parse(std::str::from_utf8(&text).ok()?).ok());
    manifest.is_some_and(|manifest| manifest != *database.manifest())
}

fn read_local(database: &Database, layer: Layer, node: NodeId) -> Result<Bytes, FetchError> {
    let mut bytes = Vec::new();
    match database.read_payload(layer, node, &mut bytes) {
        Ok(()) => {}
        Err(TileError::Missing { .. }) => return Err(FetchError::Absent),
        Err(TileError::Corrupt { reason, .. }) => return Err(FetchError::Damaged { reason: Arc::new(reason) }),
        Err(error) => {
            return Err(FetchError::failed(Cause::Disk, error.to_string(), database.path().display().to_string()));
        }
    }
    check_tile(layer, &bytes).map_err(|reason| FetchError::Damaged { reason: Arc::new(reason) })?;
    Ok(bytes.into())
}

/// Blocks on the network; not for threads of an async runtime.
impl TileSource for Store {
    fn read_elevation(&self, node: NodeId, out: &mut [f32], scratch: &mut TileScratch) -> Result<(), TileError> {
        if let Backend::Local(database) = &self.backend {
            return database.read_elevation(node, out, scratch);
        }
        let payload = self.payload_blocking(Layer::Elevation, node)?;
        decode_elevation(self.world(), node, &payload, out, scratch)
    }

    fn read_color(&self, node: NodeId, out: &mut [u8], scratch: &mut TileScratch) -> Result<(), TileError> {
        if let Backend::Local(database) = &self.backend {
            return database.read_color(node, out, scratch);
        }
        let payload = self.payload_blocking(Layer::Color, node)?;
        decode_color(self.world(), node, &payload, out)
    }
}
