//! The want list between its two ends, and who is woken by it.

use super::within_deadline;
use crate::database::{Layer, Tile};
use crate::ids::{FrameNumber, Sequence};
use crate::node::NodeId;
use crate::shm::kind::SegmentKind;
use crate::shm::memory::{self, segment};
use crate::shm::want_core::WantWords;
use crate::shm::want_list::{WantListReader, WantListWriter};
use crate::shm::{RunState, WAIT_BOUND, WantHead};
use std::sync::atomic::{AtomicBool, Ordering};

fn tile(number: u32) -> Tile {
    let layer = if number.is_multiple_of(2) { Layer::Elevation } else { Layer::Color };
    Tile { layer, node: NodeId::new(number, 1, 2).unwrap() }
}

fn head(sequence: u64) -> WantHead {
    WantHead { sequence: Sequence::new(sequence), frame: FrameNumber::new(100 + sequence), is_last: false }
}

#[test]
fn the_newest_list_is_read_once_in_its_order() {
    let (mut writer, mut reader) = memory::want_list(4).unwrap();
    let mut tiles = vec![];
    assert_eq!(reader.read(&mut tiles).unwrap(), None);
    writer.publish(head(1), &[tile(1)]);
    writer.publish(head(2), &[tile(3), tile(2)]);
    assert_eq!(reader.read(&mut tiles).unwrap(), Some(head(2)));
    assert_eq!(tiles, [tile(3), tile(2)]);
    assert_eq!(reader.read(&mut tiles).unwrap(), None);
    assert_eq!(tiles, [tile(3), tile(2)], "what was read stays");
    // More than it holds: the first, which are wanted most.
    writer.publish(head(3), &[5, 6, 7, 8, 9].map(tile));
    assert_eq!(reader.read(&mut tiles).unwrap(), Some(head(3)));
    assert_eq!(tiles, [5, 6, 7, 8].map(tile));
    let last = WantHead { is_last: true, ..head(4) };
    writer.publish(last, &[]);
    assert_eq!((reader.read(&mut tiles).unwrap(), tiles.len()), (Some(last), 0));
}

#[test]
fn a_list_that_a_killed_writer_left_half_is_not_read_and_the_next_one_is() {
    let segment = segment(SegmentKind::WantList, 4, 8).unwrap();
    let mut reader = WantListReader::attach(&segment).unwrap();
    let mut writer = WantListWriter::attach(&segment).unwrap();
    writer.publish(head(1), &[tile(1)]);
    drop(writer);
    // Killed in its second write.
    segment.words::<WantWords>().overwrite(3, [2, 0, 0, 4]);
    let mut tiles = vec![];
    assert_eq!(reader.read(&mut tiles).unwrap(), None);
    WantListWriter::attach(&segment).unwrap().publish(head(5), &[tile(2)]);
    assert_eq!(reader.read(&mut tiles).unwrap(), Some(head(5)));
    assert_eq!(tiles, [tile(2)]);
}

#[test]
fn a_reader_is_woken_by_a_list_by_the_bell_and_by_the_end_of_the_run() {
    within_deadline(|| {
        let control = memory::control().unwrap();
        let (mut writer, mut reader) = memory::want_list(4).unwrap();
        let is_due = AtomicBool::new(false);
        let bell = reader.bell();
        std::thread::scope(|scope| {
            scope.spawn(|| writer.publish(head(1), &[tile(1)]));
            let mut tiles = vec![];
            while reader.read(&mut tiles).unwrap().is_none() {
                reader.wait(&control, WAIT_BOUND, || false).unwrap();
            }
            scope.spawn(|| {
                is_due.store(true, Ordering::Release);
                bell.ring();
            });
            while !is_due.load(Ordering::Acquire) {
                reader.wait(&control, WAIT_BOUND, || is_due.load(Ordering::Acquire)).unwrap();
            }
        });
        control.set_state(RunState::Stopping);
        assert!(reader.wait(&control, WAIT_BOUND, || false).unwrap_err().is_stopping());
    });
}
