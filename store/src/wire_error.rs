//! Errors that a server sent instead of an answer.

use crate::error::Cause;

/// An answer with an error status, and its meaning.
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
