//! Other programs in a flight: names of their own, Python, frames out of the ring.

use crate::flight::Pose;
use crate::process::{Running, Terravision};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};
use terravision_common::shm::{FrameInfo, FrameRingReader, PoseRecord, PoseSender, SharedFrame, SharedName};

/// A name that no other test has.
///
/// # Panics
/// Never: the name is good.
#[must_use]
pub fn shared_name(test: &str) -> SharedName {
    static SERIAL: AtomicU32 = AtomicU32::new(0);
    // Relaxed: only uniqueness matters.
    let serial = SERIAL.fetch_add(1, Ordering::Relaxed);
    SharedName::parse(&format!("{test}-{}-{serial}", std::process::id())).expect("letters, digits and dashes")
}

/// What of this name lies in `/dev/shm`.
#[must_use]
pub fn left_of(name: &SharedName) -> Vec<PathBuf> {
    let files = [name.ring_file(), name.camera_file()];
    files.into_iter().map(|file| Path::new("/dev/shm").join(file)).filter(|path| path.exists()).collect()
}

/// A Python that has numpy and Pillow.
///
/// # Panics
/// When it is missing: `scripts/setup.sh --tests` installs it.
#[must_use]
pub fn python() -> &'static str {
    static PYTHON: OnceLock<Option<&'static str>> = OnceLock::new();
    let found = PYTHON.get_or_init(|| {
        ["python3", "/usr/bin/python3"].into_iter().find(|python| {
            let mut command = Command::new(python);
            command.args(["-c", "import numpy, PIL"]).stdout(Stdio::null()).stderr(Stdio::null());
            command.status().is_ok_and(|status| status.success())
        })
    });
    found.expect("a Python with numpy and Pillow; scripts/setup.sh --tests installs python3-numpy and python3-pil")
}

/// A program of `examples/`.
#[must_use]
pub fn example(script: &str) -> Terravision {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples").join(script);
    // No __pycache__ beside the sources.
    Terravision::program(python()).arg(path).env("PYTHONDONTWRITEBYTECODE", "1")
}

/// A reader of the ring of a flight that has just been started.
///
/// # Panics
/// When the ring does not appear before the flight's deadline.
pub fn reader(flight: &mut Running, name: &SharedName) -> FrameRingReader {
    flight.until("the frame ring", |_| FrameRingReader::open(name).ok())
}

/// A sender of poses to a flight that has just been started.
///
/// # Panics
/// When the segment does not appear before the flight's deadline.
pub fn sender(flight: &mut Running, name: &SharedName) -> PoseSender {
    flight.until("the segment of poses", |_| PoseSender::open(name).ok())
}

/// Waits for a frame that `is_it`.
///
/// # Panics
/// When it does not come before the flight's deadline or its end, or the ring is corrupt.
pub fn frame(
    flight: &mut Running,
    reader: &mut FrameRingReader,
    into: &mut SharedFrame,
    is_it: impl Fn(&FrameInfo) -> bool,
) -> FrameInfo {
    flight.until("a frame", |_| {
        let is_new = reader.read(into).unwrap_or_else(|error| panic!("{error}"));
        into.info.filter(|info| is_new && is_it(info))
    })
}

/// Waits until another program has mapped the ring of a flight.
///
/// # Panics
/// When it does not before the flight's deadline or its end.
pub fn wait_attached(flight: &mut Running, program: &Running, name: &SharedName) {
    let maps = format!("/proc/{}/maps", program.pid());
    flight.until("a reader to attach", |_| {
        std::fs::read_to_string(&maps).ok().filter(|maps| maps.contains(&name.ring_file()))
    });
}

/// The pose as a record of shared memory.
#[must_use]
pub fn record(pose: &Pose, time_s: f64) -> PoseRecord {
    PoseRecord {
        position: pose.eye,
        heading_deg: pose.heading,
        pitch_deg: pose.pitch,
        roll_deg: pose.roll,
        vfov_deg: 60.0,
        time_s,
        size: [0; 2],
        is_end: false,
    }
}

/// Sends a pose and waits for its frame.
///
/// # Panics
/// When the frame does not come before the flight's deadline or its end, or the ring is corrupt.
pub fn step(
    flight: &mut Running,
    poses: &PoseSender,
    reader: &mut FrameRingReader,
    into: &mut SharedFrame,
    record: &PoseRecord,
) -> FrameInfo {
    poses.send(record);
    frame(flight, reader, into, |info| info.pose_time_s == record.time_s)
}

/// The flight is over.
pub fn end(poses: &PoseSender) {
    poses.send(&PoseRecord { is_end: true, ..record(&Pose::new([0.0; 3], 0.0, 0.0), 0.0) });
}

/// The colours of a shared frame, without alpha.
#[must_use]
pub fn rgb(frame: &SharedFrame) -> Vec<[u8; 3]> {
    frame.rgba.chunks_exact(4).map(|p| [p[0], p[1], p[2]]).collect()
}
