//! Why a run ends before its last frame.

use crate::engine::EngineError;
use crate::frame::FrameError;
use crate::gpu::{GpuError, Missing};
use crate::sink::SinkError;
use crate::source::SourceError;
use crate::technique::DrawError;
use terravision_common::shm::WaitError;

/// Why a run ended before its last frame.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RunError {
    /// A frame could not be drawn.
    #[error(transparent)]
    Engine {
        /// Why.
        #[from]
        source: EngineError,
    },
    /// A picture could not be written.
    #[error(transparent)]
    Sink {
        /// Why.
        #[from]
        source: SinkError,
    },
}

impl RunError {
    /// Whether more was asked for than can be drawn or shown. A window that cannot be opened when
    /// this process is started again has lost its display for good.
    #[must_use]
    pub fn is_bad_input(&self) -> bool {
        match self {
            Self::Engine {
                source: EngineError::Draw { source: DrawError::Gpu { source: GpuError::Unsuitable { missing, .. } } },
            } => missing.iter().any(|lack| matches!(lack, Missing::PictureSize { .. })),
            Self::Engine { source: EngineError::PictureSize { .. } | EngineError::MeshOnly { .. } }
            | Self::Sink { source: SinkError::Window { .. } } => true,
            _ => false,
        }
    }

    /// Whether it only says that the run was stopped.
    #[must_use]
    pub fn is_stopping(&self) -> bool {
        self.wait().is_some_and(WaitError::is_stopping)
    }

    /// Whether the device was lost: another one may do.
    pub(super) fn is_device_lost(&self) -> bool {
        matches!(self, Self::Engine { source } if source.is_device_lost())
    }

    /// Whether it only says that the flight is over and all of its frames are written.
    pub(super) fn is_finished(&self) -> bool {
        self.wait().is_some_and(WaitError::is_finished)
    }

    fn wait(&self) -> Option<&WaitError> {
        match self {
            Self::Engine {
                source:
                    EngineError::Source { source: SourceError::Wait { source } }
                    | EngineError::Draw {
                        source: DrawError::Frame { source: FrameError::Source { source: SourceError::Wait { source } } },
                    },
            }
            | Self::Sink { source: SinkError::Wait { source } } => Some(source),
            _ => None,
        }
    }
}

impl From<SourceError> for RunError {
    fn from(source: SourceError) -> Self {
        Self::Engine { source: source.into() }
    }
}

impl From<FrameError> for RunError {
    fn from(source: FrameError) -> Self {
        Self::Engine { source: source.into() }
    }
}
