//! Storms over a flight: stages that are killed at random, bytes that are written at random. A
//! reader of the frame ring watches. Tests fly short ones, `scripts/storm.sh` long ones.

mod bytes;
mod death;

pub use bytes::{BytesReport, BytesStorm};
pub use death::{DeathReport, DeathStorm};

use crate::flight::{Pose, write_path};
use crate::folder::TestFolder;
use crate::process::{Running, Terravision, segments_of_launcher};
use crate::worlds::TestWorld;
use std::time::Duration;
use terravision_common::bug::INTERNAL_ERROR_WORDS;
use terravision_common::shm::{RunId, SegmentKind, SharedName};

/// Picture of a storm's flight: small, so that a frame is quick on any machine.
const SIZE: [u32; 2] = [320, 180];
const FPS: u32 = 20;
/// A sky that no texture has, and its flag.
const SKY: [u8; 3] = [255, 0, 255];

/// Numbers that come again with their seed (Marsaglia's xorshift64).
#[derive(Debug, Clone)]
struct Random(u64);

impl Random {
    fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    fn below(&mut self, end: usize) -> usize {
        (self.next() % end.max(1) as u64) as usize
    }
}

/// A flight against the clock that shares its frames: to and fro over a ridge, with a horizon that
/// nods.
fn flight(world: &TestWorld, folder: &TestFolder, name: &SharedName, seconds: f64, restarts: u32) -> Terravision {
    let frames = (seconds * f64::from(FPS)).ceil() as u64;
    let poses: Vec<Pose> = (0..frames)
        .map(|k| {
            let t = k as f64 / f64::from(FPS);
            let east = 0.5 + 0.3 * (0.11 * t).sin();
            Pose::new(world.above(east, 0.4, 500.0), 60.0 + 40.0 * (0.07 * t).sin(), -12.0 + 6.0 * (0.9 * t).sin())
        })
        .collect();
    write_path(&folder.join("path.json"), &poses, SIZE, 60.0);
    Terravision::verb("fly")
        .arg(world.database())
        .args(["--mode", "realtime", "--fps", &FPS.to_string(), "--path"])
        .arg(folder.join("path.json"))
        .args(["-o", &format!("shared:{name}"), "--depth", "--restarts", &restarts.to_string()])
        .args(["--sky", &SKY.map(|channel| channel.to_string()).join(","), "--memory", "256MiB"])
        .arg("--report")
        .arg(folder.join("report.json"))
        .deadline(Duration::from_secs(120) + Duration::from_secs_f64(2.0 * seconds))
}

/// The run of a flight, as soon as it has a control block.
fn run_of(flight: &Running) -> Option<RunId> {
    let suffix = format!("-{}", SegmentKind::Control.name());
    let segments = segments_of_launcher(flight.pid());
    RunId::parse(segments.iter().find_map(|name| name.strip_suffix(&suffix))?).ok()
}

/// What no process of a storm may ever say, or be said of.
fn crash_in(said: &str) -> Option<&str> {
    let crashes = [INTERNAL_ERROR_WORDS, "panicked", "signal 4", "signal 6", "signal 7", "signal 8", "signal 11"];
    said.lines().find(|line| crashes.iter().any(|crash| line.contains(crash)))
}
