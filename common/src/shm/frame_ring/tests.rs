//! The ring between threads, and a header that anybody may have overwritten.

use super::*;
use crate::sync::Ordering;
use proptest::prelude::*;
use std::sync::atomic::{AtomicBool, AtomicU32};

fn unique(what: &str) -> SharedName {
    static SERIAL: AtomicU32 = AtomicU32::new(0);
    // Relaxed: only uniqueness matters.
    let serial = SERIAL.fetch_add(1, Ordering::Relaxed);
    SharedName::parse(&format!("unit-{what}-{}-{serial}", std::process::id())).unwrap()
}

fn shape(size: [u32; 2]) -> FrameShape {
    FrameShape { size, has_depth: true, has_ground: true }
}

fn info(frame: u64) -> FrameInfo {
    FrameInfo {
        frame,
        published_nanos: 10 * frame,
        camera_nanos: 1000 + frame,
        pose_time_s: f64::NAN,
        position: [frame as f64, 2.0, 3.0],
        heading_deg: 4.0,
        pitch_deg: 5.0,
        roll_deg: 6.0,
        vfov_deg: 60.0,
        size: [0; 2],
        is_settled: frame.is_multiple_of(2),
    }
}

/// Every word of the frame tells its number.
fn write(writer: &mut FrameRingWriter, frame: u64, pixels: usize) -> u64 {
    let rgba = vec![frame as u8; pixels * 4];
    let depth = std::iter::repeat_n(frame as f32, pixels);
    let ground = std::iter::repeat_n([frame as f64; 3], pixels);
    writer.write(&info(frame), &rgba, depth, ground).unwrap()
}

fn sized(frame: u64, size: [u32; 2]) -> FrameInfo {
    FrameInfo { size, ..info(frame) }
}

fn assert_whole(frame: &SharedFrame, pixels: usize) {
    let of = frame.info.unwrap().frame;
    assert_eq!(frame.info.unwrap().position[0], of as f64);
    assert!(frame.rgba.len() == pixels * 4 && frame.rgba.iter().all(|&v| v == of as u8));
    assert!(frame.depth.len() == pixels && frame.depth.iter().all(|&v| v == of as f32));
    assert!(frame.ground.len() == pixels * 3 && frame.ground.iter().all(|&v| v == of as f64));
}

#[test]
fn frames_come_out_as_they_went_in_and_the_newest_wins() {
    let name = unique("order");
    // An odd number of pixels: planes end within a word.
    let (shape, pixels) = (shape([5, 3]), 15);
    let ring = FrameRing::create(&name, shape).unwrap();
    let mut reader = FrameRingReader::open(&name).unwrap();
    let mut frame = SharedFrame::default();
    assert_eq!(reader.shape(), shape);
    assert!(!reader.read(&mut frame).unwrap() && reader.newest() == 0);
    let mut writer = FrameRingWriter::open(&name, shape).unwrap();
    ring.pose_times().note(1008, 12.5).unwrap();
    for number in 7..=9 {
        write(&mut writer, number, pixels);
        assert!(reader.read(&mut frame).unwrap());
        assert_whole(&frame, pixels);
        let got = frame.info.unwrap();
        let (time, expected) = (got.pose_time_s, info(number));
        assert!(if number == 8 { time == 12.5 } else { time.is_nan() });
        assert_eq!(FrameInfo { pose_time_s: 0.0, ..got }, FrameInfo { pose_time_s: 0.0, size: shape.size, ..expected });
        assert!(!reader.read(&mut frame).unwrap(), "nothing new");
    }
    // A reader that slept sees the newest alone.
    for number in 10..=30 {
        write(&mut writer, number, pixels);
    }
    assert!(reader.read(&mut frame).unwrap() && frame.info.unwrap().frame == 30 && frame.number == 24);
    // A writer that comes after one that died goes on.
    drop(writer);
    let mut writer = FrameRingWriter::open(&name, shape).unwrap();
    assert_eq!(write(&mut writer, 31, pixels), 25);
    assert!(reader.read(&mut frame).unwrap() && frame.info.unwrap().frame == 31);
    assert!(!reader.is_ended());
    drop(ring);
    assert!(reader.is_ended() && FrameRingReader::open(&name).is_err());
}

#[test]
fn pictures_may_be_smaller_than_the_largest() {
    let name = unique("sizes");
    let shape = shape([5, 3]);
    let _ring = FrameRing::create(&name, shape).unwrap();
    let mut writer = FrameRingWriter::open(&name, shape).unwrap();
    let mut reader = FrameRingReader::open(&name).unwrap();
    let mut frame = SharedFrame::default();
    for (number, size) in [(1u64, [5u32, 3u32]), (2, [2, 3]), (3, [5, 1]), (4, [5, 3])] {
        let pixels = (size[0] * size[1]) as usize;
        let planes = (std::iter::repeat_n(number as f32, pixels), std::iter::repeat_n([number as f64; 3], pixels));
        writer.write(&sized(number, size), &vec![number as u8; pixels * 4], planes.0, planes.1).unwrap();
        assert!(reader.read(&mut frame).unwrap());
        assert_eq!(frame.info.unwrap().size, size);
        assert_whole(&frame, pixels);
    }
    // What no picture of the ring can have is not believed.
    for size in [[6, 3], [0, 3], [5, u32::MAX]] {
        writer.write(&sized(9, size), &[9; 60], std::iter::repeat(9.0), std::iter::repeat([9.0; 3])).unwrap();
        assert!(reader.read(&mut frame).unwrap() && frame.info.unwrap().size == [5, 3]);
        assert_whole(&frame, 15);
    }
}

#[test]
fn readers_beside_a_writer_that_never_waits_see_whole_frames_alone() {
    const FRAMES: u64 = if cfg!(miri) { 50 } else { 20_000 };
    let name = unique("threads");
    let (shape, pixels) = (shape([16, 9]), 144);
    let _ring = FrameRing::create(&name, shape).unwrap();
    let mut writer = FrameRingWriter::open(&name, shape).unwrap();
    let is_over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                let mut reader = FrameRingReader::open(&name).unwrap();
                let (mut frame, mut last) = (SharedFrame::default(), 0);
                // Acquire: the last frame is published.
                while !is_over.load(std::sync::atomic::Ordering::Acquire) {
                    if reader.read(&mut frame).unwrap() {
                        assert_whole(&frame, pixels);
                        assert!(frame.number > last, "frames go on");
                        last = frame.number;
                    }
                }
                if last < FRAMES {
                    assert!(reader.read(&mut frame).unwrap());
                    assert_eq!(frame.number, FRAMES);
                }
            });
        }
        for frame in 1..=FRAMES {
            write(&mut writer, frame, pixels);
        }
        is_over.store(true, std::sync::atomic::Ordering::Release);
    });
}

/// A mapping of the file would end the process here.
#[test]
fn a_ring_that_is_cut_under_its_writer_is_an_error() {
    let name = unique("cut");
    let shape = shape([64, 64]);
    let ring = FrameRing::create(&name, shape).unwrap();
    let mut writer = FrameRingWriter::open(&name, shape).unwrap();
    write(&mut writer, 1, 64 * 64);
    let path = format!("/dev/shm/{}", name.ring_file());
    let file = std::fs::OpenOptions::new().write(true).open(&path).unwrap();
    for len in [ring.total_bytes() - 1, 4096, 0, ring.total_bytes() + 1] {
        file.set_len(len).unwrap();
        let none = || (std::iter::empty(), std::iter::empty());
        let (depth, ground) = none();
        let error = writer.write(&info(2), &[7; 64 * 64 * 4], depth, ground).unwrap_err();
        assert!(matches!(error, ShmError::CutShort { found, .. } if found == len), "{error}");
        assert!(error.to_string().contains("was cut by another program"), "{error}");
        // What it is told of poses then goes nowhere, and the end is marked in what is left.
        ring.pose_times().note(1, 2.0).unwrap();
    }
    drop(ring);
    assert!(!std::path::Path::new(&path).exists());
}

#[test]
fn a_ring_of_other_frames_is_refused() {
    let name = unique("shape");
    let _ring = FrameRing::create(&name, shape([4, 4])).unwrap();
    for other in [shape([4, 5]), FrameShape { has_depth: false, ..shape([4, 4]) }] {
        assert!(FrameRingWriter::open(&name, other).is_err());
    }
    assert!(FrameRing::create(&unique("none"), shape([0, 4])).is_err());
    assert!(FrameRing::create(&unique("none"), shape([4, 65537])).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(if cfg!(miri) { 2 } else { 200 }))]
    #[test]
    fn any_bytes_over_header_and_slots_are_an_error_or_a_frame(at in 0usize..140, bytes in proptest::collection::vec(any::<u8>(), 1..64), slot in 0u64..4) {
        let name = unique("bytes");
        let shape = shape([4, 4]);
        let ring = FrameRing::create(&name, shape).unwrap();
        let mut writer = FrameRingWriter::open(&name, shape).unwrap();
        let mut attached = FrameRingReader::open(&name).unwrap();
        write(&mut writer, 1, 16);
        let file = std::fs::OpenOptions::new().write(true).open(format!("/dev/shm/{}", name.ring_file())).unwrap();
        let slot = ring.layout.slot_offset(slot + 1);
        for offset in [at as u64, slot + at as u64] {
            std::os::unix::fs::FileExt::write_all_at(&file, &bytes, offset).unwrap();
        }
        let mut frame = SharedFrame::default();
        // Whatever comes of it, it comes back, with planes of the right size.
        for reader in [Some(&mut attached), FrameRingReader::open(&name).ok().as_mut()].into_iter().flatten() {
            for _ in 0..3 {
                if let Ok(true) = reader.read(&mut frame) {
                    let [width, height] = frame.info.unwrap().size;
                    let pixels = (width * height) as usize;
                    prop_assert!(width <= 4 && height <= 4 && frame.rgba.len() == 4 * pixels);
                    prop_assert!(frame.depth.len() == pixels && frame.ground.len() == 3 * pixels);
                }
            }
        }
        // The writer keeps to what it knows: the ring recovers by itself, for readers that are
        // attached.
        for number in 2..=6 {
            write(&mut writer, number, 16);
        }
        prop_assert!(attached.read(&mut frame).unwrap());
        assert_whole(&frame, 16);
        drop(FrameRingWriter::open(&name, shape).map(|mut writer| write(&mut writer, 7, 16)));
    }
}
