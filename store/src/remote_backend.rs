//! A database that is not a local folder: on a server, in a bucket, in an archive.

use crate::cache::{DiskCache, claim_cache};
use crate::error::{Cause, Fault, FetchError, StoreError};
use crate::error_log::ErrorLog;
use crate::location::Location;
use crate::mirror::{self, OnProgress, TemporaryFolder};
use crate::network::Network;
use crate::options::{StoreOptions, default_cache_dir};
use crate::payload::Payload;
use crate::remote::Remote;
use crate::transport::Transport;
use std::sync::Arc;
use std::time::{Duration, Instant};
use terravision_common::database::{Index, Layer, MANIFEST_FILE, MOST_MANIFEST_BYTES, Tile};
use terravision_common::files::read_bounded;
use terravision_common::threads::ensure;
use tokio::runtime::{Builder, Runtime};
use tokio::task::{JoinError, JoinHandle};

/// Threads that drive the network; they decode nothing.
const NETWORK_THREADS: usize = 2;
/// Threads that read and write the disk cache.
const DISK_THREADS: usize = 8;
/// How long to wait, at the end, for pieces that are still being written to the disk cache.
const CLOSE_WAIT: Duration = Duration::from_secs(5);

/// Reader of a remote database: its mirrored index, its archives, and threads.
#[derive(Debug)]
pub(crate) struct RemoteBackend {
    index: Index,
    remote: Arc<Remote>,
    /// Always `Some`, except while it is dropped.
    runtime: Option<Runtime>,
    _temporary: Option<TemporaryFolder>,
}

impl RemoteBackend {
    pub(crate) fn open(
        transport: Transport,
        location: &Location,
        options: &StoreOptions,
        log: &Arc<ErrorLog>,
        on_progress: OnProgress<'_>,
    ) -> Result<Self, StoreError> {
        // Without threads the runtime panics.
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
                        let why = format!("the disk cache cannot be used ({error}), and --offline asks no server");
                        return Err(FetchError::failed(Cause::Offline, why, cache_dir.display().to_string()).into());
                    }
                },
            };
            let note = |error: &std::io::Error| {
                let why =
                    format!("the disk cache cannot store the index ({error}); a temporary folder is used instead");
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
        // Data that is local already is not cached.
        let cache_bytes = if location.as_path().is_some() { 0 } else { options.cache_bytes };
        let cache = DiskCache::open(&cache_dir, &name, cache_bytes, Arc::clone(log));
        added.into_iter().for_each(|bytes| cache.account(bytes));
        let place = location.to_string();
        let remote = Remote::new(&open.manifest, open.text, network, cache, place, Arc::clone(log));
        let remote = Arc::new(remote);
        if options.index.is_none() && !options.is_offline {
            runtime.block_on(remote.open_archives())?;
        }
        Ok(Self { index, remote, runtime: Some(runtime), _temporary: temporary })
    }

    /// Its manifest, world and ranges of height.
    pub(crate) fn index(&self) -> &Index {
        &self.index
    }

    pub(crate) fn remote(&self) -> &Remote {
        &self.remote
    }

    /// A stored tile; see [`Remote::payload`]. Any executor may drive it.
    pub(crate) async fn payload(&self, tile: Tile, is_vital: bool) -> Result<Payload, FetchError> {
        let Some(runtime) = &self.runtime else { return Err(closed()) };
        let remote = Arc::clone(&self.remote);
        // On the store's own threads, whichever thread waits: connections live on the runtime that
        // made them.
        let task = runtime.spawn(async move { remote.payload(tile, is_vital).await });
        Cancelling(task).await.unwrap_or_else(|error| Err(unfinished(&error)))
    }

    /// Whether requests for a layer's archive fail in a row.
    pub(crate) fn is_silent(&self, layer: Layer) -> bool {
        self.remote.is_silent(layer)
    }

    /// Waits for a read; not for threads of an async runtime.
    pub(crate) fn block_on<T>(&self, read: impl Future<Output = Result<T, FetchError>>) -> Result<T, FetchError> {
        match &self.runtime {
            Some(runtime) => runtime.block_on(read),
            None => Err(closed()),
        }
    }
}

/// A task that is cancelled when its waiter is dropped.
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

impl Drop for RemoteBackend {
    fn drop(&mut self) {
        let end = Instant::now() + CLOSE_WAIT;
        while self.remote.under_way().1 > 0 && Instant::now() < end {
            std::thread::sleep(Duration::from_millis(1));
        }
        if let Some(runtime) = self.runtime.take() {
            // Other ways to end a runtime panic on threads of another runtime.
            runtime.shutdown_background();
        }
    }
}

/// The error of a task that panicked or was cancelled.
pub(crate) fn unfinished(error: &JoinError) -> FetchError {
    match error.is_panic() {
        true => FetchError::failed(Cause::Disk, "a fault of TerraVision itself; please report it", ""),
        false => closed(),
    }
}

fn closed() -> FetchError {
    FetchError::failed(Cause::Closed, "the database was closed while it was read", "")
}
