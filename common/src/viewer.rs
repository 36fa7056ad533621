//! What the launcher (`terravision serve`) and the viewer tell each other: one JSON object a line,
//! over a socket pair that is the viewer's standard output. Its standard input is the listening
//! socket, which the launcher keeps: a viewer that died is replaced on the same port.

mod settings;

pub use settings::{SIDE_BY_SIDE, StreamSettings};

use crate::run::DatabaseConfig;
use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};
use std::net::SocketAddr;
use std::path::PathBuf;

/// Longest line of this conversation.
pub const MOST_LINE_BYTES: u64 = 1 << 20;
/// Smallest and largest side of the stream's pictures, pixels.
pub const SIDES_PX: [u32; 2] = [64, 4096];

/// Environment of the viewer's process: memory of pictures goes back to the system when it is free.
/// How many are held at a time depends on how slow clients are, and glibc would keep the most there
/// ever were. Programs that it starts are not to inherit it.
pub const VIEWER_ENVIRONMENT: [(&str, &str); 2] = [("MALLOC_MMAP_THRESHOLD_", "262144"), ("MALLOC_ARENA_MAX", "2")];

/// A pose as people type it: degrees, metres, the world's CRS.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Pod, Zeroable)]
#[repr(C)]
pub struct ViewerPose {
    /// Easting.
    pub x: f64,
    /// Northing.
    pub y: f64,
    /// Height.
    pub z: f64,
    /// Degrees clockwise from grid north.
    pub heading: f64,
    /// Degrees up from the horizontal.
    pub pitch: f64,
    /// Degrees clockwise.
    #[serde(default)]
    pub roll: f64,
    /// Vertical field of view, degrees.
    #[serde(default = "usual_vfov")]
    pub vfov: f64,
}

fn usual_vfov() -> f64 {
    60.0
}

impl ViewerPose {
    /// What is wrong with it, in a sentence; `None` where it can be flown.
    #[must_use]
    pub fn fault(&self) -> Option<String> {
        let limits = [
            ("x", self.x, 1e12),
            ("y", self.y, 1e12),
            ("z", self.z, 1e9),
            ("heading", self.heading, 1e6),
            ("pitch", self.pitch, 90.0),
            ("roll", self.roll, 1e6),
        ];
        let wrong = limits.into_iter().find(|(_, found, limit)| !found.is_finite() || found.abs() > *limit);
        let of_limits = wrong
            .map(|(name, found, limit)| format!("{name}: expected a number from -{limit} to {limit}, found {found}"));
        let is_vfov = (1.0..=170.0).contains(&self.vfov);
        of_limits.or_else(|| (!is_vfov).then(|| format!("vfov: expected a number from 1 to 170, found {}", self.vfov)))
    }
}

/// Poses as bytes, for another process of this machine.
#[must_use]
pub fn poses_to_bytes(poses: &[ViewerPose]) -> &[u8] {
    bytemuck::cast_slice(poses)
}

/// The poses in these bytes, of which nothing is known.
#[must_use]
pub fn poses_from_bytes(bytes: &[u8]) -> Vec<ViewerPose> {
    bytes.chunks_exact(size_of::<ViewerPose>()).map(bytemuck::pod_read_unaligned).collect()
}

/// What a viewer is told when it starts.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ViewerSetup {
    /// Name of the frame ring, and of the segment of poses.
    pub share: String,
    /// The world as it was typed.
    pub world: String,
    /// How its tiles are read.
    pub database: DatabaseConfig,
    /// Flags of the command line that a still has in common with the flight.
    pub still_flags: Vec<String>,
    /// Those of them that say how the database is read.
    pub database_flags: Vec<String>,
    /// The folder of all programs.
    pub programs: PathBuf,
    /// A folder for files of a moment, which the launcher removes in the end.
    pub scratch: PathBuf,
    /// Most bytes that films may take.
    pub film_bytes: u64,
    /// What every client has to know.
    pub token: Option<String>,
    /// Nobody may move the camera.
    pub is_read_only: bool,
    /// Origins whose pages may show the page in a frame.
    pub embedders: Vec<String>,
    /// Where the camera is when nobody has moved it.
    pub start: ViewerPose,
    /// What settings of `null` are.
    pub defaults: StreamSettings,
}

/// How the flight is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FlightState {
    /// It was started for the first time.
    Starting,
    /// Pictures come.
    Flying,
    /// It was started again: it died, or has new settings or another size.
    Restarting,
    /// It cannot be started; it is tried again now and then.
    Failed,
    /// Nobody has looked for a while: it is started again for the next one who does.
    Resting,
}

/// What the launcher tells of the flight.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FlightStatus {
    /// Number of the flight, from 1.
    pub number: u32,
    /// Its process; 0 while no flight runs.
    pub pid: u32,
    /// How it is.
    pub state: FlightState,
    /// Why, where it was not asked for.
    pub reason: Option<String>,
    /// Size of its pictures, pixels.
    pub size: [u32; 2],
    /// How it draws.
    pub settings: StreamSettings,
    /// Where its metrics are served.
    pub metrics: Option<SocketAddr>,
}

/// From the launcher to the viewer.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "kebab-case")]
pub enum ToViewer {
    /// The first line; [`ToViewer::Flight`] is the second.
    Setup(Box<ViewerSetup>),
    /// The flight has changed.
    Flight(FlightStatus),
    /// What was wished for cannot be flown: the flight goes on like this.
    GoesOn {
        /// Size of its pictures, pixels.
        size: [u32; 2],
        /// How it draws.
        settings: StreamSettings,
    },
    /// What the flight says.
    Notice {
        /// It is not as it should be.
        is_warning: bool,
        /// The sentence.
        text: String,
    },
}

/// From the viewer to the launcher.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "kebab-case")]
pub enum FromViewer {
    /// The first picture of the flight of this number has come.
    Flying {
        /// The number.
        number: u32,
    },
    /// Whether somebody looks.
    Audience {
        /// Somebody does.
        looks: bool,
    },
    /// The flight is to be flown like this.
    Fly {
        /// Size of its pictures, pixels.
        size: [u32; 2],
        /// How it draws.
        settings: Box<StreamSettings>,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose() -> ViewerPose {
        ViewerPose { x: 1.0, y: 2.0, z: 3.0, heading: 4.0, pitch: 5.0, roll: 6.0, vfov: 60.0 }
    }

    #[test]
    fn what_cannot_be_flown_is_told() {
        assert_eq!(pose().fault(), None);
        let pitch = ViewerPose { pitch: 91.0, ..pose() }.fault().unwrap();
        assert_eq!(pitch, "pitch: expected a number from -90 to 90, found 91");
        for wrong in [
            ViewerPose { x: f64::NAN, ..pose() },
            ViewerPose { z: f64::INFINITY, ..pose() },
            ViewerPose { vfov: 0.0, ..pose() },
            ViewerPose { vfov: f64::NAN, ..pose() },
        ] {
            assert!(wrong.fault().is_some(), "{wrong:?}");
        }
    }
}
