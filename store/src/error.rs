//! Why a database cannot be opened, and why a tile cannot be read.

use std::path::PathBuf;
use std::sync::Arc;
use terravision_common::database::{DatabaseError, Layer, ManifestError, TileDamage, TileError};
use terravision_common::node::NodeId;
use terravision_common::outcome::TileFailure;

/// The kind of a failure, by which metrics count.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Cause {
    /// The server has no such file (404, 410).
    NotFound,
    /// The server denies access (401, 403, 407).
    Denied,
    /// No credentials, or they cannot be read.
    Credentials,
    /// The server asks for fewer requests (429, 503 with `Retry-After`).
    Throttled,
    /// The server failed (5xx).
    Server,
    /// The server refused the request for another reason.
    Refused,
    /// The server does not honour byte ranges.
    NoRanges,
    /// The server sent other bytes than requested: fewer, more, or another range.
    BadAnswer,
    /// Redirected without end.
    Redirects,
    /// No answer in time.
    Timeout,
    /// No connection.
    Connect,
    /// The host's name does not resolve.
    Name,
    /// The server's certificate is not trusted, or TLS failed otherwise.
    Certificate,
    /// The connection broke.
    Interrupted,
    /// The bytes are not those that were written.
    Damaged,
    /// The database changed while it was read.
    Changed,
    /// A file was replaced by an equal one: not a failure, but worth reporting.
    Touched,
    /// It is not in the cache, and the network must not be used.
    Offline,
    /// The disk cache does not work.
    Cache,
    /// A local disk fails.
    Disk,
    /// The store was closed while it was read.
    Closed,
    /// The server sent a web page instead of the file.
    WebPage,
}

impl Cause {
    /// All causes, by their numbers.
    pub const ALL: [Self; 22] = [
        Self::NotFound,
        Self::Denied,
        Self::Credentials,
        Self::Throttled,
        Self::Server,
        Self::Refused,
        Self::NoRanges,
        Self::BadAnswer,
        Self::Redirects,
        Self::Timeout,
        Self::Connect,
        Self::Name,
        Self::Certificate,
        Self::Interrupted,
        Self::Damaged,
        Self::Changed,
        Self::Touched,
        Self::Offline,
        Self::Cache,
        Self::Disk,
        Self::Closed,
        Self::WebPage,
    ];

    /// Its number, as sent to other processes.
    #[must_use]
    pub fn number(self) -> usize {
        self as usize
    }

    /// The cause of this name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|cause| cause.name() == name)
    }

    /// Its name in metrics.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::NotFound => "not_found",
            Self::Denied => "denied",
            Self::Credentials => "credentials",
            Self::Throttled => "throttled",
            Self::Server => "server",
            Self::Refused => "refused",
            Self::NoRanges => "no_ranges",
            Self::BadAnswer => "bad_answer",
            Self::Redirects => "redirects",
            Self::Timeout => "timeout",
            Self::Connect => "connect",
            Self::Name => "name",
            Self::Certificate => "certificate",
            Self::Interrupted => "interrupted",
            Self::Damaged => "damaged",
            Self::Changed => "changed",
            Self::Touched => "touched",
            Self::Offline => "offline",
            Self::Cache => "cache",
            Self::Disk => "disk",
            Self::Closed => "closed",
            Self::WebPage => "web_page",
        }
    }

    /// Whether the server answered, or is not trusted, and would answer the same next time.
    #[must_use]
    pub fn is_refusal(self) -> bool {
        matches!(
            self,
            Self::NotFound
                | Self::Denied
                | Self::Credentials
                | Self::Refused
                | Self::NoRanges
                | Self::Redirects
                | Self::Certificate
                | Self::WebPage
        )
    }

    /// Whether the next request may succeed after a failure of this kind.
    #[must_use]
    pub fn is_passing(self) -> bool {
        matches!(
            self,
            Self::Throttled
                | Self::Server
                | Self::BadAnswer
                | Self::Timeout
                | Self::Connect
                | Self::Name
                | Self::Interrupted
                | Self::Damaged
        )
    }
}

/// A failed request or read: its kind, the file, and the reason.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{why}: {place}")]
pub struct Fault {
    /// Its kind.
    pub cause: Cause,
    /// Why, a clause.
    pub why: String,
    /// The file of the database, without secrets.
    pub place: String,
}

/// Why a tile cannot be read. Cheap to clone: several readers may wait for the same bytes.
#[derive(Debug, Clone, thiserror::Error)]
#[non_exhaustive]
pub enum FetchError {
    /// The database does not contain this tile.
    #[error("the database has no such tile")]
    Absent,
    /// Its bytes are damaged, also after repeated reads.
    #[error("it is damaged: {reason}")]
    Damaged {
        /// What is wrong with it.
        reason: Arc<TileDamage>,
    },
    /// It could not be read.
    #[error("{fault}")]
    Failed {
        /// What happened.
        fault: Arc<Fault>,
    },
}

impl FetchError {
    pub(crate) fn failed(cause: Cause, why: impl Into<String>, place: impl Into<String>) -> Self {
        Self::failed_as(Arc::new(Fault { cause, why: why.into(), place: place.into() }))
    }

    /// A failure that another read has found.
    pub(crate) fn failed_as(fault: Arc<Fault>) -> Self {
        Self::Failed { fault }
    }

    /// The kind of failure; `None` for a tile that the database does not contain.
    #[must_use]
    pub fn cause(&self) -> Option<Cause> {
        match self {
            Self::Absent => None,
            Self::Damaged { .. } => Some(Cause::Damaged),
            Self::Failed { fault } => Some(fault.cause),
        }
    }

    /// Whether a later request may succeed.
    #[must_use]
    pub fn is_passing(&self) -> bool {
        self.cause().is_some_and(Cause::is_passing)
    }

    /// The failure as used in outcomes, reports and metrics.
    #[must_use]
    pub fn failure(&self) -> TileFailure {
        match self.cause() {
            None => TileFailure::Missing,
            Some(Cause::Damaged) => TileFailure::Damaged,
            Some(Cause::Offline) => TileFailure::NotCached,
            // A failing disk is not a refusal.
            Some(cause) if cause.is_refusal() => TileFailure::Refused,
            Some(_) => TileFailure::Unreadable,
        }
    }

    /// The failure as an error of a tile reader.
    #[must_use]
    pub fn into_tile_error(self, layer: Layer, node: NodeId) -> TileError {
        match self {
            Self::Absent => TileError::Missing { layer, node },
            Self::Damaged { reason } => {
                TileError::Corrupt { layer, node, reason: TileDamage::Shared { damage: reason } }
            }
            failed @ Self::Failed { .. } => TileError::Read { layer, node, source: std::io::Error::other(failed) },
        }
    }
}

/// Why a database cannot be opened.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// A local database, or a mirrored index.
    #[error(transparent)]
    Database {
        /// What is wrong with it.
        #[from]
        source: DatabaseError,
    },
    /// The server has no manifest at this place.
    #[error("there is no finished terrain database ({why}): {location}")]
    NotADatabase {
        /// What the server said.
        why: String,
        /// Where it was looked for.
        location: String,
    },
    /// The manifest cannot be parsed.
    #[error("the manifest cannot be used: {source}, at {location}")]
    Manifest {
        /// What is wrong.
        #[source]
        source: ManifestError,
        /// Where.
        location: String,
    },
    /// The server sent a web page instead of the manifest.
    #[error("the server sent a web page in place of the manifest (a log-in, or a wrong path?), from {location}")]
    WebPage {
        /// Where.
        location: String,
    },
    /// It cannot be reached or read.
    #[error("cannot read the terrain database: {source}")]
    Fetch {
        /// Why.
        #[from]
        source: FetchError,
    },
    /// No client can be created from the location and the environment.
    #[error("cannot make a client for {location}: {why}")]
    Client {
        /// Why.
        why: String,
        /// The location.
        location: String,
    },
    /// The index cannot be stored on this machine.
    #[error("cannot keep the index of the database: {source}: {}", path.display())]
    Mirror {
        /// Why.
        #[source]
        source: std::io::Error,
        /// Where.
        path: PathBuf,
    },
    /// Threads cannot be started.
    #[error("cannot start the threads that read the network: {source}")]
    Threads {
        /// Why.
        #[source]
        source: std::io::Error,
    },
}

impl StoreError {
    /// Whether the named database cannot be opened, as opposed to a failure of this machine.
    #[must_use]
    pub fn is_bad_input(&self) -> bool {
        !matches!(self, Self::Mirror { .. } | Self::Threads { .. })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use terravision_common::shm::FAILURE_CAUSES;

    #[test]
    fn every_cause_has_a_number_and_a_name_of_its_own() {
        assert!(Cause::ALL.len() <= FAILURE_CAUSES);
        for (number, cause) in Cause::ALL.into_iter().enumerate() {
            assert_eq!((cause.number(), Cause::from_name(cause.name())), (number, Some(cause)));
        }
    }

    #[test]
    fn a_failure_that_readers_repeat_is_one_that_frames_wait_for() {
        for cause in Cause::ALL {
            let failure = FetchError::failed(cause, "", "").failure();
            assert!(!cause.is_passing() || failure.may_pass(), "{cause:?}");
            assert!(!(cause.is_refusal() || cause == Cause::Offline) || !failure.may_pass(), "{cause:?}");
        }
        assert_eq!(FetchError::Absent.failure(), TileFailure::Missing);
    }
}
