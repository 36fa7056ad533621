//! Why a frame could not be drawn.

use crate::frame::FrameError;
use crate::gpu::GpuError;
use crate::source::SourceError;
use crate::technique::DrawError;
use terravision_raycast::workers::WorkersError;

/// A frame could not be drawn.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EngineError {
    /// The device failed, or a frame from the ring is corrupt: all that can go wrong with drawing
    /// itself.
    #[error(transparent)]
    Draw {
        /// Why.
        #[from]
        source: DrawError,
    },
    /// The source failed.
    #[error(transparent)]
    Source {
        /// Why.
        #[from]
        source: SourceError,
    },
    /// No threads for rays.
    #[error(transparent)]
    Workers {
        /// Why.
        #[from]
        source: WorkersError,
    },
    /// Pictures of rays have a largest size, as those of devices have.
    #[error("a picture of {}x{} pixels cannot be drawn by rays, at most {limit}x{limit} can", .size[0], .size[1])]
    PictureSize {
        /// What was asked for.
        size: [u32; 2],
        /// The longest side.
        limit: u32,
    },
    /// Something that only the mesh does was asked of rays.
    #[error("{what}: rays cannot do that, --technique mesh can")]
    MeshOnly {
        /// What.
        what: &'static str,
    },
}

impl EngineError {
    /// Whether the device was lost: another one may do.
    #[must_use]
    pub fn is_device_lost(&self) -> bool {
        matches!(self, Self::Draw { source: DrawError::Gpu { source } } if source.is_device_lost())
    }
}

impl From<GpuError> for EngineError {
    fn from(source: GpuError) -> Self {
        DrawError::from(source).into()
    }
}

impl From<FrameError> for EngineError {
    fn from(source: FrameError) -> Self {
        DrawError::from(source).into()
    }
}
