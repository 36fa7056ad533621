//! Small flights to be disturbed: of poses, which last until they are ended, however fast they are
//! drawn.

use crate::flight::Pose;
use crate::live::{reader, record, sender, step};
use crate::process::{Finished, Running, Terravision, is_alive, segments_of_launcher};
use crate::worlds::synth_world;
use std::time::{Duration, Instant};
use terravision_common::shm::{FrameRingReader, PoseRecord, PoseSender, SharedFrame, SharedName};

/// How long the processes of a flight that is over may take to be gone.
const GONE_AFTER: Duration = Duration::from_secs(20);

/// `terravision fly` over the small world, with small pictures.
#[must_use]
pub fn small_flight() -> Terravision {
    Terravision::verb("fly").arg(synth_world(1024).database()).args(["--size", "320x180"])
}

/// Pose `k` of a flight that turns over the small world.
#[must_use]
pub fn pose(k: u64) -> PoseRecord {
    let eye = synth_world(1024).above(0.35 + 0.02 * k as f64, 0.4, 500.0);
    record(&Pose::new(eye, 15.0 * k as f64, -20.0), k as f64)
}

/// Starts a flight of poses into a shared ring, and sends it poses until `frames` frames are there.
///
/// # Panics
/// When they do not come.
#[must_use]
pub fn start_of_poses(fly: Terravision, name: &SharedName, frames: u64) -> (Running, PoseSender, FrameRingReader) {
    let ends = ["--camera".to_owned(), format!("shm:{name}"), "-o".to_owned(), format!("shared:{name}")];
    let mut flight = fly.args(ends).spawn();
    let (poses, mut ring) = (sender(&mut flight, name), reader(&mut flight, name));
    let mut shared = SharedFrame::default();
    for k in 0..frames {
        step(&mut flight, &poses, &mut ring, &mut shared, &pose(k));
    }
    (flight, poses, ring)
}

/// The processes of a flight's stages.
#[must_use]
pub fn pids(running: &Running) -> Vec<u32> {
    running.children().into_iter().map(|(pid, _)| pid).collect()
}

/// Asserts that a flight ended with exit code 1 and a sentence, and left neither a process nor a
/// segment.
///
/// # Panics
/// When it did not.
pub fn assert_over(finished: &Finished, pids: &[u32]) {
    finished.assert_told(1);
    let end = Instant::now() + GONE_AFTER;
    while pids.iter().any(|pid| is_alive(*pid)) && Instant::now() < end {
        std::thread::sleep(Duration::from_millis(10));
    }
    let alive: Vec<_> = pids.iter().filter(|pid| is_alive(**pid)).collect();
    assert!(alive.is_empty(), "processes {alive:?} are left");
    assert!(segments_of_launcher(finished.pid).is_empty(), "segments are left");
}
