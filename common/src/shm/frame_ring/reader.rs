//! A reader of the frame ring, like those of other programs: it maps the ring read-only and trusts
//! nothing.

use super::super::error::ShmError;
use super::super::frame_core::{FrameSlot, newest};
use super::super::named::{self, FRAMES, SharedName};
use super::super::region::Region;
use super::layout::{FrameShape, RING_HEADER_OFFSET, RingHeader, RingLayout, pixels_of};
use super::slot::{FrameInfo, plane};
use crate::sync::{AtomicU64, Ordering};

/// After this many overtaken copies a reader gives up for now.
const TRIES: u32 = 16;

/// A frame copied out of the ring. Keep it to reuse its memory.
#[derive(Debug, Clone, Default)]
pub struct SharedFrame {
    /// Number of the publication, from 1; a gap means missed frames.
    pub number: u64,
    /// Its description in the slot; `None` before the first.
    pub info: Option<FrameInfo>,
    /// `[height, width, 4]` bytes RGBA, row 0 at the top.
    pub rgba: Vec<u8>,
    /// `[height, width]` metres along the view axis, NaN for sky; empty when the ring has none.
    pub depth: Vec<f32>,
    /// `[height, width, 3]` easting, northing, height, NaN for sky; empty when the ring has none.
    pub ground: Vec<f64>,
}

impl SharedFrame {
    /// Empties it, keeps its memory.
    fn clear(&mut self) {
        (self.number, self.info) = (0, None);
        self.rgba.clear();
        self.depth.clear();
        self.ground.clear();
    }
}

/// A reader. Any number of them, in any process.
#[derive(Debug)]
pub struct FrameRingReader {
    region: Region,
    layout: RingLayout,
    name: String,
    seen: u64,
}

impl FrameRingReader {
    /// Opens the ring of this name.
    ///
    /// # Errors
    /// There is no ring, or its header is not that of one.
    pub fn open(name: &SharedName) -> Result<Self, ShmError> {
        let name = name.ring_file();
        let region = named::open(&name, FRAMES, false)?;
        let layout = RingLayout::read(&region, region.len(), &name)?;
        Ok(Self { region, layout, name, seen: 0 })
    }

    /// What its frames have, and the size of the largest.
    #[must_use]
    pub fn shape(&self) -> FrameShape {
        self.layout.shape
    }

    /// Whether the flight has ended in order; the content of the ring remains readable. For a
    /// killed launcher see [`FrameRingReader::launcher_pid`].
    #[must_use]
    pub fn is_ended(&self) -> bool {
        named::is_ended(&self.region)
    }

    /// Process id of the launcher, from the header.
    #[must_use]
    pub fn launcher_pid(&self) -> u32 {
        named::launcher_pid(&self.region)
    }

    /// Number of the newest publication; 0 before the first.
    #[must_use]
    pub fn newest(&self) -> u64 {
        newest(&self.region.words::<RingHeader>(RING_HEADER_OFFSET).newest)
    }

    /// Copies the newest frame if it is new; does not wait. `false` when there is no newer frame
    /// (`into` is unchanged), or when the writer overtook every copy (`into` is empty).
    ///
    /// # Errors
    /// [`ShmError::Corrupt`] when the slot of the newest frame does not hold it; `into` is empty.
    pub fn read(&mut self, into: &mut SharedFrame) -> Result<bool, ShmError> {
        for _ in 0..TRIES {
            let number = self.newest();
            if number == self.seen || number == 0 {
                return Ok(false);
            }
            let words: &[AtomicU64] =
                self.region.words_slice(self.layout.slot_offset(number), self.layout.slot_bytes / 8);
            let Some((sequence, words)) = words.split_first() else { return Ok(false) };
            let slot = FrameSlot { sequence, words };
            let layout = &self.layout;
            let copied = slot.copy(number, |words| {
                let info = FrameInfo::load(words);
                let size = layout.checked_size(info.size);
                into.info = Some(FrameInfo { size, ..info });
                load_planes(words, layout, pixels_of(size), into);
            });
            if copied.is_some() {
                into.number = number;
                self.seen = number;
                return Ok(true);
            }
            // The copy, if any, is not a valid frame.
            into.clear();
            if self.newest() == number {
                let found = sequence.load(Ordering::Relaxed);
                let (field, expected) = ("the sequence of the newest slot", "twice the number of the newest frame");
                return Err(ShmError::Corrupt { name: self.name.clone(), field, found, expected });
            }
        }
        Ok(false)
    }
}

fn load_planes(words: &[AtomicU64], layout: &RingLayout, pixels: u64, into: &mut SharedFrame) {
    let load = |word: &AtomicU64| word.load(Ordering::Relaxed);
    let color = plane(words, layout.color, pixels * 4);
    into.rgba.clear();
    into.rgba.extend(color.iter().flat_map(|word| load(word).to_ne_bytes()));
    into.rgba.truncate((pixels * 4) as usize);
    into.depth.clear();
    if layout.shape.has_depth {
        let pairs = plane(words, layout.depth, pixels * 4).iter().map(|word| load(word).to_ne_bytes());
        into.depth.extend(
            pairs.flat_map(|[a, b, c, d, e, f, g, h]| {
                [f32::from_ne_bytes([a, b, c, d]), f32::from_ne_bytes([e, f, g, h])]
            }),
        );
        into.depth.truncate(pixels as usize);
    }
    into.ground.clear();
    if layout.shape.has_ground {
        into.ground.extend(plane(words, layout.ground, pixels * 24).iter().map(|word| f64::from_bits(load(word))));
    }
}
