//! Events, with which each stage reports its work to the launcher. The ring that carries them never
//! blocks: events that find it full are dropped. The launcher makes the report and the trace from
//! them.

use crate::database::{Layer, Tile};
use crate::ids::FrameNumber;
use crate::node::NodeId;
use crate::outcome::TileFailure;
use crate::run::TechniqueChoice;
use bytemuck::{Pod, Zeroable};

/// The content of an event: its kind, with typed fields. [`Event::new`] and [`Event::content`] are
/// the only codec.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum EventContent {
    /// A span of work on a frame.
    Span {
        /// Which work.
        name: SpanName,
        /// The node of the tile that the work was about, if any.
        node: Option<NodeId>,
    },
    /// A tile could not be read.
    TileUnavailable {
        /// The tile.
        tile: Tile,
        /// Why.
        failure: TileFailure,
    },
    /// A tile that could not be read has arrived (realtime).
    TileCame {
        /// The tile.
        tile: Tile,
    },
    /// A frame was drawn: the event's start is the end of its read-back, and its duration the time
    /// since the frame before was finished.
    FrameDone {
        /// Triangles, or rays.
        triangles: u64,
    },
    /// A frame has left the sink (file written, bytes handed over).
    FrameWritten {
        /// Whether every tile that it wanted was drawn.
        is_settled: bool,
    },
    /// Counts of what a frame wanted.
    FrameWanted {
        /// Tiles.
        tiles: u32,
        /// Nodes in its tree.
        nodes: u32,
    },
    /// Tiles were copied to the device for this frame. Not sent when there were none.
    FrameUploaded {
        /// How many.
        tiles: u64,
    },
    /// The resolutions of a frame (realtime); the event's start is when its camera was made.
    FrameCamera {
        /// Screen resolution of facets, pixels.
        r_z_px: f32,
        /// Screen resolution of texels, pixels.
        r_c_px: f32,
    },
    /// Counts of what a frame lacked (realtime).
    FrameLacked {
        /// Wanted tiles that were not resident.
        tiles: u32,
        /// The share of the ground's screen area that it draws at the wanted resolution.
        sharp_share: f32,
    },
    /// What one draw of a frame cost: the event's duration, by the device's own clock or of all
    /// processor cores together.
    FrameDraw {
        /// What drew.
        technique: TechniqueChoice,
        /// Which view of the frame, from 0.
        view: u8,
        /// How many of the frame's tiles.
        tiles: u32,
    },
    /// A piece of a text; see [`Event::text`].
    Text {
        /// What the text is.
        kind: TextKind,
    },
}

/// The kind of a text that events carry in pieces.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TextKind {
    /// The name of the device that draws. Sent once, before the first frame.
    Device,
    /// Name and version of the device's driver, or how rays are cast. Sent before the first frame,
    /// and once more when the way of casting rays has been chosen.
    Driver,
    /// The name of the technique that draws. Sent once, before the first frame.
    Technique,
    /// Why it draws, a clause ([`crate::technique`]). Sent once, before the first frame.
    TechniqueReason,
    /// A sentence about a failure while the database was read; it begins with the name of the
    /// cause. One is sent for each cause and file.
    Failure,
}

/// Kinds as numbers.
mod kind {
    pub(super) const SPAN: u32 = 1;
    pub(super) const TILE_UNAVAILABLE: u32 = 2;
    pub(super) const FRAME_DONE: u32 = 3;
    pub(super) const FRAME_WRITTEN: u32 = 4;
    pub(super) const FRAME_WANTED: u32 = 5;
    pub(super) const DEVICE_NAME: u32 = 6;
    pub(super) const DRIVER_NAME: u32 = 7;
    pub(super) const FRAME_UPLOADED: u32 = 8;
    pub(super) const TECHNIQUE_NAME: u32 = 9;
    pub(super) const TECHNIQUE_REASON: u32 = 10;
    pub(super) const FRAME_CAMERA: u32 = 16;
    pub(super) const FRAME_LACKED: u32 = 17;
    pub(super) const FAILURE: u32 = 18;
    pub(super) const TILE_CAME: u32 = 19;
    pub(super) const FRAME_DRAW: u32 = 20;
}

impl TextKind {
    const fn number(self) -> u32 {
        match self {
            Self::Device => kind::DEVICE_NAME,
            Self::Driver => kind::DRIVER_NAME,
            Self::Technique => kind::TECHNIQUE_NAME,
            Self::TechniqueReason => kind::TECHNIQUE_REASON,
            Self::Failure => kind::FAILURE,
        }
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
    /// Prefetcher: decoding of one tile, directly into its slot.
    LoadTile = 4,
    /// Renderer: reading the ring, recording commands.
    Record = 5,
    /// Renderer: colour tiles copied to the device.
    Upload = 6,
    /// Renderer: from submit to the end of read-back.
    Draw = 7,
    /// Renderer's sink: encoding and writing.
    Encode = 8,
    /// Prefetcher: from the request for a tile until its bytes have arrived.
    FetchTile = 9,
}

impl SpanName {
    /// All spans, in the order in which a frame passes through them.
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

    /// Whether this is work on a single tile.
    #[must_use]
    pub const fn is_of_a_tile(self) -> bool {
        matches!(self, Self::LoadTile | Self::FetchTile)
    }

    /// The name with this number; `None` for another number (it came from shared memory).
    #[must_use]
    pub fn from_number(number: u64) -> Option<Self> {
        Self::ALL.into_iter().find(|name| u64::from(*name as u32) == number)
    }

    /// The name in reports and traces.
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
    /// Which [`EventContent`] it is.
    kind: u32,
    /// Thread within the process, 0 for its main thread.
    pub thread: u32,
    /// The frame; of a piece of a text, the length of the whole.
    frame: u64,
    /// Nanoseconds of the monotonic clock, which all processes of a machine share.
    pub start_nanos: u64,
    /// Duration in nanoseconds.
    pub duration_nanos: u64,
    /// By kind.
    value: u64,
    /// [`NodeId::pack`] of a node, by kind.
    node: u64,
}

const _: () = assert!(size_of::<Event>() == 48);

/// Bytes of text in one event of a kind that carries text.
const TEXT_BYTES: usize = 32;
/// Longest text that events carry, bytes; longer texts are cut.
const TEXT_MAX: usize = 512;

/// Two numbers of 32 bits in one word, the first in the lower half.
const fn halves(low: u32, high: u32) -> u64 {
    low as u64 | (high as u64) << 32
}

const fn low(value: u64) -> u32 {
    value as u32
}

const fn high(value: u64) -> u32 {
    (value >> 32) as u32
}

/// A layer's number: 0 elevation, 1 colour.
const fn layer_number(layer: Layer) -> u64 {
    match layer {
        Layer::Elevation => 0,
        Layer::Color => 1,
    }
}

/// A technique's number in an event.
const fn technique_number(technique: TechniqueChoice) -> u32 {
    match technique {
        TechniqueChoice::Mesh => 1,
        TechniqueChoice::Rays => 2,
    }
}

const fn technique_of(number: u32) -> Option<TechniqueChoice> {
    match number {
        1 => Some(TechniqueChoice::Mesh),
        2 => Some(TechniqueChoice::Rays),
        _ => None,
    }
}

/// The tile of a layer's number and a packed node.
fn tile_of(layer: u64, node: u64) -> Option<Tile> {
    let layer = match layer {
        0 => Layer::Elevation,
        1 => Layer::Color,
        _ => return None,
    };
    Some(Tile { layer, node: NodeId::unpack(node)? })
}

impl Event {
    /// An event with this content, of thread 0 and frame 0, without a time: callers set what
    /// matters.
    #[must_use]
    pub fn new(content: EventContent) -> Self {
        let event = |kind, value, node| Self { kind, value, node, ..Self::zeroed() };
        match content {
            EventContent::Span { name, node } => event(kind::SPAN, name as u64, node.map_or(0, NodeId::pack)),
            EventContent::TileUnavailable { tile, failure } => {
                let value = layer_number(tile.layer) | u64::from(failure.number()) << 8;
                event(kind::TILE_UNAVAILABLE, value, tile.node.pack())
            }
            EventContent::TileCame { tile } => event(kind::TILE_CAME, layer_number(tile.layer), tile.node.pack()),
            EventContent::FrameDone { triangles } => event(kind::FRAME_DONE, triangles, 0),
            EventContent::FrameWritten { is_settled } => event(kind::FRAME_WRITTEN, is_settled.into(), 0),
            EventContent::FrameWanted { tiles, nodes } => event(kind::FRAME_WANTED, halves(tiles, nodes), 0),
            EventContent::FrameUploaded { tiles } => event(kind::FRAME_UPLOADED, tiles, 0),
            EventContent::FrameCamera { r_z_px, r_c_px } => {
                event(kind::FRAME_CAMERA, halves(r_z_px.to_bits(), r_c_px.to_bits()), 0)
            }
            EventContent::FrameLacked { tiles, sharp_share } => {
                event(kind::FRAME_LACKED, halves(tiles, sharp_share.to_bits()), 0)
            }
            EventContent::FrameDraw { technique, view, tiles } => {
                let what = technique_number(technique) | (view as u32) << 8;
                event(kind::FRAME_DRAW, halves(what, tiles), 0)
            }
            EventContent::Text { kind } => event(kind.number(), 0, 0),
        }
    }

    /// Sets the frame.
    #[must_use]
    pub fn of_frame(self, frame: FrameNumber) -> Self {
        Self { frame: frame.get(), ..self }
    }

    /// The frame that it is of.
    #[must_use]
    pub fn frame(&self) -> FrameNumber {
        FrameNumber::new(self.frame)
    }

    /// Sets the thread of the process, 0 for its main thread.
    #[must_use]
    pub fn on_thread(self, thread: u32) -> Self {
        Self { thread, ..self }
    }

    /// Sets the start, nanoseconds of the monotonic clock.
    #[must_use]
    pub fn at(self, start_nanos: u64) -> Self {
        Self { start_nanos, ..self }
    }

    /// Sets the duration, nanoseconds.
    #[must_use]
    pub fn lasting(self, duration_nanos: u64) -> Self {
        Self { duration_nanos, ..self }
    }

    /// The content; `None` when it is not valid (it came from shared memory).
    #[must_use]
    pub fn content(&self) -> Option<EventContent> {
        let Self { value, node, .. } = *self;
        Some(match self.kind {
            kind::SPAN => {
                let name = SpanName::from_number(value)?;
                let node = if name.is_of_a_tile() { NodeId::unpack(node) } else { None };
                EventContent::Span { name, node }
            }
            kind::TILE_UNAVAILABLE => EventContent::TileUnavailable {
                tile: tile_of(value & 0xFF, node)?,
                failure: TileFailure::from_number(value >> 8)?,
            },
            kind::TILE_CAME => EventContent::TileCame { tile: tile_of(value, node)? },
            kind::FRAME_DONE => EventContent::FrameDone { triangles: value },
            kind::FRAME_WRITTEN => EventContent::FrameWritten { is_settled: value == 1 },
            kind::FRAME_WANTED => EventContent::FrameWanted { tiles: low(value), nodes: high(value) },
            kind::FRAME_UPLOADED => EventContent::FrameUploaded { tiles: value },
            kind::FRAME_CAMERA => {
                EventContent::FrameCamera { r_z_px: f32::from_bits(low(value)), r_c_px: f32::from_bits(high(value)) }
            }
            kind::FRAME_LACKED => {
                EventContent::FrameLacked { tiles: low(value), sharp_share: f32::from_bits(high(value)) }
            }
            kind::FRAME_DRAW => EventContent::FrameDraw {
                technique: technique_of(low(value) & 0xFF)?,
                view: u8::try_from(low(value) >> 8).ok()?,
                tiles: high(value),
            },
            kind::DEVICE_NAME => EventContent::Text { kind: TextKind::Device },
            kind::DRIVER_NAME => EventContent::Text { kind: TextKind::Driver },
            kind::TECHNIQUE_NAME => EventContent::Text { kind: TextKind::Technique },
            kind::TECHNIQUE_REASON => EventContent::Text { kind: TextKind::TechniqueReason },
            kind::FAILURE => EventContent::Text { kind: TextKind::Failure },
            _ => return None,
        })
    }

    /// The events that carry a text (at most 512 bytes, longer ones are cut), 32 bytes each:
    /// `thread` is the piece's number, `frame` the length of the whole text, and the four fields
    /// after it are the bytes.
    #[must_use]
    pub fn text(kind: TextKind, text: &str) -> Vec<Self> {
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
                kind: kind.number(),
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

    /// Adds one piece of a text to `into`; `true` when it was the last one. An invalid piece is
    /// ignored.
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
mod tests;
