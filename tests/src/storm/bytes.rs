//! The storm that writes random bytes over the heads of rings, trees and pools.

use super::{Random, crash_in, flight, run_of};
use crate::folder::TestFolder;
use crate::live::{left_of, reader, shared_name};
use crate::process::{is_alive, segments_of_launcher, signal_process};
use crate::worlds::TestWorld;
use rustix::process::Signal;
use std::fmt;
use std::fs::OpenOptions;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::time::{Duration, Instant};
use terravision_common::shm::{FrameRingReader, SegmentKind, SharedFrame};

/// What is written over. The control block is not among them: it says whether the run goes on, and
/// any bytes say something about that.
const TARGETS: [SegmentKind; 8] = [
    SegmentKind::Ring,
    SegmentKind::PingPong,
    SegmentKind::ElevationRing,
    SegmentKind::ColorPool,
    SegmentKind::ElevationPool,
    SegmentKind::WantList,
    SegmentKind::TileOutcomes,
    SegmentKind::EventsRenderer,
];
/// Header and positions of a segment; tables, trees and slots lie behind the first page.
const HEAD_BYTES: usize = 1024;
const BEHIND_HEAD_BYTES: usize = 65536;
/// Stages of a flight that are started again before it is given up.
const RESTARTS: u32 = 4;

/// Flights whose shared memory is written over.
#[derive(Debug, Clone, Copy)]
pub struct BytesStorm {
    /// Flights.
    pub rounds: u32,
    /// How long each is written at.
    pub seconds: f64,
    /// Time from one write to the next.
    pub every: Duration,
    /// Decides what is written where.
    pub seed: u64,
}

/// What a storm of bytes came to.
#[derive(Debug, Clone, Default)]
pub struct BytesReport {
    /// Flights.
    pub rounds: u32,
    /// Writes.
    pub writes: u64,
    /// Flights that were still flying at the end of their storm.
    pub flew_on: u32,
    /// Flights that had been given up, in a sentence.
    pub gave_up: u32,
    /// Frames that the reader saw.
    pub frames_seen: u64,
    /// Looks of the reader that found the ring corrupt.
    pub refused: u64,
    /// What must not be: crashes, leftovers, endings without a message.
    pub faults: Vec<String>,
}

impl fmt::Display for BytesReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} flights, {} writes: {} flew on, {} were given up with a reason, 0 crashed; the reader saw {} frames and \
             refused {} times; {} faults",
            self.rounds,
            self.writes,
            self.flew_on,
            self.gave_up,
            self.frames_seen,
            self.refused,
            self.faults.len()
        )
    }
}

impl BytesStorm {
    /// Flies through it.
    ///
    /// # Panics
    /// When a flight does not start, or does not end in time.
    #[must_use]
    pub fn fly(&self, world: &TestWorld) -> BytesReport {
        let mut report = BytesReport { rounds: self.rounds, ..BytesReport::default() };
        let mut random = Random::new(self.seed);
        for round in 0..self.rounds {
            self.round(round, world, &mut random, &mut report);
        }
        report
    }

    fn round(&self, round: u32, world: &TestWorld, random: &mut Random, report: &mut BytesReport) {
        let (folder, name) = (TestFolder::new("storm-bytes"), shared_name("storm-bytes"));
        let mut flight = flight(world, &folder, &name, self.seconds + 60.0, RESTARTS).spawn();
        let mut ring = reader(&mut flight, &name);
        let run = flight.until("the control block", run_of);
        let mut frame = SharedFrame::default();
        flight.until("the first frame", |_| ring.read(&mut frame).is_ok_and(|is_new| is_new).then_some(()));
        let stages: Vec<u32> = flight.children().into_iter().map(|(pid, _)| pid).collect();
        let end = Instant::now() + Duration::from_secs_f64(self.seconds);
        let mut next_write = Instant::now();
        // Half of the flights have one segment written over, so that no other trouble ends them
        // sooner.
        let only = round.is_multiple_of(2).then(|| random.below(TARGETS.len() + 1));
        while Instant::now() < end && !flight.has_ended() {
            if Instant::now() >= next_write {
                next_write += self.every;
                let target = only.unwrap_or_else(|| random.below(TARGETS.len() + 1));
                let file = TARGETS.get(target).map_or_else(|| name.ring_file(), |kind| run.segment_name(*kind));
                report.writes += u64::from(scribble(&Path::new("/dev/shm").join(file), random));
            }
            match ring.read(&mut frame) {
                Ok(is_new) => report.frames_seen += u64::from(is_new),
                Err(_corrupt) => report.refused += 1,
            }
            // One that comes anew has the header to check, too.
            report.refused += u64::from(FrameRingReader::open(&name).is_err());
            std::thread::sleep(Duration::from_millis(2));
        }
        let launcher = flight.pid();
        if flight.has_ended() {
            report.gave_up += 1;
        } else {
            report.flew_on += 1;
            signal_process(launcher, Signal::INT);
        }
        let finished = flight.wait();
        let mut fault = |what: String| report.faults.push(format!("round {round}: {what}"));
        if !matches!(finished.code(), Some(0 | 1 | 3 | 130)) {
            fault(format!("the launcher ended with {}: {}", finished.status, finished.stderr));
        }
        if finished.code() != Some(0) && finished.stderr.trim().is_empty() {
            fault("it ended without a message".to_owned());
        }
        if let Some(line) = crash_in(&finished.stderr) {
            fault(format!("a crash: {line}"));
        }
        let left = segments_of_launcher(launcher).len() + left_of(&name).len();
        if left > 0 {
            fault(format!("{left} segments are left"));
        }
        let alive = stages.into_iter().filter(|pid| is_alive(*pid)).count();
        if alive > 0 {
            fault(format!("{alive} processes are left"));
        }
    }
}

/// Writes up to 64 random bytes somewhere into the head of a file, or behind it; whether it is
/// there.
fn scribble(path: &Path, random: &mut Random) -> bool {
    let Ok(file) = OpenOptions::new().write(true).open(path) else { return false };
    let len = 1 + random.below(64);
    let reach = if random.below(2) == 0 { HEAD_BYTES } else { BEHIND_HEAD_BYTES };
    let bytes: Vec<u8> = (0..len).map(|_| random.next() as u8).collect();
    // Never behind the end: the file must not grow.
    let size = file.metadata().map_or(0, |found| found.len()) as usize;
    let at = random.below(reach.min(size.saturating_sub(len)));
    file.write_all_at(&bytes, at as u64).is_ok()
}
