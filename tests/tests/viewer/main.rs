//! `terravision serve`: flight and viewer, seen from a browser's side (docs/viewer.md).

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod client;
mod films;
mod first;
mod server;
mod sights;
mod video;

use client::{Client, Heard, bye_after, connect, hello};
use serde_json::json;
use server::{Server, until};
use std::time::{Duration, Instant};
use terravision_tests::folder::TestFolder;
use terravision_tests::process::{Terravision, children_of};
use terravision_tests::worlds::synth_world;
use tungstenite::Message;

const SIZE: [u32; 2] = [320, 180];
/// Rays draw the same on every machine, and start at once.
const RAYS: [&str; 2] = ["--rays", "sweep"];

fn serve(arguments: &[&str]) -> Server {
    Server::start(&synth_world(512).database(), &[&RAYS[..], arguments].concat())
}

#[test]
fn pictures_show_the_pose_and_the_one_at_rest_is_the_still() {
    let server = serve(&[]);
    let mut client = Client::enter(&server, SIZE);
    client.flying(SIZE);
    client.fly(7, 25.0);
    let picture = client.picture("the pose", |picture| picture.id == 7);
    let x = client.start["x"].as_f64().unwrap() + 25.0;
    assert_eq!((picture.size, u64::from(picture.client), picture.pose[0]), (SIZE, client.id, x));
    assert!(!picture.is_png && picture.file.starts_with(&[0xff, 0xd8]) && [75, 90].contains(&picture.quality));
    let [received, drawn, encoded] = picture.times_ms;
    assert!(received <= drawn && drawn <= encoded, "{:?}", picture.times_ms);

    let exact = client.picture("the exact picture", |picture| picture.is_exact());
    assert_eq!((exact.id, exact.size, exact.is_png, exact.flags, exact.pose), (7, SIZE, true, 15, picture.pose));
    let [x, y, z, heading, pitch, roll, vfov] = exact.pose;
    let folder = TestFolder::new("viewer-still");
    let still = folder.join("a.png");
    let flags = [
        format!("--eye={x},{y},{z}"),
        format!("--heading={heading}"),
        format!("--pitch={pitch}"),
        format!("--roll={roll}"),
        format!("--vfov={vfov}"),
        format!("--size={}x{}", SIZE[0], SIZE[1]),
    ];
    Terravision::verb("still").arg(synth_world(512).database()).args(flags).args(RAYS).arg("-o").arg(&still).succeed();
    assert!(std::fs::read(&still).unwrap() == exact.file, "the exact picture is not the still");
    let query = format!(
        "x={x}&y={y}&z={z}&heading={heading}&pitch={pitch}&roll={roll}&vfov={vfov}&width={}&height={}",
        SIZE[0], SIZE[1]
    );
    let answer = server.get(&format!("/api/still.png?{query}"));
    assert!(answer.status == 200 && answer.body == exact.file, "{}", answer.head);
    assert!(answer.head.contains("x-terravision-command: terravision still "), "{}", answer.head);

    // At rest there is nothing more to see.
    let end = Instant::now() + Duration::from_millis(800);
    while Instant::now() < end {
        let heard = client.hear(Duration::from_millis(100));
        assert!(!matches!(heard, Some(Heard::Picture(_))), "{heard:?}");
    }
    let pid = server.pid();
    assert_eq!(server.end().code(), Some(0));
    assert_eq!(Server::traces(pid), Vec::<std::path::PathBuf>::new());
}

#[test]
fn one_picture_is_under_way_and_the_next_is_the_newest() {
    let server = serve(&["--read-only"]);
    let mut reader = Client::enter(&server, SIZE);
    assert_eq!(reader.refused(r#"{"type":"take-over"}"#), "read-only");
    drop((reader, server));

    let server = serve(&[]);
    let mut client = Client::enter(&server, SIZE);
    client.flying(SIZE);
    client.fly(1, 1.0);
    client.acknowledge(false);
    let first = client.until("a picture", |_, heard| match heard {
        Heard::Picture(picture) => Some(picture),
        _ => None,
    });
    // Meanwhile another client is not slowed down.
    let mut other = Client::enter(&server, SIZE);
    for id in 2..40 {
        client.fly(id, f64::from(id));
        other.picture("each pose or a newer one", |picture| picture.id >= id);
    }
    while let Some(heard) = client.hear(Duration::from_millis(20)) {
        assert!(!matches!(heard, Heard::Picture(_)), "a picture came before the last was acknowledged");
    }
    client.acknowledge_picture(first.n);
    let next = client.until("the next picture", |_, heard| match heard {
        Heard::Picture(picture) => Some(picture),
        _ => None,
    });
    assert_eq!((next.n, next.id), (first.n + 1, 39));
}

#[test]
fn there_is_one_pilot_and_others_take_over() {
    let server = serve(&[]);
    let mut first = Client::enter(&server, SIZE);
    let mut second = Client::enter(&server, [200, 200]);
    assert_eq!(second.state["pilot"], json!(first.id));
    assert_eq!(second.state["people"].as_array().unwrap().len(), 2);
    second.fly(1, 5.0);
    assert_eq!(second.text("error")["code"], "not-pilot");
    assert_eq!(second.refused(r#"{"type":"settings","fps":20}"#), "not-pilot");
    second.say(&json!({"type": "take-over"}));
    // The picture follows the pilot's window, and the flight goes on.
    second.flying([200, 200]);
    second.fly(2, 5.0);
    second.picture("the second pilot's pose", |picture| picture.id == 2);
    let seen = first.picture("the same, by the first", |picture| picture.id == 2);
    assert_eq!((u64::from(seen.client), seen.size, seen.flight), (second.id, [200, 200], 1));
    // One that is larger than any before starts another flight.
    second.say(&json!({"type": "size", "size": [200, 1200], "dpr": 1}));
    let large = second.picture("a larger picture", |picture| picture.size == [200, 1200]);
    assert_eq!((large.flight, large.id), (2, 2));
    second.say(&json!({"type": "size", "size": [200, 200], "dpr": 1}));
    let small = second.picture("a smaller one again", |picture| picture.size == [200, 200]);
    assert_eq!(small.flight, 2);
    second.say(&json!({"type": "release"}));
    first.until("the seat", |client, _| (client.state["pilot"] == json!(client.id)).then_some(()));
    drop(first);
    second.until("an empty seat", |client, _| client.state["pilot"].is_null().then_some(()));
}

#[test]
fn settings_start_the_flight_again_and_bad_ones_change_nothing() {
    let server = serve(&["--facet-px", "6"]);
    let mut client = Client::enter(&server, SIZE);
    assert_eq!(client.flying(SIZE)["settings"]["facet_px"], 6.0);
    let before = client.picture("a picture", |picture| picture.size == SIZE).flight;
    client.say(&json!({"type": "settings", "facet_px": 12, "exaggeration": 2}));
    let after = client.picture("a picture of the next flight", |picture| picture.flight > before);
    assert_eq!(after.size, SIZE);
    let settings = client.flying(SIZE)["settings"].clone();
    assert_eq!((&settings["facet_px"], &settings["exaggeration"]), (&json!(12.0), &json!(2.0)));
    for bad in [r#""fps":0"#, r#""technique":"--output""#, r#""exaggeration":-1"#, r#""sun":"noon""#, r#""haze":0.5"#] {
        assert_eq!(client.refused(&format!(r#"{{"type":"settings",{bad}}}"#)), "bad-settings", "{bad}");
    }
    // What the flight notes of new settings is told.
    client.say(&json!({"type": "settings", "sun": "100,-20", "shadows": true}));
    client.until("a note", |_, heard| match heard {
        Heard::Text(text) => text["text"].as_str()?.starts_with("it is night").then_some(()),
        _ => None,
    });
    assert_eq!(client.flying(SIZE)["settings"]["sun"], "100,-20");
    // What the flight itself refuses is told, and it goes on as before.
    client.say(&json!({"type": "settings", "technique": "mesh"}));
    let notice = client.until("a warning", |_, heard| match heard {
        Heard::Text(text) if text["type"] == "notice" && text["level"] == "warning" => Some(text),
        _ => None,
    });
    assert!(notice["text"].as_str().unwrap().contains("goes on as before"), "{notice}");
    client.until("the old settings", |client, _| {
        (client.state["flight"] == "flying" && client.state["settings"]["technique"].is_null()).then_some(())
    });
}

#[test]
fn what_dies_comes_back() {
    let server = serve(&[]);
    let mut client = Client::enter(&server, SIZE);
    client.flying(SIZE);
    client.fly(5, 40.0);
    let x = client.picture("the pose", |picture| picture.id == 5).pose[0];
    // The viewer: its successor listens at the same port, and the camera is where it was.
    let viewer = server.child_named("terravision-viewer");
    Server::kill(viewer);
    client.until("the end", |_, heard| matches!(heard, Heard::Closed).then_some(()));
    let mut client = Client::enter(&server, SIZE);
    assert_ne!(server.child_named("terravision-viewer"), viewer);
    let picture = client.picture("a picture of the next viewer", |_| true);
    assert_eq!((picture.flight, picture.pose[0].round()), (1, x.round()));
    // A stage: the flight starts it again.
    client.flying(SIZE);
    client.fly(6, 41.0);
    client.picture("a pose", |picture| picture.id == 6);
    let flight = server.child_named("terravision");
    let stage =
        children_of(flight).into_iter().find(|(_, name)| name == "terravision-rende" || name == "terravision-renderer");
    Server::kill(stage.unwrap().0);
    let notice = client.text("notice");
    assert!(notice["text"].as_str().unwrap().contains("started again"), "{notice}");
    client.fly(7, 42.0);
    client.picture("a picture of the next renderer", |picture| picture.id == 7);
    // The whole flight: another one takes its place, at the same pose.
    Server::kill(flight);
    client.until("the state", |client, _| (client.state["flight"] == "restarting").then_some(()));
    assert!(client.state["reason"].as_str().unwrap().contains("killed"), "{}", client.state);
    let picture = client.picture("a picture of the next flight", |picture| picture.flight == 2);
    assert_eq!(picture.id, 7);
    client.fly(8, 43.0);
    client.picture("a pose", |picture| picture.id == 8);
    let pid = server.pid();
    assert_eq!(server.end().code(), Some(0));
    assert_eq!(Server::traces(pid), Vec::<std::path::PathBuf>::new());
    assert_eq!(client.text("bye")["code"], "ending");
}

#[test]
fn what_is_wrong_is_refused_with_a_reason() {
    let server = serve(&[]);
    let refused = |answer: server::Answer| (answer.status, answer.code());
    let wrong = |name, value| refused(server.ask("GET", "/api/info", &[(name, value)], b""));
    assert_eq!(wrong("Host", "example.org"), (403, "wrong-host".into()));
    assert_eq!(wrong("Host", "127.0.0.1.example.org:80"), (403, "wrong-host".into()));
    let foreign = [("Origin", "http://example.org")];
    assert_eq!(refused(server.ask("POST", "/api/heights", &foreign, b"[]")), (403, "wrong-origin".into()));
    assert_eq!(connect(&server, &foreign).err(), Some(403));
    assert!(connect(&server, &[("Origin", &format!("http://127.0.0.1:{}", server.port))]).is_ok());
    assert_eq!(wrong("Sec-Fetch-Site", "cross-site"), (403, "wrong-origin".into()));
    assert_eq!(refused(server.get("/../../etc/passwd")), (404, "not-found".into()));
    assert_eq!(refused(server.get("/api/nothing")), (404, "not-found".into()));
    assert_eq!(refused(server.ask("DELETE", "/api/info", &[], b"")), (405, "wrong-method".into()));
    assert_eq!(refused(server.get("/api/still.png?x=1&y=2&z=3&heading=0")), (400, "bad-request".into()));
    assert_eq!(refused(server.get("/api/still.png?x=1&y=2&z=3&heading=0&pitch=91")), (400, "bad-pose".into()));
    assert_eq!(refused(server.get("/api/still.png?x=NaN&y=2&z=3&heading=0&pitch=9")), (400, "bad-pose".into()));
    let huge = "/api/still.png?x=1&y=2&z=3&heading=0&pitch=0&width=100000";
    assert_eq!(refused(server.get(huge)), (400, "bad-size".into()));

    let bye = |first: Message| bye_after(&server, first)["code"].as_str().unwrap().to_owned();
    assert_eq!(bye(Message::text(r#"{"type":"take-over"}"#)), "no-hello");
    assert_eq!(bye(Message::text("{")), "malformed");
    assert_eq!(bye(Message::binary(vec![1, 2, 3])), "no-hello");
    assert_eq!(bye(Message::text(r#"{"type":"hello","protocol":99,"size":[9,9]}"#)), "wrong-protocol");
    assert_eq!(bye(Message::text(r#"{"type":"hello","protocol":1,"size":[9,-9]}"#)), "bad-size");
    let mut client = Client::enter(&server, SIZE);
    for malformed in ["", "[]", "null", r#"{"type":"pose"}"#, r#"{"type":"pose","id":1,"x":NaN}"#, r#"{"type":"x"}"#] {
        assert_eq!(client.refused(malformed), "malformed", "{malformed}");
    }
    for pose in [
        r#""x":1e999,"y":0,"z":0,"heading":0,"pitch":0"#,
        r#""x":null,"y":0,"z":0,"heading":0,"pitch":0"#,
        r#""x":0,"y":0,"z":0,"heading":0,"pitch":91"#,
        r#""x":-1e9,"y":0,"z":0,"heading":0,"pitch":0"#,
        r#""x":0,"y":0,"z":0,"heading":0,"pitch":0,"vfov":0"#,
    ] {
        let code = client.refused(&format!(r#"{{"type":"pose","id":1,{pose}}}"#));
        assert!(["malformed", "bad-pose"].contains(&code.as_str()), "{pose}: {code}");
    }
    assert_eq!(client.refused(r#"{"type":"pick","id":1,"u":2,"v":0}"#), "malformed");
    client.say_text(&" ".repeat(20_000));
    assert_eq!(client.text("bye")["code"], "too-large");
    let mut client = Client::enter(&server, SIZE);
    (0..300).for_each(|id| client.say(&json!({"type": "size", "size": SIZE, "dpr": 1, "id": id})));
    assert_eq!(client.text("bye")["code"], "too-fast");
}

#[test]
fn programs_ask_for_heights_info_and_metrics() {
    let server = serve(&["--token", "secret-token-1", "--allow-embed", "https://example.org"]);
    assert!(server.page.ends_with("/?token=secret-token-1"), "{}", server.page);
    let page = server.get("/");
    assert!(page.status == 200 && page.head.contains("text/html"), "{}", page.head);
    assert!(page.head.contains("frame-ancestors 'self' https://example.org"), "{}", page.head);
    assert!(!page.head.contains("unsafe-inline"), "{}", page.head);
    assert_eq!(server.get("/api/info").code(), "no-token");
    assert_eq!(server.get("/api/info?token=secret-token-2").code(), "wrong-token");
    let bearer = [("Authorization", "Bearer secret-token-1")];
    let info = server.ask("GET", "/api/info", &bearer, b"").json();
    assert_eq!((&info["protocol"], &info["limits"]["clients"]), (&json!(1), &json!(64)));
    let bye = bye_after(&server, Message::text(hello(SIZE).to_string()));
    assert_eq!(bye["code"], "wrong-token");
    let mut known = hello(SIZE);
    known["token"] = json!("secret-token-1");
    let mut client = Client::enter_with(&server, known);
    client.flying(SIZE);

    let world = synth_world(512);
    let ([a, b], outside) = ([world.above(0.3, 0.4, 0.0), world.above(0.75, 0.5, 0.0)], [0.0, 0.0]);
    let places = json!([[a[0], a[1]], [b[0], b[1]], outside]);
    let ask = |body: &[u8]| server.ask("POST", "/api/heights", &bearer, body);
    let heights = ask(places.to_string().as_bytes()).json();
    for (height, expected) in [(&heights[0], a[2]), (&heights[1], b[2])] {
        assert!((height.as_f64().unwrap() - expected).abs() < 0.6, "{heights} {expected}");
    }
    assert!(heights[2].is_null() && heights.as_array().unwrap().len() == 3, "{heights}");
    assert_eq!(ask(b"[[1]]").code(), "bad-request");
    assert_eq!(ask(json!(vec![[0, 0]; 5000]).to_string().as_bytes()).code(), "too-large");
    assert_eq!(ask(&vec![b' '; 300 << 10]).status, 413);

    // The ground in the middle of the picture is where the camera looks.
    client.picture("a picture", |picture| picture.size == SIZE);
    client.say(&json!({"type": "pick", "id": 4, "u": 0.5, "v": 0.6}));
    let picked = client.text("picked");
    let point: Vec<f64> = picked["point"].as_array().unwrap().iter().map(|n| n.as_f64().unwrap()).collect();
    let ground = ask(json!([[point[0], point[1]]]).to_string().as_bytes()).json();
    assert!((ground[0].as_f64().unwrap() - point[2]).abs() < 15.0, "{picked} {ground}");

    let metrics = until("metrics of the flight", || {
        let answer = server.ask("GET", "/api/metrics", &bearer, b"");
        let text = String::from_utf8(answer.body).unwrap();
        text.contains("terravision_frames_written_total").then_some(text)
    });
    assert!(metrics.contains("terravision_viewer_clients 1\n"), "{metrics}");
    let figures = client.text("figures");
    assert!(figures["clients"] == 1 && figures["bytes_per_s"].is_number(), "{figures}");
}

#[test]
fn what_cannot_be_served_is_told_and_nothing_is_left() {
    let world = synth_world(512).database();
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().to_string();
    let told = |world: &std::path::Path, arguments: &[&str], expected: &str| {
        let finished = Terravision::verb("serve").arg(world).args(arguments).run();
        finished.assert_told(2);
        assert!(finished.stderr.contains(expected) && finished.stdout.is_empty(), "{}", finished.stderr);
    };
    told(&world, &["--addr", &port], "cannot listen there");
    told(&world, &["--addr", "0.0.0.0:0"], "--token");
    told(&world, &["--addr", "127.0.0.1:0", "--token", "short"], "8 to 256");
    told(&world, &["--addr", "127.0.0.1:0", "--allow-embed", "https://a/b"], "an origin without a path");
    told(&world, &["--addr", "127.0.0.1:0", "--fps", "900"], "fps");
    told(&world.with_file_name("missing.tv"), &["--addr", "127.0.0.1:0"], "missing.tv");
    let no_file = TestFolder::new("viewer-empty");
    told(no_file.path(), &["--addr", "127.0.0.1:0"], "manifest");
}
