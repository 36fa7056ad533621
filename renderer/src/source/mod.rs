//! Where frames come from: a run's shared memory ([`LiveSource`]) or a recording in memory
//! ([`RecordedSource`]).

mod live;
mod recorded;
mod recorder;

pub use live::LiveSource;
pub use recorded::{RecordedFrame, RecordedSource, Recording, RecordingBuilder};
pub use recorder::Recorder;

use crate::gpu::HostMemory;
use terravision_common::event::Event;
use terravision_common::ids::{RingPosition, Sequence, SlotKey};
use terravision_common::rate::FrameTiming;
use terravision_common::shm::{Activity, Counter, ShmError, WaitError};
use terravision_common::slot::Slot;
use terravision_common::texels::TexelFormat;
use terravision_common::world::World;

/// What a source delivers, fixed for its life.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SourceShape {
    /// The world that nodes and lattice points are of.
    pub world: World,
    /// Most arrays that a frame can have.
    pub elevation_arrays: u64,
    /// What was done before: by renderers before this one, which were killed.
    pub done: Done,
    /// Whether there was a renderer before this one: the first slots may be the rest of a frame
    /// that it could not hold.
    pub is_resumed: bool,
    /// Slots of the colour pool.
    pub color_slots: u32,
    /// The elevation pool, where it is read.
    pub elevation_pool: Option<ElevationPoolShape>,
    /// How it holds its tiles.
    pub texels: TexelFormat,
    /// First frame, and one past the last.
    pub frames: [u64; 2],
    /// Whether frames may be left out (realtime); the last one never is.
    pub has_gaps: bool,
}

/// How an elevation pool holds its tiles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ElevationPoolShape {
    /// Slots.
    pub slots: u32,
    /// Numbers from the beginning of a slot to that of the next.
    pub stride: u32,
}

/// How far the frames of a source are done with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Done {
    /// Number of the frame within the run, from 1; 0 before the first.
    pub sequence: Sequence,
    /// One past its last position in the elevation ring.
    pub elevation_end: RingPosition,
    /// One past its last slot ([`Slots::position`]).
    pub slots_end: RingPosition,
}

/// Why a source has no next frame.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SourceError {
    /// The run ended or a peer is gone.
    #[error(transparent)]
    Wait {
        /// Why.
        #[from]
        source: WaitError,
    },
    /// A segment could not be opened or believed.
    #[error(transparent)]
    Segment {
        /// Why.
        #[from]
        source: ShmError,
    },
    /// The colour tile is too small for the world's tiles.
    #[error("a slot of the colour pool has {found} bytes, the world's tiles need {expected}")]
    ColorSlotSize {
        /// Bytes of a slot.
        found: u64,
        /// Bytes of a tile with its mips.
        expected: u64,
    },
    /// An elevation array has another size than the world's tiles.
    #[error("an elevation array has {found} values, the world's tiles have {expected}")]
    ElevationArraySize {
        /// Values of an array.
        found: u64,
        /// Posts of a tile.
        expected: u64,
    },
    /// A recording is over.
    #[error("the recording has no more frames")]
    Ended,
}

/// The slots of frames, one after the other. What comes out of it is not trusted:
/// `frame::FrameReader` checks every slot.
pub trait Slots {
    /// The next slot, if there is one now.
    ///
    /// # Errors
    /// The source is damaged or over.
    fn try_next(&mut self) -> Result<Option<Slot>, SourceError>;

    /// Waits for the next slot.
    ///
    /// # Errors
    /// The run ended, a peer is gone, or the source is damaged or over.
    fn next(&mut self) -> Result<Slot, SourceError>;

    /// Position of the slot that comes next; counts up over all slots.
    fn position(&self) -> RingPosition;

    /// Goes back to the first slot of the first frame that is not done with, if it was held.
    /// Returns how far frames are done with.
    fn rewind(&mut self) -> Done;
}

/// The elevation arrays and colour tiles that frames name: in place, for a device that may read
/// them there, or as copies.
pub trait Pools {
    /// The elevation arrays' memory, when a device may read it in place.
    fn elevation_memory(&self) -> Option<HostMemory>;

    /// The colour tiles' memory, likewise.
    fn color_memory(&self) -> Option<HostMemory>;

    /// Byte offset of an elevation array in [`Pools::elevation_memory`]; `None` when there is no
    /// such array now.
    ///
    /// # Errors
    /// The source is damaged.
    fn elevation_offset(&mut self, position: u64) -> Result<Option<u64>, SourceError>;

    /// Copies an elevation array (as many values as `out` has); whether there is such an array now.
    ///
    /// # Errors
    /// The source is damaged.
    fn read_elevation(&mut self, position: u64, out: &mut [f32]) -> Result<bool, SourceError>;

    /// The whole elevation pool, as numbers, where it is read. Those of a frame's tiles do not change
    /// as long as the frame is not done with; no others are read.
    fn elevation_pool(&self) -> &[f32];

    /// Whether a slot of the elevation pool holds this generation.
    fn has_elevation_tile(&self, key: SlotKey) -> bool;

    /// Byte offset of a colour tile in [`Pools::color_memory`]; `None` when the slot holds another
    /// generation.
    fn color_offset(&mut self, key: SlotKey) -> Option<u64>;

    /// A colour tile with its mips, in place; `None` when the slot holds another generation.
    fn color(&self, key: SlotKey) -> Option<&[u8]>;

    /// Copies a colour tile with its mips (as many bytes as `out` has); whether the slot holds this
    /// generation.
    fn read_color(&mut self, key: SlotKey, out: &mut [u8]) -> bool;
}

/// What frames are done with, and whether there are more.
pub trait Completion {
    /// A frame is done with, and so are those before it: what it named may be replaced.
    ///
    /// # Errors
    /// The source is damaged.
    fn complete(&mut self, done: &Done) -> Result<(), SourceError>;

    /// The elevation arrays below a position belong to no frame, and no frame before them is with
    /// the device.
    ///
    /// # Errors
    /// The source is damaged.
    fn release_elevations(&mut self, upto: RingPosition) -> Result<(), SourceError>;

    /// Whether a renderer that was killed has completed the last frame of the run.
    fn is_over(&self) -> bool {
        false
    }

    /// Whether this renderer may be killed and replaced by another one.
    fn is_supervised(&self) -> bool {
        false
    }

    /// Whether the run goes on; a sign of life too. Asked once a frame and while waiting for sinks.
    ///
    /// # Errors
    /// The run ended.
    fn check(&mut self) -> Result<(), SourceError>;
}

/// What the launcher and the rate control are told; nothing of it waits.
pub trait Telemetry {
    /// A frame is finished, which took so long: for the rate control. Sources that have none do not
    /// listen.
    fn timed(&mut self, timing: &FrameTiming);

    /// This many frames have left the sink.
    fn written(&mut self, count: u64);

    /// Tells the launcher about work done; never waits.
    fn event(&mut self, event: &Event);

    /// Adds to one of the run's counters.
    fn count(&mut self, counter: Counter, by: u64);

    /// What is waited for until the next [`Telemetry::progress`], for the launcher to watch.
    fn awaits(&mut self, _activity: Activity) {}

    /// A frame was recorded, drawn or written.
    fn progress(&mut self) {}
}

/// Where frames come from. One thread calls it; only [`Slots::next`] blocks.
pub trait FrameSource: Slots + Pools + Completion + Telemetry {
    /// What it delivers.
    fn shape(&self) -> SourceShape;
}
