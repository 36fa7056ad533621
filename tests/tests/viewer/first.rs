//! A client that comes while the viewer starts: the launcher is played by the test.

use crate::SIZE;
use crate::client::Client;
use crate::server::{DEADLINE, Server};
use serde_json::json;
use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::process::Command;
use std::time::Duration;
use terravision_common::run::DatabaseConfig;
use terravision_common::viewer::{
    FlightState, FlightStatus, FromViewer, StreamSettings, ToViewer, ViewerPose, ViewerSetup,
};
use terravision_tests::folder::TestFolder;
use terravision_tests::process::binary;
use terravision_tests::worlds::synth_world;

/// Longer than the server needs to let a client in.
const HEAD_START: Duration = Duration::from_millis(400);

fn tell(viewer: &mut UnixStream, message: &ToViewer) {
    viewer.write_all(format!("{}\n", serde_json::to_string(message).unwrap()).as_bytes()).unwrap();
}

fn setup(scratch: &TestFolder) -> ToViewer {
    ToViewer::Setup(Box::new(ViewerSetup {
        share: format!("first-{}", std::process::id()),
        world: "synth".into(),
        database: DatabaseConfig {
            location: synth_world(512).database().display().to_string(),
            cache: None,
            cache_bytes: 0,
            is_offline: true,
            request_timeout_ms: 1000,
            parallel_requests: 1,
        },
        still_flags: Vec::new(),
        database_flags: Vec::new(),
        programs: binary("terravision").parent().unwrap().to_owned(),
        scratch: scratch.path().to_owned(),
        film_bytes: 1,
        token: None,
        is_read_only: false,
        embedders: Vec::new(),
        start: ViewerPose { x: 0.0, y: 0.0, z: 900.0, heading: 0.0, pitch: -10.0, roll: 0.0, vfov: 60.0 },
        defaults: StreamSettings::default(),
    }))
}

#[test]
fn who_comes_before_the_flight_is_known_orders_none_by_other_settings() {
    let scratch = TestFolder::new("viewer-first");
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let (mut viewer, theirs) = UnixStream::pair().unwrap();
    let mut command = Command::new(binary("terravision-viewer"));
    command.stdin(OwnedFd::from(listener)).stdout(OwnedFd::from(theirs));
    let server = Server::played(command.spawn().unwrap(), port);
    drop(command);
    tell(&mut viewer, &setup(&scratch));
    std::thread::scope(|scope| {
        let client = scope.spawn(|| Client::enter(&server, SIZE));
        std::thread::sleep(HEAD_START);
        let settings = StreamSettings { stereo: Some("side-by-side".into()), ..StreamSettings::default() };
        tell(
            &mut viewer,
            &ToViewer::Flight(FlightStatus {
                number: 1,
                pid: std::process::id(),
                state: FlightState::Starting,
                reason: None,
                size: SIZE,
                settings: settings.clone(),
                metrics: None,
            }),
        );
        let client = client.join().unwrap();
        assert_eq!(client.state["settings"], json!(settings));
        // What the client's window orders is that flight, too.
        viewer.set_read_timeout(Some(DEADLINE)).unwrap();
        let order =
            BufReader::new(&viewer).lines().find_map(|line| match serde_json::from_str(&line.unwrap()).unwrap() {
                FromViewer::Fly { settings, .. } => Some(*settings),
                _ => None,
            });
        assert_eq!(order, Some(settings));
    });
}
