//! A database on the fault server and in its folder, and all of its tiles read from either.

#![allow(
    dead_code,
    clippy::unwrap_used,
    reason = "each test program uses its own part; helpers of tests fail by panicking"
)]

use std::time::Duration;
use terravision_common::database::Layer;
use terravision_common::node::NodeId;
use terravision_common::world::World;
use terravision_store::{FetchError, Location, RetryOptions, Store, StoreOptions};
use terravision_testkit::fault_server::FaultServer;
use terravision_tests::folder::TestFolder;
use terravision_tests::worlds::synth_world;

pub(crate) const FILES: [&str; 4] = ["manifest.json", "nodes.tvn", "elevation.pmtiles", "color.pmtiles"];

/// Impatient, and stubborn: tests have no time to wait for servers that will not answer, and many
/// faults at once.
pub(crate) fn options(folder: &TestFolder) -> StoreOptions {
    StoreOptions {
        cache_dir: Some(folder.join("cache")),
        request_timeout: Duration::from_millis(700),
        deadline: Duration::from_secs(60),
        retries: RetryOptions {
            most: 40,
            first_wait: Duration::from_millis(2),
            longest_wait: Duration::from_millis(30),
            share: 20.0,
            burst: 10_000,
        },
        ..StoreOptions::default()
    }
}

pub(crate) fn serve() -> FaultServer {
    FaultServer::serve(synth_world(1024).database().parent().unwrap())
}

pub(crate) fn location(server: &FaultServer) -> Location {
    Location::parse(&server.url("world.tv")).unwrap()
}

pub(crate) fn local() -> Store {
    Store::open(&Location::folder(&synth_world(1024).database()), &StoreOptions::default()).unwrap()
}

/// Some tiles of all levels, both layers; a few that there are not.
pub(crate) fn tiles(world: &World) -> Vec<(Layer, NodeId)> {
    let of_level = |q: u8| {
        let [columns, rows] = world.nodes_at(q);
        let step = (columns.max(rows) / 12).max(1) as usize;
        (0..=rows)
            .step_by(step)
            .flat_map(move |n| (0..=columns).step_by(step).filter_map(move |m| NodeId::new(m, n, q)))
    };
    let nodes: Vec<NodeId> = (0..world.levels()).rev().flat_map(of_level).collect();
    nodes.iter().flat_map(|node| [(Layer::Elevation, *node), (Layer::Color, *node)]).collect()
}

/// A node of the finest level that has colour.
pub(crate) fn fine(m: u32) -> NodeId {
    NodeId::new(m, 1, synth_world_level()).unwrap()
}

pub(crate) fn synth_world_level() -> u8 {
    static LEVEL: std::sync::OnceLock<u8> = std::sync::OnceLock::new();
    *LEVEL.get_or_init(|| local().world().finest_color_level())
}

/// Reads tiles with eight threads; what each gave, `None` for one that the database does not have.
pub(crate) fn read(store: &Store, tiles: &[(Layer, NodeId)]) -> Vec<Result<Option<Vec<u8>>, FetchError>> {
    let one = |(layer, node): &(Layer, NodeId)| match block_on(store.payload(*layer, *node)) {
        Ok(bytes) => Ok(Some(bytes.to_vec())),
        Err(FetchError::Absent) => Ok(None),
        Err(error) => Err(error),
    };
    let mut results: Vec<_> = tiles.iter().map(|_| Ok(None)).collect();
    let next = std::sync::atomic::AtomicUsize::new(0);
    std::thread::scope(|scope| {
        let work = || {
            let mut done = Vec::new();
            loop {
                let at = next.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                let Some(tile) = tiles.get(at) else { return done };
                done.push((at, one(tile)));
            }
        };
        let threads: Vec<_> = (0..8).map(|_| scope.spawn(work)).collect();
        for (at, result) in threads.into_iter().flat_map(|thread| thread.join().unwrap()) {
            results[at] = result;
        }
    });
    results
}

/// Any executor may drive a store: this one parks its thread.
pub(crate) fn block_on<F: Future>(future: F) -> F::Output {
    struct Unpark(std::thread::Thread);
    impl std::task::Wake for Unpark {
        fn wake(self: std::sync::Arc<Self>) {
            self.0.unpark();
        }
    }
    let mut future = std::pin::pin!(future);
    let waker = std::sync::Arc::new(Unpark(std::thread::current())).into();
    let mut context = std::task::Context::from_waker(&waker);
    loop {
        if let std::task::Poll::Ready(output) = future.as_mut().poll(&mut context) {
            return output;
        }
        std::thread::park_timeout(Duration::from_millis(100));
    }
}

pub(crate) fn assert_same(what: &str, tiles: &[(Layer, NodeId)], found: &[Result<Option<Vec<u8>>, FetchError>]) {
    let expected = read(&local(), tiles);
    for ((tile, found), expected) in tiles.iter().zip(found).zip(&expected) {
        match found {
            Ok(found) => assert!(*found == *expected.as_ref().unwrap(), "{what}: {tile:?} differs"),
            Err(error) => panic!("{what}: {tile:?}: {error}"),
        }
    }
}
