//! What a server said in place of an answer.

use crate::error::Cause;

/// An answer that is an error, and what it means.
#[derive(Debug, Clone, thiserror::Error)]
#[error("{why}")]
pub(crate) struct WireError {
    pub(crate) cause: Cause,
    why: String,
}

impl WireError {
    pub(crate) fn new(cause: Cause, why: impl Into<String>) -> Self {
        Self { cause, why: why.into() }
    }
}
