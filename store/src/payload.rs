//! What a read brings.

use bytes::Bytes;
use std::time::Instant;

/// A tile as it is stored.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Payload {
    /// Its bytes; their checksum is right.
    pub bytes: Bytes,
    /// When the request was made that was answered, if it was made anew because the one before took
    /// much longer than usual.
    pub resent_at: Option<Instant>,
}

impl Payload {
    /// One whose first request was answered.
    #[must_use]
    pub fn new(bytes: Bytes) -> Self {
        Self { bytes, resent_at: None }
    }
}
