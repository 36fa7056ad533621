//! Realtime mode: a frame is made of what is there, and waits for nothing.

mod support;

use support::flight::{Flight, Source};
use terravision_common::event::EventContent;

fn realtime() -> Flight {
    Flight { realtime: Some(3), frames: 60, ..Flight::new() }
}

#[test]
fn frames_are_made_of_what_is_there_and_may_be_left_out() {
    let held = 30;
    let flight = Flight { held: Some(held), ..realtime() };
    // Every slot that is named holds the right tile until the frame is completed: the flight's
    // renderer looks.
    let (frames, events) = flight.fly().expect("a flight");
    let numbers: Vec<u64> = frames.iter().map(|frame| frame.marker.frame).collect();
    assert_eq!(numbers, (0..60).map(|k| 100 + 3 * k).collect::<Vec<_>>());
    assert!(frames.iter().all(|frame| !frame.tiles.is_empty() && frame.end.unavailable_count < frame.end.wanted_count));
    // All frames tell what they lacked, and that is what their ends say.
    let told = events.iter().filter_map(|event| match event.content()? {
        EventContent::FrameLacked { tiles, sharp_share } => Some(((event.frame().get(), tiles), sharp_share)),
        _ => None,
    });
    let (lacked, sharp): (Vec<(u64, u32)>, Vec<f32>) = told.unzip();
    // Ground is as fine as wanted where nothing lacks, and only there all of it.
    assert!(
        sharp
            .iter()
            .zip(&lacked)
            .all(|(share, (_, count))| (0.0..=1.0).contains(share) && (*count > 0 || *share == 1.0))
    );
    // With the top levels alone none is as fine as wanted; later each lacks what has just come into
    // view, at most.
    let (before, after) = sharp.split_at(held as usize);
    assert!(before.iter().all(|share| *share < 0.1), "{before:?}");
    assert!(after[1..].iter().all(|share| *share > 0.8), "{after:?}");
    assert_eq!(lacked, frames.iter().map(|f| (f.marker.frame, f.end.unavailable_count)).collect::<Vec<_>>());
}

#[test]
fn too_little_memory_costs_resolution_and_no_slot_in_use() {
    // Less than a frame wants, which exact mode refuses; the locked top levels take most of it.
    let flight = Flight { color_slots: 40, elevation_slots: 40, ..realtime() };
    let (frames, _) = flight.fly().expect("a flight");
    assert_eq!(frames.len(), 60);
    assert!(frames.iter().all(|frame| frame.end.unavailable_count > 0 && !frame.tiles.is_empty()));
    let exact = Flight { realtime: None, ..flight };
    assert!(exact.fly().is_err());
}

#[test]
fn missing_tiles_do_not_end_it() {
    let (frames, _) = Flight { source: Source::new(60), ..realtime() }.fly().expect("a flight");
    assert_eq!(frames.len(), 60);
    assert!(frames.iter().all(|frame| frame.end.unavailable_count > 0 && !frame.tiles.is_empty()));
}
