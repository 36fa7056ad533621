//! Shared memory that other programs write: events of a stage, frames, poses. (Segments of a run:
//! `common/src/shm/tests/garbage.rs`.)

use crate::within;
use std::fs::{File, OpenOptions};
use std::os::unix::fs::FileExt;
use std::path::Path;
use terravision_common::event::{Event, SpanName};
use terravision_common::ids::FrameNumber;
use terravision_common::shm::{
    FrameRing, FrameRingReader, FrameShape, PoseInbox, PoseRecord, PoseSender, SharedFrame, Stage,
};
use terravision_launcher::measure::collector::Collector;
use terravision_tests::fuzz::{Numbers, Target};
use terravision_tests::live::shared_name;

/// An event of each kind, as it lies in memory: kind and thread, then frame, start, duration, value
/// and node.
fn events() -> Vec<u8> {
    let event = |kind: u64| {
        let value = SpanName::Generate as u64 + kind % 9;
        [kind, kind % 5, 1_000_000 * kind, 5_000 * kind, value, 0].map(u64::to_le_bytes).concat()
    };
    // Some numbers are of no kind.
    (0..40).flat_map(event).collect()
}

#[test]
fn events_of_a_stage() {
    let target = Target {
        name: "events",
        inputs: vec![events()],
        words: &[b"\0\0\0\0\0\0\0\0", &[0xff; 8], b"corrupt: "],
        short_round: 3000,
    };
    target.run(|bytes| {
        within(16 << 20, || {
            let mut collector = Collector::new(FrameNumber::new(0), 8, false);
            for event in bytes.chunks_exact(size_of::<Event>()) {
                let event: Event = bytemuck::pod_read_unaligned(event);
                for stage in [Stage::Generator, Stage::Preparer, Stage::Renderer, Stage::Prefetcher] {
                    collector.take(stage, event);
                }
            }
            let told = [collector.device(), collector.driver(), collector.technique().unwrap_or_default()];
            // What is printed of it is escaped there.
            assert!(told.iter().all(|text| text.len() <= 12 * bytes.len()), "{told:?}");
        });
    });
}

/// Writes over a public segment as any program of the user may, at a place that the input's first
/// bytes choose.
fn scribble(file: &File, bytes: &[u8]) {
    let length = file.metadata().unwrap().len();
    let mut numbers = Numbers::new(
        bytes.iter().fold(bytes.len() as u64, |sum, byte| sum.wrapping_mul(31).wrapping_add(u64::from(*byte))),
    );
    for part in bytes.chunks(16) {
        // Heads of segments and slots are where numbers are believed: half of all parts go there.
        let span = if numbers.below(2) == 0 { length.min(1024) } else { length };
        let at = (numbers.any() % span).min(length - part.len() as u64);
        file.write_all_at(part, at).unwrap();
    }
}

fn segment(name: &str) -> File {
    OpenOptions::new().read(true).write(true).open(Path::new("/dev/shm").join(name)).unwrap()
}

#[test]
fn frames_of_another_program() {
    let name = shared_name("fuzz-frames");
    let shape = FrameShape { size: [16, 8], has_depth: true, has_ground: true };
    let ring = FrameRing::create(&name, shape).unwrap();
    let file = segment(&name.ring_file());
    let mut whole = vec![0; file.metadata().unwrap().len() as usize];
    file.read_exact_at(&mut whole, 0).unwrap();
    let inputs = vec![whole[..512].to_vec(), vec![0xff; 64], vec![1; 64]];
    let target = Target {
        name: "frame-ring",
        inputs,
        words: &[&[0xff; 8], &[0; 8], &1u64.to_le_bytes(), &2u64.to_le_bytes()],
        short_round: 1500,
    };
    let mut reader = FrameRingReader::open(&name).unwrap();
    target.run(|bytes| {
        scribble(&file, bytes);
        within(64 << 20, || {
            let mut frame = SharedFrame::default();
            drop(reader.read(&mut frame));
            assert!(frame.rgba.len() <= 16 * 8 * 4);
            assert!(
                (reader.newest(), reader.is_ended(), reader.launcher_pid()).2 < u32::MAX || reader.shape() == shape
            );
            // A new reader does not trust the content either.
            drop(FrameRingReader::open(&name));
        });
        file.write_all_at(&whole, 0).unwrap();
    });
    drop(ring);
}

#[test]
fn poses_of_another_program() {
    let name = shared_name("fuzz-poses");
    let mut inbox = PoseInbox::create(&name).unwrap();
    let file = segment(&name.camera_file());
    let sender = PoseSender::open(&name).unwrap();
    let record = PoseRecord {
        position: [500_000.0, 5_000_000.0, 1000.0],
        heading_deg: 90.0,
        pitch_deg: -10.0,
        roll_deg: 0.0,
        vfov_deg: 60.0,
        time_s: 1.0,
        size: [0; 2],
        is_end: false,
    };
    sender.send(&record);
    let mut whole = vec![0; file.metadata().unwrap().len() as usize];
    file.read_exact_at(&mut whole, 0).unwrap();
    let inputs = vec![whole[..256].to_vec(), vec![0xff; 32]];
    let target = Target {
        name: "poses",
        inputs,
        words: &[&f64::NAN.to_le_bytes(), &[0xff; 8], &3u64.to_le_bytes()],
        short_round: 1500,
    };
    target.run(|bytes| {
        scribble(&file, bytes);
        within(1 << 20, || {
            for _ in 0..3 {
                drop(inbox.read());
            }
            drop(inbox.answer(1, 2));
            drop(PoseSender::open(&name));
        });
        file.write_all_at(&whole, 0).unwrap();
    });
}
