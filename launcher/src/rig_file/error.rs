//! What is wrong with a file of views.

use std::path::PathBuf;

/// A file of views cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RigError {
    /// It cannot be read.
    #[error("--views {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// It is not JSON, or has other keys.
    #[error("--views {} is not a file of views: {source}; docs/views.md has examples", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// What is wrong, and where.
        source: serde_json::Error,
    },
    /// Its views are not a rig.
    #[error("--views {}: {source}", path.display())]
    Rig {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: terravision_common::rig::RigError,
    },
    /// A value is out of range.
    #[error("--views {}: the {key} of view {view} is {found}, expected {expected}", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// The view.
        view: String,
        /// Which value.
        key: &'static str,
        /// What it is.
        found: String,
        /// What it may be.
        expected: &'static str,
    },
    /// Some views have a place, others do not.
    #[error("--views {}: some views have x and y, some do not; expected x and y for all of them or for none", path.display())]
    HalfPlaced {
        /// The file.
        path: PathBuf,
    },
    /// Views have places, but each goes into a picture of its own.
    #[error("--views {}: a picture of each view (\"separate\") has no place for x and y; leave them out", path.display())]
    PlacedApart {
        /// The file.
        path: PathBuf,
    },
    /// Two views cover each other.
    #[error("--views {}: views {first} and {second} overlap in the picture; move one with x and y", path.display())]
    Overlap {
        /// The file.
        path: PathBuf,
        /// One.
        first: String,
        /// The other.
        second: String,
    },
    /// The picture of all views is too large.
    #[error(
        "--views {}: all views together are a picture of {width}x{height} pixels, expected sides up to 65536 and 268 million pixels; \
         make them smaller, or place them above each other with x and y",
        path.display()
    )]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Width, pixels.
        width: u64,
        /// Height, pixels.
        height: u64,
    },
}
