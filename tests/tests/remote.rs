//! Whole flights over a database on a server: the same bytes as from its folder, through a lossy
//! link, from the cache alone; and a sentence with the right exit code when there is no way to it.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use std::collections::BTreeMap;
use std::fs;
use std::io::{Read, Write};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use terravision_common::shm::SharedFrame;
use terravision_testkit::fault_server::{Fault, FaultServer, Rule};
use terravision_tests::flight::{Pose, write_path};
use terravision_tests::folder::TestFolder;
use terravision_tests::live::{end, reader, record, sender, shared_name, step};
use terravision_tests::process::{Finished, Terravision};
use terravision_tests::shot::{VFOV_DEG, oblique_poses, read_report};
use terravision_tests::worlds::synth_world;

const FRAMES: u64 = 6;

fn serve() -> FaultServer {
    FaultServer::serve(synth_world(1024).database().parent().unwrap())
}

/// A flight that turns and goes forward, low enough for the finest tiles.
fn fly(world: &str, folder: &TestFolder, name: &str, more: &[&str]) -> Finished {
    let from = synth_world(1024);
    let poses: Vec<Pose> = (0..FRAMES)
        .map(|k| {
            let t = k as f64 / FRAMES as f64;
            Pose::new(from.above(0.3 + 0.3 * t, 0.3 + 0.2 * t, 250.0 + 300.0 * t), 60.0 + 90.0 * t, -20.0)
        })
        .collect();
    write_path(&folder.join("path.json"), &poses, [640, 360], VFOV_DEG);
    Terravision::verb("fly")
        .arg(world)
        .arg("--path")
        .arg(folder.join("path.json"))
        .arg("-o")
        .arg(folder.join(format!("{name}/")))
        .arg("--report")
        .arg(folder.join(format!("{name}.json")))
        .arg("--cache")
        .arg(folder.join("cache"))
        .args(more)
        .run()
}

fn report_of(folder: &TestFolder, name: &str) -> serde_json::Value {
    serde_json::from_slice(&fs::read(folder.join(format!("{name}.json"))).unwrap()).unwrap()
}

fn still(world: &str, folder: &TestFolder, more: &[&str]) -> Finished {
    Terravision::verb("still")
        .arg("--quality=default")
        .arg(world)
        .args(oblique_poses(&synth_world(1024))[0].1.arguments())
        .args(["--size=320x180".to_owned(), format!("--vfov={VFOV_DEG}"), "-o".to_owned()])
        .arg(folder.join("a.png"))
        .arg("--report")
        .arg(folder.join("report.json"))
        .arg("--cache")
        .arg(folder.join("cache"))
        .args(more)
        .run()
}

/// Fills the cache with what every flight begins with: a picture of the sky. What is asked for
/// after that, and in which order, does not depend on chance.
fn look_at_the_sky(url: &str, folder: &TestFolder) {
    let from = synth_world(1024).above(0.5, 0.5, 500.0);
    let sky = Pose::new(from, 0.0, 90.0);
    Terravision::verb("still")
        .arg("--quality=default")
        .arg(url)
        .args(sky.arguments())
        .args(["--size=64x36", "-o"])
        .arg(folder.join("sky.png"))
        .arg("--cache")
        .arg(folder.join("cache"))
        .succeed();
}

fn pictures(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    entries.map(|path| (path.file_name().unwrap().to_string_lossy().into_owned(), fs::read(&path).unwrap())).collect()
}

fn assert_same(what: &str, folder: &TestFolder, name: &str) {
    let (expected, found) = (pictures(&folder.join("local")), pictures(&folder.join(name)));
    assert_eq!(expected.len() as u64, FRAMES);
    assert!(expected == found, "{what}: the pictures differ from those of the folder");
    assert_eq!(report_of(folder, name)["settled"], true, "{what}");
}

fn local(folder: &TestFolder) {
    let finished = fly(&synth_world(1024).database().display().to_string(), folder, "local", &[]);
    finished.assert_code(0);
    finished.assert_no_warning();
}

#[test]
fn a_flight_over_a_server_gives_the_bytes_of_the_folder_and_again_from_its_cache() {
    let (server, folder) = (serve(), TestFolder::new("remote-same"));
    local(&folder);
    let url = server.url("world.tv");
    let finished = fly(&url, &folder, "first", &[]);
    finished.assert_code(0);
    finished.assert_no_warning();
    assert_same("first", &folder, "first");
    let whole: u64 = ["elevation.pmtiles", "color.pmtiles", "nodes.tvn"]
        .iter()
        .map(|file| fs::metadata(synth_world(1024).database().join(file)).unwrap().len())
        .sum();
    println!("{:?}, {} of {whole} bytes", server.asked_by_path(), server.bytes());
    assert_eq!(server.asked_by_path()["world.tv/manifest.json"], 1, "the launcher alone asks for it");
    assert!(server.bytes() < whole, "what no frame wants is not read");
    let report = report_of(&folder, "first");
    let network = &report["network"];
    // The launcher has read the index, and both have looked at what archives begin with.
    let all: usize = server.asked_by_path().values().sum();
    let requests = network["requests"].as_u64().unwrap();
    assert!(requests > 10 && requests < all as u64, "{requests} of {all}: {network}");
    assert!(network["bytes"].as_u64().unwrap() < server.bytes() && network["repeated"] == 0, "{network}");
    assert!(network["failures"].as_array().unwrap().is_empty());
    let round_trip = &report["prefetch"]["round_trip_ms"];
    assert!(round_trip["p50"].as_f64() > Some(0.0) && round_trip["p50"].as_f64() <= round_trip["worst"].as_f64());
    let window = &report["prefetch"]["window"];
    assert!(window["least"].as_u64() >= Some(8) && window["most"].as_u64() <= Some(512), "{window}");
    assert!(finished.stderr.contains("requests to the server"), "{}", finished.stderr);

    drop(server.take_asked());
    fly(&url, &folder, "second", &[]).assert_code(0);
    assert_same("second", &folder, "second");
    let report = report_of(&folder, "second");
    let cache = &report["network"]["cache"];
    assert_eq!((&report["network"]["bytes"], &cache["misses"]), (&0.into(), &0.into()), "{report}");
    assert!(cache["bytes"].as_u64() > Some(10_000) && cache["hits"].as_u64() > Some(10), "{cache}");
    assert_eq!(server.take_asked().len(), 1, "the manifest");

    server.set_down(true);
    let finished = fly(&url, &folder, "offline", &["--offline"]);
    finished.assert_code(0);
    assert_same("offline", &folder, "offline");
    // Elsewhere than where it has been, there is nothing to fly over.
    let finished = Terravision::verb("info").args([server.url("other.tv").as_str(), "--offline", "--cache"]);
    let finished = finished.arg(folder.join("cache")).run();
    finished.assert_told(2);
    assert!(finished.stderr.contains("disk cache"), "{}", finished.stderr);
}

#[test]
fn what_is_not_in_the_cache_is_told_as_such() {
    let (server, folder) = (serve(), TestFolder::new("remote-gaps"));
    let url = server.url("world.tv");
    look_at_the_sky(&url, &folder);
    server.set_down(true);
    let finished = still(&url, &folder, &["--offline"]);
    finished.assert_told(3);
    let said = finished.stderr.lines().last().unwrap();
    assert!(said.contains("could not be read") && said.contains("not in the cache"), "{said}");
    assert!(!finished.stderr.contains("read error"), "{}", finished.stderr);
    let report: serde_json::Value = serde_json::from_slice(&fs::read(folder.join("report.json")).unwrap()).unwrap();
    let causes = report["tiles"]["unavailable"].as_array().unwrap().iter().map(|tile| tile["cause"].as_str().unwrap());
    assert!(causes.clone().count() > 0 && causes.clone().all(|cause| cause == "not in the cache"), "{report}");
}

#[test]
fn two_flights_share_a_cache_and_a_lossy_link_and_give_the_same_bytes() {
    let (server, folder) = (serve(), TestFolder::new("remote-lossy"));
    local(&folder);
    server.misbehave([
        // A fifth of all requests: that one fails as often in a row as it is asked again is out of
        // the question.
        Rule::new(Fault::Drop).percent(12),
        Rule::new(Fault::Garbage).percent(3),
        Rule::new(Fault::Truncate).percent(3),
        Rule::new(Fault::Status(500, None)).percent(2),
        Rule::new(Fault::Status(429, Some(1))).after(20).times(1),
        Rule::new(Fault::Late(2000)).percent(1),
    ]);
    let url = server.url("world.tv");
    let more = ["--timeout", "20"];
    let [a, b] = std::thread::scope(|scope| {
        let (url, folder, more) = (&url, &folder, &more);
        ["a", "b"].map(|name| scope.spawn(move || fly(url, folder, name, more))).map(|run| run.join().unwrap())
    });
    let struck = server.take_asked().iter().filter(|asked| asked.fault.is_some()).count();
    println!("{struck} requests failed; {}", a.stderr);
    let mut failed = 0;
    for (name, finished) in [("a", a), ("b", b)] {
        finished.assert_code(0);
        assert_same(name, &folder, name);
        let warnings = finished.stderr.lines().filter(|line| line.contains("world.tv")).count();
        assert!((1..=20).contains(&warnings), "each cause is told once:\n{}", finished.stderr);
        let report = report_of(&folder, name);
        let failures = report["network"]["failures"].as_array().unwrap();
        let count: u64 = failures.iter().map(|failure| failure["count"].as_u64().unwrap()).sum();
        failed += count;
        assert!(failures.iter().all(|failure| !failure["told"].as_array().unwrap().is_empty()), "{report}");
        assert!(count == 0 || report["network"]["repeated"].as_u64() > Some(0), "{report}");
    }
    assert!(struck > 5 && failed > 0 && failed <= struck as u64 + 20, "{failed} of {struck}");
}

#[test]
fn tiles_that_cannot_be_had_cost_resolution_and_nothing_else() {
    let (server, folder) = (serve(), TestFolder::new("remote-missing"));
    look_at_the_sky(&server.url("world.tv"), &folder);
    server.misbehave([Rule::new(Fault::Status(404, None)).of("color.pmtiles")]);
    let finished = still(&server.url("world.tv"), &folder, &["--timeout", "2"]);
    finished.assert_told(3);
    assert!(finished.stderr.contains("no such file"), "{}", finished.stderr);
    let report = read_report(&folder);
    assert!(!report["tiles"]["unavailable"].as_array().unwrap().is_empty() && report["settled"] == false, "{report}");
    assert!(folder.join("a.png").exists());
}

#[test]
fn a_server_that_dies_under_way_ends_the_flight_in_time() {
    let (server, folder) = (serve(), TestFolder::new("remote-dies"));
    look_at_the_sky(&server.url("world.tv"), &folder);
    server.misbehave([Rule::new(Fault::Drop).of("color.pmtiles")]);
    let finished = still(&server.url("world.tv"), &folder, &["--timeout", "0.5"]);
    finished.assert_told(3);
    assert!(finished.stderr.contains("color.pmtiles"), "{}", finished.stderr);
}

/// Flies while an archive is away for seconds from the start; the index is in the cache.
fn fly_through_an_outage(fault: &Fault, folder: &TestFolder, name: &str, more: &[&str]) -> Finished {
    let server = serve();
    let url = server.url("world.tv");
    Terravision::verb("info").args([url.as_str(), "--cache"]).arg(folder.join("cache")).succeed();
    server.misbehave([Rule::new(fault.clone()).of("color.pmtiles")]);
    drop(server.take_asked());
    let finished = std::thread::scope(|scope| {
        let flight = scope.spawn(|| fly(&url, folder, name, more));
        std::thread::sleep(Duration::from_secs(4));
        let asked = server.take_asked().iter().filter(|asked| asked.path.ends_with("color.pmtiles")).count();
        // Passing failures: eight in a row, those under way, then a probe now and then. Refused
        // ones: once each, the top levels again.
        assert!(asked < 150, "{fault:?}: {asked} requests");
        server.misbehave([]);
        flight.join().unwrap()
    });
    println!("{fault:?} {more:?}: {}", finished.stderr);
    finished
}

#[test]
fn a_server_that_is_away_at_the_start_is_waited_for_and_told() {
    let folder = TestFolder::new("remote-outage");
    local(&folder);
    let finished = fly_through_an_outage(&Fault::Status(500, None), &folder, "exact", &[]);
    finished.assert_code(0);
    assert_same("outage", &folder, "exact");
    assert!(finished.stderr.contains("the server failed (500 Internal Server Error)"), "{}", finished.stderr);
    let realtime = ["--mode", "realtime", "--fps", "5", "--timeout", "1"];
    for (fault, may_lose) in [(Fault::Status(500, None), false), (Fault::Drop, false), (Fault::WebPage, true)] {
        let folder = TestFolder::new("remote-outage");
        let finished = fly_through_an_outage(&fault, &folder, "realtime", &realtime);
        // What is refused rests for minutes, but for what no picture can be without.
        assert!(finished.code() == Some(0) || (may_lose && finished.code() == Some(3)), "{}", finished.stderr);
        let words = "; the flight begins when the coarsest tiles are there";
        assert_eq!(finished.stderr.matches(words).count(), 1, "{fault:?}: {}", finished.stderr);
    }
}

#[test]
fn what_goes_wrong_under_way_is_told_once_and_the_flight_goes_on() {
    for (fault, words) in [
        (Fault::WebPage, "web page in place of the file"),
        (Fault::RedirectLoop, "redirects without end"),
        (Fault::Status(401, None), "gives no access"),
        (Fault::IgnoreRange, "byte ranges"),
    ] {
        let (server, folder) = (serve(), TestFolder::new("remote-under-way"));
        look_at_the_sky(&server.url("world.tv"), &folder);
        server.misbehave([Rule::new(fault.clone()).of("color.pmtiles")]);
        let finished = still(&server.url("world.tv"), &folder, &["--timeout", "2"]);
        println!("{fault:?}: {}", finished.stderr);
        finished.assert_told(3);
        // When it happens first, and with its count at the end.
        assert!((1..=2).contains(&finished.stderr.matches(words).count()), "{fault:?}: {}", finished.stderr);
        let report = read_report(&folder);
        let mut failures = report["network"]["failures"].as_array().unwrap().iter();
        assert!(failures.any(|failure| failure["told"].to_string().contains(words)), "{fault:?}: {report}");
        assert!(folder.join("a.png").exists());
    }
}

#[test]
fn a_database_that_is_made_anew_under_way_is_not_mixed_with_the_old_one() {
    let (folder, name) = (TestFolder::new("remote-changes"), shared_name("remote-changes"));
    let copy = folder.join("world.tv");
    fs::create_dir(&copy).unwrap();
    for file in fs::read_dir(synth_world(1024).database()).unwrap().map(Result::unwrap) {
        fs::copy(file.path(), copy.join(file.file_name())).unwrap();
    }
    let server = FaultServer::serve(folder.path());
    let mut flight = Terravision::verb("fly")
        .arg(server.url("world.tv"))
        .args(["--camera", &format!("shm:{name}"), "--size", "320x180", "-o", &format!("shared:{name}"), "--cache"])
        .arg(folder.join("cache"))
        .spawn();
    let (poses, mut ring) = (sender(&mut flight, &name), reader(&mut flight, &name));
    let mut shared = SharedFrame::default();
    let mut step_to = |flight: &mut _, k: u64, time_s: f64| {
        let pose = Pose::new(synth_world(1024).above(0.2 + 0.3 * k as f64, 0.4, 300.0), 80.0 * k as f64, -20.0);
        step(flight, &poses, &mut ring, &mut shared, &record(&pose, time_s)).is_settled
    };
    assert!(step_to(&mut flight, 0, 1.0));
    let manifest = fs::read_to_string(copy.join("manifest.json")).unwrap();
    fs::write(copy.join("manifest.json"), manifest.replace("\"name\": \"", "\"name\": \"another ")).unwrap();
    server.set_etag("2");
    assert!(!step_to(&mut flight, 1, 2.0), "nothing of the new one is drawn");
    assert!(step_to(&mut flight, 0, 3.0), "what is there stays there");
    end(&poses);
    let finished = flight.wait();
    finished.assert_told(3);
    let told = finished.stderr.matches("was replaced while it was open").count();
    assert!((1..=2).contains(&told), "{}", finished.stderr);
}

#[test]
fn no_way_to_a_database_is_told_in_one_sentence() {
    let (server, folder) = (serve(), TestFolder::new("remote-told"));
    let url = server.url("world.tv");
    let all = |fault| vec![Rule::new(fault)];
    let cases: Vec<(Vec<Rule>, &str, &str)> = vec![
        (vec![], "ftp://127.0.0.1/world.tv", "the scheme of a database is ftp://"),
        (vec![], "http://127.0.0.1:9/world.tv", "no connection"),
        (vec![], "http://nowhere.invalid/world.tv", "nowhere.invalid"),
        (vec![], "s3://bucket/world.tv", "there are no credentials"),
        (all(Fault::Status(403, None)), &url, "expired credentials"),
        (all(Fault::RedirectLoop), &url, "redirects without end"),
        (all(Fault::WebPage), &url, "web page"),
        (all(Fault::IgnoreRange), &url, "byte ranges"),
        (all(Fault::Hang), &url, "no complete answer"),
        (vec![Rule::new(Fault::Status(404, None)).of("nodes.tvn")], &url, "no such file"),
    ];
    for (rules, world, words) in cases {
        server.misbehave(rules);
        let finished = Terravision::verb("info")
            .args([world, "--timeout", "1", "--cache"])
            .arg(folder.join("cache"))
            .env("AWS_METADATA_ENDPOINT", "http://127.0.0.1:9")
            .env("AWS_ACCESS_KEY_ID", "")
            .env("AWS_SECRET_ACCESS_KEY", "")
            .env("AWS_WEB_IDENTITY_TOKEN_FILE", "")
            .deadline(Duration::from_secs(60))
            .run();
        println!("{world}: {:?} {}", finished.code(), finished.stderr.trim());
        finished.assert_told(2);
        assert!(finished.stderr.contains(words), "{words}: {}", finished.stderr);
        assert_eq!(finished.stderr.trim_end().lines().count(), 1, "{}", finished.stderr);
    }
}

/// A server that speaks TLS with a certificate of `data/` and has nothing. Its URL, and the
/// certificate's file.
fn serve_tls(name: &str) -> (String, PathBuf) {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("data");
    let certificate = data.join(format!("{name}.pem"));
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("https://localhost:{}/world.tv", listener.local_addr().unwrap().port());
    let chain = vec![CertificateDer::from_pem_file(&certificate).unwrap()];
    let key = PrivateKeyDer::from_pem_file(data.join(format!("{name}.key"))).unwrap();
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = rustls::ServerConfig::builder_with_provider(provider).with_safe_default_protocol_versions().unwrap();
    let config = Arc::new(config.with_no_client_auth().with_single_cert(chain, key).unwrap());
    // Requests that get through are answered with 404.
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let session = rustls::ServerConnection::new(Arc::clone(&config)).unwrap();
            let mut tls = rustls::StreamOwned::new(session, stream);
            if matches!(tls.read(&mut [0; 4096]), Ok(1..)) {
                drop(tls.write_all(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"));
                tls.conn.send_close_notify();
                drop(tls.flush());
            }
        }
    });
    (url, certificate)
}

#[test]
fn a_certificate_of_its_own_is_told_and_trusted_when_it_is_named() {
    let (url, certificate) = serve_tls("self-signed");
    let folder = TestFolder::new("remote-tls");
    let info =
        || Terravision::verb("info").args([url.as_str(), "--timeout", "10", "--cache"]).arg(folder.join("cache"));
    let finished = info().run();
    finished.assert_told(2);
    assert!(finished.stderr.contains("certificate is not trusted"), "{}", finished.stderr);
    let finished = info().env("SSL_CERT_FILE", &certificate).run();
    finished.assert_told(2);
    assert!(finished.stderr.contains("no finished terrain database"), "{}", finished.stderr);
}

#[test]
fn a_certificate_of_an_authority_is_told_with_what_to_do() {
    // As openssl req -x509 makes them unless told otherwise; to be named as trusted does not help.
    let (url, certificate) = serve_tls("self-signed-authority");
    let folder = TestFolder::new("remote-authority");
    let info = Terravision::verb("info").args([url.as_str(), "--timeout", "10", "--cache"]).arg(folder.join("cache"));
    let finished = info.env("SSL_CERT_FILE", &certificate).run();
    finished.assert_told(2);
    for words in ["certificate is not trusted", "CA:TRUE", "-addext basicConstraints=critical,CA:FALSE"] {
        assert!(finished.stderr.contains(words), "{}", finished.stderr);
    }
}
