//! The frame ring: finished frames for other programs, newest wins (docs/frame-ring.md).
//!
//! The launcher creates it ([`FrameRing`]), the renderer writes it ([`FrameRingWriter`]), and any
//! number of programs read it, for example with [`FrameRingReader`]. Readers only need a read-only
//! mapping, come and go at any time, and are unknown to the writer, which never waits. Readers load
//! pixels as atomic words: a reader that is overtaken copies garbage, notices it, and takes the
//! newer frame. The writer stores pixels by file writes ([`super::public_file`]): if a program
//! truncates the file, the flight ends with a message.

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

/// A frame ring that this process has created. When dropped, it is marked as ended and its name is
/// removed.
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

    /// The table in which the pilot records the times of poses.
    #[must_use]
    pub fn pose_times(&self) -> PoseTimes {
        PoseTimes { file: Arc::clone(&self.segment.file), next: 0 }
    }
}

/// The times of poses in the clock of their sender, from the pilot to the frames made from them.
#[derive(Debug)]
pub struct PoseTimes {
    file: Arc<PublicFile>,
    next: u64,
}

impl PoseTimes {
    /// Records the time of the pose from which a camera was made at this moment. To be called
    /// before the camera is sent.
    ///
    /// # Errors
    /// The ring was truncated.
    pub fn note(&mut self, camera_nanos: u64, seconds: f64) -> Result<(), ShmError> {
        let offset = RingLayout::pose_time_offset(self.next);
        self.next += 1;
        // The camera, which is sent later, publishes it to the renderer (SYNC ring.publish and so
        // on).
        self.file.write_words(offset, &[camera_nanos, seconds.to_bits()])
    }
}

/// The renderer's end. One at a time; another one continues after the last published frame.
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
        // A number that no flight reaches was not written by a renderer: start again.
        let next = if last < 1 << 60 { last + 1 } else { 1 };
        Ok(Self { file: opened, layout, next, buffer: Vec::new() })
    }

    /// Publishes a frame: `rgba` in rows from the top, `depth` and `ground` by pixel; the latter
    /// two are used only if the ring has these planes. Never waits. Returns the number of the
    /// publication.
    ///
    /// # Errors
    /// [`ShmError::CutShort`]: another program has truncated the file; this may have killed
    /// programs that map it.
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

    /// The recorded time of a camera.
    fn noted_time(&mut self, camera_nanos: u64) -> Result<Option<f64>, ShmError> {
        // Cameras of a path have the moment 0.
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
