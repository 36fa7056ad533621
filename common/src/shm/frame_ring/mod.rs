//! The frame ring: finished frames for other programs, newest wins (docs/frame-ring.md).
//!
//! The launcher makes it ([`FrameRing`]), the renderer writes it ([`FrameRingWriter`]), any number of programs read it,
//! of which [`FrameRingReader`] is one: they need no more than a mapping for reading, come and go at will, and are not
//! known to the writer, which waits for nobody. Pixels are stored and loaded as atomic words, so a reader that is overtaken
//! copies nonsense, notices, and takes the newer frame.

mod layout;
mod reader;
mod slot;
#[cfg(test)]
mod tests;

pub use layout::FrameShape;
pub use reader::{FrameRingReader, SharedFrame};
pub use slot::FrameInfo;

use super::error::ShmError;
use super::frame_core::{FrameSlot, newest};
use super::named::{self, FRAMES, NamedSegment, SharedName};
use super::region::Region;
use crate::sync::{AtomicU64, Ordering};
use layout::{POSE_TIMES, RING_HEADER_OFFSET, RingHeader, RingLayout, SLOTS};
use std::sync::Arc;

/// A frame ring that this process has made; dropped, it is marked as ended and its name is removed.
#[derive(Debug)]
pub struct FrameRing {
    segment: NamedSegment,
    layout: RingLayout,
}

impl FrameRing {
    /// Makes the ring of this name.
    ///
    /// # Errors
    /// [`ShmError::NameTaken`] while another run has the name, [`ShmError::NotEnoughSpace`].
    pub fn create(name: &SharedName, shape: FrameShape) -> Result<Self, ShmError> {
        let file = name.ring_file();
        let layout = RingLayout::new(shape, SLOTS).ok_or_else(|| ShmError::Corrupt {
            name: file.clone(),
            field: "the size of its pictures",
            found: u64::from(shape.size[0]) << 32 | u64::from(shape.size[1]),
            expected: "sides from 1 to 65536 pixels",
        })?;
        let segment = NamedSegment::create(&file, FRAMES, layout.total_bytes, |region| layout.write(region))?;
        Ok(Self { segment, layout })
    }

    /// Bytes of shared memory that it takes.
    #[must_use]
    pub fn total_bytes(&self) -> u64 {
        self.layout.total_bytes
    }

    /// Where the pilot notes the time of a pose.
    #[must_use]
    pub fn pose_times(&self) -> PoseTimes {
        PoseTimes { region: Arc::clone(&self.segment.region), next: 0 }
    }
}

/// The times of poses, in the clock of who sent them, from the pilot to the frames that come of them.
#[derive(Debug)]
pub struct PoseTimes {
    region: Arc<Region>,
    next: u64,
}

impl PoseTimes {
    /// The pose that was made a camera at this moment has this time; to be said before the camera is sent.
    pub fn note(&mut self, camera_nanos: u64, seconds: f64) {
        let [of, time] = pose_time(&self.region, self.next) else { return };
        self.next += 1;
        // Relaxed: the camera, which is sent later, brings it to the renderer (SYNC ring.publish and so on).
        time.store(seconds.to_bits(), Ordering::Relaxed);
        of.store(camera_nanos, Ordering::Relaxed);
    }
}

fn pose_time(region: &Region, entry: u64) -> &[AtomicU64] {
    region.words_slice(RingLayout::pose_time_offset(entry), 2)
}

/// The time that was noted of a camera.
fn noted_time(region: &Region, camera_nanos: u64) -> Option<f64> {
    let entries = (0..POSE_TIMES).map(|entry| pose_time(region, entry));
    let of_camera = |entry: &[AtomicU64]| match entry {
        [of, time] if of.load(Ordering::Relaxed) == camera_nanos => Some(time.load(Ordering::Relaxed)),
        _ => None,
    };
    // A moment of 0 is that of a path's camera.
    entries.filter(|_| camera_nanos != 0).find_map(of_camera).map(f64::from_bits)
}

/// The renderer's end. One at a time; another one goes on behind the last frame that was published.
#[derive(Debug)]
pub struct FrameRingWriter {
    region: Region,
    layout: RingLayout,
    next: u64,
}

impl FrameRingWriter {
    /// Opens the ring of this name, which must be of such frames.
    ///
    /// # Errors
    /// See [`ShmError`].
    pub fn open(name: &SharedName, shape: FrameShape) -> Result<Self, ShmError> {
        let file = name.ring_file();
        let region = named::open(&file, FRAMES, true)?;
        let layout = RingLayout::read(&region, &file)?;
        if layout.shape != shape {
            let found = u64::from(layout.shape.size[0]) << 32 | u64::from(layout.shape.size[1]);
            let (field, expected) = ("the shape of its pictures", "that of the run");
            return Err(ShmError::Corrupt { name: file, field, found, expected });
        }
        let header: &RingHeader = region.words(RING_HEADER_OFFSET);
        let last = newest(&header.newest);
        // A number that no flight reaches was not written by a renderer: begin again.
        let next = if last < 1 << 60 { last + 1 } else { 1 };
        Ok(Self { region, layout, next })
    }

    /// Publishes a frame: `rgba` in rows from the top, `depth` and `ground` by pixel; the latter two are
    /// looked at only when the ring has such a plane. Waits for nobody. Returns the number of the publication.
    pub fn write(
        &mut self,
        info: &FrameInfo,
        rgba: &[u8],
        depth: impl Iterator<Item = f32>,
        ground: impl Iterator<Item = [f64; 3]>,
    ) -> u64 {
        let number = self.next;
        self.next += 1;
        let offset = self.layout.slot_offset(number);
        let words: &[AtomicU64] = self.region.words_slice(offset, self.layout.slot_bytes / 8);
        let Some((sequence, words)) = words.split_first() else { return number };
        let slot = FrameSlot { sequence, words };
        let pose_time = noted_time(&self.region, info.camera_nanos).unwrap_or(info.pose_time_s);
        slot.begin(number);
        slot::store(words, &self.layout, &FrameInfo { pose_time_s: pose_time, ..*info }, rgba, depth, ground);
        let header: &RingHeader = self.region.words(RING_HEADER_OFFSET);
        slot.publish(number, &header.newest);
        number
    }
}
