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
    /// (1 missing, 2 corrupt, 3 read error).
    TileUnavailable = 2,
    /// A frame was drawn: `value` is the number of triangles, `start_nanos` the end of its read-back, and
    /// `duration_nanos` the time since the frame before was finished.
    FrameDone = 3,
    /// A frame has left the sink (file written, bytes handed over): `value` is 1 when it was settled.
    FrameWritten = 4,
    /// Tiles that the frame wanted (`value`, low 32 bits) and nodes in its tree (high 32 bits).
    FrameWanted = 5,
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
    /// Preparer's loader: read and decode of one tile.
    LoadTile = 4,
    /// Renderer: reading the ring, recording commands.
    Record = 5,
    /// Renderer: colour tiles copied to the device.
    Upload = 6,
    /// Renderer: from submit to the end of read-back.
    Draw = 7,
    /// Renderer's sink: encoding and writing.
    Encode = 8,
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

/// Nanoseconds of the monotonic clock.
#[must_use]
pub fn monotonic_nanos() -> u64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    now.tv_sec.cast_unsigned() * 1_000_000_000 + now.tv_nsec.cast_unsigned()
}
