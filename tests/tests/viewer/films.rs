//! Films and path files: asked for over HTTP, told of over the WebSocket.

use crate::client::{Client, Heard};
use crate::server::{Server, until};
use crate::{RAYS, SIZE, serve};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use terravision_tests::folder::TestFolder;
use terravision_tests::process::Terravision;
use terravision_tests::worlds::synth_world;

/// A way of this many seconds over the middle of the world.
fn path(seconds: f64) -> Value {
    let world = synth_world(512);
    let key = |t: f64, east: f64| {
        let [x, y, z] = world.above(east, 0.3, 400.0);
        json!({"t": t, "x": x, "y": y, "z": z, "heading": 10.0, "pitch": -20.0})
    };
    let mut keyframes = [key(0.0, 0.4), key(seconds, 0.6)];
    keyframes[0]["rest"] = json!(true);
    let [x, y, z] = world.above(0.5, 0.8, 0.0);
    json!({"keyframes": keyframes, "target": [x, y, z]})
}

fn order(path: &Value) -> Vec<u8> {
    json!({"name": "a film", "size": [160, 90], "fps": 10, "path": path}).to_string().into_bytes()
}

/// The next `films` in which there is a film like this, or none at all.
fn film(client: &mut Client, what: &str, is_it: impl Fn(Option<&Value>) -> bool) -> Value {
    client.until(what, |_, heard| match heard {
        Heard::Text(text) if text["type"] == "films" && is_it(text["films"].as_array()?.last()) => Some(text),
        _ => None,
    })
}

fn is_in_state(state: &str) -> impl Fn(Option<&Value>) -> bool {
    move |film| film.is_some_and(|film| film["state"] == state)
}

/// Folder of the films of a server.
fn folder_of(server: &Server) -> PathBuf {
    std::env::temp_dir().join(format!("terravision-serve-{}-0/films", server.pid()))
}

fn files_in(folder: &Path) -> Vec<PathBuf> {
    std::fs::read_dir(folder).into_iter().flatten().map(|entry| entry.unwrap().path()).collect()
}

#[test]
fn a_film_is_that_of_the_same_path_flown_and_can_be_cancelled() {
    let server = serve(&[]);
    let mut client = Client::enter(&server, SIZE);
    let ordered = server.ask("POST", "/api/films", &[], &order(&path(1.0)));
    assert_eq!((ordered.status, ordered.json()), (202, json!({"id": 1})));
    let done = film(&mut client, "the film", is_in_state("done"));
    let bytes = done["films"][0]["bytes"].as_u64().unwrap();
    assert!(done["bytes"].as_u64().unwrap() >= bytes && bytes > 1000, "{done}");
    let answer = server.get("/api/films/1.mp4");
    assert!(answer.head.contains("attachment; filename=\"a-film.mp4\""), "{}", answer.head);
    assert_eq!((answer.status, answer.body.len() as u64, &answer.body[4..8]), (200, bytes, &b"ftyp"[..]));
    let folder = TestFolder::new("viewer-film");
    let (file, own) = (folder.join("path.json"), folder.join("own.mp4"));
    std::fs::write(&file, path(1.0).to_string()).unwrap();
    let flags = ["--size", "160x90", "--fps", "10"];
    let fly = Terravision::verb("fly");
    fly.arg(synth_world(512).database()).arg("--path").arg(&file).args(flags).args(RAYS).arg("-o").arg(&own).succeed();
    assert!(std::fs::read(&own).unwrap() == answer.body, "the film is not that of the path");

    // A long one: it tells how far it is, no other is begun, and nothing is left when it is cancelled.
    let ordered = server.ask("POST", "/api/films", &[], &order(&path(500.0)));
    assert_eq!(ordered.json(), json!({"id": 2}));
    let drawing = film(&mut client, "progress", |film| film.is_some_and(|film| film["frames"] == 5001));
    assert_eq!(drawing["films"].as_array().unwrap().len(), 2);
    assert_eq!(server.ask("POST", "/api/films", &[], &order(&path(1.0))).code(), "busy");
    assert_eq!(server.get("/api/films/2.mp4").code(), "not-found");
    assert_eq!(server.ask("DELETE", "/api/films/2", &[], b"").status, 204);
    film(&mut client, "the end of the second", |film| film.is_some_and(|film| film["id"] == 1));
    until("a folder without halves", || (files_in(&folder_of(&server)).len() == 2).then_some(()));
    assert_eq!(server.ask("DELETE", "/api/films/1", &[], b"").status, 204);
    assert!(film(&mut client, "an empty list", |film| film.is_none())["bytes"] == 0);
    assert_eq!(server.ask("DELETE", "/api/films/1", &[], b"").code(), "not-found");
    let foreign = [("Origin", "http://example.org")];
    assert_eq!(server.ask("DELETE", "/api/films/1", &foreign, b"").code(), "wrong-origin");

    // A server that ends leaves nothing of a film that is being made.
    server.ask("POST", "/api/films", &[], &order(&path(500.0)));
    film(&mut client, "progress", |film| film.is_some_and(|film| film["drawn"].as_u64() > Some(0)));
    let pid = server.pid();
    assert_eq!(server.end().code(), Some(0));
    assert_eq!(Server::traces(pid), Vec::<PathBuf>::new());
}

#[test]
fn a_viewer_that_dies_leaves_whole_films_and_no_halves() {
    let server = serve(&[]);
    server.ask("POST", "/api/films", &[], &order(&path(0.5)));
    let mut client = Client::enter(&server, SIZE);
    film(&mut client, "the film", is_in_state("done"));
    server.ask("POST", "/api/films", &[], &order(&path(500.0)));
    film(&mut client, "progress", |film| film.is_some_and(|film| film["drawn"].as_u64() > Some(0)));
    Server::kill(server.child_named("terravision-viewer"));
    client.until("the end", |_, heard| matches!(heard, Heard::Closed).then_some(()));
    let mut client = Client::enter(&server, SIZE);
    let kept = film(&mut client, "the list", |film| film.is_some());
    assert_eq!((kept["films"].as_array().unwrap().len(), &kept["films"][0]["id"]), (1, &json!(1)));
    until("a folder without halves", || (files_in(&folder_of(&server)).len() == 2).then_some(()));
    assert_eq!(server.get("/api/films/1.mp4").status, 200);
}

#[test]
fn what_cannot_become_a_film_is_told_in_a_sentence() {
    let server = serve(&["--film-bytes", "30000"]);
    let mut client = Client::enter(&server, SIZE);
    let mut told = |path: &Value| {
        assert_eq!(server.ask("POST", "/api/films", &[], &order(path)).status, 202);
        let failed = film(&mut client, "a failure", is_in_state("failed"));
        let id = failed["films"][0]["id"].as_u64().unwrap();
        assert_eq!(server.ask("DELETE", &format!("/api/films/{id}"), &[], b"").status, 204);
        film(&mut client, "an empty list", |film| film.is_none());
        assert_eq!(files_in(&folder_of(&server)), Vec::<PathBuf>::new());
        failed["films"][0]["text"].as_str().unwrap().to_owned()
    };
    let text = told(&json!({"keyframes": [{"t": 0, "x": 1, "y": 2, "z": 3, "heading": 0, "pitch": "down"}]}));
    assert!(text.starts_with("the path: keyframe 0: \"pitch\": expected degrees"), "{text}");
    let text = told(&path(60.0));
    assert!(text.contains("more than the 30.0 kB that films may take here"), "{text}");
    for (body, code) in [("{}", "bad-request"), (r#"{"size":[160,90],"path":7}"#, "bad-path")] {
        assert_eq!(server.ask("POST", "/api/films", &[], body.as_bytes()).code(), code);
    }
    let watched = serve(&["--read-only"]);
    assert_eq!(watched.ask("POST", "/api/films", &[], &order(&path(1.0))).code(), "read-only");

    let server = Server::start_with_path(&synth_world(512).database(), &RAYS, "/nonexistent");
    let mut client = Client::enter(&server, SIZE);
    server.ask("POST", "/api/films", &[], &order(&path(1.0)));
    let failed = film(&mut client, "a failure", is_in_state("failed"));
    let text = failed["films"][0]["text"].as_str().unwrap();
    assert!(text.contains("ffmpeg makes the film and is not installed"), "{text}");
}

#[test]
fn path_files_come_back_as_keyframes_or_with_line_and_reason() {
    let server = serve(&[]);
    let post = |name: &str, text: &str| server.ask("POST", &format!("/api/path?name={name}"), &[], text.as_bytes());
    let read = post("a.json", &path(4.0).to_string()).json();
    assert_eq!((&read["keyframes"][0]["rest"], &read["target"]), (&json!(true), &path(4.0)["target"]));
    assert_eq!(read["keyframes"][1]["x"], path(4.0)["keyframes"][1]["x"]);
    let view = |lon: f64| {
        format!(
            "<gx:FlyTo><gx:duration>3</gx:duration><gx:flyToMode>smooth</gx:flyToMode><Camera><longitude>{lon}</longitude>\
             <latitude>46.9</latitude><altitude>2500</altitude><tilt>70</tilt><altitudeMode>absolute</altitudeMode></Camera></gx:FlyTo>"
        )
    };
    let tour = format!("<kml><gx:Tour><gx:Playlist>{}{}</gx:Playlist></gx:Tour></kml>", view(9.0), view(9.01));
    let read = post("tour.kml", &tour).json();
    let keyframes = read["keyframes"].as_array().unwrap();
    assert_eq!((keyframes.len(), &keyframes[1]["t"], &keyframes[1]["z"]), (2, &json!(3.0), &json!(2500.0)));
    let camera = json!([{"id": "document", "version": "1.0"}, {
        "id": "camera",
        "position": {"cartographicDegrees": [0, 9.0, 46.9, 2500, 3, 9.01, 46.9, 2500]},
        "orientation": {"unitQuaternion": [0.5, 0.5, 0.5, 0.5]},
    }]);
    let read = post("tour.czml", &camera.to_string()).json();
    let of_czml = read["keyframes"].as_array().unwrap();
    assert_eq!((of_czml.len(), &of_czml[1]["t"], &of_czml[1]["x"]), (2, &json!(3.0), &keyframes[1]["x"]));
    let line = json!({"type": "LineString", "coordinates": [[9.0, 46.9], [9.01, 46.9]]});
    let read = post("line.geojson", &line.to_string()).json();
    assert!(read["keyframes"].as_array().unwrap().len() > 10, "{read}");
    // What of a file is not flown is told to who looks.
    let mut client = Client::enter(&server, SIZE);
    post("two.kml", &tour.replace("<gx:Playlist>", "<gx:Playlist><gx:SoundCue/>"));
    let notice = client.until("a notice of the path", |_, heard| match heard {
        Heard::Text(value) if value["text"].as_str().is_some_and(|text| text.starts_with("two.kml")) => Some(value),
        _ => None,
    });
    let expected = "two.kml: of the tour only the camera's way is flown, without its 1 sound";
    assert_eq!((&notice["level"], &notice["text"]), (&json!("info"), &json!(expected)));
    let refused = |name: &str, text: &str| {
        let answer = post(name, text);
        assert_eq!((answer.status, answer.code().as_str()), (400, "bad-path"));
        answer.json()["error"]["text"].as_str().unwrap().to_owned()
    };
    let text = refused("my%20tour.kml", "<kml>\n<a></kml>");
    assert!(text.contains("my tour.kml is not valid XML: line 2: expected </a>"), "{text}");
    let text = refused("bad.json", "{\"keyframes\": [\n{\"t\": 0,,}]}");
    assert!(text.contains("bad.json is not valid JSON") && text.contains("line 2"), "{text}");
    let text = refused("bad.czml", &camera.to_string().replace("2500", "\"x\""));
    assert!(text.contains("bad.czml: packet \"camera\": position: ") && text.contains("sample 0: expected a number"));
    let text = refused("", "hello");
    assert!(text.starts_with("the path is not a camera path") && !text.contains("upload"), "{text}");
}
