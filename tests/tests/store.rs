//! A database on a server, read through every kind of trouble: the same tiles as from its folder,
//! or an error that says what and why, and never more requests than make sense.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

mod served;

use served::{FILES, assert_same, block_on, fine, local, location, options, read, serve, tiles};
use std::fs;
use std::path::Path;
use std::time::Duration;
use terravision_common::database::{Layer, TileError, TileScratch, TileSource, color_tile_bytes};
use terravision_common::node::NodeId;
use terravision_store::{Cause, FetchError, Location, RetryOptions, Store, StoreError, StoreOptions};
use terravision_testkit::fault_server::{Fault, FaultServer, Link, Rule};
use terravision_tests::folder::TestFolder;
use terravision_tests::process::Terravision;
use terravision_tests::worlds::synth_world;

#[test]
fn a_server_gives_the_tiles_of_the_folder_in_ranges_over_few_connections() {
    let (server, folder) = (serve(), TestFolder::new("store-plain"));
    let store = Store::open(&location(&server), &options(&folder)).unwrap();
    assert_eq!(store.manifest(), local().manifest());
    assert_eq!(store.ranges(), local().ranges());
    let tiles = tiles(store.world());
    assert_same("plain", &tiles, &read(&store, &tiles));
    let asked = server.asked_by_path();
    println!("{} tiles: {asked:?}, {} connections, {:?}", tiles.len(), server.connections(), store.stats());
    assert_eq!((asked["world.tv/manifest.json"], store.stats().repeated), (1, 0));
    assert!(asked["world.tv/elevation.pmtiles"] * 4 < tiles.len(), "neighbours share extents");
    assert!(server.connections() <= 17, "connections are used again");
    for asked in server.take_asked() {
        let length = asked.range.map_or(0, |[first, end]| end - first);
        assert!(asked.path.ends_with("manifest.json") || (1..=1 << 20).contains(&length), "{asked:?}");
    }
    assert!(store.errors().folded().is_empty());

    // The same by a source that blocks, decoded.
    let (local, mut scratch) = (local(), TileScratch::default());
    let root = store.world().root();
    let mut colors = [vec![0; color_tile_bytes(store.world())], vec![1; color_tile_bytes(store.world())]];
    store.read_color(root, &mut colors[0], &mut scratch).unwrap();
    local.read_color(root, &mut colors[1], &mut scratch).unwrap();
    assert!(colors[0] == colors[1]);
    let posts = (store.world().elevation_posts() as usize).pow(2);
    let mut heights = [vec![0f32; posts], vec![1.0; posts]];
    store.read_elevation(root, &mut heights[0], &mut scratch).unwrap();
    local.read_elevation(root, &mut heights[1], &mut scratch).unwrap();
    assert_eq!(heights[0], heights[1]);
}

#[test]
fn an_archive_gives_the_tiles_of_the_folder_from_this_machine_and_from_a_server() {
    let folder = TestFolder::new("store-archive");
    let database = synth_world(1024).database();
    for (name, format) in [("gnu world.tar", "gnu"), ("pax.tar", "pax")] {
        Terravision::program("tar")
            .args(["--format", format, "-cf"])
            .arg(folder.join(name))
            .arg("-C")
            .arg(database.parent().unwrap())
            .arg("world.tv")
            .succeed();
    }
    let server = FaultServer::serve(folder.path());
    for location in [folder.join("gnu world.tar").display().to_string(), server.url("pax.tar?key=1")] {
        let location = Location::parse(&location).unwrap();
        let store = Store::open(&location, &options(&folder)).unwrap();
        assert_eq!(store.manifest(), local().manifest());
        let tiles = tiles(store.world());
        assert_same("archive", &tiles, &read(&store, &tiles));
        assert!(store.errors().folded().is_empty() && store.stats().requests > 10, "{:?}", store.stats());
    }
    fs::write(folder.join("no.tar"), vec![b'x'; 4096]).unwrap();
    for (name, words) in [("no.tar", "not a tar archive"), ("none.tar", "No such file")] {
        let error = Store::open(&Location::parse(&folder.join(name).display().to_string()).unwrap(), &options(&folder));
        let error = error.unwrap_err();
        assert!(error.is_bad_input() && error.to_string().contains(words), "{error}");
    }
}

#[test]
fn what_passes_is_asked_again_until_it_came() {
    let faults = [
        Rule::new(Fault::Drop).percent(40),
        Rule::new(Fault::Status(500, None)).percent(40),
        Rule::new(Fault::Status(503, Some(0))).percent(40),
        Rule::new(Fault::Status(429, None)).percent(40),
        Rule::new(Fault::Truncate).percent(40),
        Rule::new(Fault::TooLong).percent(40),
        Rule::new(Fault::Shifted).percent(40),
        Rule::new(Fault::Garbage).percent(20),
        Rule::new(Fault::Hang).percent(3),
        Rule::new(Fault::Late(1500)).percent(3),
    ];
    for rule in faults {
        let (server, folder) = (serve(), TestFolder::new("store-passes"));
        let store = Store::open(&location(&server), &options(&folder)).unwrap();
        server.misbehave([rule.clone()]);
        let tiles: Vec<_> = tiles(store.world()).into_iter().step_by(3).collect();
        let found = read(&store, &tiles);
        let struck = server.take_asked().iter().filter(|asked| asked.fault.is_some()).count();
        println!("{rule:?}: {struck} struck, {:?}", store.stats());
        assert!(struck > 2, "{rule:?} struck {struck} times");
        server.misbehave([]);
        assert_same(&format!("{rule:?}"), &tiles, &found);
        let news = store.errors().take_news();
        assert!((1..=4).contains(&news.len()), "told once for each cause: {news:?}");
        assert!(news.iter().all(|line| line.contains("world.tv/")), "{news:?}");
    }
}

#[test]
fn a_server_that_is_gone_for_a_while_is_waited_for() {
    let (server, folder) = (serve(), TestFolder::new("store-gone"));
    let store = Store::open(&location(&server), &options(&folder)).unwrap();
    let tiles: Vec<_> = tiles(store.world()).into_iter().step_by(5).collect();
    server.set_down(true);
    let found = std::thread::scope(|scope| {
        let reading = scope.spawn(|| read(&store, &tiles));
        while store.errors().counts().values().sum::<u64>() < 12 {
            std::thread::sleep(Duration::from_millis(2));
        }
        server.set_down(false);
        reading.join().unwrap()
    });
    assert_same("gone", &tiles, &found);
}

#[test]
fn a_server_that_restarts_for_seconds_costs_no_tile_and_few_requests() {
    for fault in [Some(Fault::Status(500, None)), Some(Fault::Drop), None] {
        let (server, folder) = (serve(), TestFolder::new("store-restart"));
        // As a flight has it, but for the cache.
        let patient = StoreOptions { cache_dir: Some(folder.join("cache")), ..StoreOptions::default() };
        let store = Store::open(&location(&server), &patient).unwrap();
        let tiles = tiles(store.world());
        match &fault {
            Some(fault) => server.misbehave([Rule::new(fault.clone())]),
            None => server.set_down(true),
        }
        drop(server.take_asked());
        let found = std::thread::scope(|scope| {
            let readings: Vec<_> = (0..4).map(|_| scope.spawn(|| read(&store, &tiles))).collect();
            std::thread::sleep(Duration::from_secs(6));
            let asked = server.take_asked().len();
            let before = store.stats();
            println!("{fault:?}: {asked} requests in 6 s, {before:?}");
            // Two files, the first failures of all readers, then a probe after 0.2, 0.4 ... 2 s for
            // each.
            assert!(asked <= 64 && before.repeated <= 64, "{fault:?}: {asked} requests, {before:?}");
            server.misbehave([]);
            server.set_down(false);
            readings.into_iter().map(|reading| reading.join().unwrap()).next_back().unwrap()
        });
        assert_same("restart", &tiles, &found);
        println!("{fault:?}: {:?}", store.stats());
    }
}

#[test]
fn what_does_not_pass_ends_in_one_error_and_few_requests() {
    for (fault, cause) in [
        (Fault::Status(404, None), Cause::NotFound),
        (Fault::Status(403, None), Cause::Denied),
        (Fault::WebPage, Cause::WebPage),
        (Fault::IgnoreRange, Cause::NoRanges),
        (Fault::RedirectLoop, Cause::Redirects),
        (Fault::Status(418, None), Cause::Refused),
    ] {
        let (server, folder) = (serve(), TestFolder::new("store-final"));
        let store = Store::open(&location(&server), &options(&folder)).unwrap();
        server.misbehave([Rule::new(fault.clone()).of("color.pmtiles")]);
        drop(server.take_asked());
        let node = fine(1);
        for _ in 0..20 {
            let error = block_on(store.payload(Layer::Color, node)).unwrap_err();
            assert_eq!(error.cause(), Some(cause), "{fault:?}: {error}");
            assert!(error.to_string().contains("color.pmtiles"), "{error}");
        }
        // A redirect is followed ten times. The manifest is looked at once: has the database
        // changed?
        let (manifest, others): (Vec<_>, Vec<_>) =
            server.take_asked().into_iter().partition(|asked| asked.path.ends_with("manifest.json"));
        let asked = others.len();
        assert!(manifest.len() <= 1, "{fault:?}: {manifest:?}");
        assert!(asked == 1 || (cause == Cause::Redirects && asked <= 11), "{fault:?}: {asked} requests");
        assert!(block_on(store.payload(Layer::Elevation, node)).is_ok(), "the other archive is well");
        println!("{fault:?}: {:?}", store.errors().take_news());
    }
}

#[test]
fn failures_do_not_multiply_requests() {
    let (server, folder) = (serve(), TestFolder::new("store-storm"));
    let limited = RetryOptions { share: 0.5, burst: 10, ..options(&folder).retries };
    let deadline = Duration::from_secs(2);
    let limited = StoreOptions { retries: limited, deadline, ..options(&folder) };
    let store = Store::open(&location(&server), &limited).unwrap();
    server.misbehave([Rule::new(Fault::Status(500, None))]);
    let tiles: Vec<_> = tiles(store.world()).into_iter().filter(|(layer, _)| *layer == Layer::Color).collect();
    drop(server.take_asked());
    let failed = read(&store, &tiles).iter().filter(|read| read.is_err()).count();
    let asked = server.take_asked().len();
    println!("{failed} tiles failed after {asked} requests");
    assert!(failed > 50 && asked as f64 <= 10.0 + 1.5 * failed as f64 + 10.0, "{asked} requests for {failed} tiles");
    // They rest now: nothing is asked.
    assert_eq!(read(&store, &tiles).iter().filter(|read| read.is_err()).count(), failed);
    assert_eq!(server.take_asked().len(), 0, "what just failed is not asked for again");
}

#[test]
fn a_server_that_asks_for_quiet_gets_it() {
    let (server, folder) = (serve(), TestFolder::new("store-quiet"));
    let store = Store::open(&location(&server), &options(&folder)).unwrap();
    // One answer asks for an hour: no more requests are made, and reads end at once instead of at
    // their deadline.
    server.misbehave([Rule::new(Fault::Status(429, Some(3600)))]);
    let tiles: Vec<_> = tiles(store.world()).into_iter().filter(|(layer, _)| *layer == Layer::Color).collect();
    drop(server.take_asked());
    let found = read(&store, &tiles);
    let throttled = found.iter().flat_map(Result::as_ref).count();
    let errors: Vec<_> = found.into_iter().filter_map(Result::err).collect();
    assert!(errors.iter().all(|error| error.cause() == Some(Cause::Throttled)), "{:?}", errors.first());
    let asked = server.take_asked().len();
    println!("{} throttled, {throttled} had, {asked} requests", errors.len());
    assert!(errors.len() > 50 && asked <= 16, "{asked} requests, at most those that were under way");
}

#[test]
fn a_database_that_changes_under_way_is_told_once_and_one_that_is_touched_goes_on() {
    let folder = TestFolder::new("store-changed");
    let copy = folder.join("world.tv");
    fs::create_dir_all(&copy).unwrap();
    for file in FILES {
        fs::copy(synth_world(1024).database().join(file), copy.join(file)).unwrap();
    }
    let server = FaultServer::serve(folder.path());
    let no_cache = StoreOptions { cache_bytes: 0, ..options(&folder) };
    let store = Store::open(&location(&server), &no_cache).unwrap();
    let tiles: Vec<_> = tiles(store.world()).into_iter().filter(|(layer, _)| *layer == Layer::Color).collect();
    let (first, rest) = tiles.split_at(20);
    assert_same("before", first, &read(&store, first));
    server.set_etag("touched");
    assert_same("touched", first, &read(&store, first));
    let news = store.errors().take_news();
    assert!(news.len() == 1 && news[0].contains("equal one"), "{news:?}");

    let manifest = fs::read_to_string(copy.join("manifest.json")).unwrap();
    fs::write(copy.join("manifest.json"), manifest.replace("\"name\"", "\"Name\"")).unwrap();
    server.set_etag("changed");
    let found = read(&store, rest);
    let error = found.iter().find_map(|read| read.as_ref().err()).unwrap();
    assert!(error.cause() == Some(Cause::Changed) && error.to_string().contains("open it again"), "{error}");
    assert!(found.iter().all(|read| matches!(read, Ok(None)) || read.is_err()), "nothing of the new one is taken");
    assert_eq!(store.errors().take_news().len(), 1);
    drop(server.take_asked());
    let error = block_on(store.payload(Layer::Color, store.world().root())).unwrap_err();
    assert_eq!((error.cause(), server.take_asked().len()), (Some(Cause::Changed), 0), "no more requests");
}

#[test]
fn a_database_that_is_replaced_by_a_smaller_one_is_told_as_changed_on_a_server_and_in_a_folder() {
    let folder = TestFolder::new("store-replaced");
    let copy = folder.join("world.tv");
    fs::create_dir_all(&copy).unwrap();
    let put = |from: &Path, file: &str| {
        fs::copy(from.join(file), copy.join(file)).unwrap();
    };
    let (large, small) = (synth_world(1024).database(), synth_world(256).database());
    FILES.iter().for_each(|file| put(&large, file));
    let server = FaultServer::serve(folder.path());
    let no_cache = StoreOptions { cache_bytes: 0, ..options(&folder) };
    let places = [location(&server), Location::folder(&copy)];
    let stores = places.map(|place| Store::open(&place, &no_cache).unwrap());
    let tiles: Vec<_> = tiles(stores[0].world()).into_iter().filter(|(layer, _)| *layer == Layer::Color).collect();
    FILES.iter().for_each(|file| put(&small, file));
    // A server without marks of content: 416 is all that it says.
    server.misbehave([Rule::new(Fault::Status(416, None)).of("color.pmtiles")]);
    for store in &stores {
        let found = read(store, &tiles);
        let changed = found.iter().filter_map(|read| read.as_ref().err()).filter(|e| e.cause() == Some(Cause::Changed));
        assert!(changed.count() > 20, "{:?}", store.errors().folded());
        let news = store.errors().take_news();
        assert!(news.iter().any(|line| line.contains("open it again") && line.contains("has changed")), "{news:?}");
    }
}

#[test]
fn reads_that_nobody_waits_for_are_cancelled() {
    let (server, folder) = (serve(), TestFolder::new("store-cancel"));
    let store = Store::open(&location(&server), &options(&folder)).unwrap();
    server.misbehave([Rule::new(Fault::Hang)]);
    let mut reads: Vec<_> = (0..8).map(|m| Box::pin(store.payload(Layer::Color, fine(m)))).collect();
    let mut context = std::task::Context::from_waker(std::task::Waker::noop());
    assert!(reads.iter_mut().all(|read| read.as_mut().poll(&mut context).is_pending()));
    let until = |what: &str, is_so: &dyn Fn() -> bool| {
        for _ in 0..5000 {
            if is_so() {
                return;
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        panic!("{what}: {:?}", store.stats());
    };
    until("they are asked", &|| store.stats().under_way == 8);
    drop(reads);
    until("they are cancelled", &|| store.stats().under_way == 0);
    // Cancelled reads are not failures: the tiles may be requested at once.
    server.misbehave([]);
    assert!(block_on(store.payload(Layer::Color, fine(1))).is_ok());
}

#[test]
fn the_same_tile_is_read_once_for_many() {
    let (server, folder) = (serve(), TestFolder::new("store-single"));
    let store = Store::open(&location(&server), &StoreOptions { cache_bytes: 0, ..options(&folder) }).unwrap();
    server.set_link(Link { latency: Duration::from_millis(200), bits_per_s: None });
    drop(server.take_asked());
    let tile = (Layer::Color, fine(1));
    let found = read(&store, &[tile; 8]);
    assert!(found.iter().all(|read| matches!(read, Ok(Some(_)))));
    assert_eq!(server.take_asked().len(), 1);
}

#[test]
fn what_cannot_be_opened_is_told_in_a_sentence() {
    let folder = TestFolder::new("store-open");
    let server = serve();
    let opened = |rules: Vec<Rule>, path: &str| -> StoreError {
        server.misbehave(rules);
        let quick = RetryOptions { most: 2, ..options(&folder).retries };
        let options = StoreOptions { retries: quick, cache_dir: Some(folder.join(path)), ..options(&folder) };
        Store::open(&Location::parse(&server.url(path)).unwrap(), &options).unwrap_err()
    };
    let all = |fault| vec![Rule::new(fault)];
    for (error, words) in [
        (opened(vec![], "nothing.tv"), "no finished terrain database"),
        (opened(all(Fault::WebPage), "world.tv"), "web page"),
        (opened(all(Fault::Garbage), "world.tv"), "manifest"),
        (opened(all(Fault::RedirectLoop), "world.tv"), "redirects without end"),
        (opened(all(Fault::IgnoreRange), "world.tv"), "does not honour byte ranges"),
        (opened(all(Fault::Status(401, None)), "world.tv"), "gives no access"),
        (opened(all(Fault::Status(500, None)), "world.tv"), "the server failed"),
        (opened(all(Fault::Status(429, Some(3600))), "world.tv"), "fewer requests"),
    ] {
        println!("{error}");
        assert!(error.to_string().contains(words), "{words}: {error}");
        assert!(error.is_bad_input(), "{error}");
        assert_eq!(error.to_string().lines().count(), 1, "{error}");
    }
    let refused = Store::open(&Location::parse("http://127.0.0.1:9/w.tv").unwrap(), &options(&folder)).unwrap_err();
    assert!(refused.to_string().contains("no connection") && refused.is_bad_input(), "{refused}");
}

#[test]
fn errors_of_tiles_keep_their_kinds() {
    let node = NodeId::new(0, 0, 0).unwrap();
    let absent = FetchError::Absent.into_tile_error(Layer::Color, node);
    assert!(matches!(absent, TileError::Missing { .. }), "{absent}");
    let (server, folder) = (serve(), TestFolder::new("store-codes"));
    let store = Store::open(&location(&server), &options(&folder)).unwrap();
    server.misbehave([Rule::new(Fault::Garbage)]);
    let damaged = block_on(store.payload(Layer::Color, fine(1))).unwrap_err();
    assert!(matches!(damaged, FetchError::Damaged { .. }), "{damaged}");
    let damaged = damaged.into_tile_error(Layer::Color, node);
    assert!(matches!(damaged, TileError::Corrupt { .. }), "{damaged}");
    server.misbehave([Rule::new(Fault::Status(404, None))]);
    let mut out = vec![0; color_tile_bytes(store.world())];
    let error = store.read_color(fine(2), &mut out, &mut TileScratch::default()).unwrap_err();
    assert!(matches!(error, TileError::Read { .. }) && error.to_string().contains("no such file"), "{error}");
}

#[test]
fn info_tells_where_a_world_lies_and_where_it_is_highest() {
    let database = synth_world(1024).database();
    let finished = Terravision::verb("info").arg(&database).arg("--json").succeed();
    let told: serde_json::Value = serde_json::from_str(&finished.stdout_text()).unwrap();
    let numbers = |value: &serde_json::Value| -> Vec<f64> {
        value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
    };
    let (local, mut scratch) = (local(), TileScratch::default());
    let origin = local.world().fields().origin;
    for (name, side) in [("highest", 1), ("lowest", 0)] {
        let place = numbers(&told[name]["place"]);
        let [x, y] = [place[0] - origin[0], place[1] - origin[1]];
        let ground = terravision_common::ground::ground_height(&local, local.world(), x, y, &mut scratch).unwrap();
        assert_eq!(told[name]["height_m"].as_f64(), ground);
        let expected = local.manifest().fields().elevation.range_m[side];
        assert!((ground.unwrap() - expected).abs() < 0.01, "{name}: {ground:?}, expected {expected}");
    }
    let ([w, s, e, n], at) =
        (<[f64; 4]>::try_from(numbers(&told["bounds_lon_lat"])).unwrap(), numbers(&told["highest"]["lon_lat"]));
    assert!(w <= at[0] && at[0] <= e && s <= at[1] && at[1] <= n && e - w < 0.2 && n - s < 0.2, "{told}");
    let text = Terravision::verb("info").arg(&database).succeed().stdout_text();
    assert!(text.contains("\nhighest ") && text.contains("\non the body ") && text.contains(" MiB"), "{text}");
}
