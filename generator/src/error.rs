//! Why the generator gives up.

use terravision_common::camera::CameraError;
use terravision_common::database::DatabaseError;
use terravision_common::ids::FrameNumber;
use terravision_common::rate::BadSettings;
use terravision_common::shm::{ShmError, WaitError};
use terravision_common::stage::StageError;

/// Why the generator gave up.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GeneratorError {
    /// The database cannot be opened.
    #[error(transparent)]
    Database {
        /// Why.
        #[from]
        source: DatabaseError,
    },
    /// A segment cannot be opened.
    #[error(transparent)]
    Shm {
        /// Why.
        #[from]
        source: ShmError,
    },
    /// The run ended.
    #[error(transparent)]
    Wait {
        /// How.
        #[from]
        source: WaitError,
    },
    /// The rate control cannot work with the run's settings.
    #[error(transparent)]
    Rate {
        /// Which of them.
        #[from]
        source: BadSettings,
    },
    /// The launcher sent another frame than the next.
    #[error("the launcher sent the camera of frame {found}, expected frame {expected}")]
    WrongFrame {
        /// The frame that was sent.
        found: FrameNumber,
        /// The next one.
        expected: FrameNumber,
    },
    /// The launcher sent a camera that is not valid.
    #[error("frame {frame} has no valid camera: {source}")]
    BadCamera {
        /// Its frame.
        frame: FrameNumber,
        /// What is wrong with it, or with a view that it carries.
        source: CameraError,
    },
}

impl StageError for GeneratorError {
    fn is_stopping(&self) -> bool {
        matches!(self, Self::Wait { source } if source.is_stopping())
    }
}
