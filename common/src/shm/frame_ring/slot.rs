//! A slot's words behind its sequence: what they say of the frame, and its planes.

use super::layout::{RingLayout, SLOT_HEADER_BYTES};
use crate::camera::Camera;
use crate::sync::{AtomicU64, Ordering};

/// What a slot says of its frame. Degrees and the database's CRS, as on the command line: other programs read it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameInfo {
    /// Number of the frame in its flight.
    pub frame: u64,
    /// When it was published, nanoseconds of the monotonic clock.
    pub published_nanos: u64,
    /// When its pose was made or came in, nanoseconds of the monotonic clock; 0 when time plays no part.
    pub camera_nanos: u64,
    /// Time of its pose in the clock of who sent it, seconds; NaN for poses of a path, or without a time.
    pub pose_time_s: f64,
    /// Easting, northing and height of the eye, in the database's CRS, metres.
    pub position: [f64; 3],
    /// Degrees clockwise from grid north.
    pub heading_deg: f64,
    /// Degrees up from the horizontal.
    pub pitch_deg: f64,
    /// Degrees clockwise.
    pub roll_deg: f64,
    /// Vertical field of view, degrees.
    pub vfov_deg: f64,
    /// Whether every tile that it wanted was there.
    pub is_settled: bool,
}

/// Words of a [`FrameInfo`].
const INFO_WORDS: usize = 12;
const IS_SETTLED: u64 = 1;
const _: () = assert!(8 + INFO_WORDS as u64 * 8 <= SLOT_HEADER_BYTES);

impl FrameInfo {
    /// Of a frame of this camera over a world with this origin.
    #[must_use]
    pub fn new(frame: u64, camera: &Camera, origin: [f64; 2], is_settled: bool, published_nanos: u64) -> Self {
        let [x, y, z] = camera.eye_in_world;
        Self {
            frame,
            published_nanos,
            camera_nanos: camera.timestamp_nanos,
            pose_time_s: f64::NAN,
            position: [origin[0] + x, origin[1] + y, z],
            heading_deg: camera.heading_rad.to_degrees(),
            pitch_deg: camera.pitch_rad.to_degrees(),
            roll_deg: camera.roll_rad.to_degrees(),
            vfov_deg: camera.vfov_rad.to_degrees(),
            is_settled,
        }
    }

    fn words(&self) -> [u64; INFO_WORDS] {
        let [x, y, z] = self.position.map(f64::to_bits);
        let angles = [self.heading_deg, self.pitch_deg, self.roll_deg, self.vfov_deg].map(f64::to_bits);
        let [heading, pitch, roll, vfov] = angles;
        let time = self.pose_time_s.to_bits();
        let flags = if self.is_settled { IS_SETTLED } else { 0 };
        [self.frame, self.published_nanos, self.camera_nanos, time, x, y, z, heading, pitch, roll, vfov, flags]
    }

    pub(super) fn load(words: &[AtomicU64]) -> Self {
        let word = |index: usize| words.get(index).map_or(0, |word| word.load(Ordering::Relaxed));
        let number = |index: usize| f64::from_bits(word(index));
        Self {
            frame: word(0),
            published_nanos: word(1),
            camera_nanos: word(2),
            pose_time_s: number(3),
            position: [number(4), number(5), number(6)],
            heading_deg: number(7),
            pitch_deg: number(8),
            roll_deg: number(9),
            vfov_deg: number(10),
            is_settled: word(11) & IS_SETTLED != 0,
        }
    }
}

/// The words of a plane at a byte offset within its slot, out of the slot's words behind the sequence.
pub(super) fn plane(words: &[AtomicU64], offset: u64, bytes: u64) -> &[AtomicU64] {
    let first = (offset / 8) as usize - 1;
    words.get(first..first + bytes.div_ceil(8) as usize).unwrap_or_default()
}

/// Stores a whole slot; called between `FrameSlot::begin` and `publish`.
pub(super) fn store(
    words: &[AtomicU64],
    layout: &RingLayout,
    info: &FrameInfo,
    rgba: &[u8],
    mut depth: impl Iterator<Item = f32>,
    ground: impl Iterator<Item = [f64; 3]>,
) {
    // Relaxed throughout: SYNC frame.begin and frame.end order them all.
    for (word, value) in words.iter().zip(info.words()) {
        word.store(value, Ordering::Relaxed);
    }
    let pixels = layout.pixels();
    let (pairs, last) = rgba.as_chunks::<8>();
    let color = plane(words, layout.color, pixels * 4);
    for (word, pair) in color.iter().zip(pairs) {
        word.store(u64::from_ne_bytes(*pair), Ordering::Relaxed);
    }
    if let (Some(word), false) = (color.get(pairs.len()), last.is_empty()) {
        let mut pair = [0; 8];
        pair[..last.len()].copy_from_slice(last);
        word.store(u64::from_ne_bytes(pair), Ordering::Relaxed);
    }
    if layout.shape.has_depth {
        for word in plane(words, layout.depth, pixels * 4) {
            let mut pair = [0; 8];
            let (first, second) = pair.split_at_mut(4);
            first.copy_from_slice(&depth.next().unwrap_or(f32::NAN).to_ne_bytes());
            second.copy_from_slice(&depth.next().unwrap_or(f32::NAN).to_ne_bytes());
            word.store(u64::from_ne_bytes(pair), Ordering::Relaxed);
        }
    }
    if layout.shape.has_ground {
        let (triples, _none) = plane(words, layout.ground, pixels * 24).as_chunks::<3>();
        for (words, position) in triples.iter().zip(ground) {
            for (word, value) in words.iter().zip(position) {
                word.store(value.to_bits(), Ordering::Relaxed);
            }
        }
    }
}
