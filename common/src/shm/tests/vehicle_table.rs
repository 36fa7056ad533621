//! The vehicle table between its two ends.

use crate::ids::FrameNumber;
use crate::shm::TableHead;
use crate::shm::kind::SegmentKind;
use crate::shm::memory::{self, segment};
use crate::shm::vehicle_layout::{TABLE_FRAMES, table_frame_bytes};
use crate::shm::vehicle_table::{VehicleTableReader, VehicleTableWriter};
use crate::shm::want_core::WantWords;
use crate::vehicle::VehicleRecord;
use glam::{DVec3, Quat};
use proptest::prelude::*;

fn record(vehicle: u32) -> VehicleRecord {
    VehicleRecord::new(vehicle, DVec3::new(1.0, f64::from(vehicle), 3.0), Quat::IDENTITY)
}

fn head(frame: u64) -> TableHead {
    TableHead { frame: FrameNumber::new(frame), time_s: 0.5 * frame as f64 }
}

#[test]
fn each_frame_has_its_own_vehicles_until_another_takes_its_place() {
    let (mut writer, mut reader) = memory::vehicle_table(2).unwrap();
    assert_eq!(writer.frames(), TABLE_FRAMES);
    assert_eq!(reader.read(FrameNumber::new(7)).unwrap(), None);
    writer.write(head(7), &[record(0)]);
    writer.write(head(8), &[record(1), record(2), record(3)]);
    assert_eq!(reader.read(FrameNumber::new(7)).unwrap(), Some((head(7), vec![record(0)])));
    assert_eq!(reader.read(FrameNumber::new(7)).unwrap(), Some((head(7), vec![record(0)])), "as often as it is asked");
    // More than there is room for: the first.
    assert_eq!(reader.read(FrameNumber::new(8)).unwrap(), Some((head(8), vec![record(1), record(2)])));
    writer.write(head(7 + TABLE_FRAMES), &[]);
    assert_eq!(reader.read(FrameNumber::new(7)).unwrap(), None);
    assert_eq!(reader.read(FrameNumber::new(7 + TABLE_FRAMES)).unwrap(), Some((head(7 + TABLE_FRAMES), vec![])));
}

#[test]
fn a_run_without_vehicles_has_a_table_without_room() {
    let (mut writer, mut reader) = memory::vehicle_table(0).unwrap();
    writer.write(head(3), &[record(0)]);
    assert_eq!((writer.frames(), reader.read(FrameNumber::new(3)).unwrap()), (1, Some((head(3), vec![]))));
    for bytes in [8, 383, 384 + 65] {
        assert!(VehicleTableReader::attach(&segment(SegmentKind::VehicleTable, 4, bytes).unwrap()).is_err(), "{bytes}");
    }
    assert!(VehicleTableWriter::attach(&segment(SegmentKind::WantList, 4, 8).unwrap()).is_err());
}

proptest! {
    #[test]
    fn a_table_of_any_words_gives_valid_vehicles_or_says_what_is_wrong(
        version in any::<u64>(), words in prop::array::uniform4(prop_oneof![Just(8), Just(16), 0u64..40, any::<u64>()]),
        frame in 0u64..3
    ) {
        let segment = segment(SegmentKind::VehicleTable, 1, table_frame_bytes(2)).unwrap();
        let mut reader = VehicleTableReader::attach(&segment).unwrap();
        let mut writer = VehicleTableWriter::attach(&segment).unwrap();
        let wrong = VehicleRecord { position_in_world: [f64::NAN; 3], ..record(1) };
        writer.write(head(frame), &[record(0), wrong]);
        segment.region().words::<WantWords>(segment.item_offset(0)).overwrite(version, words);
        match reader.read(FrameNumber::new(frame)) {
            Ok(Some((found, vehicles))) => {
                prop_assert_eq!((found.frame.get(), words[0]), (frame, frame));
                prop_assert!(vehicles.iter().all(|vehicle| *vehicle == record(0)));
            }
            Ok(None) => {}
            Err(error) => prop_assert!(words[3] > 16 || words[3] % 8 != 0, "{error}"),
        }
        // A writer that takes it over is understood.
        writer.write(head(frame + 1), &[record(5)]);
        prop_assert_eq!(reader.read(FrameNumber::new(frame + 1)).unwrap(), Some((head(frame + 1), vec![record(5)])));
    }
}
