//! Poses from another program while a flight goes on: `--camera shm:NAME` or `--camera udp:ADDRESS`
//! (docs/frame-ring.md). What comes in is checked ([`gate`]); what is not a pose is refused,
//! reported once for each cause, and counted, and the flight goes on.

pub mod gate;
pub mod message;
mod udp;

use crate::path::Ground;
use gate::Gate;
use message::Message;
use std::fmt;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::{Duration, Instant};
use terravision_common::camera::Camera;
use terravision_common::shm::{PoseInbox, SharedName, ShmError};
use terravision_store::Store;
use udp::UdpPort;

/// Between two looks at a pose in shared memory: other languages have no futex to wake us with.
const LOOK_EVERY: Duration = Duration::from_micros(500);

/// Where `--camera` says that poses come from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CameraSource {
    /// A record in shared memory.
    Shared(SharedName),
    /// JSON lines in datagrams to this address of this machine.
    Udp(SocketAddr),
}

/// The text of `--camera` is not a source of poses.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("expected shm:NAME (letters, digits, dots, dashes, underscores) or udp:127.0.0.1:PORT")]
pub struct CameraSourceError;

impl FromStr for CameraSource {
    type Err = CameraSourceError;
    fn from_str(text: &str) -> Result<Self, CameraSourceError> {
        if let Some(name) = text.strip_prefix("shm:") {
            return SharedName::parse(name).map(Self::Shared).map_err(|_bad_name| CameraSourceError);
        }
        // Poses steer what is drawn: other machines must not.
        let address: Option<SocketAddr> = text.strip_prefix("udp:").and_then(|address| address.parse().ok());
        address.filter(|address| address.ip().is_loopback()).map(Self::Udp).ok_or(CameraSourceError)
    }
}

impl fmt::Display for CameraSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Shared(name) => write!(f, "shm:{name}"),
            Self::Udp(address) => write!(f, "udp:{address}"),
        }
    }
}

/// Why poses cannot come in.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InputError {
    /// The segment cannot be made.
    #[error("--camera {from}: {source}")]
    Shared {
        /// As asked for.
        from: CameraSource,
        /// Why.
        #[source]
        source: ShmError,
    },
    /// The port cannot be listened at.
    #[error("--camera {from}: cannot listen there: {source}")]
    Udp {
        /// As asked for.
        from: CameraSource,
        /// Why.
        #[source]
        source: std::io::Error,
    },
}

/// What a look at the input brought.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Incoming {
    /// A pose that was accepted, as a camera, and its time in the sender's clock (NaN without one).
    Pose {
        /// The camera; its timestamp is when it came in.
        camera: Camera,
        /// Seconds.
        time_s: f64,
    },
    /// Nothing to fly in the time that was given.
    Nothing,
    /// The sender ends the flight.
    End,
}

#[derive(Debug)]
enum Port {
    Shared(PoseInbox),
    Udp(UdpPort),
}

/// The input of a flight. One thread reads it.
#[derive(Debug)]
pub struct CameraInput {
    port: Port,
    gate: Gate,
}

impl CameraInput {
    /// Makes the segment, or listens at the port.
    ///
    /// # Errors
    /// [`InputError`].
    pub fn open(from: &CameraSource, gate: Gate) -> Result<Self, InputError> {
        let port = match from {
            CameraSource::Shared(name) => Port::Shared(
                PoseInbox::create(name).map_err(|source| InputError::Shared { from: from.clone(), source })?,
            ),
            CameraSource::Udp(address) => {
                Port::Udp(UdpPort::open(*address).map_err(|source| InputError::Udp { from: from.clone(), source })?)
            }
        };
        Ok(Self { port, gate })
    }

    /// Where senders send to, for people.
    #[must_use]
    pub fn place(&self) -> String {
        match &self.port {
            Port::Shared(inbox) => format!("/dev/shm/{}", inbox.file()),
            Port::Udp(port) => format!("udp:{}", port.address()),
        }
    }

    /// The file that poses come by, if they come by one.
    #[must_use]
    pub fn shared_file(&self) -> Option<PathBuf> {
        match &self.port {
            Port::Shared(inbox) => Some(Path::new("/dev/shm").join(inbox.file())),
            Port::Udp(_) => None,
        }
    }

    /// The next pose that is accepted; waits for one, `timeout` at most. Poses in shared memory
    /// that were replaced before a look at them are not seen. `tell` gets a sentence at the first
    /// refusal of each cause.
    ///
    /// # Errors
    /// No pose can come any more: another program has cut the segment.
    pub fn next(
        &mut self,
        timeout: Duration,
        ground: &dyn Ground,
        tell: &mut dyn FnMut(String),
    ) -> Result<Incoming, ShmError> {
        let until = Instant::now() + timeout;
        loop {
            let message = match &mut self.port {
                Port::Shared(inbox) => inbox.read()?.map(Message::of_record),
                Port::Udp(port) => port.next(until.saturating_duration_since(Instant::now())),
            };
            if let Some(message) = message {
                let outcome = self.gate.pass(&message, ground, tell);
                if let Port::Shared(inbox) = &self.port {
                    inbox.answer(self.gate.accepted(), self.gate.refused())?;
                }
                // A refusal is counted and told by the gate.
                if let Ok(incoming) = outcome {
                    return Ok(incoming);
                }
            }
            let rest = until.saturating_duration_since(Instant::now());
            if rest.is_zero() {
                return Ok(Incoming::Nothing);
            }
            if let Port::Shared(_) = self.port {
                std::thread::sleep(rest.min(LOOK_EVERY));
            }
        }
    }

    /// How many poses were accepted, refused and lifted, in sentences; none when all were flown as
    /// they came.
    #[must_use]
    pub fn summary(&self) -> Vec<String> {
        self.gate.summary()
    }
}

/// An input with what its poses are checked against.
#[derive(Debug)]
pub struct LiveCamera {
    /// The input.
    pub input: CameraInput,
    /// The world, for the ground under the camera.
    pub database: Store,
    /// Factor on its heights.
    pub exaggeration: f64,
    /// The flight ends when no pose came for this long and all frames are written.
    pub idle_timeout: Option<Duration>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sources_are_read_and_others_refused() {
        for text in ["shm:uav", "udp:127.0.0.1:9000", "udp:[::1]:1"] {
            assert_eq!(text.parse::<CameraSource>().unwrap().to_string(), text);
        }
        for text in
            ["", "shm:", "shm:a/b", "shm:x-camera", "udp:", "udp:9000", "udp:0.0.0.0:9000", "udp:10.0.0.1:9", "tcp:1"]
        {
            assert!(text.parse::<CameraSource>().is_err(), "{text}");
        }
    }
}
