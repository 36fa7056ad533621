//! What the desk asks for, gives up, tells and evicts, step by step: no thread, no clock.

mod support;

use proptest::prelude::*;
use std::collections::{HashMap, HashSet};
use support::{MS, Office, color, elevation, world};
use terravision_common::database::{Layer, Tile};
use terravision_common::ids::SlotKey;
use terravision_common::outcome::Outcome;
use terravision_common::shm::{Counter, Gauge, WantHead};
use terravision_common::top_levels::top_levels;
use terravision_prefetcher::desk::{News, Wish};

#[test]
fn what_is_needed_now_comes_first_then_the_top_levels_then_what_is_predicted() {
    let mut office = Office::new(64, false);
    office.desk.expect([color(20), color(21)], 1, &office.control, &mut office.crew);
    let head = WantHead { sequence: 1, frame: 1, is_last: false };
    office.desk.want(head, &[color(3), elevation(3), color(4)], 1, &office.control, &mut office.crew);
    let mut asked = vec![];
    while asked.len() < 3 + 42 + 2 {
        office.step();
        asked.extend(office.crew.asked());
        office.crew.answer_all(office.now);
    }
    let (top, _) = top_levels(&world());
    let expected: Vec<Tile> = [&[color(3), elevation(3), color(4)][..], &top, &[color(20), color(21)]].concat();
    assert_eq!(asked, expected);
}

#[test]
fn a_list_replaces_the_one_before_and_what_is_on_none_is_given_up_on_the_wire() {
    let mut office = Office::warmed(64, false);
    office.want(1, &[color(1), color(2), color(3)]);
    let tickets: Vec<u64> = office.crew.requests.iter().map(|(ticket, _)| *ticket).collect();
    office.want(2, &[color(3), color(4)]);
    assert_eq!(office.crew.cancelled, tickets[..2], "the first two, each once");
    assert_eq!(office.crew.open(), [color(3), color(4)], "what stays on the list is not asked for again");
    assert_eq!(office.control.counter(Counter::TilesCancelled), 2);
    // An answer that was on its way when it was given up changes nothing.
    office.crew.answer(color(1), office.now);
    office.crew.answer(color(3), office.now);
    office.step();
    assert!(!office.is_there(color(1)) && office.is_there(color(3)));
    // Also what has arrived and waits for a slot is given up: nothing is held for it.
    office.want(3, &[]);
    assert_eq!(office.desk.wish_of(color(4)), None);
}

#[test]
fn a_predicted_tile_that_is_wanted_is_asked_for_once_and_then_urgent() {
    let mut office = Office::warmed(64, false);
    office.expect(&[color(1), color(2)]);
    assert_eq!(office.desk.wish_of(color(2)), Some(Wish::Ahead));
    office.want(1, &[color(2), color(3)]);
    assert_eq!(office.desk.wish_of(color(2)), Some(Wish::Now));
    assert_eq!(office.crew.open(), [color(1), color(2), color(3)]);
    // And the other way round: no longer wanted, still expected.
    office.expect(&[color(2), color(3)]);
    office.want(2, &[]);
    assert_eq!(office.crew.open(), [color(2), color(3)]);
    assert_eq!(office.desk.wish_of(color(3)), Some(Wish::Ahead));
    office.expect(&[]);
    assert!(office.crew.open().is_empty());
}

#[test]
fn a_tile_that_is_needed_now_takes_the_place_of_the_predicted_one_asked_for_last() {
    let mut office = Office::warmed(200, false);
    let ahead: Vec<Tile> = (0..60).map(|m| support::tile(Layer::Color, m, 0)).collect();
    office.expect(&ahead);
    let n = office.desk.window().n() as usize;
    office.want(1, &[elevation(1), elevation(2)]);
    let open = office.crew.open();
    assert_eq!(open[..n - 2], ahead[..n - 2]);
    assert_eq!(open[n - 2..], [elevation(1), elevation(2)]);
}

#[test]
fn outcomes_are_told_when_a_tile_ends_and_again_for_every_list_that_names_it() {
    let mut office = Office::warmed(64, false);
    office.want(1, &[color(1), color(2), elevation(1)]);
    assert!(office.told().is_empty());
    office.crew.answer(color(1), office.now);
    office.crew.refuse(color(2), 3, office.now);
    office.step();
    let told: HashMap<Tile, Outcome> = office.told().into_iter().collect();
    let key = office.colors.find(color(1).node).expect("it is there");
    let resident = Outcome::Resident { key };
    let expected = [(color(1), resident), (color(2), Outcome::Unavailable { code: 3 })];
    assert_eq!(told, HashMap::from(expected));
    // For the launcher once, for the preparer with each list.
    let of_two = |news: &News| matches!(news, News::Unavailable { tile, code: 3, frame: 101, .. } if *tile == color(2));
    assert_eq!(office.desk.news.iter().filter(|news| of_two(news)).count(), 1);
    for sequence in 2..4 {
        office.want(sequence, &[color(1), color(2), elevation(1)]);
        assert_eq!(office.told(), expected, "what is still on its way has no outcome");
    }
    assert_eq!(office.desk.news.iter().filter(|news| of_two(news)).count(), 1);
    assert_eq!(office.control.counter(Counter::TilesUnavailable), 1);
    // A tile that no world has.
    let nowhere = Tile { layer: Layer::Color, node: terravision_common::node::NodeId::new(9999, 1, 0).expect("an id") };
    office.want(4, &[nowhere]);
    assert_eq!(office.told(), [(nowhere, Outcome::Unavailable { code: 1 })]);
}

#[test]
fn what_was_only_expected_is_lost_when_a_frame_lacks_it_and_not_before() {
    let mut office = Office::warmed(64, true);
    office.expect(&[color(1), color(2)]);
    for tile in [color(1), color(2)] {
        office.crew.refuse(tile, 3, office.now);
    }
    office.step();
    let lost = |office: &Office| {
        let lost = office.desk.news.iter().filter_map(|news| match news {
            News::Unavailable { tile, frame, .. } => Some((*tile, *frame)),
            _ => None,
        });
        (lost.collect::<Vec<_>>(), office.control.counter(Counter::TilesUnavailable))
    };
    assert_eq!(lost(&office), (vec![], 0));
    for sequence in 1..3 {
        office.want(sequence, &[color(2)]);
        assert_eq!(lost(&office), (vec![(color(2), 101)], 1), "once");
    }
}

#[test]
fn a_tile_that_could_not_be_had_is_tried_again_after_a_while_if_at_all() {
    for (has_retries, code, cycles) in [(false, 3, 1000), (true, 3, 10), (true, 1, 300)] {
        let mut office = Office::warmed(64, has_retries);
        office.want(1, &[color(1)]);
        office.crew.refuse(color(1), code, office.now);
        office.step();
        office.pass(cycles - 1);
        office.want(2, &[color(1)]);
        assert!(office.crew.open().is_empty(), "it is left alone for {cycles} cycles");
        office.pass(2);
        office.want(3, &[color(1)]);
        assert_eq!(!office.crew.open().is_empty(), has_retries);
        if has_retries {
            office.told();
            office.crew.answer(color(1), office.now);
            office.step();
            assert!(matches!(office.told()[..], [(tile, Outcome::Resident { .. })] if tile == color(1)));
        }
    }
}

#[test]
fn a_request_without_an_answer_is_made_again_with_growing_patience_and_then_left_to_its_source() {
    let mut office = Office::warmed(64, false);
    office.want(1, &[color(1)]);
    let mut made_at = vec![office.now];
    for _ in 0..1000 {
        let before = office.crew.requests.len();
        office.pass(1);
        if office.crew.requests.len() > before {
            made_at.push(office.now);
        }
    }
    let waits: Vec<u64> = made_at.windows(2).map(|pair| (pair[1] - pair[0]) / (200 * MS)).collect();
    assert_eq!(waits, [4, 7, 13, 25, 49], "0.6, 1.2, 2.4, 4.8 and 9.6 seconds, and no sixth time");
    assert_eq!(office.crew.open(), [color(1)]);
    office.crew.answer(color(1), office.now);
    office.step();
    assert!(office.is_there(color(1)));
}

#[test]
fn no_room_is_told_once_nothing_changes_it_and_a_completed_frame_does() {
    // The top levels fill 21 slots of 23.
    let mut office = Office::warmed(23, false);
    office.want(1, &[color(1), color(2), color(3), elevation(3)]);
    office.crew.is_decoding_held = true;
    office.crew.answer_all(office.now);
    office.step();
    assert!(office.told().is_empty(), "two tiles are being decoded: they may fail and leave room");
    office.crew.decode_all(office.now);
    office.crew.is_decoding_held = false;
    office.step();
    let told = office.told();
    let no_room: Vec<_> = told.iter().filter(|(_, o)| matches!(o, Outcome::NoRoom { .. })).collect();
    assert_eq!(no_room.len(), 1, "{told:?}");
    assert_eq!((no_room[0].0.layer, no_room[0].1), (Layer::Color, Outcome::NoRoom { completed: 0 }));
    assert_eq!(told.iter().filter(|(_, o)| matches!(o, Outcome::Resident { .. })).count(), 3);
    office.step();
    assert!(office.told().is_empty(), "once");
    // Frame 1 is drawn: its tiles make room for the payload that waits, which is not asked for again.
    let requests = office.control.counter(Counter::TilesRequested);
    office.control.set_completed_sequence(1);
    office.want(2, &[color(3)]);
    assert!(office.is_there(color(3)));
    assert_eq!(office.control.counter(Counter::TilesRequested), requests);
}

#[test]
fn a_layer_without_room_does_not_keep_the_other_from_loading() {
    let mut office = Office::warmed(22, false);
    // More colour than is ever held, none of which finds room but the first; then elevation.
    let mut wanted: Vec<Tile> = (0..32)
        .flat_map(|m| [2, 3, 4].map(|q| (m, q)))
        .map(|(m, q)| support::tile(Layer::Color, m, if q == 4 { 1 } else { q - 2 }))
        .collect();
    wanted.push(elevation(5));
    office.want(1, &wanted);
    for _ in 0..20 {
        office.crew.answer_all(office.now);
        office.step();
    }
    assert!(office.is_there(elevation(5)));
    assert!(office.told().iter().any(|(t, o)| t.layer == Layer::Color && matches!(o, Outcome::NoRoom { .. })));
    let asked = office.control.counter(Counter::TilesRequested);
    assert!(asked < 42 + 80, "payloads that nothing can be done with are not heaped up: {asked} were asked for");
}

#[test]
fn at_most_n_predicted_tiles_are_listed_and_none_without_room() {
    let mut office = Office::warmed(200, false);
    let tiles: Vec<Tile> = (0..60).map(|m| support::tile(Layer::Color, m, 0)).collect();
    office.expect(&tiles);
    let n = office.desk.window().n() as usize;
    assert!(n < 60);
    assert_eq!(office.control.gauge(Gauge::TilesPredicted), n as u64);
    assert_eq!(office.crew.open(), tiles[..n]);
    // Two slots are free, and the rest of the pool is of the top levels.
    let mut office = Office::warmed(23, false);
    office.expect(&tiles);
    assert_eq!(office.crew.open(), tiles[..2]);
    office.crew.answer_all(office.now);
    office.step();
    office.expect(&tiles);
    assert!(office.crew.open().is_empty(), "what is expected does not push out what is as much expected");
    // Later the view is expected elsewhere, and they go.
    office.want(2, &[]);
    office.expect(&tiles[10..]);
    assert_eq!(office.crew.open(), tiles[10..12]);
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

    /// Whatever comes: the top levels stay, and so does every tile that a frame wanted and found there, until that frame
    /// is completed. What is asked for is on a list, once.
    #[test]
    fn neither_locked_nor_named_tiles_are_ever_evicted(steps in prop::collection::vec(step(), 1..120)) {
        let mut office = Office::warmed(27, true);
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
                    let (there, lacking): (Vec<Tile>, Vec<Tile>) = tiles.iter().partition(|tile| office.is_there(**tile));
                    for tile in there {
                        let key = office.reader(tile.layer).find(tile.node).expect("it is there");
                        prop_assert!(office.reader(tile.layer).touch(key, sequence));
                        named.insert(tile, (key, sequence));
                    }
                    wanted = lacking.iter().copied().collect();
                    office.want(sequence, &lacking);
                }
                Step::Expect { tiles } => {
                    let tiles: Vec<Tile> = tiles.iter().map(numbered).collect();
                    expected = tiles.iter().copied().collect();
                    office.expect(&tiles);
                }
                Step::Answer { share } => {
                    for tile in office.crew.open() {
                        if (tile.pack().wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 56) as u8 <= share {
                            office.crew.answer(tile, office.now);
                        }
                    }
                    office.step();
                }
                Step::Refuse => {
                    if let Some(tile) = office.crew.open().first() {
                        office.crew.refuse(*tile, 3, office.now);
                    }
                    office.step();
                }
                Step::Complete { behind } => {
                    completed = completed.max(sequence.saturating_sub(behind));
                    office.control.set_completed_sequence(completed);
                }
                Step::Cycle => office.pass(1),
            }
            // What came for a frame is told, and the frame holds it from its loading on.
            for (tile, outcome) in office.told() {
                if let Outcome::Resident { key } = outcome && wanted.contains(&tile) {
                    named.insert(tile, (key, sequence));
                }
            }
            named.retain(|_, (_, until)| *until > completed);
            for (tile, (key, _)) in &named {
                prop_assert!(office.reader(tile.layer).bytes(*key).is_some(), "{} is gone", tile);
            }
            prop_assert!(top.iter().all(|tile| office.is_there(*tile)));
            let open = office.crew.open();
            prop_assert_eq!(open.iter().collect::<HashSet<_>>().len(), open.len());
            prop_assert!(open.iter().all(|tile| wanted.contains(tile) || expected.contains(tile)));
        }
    }
}
