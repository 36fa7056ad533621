//! Nothing from the ring is trusted: damaged frames are refused with a sentence, never drawn, never
//! a panic.

mod support;

use bytemuck::Zeroable;
use proptest::prelude::*;
use support::{Scene, camera, draw, node, options, world};
use terravision_common::camera::CameraFields;
use terravision_common::ids::{RingPosition, Sequence, SlotKey};
use terravision_common::slot::{
    ElevationSlot, ElevationTile, FrameEnd, FrameMarker, Slot, SlotContent, TileSlot, ViewSlot,
};
use terravision_common::texels::TexelFormat;
use terravision_renderer::frame::{FrameReader, TileFault, check_tile};
use terravision_renderer::source::{Done, ElevationPoolShape, SourceShape};

const SIZE: [u32; 2] = [32, 24];

fn good_tile() -> TileSlot {
    TileSlot { end: [8, 8], elevation_level: 1, color_level: 1, color_slot: 3, ..TileSlot::zeroed() }
}

#[test]
fn a_good_tile_passes_and_each_fault_is_named() {
    let world = world([64, 64]);
    let check = |change: &dyn Fn(&mut TileSlot)| {
        let mut tile = good_tile();
        change(&mut tile);
        check_tile(&tile, &world, 4)
    };
    assert_eq!(check(&|_| {}), Ok(()));
    assert_eq!(check(&|t| t.end = [9, 8]), Err(TileFault::Block));
    assert_eq!(check(&|t| t.start = [8, 0]), Err(TileFault::Block));
    assert_eq!(check(&|t| t.elevation_level = 4), Err(TileFault::Level));
    assert_eq!(check(&|t| t.color_level = 255), Err(TileFault::Level));
    assert_eq!(check(&|t| t.elevation_origin = [8, 0]), Err(TileFault::Origin));
    assert_eq!(check(&|t| t.elevation_origin = [64, 0]), Err(TileFault::Origin));
    assert_eq!(check(&|t| t.color_origin = [u32::MAX, 0]), Err(TileFault::Origin));
    assert_eq!(check(&|t| t.color_origin = [16, 0]), Err(TileFault::Cover));
    assert_eq!(check(&|t| t.color_level = 0), Err(TileFault::Cover));
    assert_eq!(check(&|t| t.edge_snap[2] = 4), Err(TileFault::Snap));
    assert_eq!(check(&|t| t.grid_snap = 1), Err(TileFault::Snap));
    let thin = |t: &mut TileSlot| (t.grid_snap, t.edge_snap) = (1, [1, 1, 2, 1]);
    assert_eq!(check(&thin), Ok(()));
    let between = |t: &mut TileSlot| {
        thin(t);
        t.end[0] -= 1;
    };
    assert_eq!(check(&between), Err(TileFault::Block));
    assert_eq!(check(&|t| t.color_slot = 4), Err(TileFault::ColorSlot));
}

fn shape() -> SourceShape {
    SourceShape {
        world: world([64, 64]),
        elevation_arrays: 16,
        done: Done { elevation_end: RingPosition::new(100), ..Done::default() },
        is_resumed: false,
        color_slots: 4,
        elevation_pool: Some(ElevationPoolShape { slots: 2, stride: 81 }),
        texels: TexelFormat::Rgba8,
        frames: [7, 9],
        has_gaps: false,
    }
}

fn marker() -> FrameMarker {
    let camera = camera([1.0, 2.0, 300.0], 0.0, -50.0, SIZE);
    FrameMarker {
        frame: 7,
        camera: *camera.fields(),
        sequence: 1,
        elevation_start: 100,
        maker: 1,
        picture: SIZE,
        ..FrameMarker::zeroed()
    }
}

fn view() -> ViewSlot {
    ViewSlot { camera: marker().camera, lens_shift_px: 0.0, at: [0, 0], index: 0, count: 1 }
}

/// The slots, with the one view of a frame behind its marker.
fn with_view(slots: &[SlotContent]) -> Vec<SlotContent> {
    let is_marker = |slot: &SlotContent| matches!(slot, SlotContent::Marker(_));
    slots
        .iter()
        .flat_map(|slot| [Some(*slot), is_marker(slot).then_some(SlotContent::View(view()))])
        .flatten()
        .collect()
}

fn end() -> FrameEnd {
    FrameEnd { frame: 7, tile_count: 1, elevation_end: 101, ..FrameEnd::zeroed() }
}

/// Feeds slots of frames with one view; what the reader says to the last of them.
fn feed(slots: &[SlotContent]) -> Result<bool, String> {
    feed_as_they_are(&with_view(slots))
}

fn feed_as_they_are(slots: &[SlotContent]) -> Result<bool, String> {
    let mut reader = FrameReader::new(shape(), SIZE).expect("the world is small");
    let mut last = Ok(false);
    for content in slots {
        last = reader.add(&Slot::new(content)).map_err(|error| error.to_string());
        if last.is_err() {
            break;
        }
    }
    last
}

#[test]
fn a_frame_is_complete_with_its_end() {
    let tile = SlotContent::Tile(TileSlot { elevation_position: 100, ..good_tile() });
    assert_eq!(feed(&[SlotContent::Marker(marker()), tile, SlotContent::End(end())]), Ok(true));
}

#[test]
fn in_realtime_frames_may_be_left_out_but_none_comes_twice_or_after_the_last() {
    let frame = |frame: u64| {
        let tile = TileSlot { elevation_position: 100, ..good_tile() };
        [
            SlotContent::Marker(FrameMarker { frame, ..marker() }),
            SlotContent::Tile(tile),
            SlotContent::End(FrameEnd { frame, elevation_end: 101, ..end() }),
        ]
    };
    let shape = SourceShape { frames: [7, 20], has_gaps: true, ..shape() };
    let read = |reader: &mut FrameReader, number: u64| {
        with_view(&frame(number))
            .iter()
            .try_fold(false, |_, slot| reader.add(&Slot::new(slot)))
            .map_err(|error| error.to_string())
    };
    let mut reader = FrameReader::new(shape, SIZE).expect("the world is small");
    assert_eq!((read(&mut reader, 9), reader.remaining(), reader.frame().sequence), (Ok(true), 10, Sequence::FIRST));
    for wrong in [9, 8, 20, u64::MAX] {
        let mut reader = FrameReader::new(shape, SIZE).expect("the world is small");
        assert_eq!(read(&mut reader, 9), Ok(true));
        let refused = read(&mut reader, wrong).expect_err("out of order");
        assert!(refused.contains(&format!("its number is {wrong}, expected 10")), "{refused}");
    }
    // Its arrays follow those of the frame before.
    let last = [
        SlotContent::Marker(FrameMarker { frame: 19, sequence: 2, elevation_start: 101, ..marker() }),
        SlotContent::End(FrameEnd { frame: 19, tile_count: 0, elevation_end: 101, ..end() }),
    ];
    assert!(with_view(&last).iter().try_fold(false, |_, slot| reader.add(&Slot::new(slot))).expect("in order"));
    assert_eq!((reader.remaining(), reader.frame().sequence), (0, Sequence::new(2)));
}

#[test]
fn a_frame_that_a_killed_preparer_has_begun_is_broken_off_by_the_next() {
    let tile = SlotContent::Tile(TileSlot { elevation_position: 100, ..good_tile() });
    // It had made another array than it told of, and the next one begins behind it.
    let again = SlotContent::Marker(FrameMarker { maker: 2, elevation_start: 102, ..marker() });
    let anew = SlotContent::Tile(TileSlot { elevation_position: 102, color_generation: 5, ..good_tile() });
    let closed = SlotContent::End(FrameEnd { elevation_end: 103, ..end() });
    assert_eq!(feed(&[SlotContent::Marker(marker()), tile, again, anew, closed]), Ok(true));
    let stray = [SlotContent::Marker(marker()), tile, again, tile, closed];
    assert!(feed(&stray).expect_err("an array of the other frame").contains("does not belong to the frame"));
}

fn done(sequence: u64, elevation_end: u64) -> Done {
    let (sequence, elevation_end) = (Sequence::new(sequence), RingPosition::new(elevation_end));
    Done { sequence, elevation_end, slots_end: RingPosition::default() }
}

#[test]
fn a_renderer_after_another_passes_over_what_is_done_and_the_rest_of_what_was_given_back() {
    let shape = SourceShape { done: done(1, 100), is_resumed: true, frames: [7, 12], ..shape() };
    let mut reader = FrameReader::new(shape, SIZE).expect("the world is small");
    let tile = |position| SlotContent::Tile(TileSlot { elevation_position: position, ..good_tile() });
    let marker = |frame, sequence, elevation_start| {
        SlotContent::Marker(FrameMarker { frame, sequence, elevation_start, ..marker() })
    };
    let close = |frame, elevation_end| SlotContent::End(FrameEnd { frame, elevation_end, ..end() });
    let mut add = |slot: SlotContent| {
        let slots = with_view(&[slot]);
        slots.iter().try_fold(false, |_, slot| reader.add(&Slot::new(slot))).map_err(|error| error.to_string())
    };
    // The end of a frame that did not fit into the ring, one that is done, and the first that is
    // not.
    for slot in [tile(60), close(6, 61), marker(7, 1, 90), tile(90)] {
        assert_eq!(add(slot), Ok(false));
    }
    assert_eq!(add(close(7, 91)), Ok(true), "read, for the reader to pass over");
    assert!(add(tile(100)).expect_err("within the ring").contains("found a tile"));
    assert_eq!(add(marker(8, 2, 104)), Ok(false));
    assert_eq!(add(tile(104)), Ok(false));
    assert_eq!(add(close(8, 105)), Ok(true));
    let expected = done(2, 105);
    assert_eq!((reader.done_with_frame(), reader.remaining()), (expected, 3));
}

#[test]
fn frames_that_cannot_be_are_refused_with_a_sentence() {
    let tile = |change: &dyn Fn(&mut TileSlot)| {
        let mut tile = TileSlot { elevation_position: 100, ..good_tile() };
        change(&mut tile);
        SlotContent::Tile(tile)
    };
    let opened = SlotContent::Marker(marker());
    let closed = SlotContent::End(end());
    let plain = tile(&|_| {});
    let cases: Vec<(Vec<SlotContent>, &str)> = vec![
        (vec![plain], "found a tile, expected a frame marker"),
        (vec![closed], "found the end of a frame"),
        (vec![opened, opened], "found a frame marker"),
        (vec![SlotContent::Marker(FrameMarker { frame: 8, ..marker() })], "its number is 8, expected 7"),
        (vec![SlotContent::Marker(FrameMarker { sequence: 2, ..marker() })], "its place in the run is 2, expected 1"),
        (vec![SlotContent::Marker(FrameMarker { sequence: 0, ..marker() })], "its place in the run is 0, expected 1"),
        (
            vec![SlotContent::Marker(FrameMarker { elevation_start: 99, ..marker() })],
            "its first elevation array is 99, expected 100",
        ),
        (vec![SlotContent::Marker(FrameMarker { elevation_start: 117, ..marker() })], "elevation array is 117"),
        (vec![opened, SlotContent::Marker(FrameMarker { maker: 0, ..marker() })], "found a frame marker"),
        (
            vec![SlotContent::Marker(FrameMarker {
                camera: CameraFields { vfov_rad: f64::NAN, ..marker().camera },
                ..marker()
            })],
            "no valid camera: its vertical field of view is NaN, expected 0.0001 to 3.1 rad",
        ),
        (vec![SlotContent::Marker(FrameMarker { picture: [33, 9], ..marker() })], "a picture of 33x9 pixels, expected"),
        (vec![opened, tile(&|t| t.edge_snap[0] = 200)], "more vertices collapse"),
        (vec![opened, plain, tile(&|t| t.color_generation = 2)], "another generation"),
        (vec![opened, closed], "the number of its tiles is 1, expected 0"),
        (vec![opened, plain, SlotContent::End(FrameEnd { frame: 8, ..end() })], "number at its end is 8"),
        (vec![opened, plain, SlotContent::End(FrameEnd { elevation_end: 117, ..end() })], "17, expected 16"),
        (vec![opened, plain, SlotContent::End(FrameEnd { elevation_end: 99, ..end() })], "elevation arrays is"),
        (vec![opened, tile(&|t| t.elevation_position = 101), closed], "does not belong to the frame"),
        (vec![opened, tile(&|t| t.elevation_position = u64::MAX), closed], "does not belong to the frame"),
    ];
    for (slots, sentence) in cases {
        let error = feed(&slots).unwrap_err();
        assert!(error.contains(sentence), "{error:?} does not say {sentence:?}");
    }
}

#[test]
fn elevation_tiles_that_cannot_be_are_refused_with_a_sentence() {
    let root = ElevationTile::new(node(0, 0, 3), SlotKey::new(0, 5));
    // The leaf of `good_tile`.
    let leaf = ElevationTile::new(node(0, 0, 1), SlotKey::new(1, 5));
    let named = |tiles: &[ElevationTile]| SlotContent::Elevation(ElevationSlot::of(tiles));
    let tile = |at| SlotContent::Tile(TileSlot { elevation_position: at, ..good_tile() });
    let opened = SlotContent::Marker(marker());
    let closed = |count| SlotContent::End(FrameEnd { elevation_end: 100, elevation_tile_count: count, ..end() });
    assert_eq!(feed(&[opened, named(&[root, leaf]), tile(1), closed(2)]), Ok(true));
    assert_eq!(feed(&[opened, named(&[root]), named(&[leaf]), tile(1), closed(2)]), Ok(true));
    let of = |tile: ElevationTile| vec![opened, named(&[root, tile])];
    let cases: Vec<(Vec<SlotContent>, &str)> = vec![
        (vec![named(&[root])], "found elevation tiles, expected a frame marker"),
        (vec![opened, named(&[root, leaf]), tile(1), named(&[leaf])], "found elevation tiles"),
        (
            of(ElevationTile { node: u64::MAX, ..leaf }),
            "elevation tile 1 of frame 7 from the ring is corrupt: it is not",
        ),
        (of(ElevationTile::new(node(9, 0, 3), SlotKey::new(1, 5))), "not of a node with elevation"),
        (of(ElevationTile { slot: 2, ..leaf }), "its slot is not one of the elevation pool's"),
        (vec![opened, named(&[root, leaf]), tile(0), closed(2)], "does not belong to the frame"),
        (vec![opened, named(&[root, leaf]), tile(2), closed(2)], "does not belong to the frame"),
        (vec![opened, named(&[root, leaf]), tile(u64::MAX), closed(2)], "does not belong to the frame"),
        (vec![opened, named(&[root, leaf]), tile(1), closed(1)], "number of its elevation tiles is 1, expected 2"),
    ];
    for (slots, sentence) in cases {
        let error = feed(&slots).unwrap_err();
        assert!(error.contains(sentence), "{error:?} does not say {sentence:?}");
    }
    let without = SourceShape { elevation_pool: None, ..shape() };
    let mut reader = FrameReader::new(without, SIZE).expect("the world is small");
    let slots = with_view(&[opened, named(&[root])]);
    let refused = slots.iter().try_fold(false, |_, slot| reader.add(&Slot::new(slot))).expect_err("no pool is read");
    assert!(refused.to_string().contains("elevation pool's"), "{refused}");
}

#[test]
fn views_that_cannot_be_are_refused_with_a_sentence() {
    let [opened, closed] = [SlotContent::Marker(marker()), SlotContent::End(end())];
    let tile = SlotContent::Tile(TileSlot { elevation_position: 100, ..good_tile() });
    let of = |change: &dyn Fn(&mut ViewSlot)| {
        let mut view = view();
        change(&mut view);
        SlotContent::View(view)
    };
    let whole = of(&|_| {});
    let [first, second] = [0, 1].map(|index| of(&|view| (view.index, view.count) = (index, 2)));
    let far = camera([1e11, 0.0, 0.0], 0.0, 0.0, SIZE);
    let cases: [(Vec<SlotContent>, &str); 12] = [
        (vec![whole], "found a view, expected a frame marker"),
        (vec![opened, tile], "found a tile, expected a view"),
        (vec![opened, closed], "found the end of a frame, expected a view"),
        (vec![opened, first, tile], "found a tile, expected a view"),
        (vec![opened, whole, whole], "found a view, expected a tile"),
        (vec![opened, of(&|view| view.count = 0)], "the number of views is 0"),
        (vec![opened, of(&|view| view.count = 7)], "the number of views is 7, expected 6"),
        (vec![opened, second], "the number of a view is 1, expected 0"),
        (vec![opened, first, of(&|view| (view.index, view.count) = (1, 3))], "the number of views is 3, expected 2"),
        (vec![opened, of(&|view| view.at = [1, 0])], "view 0 of frame 7 from the ring has no valid camera within"),
        (vec![opened, of(&|view| view.camera.vfov_rad = f64::NAN)], "no valid camera within"),
        (vec![opened, of(&|view| view.camera = *far.fields())], "no valid camera within"),
    ];
    for (slots, sentence) in cases {
        let error = feed_as_they_are(&slots).unwrap_err();
        assert!(error.contains(sentence), "{error:?} does not say {sentence:?}");
    }
    assert_eq!(feed_as_they_are(&[opened, first, second, tile, closed]), Ok(true));
}

#[test]
fn a_tile_of_another_generation_than_the_pool_has_ends_the_run() {
    let flat = |_: f64, _: f64| 0.0;
    let green = |_: f64, _: f64| [0, 200, 0];
    let mut scene = Scene::new(world([16, 16]), &flat, &green);
    let camera = camera([80.0, 80.0, 100.0], 0.0, -90.0, SIZE);
    let tile = scene.leaf(node(0, 0, 1), &camera, [0; 4]);
    scene.frame(&camera, vec![TileSlot { color_generation: 9, ..tile }]);
    let recording = scene.finish();
    for options in support::paths(&options(SIZE)) {
        let error = draw(&options, &recording).unwrap_err().to_string();
        assert!(error.contains("holds another generation"), "{error}");
    }
}

proptest! {
    #[test]
    fn any_bytes_are_refused_or_drawn_within_bounds(words: [u64; 7], flips in prop::collection::vec((0usize..56, any::<u8>()), 0..4)) {
        let world = world([64, 40]);
        let mut tiles = [bytemuck::cast::<[u64; 7], TileSlot>(words), good_tile()];
        for (at, value) in flips {
            bytemuck::bytes_of_mut(&mut tiles[1])[at] = value;
        }
        for tile in tiles {
            if check_tile(&tile, &world, 4).is_ok() {
                prop_assert!(tile.end.iter().all(|&end| u32::from(end) <= world.elevation_tile()));
                prop_assert!(tile.start[0] < tile.end[0] && tile.start[1] < tile.end[1]);
                prop_assert!(tile.color_slot < 4 && tile.elevation_level < world.levels());
                prop_assert!(tile.elevation_origin[0] < 64 && tile.elevation_origin[1] < 40);
                prop_assert!(tile.edge_snap.iter().all(|&snap| 1 << snap <= world.elevation_tile()));
            }
        }
    }

    #[test]
    fn any_sequence_of_slots_is_read_without_a_panic(
        slots in prop::collection::vec((0u64..5, prop::array::uniform16(prop_oneof![0u64..200, any::<u64>()])), 1..12)
    ) {
        let mut reader = FrameReader::new(shape(), SIZE).unwrap();
        for (kind, payload) in slots {
            let mut words = [0u64; 17];
            words[0] = kind;
            words[1..].copy_from_slice(&payload);
            if reader.add(&bytemuck::cast::<[u64; 17], Slot>(words)).is_err() {
                break;
            }
        }
    }
}
