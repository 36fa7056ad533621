//! What pictures show: places, tiles, two eyes; and what becomes of a flight that nobody sees.

use crate::client::{Client, Heard};
use crate::server::until;
use crate::{RAYS, SIZE, serve};
use serde_json::{Value, json};
use std::time::{Duration, Instant};
use terravision_tests::folder::TestFolder;
use terravision_tests::process::Terravision;
use terravision_tests::worlds::synth_world;

#[test]
fn a_place_is_that_of_the_picture_that_was_meant() {
    let server = serve(&[]);
    let mut client = Client::enter(&server, SIZE);
    client.flying(SIZE);
    client.fly(1, 0.0);
    let first = client.picture("the first pose", |picture| picture.id == 1);
    let mut pick = |n: Option<u32>| {
        client.say(&json!({"type": "pick", "id": 4, "u": 0.5, "v": 0.6, "n": n}));
        client.text("picked")
    };
    let (known, newest, unknown) = (pick(Some(first.n)), pick(None), pick(Some(first.n + 1000)));
    assert_eq!((&known["n"], &newest["n"], &unknown["n"]), (&json!(first.n), &Value::Null, &Value::Null));
    assert!(known["point"].is_array(), "{known}");
    assert_eq!(unknown["point"].as_array().map(Vec::len), Some(3));
}

#[test]
fn the_map_is_told_of_tiles_and_of_what_is_seen_by_those_who_ask() {
    let server = serve(&[]);
    let (mut client, mut other) = (Client::enter(&server, SIZE), Client::enter(&server, SIZE));
    client.flying(SIZE);
    client.say(&json!({"type": "map", "wanted": true}));
    let is_full = |text: &Value| {
        let tiles = text["tiles"]["resident"].as_array().map_or(0, Vec::len);
        tiles >= 3 && tiles.is_multiple_of(3) && text["footprint"].as_array().is_some_and(|places| places.len() > 20)
    };
    let map = client.until("a full map", |_, heard| match heard {
        Heard::Text(text) if text["type"] == "map" && is_full(&text) => Some(text),
        _ => None,
    });
    let bounds = server.get("/api/info").json()["world"]["bounds"].clone();
    let [low, high] = [0, 1].map(|corner| [0, 1].map(|axis| bounds[corner][axis].as_f64().unwrap()));
    for place in map["footprint"].as_array().unwrap() {
        for axis in 0..2 {
            let value = place[axis].as_f64().unwrap();
            // The wall at the border is seen from kilometres away.
            assert!(value >= low[axis] - 25.0 && value <= high[axis] + 25.0, "{place} is beside the world");
        }
    }
    // The coarsest nodes come first, and lie in the world.
    let tiles: Vec<u64> = map["tiles"]["resident"].as_array().unwrap().iter().map(|n| n.as_u64().unwrap()).collect();
    assert!(tiles[0] >= tiles[tiles.len() - 3] && tiles[1] == 0 && tiles[2] == 0, "{tiles:?}");
    let end = Instant::now() + Duration::from_millis(900);
    while Instant::now() < end {
        let heard = other.hear(Duration::from_millis(50));
        assert!(!matches!(&heard, Some(Heard::Text(text)) if text["type"] == "map"), "{heard:?}");
    }
}

#[test]
fn two_eyes_are_one_picture_and_at_rest_the_stereo_still() {
    let server = serve(&["--stereo", "side-by-side", "--convergence", "900"]);
    let mut client = Client::enter(&server, SIZE);
    assert_eq!(client.flying(SIZE)["settings"]["stereo"], "side-by-side");
    client.fly(7, 0.0);
    let exact = client.picture("the exact picture", |picture| picture.is_exact() && picture.id == 7);
    assert_eq!(exact.size, SIZE);
    let still = |how: &str, size: [u32; 2], more: &[&str]| {
        let folder = TestFolder::new(&format!("viewer-stereo-{how}"));
        let file = folder.join("a.png");
        let [x, y, z, heading, pitch, roll, vfov] = exact.pose;
        let pose = [format!("--eye={x},{y},{z}"), format!("--heading={heading}"), format!("--pitch={pitch}")];
        let rest = [format!("--roll={roll}"), format!("--vfov={vfov}"), format!("--size={}x{}", size[0], size[1])];
        let command = Terravision::verb("still").arg(synth_world(512).database()).args(pose).args(rest).args(RAYS);
        command.args(["--stereo", how]).args(more).arg("-o").arg(&file).succeed();
        std::fs::read(&file).unwrap()
    };
    assert!(still("side-by-side", [SIZE[0] / 2, SIZE[1]], &["--convergence", "900"]) == exact.file);
    // The same column of both halves shows ground at about the same place.
    let mut pick = |u: f64| {
        client.say(&json!({"type": "pick", "id": 1, "u": u, "v": 0.7}));
        let picked = client.text("picked");
        [0, 1].map(|axis| picked["point"][axis].as_f64().unwrap())
    };
    let ([left, right], apart) = ([pick(0.25), pick(0.75)], 900.0 / 30.0);
    let between = (left[0] - right[0]).hypot(left[1] - right[1]);
    assert!(between < 2.0 * apart, "{left:?} {right:?}");
    // Other numbers start the flight again; without stereo it is one picture.
    client.say(&json!({"type": "settings", "stereo": "anaglyph", "eye_separation": 20}));
    let exact = client.picture("an exact anaglyph", |picture| picture.is_exact() && picture.flight > exact.flight);
    let flags = ["--convergence", "900", "--eye-separation", "20"];
    assert!(still("anaglyph", SIZE, &flags) == exact.file, "it is not the still's");
    assert_eq!(client.refused(r#"{"type":"settings","eye_separation":901}"#), "bad-settings");
    let [x, y, z, heading, pitch, roll, vfov] = exact.pose;
    let query = format!("x={x}&y={y}&z={z}&heading={heading}&pitch={pitch}&roll={roll}&vfov={vfov}");
    assert!(server.get(&format!("/api/still.png?{query}&stereo=1")).body == exact.file);
    assert!(server.get(&format!("/api/still.png?{query}")).body != exact.file);
    client.say(&json!({"type": "settings", "stereo": "off"}));
    client.picture("one eye", |picture| picture.flight > exact.flight);
}

#[test]
fn a_flight_that_nobody_sees_rests_and_is_there_again_for_the_next() {
    let server = serve(&["--rest-after", "0.5"]);
    let mut client = Client::enter(&server, SIZE);
    client.flying(SIZE);
    client.fly(3, 25.0);
    let before = client.picture("a picture", |picture| picture.id == 3);
    drop(client);
    let is_flying = || {
        let children = terravision_tests::process::children_of(server.pid());
        children.iter().any(|(_, name)| name == "terravision")
    };
    until("a flight that rests", || (!is_flying()).then_some(()));
    // What needs no flight is answered meanwhile.
    assert_eq!(server.ask("POST", "/api/heights", &[], b"[[0,0]]").json(), json!([null]));
    let mut client = Client::enter(&server, SIZE);
    let after = client.picture("a picture of the next flight", |picture| picture.flight > before.flight);
    assert_eq!(after.pose, before.pose);
}

#[test]
fn twenty_errors_end_a_session() {
    let server = serve(&[]);
    let mut client = Client::enter(&server, SIZE);
    (0..19).for_each(|_| assert_eq!(client.refused("{}"), "malformed"));
    client.say_text("{}");
    assert_eq!(client.text("bye")["code"], "too-many-errors");
}
