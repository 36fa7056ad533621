//! Measures the latency of the ring and of the ping-pong buffer between two processes: `cargo run
//! --release -p terravision-common --example hand_over`.
//!
//! It is also the smallest program that shares memory between two processes: it makes the segments,
//! starts the other process with the run's name, and opens the handles on both sides. A message
//! goes to the other process and an answer comes back; half of the round trip is the latency. The
//! first process pauses before each message: without a pause the other one has just begun to wait,
//! with a pause it sleeps.

use bytemuck::Zeroable;
use std::error::Error;
use std::io::Write;
use std::process::Command;
use std::time::{Duration, Instant};
use terravision_common::shm::{
    CameraRecord, Consumer, Control, Layout, Producer, RunId, RunSegments, SegmentKind, TreeReader, TreeWriter,
};
use terravision_common::slot::{FrameEnd, Slot, SlotContent};
use terravision_common::tree::TreeHeader;

const ROUNDS: u64 = 2000;
const RESTS_MICROS: [u64; 4] = [0, 50, 500, 5000];

fn main() -> Result<(), Box<dyn Error>> {
    if let Some(run) = std::env::args().nth(1) {
        return answer(&RunId::parse(&run)?);
    }
    let run = RunId::new_for_this_process()?;
    let segments = RunSegments::create(&run, &Layout::small())?;
    let mut other = Command::new(std::env::current_exe()?).arg(run.to_string()).spawn()?;
    ask(&run)?;
    other.wait()?;
    drop(segments);
    Ok(())
}

/// Sends slots and trees, and waits for the answer to each.
fn ask(run: &RunId) -> Result<(), Box<dyn Error>> {
    let control = Control::open(run)?;
    let mut ring = Producer::<Slot>::open(run, SegmentKind::Ring)?;
    let mut trees = TreeWriter::open(run)?;
    let mut answers = Consumer::<CameraRecord>::open(run, SegmentKind::CameraRing)?;
    let mut out = std::io::stdout().lock();
    // The first answer shows that the other process is ready.
    answers.pop(&control)?;
    for rest in RESTS_MICROS.map(Duration::from_micros) {
        let mut slots = Vec::with_capacity(ROUNDS as usize);
        for frame in 0..ROUNDS {
            std::thread::sleep(rest);
            let start = Instant::now();
            ring.push(&Slot::new(&SlotContent::End(FrameEnd { frame, ..FrameEnd::zeroed() })), &control)?;
            answers.pop(&control)?;
            slots.push(start.elapsed() / 2);
        }
        let mut halves = Vec::with_capacity(ROUNDS as usize);
        for frame in 0..ROUNDS {
            std::thread::sleep(rest);
            let start = Instant::now();
            trees.write(&control, |_| TreeHeader { frame, ..TreeHeader::zeroed() })?;
            answers.pop(&control)?;
            halves.push(start.elapsed() / 2);
        }
        let rest = rest.as_micros();
        writeln!(out, "rest {rest:>4} us: ring {}, ping-pong {}", line(slots), line(halves))?;
    }
    Ok(())
}

/// Answers each slot and each tree.
fn answer(run: &RunId) -> Result<(), Box<dyn Error>> {
    let control = Control::open(run)?;
    let mut ring = Consumer::<Slot>::open(run, SegmentKind::Ring)?;
    let mut trees = TreeReader::open(run)?;
    let mut answers = Producer::<CameraRecord>::open(run, SegmentKind::CameraRing)?;
    answers.push(&CameraRecord::zeroed(), &control)?;
    for _ in RESTS_MICROS {
        for _ in 0..ROUNDS {
            ring.pop(&control)?;
            answers.push(&CameraRecord::zeroed(), &control)?;
        }
        for _ in 0..ROUNDS {
            drop(trees.next(&control)?);
            answers.push(&CameraRecord::zeroed(), &control)?;
        }
    }
    Ok(())
}

fn line(mut times: Vec<Duration>) -> String {
    times.sort_unstable();
    let at = |p: f64| times.get((p * (times.len() - 1) as f64) as usize).map_or(0.0, |time| time.as_secs_f64() * 1e6);
    format!("p50 {:.1} us, p99 {:.1} us, worst {:.1} us", at(0.5), at(0.99), at(1.0))
}
