//! A frame of the flight, and its header for clients.

use std::time::{Duration, Instant};
use terravision_common::event::monotonic_nanos;
use terravision_common::shm::SharedFrame;
use terravision_common::viewer::ViewerPose;

/// Bytes of a picture's header.
pub(crate) const HEADER_BYTES: usize = 128;
/// A camera that has not moved for this long rests.
pub(crate) const REST_AFTER: Duration = Duration::from_millis(150);

/// Milliseconds of the monotonic clock.
pub(crate) fn now_ms() -> f64 {
    monotonic_nanos() as f64 / 1e6
}

/// A pose as it was sent to the flight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SentPose {
    /// The pose.
    pub(crate) pose: ViewerPose,
    /// Its time in the segment of poses, which the frame repeats.
    pub(crate) time_s: f64,
    /// The client that sent it; 0 for the start.
    pub(crate) client: u32,
    /// That client's number of it.
    pub(crate) id: u32,
    /// When it came in.
    pub(crate) received_ms: f64,
}

/// Which view pictures show: those of one scene differ in how finely they do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Scene {
    /// Number of the flight.
    pub(crate) flight: u32,
    /// Time of the pose, bits.
    pub(crate) time: u64,
}

/// A frame of the flight.
#[derive(Debug)]
pub(crate) struct Picture {
    /// Number of the flight.
    pub(crate) flight: u32,
    /// Width and height, pixels.
    pub(crate) size: [u32; 2],
    /// What it shows: the pose as it was sent, at the height at which it was drawn.
    pub(crate) pose: ViewerPose,
    /// The pose as it was sent.
    pub(crate) sent: SentPose,
    /// Number of the frame in its flight.
    pub(crate) number: u64,
    /// Whether every tile that it wanted was there.
    pub(crate) is_settled: bool,
    /// When it was drawn.
    pub(crate) drawn_ms: f64,
    /// Since when pictures show this scene.
    pub(crate) since: Instant,
    /// Pixels and depths.
    pub(crate) frame: SharedFrame,
}

impl Picture {
    /// What it shows.
    pub(crate) fn scene(&self) -> Scene {
        Scene { flight: self.flight, time: self.sent.time_s.to_bits() }
    }
}

/// The file of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Level {
    /// JPEG of a picture between others.
    Moving,
    /// JPEG of a picture at rest.
    Rest,
    /// PNG of an exact picture.
    Exact,
}

impl Level {
    /// Quality of its JPEG; 0 for PNG.
    pub(crate) fn quality(self) -> u8 {
        match self {
            Self::Moving => 75,
            Self::Rest => 90,
            Self::Exact => 0,
        }
    }
}

const RESTS: u8 = 1;
const HAS_ALL_TILES: u8 = 2;
const IS_LOSSLESS: u8 = 4;
const IS_EXACT: u8 = 8;
const IS_KEY: u8 = 16;

/// What stands behind the header.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FileKind {
    /// A JPEG or PNG file, by the picture's level.
    Still,
    /// An access unit of H.264.
    Video {
        /// Nothing before it is needed.
        is_key: bool,
    },
}

/// The header of a client's picture number `n`, as docs/viewer.md has it.
pub(crate) fn header(picture: &Picture, level: Level, kind: FileKind, n: u32) -> [u8; HEADER_BYTES] {
    let mut header = [0; HEADER_BYTES];
    let mut at = 0;
    let mut put = |bytes: &[u8]| {
        header[at..at + bytes.len()].copy_from_slice(bytes);
        at += bytes.len();
    };
    let is_exact = level == Level::Exact;
    let flags = [
        (level > Level::Moving, RESTS),
        (picture.is_settled || is_exact, HAS_ALL_TILES),
        (is_exact, IS_LOSSLESS),
        (is_exact, IS_EXACT),
        (kind == FileKind::Video { is_key: true }, IS_KEY),
    ];
    let flags = flags.into_iter().filter(|(is_set, _)| *is_set).map(|(_, flag)| flag).sum();
    put(b"TVPF");
    put(&1u16.to_le_bytes());
    put(&(HEADER_BYTES as u16).to_le_bytes());
    put(&n.to_le_bytes());
    let (number, quality) = match kind {
        FileKind::Still => (u8::from(is_exact), level.quality()),
        FileKind::Video { .. } => (2, 0),
    };
    put(&[number, flags, quality, 0]);
    put(&picture.number.to_le_bytes());
    let [width, height] = picture.size;
    [width, height, picture.sent.id, picture.sent.client].iter().for_each(|number| put(&number.to_le_bytes()));
    let ViewerPose { x, y, z, heading, pitch, roll, vfov } = picture.pose;
    let times = [picture.sent.received_ms, picture.drawn_ms, now_ms()];
    [x, y, z, heading, pitch, roll, vfov].iter().chain(&times).for_each(|number| put(&number.to_le_bytes()));
    put(&picture.flight.to_le_bytes());
    header
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_header_is_that_of_the_document() {
        let pose = ViewerPose { x: 1.0, y: 2.0, z: 3.0, heading: 4.0, pitch: 5.0, roll: 6.0, vfov: 60.0 };
        let sent = SentPose { pose, time_s: 9.0, client: 3, id: 17, received_ms: 100.0 };
        let picture = Picture {
            flight: 2,
            size: [640, 360],
            pose,
            sent,
            number: 77,
            is_settled: true,
            drawn_ms: 110.0,
            since: Instant::now(),
            frame: SharedFrame::default(),
        };
        let video = header(&picture, Level::Moving, FileKind::Video { is_key: true }, 5);
        assert_eq!(video[12..16], [2, 2 + 16, 0, 0]);
        let header = header(&picture, Level::Exact, FileKind::Still, 5);
        let u32_at = |at: usize| u32::from_le_bytes(header[at..at + 4].try_into().unwrap());
        let f64_at = |at: usize| f64::from_le_bytes(header[at..at + 8].try_into().unwrap());
        assert_eq!((&header[..4], u32_at(8), header[12], header[13], u32_at(16)), (&b"TVPF"[..], 5, 1, 15, 77));
        assert_eq!([24, 28, 32, 36, 120].map(u32_at), [640, 360, 17, 3, 2]);
        assert_eq!([40, 56, 64, 88, 96, 104].map(f64_at), [1.0, 3.0, 4.0, 60.0, 100.0, 110.0]);
        assert!(f64_at(112) > 0.0 && u32_at(124) == 0);
    }
}
