//! What is in the picture: labels, two eyes.

use super::screen::{Look, has_server};
use super::{Flight, SIZE};
use terravision_common::shm::PoseRecord;
use terravision_tests::flight::Pose;
use terravision_tests::shot::Shot;
use terravision_tests::worlds::synth_world;

#[test]
fn labels_are_drawn_over_the_picture_in_the_window() {
    if !has_server() {
        return;
    }
    for technique in ["rays", "mesh"] {
        let labels = ["--label", "Test", "--scale-bar", "--north-arrow", "--clock", "--technique", technique];
        let flight = Flight::start(&labels);
        // White letters, in the corners where they belong.
        let white = |look: &Look, x: std::ops::Range<usize>, y: std::ops::Range<usize>| {
            let width = look.size[0] as usize;
            y.flat_map(|y| x.clone().map(move |x| y * width + x)).filter(|at| look.rgb[*at] == [255; 3]).count()
        };
        let look = flight.look_until("labels", |look| {
            let corners = [(0..200, 0..50), (540..640, 0..90), (0..200, 310..360), (400..640, 300..360)];
            corners.into_iter().all(|(x, y)| white(look, x, y) > 20)
        });
        look.save(&format!("view-labels-{technique}.png"));
        flight.ends(|flight| flight.screen.close(flight.window));
    }
}

#[test]
fn two_eyes_share_the_window() {
    if !has_server() {
        return;
    }
    let flight = Flight::start(&["--stereo", "side-by-side", "--technique", "rays"]);
    let look = flight.look_until("a picture", Look::is_filled);
    look.save("view-side-by-side.png");
    let width = SIZE[0] as usize / 2;
    let half = |from: usize| {
        let rgb = look.rgb.chunks(2 * width).flat_map(|row| row[from..from + width].to_vec()).collect();
        Look { size: [width as u32, SIZE[1]], rgb }
    };
    let (left, right) = (half(0), half(width));
    // Each sees about what one eye between them sees, and not the whole window's picture squeezed.
    let PoseRecord { position, heading_deg, pitch_deg, .. } = flight.pose();
    let world = synth_world(1024);
    let middle = Shot { size: left.size, ..Shot::new(&world, Pose::new(position, heading_deg, pitch_deg)) };
    let whole = Shot { size: SIZE, ..middle.clone() }.take(&["--technique", "rays"], false).rgb;
    let squeezed: Vec<[u8; 3]> = whole.into_iter().step_by(2).collect();
    let middle = middle.take(&["--technique", "rays"], false).rgb;
    let [apart, off, wrong] = [&right.rgb, &middle, &squeezed].map(|rgb| left.difference(rgb));
    println!("left from right {apart:.1} levels, from the middle {off:.1}, from a squeezed one {wrong:.1}");
    assert!(apart > 1.0 && off < 0.6 * wrong, "{apart} {off} {wrong}");
    flight.ends(|flight| flight.screen.close(flight.window));
}
