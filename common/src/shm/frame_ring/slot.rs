//! The words of a slot after its sequence: description and planes of the frame.

use super::super::error::ShmError;
use super::super::public_file::PublicFile;
use super::super::size::{pack_size, unpack_size};
use super::layout::{RingLayout, SLOT_HEADER_BYTES, pixels_of};
use crate::camera::Camera;
use crate::sync::{AtomicU64, Ordering};

/// The description of a frame in its slot. Degrees and the database's CRS, as on the command line,
/// because other programs read it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameInfo {
    /// Number of the frame in its flight.
    pub frame: u64,
    /// When it was published, nanoseconds of the monotonic clock.
    pub published_nanos: u64,
    /// When its pose was made or received, nanoseconds of the monotonic clock; 0 in exact mode.
    pub camera_nanos: u64,
    /// Time of its pose in the clock of the sender, seconds; NaN for poses of a path, or without a
    /// time.
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
    /// Width and height of its picture, pixels: at most those of the ring.
    pub size: [u32; 2],
    /// Whether every tile that it wanted was drawn.
    pub is_settled: bool,
}

/// Words of a [`FrameInfo`].
const INFO_WORDS: usize = 13;
const IS_SETTLED: u64 = 1;
const _: () = assert!(8 + INFO_WORDS as u64 * 8 <= SLOT_HEADER_BYTES);

impl FrameInfo {
    /// The description of a frame of this camera, whose picture is all of it, over a world with this
    /// origin.
    #[must_use]
    pub fn new(frame: u64, camera: &Camera, origin: [f64; 2], is_settled: bool, published_nanos: u64) -> Self {
        let [x, y, z] = camera.fields().eye_in_world;
        Self {
            frame,
            published_nanos,
            camera_nanos: camera.timestamp_nanos(),
            pose_time_s: f64::NAN,
            position: [origin[0] + x, origin[1] + y, z],
            heading_deg: camera.heading_rad().to_degrees(),
            pitch_deg: camera.pitch_rad().to_degrees(),
            roll_deg: camera.roll_rad().to_degrees(),
            vfov_deg: camera.vfov_rad().to_degrees(),
            size: [camera.width(), camera.height()],
            is_settled,
        }
    }

    fn words(&self) -> [u64; INFO_WORDS] {
        let [x, y, z] = self.position.map(f64::to_bits);
        let angles = [self.heading_deg, self.pitch_deg, self.roll_deg, self.vfov_deg].map(f64::to_bits);
        let [heading, pitch, roll, vfov] = angles;
        let time = self.pose_time_s.to_bits();
        let flags = if self.is_settled { IS_SETTLED } else { 0 };
        let size = pack_size(self.size);
        [self.frame, self.published_nanos, self.camera_nanos, time, x, y, z, heading, pitch, roll, vfov, flags, size]
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
            size: unpack_size(word(12)),
            is_settled: word(11) & IS_SETTLED != 0,
        }
    }
}

/// The words of a plane at a byte offset within its slot, out of the slot's words behind the
/// sequence.
pub(super) fn plane(words: &[AtomicU64], offset: u64, bytes: u64) -> &[AtomicU64] {
    let first = (offset / 8) as usize - 1;
    words.get(first..first + bytes.div_ceil(8) as usize).unwrap_or_default()
}

/// Bytes of a plane that are converted at a time.
const CHUNK: usize = 1 << 18;

/// Stores a slot, except for its sequence, at `offset` of the file; to be called between `begin`
/// and `publish`.
#[expect(clippy::too_many_arguments, reason = "the place, and the planes as they come")]
pub(super) fn store(
    file: &PublicFile,
    offset: u64,
    layout: &RingLayout,
    buffer: &mut Vec<u8>,
    info: &FrameInfo,
    rgba: &[u8],
    depth: impl Iterator<Item = f32>,
    ground: impl Iterator<Item = [f64; 3]>,
) -> Result<(), ShmError> {
    // In any order: SYNC frame.begin and frame.end order all stores.
    file.write_words(offset + 8, &info.words())?;
    // The planes are where those of the largest picture are; a smaller one fills their beginnings.
    let pixels = pixels_of(layout.checked_size(info.size)) as usize;
    file.write_at(offset + layout.color, &rgba[..rgba.len().min(pixels * 4)])?;
    if layout.shape.has_depth {
        let depth = depth.chain(std::iter::repeat(f32::NAN)).take(pixels);
        store_plane(file, offset + layout.depth, buffer, depth.map(f32::to_ne_bytes))?;
    }
    if layout.shape.has_ground {
        let ground = ground.chain(std::iter::repeat([f64::NAN; 3])).take(pixels);
        store_plane(file, offset + layout.ground, buffer, ground.flatten().map(f64::to_ne_bytes))?;
    }
    Ok(())
}

fn store_plane<const N: usize>(
    file: &PublicFile,
    mut offset: u64,
    buffer: &mut Vec<u8>,
    values: impl Iterator<Item = [u8; N]>,
) -> Result<(), ShmError> {
    buffer.clear();
    for value in values {
        buffer.extend_from_slice(&value);
        if buffer.len() >= CHUNK {
            file.write_at(offset, buffer)?;
            offset += buffer.len() as u64;
            buffer.clear();
        }
    }
    file.write_at(offset, buffer)
}
