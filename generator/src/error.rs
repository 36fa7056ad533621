//! Why the generator gives up.

use terravision_common::camera::CameraError;
use terravision_common::database::DatabaseError;
use terravision_common::rate::BadSettings;
use terravision_common::shm::{ShmError, WaitError};
use terravision_common::stage::StageError;

/// Why the generator gave up.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GeneratorError {
    /// The database cannot be opened.
    #[error(transparent)]
    Database(#[from] DatabaseError),
    /// A segment cannot be opened.
    #[error(transparent)]
    Shm(#[from] ShmError),
    /// The run ended.
    #[error(transparent)]
    Wait(#[from] WaitError),
    /// The rate control cannot work with the run's settings.
    #[error(transparent)]
    Rate(#[from] BadSettings),
    /// The launcher sent another frame than the next.
    #[error("the launcher sent the camera of frame {found}, expected frame {expected}")]
    WrongFrame {
        /// The frame that was sent.
        found: u64,
        /// The next one.
        expected: u64,
    },
    /// The launcher sent a camera that is not valid.
    #[error("frame {frame} has no valid camera: {source}")]
    BadCamera {
        /// Its frame.
        frame: u64,
        /// What is wrong with it, or with a view that it carries.
        source: CameraError,
    },
}

impl StageError for GeneratorError {
    fn is_stopping(&self) -> bool {
        matches!(self, Self::Wait(wait) if wait.is_stopping())
    }
}
