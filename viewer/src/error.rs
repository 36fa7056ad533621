//! Why a viewer ends other than by the end of its launcher.

use std::io;

/// Why a viewer ends.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ViewerError {
    /// It was not started by the launcher.
    #[error(
        "this program is started by terravision serve: expected a listening socket as standard input and a socket as \
         standard output: {0}"
    )]
    NotServed(io::Error),
    /// The launcher's first line is not what it should be.
    #[error("the launcher's first line cannot be read: {0}")]
    Setup(String),
    /// The system refuses.
    #[error("cannot set up the process: {0}")]
    Os(io::Error),
    /// The world does not open.
    #[error(transparent)]
    World(#[from] terravision_store::StoreError),
    /// It is not where it is said to be.
    #[error(transparent)]
    Location(#[from] terravision_store::LocationError),
}
