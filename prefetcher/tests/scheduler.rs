//! What the scheduler requests, cancels, reports and evicts, step by step, without threads or
//! clocks.

mod support;

use proptest::prelude::*;
use std::collections::{HashMap, HashSet};
use support::{Fixture, color, elevation, world};
use terravision_common::database::{Layer, Tile};
use terravision_common::ids::{FrameNumber, Sequence, SlotKey};
use terravision_common::outcome::{Outcome, TileFailure};
use terravision_common::shm::{Counter, Gauge, WantHead};
use terravision_common::top_levels::top_levels;
use terravision_prefetcher::scheduler::{Priority, TileEvent};
use terravision_store::FailedTiles;

#[test]
fn what_is_needed_now_comes_first_then_the_top_levels_then_what_is_predicted() {
    let mut fixture = Fixture::new(64, FailedTiles::Final);
    fixture.scheduler.expect([color(20), color(21)], &fixture.control, &mut fixture.executor);
    let head = WantHead { sequence: Sequence::FIRST, frame: FrameNumber::new(1), is_last: false };
    fixture.scheduler.want(head, &[color(3), elevation(3), color(4)], 1, &fixture.control, &mut fixture.executor);
    let mut asked = vec![];
    while asked.len() < 3 + 42 + 2 {
        fixture.step();
        asked.extend(fixture.executor.asked());
        fixture.executor.answer_all(fixture.now);
    }
    let (top, _) = top_levels(&world());
    let expected: Vec<Tile> = [&[color(3), elevation(3), color(4)][..], &top, &[color(20), color(21)]].concat();
    assert_eq!(asked, expected);
}

#[test]
fn a_list_replaces_the_one_before_and_what_is_on_none_is_given_up_on_the_wire() {
    let mut fixture = Fixture::warmed(64, FailedTiles::Final);
    fixture.want(1, &[color(1), color(2), color(3)]);
    let tickets: Vec<u64> = fixture.executor.requests.iter().map(|(ticket, _)| *ticket).collect();
    fixture.want(2, &[color(3), color(4)]);
    assert_eq!(fixture.executor.cancelled, tickets[..2], "the first two, each once");
    assert_eq!(fixture.executor.open(), [color(3), color(4)], "what stays on the list is not asked for again");
    assert_eq!(fixture.control.counter(Counter::TilesCancelled), 2);
    // An answer that was in flight when its request was cancelled changes nothing.
    fixture.executor.answer(color(1), fixture.now);
    fixture.executor.answer(color(3), fixture.now);
    fixture.step();
    assert!(!fixture.is_there(color(1)) && fixture.is_there(color(3)));
    // A payload that has arrived and waits for a slot is given up too.
    fixture.want(3, &[]);
    assert_eq!(fixture.scheduler.priority_of(color(4)), None);
}

#[test]
fn a_predicted_tile_that_is_wanted_is_asked_for_once_and_then_urgent() {
    let mut fixture = Fixture::warmed(64, FailedTiles::Final);
    fixture.expect(&[color(1), color(2)]);
    assert_eq!(fixture.scheduler.priority_of(color(2)), Some(Priority::Ahead));
    fixture.want(1, &[color(2), color(3)]);
    assert_eq!(fixture.scheduler.priority_of(color(2)), Some(Priority::Now));
    assert_eq!(fixture.executor.open(), [color(1), color(2), color(3)]);
    // And the reverse: no longer wanted, but still predicted.
    fixture.expect(&[color(2), color(3)]);
    fixture.want(2, &[]);
    assert_eq!(fixture.executor.open(), [color(2), color(3)]);
    assert_eq!(fixture.scheduler.priority_of(color(3)), Some(Priority::Ahead));
    fixture.expect(&[]);
    assert!(fixture.executor.open().is_empty());
}

#[test]
fn a_tile_that_is_needed_now_takes_the_place_of_the_predicted_one_asked_for_last() {
    let mut fixture = Fixture::warmed(200, FailedTiles::Final);
    let ahead: Vec<Tile> = (0..60).map(|m| support::tile(Layer::Color, m, 0)).collect();
    fixture.expect(&ahead);
    let n = fixture.scheduler.window().n() as usize;
    fixture.want(1, &[elevation(1), elevation(2)]);
    let open = fixture.executor.open();
    assert_eq!(open[..n - 2], ahead[..n - 2]);
    assert_eq!(open[n - 2..], [elevation(1), elevation(2)]);
}

#[test]
fn outcomes_are_told_when_a_tile_ends_and_again_for_every_list_that_names_it() {
    let mut fixture = Fixture::warmed(64, FailedTiles::Final);
    fixture.want(1, &[color(1), color(2), elevation(1)]);
    assert!(fixture.told().is_empty());
    fixture.executor.answer(color(1), fixture.now);
    fixture.executor.refuse(color(2), TileFailure::Unreadable, fixture.now);
    fixture.step();
    let told: HashMap<Tile, Outcome> = fixture.told().into_iter().collect();
    let key = fixture.colors.find(color(1).node).expect("it is there");
    let resident = Outcome::Resident { key };
    let expected = [(color(1), resident), (color(2), Outcome::Unavailable { failure: TileFailure::Unreadable })];
    assert_eq!(told, HashMap::from(expected));
    // Reported to the launcher once, to the preparer with each list.
    let of_two = |events: &TileEvent| matches!(events, TileEvent::Unavailable { tile, failure: TileFailure::Unreadable, frame, .. } if *tile == color(2) && *frame == FrameNumber::new(101));
    assert_eq!(fixture.scheduler.events.iter().filter(|events| of_two(events)).count(), 1);
    for sequence in 2..4 {
        fixture.want(sequence, &[color(1), color(2), elevation(1)]);
        assert_eq!(fixture.told(), expected, "what is still on its way has no outcome");
    }
    assert_eq!(fixture.scheduler.events.iter().filter(|events| of_two(events)).count(), 1);
    assert_eq!(fixture.control.counter(Counter::TilesUnavailable), 1);
    // A tile that no world has.
    let nowhere = Tile { layer: Layer::Color, node: terravision_common::node::NodeId::new(9999, 1, 0).expect("an id") };
    fixture.want(4, &[nowhere]);
    assert_eq!(fixture.told(), [(nowhere, Outcome::Unavailable { failure: TileFailure::Missing })]);
}

#[test]
fn what_was_only_expected_is_lost_when_a_frame_lacks_it_and_not_before() {
    let mut fixture = Fixture::warmed(64, FailedTiles::Rest);
    fixture.expect(&[color(1), color(2)]);
    for tile in [color(1), color(2)] {
        fixture.executor.refuse(tile, TileFailure::Unreadable, fixture.now);
    }
    fixture.step();
    let lost = |fixture: &Fixture| {
        let lost = fixture.scheduler.events.iter().filter_map(|events| match events {
            TileEvent::Unavailable { tile, frame, .. } => Some((*tile, *frame)),
            _ => None,
        });
        (lost.collect::<Vec<_>>(), fixture.control.counter(Counter::TilesUnavailable))
    };
    assert_eq!(lost(&fixture), (vec![], 0));
    for sequence in 1..3 {
        fixture.want(sequence, &[color(2)]);
        assert_eq!(lost(&fixture), (vec![(color(2), FrameNumber::new(101))], 1), "once");
    }
}

#[test]
fn a_tile_that_could_not_be_had_is_tried_again_after_a_while_if_at_all() {
    for (failed_tiles, failure, cycles) in [
        (FailedTiles::Final, TileFailure::Unreadable, 1000),
        (FailedTiles::Rest, TileFailure::Unreadable, 10),
        (FailedTiles::Rest, TileFailure::Missing, 300),
    ] {
        let has_retries = failed_tiles == FailedTiles::Rest;
        let mut fixture = Fixture::warmed(64, failed_tiles);
        fixture.want(1, &[color(1)]);
        fixture.executor.refuse(color(1), failure, fixture.now);
        fixture.step();
        fixture.pass(cycles - 1);
        fixture.want(2, &[color(1)]);
        assert!(fixture.executor.open().is_empty(), "it is left alone for {cycles} cycles");
        fixture.pass(2);
        fixture.want(3, &[color(1)]);
        assert_eq!(!fixture.executor.open().is_empty(), has_retries);
        if has_retries {
            fixture.told();
            fixture.executor.answer(color(1), fixture.now);
            fixture.step();
            assert!(matches!(fixture.told()[..], [(tile, Outcome::Resident { .. })] if tile == color(1)));
        }
    }
}

#[test]
fn a_request_without_an_answer_is_left_to_its_source_which_knows_when_to_make_it_anew() {
    let mut fixture = Fixture::warmed(64, FailedTiles::Rest);
    fixture.want(1, &[color(1)]);
    for _ in 0..1000 {
        fixture.pass(1);
    }
    assert_eq!(fixture.executor.requests.len(), 1, "asked for once");
    assert_eq!((fixture.executor.open(), &fixture.executor.cancelled[..]), (vec![color(1)], &[][..]));
    fixture.executor.answer(color(1), fixture.now);
    fixture.step();
    assert!(fixture.is_there(color(1)));
}

#[test]
fn no_room_is_told_once_nothing_changes_it_and_a_completed_frame_does() {
    // The top levels fill 21 slots of 23.
    let mut fixture = Fixture::warmed(23, FailedTiles::Final);
    fixture.want(1, &[color(1), color(2), color(3), elevation(3)]);
    fixture.executor.is_decoding_held = true;
    fixture.executor.answer_all(fixture.now);
    fixture.step();
    assert!(fixture.told().is_empty(), "two tiles are being decoded: they may fail and leave room");
    fixture.executor.decode_all(fixture.now);
    fixture.executor.is_decoding_held = false;
    fixture.step();
    let told = fixture.told();
    let no_room: Vec<_> = told.iter().filter(|(_, o)| matches!(o, Outcome::NoRoom { .. })).collect();
    assert_eq!(no_room.len(), 1, "{told:?}");
    assert_eq!((no_room[0].0.layer, no_room[0].1), (Layer::Color, Outcome::NoRoom { completed: Sequence::NONE }));
    assert_eq!(told.iter().filter(|(_, o)| matches!(o, Outcome::Resident { .. })).count(), 3);
    fixture.step();
    assert!(fixture.told().is_empty(), "once");
    // Frame 1 is drawn: its tiles make room for the payload that waits, which is not asked for
    // again.
    let requests = fixture.control.counter(Counter::TilesRequested);
    fixture.control.set_completed_sequence(Sequence::FIRST);
    fixture.want(2, &[color(3)]);
    assert!(fixture.is_there(color(3)));
    assert_eq!(fixture.control.counter(Counter::TilesRequested), requests);
}

#[test]
fn a_layer_without_room_does_not_keep_the_other_from_loading() {
    let mut fixture = Fixture::warmed(22, FailedTiles::Final);
    // More colour than is ever held, none of which finds room but the first; then elevation.
    let mut wanted: Vec<Tile> = (0..32)
        .flat_map(|m| [2, 3, 4].map(|q| (m, q)))
        .map(|(m, q)| support::tile(Layer::Color, m, if q == 4 { 1 } else { q - 2 }))
        .collect();
    wanted.push(elevation(5));
    fixture.want(1, &wanted);
    for _ in 0..20 {
        fixture.executor.answer_all(fixture.now);
        fixture.step();
    }
    assert!(fixture.is_there(elevation(5)));
    assert!(fixture.told().iter().any(|(t, o)| t.layer == Layer::Color && matches!(o, Outcome::NoRoom { .. })));
    let asked = fixture.control.counter(Counter::TilesRequested);
    assert!(asked < 42 + 80, "payloads that nothing can be done with are not heaped up: {asked} were asked for");
}

#[test]
fn at_most_n_predicted_tiles_are_listed_and_none_without_room() {
    let mut fixture = Fixture::warmed(200, FailedTiles::Final);
    let tiles: Vec<Tile> = (0..60).map(|m| support::tile(Layer::Color, m, 0)).collect();
    fixture.expect(&tiles);
    let n = fixture.scheduler.window().n() as usize;
    assert!(n < 60);
    assert_eq!(fixture.control.gauge(Gauge::TilesPredicted), n as u64);
    assert_eq!(fixture.executor.open(), tiles[..n]);
    // Two slots are free, and the rest of the pool is of the top levels.
    let mut fixture = Fixture::warmed(23, FailedTiles::Final);
    fixture.expect(&tiles);
    assert_eq!(fixture.executor.open(), tiles[..2]);
    fixture.executor.answer_all(fixture.now);
    fixture.step();
    fixture.expect(&tiles);
    assert!(fixture.executor.open().is_empty(), "what is expected does not push out what is as much expected");
    // Later the view is expected elsewhere, and they go.
    fixture.want(2, &[]);
    fixture.expect(&tiles[10..]);
    assert_eq!(fixture.executor.open(), tiles[10..12]);
}

/// One step of a random flight.
#[derive(Debug, Clone)]
enum Step {
    Want { tiles: Vec<u32> },
    Expect { tiles: Vec<u32> },
    Answer { share: u8 },
    Refuse,
    Complete { behind: u64 },
    Cycle,
}

fn step() -> impl Strategy<Value = Step> {
    let tiles = || prop::collection::vec(0u32..24, 0..10);
    prop_oneof![
        4 => tiles().prop_map(|tiles| Step::Want { tiles }),
        3 => tiles().prop_map(|tiles| Step::Expect { tiles }),
        4 => (0u8..=255).prop_map(|share| Step::Answer { share }),
        1 => Just(Step::Refuse),
        2 => (0u64..4).prop_map(|behind| Step::Complete { behind }),
        2 => Just(Step::Cycle),
    ]
}

fn numbered(number: &u32) -> Tile {
    if number.is_multiple_of(2) { color(*number) } else { elevation(*number) }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever comes: the top levels stay, and so does every tile that a frame wanted and found
    /// there, until that frame is completed. What is asked for is on a list, once.
    #[test]
    fn neither_locked_nor_named_tiles_are_ever_evicted(steps in prop::collection::vec(step(), 1..120)) {
        let mut fixture = Fixture::warmed(27, FailedTiles::Rest);
        let (top, _) = top_levels(&world());
        let (mut sequence, mut completed) = (0, 0);
        // Slot and generation of tiles that frames hold, and the last of these frames.
        let mut named: HashMap<Tile, (SlotKey, u64)> = HashMap::new();
        let (mut wanted, mut expected) = (HashSet::new(), HashSet::new());
        for step in steps {
            match step {
                Step::Want { tiles } => {
                    sequence += 1;
                    let tiles: Vec<Tile> = tiles.iter().map(numbered).collect();
                    // As the preparer does it: what is there is kept, what is not is listed.
                    let (there, lacking): (Vec<Tile>, Vec<Tile>) = tiles.iter().partition(|tile| fixture.is_there(**tile));
                    for tile in there {
                        let key = fixture.reader(tile.layer).find(tile.node).expect("it is there");
                        prop_assert!(fixture.reader(tile.layer).touch(key, Sequence::new(sequence)));
                        named.insert(tile, (key, sequence));
                    }
                    wanted = lacking.iter().copied().collect();
                    fixture.want(sequence, &lacking);
                }
                Step::Expect { tiles } => {
                    let tiles: Vec<Tile> = tiles.iter().map(numbered).collect();
                    expected = tiles.iter().copied().collect();
                    fixture.expect(&tiles);
                }
                Step::Answer { share } => {
                    for tile in fixture.executor.open() {
                        if (tile.pack().wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 56) as u8 <= share {
                            fixture.executor.answer(tile, fixture.now);
                        }
                    }
                    fixture.step();
                }
                Step::Refuse => {
                    if let Some(tile) = fixture.executor.open().first() {
                        fixture.executor.refuse(*tile, TileFailure::Unreadable, fixture.now);
                    }
                    fixture.step();
                }
                Step::Complete { behind } => {
                    completed = completed.max(sequence.saturating_sub(behind));
                    fixture.control.set_completed_sequence(Sequence::new(completed));
                }
                Step::Cycle => fixture.pass(1),
            }
            // What came for a frame is told, and the frame holds it from its loading on.
            for (tile, outcome) in fixture.told() {
                if let Outcome::Resident { key } = outcome && wanted.contains(&tile) {
                    named.insert(tile, (key, sequence));
                }
            }
            named.retain(|_, (_, until)| *until > completed);
            for (tile, (key, _)) in &named {
                prop_assert!(fixture.reader(tile.layer).bytes(*key).is_some(), "{} is gone", tile);
            }
            prop_assert!(top.iter().all(|tile| fixture.is_there(*tile)));
            let open = fixture.executor.open();
            prop_assert_eq!(open.iter().collect::<HashSet<_>>().len(), open.len());
            prop_assert!(open.iter().all(|tile| wanted.contains(tile) || expected.contains(tile)));
        }
    }
}
