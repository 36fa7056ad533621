//! What a desktop does to a window: it fills the screen, has pixels of another size, or takes away
//! what pictures are shown on.

use super::screen::{Look, Screen, has_server};
use super::{Flight, SIZE, view};
use std::time::Duration;

const ESCAPE: u32 = 0xff1b;
const F11: u32 = 0xffc8;
const W: u32 = 0x77;

#[test]
fn a_window_fills_the_screen_and_comes_back() {
    if !has_server() {
        return;
    }
    let flight = Flight::start(&[]);
    flight.screen.manage_windows();
    for key in [F11, ESCAPE, F11, F11] {
        flight.screen.tap(key);
        let is_full = flight.screen.answer_full_screen(flight.window, SIZE);
        let size = if is_full { [1280, 800] } else { SIZE };
        flight.screen.until("its size", || (flight.pose().size == size).then_some(()));
        flight.look_until("a picture of that size", |look| look.size == size && look.is_filled());
    }
    flight.ends(|flight| flight.screen.close(flight.window));
}

#[test]
fn pixels_of_another_size_make_a_picture_of_more_of_them() {
    if !has_server() {
        return;
    }
    // A desktop that says how large its pixels are, and changes its mind.
    let screen = Screen::start([1280, 800]);
    screen.set_density(96, &[]);
    let flight = Flight::begin(screen, view(&[]).env("WINIT_X11_SCALE_FACTOR", ""));
    assert_eq!(flight.pose().size, SIZE);
    flight.screen.set_density(192, &[flight.window]);
    let double = SIZE.map(|side| 2 * side);
    flight.screen.until("a larger picture", || (flight.pose().size == double).then_some(()));
    flight.look_until("a picture of that size", |look| look.size == double && look.is_filled());
    // Hands hold the same ground: their pixels are the desktop's.
    let before = flight.pose();
    flight.moves("a flight ahead", |screen| screen.hold(W, Duration::from_millis(200)));
    assert!(flight.pose().position[2] < before.position[2]);
    flight.screen.set_density(96, &[flight.window]);
    flight.screen.until("a smaller picture", || (flight.pose().size == SIZE).then_some(()));
    flight.look_until("a picture of that size", |look| look.size == SIZE && look.is_filled());
    flight.ends(|flight| flight.screen.close(flight.window));
}

/// The desktop's answers are replaced; what is made anew is real, and the validation layer looks on.
#[test]
fn whatever_is_lost_is_made_anew() {
    if !has_server() {
        return;
    }
    let faults = "acquire 4 out-of-date, present 6 out-of-date, acquire 8 surface-lost, present 10 surface-lost, acquire 12 timeout, \
        acquire 14 device-lost, present 16 device-lost, acquire 18 surface-lost, acquire 19 surface-lost, acquire 20 surface-lost";
    for technique in ["rays", "mesh"] {
        let command = view(&["--technique", technique, "--log", "terravision_renderer=debug"]);
        let flight = Flight::begin(Screen::start([1280, 800]), command.env("TERRAVISION_TEST_WINDOW_FAULTS", faults));
        // Each picture of a new camera is one more.
        for way in 0..6 {
            flight.moves("a flight ahead", |screen| screen.hold(W, Duration::from_millis(150 + way)));
        }
        flight.screen.resize(flight.window, [500, 400]);
        flight.look_until("a picture of another size", |look| look.size == [500, 400] && look.is_filled());
        flight.screen.close(flight.window);
        let finished = flight.running.wait();
        finished.assert_code(0);
        let said = |what: &str| finished.stderr.matches(what).count();
        let found = ["is_surface=false", "is_surface=true", "a picture was not shown"].map(said);
        assert!(found[0] >= 2 && found[1] == 5 && found[2] == 2, "{technique}: {found:?}: {}", finished.stderr);
    }
}

#[test]
fn a_device_that_is_lost_is_opened_again_for_window_and_pictures() {
    if !has_server() {
        return;
    }
    let command = view(&["--technique", "mesh"]).env("TERRAVISION_TEST_LOSE_DEVICE_AT", "20");
    let flight = Flight::begin(Screen::start([1280, 800]), command);
    let before = flight.pose();
    for _ in 0..4 {
        flight.moves("a flight ahead", |screen| screen.hold(W, Duration::from_millis(200)));
    }
    flight.look_until("a picture", Look::is_filled);
    assert!(flight.pose().position != before.position);
    flight.screen.close(flight.window);
    let finished = flight.running.wait();
    finished.assert_code(0);
    assert!(finished.stderr.contains("lost"), "{}", finished.stderr);
}
