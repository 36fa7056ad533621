//! `terravision view` on a screen that nobody sees: hands move the camera, the window changes its
//! size, and closing it leaves nothing.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

mod desktop;
mod paths;
mod picture;
mod screen;
mod wayland;

use screen::{Look, Screen, has_server};
use std::time::Duration;
use terravision_common::shm::{PoseRecord, PoseSender, SharedName};
use terravision_tests::flight::Pose;
use terravision_tests::live::left_of;
use terravision_tests::process::{Running, Terravision, segments_of_launcher, signal_process};
use terravision_tests::shot::Shot;
use terravision_tests::worlds::synth_world;

/// Keysyms.
const W: u32 = 0x77;
const Q: u32 = 0x71;
const T: u32 = 0x74;
const R: u32 = 0x72;
const F1: u32 = 0xffbe;
const RIGHT: u32 = 0xff53;
const SHIFT: u32 = 0xffe1;
const CONTROL: u32 = 0xffe3;
/// Buttons.
const LEFT: u8 = 1;
const WHEEL_UP: u8 = 4;

const SIZE: [u32; 2] = [640, 360];

/// A window that flies.
struct Flight {
    running: Running,
    screen: Screen,
    window: u32,
    poses: PoseSender,
    name: SharedName,
}

impl Flight {
    fn start(flags: &[&str]) -> Self {
        Self::begin(Screen::start([1280, 800]), view(flags))
    }

    /// On this screen, by this command.
    fn begin(screen: Screen, command: Terravision) -> Self {
        let command = command.env("DISPLAY", &screen.name);
        let flight = Self::open(screen, command, "TerraVision");
        flight.look_until("a picture", Look::is_filled);
        flight
    }

    /// By this command, in what this screen shows as a window of that name.
    fn open(screen: Screen, command: Terravision, title: &str) -> Self {
        let mut running = command.spawn();
        let name = SharedName::parse(&format!("view-{}", running.pid())).unwrap();
        let poses = running.until("the segment of poses", |_| PoseSender::open(&name).ok());
        let window = screen.window(title);
        Self { running, screen, window, poses, name }
    }

    fn look(&self) -> Look {
        self.screen.until("what the window shows", || self.screen.look(self.window))
    }

    fn look_until(&self, what: &str, is_it: impl Fn(&Look) -> bool) -> Look {
        self.screen.until(what, || self.screen.look(self.window).filter(|look| is_it(look)))
    }

    fn pose(&self) -> PoseRecord {
        self.screen.until("a pose", || self.poses.newest())
    }

    /// Does something, and waits until pose and picture have changed.
    fn moves(&self, what: &str, action: impl FnOnce(&Screen)) -> PoseRecord {
        let (before, shown) = (self.pose(), self.look());
        action(&self.screen);
        let pose = self.screen.until(what, || Some(self.pose()).filter(|pose| pose.position != before.position));
        self.look_until(what, |look| look.difference(&shown.rgb) > 0.5);
        pose
    }

    /// Closes it: it ends in order, and leaves nothing.
    fn ends(self, close: impl FnOnce(&Self)) {
        close(&self);
        let Self { running, screen, window, name, .. } = self;
        let finished = running.wait();
        finished.assert_code(0);
        finished.assert_no_warning();
        assert!(!screen.is_there(window));
        assert!(left_of(&name).is_empty() && segments_of_launcher(finished.pid).is_empty());
    }
}

fn view(flags: &[&str]) -> Terravision {
    Terravision::verb("view")
        .arg(synth_world(1024).database())
        .args(["--size", "640x360", "--validation"])
        .args(flags)
        // Neither a desktop of who runs this, nor its scale.
        .env("WAYLAND_DISPLAY", "")
        .env("WINIT_X11_SCALE_FACTOR", "1")
}

/// By the device that draws, whose pictures stay there, and by the processor, whose are uploaded.
#[test]
fn hands_move_the_camera_and_the_window_follows() {
    if !has_server() {
        return;
    }
    for technique in ["rays", "mesh"] {
        let flight = Flight::start(&["--technique", technique]);
        flight.look().save(&format!("view-{technique}.png"));
        let start = flight.pose();
        assert_eq!(start.size, SIZE);
        let flown = flight.moves("a flight ahead", |screen| screen.hold(W, Duration::from_millis(400)));
        assert!(flown.position[2] < start.position[2], "the camera looks down, and flies there");
        let turned = flight.moves("a turn", |screen| {
            screen.press(SHIFT);
            screen.hold(RIGHT, Duration::from_millis(300));
            screen.release(SHIFT);
        });
        assert!(turned.heading_deg != flown.heading_deg);
        flight.moves("a drag", |screen| {
            screen.point([320, 250]);
            screen.button(LEFT, true);
            std::thread::sleep(Duration::from_millis(100));
            screen.point([380, 280]);
            screen.point([400, 290]);
            screen.button(LEFT, false);
        });
        let zoomed = flight.moves("a zoom", |screen| (0..3).for_each(|_| screen.click(WHEEL_UP)));
        assert!(zoomed.position[2] < turned.position[2]);
        // What is shown is what a still shows from there.
        std::thread::sleep(Duration::from_millis(1500));
        let PoseRecord { position, heading_deg, pitch_deg, .. } = flight.pose();
        let pose = Pose::new(position, heading_deg, pitch_deg);
        let world = synth_world(1024);
        let shot = Shot { size: SIZE, ..Shot::new(&world, pose) }.take(&["--technique", technique], false);
        let difference = flight.look().difference(&shot.rgb);
        println!("{technique}: {difference:.2} levels from a still");
        assert!(difference < 6.0, "{difference} levels");
        // The keys in the title bar, line by line, and away again.
        let titled = |what: &str| {
            flight.screen.until(what, || flight.screen.title(flight.window).contains(what).then_some(()));
        };
        flight.screen.tap(F1);
        titled("drag: hold the ground");
        titled("wheel, + and -: zoom");
        flight.screen.tap(F1);
        titled("m above ground");
        // The tree over the picture, and away again.
        let plain = flight.look();
        flight.screen.tap(T);
        let overlaid = flight.look_until("the tree", |look| look.difference(&plain.rgb) > 1.0);
        overlaid.save(&format!("view-{technique}-tree.png"));
        flight.screen.tap(T);
        flight.look_until("the picture without the tree", |look| look.difference(&plain.rgb) < 1.0);
        flight.ends(|flight| flight.screen.close(flight.window));
    }
}

#[test]
fn the_picture_is_as_large_as_its_window() {
    if !has_server() {
        return;
    }
    for technique in ["rays", "mesh"] {
        let flight = Flight::start(&["--technique", technique, "--vsync", "off"]);
        for size in [[900, 500], [300, 640], [64, 48], [1280, 800]] {
            flight.screen.resize(flight.window, size);
            flight.screen.until("the new size", || (flight.pose().size == size).then_some(()));
            let look = flight.look_until("a picture of that size", |look| look.size == size && look.is_filled());
            look.save(&format!("view-{technique}-{}x{}.png", size[0], size[1]));
        }
        // Many sizes in a row, as a person who drags a corner makes them.
        for step in 0..40 {
            flight.screen.resize(flight.window, [640 + 7 * step, 360 + 5 * step]);
            std::thread::sleep(Duration::from_millis(10));
        }
        flight.screen.until("the last size", || (flight.pose().size == [913, 555]).then_some(()));
        flight.look_until("a picture of the last size", |look| look.size == [913, 555] && look.is_filled());
        flight.ends(|flight| {
            flight.screen.press(CONTROL);
            flight.screen.tap(Q);
            flight.screen.release(CONTROL);
        });
    }
}

#[test]
fn from_beside_the_world_its_walls_are_shown() {
    if !has_server() {
        return;
    }
    let flight = Flight::start(&["--technique", "mesh"]);
    // Back and down, beside the world's border: what is drawn over by the processor is uploaded.
    let world = synth_world(1024);
    let [x, y, z] = world.above(0.5, 0.0, 1000.0);
    let beside = PoseRecord { position: [x, y - 3000.0, z], heading_deg: 0.0, pitch_deg: -15.0, ..flight.pose() };
    flight.poses.send(&PoseRecord { time_s: beside.time_s + 1000.0, ..beside });
    let wall = |look: &Look| look.rgb.iter().filter(|rgb| **rgb == [122, 108, 94]).count();
    let look = flight.look_until("a wall", |look| wall(look) > 500);
    look.save("view-walls.png");
    flight.ends(|flight| flight.screen.close(flight.window));
}

#[test]
fn a_renderer_that_is_killed_comes_back_with_its_window() {
    if !has_server() {
        return;
    }
    let mut flight = Flight::start(&[]);
    flight.moves("a flight ahead", |screen| screen.hold(W, Duration::from_millis(300)));
    std::thread::sleep(Duration::from_millis(300));
    let flown = flight.pose();
    let renderer = flight.running.stage("renderer");
    signal_process(renderer, rustix::process::Signal::KILL);
    // The next one may have its number.
    flight.screen.until("the end of its window", || (!flight.screen.is_there(flight.window)).then_some(()));
    flight.window = flight.screen.window("TerraVision");
    flight.look_until("a picture", Look::is_filled);
    assert_eq!(flight.pose().position, flown.position, "the camera is where it was");
    flight.screen.tap(R);
    let screen = &flight.screen;
    screen.until("the way back", || (flight.pose().position != flown.position).then_some(()));
    flight.screen.close(flight.window);
    let finished = flight.running.wait();
    finished.assert_code(0);
    assert!(finished.stderr.contains("started again"), "{}", finished.stderr);
    assert!(left_of(&flight.name).is_empty());
}

#[test]
fn a_window_whose_processes_are_all_told_to_end_ends() {
    if !has_server() {
        return;
    }
    let mut flight = Flight::start(&[]);
    let stages = ["generator", "prefetcher", "preparer", "renderer"].map(|stage| flight.running.stage(stage));
    for pid in [flight.running.pid()].iter().chain(&stages) {
        signal_process(*pid, rustix::process::Signal::TERM);
    }
    let finished = flight.running.wait();
    assert!(!finished.stderr.contains("started again"), "{}", finished.stderr);
    assert!(left_of(&flight.name).is_empty() && segments_of_launcher(finished.pid).is_empty());
}

#[test]
fn a_display_that_is_gone_ends_the_flight_at_the_second_try() {
    if !has_server() {
        return;
    }
    let mut flight = Flight::start(&[]);
    flight.screen.kill();
    let finished = flight.running.wait();
    finished.assert_code(2);
    let last = finished.stderr.trim().lines().next_back().unwrap();
    assert!(last.starts_with("terravision: the renderer gave up: there is no display for a window ("), "{last}");
    assert_eq!(finished.stderr.matches("started again").count(), 2, "{}", finished.stderr);
    assert!(left_of(&flight.name).is_empty() && segments_of_launcher(finished.pid).is_empty());
}

#[test]
fn without_a_display_there_is_a_sentence() {
    let finished = view(&[]).env("DISPLAY", "").run();
    finished.assert_code(1);
    let said = finished.stderr.trim();
    assert!(said.starts_with("terravision: there is no display for a window (") && said.lines().count() == 1, "{said}");
    let finished = view(&[]).env("DISPLAY", ":4711").run();
    finished.assert_code(1);
    assert_eq!(finished.stderr.trim().lines().count(), 1, "{}", finished.stderr);
}

#[test]
fn without_a_device_that_shows_windows_there_is_a_sentence() {
    if !has_server() {
        return;
    }
    let screen = Screen::start([640, 480]);
    let finished = view(&[]).env("DISPLAY", &screen.name).env("VK_ICD_FILENAMES", "/nowhere.json").run();
    finished.assert_code(1);
    let said = finished.stderr.trim();
    assert!(said.starts_with("terravision: no Vulkan device was found") && said.lines().count() == 1, "{said}");
}
