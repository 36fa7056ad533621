//! The frame ring: finished frames for other programs, newest wins (docs/frame-ring.md).
//!
//! The launcher makes it ([`FrameRing`]), the renderer writes it ([`FrameRingWriter`]), any number
//! of programs read it, of which [`FrameRingReader`] is one: they need no more than a mapping for
//! reading, come and go at will, and are not known to the writer, which waits for nobody. Readers
//! load pixels as atomic words, so one that is overtaken copies nonsense, notices, and takes the
//! newer frame. The writer stores them as one writes a file ([`super::public_file`]): a program
//! that cuts the file under it ends the flight with a sentence.

mod layout;
mod reader;
mod slot;
#[cfg(test)]
mod tests;

pub use layout::FrameShape;
pub use reader::{FrameRingReader, SharedFrame};
pub use slot::FrameInfo;

use super::error::ShmError;
use super::frame_core::{Outlet, begin, newest, publish};
use super::named::{self, FRAMES, NamedSegment, SharedName};
use super::public_file::PublicFile;
use layout::{
    HEAD_BYTES, NEWEST_OFFSET, POSE_TIME_BYTES, POSE_TIMES, POSE_TIMES_OFFSET, RING_HEADER_OFFSET, RingHeader,
    RingLayout, SLOTS,
};
use std::path::PathBuf;
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

    /// Its file.
    #[must_use]
    pub fn path(&self) -> PathBuf {
        named::path(self.segment.name()).into()
    }

    /// Bytes of shared memory that it takes.
    #[must_use]
    pub fn total_bytes(&self) -> u64 {
        self.layout.total_bytes
    }

    /// Where the pilot notes the time of a pose.
    #[must_use]
    pub fn pose_times(&self) -> PoseTimes {
        PoseTimes { file: Arc::clone(&self.segment.file), next: 0 }
    }
}

/// The times of poses, in the clock of who sent them, from the pilot to the frames that come of
/// them.
#[derive(Debug)]
pub struct PoseTimes {
    file: Arc<PublicFile>,
    next: u64,
}

impl PoseTimes {
    /// The pose that was made a camera at this moment has this time; to be said before the camera
    /// is sent.
    ///
    /// # Errors
    /// The ring was cut short.
    pub fn note(&mut self, camera_nanos: u64, seconds: f64) -> Result<(), ShmError> {
        let offset = RingLayout::pose_time_offset(self.next);
        self.next += 1;
        // The camera, which is sent later, brings it to the renderer (SYNC ring.publish and so on).
        self.file.write_words(offset, &[camera_nanos, seconds.to_bits()])
    }
}

/// The renderer's end. One at a time; another one goes on behind the last frame that was published.
#[derive(Debug)]
pub struct FrameRingWriter {
    file: PublicFile,
    layout: RingLayout,
    next: u64,
    buffer: Vec<u8>,
}

impl FrameRingWriter {
    /// Opens the ring of this name, which must be of such frames.
    ///
    /// # Errors
    /// See [`ShmError`].
    pub fn open(name: &SharedName, shape: FrameShape) -> Result<Self, ShmError> {
        let file = name.ring_file();
        let (opened, head) = named::open_unmapped(&file, FRAMES, HEAD_BYTES)?;
        let layout = RingLayout::read(&head, opened.len(), &file)?;
        if layout.shape != shape {
            let found = u64::from(layout.shape.size[0]) << 32 | u64::from(layout.shape.size[1]);
            let (field, expected) = ("the shape of its pictures", "that of the run");
            return Err(ShmError::Corrupt { name: file, field, found, expected });
        }
        let header: &RingHeader = head.words(RING_HEADER_OFFSET);
        let last = newest(&header.newest);
        // A number that no flight reaches was not written by a renderer: begin again.
        let next = if last < 1 << 60 { last + 1 } else { 1 };
        Ok(Self { file: opened, layout, next, buffer: Vec::new() })
    }

    /// Publishes a frame: `rgba` in rows from the top, `depth` and `ground` by pixel; the latter
    /// two are looked at only when the ring has such a plane. Waits for nobody. Returns the number
    /// of the publication.
    ///
    /// # Errors
    /// [`ShmError::CutShort`]: another program has cut the file; who maps it may be dead of it.
    pub fn write(
        &mut self,
        info: &FrameInfo,
        rgba: &[u8],
        depth: impl Iterator<Item = f32>,
        ground: impl Iterator<Item = [f64; 3]>,
    ) -> Result<u64, ShmError> {
        self.file.check_len()?;
        let number = self.next;
        self.next += 1;
        let offset = self.layout.slot_offset(number);
        let pose_time_s = self.noted_time(info.camera_nanos)?.unwrap_or(info.pose_time_s);
        let mut out = SlotFile { file: &self.file, offset };
        begin(&mut out, number)?;
        let info = FrameInfo { pose_time_s, ..*info };
        slot::store(&self.file, offset, &self.layout, &mut self.buffer, &info, rgba, depth, ground)?;
        publish(&mut out, number)?;
        Ok(number)
    }

    /// The time that was noted of a camera.
    fn noted_time(&mut self, camera_nanos: u64) -> Result<Option<f64>, ShmError> {
        // A moment of 0 is that of a path's camera.
        if camera_nanos == 0 {
            return Ok(None);
        }
        self.buffer.resize((POSE_TIMES * POSE_TIME_BYTES) as usize, 0);
        self.file.read_at(POSE_TIMES_OFFSET, &mut self.buffer)?;
        let (words, _none) = self.buffer.as_chunks::<8>();
        let mut entries = words.as_chunks::<2>().0.iter().map(|entry| entry.map(u64::from_ne_bytes));
        Ok(entries.find(|[of, _]| *of == camera_nanos).map(|[_, time]| f64::from_bits(time)))
    }
}

/// A slot in the ring's file.
struct SlotFile<'a> {
    file: &'a PublicFile,
    offset: u64,
}

impl Outlet for SlotFile<'_> {
    type Error = ShmError;

    fn sequence(&mut self, value: u64) -> Result<(), ShmError> {
        self.file.write_words(self.offset, &[value])
    }

    fn newest(&mut self, number: u64) -> Result<(), ShmError> {
        self.file.write_words(NEWEST_OFFSET, &[number])
    }
}
