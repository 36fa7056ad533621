//! Pictures as H.264, for clients over slow links.

use crate::client::{Client, IS_KEY, Picture, hello};
use crate::server::{Server, until};
use crate::{RAYS, serve};
use serde_json::json;
use std::os::unix::fs::PermissionsExt;
use std::time::Duration;
use terravision_tests::folder::TestFolder;
use terravision_tests::process::{children_of, is_alive};
use terravision_tests::worlds::synth_world;

const SIZE: [u32; 2] = [640, 360];
/// Pictures after which it is video, at the latest.
const SOON: u32 = 14;

/// Takes moving pictures as a client does whose link needs a quarter of a second for each, until one
/// is what is looked for.
fn slowly(client: &mut Client, is_it: impl Fn(&Picture) -> bool) -> Option<Picture> {
    for id in 1..=SOON {
        client.fly(id, f64::from(id));
        let picture = client.picture("a picture", |_| true);
        if is_it(&picture) {
            return Some(picture);
        }
        std::thread::sleep(Duration::from_millis(250));
        // The next one is to be of a camera that moves.
        client.fly(SOON + id, f64::from(id) + 0.5);
        std::thread::sleep(Duration::from_millis(60));
        client.acknowledge_picture(picture.n);
    }
    None
}

/// A client that decodes video, and acknowledges when it is told to.
fn enter(server: &Server) -> Client {
    let mut greeting = hello(SIZE);
    greeting["h264"] = json!(true);
    let mut client = Client::enter_with(server, greeting);
    client.flying(SIZE);
    client.acknowledge(false);
    client
}

/// The encoders of a viewer.
fn encoders(viewer: u32) -> Vec<u32> {
    children_of(viewer).into_iter().filter(|(_, name)| name == "ffmpeg").map(|(pid, _)| pid).collect()
}

#[test]
fn a_client_over_a_slow_link_is_sent_video_until_it_cannot_decode_it() {
    let server = serve(&["--fps", "20"]);
    let mut client = enter(&server);
    let first = slowly(&mut client, |picture| picture.is_video).unwrap();
    let length = u32::from_le_bytes(first.file[..4].try_into().unwrap()) as usize;
    // A configuration of constrained baseline, and a key picture.
    let config = &first.file[4..4 + length];
    assert_eq!((config[0], config[1], config[2] & 0x40, first.flags & IS_KEY, first.quality), (1, 66, 0x40, IS_KEY, 0));
    assert!(first.file.len() > 4 + length + 100 && first.size == SIZE);
    client.say(&json!({"type": "ack", "n": first.n, "ms": 3}));
    let second = slowly(&mut client, |picture| picture.is_video && picture.n > first.n).unwrap();
    assert_eq!((&second.file[..4], second.flags & IS_KEY), (&[0; 4][..], 0));
    assert!(second.file.len() < first.file.len(), "{} and {} bytes", first.file.len(), second.file.len());
    client.say(&json!({"type": "ack", "n": second.n, "failed": true}));
    let jpeg = slowly(&mut client, |picture| picture.n > second.n && picture.quality == 75).unwrap();
    assert!(!jpeg.is_video && jpeg.file.starts_with(&[0xff, 0xd8]));
}

#[test]
fn a_client_that_does_not_decode_video_is_sent_none() {
    let server = serve(&["--fps", "20"]);
    let mut client = Client::enter(&server, SIZE);
    client.flying(SIZE);
    client.acknowledge(false);
    assert!(slowly(&mut client, |picture| picture.is_video).is_none());
}

#[test]
fn an_encoder_ends_with_its_client_and_with_the_server() {
    let server = serve(&["--fps", "20"]);
    let viewer = server.child_named("terravision-viewer");
    let mut client = enter(&server);
    slowly(&mut client, |picture| picture.is_video).unwrap();
    assert_eq!(encoders(viewer).len(), 1);
    drop(client);
    until("the end of the client's encoder", || encoders(viewer).is_empty().then_some(()));
    let mut client = enter(&server);
    slowly(&mut client, |picture| picture.is_video).unwrap();
    let encoder = encoders(viewer)[0];
    Server::kill(viewer);
    until("the end of the encoder of a server that was killed", || (!is_alive(encoder)).then_some(()));
}

#[test]
fn without_an_encoder_pictures_stay_jpeg_and_the_client_is_told_once() {
    let folder = TestFolder::new("no-h264");
    let script = "#!/bin/sh\ncat > /dev/null &\necho \"Unknown encoder 'libx264'\" >&2\nexit 1\n";
    std::fs::write(folder.join("ffmpeg"), script).unwrap();
    std::fs::set_permissions(folder.join("ffmpeg"), std::fs::Permissions::from_mode(0o755)).unwrap();
    let other = format!("{}:{}", folder.path().display(), std::env::var("PATH").unwrap());
    let without = "ffmpeg is not installed on the server".to_owned();
    let refused = "ffmpeg of the server does not encode H.264: Unknown encoder 'libx264'".to_owned();
    for (path, reason) in [("/nonexistent".to_owned(), without), (other, refused)] {
        let flags = [&RAYS[..], &["--fps", "20"]].concat();
        let server = Server::start_with_path(&synth_world(512).database(), &flags, &path);
        let mut client = enter(&server);
        assert!(slowly(&mut client, |picture| picture.is_video).is_none());
        let told: Vec<String> = client.notices.iter().filter(|text| text.contains("JPEG")).cloned().collect();
        assert_eq!(told, [format!("the link is slow, and pictures stay JPEG: {reason}")]);
    }
}
