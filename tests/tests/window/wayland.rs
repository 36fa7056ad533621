//! The window on a desktop of Wayland: Weston, which has a screen of X11 that nobody sees for its
//! own, so that hands and eyes are those of the other tests.

use super::screen::{Look, Screen, has_program, has_server};
use super::{CONTROL, Flight, Q, SIZE, W, view};
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::Duration;
use terravision_tests::flight::Pose;
use terravision_tests::folder::TestFolder;
use terravision_tests::live::left_of;
use terravision_tests::process::{Finished, segments_of_launcher};
use terravision_tests::shot::Shot;
use terravision_tests::worlds::synth_world;

const ESCAPE: u32 = 0xff1b;
const F11: u32 = 0xffc8;
const DESKTOP: [u32; 2] = [1280, 800];
/// The sky of the default light.
const SKY: [u8; 3] = [150, 190, 235];

/// The desktop. It ends when this is dropped.
struct Weston {
    compositor: Child,
    folder: TestFolder,
}

impl Drop for Weston {
    fn drop(&mut self) {
        self.compositor.kill().ok();
        self.compositor.wait().ok();
    }
}

impl Weston {
    fn start(screen: &Screen) -> Self {
        let folder = TestFolder::new("weston");
        fs::set_permissions(folder.path(), Permissions::from_mode(0o700)).unwrap();
        let [width, height] = DESKTOP;
        let mut weston = Command::new("weston");
        weston
            .args(["--backend=x11-backend.so", "--use-pixman", "--no-config", "--idle-time=0", "--socket=desktop"])
            .args([format!("--width={width}"), format!("--height={height}")])
            .env("DISPLAY", &screen.name)
            .env("XDG_RUNTIME_DIR", folder.path())
            .env_remove("WAYLAND_DISPLAY")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        let weston = Self { compositor: weston.spawn().unwrap(), folder };
        screen.until("a desktop of Wayland", || weston.socket().exists().then_some(()));
        weston
    }

    fn socket(&self) -> PathBuf {
        self.folder.join("desktop")
    }

    fn kill(&mut self) {
        self.compositor.kill().unwrap();
        self.compositor.wait().unwrap();
    }
}

/// Whether there is such a desktop.
fn has_weston() -> bool {
    has_server() && has_program("weston", "--version")
}

/// A window on a desktop of its own.
fn start(flags: &[&str]) -> (Weston, Flight) {
    let screen = Screen::start(DESKTOP);
    let weston = Weston::start(&screen);
    let command = view(flags).env("WAYLAND_DISPLAY", weston.socket()).env("DISPLAY", "");
    let flight = Flight::open(screen, command, "Weston");
    flight.look_until("a picture", |look| look.rgb.iter().filter(|rgb| **rgb == SKY).count() > 5000);
    (weston, flight)
}

/// It has ended, and left nothing.
fn ends(flight: Flight) -> Finished {
    let finished = flight.running.wait();
    assert!(left_of(&flight.name).is_empty() && segments_of_launcher(finished.pid).is_empty());
    finished
}

#[test]
fn a_window_of_wayland_shows_what_hands_do() {
    if !has_weston() {
        return;
    }
    for technique in ["rays", "mesh"] {
        let (_weston, flight) = start(&["--technique", technique]);
        assert_eq!(flight.pose().size, SIZE);
        flight.look().save(&format!("view-wayland-{technique}.png"));
        flight.moves("a flight ahead", |screen| screen.hold(W, Duration::from_millis(400)));
        // As large as the desktop, and as before.
        let is_sized = |size: [u32; 2]| flight.screen.until("its size", || (flight.pose().size == size).then_some(()));
        flight.screen.tap(F11);
        is_sized(DESKTOP);
        std::thread::sleep(Duration::from_millis(1500));
        let pose = flight.pose();
        let pose = Pose::new(pose.position, pose.heading_deg, pose.pitch_deg);
        let world = synth_world(1024);
        let shot = Shot { size: DESKTOP, ..Shot::new(&world, pose) }.take(&["--technique", technique], false);
        let difference = flight.look_until("a picture", Look::is_filled).difference(&shot.rgb);
        assert!(difference < 6.0, "{technique}: {difference} levels from a still");
        flight.screen.tap(ESCAPE);
        is_sized(SIZE);
        flight.screen.press(CONTROL);
        flight.screen.tap(Q);
        flight.screen.release(CONTROL);
        let finished = ends(flight);
        finished.assert_code(0);
        finished.assert_no_warning();
    }
}

#[test]
fn a_desktop_that_dies_takes_the_flight_along() {
    if !has_weston() {
        return;
    }
    let (mut weston, flight) = start(&[]);
    weston.kill();
    let finished = ends(flight);
    assert!(finished.stderr.contains("the desktop has gone"), "{}", finished.stderr);
}

#[test]
fn a_desktop_that_is_not_there_is_told_in_a_sentence() {
    let folder = TestFolder::new("no-weston");
    let finished = view(&[]).env("WAYLAND_DISPLAY", folder.join("none")).env("DISPLAY", "").run();
    finished.assert_code(1);
    let said = finished.stderr.trim();
    assert!(said.starts_with("terravision: there is no display for a window (") && said.lines().count() == 1, "{said}");
    let finished = view(&[]).env("WAYLAND_DISPLAY", folder.join("none")).env("DISPLAY", ":4711").run();
    finished.assert_code(1);
    assert!(finished.stderr.contains("WAYLAND_DISPLAY is set: without it DISPLAY is used"), "{}", finished.stderr);
}
