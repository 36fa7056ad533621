//! Why there is no window.

use terravision_common::shm::ShmError;

/// A window cannot be opened.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WindowError {
    /// There is no desktop to open it on.
    #[error(
        "there is no display for a window ({reason}); start it on a desktop of X11 or Wayland, or look around with terravision serve"
    )]
    NoDisplay {
        /// What was tried.
        reason: String,
    },
    /// The desktop refuses.
    #[error("the window cannot be opened: {reason}")]
    Refused {
        /// Its reason.
        reason: String,
    },
    /// Poses cannot be sent to the flight.
    #[error(transparent)]
    Poses {
        /// Why.
        #[from]
        source: ShmError,
    },
    /// The path that is to be played is not there.
    #[error("the path cannot be read: {source}: {}", path.display())]
    Path {
        /// Why.
        source: std::io::Error,
        /// The launcher's file.
        path: std::path::PathBuf,
    },
    /// The system gives no thread.
    #[error("the window has no thread: {source}")]
    Thread {
        /// Why.
        #[from]
        source: std::io::Error,
    },
}
