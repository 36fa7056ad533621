//! What is wrong with a file of views, or with the views that other flags ask for.

/// Views cannot be drawn.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RigError {
    /// It cannot be read.
    #[error("{asked}: {source}")]
    Read {
        /// The flag that asked for it.
        asked: String,
        /// Why.
        source: std::io::Error,
    },
    /// It is not JSON, or has other keys.
    #[error("{asked} is not a file of views: {source}; docs/views.md has examples")]
    Json {
        /// The flag that asked for it.
        asked: String,
        /// What is wrong, and where.
        source: serde_json::Error,
    },
    /// Its views are not a rig.
    #[error("{asked}: {source}")]
    Rig {
        /// The flag that asked for it.
        asked: String,
        /// Why not.
        source: terravision_common::rig::RigError,
    },
    /// A value is out of range.
    #[error("{asked}: the {key} of view {view} is {found}, expected {expected}")]
    Value {
        /// The flag that asked for it.
        asked: String,
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
    #[error("{asked}: some views have x and y, some do not; expected x and y for all of them or for none")]
    HalfPlaced {
        /// The flag that asked for it.
        asked: String,
    },
    /// Views have places, but each goes into a picture of its own.
    #[error("{asked}: a picture of each view (\"separate\") has no place for x and y; leave them out")]
    PlacedApart {
        /// The flag that asked for it.
        asked: String,
    },
    /// Two views cover each other.
    #[error("{asked}: views {first} and {second} overlap in the picture; move one with x and y")]
    Overlap {
        /// The flag that asked for it.
        asked: String,
        /// One.
        first: String,
        /// The other.
        second: String,
    },
    /// Two views are to be one picture for glasses, and they are not two of one size.
    #[error("{asked}: an anaglyph is made of two views of one size, a left and a right one; found {found}")]
    NoPair {
        /// The flag that asked for it.
        asked: String,
        /// What there is.
        found: String,
    },
    /// The picture of all views is too large.
    #[error(
        "{asked}: all views together are a picture of {width}x{height} pixels, expected sides up to 65536 and 268 million pixels; \
         make them smaller, or place them above each other with x and y"
    )]
    TooLarge {
        /// The flag that asked for it.
        asked: String,
        /// Width, pixels.
        width: u64,
        /// Height, pixels.
        height: u64,
    },
}
