//! Events: what each stage tells the launcher about its work, through a ring that is dropped into when full and never
//! waited for. The launcher makes the report and the trace from them.

use bytemuck::{Pod, Zeroable};

/// What an [`Event`] is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum EventKind {
    /// A span of work on a frame: `start_nanos`, `duration_nanos`; `value` is [`SpanName`] as a number.
    Span = 1,
    /// A tile could not be had: `node`; `value` is 0 for elevation and 1 for colour, plus 256 times a cause code
    /// (1 missing, 2 corrupt, 3 read error, 4 refused, 5 not in the cache).
    TileUnavailable = 2,
    /// A frame was drawn: `value` is the number of triangles, `start_nanos` the end of its read-back, and
    /// `duration_nanos` the time since the frame before was finished.
    FrameDone = 3,
    /// A frame has left the sink (file written, bytes handed over): `value` is 1 when it was settled.
    FrameWritten = 4,
    /// Tiles that the frame wanted (`value`, low 32 bits) and nodes in its tree (high 32 bits).
    FrameWanted = 5,
    /// A piece of the name of the device that draws; see [`Event::text`]. Sent once, before the first frame.
    DeviceName = 6,
    /// A piece of the name and version of the device's driver, or of how rays are cast; see [`Event::text`]. Sent before the first
    /// frame, and once more when the way of casting rays has been chosen.
    DriverName = 7,
    /// Tiles that were copied to the device for this frame: `value` is their number. Not sent when there were none.
    FrameUploaded = 8,
    /// A piece of the name of the technique that draws; see [`Event::text`]. Sent once, before the first frame.
    TechniqueName = 9,
    /// What a frame was made for (realtime): `start_nanos` is when its camera was made, `value` the bits of r_z (low 32)
    /// and r_c (high 32) as f32, pixels.
    FrameCamera = 16,
    /// What a frame lacked (realtime): `value` is the number of tiles that it wanted and that were not there (low 32 bits),
    /// and the share of the ground's screen area that it draws as finely as wanted (high 32), an f32.
    FrameLacked = 17,
    /// A piece of a sentence about a failure while the database was read; see [`Event::text`]. The sentence begins with
    /// the name of the cause. One is sent for each cause and file.
    Failure = 18,
    /// A tile that could not be had came after all (realtime): `node`, and `value` as in [`EventKind::TileUnavailable`], without a
    /// cause.
    TileCame = 19,
}

impl EventKind {
    /// The kind with this number; `None` for a number that is none (it came from shared memory).
    #[must_use]
    pub const fn from_number(number: u32) -> Option<Self> {
        Some(match number {
            1 => Self::Span,
            2 => Self::TileUnavailable,
            3 => Self::FrameDone,
            4 => Self::FrameWritten,
            5 => Self::FrameWanted,
            6 => Self::DeviceName,
            7 => Self::DriverName,
            8 => Self::FrameUploaded,
            9 => Self::TechniqueName,
            16 => Self::FrameCamera,
            17 => Self::FrameLacked,
            18 => Self::Failure,
            19 => Self::TileCame,
            _ => return None,
        })
    }
}

/// Names of spans, as shown in a trace.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum SpanName {
    /// Generator: search of the quad tree.
    Generate = 1,
    /// Preparer: waiting for tiles.
    AwaitTiles = 2,
    /// Preparer: truncation, elevation arrays, slots.
    Prepare = 3,
    /// Prefetcher: decoding of one tile, straight into its slot.
    LoadTile = 4,
    /// Renderer: reading the ring, recording commands.
    Record = 5,
    /// Renderer: colour tiles copied to the device.
    Upload = 6,
    /// Renderer: from submit to the end of read-back.
    Draw = 7,
    /// Renderer's sink: encoding and writing.
    Encode = 8,
    /// Prefetcher: from the request for a tile until its bytes are there.
    FetchTile = 9,
}

impl SpanName {
    /// All of them, in the order in which a frame passes through them.
    pub const ALL: [Self; 9] = [
        Self::Generate,
        Self::AwaitTiles,
        Self::Prepare,
        Self::LoadTile,
        Self::Record,
        Self::Upload,
        Self::Draw,
        Self::Encode,
        Self::FetchTile,
    ];

    /// The name with this number; `None` for a number that is none (it came from shared memory).
    #[must_use]
    pub fn from_number(number: u64) -> Option<Self> {
        Self::ALL.into_iter().find(|name| u64::from(*name as u32) == number)
    }

    /// As reports and traces show it.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Generate => "generate",
            Self::AwaitTiles => "await-tiles",
            Self::Prepare => "prepare",
            Self::LoadTile => "load-tile",
            Self::Record => "record",
            Self::Upload => "upload",
            Self::Draw => "draw",
            Self::Encode => "encode",
            Self::FetchTile => "fetch-tile",
        }
    }
}

/// One event; 48 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Event {
    /// [`EventKind`] as a number.
    pub kind: u32,
    /// Thread within the process, 0 for its main thread.
    pub thread: u32,
    /// The frame.
    pub frame: u64,
    /// Nanoseconds of the monotonic clock, which all processes of a machine share.
    pub start_nanos: u64,
    /// Duration in nanoseconds.
    pub duration_nanos: u64,
    /// By kind.
    pub value: u64,
    /// [`crate::node::NodeId::pack`] of a node, by kind.
    pub node: u64,
}

const _: () = assert!(size_of::<Event>() == 48);

/// Bytes of text in one event of a kind that carries text.
const TEXT_BYTES: usize = 32;
/// Longest text that events carry, bytes; what is longer is cut.
const TEXT_MAX: usize = 512;

impl Event {
    /// The events that carry a text (at most 512 bytes, longer ones are cut), 32 bytes each: `thread` is the
    /// piece's number, `frame` the length of the whole text, and the four fields after it are the bytes.
    #[must_use]
    pub fn text(kind: EventKind, text: &str) -> Vec<Self> {
        let mut len = text.len().min(TEXT_MAX);
        while !text.is_char_boundary(len) {
            len -= 1;
        }
        let mut events = Vec::new();
        for (piece, bytes) in text.as_bytes()[..len].chunks(TEXT_BYTES).enumerate() {
            let mut padded = [0; TEXT_BYTES];
            padded[..bytes.len()].copy_from_slice(bytes);
            let [start_nanos, duration_nanos, value, node] = bytemuck::cast::<_, [u64; 4]>(padded);
            let frame = len as u64;
            events.push(Self {
                kind: kind as u32,
                thread: piece as u32,
                frame,
                start_nanos,
                duration_nanos,
                value,
                node,
            });
        }
        events
    }

    /// Puts one piece of a text in its place; `true` when it was the last one. A piece that cannot be one is ignored.
    pub fn collect_text(&self, into: &mut Vec<u8>) -> bool {
        let (len, from) = (self.frame as usize, (self.thread as usize).saturating_mul(TEXT_BYTES));
        if len > TEXT_MAX || from >= len {
            return false;
        }
        if from == 0 {
            into.clear();
        }
        let bytes: [u8; TEXT_BYTES] = bytemuck::cast([self.start_nanos, self.duration_nanos, self.value, self.node]);
        into.resize(len, b' ');
        let to = len.min(from + TEXT_BYTES);
        into[from..to].copy_from_slice(&bytes[..to - from]);
        to == len
    }
}

/// Nanoseconds of the monotonic clock.
#[must_use]
pub fn monotonic_nanos() -> u64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    now.tv_sec.cast_unsigned() * 1_000_000_000 + now.tv_nsec.cast_unsigned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_text_comes_together_again(text in "\\PC{0,80}") {
            let events = Event::text(EventKind::DeviceName, &text);
            let mut bytes = Vec::new();
            let last: Vec<bool> = events.iter().map(|event| event.collect_text(&mut bytes)).collect();
            let got = String::from_utf8(bytes).unwrap();
            prop_assert!(text.starts_with(&got) && got.len() >= text.len().min(TEXT_MAX - 3));
            prop_assert_eq!(last.iter().position(|is_last| *is_last), last.len().checked_sub(1));
        }

        #[test]
        fn a_foreign_piece_never_grows_the_text(thread: u32, frame: u64, value: u64) {
            let mut bytes = Vec::new();
            let _ = Event { thread, frame, value, ..Event::zeroed() }.collect_text(&mut bytes);
            prop_assert!(bytes.len() <= TEXT_MAX);
        }
    }

    #[test]
    fn numbers_and_names_agree() {
        for name in SpanName::ALL {
            assert_eq!(SpanName::from_number(u64::from(name as u32)), Some(name));
        }
        for number in 0..100 {
            assert!(EventKind::from_number(number).is_none_or(|kind| kind as u32 == number));
        }
    }
}
