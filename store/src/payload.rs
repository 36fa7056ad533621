//! The result of a read.

use bytes::Bytes;
use std::time::Instant;

/// A stored tile.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Payload {
    /// Its bytes, whose checksum has been verified.
    pub bytes: Bytes,
    /// When the answered request was made, if it was repeated because the one before took much
    /// longer than usual.
    pub resent_at: Option<Instant>,
}

impl Payload {
    /// A tile whose first request was answered.
    #[must_use]
    pub fn new(bytes: Bytes) -> Self {
        Self { bytes, resent_at: None }
    }
}
