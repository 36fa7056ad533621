//! Where pictures go: one trait, a sibling file per sink. Sinks run on threads of their own
//! ([`workers`]).

mod anaglyph;
mod choose;
mod labels;
mod null;
mod png;
mod repeat;
mod shared;
mod split_views;
mod stream;
mod temporary;
mod tiff;
#[cfg(feature = "window")]
mod window;
pub mod workers;
mod yuv;

pub use anaglyph::AnaglyphSink;
pub use choose::sinks_of;
pub use labels::LabelSink;
pub use null::NullSink;
pub use png::{PngFileSink, PngFolderSink};
pub use repeat::RepeatSink;
pub use shared::SharedSink;
pub use split_views::SplitViewsSink;
pub use stream::StreamSink;
pub use tiff::{DepthSink, GroundSink};
#[cfg(feature = "window")]
pub use window::WindowSink;

use crate::gpu::{DevicePicture, GpuError};
use crate::pixels::PixelPlaces;
use crate::vehicles::VehicleFeedError;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use terravision_common::camera::Camera;
use terravision_common::ids::FrameNumber;
use terravision_common::rig::Views;
use terravision_common::shm::WaitError;

/// One finished picture.
#[derive(Debug, Clone, Copy)]
pub struct Picture<'a> {
    /// Number of the frame in its flight.
    pub frame: FrameNumber,
    /// Name of the one view that it shows; `None` where it shows all views of its frame.
    pub view: Option<&'a str>,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// `[height, width, 4]` bytes RGBA, row 0 at the top. Alpha is 255, or 254 where the ground was
    /// made up (`terravision_common::validity`). Empty where no sink needs pixels in memory of the
    /// processor ([`FrameSink::needs`]).
    pub rgba: &'a [u8],
    /// `[height, width]` near plane over metres along the view axis, 0 for sky; when depth was
    /// asked for.
    pub reversed_depth: Option<&'a [f32]>,
    /// The picture on the device, where a sink needs it there.
    pub on_device: Option<&'a DevicePicture>,
    /// The views that it shows, and where.
    pub views: Views,
    /// Whether every tile that it wanted was there.
    pub is_settled: bool,
}

impl<'a> Picture<'a> {
    /// Its camera: that of the first view, where it shows several.
    #[must_use]
    pub fn camera(&self) -> &Camera {
        &self.views[0].camera
    }

    /// Of each pixel, whether it shows ground that was made up.
    pub fn made_up(&self) -> impl Iterator<Item = bool> + use<'a> {
        self.rgba.chunks_exact(4).map(|texel| texel[3] & 1 == 0)
    }
}

/// Whether a picture has the one size that a sink takes.
fn check_size(sink: &'static str, picture: &Picture<'_>, expected: [u32; 2]) -> Result<(), SinkError> {
    let Picture { frame, size: found, .. } = *picture;
    if found == expected { Ok(()) } else { Err(SinkError::PictureSize { sink, frame, found, expected }) }
}

/// Whether a picture fits into a sink's room.
fn check_room(sink: &'static str, picture: &Picture<'_>, most: [u32; 2]) -> Result<(), SinkError> {
    let Picture { frame, size: found, .. } = *picture;
    let fits = (0..2).all(|axis| found[axis] <= most[axis]);
    if fits { Ok(()) } else { Err(SinkError::PictureTooLarge { sink, frame, found, most }) }
}

/// Width and height of a picture, and its pixels, RGBA.
pub type SizedRgba = ([u32; 2], Vec<u8>);

/// A sink could not do its work.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SinkError {
    /// A file or folder could not be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The system's reason.
        source: io::Error,
        /// The file or folder.
        path: PathBuf,
    },
    /// A picture could not be encoded.
    #[error("cannot encode {}: {reason}", path.display())]
    Encode {
        /// The encoder's reason.
        reason: String,
        /// The file.
        path: PathBuf,
    },
    /// Standard output could not be written to.
    #[error("standard output cannot be written: {source}")]
    Stdout {
        /// The system's reason.
        source: io::Error,
    },
    /// Who read standard output has gone.
    #[error("the reader of standard output has gone after {frames} frames")]
    ReaderGone {
        /// Frames that were written completely.
        frames: u64,
    },
    /// The picture has no depth.
    #[error("no depth came with the picture for {}", path.display())]
    NoDepth {
        /// The file that needs it.
        path: PathBuf,
    },
    /// The device could not copy a picture.
    #[error("a picture cannot be shown: {source}")]
    Show {
        /// Why.
        #[from]
        source: GpuError,
    },
    /// A sink of pictures of one size was given one of another.
    #[error(
        "frame {frame} is a picture of {}x{} pixels, but {sink} takes {}x{} only; start a flight of its own for another size",
        .found[0], .found[1], .expected[0], .expected[1]
    )]
    PictureSize {
        /// What it is.
        sink: &'static str,
        /// The frame.
        frame: FrameNumber,
        /// Its size.
        found: [u32; 2],
        /// The sink's.
        expected: [u32; 2],
    },
    /// A sink with room for pictures of some size was given a larger one.
    #[error(
        "frame {frame} is a picture of {}x{} pixels, larger than the {}x{} for which {sink} has room",
        .found[0], .found[1], .most[0], .most[1]
    )]
    PictureTooLarge {
        /// What it is.
        sink: &'static str,
        /// The frame.
        frame: FrameNumber,
        /// Its size.
        found: [u32; 2],
        /// The largest.
        most: [u32; 2],
    },
    /// A frame has other views than the run's rig.
    #[error("a frame has {found} views, expected {expected}")]
    ViewCount {
        /// Views of the frame.
        found: usize,
        /// Views of the rig.
        expected: usize,
    },
    /// The frame ring could not be opened or written.
    #[error(transparent)]
    Shared {
        /// Why.
        #[from]
        source: terravision_common::shm::ShmError,
    },
    /// Frames of the stream ring have another size.
    #[error("the stream ring has frames of {found} bytes, expected {expected}")]
    RingSize {
        /// What the ring has.
        found: u64,
        /// What a frame takes.
        expected: u64,
    },
    /// The run ended while the launcher was waited for.
    #[error(transparent)]
    Wait {
        /// How.
        #[from]
        source: WaitError,
    },
    /// It is not known where vehicles are.
    #[error(transparent)]
    Vehicles {
        /// Why.
        #[from]
        source: VehicleFeedError,
    },
    /// There is no window.
    #[error("{reason}")]
    Window {
        /// A sentence.
        reason: String,
    },
    /// A thread of the sink ended without an error.
    #[error("a thread that writes pictures has ended unexpectedly")]
    WorkerGone,
}

/// Takes finished pictures, in order. Runs on a thread of its own; may block for as long as writing
/// takes.
///
/// Dropping a sink that was not finished removes what is incomplete.
pub trait FrameSink: Send {
    /// Where it needs the pixels of pictures. What no sink of a run needs is not made: without any
    /// that needs them in memory, nothing is read back.
    fn needs(&self) -> PixelPlaces {
        PixelPlaces::HOST
    }

    /// Whether frames have outlines of the tree's colour leaves, where a person decides that while
    /// they are drawn.
    fn tree_overlay(&self) -> Option<Arc<AtomicBool>> {
        None
    }

    /// Takes the next picture; it is safely out of our hands when this returns.
    ///
    /// # Errors
    /// The picture could not be written; the run ends.
    fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError>;

    /// All pictures were written: completes the output.
    ///
    /// # Errors
    /// The output could not be completed.
    fn finish(&mut self) -> Result<(), SinkError>;

    /// A frame that a sink before this one, which was killed, has written; `None` where that
    /// cannot be read.
    ///
    /// # Errors
    /// The file there is not a picture.
    fn read_back(&mut self, _frame: FrameNumber) -> Result<Option<SizedRgba>, SinkError> {
        Ok(None)
    }
}

/// Several sinks as one: each picture goes to all of them, in order.
#[derive(Default)]
pub struct AllOf(
    /// The sinks.
    pub Vec<Box<dyn FrameSink>>,
);

impl std::fmt::Debug for AllOf {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "AllOf({} sinks)", self.0.len())
    }
}

impl FrameSink for AllOf {
    fn needs(&self) -> PixelPlaces {
        self.0.iter().fold(PixelPlaces::NOWHERE, |needs, sink| needs.and(sink.needs()))
    }

    fn tree_overlay(&self) -> Option<Arc<AtomicBool>> {
        self.0.iter().find_map(|sink| sink.tree_overlay())
    }

    fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
        self.0.iter_mut().try_for_each(|sink| sink.write(picture))
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        self.0.iter_mut().try_for_each(|sink| sink.finish())
    }
}
