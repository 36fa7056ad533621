//! Readers of bytes that may be anything: they say so, and neither panic nor read out of bounds nor
//! hang.

use crate::camera::Camera;
use crate::database::{Layer, Tile};
use crate::ids::{RingPosition, Sequence, SlotIndex, SlotKey};
use crate::shm::array_ring::{ElevationReader, ElevationWriter};
use crate::shm::control::{Control, Counter};
use crate::shm::control_words::ControlWords;
use crate::shm::cursor::Positions;
use crate::shm::geometry::{Geometry, WORDS_OFFSET, half_bytes};
use crate::shm::header::{NotUsable, Segment};
use crate::shm::kind::{SegmentKind, Stage};
use crate::shm::memory::segment;
use crate::shm::ping_pong::{TreeReader, TreeWriter};
use crate::shm::pool::{PoolIndex, PoolReader, PoolWriter};
use crate::shm::process::ProcessId;
use crate::shm::region::Region;
use crate::shm::ring::{Consumer, Producer};
use crate::shm::want_core::WantWords;
use crate::shm::want_list::{WantListReader, WantListWriter};
use crate::shm::{ShmError, WantHead, memory};
use crate::tree::TreeHeader;
use bytemuck::Zeroable;
use proptest::prelude::*;
use std::hint::black_box;
use std::sync::Arc;

/// Overwrites bytes of a segment, as a peer that lost its mind would.
fn scribble(segment: &Segment, offset: u64, bytes: &[u8]) {
    for (at, byte) in (offset..segment.region().len()).zip(bytes) {
        // SAFETY: one thread, no guard is held.
        unsafe { segment.region().write(at, byte) }
    }
}

/// Numbers near every border, and any number.
fn position() -> impl Strategy<Value = u64> {
    prop_oneof![0u64..20, Just(u64::MAX), u64::MAX - 20..u64::MAX, any::<u64>()]
}

fn bytes(len: usize) -> impl Strategy<Value = Vec<u8>> {
    proptest::collection::vec(any::<u8>(), len)
}

proptest! {
    #[test]
    fn any_header_is_refused_or_fits_its_mapping(
        words in proptest::collection::vec((0u64..12, position()), 0..6),
        pages in 1u64..5,
        kind in 0usize..SegmentKind::ALL.len(),
    ) {
        let kind = SegmentKind::ALL[kind];
        let made = Geometry::checked(kind, 2, half_bytes(4)).unwrap();
        let full = Segment::create(Region::heap(made.total_bytes).unwrap(), made).unwrap();
        for (word, value) in words {
            scribble(&full, word * 8, &value.to_le_bytes());
        }
        // The same header before a mapping of another length.
        let region = Region::heap(pages * 4096).unwrap();
        // SAFETY: one thread, the first page of both regions.
        unsafe { region.write(0, &full.region().read::<[u8; 256]>(0)) }
        if let Ok(segment) = Segment::check(region, kind, "x") {
            let geometry = *segment.geometry();
            prop_assert!(geometry.total_bytes <= pages * 4096);
            let last = segment.item_offset(geometry.capacity - 1);
            prop_assert!(last + geometry.item_bytes <= geometry.total_bytes);
        }
    }

    #[test]
    fn a_ring_with_any_positions_yields_at_most_its_capacity(write in position(), read in position(), slots in bytes(64)) {
        let segment = segment(SegmentKind::Ring, 8, 8).unwrap();
        scribble(&segment, segment.item_offset(0), &slots);
        let words: &Positions = segment.words();
        // Before the open ...
        words.overwrite(write, read);
        if let (Ok(mut consumer), Ok(mut producer)) =
            (Consumer::<u64>::attach(&segment), Producer::<u64>::attach(&segment))
        {
            let mut popped = 0;
            while let Ok(Some(_)) = consumer.try_pop() {
                popped += 1;
                prop_assert!(popped <= 8);
            }
            // ... and after it.
            words.overwrite(read, write);
            for _ in 0..20 {
                producer.try_push(1).ok();
            }
            words.overwrite(write.wrapping_mul(3), read);
            popped = 0;
            while let Ok(Some(_)) = consumer.try_pop() {
                popped += 1;
                prop_assert!(popped <= 16);
            }
        }
    }

    #[test]
    fn a_tree_of_any_bytes_stays_inside_its_half(half in bytes(half_bytes(8) as usize), count in position(), write in position()) {
        let segment = segment(SegmentKind::PingPong, 2, half_bytes(8)).unwrap();
        let control = memory::control().unwrap();
        let mut writer = TreeWriter::attach(&segment).unwrap();
        let mut reader = TreeReader::attach(&segment).unwrap();
        writer.write(&control, |_| TreeHeader::zeroed()).unwrap();
        scribble(&segment, segment.item_offset(0), &half);
        let at = std::mem::offset_of!(TreeHeader, node_count) as u64;
        scribble(&segment, segment.item_offset(0) + at, &(count as u32).to_le_bytes());
        match reader.try_next() {
            Ok(Some(tree)) => {
                prop_assert_eq!(tree.nodes().len(), count as u32 as usize);
                prop_assert!(tree.nodes().len() <= 8);
                for (index, node) in (0u32..).zip(tree.nodes()) {
                    if let Some(children) = node.children(index, tree.nodes().len() as u32) {
                        prop_assert!(children.end as usize <= tree.nodes().len());
                    }
                }
            }
            Ok(None) => prop_assert!(false, "a tree was published"),
            Err(error) => {
                let is_corrupt = matches!(error, ShmError::Corrupt { .. });
                prop_assert!(is_corrupt);
            }
        }
        segment.words::<Positions>().overwrite(write, 0);
        while let Ok(Some(_)) = reader.try_next() {}
    }

    #[test]
    fn an_elevation_ring_with_any_positions_gives_arrays_inside_it(
        write in position(), read in position(), asked in proptest::collection::vec(position(), 1..8)
    ) {
        let segment = segment(SegmentKind::ElevationRing, 4, 100).unwrap();
        segment.words::<Positions>().overwrite(write, read);
        if let Ok(mut reader) = ElevationReader::attach(&segment) {
            for position in asked {
                if let Ok(Some(values)) = reader.read_array(position) {
                    prop_assert_eq!(values.len(), 25);
                }
                reader.released(RingPosition::new(position)).ok();
                segment.words::<Positions>().overwrite(position, write);
            }
        }
        ElevationWriter::attach(&segment).ok();
    }

    #[test]
    fn a_pool_with_any_table_gives_tiles_inside_it(
        table in bytes(4 * 32), slot in position(), generation: u32, completed in position(), node in 0u32..100
    ) {
        let segment = segment(SegmentKind::ElevationPool, 4, 100).unwrap();
        scribble(&segment, segment.geometry().table_offset, &table);
        let reader = PoolReader::attach(&segment).unwrap();
        let node = crate::node::NodeId::new(node, 0, 0).unwrap();
        let completed = Sequence::new(completed);
        for info in reader.slots() {
            if let Some(tile) = reader.bytes(info.key()) {
                prop_assert_eq!(tile.bytes().len(), 100);
                prop_assert_eq!(tile.f32().len(), 25);
            }
        }
        prop_assert!(reader.bytes(SlotKey::new(slot as u32, generation)).is_none_or(|tile| tile.len() == 100));
        prop_assert_eq!(reader.slot_offset(SlotIndex::new(slot as u32)).is_some(), (slot as u32) < 4);
        // A writer that takes such a pool over works with what it finds.
        let mut writer = PoolWriter::attach(&segment).unwrap();
        writer.touch(SlotIndex::new(slot as u32), completed);
        writer.lock(SlotIndex::new(slot as u32));
        black_box(reader.find(node));
        if let Some(mut guard) = writer.allocate(node, completed, completed) {
            guard.bytes_mut().fill(7);
            guard.f32_mut().fill(1.0);
            let key = guard.publish();
            prop_assert_eq!(writer.find(node), Some(key));
        }
        scribble(&segment, segment.geometry().table_offset, &table);
        black_box(writer.residency(node));
        drop(writer.allocate(node, Sequence::FIRST, completed));
    }

    #[test]
    fn an_index_that_is_told_anything_gives_tiles_that_are_there(
        table in bytes(4 * 32), told in proptest::collection::vec((0u32..6, 0u32..6, 0u32..4, 0u64..4), 0..20)
    ) {
        let segment = segment(SegmentKind::ElevationPool, 4, 100).unwrap();
        let mut index = PoolIndex::new(PoolReader::attach(&segment).unwrap());
        scribble(&segment, segment.geometry().table_offset, &table);
        for (number, slot, generation, sequence) in told {
            let node = crate::node::NodeId::new(number, 0, 0).unwrap();
            let is_there = index.note(node, SlotKey::new(slot, generation));
            prop_assert!(!is_there || slot < 4);
            let sequence = Sequence::new(sequence);
            index.keep(node, sequence);
            if let Some(tile) = index.bytes(node, sequence) {
                prop_assert_eq!(tile.len(), 100);
            }
        }
    }

    #[test]
    fn a_want_list_of_any_words_gives_at_most_its_capacity(
        version in position(), head in prop::array::uniform4(position()), entries in bytes(8 * 8)
    ) {
        let segment = segment(SegmentKind::WantList, 8, 8).unwrap();
        let mut reader = WantListReader::attach(&segment).unwrap();
        scribble(&segment, segment.item_offset(0), &entries);
        segment.words::<WantWords>().overwrite(version, head);
        let mut tiles = Vec::new();
        match reader.read(&mut tiles) {
            Ok(Some(found)) => prop_assert!(head[3] <= 8 && tiles.len() <= 8 && found.sequence.get() == head[0]),
            Ok(None) => prop_assert!(tiles.is_empty()),
            Err(error) => prop_assert!(head[3] > 8, "{}", error),
        }
        // A writer that takes it over is understood.
        let tile = Tile { layer: Layer::Color, node: crate::node::NodeId::new(1, 0, 0).unwrap() };
        let mut writer = WantListWriter::attach(&segment).unwrap();
        for sequence in [1, 2].map(Sequence::new) {
            writer.publish(WantHead { sequence, ..WantHead::default() }, &[tile; 9]);
        }
        prop_assert_eq!(reader.read(&mut tiles).unwrap().map(|head| head.sequence.get()), Some(2));
        prop_assert_eq!(tiles, vec![tile; 8]);
    }

    #[test]
    fn a_control_block_of_any_bytes_answers(garbage in bytes(size_of::<ControlWords>())) {
        let segment = segment(SegmentKind::Control, 1, 0).unwrap();
        scribble(&segment, WORDS_OFFSET, &garbage);
        let control = Control::attach(&segment, ProcessId::own().unwrap()).unwrap();
        for stage in Stage::ALL {
            black_box((control.heartbeat_of(stage), control.pid_of(stage)));
            control.heartbeat(stage);
        }
        prop_assert!(control.camera().is_none_or(|camera| Camera::new(*camera.fields()).is_ok()));
        prop_assert!(control.r_z_px().is_none_or(|value| value > 0.0));
        black_box((control.counter(Counter::EventsDropped), control.state()));
        control.set_state(crate::shm::RunState::Failed);
        prop_assert!(control.check_running().is_err());
        // A wait ends, whatever the words say: at once, or because the run has failed.
        control.wait_completed(Sequence::new(u64::MAX)).ok();
    }
}

#[test]
fn what_is_wrong_with_a_header_is_said() {
    let geometry = Geometry::checked(SegmentKind::Ring, 8, 8).unwrap();
    let change = |offset: u64, value: u32| {
        let segment = Segment::create(Region::heap(geometry.total_bytes).unwrap(), geometry).unwrap();
        scribble(&segment, offset, &value.to_le_bytes());
        let region = Region::heap(geometry.total_bytes).unwrap();
        // SAFETY: one thread.
        unsafe { region.write(0, &segment.region().read::<[u8; 256]>(0)) }
        match Segment::check(region, SegmentKind::Ring, "the-name") {
            Err(NotUsable::Never(error)) => error.to_string(),
            other => panic!("{other:?}"),
        }
    };
    let cases = [
        (0, 1, "the-name is not a TerraVision segment"),
        (8, 77, "layout version 77, this program has "),
        (12, 1, "the kind is 1, expected the kind that its name says"),
        (16, 1, "the layout size is 1,"),
        (32, 7, "the capacity is 7, expected"),
    ];
    for (offset, value, expected) in cases {
        let message = change(offset, value);
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn handles_refuse_segments_of_other_kinds_and_records_of_other_sizes() {
    let ring = segment(SegmentKind::Ring, 8, 8).unwrap();
    assert!(TreeReader::attach(&ring).is_err());
    assert!(ElevationReader::attach(&ring).is_err());
    assert!(PoolReader::attach(&ring).is_err());
    assert!(WantListReader::attach(&ring).is_err());
    assert!(WantListWriter::attach(&segment(SegmentKind::WantList, 8, 16).unwrap()).is_err());
    assert!(Control::attach(&ring, ProcessId::own().unwrap()).is_err());
    let error = Consumer::<[u64; 2]>::attach(&ring).unwrap_err();
    assert!(error.to_string().contains("the size of a slot is 8"), "{error}");
    let pool = segment(SegmentKind::ColorPool, 8, 8).unwrap();
    assert!(matches!(Consumer::<u64>::attach(&pool), Err(ShmError::WrongKind { .. })));
}

#[test]
fn a_second_producer_is_refused_while_the_first_lives_and_goes_on_where_it_stopped() {
    let ring = segment(SegmentKind::Ring, 8, 8).unwrap();
    let mut first = Producer::<u64>::attach(&ring).unwrap();
    let taken = Producer::<u64>::attach(&ring).unwrap_err();
    assert!(matches!(taken, ShmError::RoleTaken { role: "writer", pid, .. } if pid == std::process::id()));
    first.try_push(1).unwrap();
    drop(first);
    Producer::<u64>::attach(&ring).unwrap().try_push(2).unwrap();
    let mut consumer = Consumer::<u64>::attach(&ring).unwrap();
    assert_eq!([consumer.try_pop().unwrap(), consumer.try_pop().unwrap()], [Some(1), Some(2)]);
    let weak = Arc::downgrade(&ring);
    drop((ring, consumer));
    assert!(weak.upgrade().is_none(), "a dropped handle keeps the segment");
}
