//! What others send and leave lying about: no panic, no hang, no memory beyond its bounds, no
//! secret that goes astray, no text that steers a terminal.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

mod served;

use served::{FILES, block_on, local, location, options, serve, tiles};
use std::fs;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use terravision_common::database::{ManifestFields, NodeRanges};
use terravision_common::world::World;
use terravision_store::{FetchError, Location, Store};
use terravision_testkit::fault_server::FaultServer;
use terravision_tests::folder::TestFolder;
use terravision_tests::process::{Finished, Terravision, peak_kib};
use terravision_tests::worlds::synth_world;

/// Memory that `info` over a server may take, KiB: programs and libraries take a tenth of it.
const INFO_KIB: u64 = 160 << 10;

/// A server that answers every connection with `answer`, given the head of the request. Heads are
/// kept.
struct RawServer {
    address: String,
    heads: Arc<Mutex<Vec<String>>>,
}

impl RawServer {
    fn new(answer: impl Fn(&str, &mut TcpStream) -> std::io::Result<()> + Send + Sync + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let heads = Arc::new(Mutex::new(Vec::new()));
        let (kept, answer) = (Arc::clone(&heads), Arc::new(answer));
        // Ends with the test's process.
        std::thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let (kept, answer) = (Arc::clone(&kept), Arc::clone(&answer));
                std::thread::spawn(move || {
                    let mut stream = stream;
                    stream.set_write_timeout(Some(Duration::from_secs(20))).unwrap();
                    let mut head = Vec::new();
                    while !head.ends_with(b"\r\n\r\n") {
                        let mut byte = [0];
                        if !matches!(stream.read(&mut byte), Ok(1)) {
                            return;
                        }
                        head.push(byte[0]);
                    }
                    let head = String::from_utf8_lossy(&head).to_lowercase();
                    kept.lock().unwrap().push(head.clone());
                    // A client that has enough closes the connection.
                    drop(answer(&head, &mut stream));
                });
            }
        });
        Self { address, heads }
    }

    fn heads(&self) -> Vec<String> {
        self.heads.lock().unwrap().clone()
    }
}

fn info(database: &str) -> Terravision {
    Terravision::verb("info").arg(database).args(["--timeout", "2"])
}

/// Runs to its end; the most memory that it had, KiB.
fn measured(command: Terravision) -> (Finished, u64) {
    let mut running = command.spawn();
    let mut peak = 0;
    while !running.has_ended() {
        peak = peak.max(peak_kib(running.pid()).unwrap_or(0));
        std::thread::sleep(Duration::from_millis(2));
    }
    (running.wait(), peak)
}

fn one_sentence(finished: &Finished, words: &str) {
    finished.assert_told(2);
    let lines: Vec<&str> = finished.stderr.lines().collect();
    assert!(
        lines.len() == 1 && lines[0].starts_with("terravision: ") && lines[0].contains(words),
        "{words}: {lines:?}"
    );
}

/// A copy of the database, with another manifest.
fn with_manifest(folder: &TestFolder, change: impl FnOnce(&mut ManifestFields)) -> PathBuf {
    let path = folder.join("world.tv");
    fs::create_dir_all(&path).unwrap();
    for name in FILES {
        fs::copy(synth_world(1024).database().join(name), path.join(name)).unwrap();
    }
    let mut manifest = local().manifest().fields().clone();
    change(&mut manifest);
    fs::write(path.join("manifest.json"), manifest.to_text().unwrap()).unwrap();
    path
}

fn tar(folder: &TestFolder) -> PathBuf {
    let path = folder.join("world.tar");
    let parent = synth_world(1024).database().parent().unwrap().to_owned();
    Terravision::program("tar").arg("-cf").arg(&path).arg("-C").arg(parent).arg("world.tv").succeed();
    path
}

#[test]
fn a_claim_of_petabytes_of_height_ranges_is_refused_before_any_is_asked_for() {
    let folder = TestFolder::new("hostile-nodes");
    with_manifest(&folder, |manifest| {
        manifest.world.extent = [1 << 28; 2];
        manifest.world.elevation_tile = 16;
        manifest.world.levels = 25;
        manifest.nodes.bytes = *NodeRanges::file_bytes(&World::new(manifest.world).unwrap(), false).end();
        assert!(manifest.nodes.bytes > 1 << 50);
    });
    let server = FaultServer::serve(folder.path());
    let (finished, peak) = measured(info(&server.url("world.tv")).arg("--cache").arg(folder.join("cache")));
    one_sentence(&finished, "bytes of height ranges, and at most 1073741824 are read");
    assert!(peak < INFO_KIB, "{peak} KiB");
    assert!(server.take_asked().iter().all(|asked| asked.path.ends_with("manifest.json")));
    // A manifest that contradicts itself is told, too.
    with_manifest(&folder, |manifest| manifest.nodes.bytes += 8);
    let finished = info(&server.url("world.tv")).arg("--cache").arg(folder.join("cache")).run();
    one_sentence(&finished, "and its world needs");
    assert!(server.take_asked().iter().all(|asked| asked.path.ends_with("manifest.json")));
}

#[test]
fn answers_without_end_are_not_followed() {
    let endless_head = RawServer::new(|_, stream| {
        stream.write_all(b"HTTP/1.1 200 OK\r\n")?;
        loop {
            stream.write_all(&[b"X-More: ".as_slice(), &[b'x'; 4000], b"\r\n"].concat())?;
        }
    });
    let endless_line = RawServer::new(|_, stream| {
        stream.write_all(b"HTTP/1.1 200 OK\r\nX-More: ")?;
        loop {
            stream.write_all(&[b'x'; 4096])?;
        }
    });
    let endless_body = RawServer::new(|_, stream| {
        stream.write_all(b"HTTP/1.1 200 OK\r\nContent-Length: 3000000000000000\r\nETag: \"1\"\r\n\r\n")?;
        loop {
            stream.write_all(&[b' '; 65536])?;
        }
    });
    let endless_error = RawServer::new(|_, stream| {
        stream.write_all(b"HTTP/1.1 403 Forbidden\r\nTransfer-Encoding: chunked\r\n\r\n")?;
        loop {
            stream.write_all(&[b"1000\r\n".as_slice(), &[b'x'; 4096], b"\r\n"].concat())?;
        }
    });
    for (server, words) in [
        (endless_head, "connection"),
        (endless_line, "connection"),
        (endless_body, "at most 16777216"),
        (endless_error, "no access"),
    ] {
        let folder = TestFolder::new("hostile-endless");
        let url = format!("http://{}/world.tv", server.address);
        let (finished, peak) = measured(info(&url).arg("--cache").arg(folder.join("cache")));
        one_sentence(&finished, words);
        assert!(peak < INFO_KIB, "{words}: {peak} KiB");
    }
}

#[test]
fn marks_that_change_with_every_answer_cost_a_few_looks_and_no_tile() {
    let (server, folder) = (serve(), TestFolder::new("hostile-etags"));
    let store = Store::open(&location(&server), &options(&folder)).unwrap();
    let tiles: Vec<_> = tiles(store.world()).into_iter().take(120).collect();
    let expected = served::read(&local(), &tiles);
    drop(server.take_asked());
    for (number, (tile, expected)) in tiles.iter().zip(expected).enumerate() {
        server.set_etag(&format!("{number}"));
        let found = match block_on(store.payload(tile.0, tile.1)) {
            Ok(bytes) => Some(bytes.to_vec()),
            Err(FetchError::Absent) => None,
            Err(error) => panic!("{error}"),
        };
        assert_eq!(Some(found), expected.ok());
    }
    let looks = server.take_asked().iter().filter(|asked| asked.path.ends_with("manifest.json")).count();
    assert!((1..=40).contains(&looks), "{looks} looks at the manifest");
}

#[test]
fn an_archive_that_is_cut_short_anywhere_is_an_error_and_no_panic() {
    let folder = TestFolder::new("hostile-tar");
    let path = tar(&folder);
    let whole = fs::read(&path).unwrap();
    let mut told = 0;
    for part in 0..24u64 {
        // Cut at headers, in files, and beside multiples of the block.
        let length = (whole.len() as u64 * part / 24).saturating_sub(part % 3 * 100) as usize;
        fs::write(&path, &whole[..length]).unwrap();
        match Store::open(&Location::parse(path.to_str().unwrap()).unwrap(), &options(&folder)) {
            Err(error) => {
                let error = error.to_string();
                assert!(!error.contains("fault of TerraVision"), "{length} bytes: {error}");
                told += 1;
            }
            Ok(store) => {
                let read = served::read(&store, &tiles(store.world()));
                let failed: Vec<String> = read.into_iter().filter_map(|tile| Some(tile.err()?.to_string())).collect();
                assert!(failed.iter().all(|error| !error.contains("fault of TerraVision")), "{failed:?}");
                told += usize::from(!failed.is_empty());
            }
        }
    }
    // A cut in the last tiles may leave all that are looked at here.
    assert!(told >= 20, "{told} of 24 cuts are noticed");
    // Cut while it is open, as by someone who writes it anew.
    fs::write(&path, &whole).unwrap();
    let store = Store::open(&Location::parse(path.to_str().unwrap()).unwrap(), &options(&folder)).unwrap();
    fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    let read = served::read(&store, &tiles(store.world()));
    assert!(read.iter().any(Result::is_err));
    let finished = info(path.to_str().unwrap()).run();
    finished.assert_told(2);
}

#[test]
fn damage_in_an_archive_of_this_machine_is_looked_at_twice_and_no_more() {
    let folder = TestFolder::new("hostile-damage");
    let path = tar(&folder);
    let mut bytes = fs::read(&path).unwrap();
    // Tiles of both archives are damaged, and no directory: those lie in the first bytes, and at
    // the end.
    let places = ["color.pmtiles", "elevation.pmtiles"].map(|file| {
        let name = format!("world.tv/{file}");
        let start = bytes.windows(name.len()).position(|w| w == name.as_bytes()).unwrap() + 512;
        let length = fs::metadata(synth_world(1024).database().join(file)).unwrap().len() as usize;
        start + 20_000..start + length * 3 / 4
    });
    for at in places.into_iter().flat_map(|place| place.step_by(300)) {
        bytes[at] ^= 0x10;
    }
    fs::write(&path, &bytes).unwrap();
    let patient =
        terravision_store::StoreOptions { retries: terravision_store::RetryOptions::default(), ..options(&folder) };
    let store = Store::open(&Location::parse(path.to_str().unwrap()).unwrap(), &patient).unwrap();
    let tiles = tiles(store.world());
    let failed = served::read(&store, &tiles).iter().filter(|tile| tile.is_err()).count() as u64;
    let figures = store.stats();
    assert!(failed > 10, "{failed} tiles");
    assert!(figures.repeated <= failed, "{} repeated for {failed} tiles", figures.repeated);
}

#[test]
fn what_is_no_database_is_told_in_a_sentence_and_nothing_waits() {
    let folder = TestFolder::new("hostile-kinds");
    let fifo = |name: &str| {
        let path = folder.join(name);
        let mode = rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR;
        rustix::fs::mknodat(rustix::fs::CWD, &path, rustix::fs::FileType::Fifo, mode, 0).unwrap();
        path
    };
    let link = |name: &str, to: &str| {
        std::os::unix::fs::symlink(to, folder.join(name)).unwrap();
        folder.join(name)
    };
    let socket = folder.join("socket");
    let _listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
    let database = with_manifest(&folder, |_| ());
    fs::remove_file(database.join("color.pmtiles")).unwrap();
    fifo("world.tv/color.pmtiles");
    for (path, words) in [
        (fifo("fifo"), "it is a named pipe"),
        (fifo("fifo.tar"), "a named pipe, expected a regular file"),
        (link("zero", "/dev/zero"), "it is a device"),
        (link("zero.tar", "/dev/zero"), "a device, expected a regular file"),
        (socket, "it is a socket"),
        (PathBuf::from("/dev/null"), "it is a device"),
        (folder.path().to_owned(), "has no manifest.json"),
        (database, "a named pipe, expected a regular file"),
    ] {
        one_sentence(&info(path.to_str().unwrap()).run(), words);
    }
}

#[test]
fn foreign_text_does_not_steer_a_terminal() {
    const BAD: &str = "\u{1b}]0;x\u{7}\u{1b}[2J\u{202e}\u{9b}31m";
    let folder = TestFolder::new("hostile-text");
    let database = with_manifest(&folder, |manifest| {
        manifest.name = BAD.into();
        manifest.crs.name = format!("a\nb{BAD}");
        manifest.body.name = BAD.into();
    });
    let is_plain = |text: &str| !text.chars().any(|c| (c.is_control() && c != '\n') || c == '\u{202e}');
    let finished = info(database.to_str().unwrap()).run();
    finished.assert_code(0);
    let said = finished.stdout_text();
    assert!(is_plain(&said) && said.contains("a b\\x1b]0;x\\x07\\x1b[2J\\u{202e}\\x9b31m"), "{said:?}");
    let finished = info(database.to_str().unwrap()).arg("--json").run();
    assert!(is_plain(&finished.stdout_text()));
    let value: serde_json::Value = serde_json::from_slice(&finished.stdout).unwrap();
    assert_eq!(value["manifest"]["name"], BAD);

    let server = RawServer::new(|_, stream| {
        let body = format!("<Error><Code>{BAD}</Code></Error>");
        write!(stream, "HTTP/1.1 302 Found\r\nLocation: evil://x\r\nContent-Length: {}\r\n\r\n{body}", body.len())
    });
    let commands = [
        info(&format!("{}/no{BAD}.tv", folder.path().display())),
        info(&format!("http://{}/w{BAD}.tv", server.address)).arg("--cache").arg(folder.join(format!("c{BAD}"))),
        Terravision::verb("info").arg(&database).arg(format!("--no{BAD}")),
        Terravision::verb("ingest").arg("--elevation").arg(folder.join(format!("d{BAD}.tif"))).args(["-o", "x.tv"]),
    ];
    for command in commands {
        let finished = command.current_dir(folder.path()).run();
        assert!(!finished.status.success() && !finished.stderr.is_empty());
        assert!(is_plain(&finished.stderr), "{:?}", finished.stderr);
    }
}

#[test]
fn secrets_stay_with_the_server_that_they_are_for() {
    let folder = TestFolder::new("hostile-redirect");
    let other = RawServer::new(|_, stream| stream.write_all(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n"));
    let target = other.address.clone();
    let first = RawServer::new(move |head, stream| {
        let path = head.split_whitespace().nth(1).unwrap_or("/");
        write!(
            stream,
            "HTTP/1.1 307 Temporary Redirect\r\nLocation: http://{target}{path}\r\nContent-Length: 0\r\n\r\n"
        )
    });
    let in_bucket = Terravision::verb("info")
        .args(["s3://bucket/world.tv", "--timeout", "2", "--cache"])
        .arg(folder.join("cache"))
        .env("AWS_ENDPOINT_URL", format!("http://{}", first.address))
        .env("AWS_REGION", "us-east-1")
        .env("AWS_ACCESS_KEY_ID", "hush-key")
        .env("AWS_SECRET_ACCESS_KEY", "hush-secret")
        .env("AWS_SESSION_TOKEN", "hush-token");
    one_sentence(&in_bucket.run(), "no finished terrain database");
    let url = format!("http://me:hush@{}/world.tv?token=hush", first.address);
    let finished = info(&url).arg("--cache").arg(folder.join("cache")).run();
    one_sentence(&finished, "no finished terrain database");
    assert!(!finished.stderr.contains("hush"), "{}", finished.stderr);

    let (at_first, at_other) = (first.heads(), other.heads());
    assert!(at_first.iter().any(|head| head.contains("x-amz-security-token: hush-token")), "{at_first:?}");
    assert!(at_first.iter().any(|head| head.contains("authorization: basic bwu6ahvzaa==")), "{at_first:?}");
    assert!(at_other.len() >= 2, "{at_other:?}");
    for head in at_other {
        // The path is what the first server wrote.
        let headers = head.split_once("\r\n").unwrap().1;
        assert!(
            !headers.contains("hush") && !headers.contains("authorization") && !headers.contains("x-amz"),
            "{head}"
        );
        assert!(!headers.contains("referer"), "{head}");
    }
}

#[test]
fn no_command_line_of_a_stage_has_the_secrets_of_a_url() {
    let (server, folder) = (serve(), TestFolder::new("hostile-cmdline"));
    let url = server.url("world.tv?token=hush").replace("http://", "http://me:hush@");
    let mut running = Terravision::verb("fly")
        .arg(url)
        .args(["--path", "orbit", "--frames", "0..5000", "--size", "320x180", "--technique", "rays", "-o"])
        .arg(folder.join("frames/"))
        .arg("--cache")
        .arg(folder.join("cache"))
        .spawn();
    let mut lines = Vec::new();
    for stage in ["generator", "prefetcher", "preparer", "renderer"] {
        let pid = running.stage(stage);
        lines.push(fs::read(format!("/proc/{pid}/cmdline")).unwrap());
        lines.push(fs::read(format!("/proc/{pid}/environ")).unwrap());
    }
    // They have read what they were told, and fly.
    running.until("the first frame", |_| folder.join("frames/frame-000000.png").exists().then_some(()));
    running.signal(rustix::process::Signal::INT);
    running.wait().assert_code(130);
    assert!(lines.iter().any(|line| line.windows(5).any(|word| word == b"--run")));
    assert!(lines.iter().all(|line| !line.windows(4).any(|word| word == b"hush")));
}

#[test]
fn a_cache_and_temporary_folders_are_private() {
    use std::os::unix::fs::PermissionsExt;
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
    let (server, folder) = (serve(), TestFolder::new("hostile-cache"));
    let at = |cache: &str| info(&server.url("world.tv")).arg("--cache").arg(folder.join(cache));
    at("new").succeed();
    assert_eq!([mode(&folder.join("new")), mode(&folder.join("new/index"))], [0o700; 2]);
    // Where others may write, and things of the user lie, the cache is done without, in a sentence.
    fs::create_dir(folder.join("open")).unwrap();
    fs::write(folder.join("open/photo.jpg"), "mine").unwrap();
    fs::set_permissions(folder.join("open"), fs::Permissions::from_mode(0o777)).unwrap();
    let store = Store::open(
        &location(&server),
        &terravision_store::StoreOptions { cache_dir: Some(folder.join("open")), ..options(&folder) },
    )
    .unwrap();
    let news = store.errors().take_news();
    assert!(news.iter().any(|line| line.contains("others may write into the folder (mode 777")), "{news:?}");
    let index = store.index().path().to_owned();
    assert!(!index.starts_with(folder.path()) && mode(&index) == 0o700, "{}", index.display());
    drop(store);
    assert!(!index.exists());
    assert_eq!(fs::read_dir(folder.join("open")).unwrap().count(), 1);
    let offline = at("open").arg("--offline").run();
    one_sentence(&offline, "others may write into the folder");
}
