//! `terravision query`: answers against GDAL's and against the rasters, bad input, the socket.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use rustix::process::Signal;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;
use terravision_tests::folder::TestFolder;
use terravision_tests::process::{Running, Terravision, binary};
use terravision_tests::worlds::synth_world;

/// What the command answered.
struct Answered {
    code: Option<i32>,
    lines: Vec<String>,
    error: String,
}

/// Asks with these lines as standard input.
fn ask(world: &Path, flags: &[&str], input: &[u8]) -> Answered {
    let mut command = Command::new(binary("terravision"));
    let command = command.arg("query").arg(world).args(flags);
    let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let (mut stdin, input) = (child.stdin.take().unwrap(), input.to_vec());
    let writer = std::thread::spawn(move || stdin.write_all(&input).ok());
    let output = child.wait_with_output().unwrap();
    writer.join().unwrap();
    Answered {
        code: output.status.code(),
        lines: String::from_utf8(output.stdout).unwrap().lines().map(str::to_owned).collect(),
        error: String::from_utf8(output.stderr).unwrap(),
    }
}

/// The answers, of a run that has to succeed.
fn answers(world: &Path, flags: &[&str], input: &[u8]) -> Vec<String> {
    let answered = ask(world, flags, input);
    assert_eq!((answered.code, answered.error.as_str()), (Some(0), ""), "{flags:?}");
    answered.lines
}

/// The numbers of an answer of this status.
fn numbers(line: &str, status: &str) -> Vec<f64> {
    let rest = line.strip_prefix(status).unwrap_or_else(|| panic!("{line}: expected {status}"));
    rest.split_whitespace().map(|word| word.parse().unwrap_or_else(|_| panic!("{line}: {word}"))).collect()
}

/// Numbers without a pattern, from 0 to 1.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

fn data() -> Option<PathBuf> {
    let folder = std::env::var_os("TERRAVISION_DATA").map(PathBuf::from);
    if folder.is_none() {
        println!("TERRAVISION_DATA is not set: nothing was compared with GDAL");
    }
    folder.map(|folder| if folder.is_absolute() { folder } else { Path::new("..").join(folder) })
}

fn gdal(program: &str, words: &[&str], files: [&Path; 2]) {
    let done = Command::new(program).args(words).args(files).output();
    let done = done.unwrap_or_else(|error| panic!("{program}, of the package gdal-bin, does not start: {error}"));
    assert!(done.status.success(), "{program}: {}", String::from_utf8_lossy(&done.stderr));
}

/// Heights of a raster as GDAL's bilinear kernel has them, at places that have nothing to do with
/// its pixels: x, y and height.
fn gdal_bilinear(raster: &Path, folder: &TestFolder, [w, s, e, n]: [f64; 4], step: [f64; 2]) -> Vec<[f64; 3]> {
    let (warped, text) = (folder.join("warped.tif"), folder.join("warped.xyz"));
    std::fs::remove_file(&warped).ok();
    let bounds = [w, s, e, n].map(|v| v.to_string());
    let step = step.map(|v| v.to_string());
    let words = ["-q", "-r", "bilinear", "-et", "0", "-ot", "Float64", "-tr", &step[0], &step[1], "-te"];
    gdal("gdalwarp", &[&words[..], &bounds.each_ref().map(String::as_str)].concat(), [raster, &warped]);
    gdal("gdal_translate", &["-q", "-of", "XYZ"], [&warped, &text]);
    let text = std::fs::read_to_string(&text).unwrap();
    let point = |line: &str| -> [f64; 3] {
        let numbers: Vec<f64> = line.split_whitespace().map(|word| word.parse().unwrap()).collect();
        numbers.try_into().unwrap()
    };
    text.lines().map(point).collect()
}

#[test]
fn heights_are_gdals_bilinear_samples_of_the_source_within_a_centimetre() {
    let Some(data) = data() else { return };
    let mut random = Random(7);
    for file in ["earth-sthelens/SainteHelens.dem", "ingest-geotiff/lidar_dem_utm15_float32_tiled.tif"] {
        let raster = data.join(file);
        let folder = TestFolder::new("query-gdal");
        let world = folder.join("w.tv");
        Terravision::verb("ingest").arg("--elevation").arg(&raster).arg("-o").arg(&world).run().assert_code(0);
        let info = Terravision::verb("info").arg(&world).arg("--json").succeed().stdout_text();
        let info: Value = serde_json::from_str(&info).unwrap();
        let [w, s, e, n] = [0, 1, 2, 3].map(|side| info["bounds"][side].as_f64().unwrap());
        let spacing = info["elevation_spacing_m"].as_f64().unwrap();
        let (mut compared, mut worst) = (0, 0.0f64);
        for _ in 0..4 {
            // Somewhere in the middle, away from what the file has no data for.
            let side = 30.0 * spacing;
            let at = [w + (0.3 + 0.3 * random.next()) * (e - w), s + (0.3 + 0.3 * random.next()) * (n - s)];
            let step = [0, 1].map(|_| side / (60.0 + (20.0 * random.next()).floor()));
            let points = gdal_bilinear(&raster, &folder, [at[0], at[1], at[0] + side, at[1] + side], step);
            let input: String = points.iter().map(|[x, y, _]| format!("{x} {y}\n")).collect();
            let found = answers(&world, &[], input.as_bytes());
            assert_eq!(found.len(), points.len());
            for ([x, y, expected], line) in points.iter().zip(&found) {
                let height = numbers(line, "ok")[0];
                worst = worst.max((height - expected).abs());
                assert!((height - expected).abs() < 0.01, "{file} at {x} {y}: {height}, GDAL {expected}");
            }
            compared += points.len();
        }
        println!("{file}: {compared} points, at most {worst:.4} m from GDAL's");
        assert!(compared > 10_000);
    }
}

#[test]
fn places_in_longitude_and_latitude_are_the_same_places() {
    let world = synth_world(512).database();
    let info = Terravision::verb("info").arg(&world).arg("--json").succeed().stdout_text();
    let highest = serde_json::from_str::<Value>(&info).unwrap()["highest"].clone();
    let text = |place: &Value| format!("{} {}", place[0], place[1]);
    let height = highest["height_m"].as_f64().unwrap();
    let lonlat = answers(&world, &["--crs", "lonlat"], text(&highest["lon_lat"]).as_bytes());
    let own = answers(&world, &["--interpolation", "facet"], text(&highest["place"]).as_bytes());
    assert!((numbers(&lonlat[0], "ok")[0] - height).abs() < 0.1, "{lonlat:?}, {height}");
    assert!((numbers(&own[0], "ok")[0] - height).abs() < 0.001, "{own:?}, {height}");
    // Where a line from above it down into it ends, it is hidden.
    let [lon, lat] = [0, 1].map(|axis| highest["lon_lat"][axis].as_f64().unwrap());
    let line = format!("{lon} {lat} {} {lon} {lat} {}", height + 100.0, height - 100.0);
    let hidden = answers(&world, &["--crs", "lonlat", "--sight"], line.as_bytes());
    let hidden = numbers(&hidden[0], "hidden");
    assert!((hidden[0] - 100.0).abs() < 0.1 && (hidden[1] - lon).abs() < 1e-7 && (hidden[2] - lat).abs() < 1e-7);
}

#[test]
fn every_line_has_an_answer_and_a_bad_one_spoils_no_other() {
    let world = synth_world(512);
    let [x, y, _] = world.above(0.5, 0.5, 0.0);
    let input = format!(
        "{x} {y}\n\nx y\n{x} nan\n1 2\n{x},{y},5000,summit\n\u{1b}]0;\u{7}\n{x}\n{{\"points\": [[{x}, {y}], [1]], \"id\": 7}}\n\
         {{\"points\": 3}}\n{x} {y}"
    );
    let found = answers(&world.database(), &[], input.as_bytes());
    let first: Vec<&str> = found.iter().map(|line| line.split([' ', ':']).next().unwrap()).collect();
    let bad = "bad";
    assert_eq!(first, ["ok", bad, bad, bad, "outside", "ok", bad, bad, "{\"answers\"", "{\"error\"", "ok"]);
    assert!(!found.iter().any(|line| line.contains('\u{1b}')), "{found:?}");
    assert_eq!(found[0], found[10]);
    let above = numbers(&found[5], "ok");
    assert!((above[0] + above[4] - 5000.0).abs() < 0.0011, "{above:?}");
    let request: Value = serde_json::from_str(&found[8]).unwrap();
    assert_eq!((&request["id"], &request["answers"][1]["status"]), (&json!(7), &json!("bad")));
    let height = request["answers"][0]["height"].as_f64().unwrap();
    assert!((height - above[0]).abs() < 0.001, "{height}");
    // Bytes that are not text, and a line without an end.
    let found = answers(&world.database(), &[], b"\xff\xfe 1\n\0\0");
    assert!(found.len() == 2 && found.iter().all(|line| line.starts_with("bad expected x y or x y z")), "{found:?}");
}

#[test]
fn wrong_command_lines_are_told_in_a_sentence() {
    let world = synth_world(512).database();
    for (flags, words) in [
        (&["--sphere", "0"][..], "--sphere is 0: expected a radius in metres"),
        (&["--sphere", "nan"], "--sphere is NaN"),
        (&["--sphere", "1001"], "at most 1000"),
        (&["--sight", "--sphere", "2"], "cannot be used with"),
        (&["--crs", "mars"], "'mars'"),
        (&["--listen", "/nonexistent/a.sock"], "--listen: cannot make the socket /nonexistent/a.sock"),
        (&["--listen", "/dev/null"], "is not a socket"),
    ] {
        let answered = ask(&world, flags, b"");
        assert_eq!(answered.code, Some(2), "{flags:?}: {}", answered.error);
        assert!(answered.error.contains(words) && answered.error.lines().count() == 1, "{}", answered.error);
        assert!(answered.lines.is_empty());
    }
    let answered = ask(Path::new("/nonexistent.tv"), &[], b"1 2\n");
    assert_eq!((answered.code, answered.lines.len()), (Some(2), 0), "{}", answered.error);
}

#[test]
fn what_hides_and_what_is_touched_is_on_the_ground() {
    let world = synth_world(512);
    let mut random = Random(3);
    let mut place = |height_m: f64| world.above(random.next(), random.next(), height_m);
    let pairs: Vec<[f64; 6]> = (0..300)
        .map(|k| {
            let ([a, b, c], [d, e, f]) = (place(30.0 + f64::from(k)), place(30.0));
            [a, b, c, d, e, f]
        })
        .collect();
    let input: String = pairs.iter().map(|pair| pair.map(|v| v.to_string()).join(" ") + "\n").collect();
    let height = |points: &[[f64; 2]]| -> Vec<f64> {
        let input: String = points.iter().map(|[x, y]| format!("{x} {y}\n")).collect();
        let found = answers(&world.database(), &["--interpolation", "facet"], input.as_bytes());
        found.iter().map(|line| numbers(line, "ok")[0]).collect()
    };
    let sights = answers(&world.database(), &["--sight"], input.as_bytes());
    let (mut hidden, mut on_ground) = (0, Vec::new());
    for (pair, line) in pairs.iter().zip(&sights) {
        let seen = line.starts_with("visible");
        // Heights along the line, up to where it is hidden.
        let end = if seen { 1.0 } else { numbers(line, "hidden")[0] / length(pair) };
        let at = |share: f64| [0, 1, 2].map(|axis| pair[axis] + share * (pair[axis + 3] - pair[axis]));
        let shares: Vec<f64> = (0..200).map(|k| end * f64::from(k) / 200.0).collect();
        let grounds = height(&shares.iter().map(|share| [at(*share)[0], at(*share)[1]]).collect::<Vec<_>>());
        for (share, ground) in shares.iter().zip(grounds) {
            assert!(at(*share)[2] > ground - 0.01, "{line}: the ground is {ground} at {:?}", at(*share));
        }
        if !seen {
            hidden += 1;
            let [_, x, y, z]: [f64; 4] = numbers(line, "hidden").try_into().unwrap();
            on_ground.push([x, y, z]);
        }
    }
    assert!((30..270).contains(&hidden), "{hidden} of 300 are hidden");
    for line in answers(&world.database(), &["--sphere", "12"], input.as_bytes()) {
        if line != "free" {
            let touch: [f64; 10] = numbers(&line, "touch").try_into().unwrap();
            let across: f64 = (1..4).map(|k| (touch[k] - touch[k + 3]).powi(2)).sum::<f64>().sqrt();
            assert!((across - 12.0).abs() < 0.01, "{line}");
            on_ground.push([touch[4], touch[5], touch[6]]);
        }
    }
    assert!(on_ground.len() > hidden + 20, "{} of 300 touch", on_ground.len() - hidden);
    let grounds = height(&on_ground.iter().map(|[x, y, _]| [*x, *y]).collect::<Vec<_>>());
    for ([x, y, z], ground) in on_ground.iter().zip(grounds) {
        // Places are written in millimetres, and the ground is steep.
        assert!((z - ground).abs() < 0.02, "{x} {y} {z}: the ground is {ground}");
    }
}

fn length(pair: &[f64; 6]) -> f64 {
    (0..3).map(|axis| (pair[axis + 3] - pair[axis]).powi(2)).sum::<f64>().sqrt()
}

#[test]
fn answers_come_while_the_input_goes_on() {
    let world = synth_world(512);
    let [x, y, _] = world.above(0.25, 0.75, 0.0);
    let mut command = Command::new(binary("terravision"));
    let command = command.arg("query").arg(world.database());
    let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let (mut stdin, mut stdout) = (child.stdin.take().unwrap(), BufReader::new(child.stdout.take().unwrap()));
    for _ in 0..3 {
        writeln!(stdin, "{x} {y}").unwrap();
        let mut line = String::new();
        stdout.read_line(&mut line).unwrap();
        assert!(line.starts_with("ok "), "{line}");
    }
    // Nobody reads the answers any more: it ends in silence.
    drop(stdout);
    writeln!(stdin, "{x} {y}").ok();
    assert_eq!(child.wait().unwrap().code(), Some(0));
}

#[test]
fn a_damaged_tile_is_answered_from_a_coarser_one_and_told_of() {
    let world = synth_world(512);
    let folder = TestFolder::new("query-damage");
    for file in ["manifest.json", "nodes.tvn", "color.pmtiles", "elevation.pmtiles"] {
        std::fs::copy(world.database().join(file), folder.join(file)).unwrap();
    }
    // Bytes near the archive's end are tiles.
    let mut archive = std::fs::read(folder.join("elevation.pmtiles")).unwrap();
    let length = archive.len();
    archive[length - 40..length - 20].iter_mut().for_each(|byte| *byte ^= 0x55);
    std::fs::write(folder.join("elevation.pmtiles"), archive).unwrap();
    let points: Vec<[f64; 3]> =
        (0..3600).map(|k| world.above(f64::from(k % 60) / 59.0, f64::from(k / 60) / 59.0, 0.0)).collect();
    let input: String = points.iter().map(|[x, y, _]| format!("{x} {y}\n")).collect();
    let answered = ask(folder.path(), &[], input.as_bytes());
    assert_eq!(answered.code, Some(3), "{}", answered.error);
    assert!(answered.error.starts_with("terravision: 1 tile could not be read"), "{}", answered.error);
    assert_eq!(answered.lines.len(), 3600);
    let coarser = answered.lines.iter().filter(|line| line.ends_with(" coarser")).count();
    assert!(coarser > 0 && coarser < 1800, "{coarser}");
    assert!(answered.lines.iter().all(|line| line.starts_with("ok ")));
}

/// A server of questions, and its socket.
fn listen(folder: &TestFolder, flags: &[&str]) -> (Running, PathBuf) {
    let socket = folder.join("q.sock");
    let command = Terravision::verb("query").arg(synth_world(512).database()).arg("--listen").arg(&socket);
    let mut running = command.args(flags).spawn();
    running.until("the socket", |_| UnixStream::connect(&socket).ok());
    (running, socket)
}

struct Client(BufReader<UnixStream>);

impl Client {
    fn connect(socket: &Path) -> Self {
        let stream = UnixStream::connect(socket).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        Self(BufReader::new(stream))
    }

    fn send(&mut self, bytes: &[u8]) {
        self.0.get_mut().write_all(bytes).unwrap();
    }

    fn hear(&mut self) -> Value {
        let mut line = String::new();
        self.0.read_line(&mut line).unwrap();
        serde_json::from_str(&line).unwrap_or_else(|error| panic!("{line}: {error}"))
    }

    fn ask(&mut self, request: &Value) -> Value {
        self.send(format!("{request}\n").as_bytes());
        self.hear()
    }
}

#[test]
fn clients_of_the_socket_ask_in_turns_and_bad_ones_get_a_sentence() {
    let folder = TestFolder::new("query-socket");
    let (server, socket) = listen(&folder, &[]);
    assert_eq!(std::fs::metadata(&socket).unwrap().permissions().mode() & 0o777, 0o600);
    let world = synth_world(512);
    let [x, y, z] = world.above(0.4, 0.6, 0.0);
    let (mut first, mut second) = (Client::connect(&socket), Client::connect(&socket));
    let many: Vec<[f64; 2]> = vec![[x, y]; 20_000];
    first.send(format!("{}\n{}\n", json!({"id": "a", "points": many}), json!({"id": 2, "points": []})).as_bytes());
    let height = |answer: &Value| answer["height"].as_f64().unwrap();
    let facet = second.ask(&json!({"points": [[x, y, z + 10.0]], "interpolation": "facet"}));
    assert!((height(&facet["answers"][0]) - z).abs() < 0.01 && facet["id"] == Value::Null, "{facet}");
    assert!((facet["answers"][0]["above"].as_f64().unwrap() - 10.0).abs() < 0.01);
    let all = first.hear();
    assert_eq!((&all["id"], all["answers"].as_array().unwrap().len()), (&json!("a"), 20_000));
    assert_eq!(first.hear(), json!({"id": 2, "answers": []}));
    let agl = json!({"ask": "sight", "agl": true, "points": [[x, y, 2, x, y, 50], [x, y, -5, x, y, 50]]});
    let agl = second.ask(&agl);
    assert_eq!((&agl["answers"][0]["status"], &agl["answers"][1]["status"]), (&json!("visible"), &json!("hidden")));
    let sphere = second.ask(&json!({"ask": "sphere", "radius": 3, "points": [[x, y, z + 100.0, x, y, z - 100.0]]}));
    assert_eq!(sphere["answers"][0]["status"], "touch");
    for (request, words) in [
        ("7", "not a request"),
        ("{\"points\": [[1, 2]], \"radios\": 3}", "unknown field `radios`"),
        ("{\"ask\": \"colour\", \"points\": []}", "unknown variant `colour`"),
        ("{\"ask\": \"sphere\", \"points\": []}", "a sphere has no radius"),
        ("{\"radius\": -1, \"points\": []}", "the radius is -1"),
        ("{\"ask\": \"height\", \"radius\": 1, \"points\": []}", "only a sphere has a radius"),
        ("\u{0}\u{1}", "not a request"),
        (&format!("{{\"points\": [{}0]}}", "0,".repeat(100_000)), "100001 points, expected at most 100000"),
        (&"[".repeat(100_000), "not a request"),
    ] {
        second.send(format!("{request}\n").as_bytes());
        let answer = second.hear();
        let error = answer["error"].as_str().unwrap();
        assert!(error.contains(words) && error.len() < 400, "{error}");
    }
    let odd = second.ask(&json!({"points": [[x, y], [x], "x", null, [x, "y"], [0, 0], {}]}));
    let status: Vec<&str> = odd["answers"].as_array().unwrap().iter().map(|a| a["status"].as_str().unwrap()).collect();
    assert_eq!(status, ["ok", "bad", "bad", "bad", "bad", "outside", "bad"]);
    // A line without an end is refused when it is too long, and its client left; the other goes on.
    let mut long = first;
    let chunk = vec![b' '; 1 << 20];
    // It may be left before it has sent all.
    for _ in 0..10 {
        long.0.get_mut().write_all(&chunk).ok();
    }
    let mut rest = Vec::new();
    long.0.read_to_end(&mut rest).ok();
    assert!(String::from_utf8_lossy(&rest).contains("longer than 8 MiB"), "{}", String::from_utf8_lossy(&rest));
    assert_eq!(second.ask(&json!({"points": []})), json!({"id": null, "answers": []}));
    // Ctrl-C ends it with clients connected, and the socket is gone.
    server.signal(Signal::INT);
    let finished = server.wait();
    finished.assert_code(0);
    finished.assert_no_warning();
    assert!(!socket.exists());
    assert_eq!(second.0.read_line(&mut String::new()).unwrap_or(0), 0);
}

#[test]
fn a_socket_that_was_left_is_replaced_and_one_in_use_is_not() {
    let folder = TestFolder::new("query-left");
    drop(UnixListener::bind(folder.join("q.sock")).unwrap());
    let (server, socket) = listen(&folder, &["--sight"]);
    let flags = ["--listen", socket.to_str().unwrap()];
    let answered = ask(&synth_world(512).database(), &flags, b"");
    assert_eq!(answered.code, Some(2), "{}", answered.error);
    assert!(answered.error.contains("another program listens on"), "{}", answered.error);
    assert!(socket.exists());
    server.signal(Signal::TERM);
    server.wait().assert_code(0);
    assert!(!socket.exists());
}
