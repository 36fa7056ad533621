//! The disk cache of databases on servers: what it has is not asked for again, what it cannot keep
//! costs nothing but time.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

mod served;

use served::{assert_same, block_on, fine, location, options, read, serve, tiles};
use std::fs;
use std::path::Path;
use terravision_common::database::Layer;
use terravision_store::{Cause, Location, Store, StoreOptions};
use terravision_tests::folder::TestFolder;

#[test]
fn a_second_run_asks_for_the_manifest_alone_and_an_offline_one_for_nothing() {
    let (server, folder) = (serve(), TestFolder::new("store-cache"));
    let tiles = {
        let store = Store::open(&location(&server), &options(&folder)).unwrap();
        let tiles: Vec<_> = tiles(store.world()).into_iter().filter(|(_, node)| *node != fine(1)).collect();
        assert_same("first", &tiles, &read(&store, &tiles));
        tiles
    };
    drop(server.take_asked());
    {
        let store = Store::open(&location(&server), &options(&folder)).unwrap();
        assert_same("second", &tiles, &read(&store, &tiles));
        assert_eq!(server.take_asked().len(), 1, "the manifest");
    }
    server.set_down(true);
    let offline = StoreOptions { is_offline: true, ..options(&folder) };
    let store = Store::open(&location(&server), &offline).unwrap();
    assert_same("offline", &tiles, &read(&store, &tiles));
    assert_eq!((server.take_asked().len(), store.stats().requests), (0, 0));
    // A tile that it lacks is an error that says so.
    let error = block_on(store.payload(Layer::Color, fine(1))).unwrap_err();
    assert!(error.cause() == Some(Cause::Offline) && error.to_string().contains("not in the cache"), "{error}");
    // Nothing of another place.
    let elsewhere = Location::parse("http://127.0.0.1:9/other.tv").unwrap();
    let error = Store::open(&elsewhere, &offline).unwrap_err();
    assert!(error.is_bad_input() && error.to_string().contains("nothing of it"), "{error}");
}

fn for_each_entry(folder: &Path, each: &mut dyn FnMut(&Path)) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        match entry.metadata().unwrap().is_dir() {
            true => for_each_entry(&entry.path(), each),
            false => each(&entry.path()),
        }
    }
}

#[test]
fn damaged_entries_of_the_cache_are_read_anew() {
    let (server, folder) = (serve(), TestFolder::new("store-damaged"));
    let tiles = {
        let store = Store::open(&location(&server), &options(&folder)).unwrap();
        let tiles = tiles(store.world());
        assert_same("first", &tiles, &read(&store, &tiles));
        tiles
    };
    let mut number = 0;
    for_each_entry(&folder.join("cache"), &mut |path| {
        let mut bytes = fs::read(path).unwrap();
        number += 1;
        match number % 4 {
            0 => bytes.truncate(bytes.len() / 2),
            1 => bytes.clear(),
            2 => {
                let middle = bytes.len() / 2;
                bytes[middle] ^= 1;
            }
            _ => bytes.extend([7; 100]),
        }
        fs::write(path, bytes).unwrap();
    });
    let store = Store::open(&location(&server), &options(&folder)).unwrap();
    assert_same("damaged", &tiles, &read(&store, &tiles));
    assert!(store.stats().cache.damaged > 10, "{:?}", store.stats());
    let news = store.errors().take_news();
    assert!(news.iter().any(|line| line.contains("damaged")), "{news:?}");
}

#[test]
fn a_small_cache_stays_small_and_one_that_cannot_be_is_done_without() {
    let (server, folder) = (serve(), TestFolder::new("store-small"));
    let small = StoreOptions { cache_bytes: 200 << 10, ..options(&folder) };
    let stores = [Store::open(&location(&server), &small).unwrap(), Store::open(&location(&server), &small).unwrap()];
    let tiles = tiles(stores[0].world());
    std::thread::scope(|scope| {
        for store in &stores {
            let tiles = &tiles;
            scope.spawn(move || assert_same("small", tiles, &read(store, tiles)));
        }
    });
    drop(stores);
    let mut bytes = 0;
    for_each_entry(&folder.join("cache/tiles"), &mut |path| bytes += fs::metadata(path).unwrap().len());
    assert!(bytes > 0 && bytes <= 200 << 10, "{bytes} bytes");

    let nowhere = StoreOptions { cache_dir: Some("/proc/terravision".into()), ..options(&folder) };
    let store = Store::open(&location(&server), &nowhere).unwrap();
    assert_same("no cache", &tiles, &read(&store, &tiles));
    let news = store.errors().take_news();
    assert!(
        !news.is_empty() && news.len() <= 2 && news.iter().all(|line| line.contains("/proc/terravision")),
        "{news:?}"
    );
    let index = store.index().path().to_owned();
    assert!(index.join("nodes.tvn").exists());
    drop(store);
    assert!(!index.exists(), "the index that no cache would take is gone");
}
