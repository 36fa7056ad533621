//! `--metrics`: what a scrape says during a flight is what the report says after it.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use terravision_common::shm::SharedFrame;
use terravision_testkit::fault_server::{Fault, FaultServer, Rule};
use terravision_tests::flight::Pose;
use terravision_tests::folder::TestFolder;
use terravision_tests::live::{end, reader, record, sender, shared_name, step};
use terravision_tests::process::{Running, Terravision, loopback_port};
use terravision_tests::shot::read_report;
use terravision_tests::worlds::synth_world;

const FRAMES: u64 = 4;

/// Asks once, and reads the text format: value by name and labels. Every line has to be one of the
/// format.
fn scrape(port: u16) -> BTreeMap<String, f64> {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    stream.write_all(b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
    let mut text = String::new();
    stream.read_to_string(&mut text).unwrap();
    let (head, body) = text.split_once("\r\n\r\n").unwrap();
    assert!(head.starts_with("HTTP/1.1 200 OK") && head.contains("text/plain; version=0.0.4"), "{head}");
    let (mut values, mut kinds) = (BTreeMap::new(), BTreeMap::new());
    for line in body.lines() {
        if let Some(kind) = line.strip_prefix("# TYPE ") {
            let (name, kind) = kind.split_once(' ').unwrap();
            assert!(["counter", "gauge", "histogram"].contains(&kind), "{line}");
            assert!(kinds.insert(name.to_owned(), kind.to_owned()).is_none(), "{name} comes twice");
        } else if !line.starts_with("# HELP ") {
            let (series, value) = line.rsplit_once(' ').unwrap();
            let name = series.split('{').next().unwrap();
            let is_known = |name: &str| kinds.contains_key(name);
            let of_histogram =
                ["_bucket", "_sum", "_count"].iter().filter_map(|end| name.strip_suffix(end)).any(is_known);
            assert!(name.starts_with("terravision_") && (is_known(name) || of_histogram), "{line}");
            assert!(values.insert(series.to_owned(), value.parse().unwrap()).is_none(), "{series} comes twice");
        }
    }
    values
}

/// Metrics of a flight whose frames are all drawn, once their counters no longer change: events go
/// by the launcher, and the prefetcher tells in cycles.
fn settled(flight: &mut Running, port: u16) -> BTreeMap<String, f64> {
    let counters = |values: &BTreeMap<String, f64>| -> Vec<(String, f64)> {
        values.iter().filter(|(name, _)| name.contains("_total")).map(|(name, v)| (name.clone(), *v)).collect()
    };
    let mut before: BTreeMap<String, f64> = BTreeMap::new();
    flight.until("metrics of all frames that no longer change", |_| {
        std::thread::sleep(std::time::Duration::from_millis(300));
        let metrics = scrape(port);
        for (name, value) in counters(&before) {
            assert!(metrics[&name] >= value, "{name} went back");
        }
        let has_all = |name: &str| metrics[name] == FRAMES as f64;
        let is_done = has_all("terravision_frames_written_total") && has_all("terravision_frame_seconds_count");
        let is_same = counters(&before) == counters(&metrics);
        before = metrics;
        (is_done && is_same).then(|| before.clone())
    })
}

/// What a report says under other names.
fn assert_like_report(metrics: &BTreeMap<String, f64>, report: &serde_json::Value) {
    let told = |path: &[&str]| {
        let value = path.iter().fold(report, |value, key| &value[*key]);
        value.as_f64().unwrap_or_else(|| panic!("{path:?}: {value}"))
    };
    for (name, path) in [
        ("frames_written_total", &["frames"][..]),
        ("tiles_wanted_total", &["tiles", "wanted"]),
        ("tiles_loaded_total", &["tiles", "loaded"]),
        ("tiles_evicted_total", &["tiles", "evicted"]),
        ("tiles_uploaded_total", &["tiles", "uploaded"]),
        ("tiles_requested_total", &["prefetch", "requested"]),
        ("tiles_cancelled_total", &["prefetch", "cancelled"]),
        ("tile_bytes_total", &["prefetch", "bytes"]),
        ("prefetch_window", &["prefetch", "window", "last"]),
        ("network_requests_total", &["network", "requests"]),
        ("network_repeated_total", &["network", "repeated"]),
        ("network_bytes_total", &["network", "bytes"]),
        ("cache_hits_total", &["network", "cache", "hits"]),
        ("cache_misses_total", &["network", "cache", "misses"]),
        ("events_dropped_total", &["events_dropped"]),
    ] {
        assert_eq!(metrics[&format!("terravision_{name}")], told(path), "{name}");
    }
}

#[test]
fn a_scrape_during_a_flight_says_what_the_report_says_after_it() {
    let server = FaultServer::serve(synth_world(1024).database().parent().unwrap());
    // After what every flight begins with.
    server.misbehave([Rule::new(Fault::Status(503, None)).of("color.pmtiles").after(12).times(3)]);
    let (folder, name) = (TestFolder::new("metrics"), shared_name("metrics"));
    let mut flight = Terravision::verb("fly")
        .arg(server.url("world.tv"))
        .args([
            "--camera",
            &format!("shm:{name}"),
            "--size",
            "320x180",
            "--facet-px",
            "10",
            "-o",
            &format!("shared:{name}"),
            "--metrics",
            "0",
        ])
        .arg("--report")
        .arg(folder.join("report.json"))
        .arg("--cache")
        .arg(folder.join("cache"))
        .spawn();
    let poses = sender(&mut flight, &name);
    let mut ring = reader(&mut flight, &name);
    let port = flight.until("the port", |flight| loopback_port(flight.pid(), "tcp"));
    // Nonsense and slow clients do not disturb the flight.
    let mut nonsense = TcpStream::connect(("127.0.0.1", port)).unwrap();
    nonsense.write_all(&[0xff; 100]).unwrap();
    let mut shared = SharedFrame::default();
    for k in 0..FRAMES {
        let pose = Pose::new(synth_world(1024).above(0.35 + 0.05 * k as f64, 0.4, 500.0), 25.0 * k as f64, -20.0);
        step(&mut flight, &poses, &mut ring, &mut shared, &record(&pose, k as f64));
    }
    let metrics = settled(&mut flight, port);
    end(&poses);
    flight.wait().assert_code(0);
    let report = read_report(&folder);
    assert_like_report(&metrics, &report);
    assert_eq!(metrics["terravision_failures_total{cause=\"server\"}"], 3.0);
    assert_eq!(report["network"]["failures"][0]["cause"], "server", "{report}");
    assert_eq!(metrics["terravision_failures_total{cause=\"timeout\"}"], 0.0);
    let [wanted, resident] = ["wanted", "resident"].map(|what| metrics[&format!("terravision_frame_tiles_{what}")]);
    assert!(wanted > 10.0 && resident == wanted, "in exact mode everything is there: {resident} of {wanted}");
    assert_eq!(metrics["terravision_tiles_in_flight"], 0.0);
    for pool in ["elevation", "color"] {
        let used = metrics[&format!("terravision_pool_slots_used{{pool=\"{pool}\"}}")];
        assert!(used > 5.0 && used <= metrics[&format!("terravision_pool_slots{{pool=\"{pool}\"}}")], "{used}");
    }
    assert_eq!((metrics["terravision_facet_pixels"], metrics["terravision_texel_pixels"]), (10.0, 1.0));
    assert!(metrics["terravision_round_trip_seconds"] > 0.0);
    for stage in ["generator", "preparer", "renderer", "prefetcher"] {
        assert_eq!(metrics[&format!("terravision_stage_restarts_total{{stage=\"{stage}\"}}")], 0.0);
    }
    assert_eq!(metrics["terravision_frame_seconds_bucket{le=\"+Inf\"}"], FRAMES as f64);
    assert!(metrics["terravision_frame_seconds_sum"] > 0.0);
    // The port is free again.
    TcpListener::bind(("127.0.0.1", port)).unwrap();
}

#[test]
fn an_address_that_cannot_be_listened_at_is_told() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    for (address, words) in [(address.as_str(), "cannot listen there"), ("nowhere", "a port of this machine")] {
        let ended = Terravision::verb("fly")
            .arg(synth_world(1024).database())
            .args(["-o", "/dev/null", "--metrics", address])
            .run();
        ended.assert_told(2);
        assert!(ended.stderr.contains(words), "{}", ended.stderr);
    }
}
