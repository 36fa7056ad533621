//! What the launcher (`terravision serve`) and the viewer tell each other: one JSON object a line,
//! over a socket pair that is the viewer's standard output. Its standard input is the listening
//! socket, which the launcher keeps: a viewer that died is replaced on the same port.

use crate::run::DatabaseConfig;
use serde::{Deserialize, Serialize};
use std::net::SocketAddr;
use std::path::PathBuf;

/// Longest line of this conversation.
pub const MOST_LINE_BYTES: u64 = 1 << 20;
/// Smallest and largest side of the stream's pictures, pixels.
pub const SIDES_PX: [u32; 2] = [64, 4096];

/// A pose as people type it: degrees, metres, the world's CRS.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
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

/// How the flight draws, where it is not left to TerraVision.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct StreamSettings {
    /// `--facet-px`.
    pub facet_px: Option<f64>,
    /// `--texel-px`.
    pub texel_px: Option<f64>,
    /// `--fps`.
    pub fps: Option<f64>,
    /// `--technique`; "auto" or `None` for the usual one.
    pub technique: Option<String>,
    /// `--exaggeration`.
    pub exaggeration: Option<f64>,
    /// `--overlay`; "none" or `None` for none.
    pub overlay: Option<String>,
}

impl StreamSettings {
    /// What is wrong with them, in a sentence; `None` where a flight can be started with them.
    #[must_use]
    pub fn fault(&self) -> Option<String> {
        let numbers = [
            ("facet_px", self.facet_px, [0.5, 100.0]),
            ("texel_px", self.texel_px, [0.25, 32.0]),
            ("fps", self.fps, [1.0, 60.0]),
            ("exaggeration", self.exaggeration, [0.0, 100.0]),
        ];
        let number = numbers.into_iter().find_map(|(name, value, [low, high])| {
            let found = value.filter(|value| !(low..=high).contains(value))?;
            Some(format!("{name}: expected a number from {low} to {high}, found {found}"))
        });
        let words = [
            ("technique", &self.technique, &["auto", "mesh", "rays"][..]),
            ("overlay", &self.overlay, &["none", "tree"][..]),
        ];
        number.or_else(|| {
            words.into_iter().find_map(|(name, value, known)| {
                let found = value.as_ref().filter(|value| !known.contains(&value.as_str()))?;
                Some(format!("{name}: expected one of {}, found {found:?}", known.join(", ")))
            })
        })
    }

    /// Their flags of the command line: with `fps`, those of a flight.
    #[must_use]
    pub fn flags(&self) -> Vec<String> {
        let mut flags = self.picture_flags();
        let finest = [("--facet-px", self.facet_px), ("--texel-px", self.texel_px), ("--fps", self.fps)];
        for (flag, value) in finest {
            flags.extend(value.into_iter().flat_map(|value| [flag.to_owned(), value.to_string()]));
        }
        flags
    }

    /// The flags of what the finest picture shows, too.
    #[must_use]
    pub fn picture_flags(&self) -> Vec<String> {
        let technique = self.technique.clone().filter(|technique| technique != "auto");
        let overlay = self.overlay.clone().filter(|overlay| overlay != "none");
        let exaggeration = self.exaggeration.map(|factor| factor.to_string());
        let all = [("--technique", technique), ("--exaggeration", exaggeration), ("--overlay", overlay)];
        all.into_iter().flat_map(|(flag, value)| value.map(|value| [flag.to_owned(), value])).flatten().collect()
    }
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
    /// The folder of all programs.
    pub programs: PathBuf,
    /// A folder for files of a moment, which the launcher removes in the end.
    pub scratch: PathBuf,
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
}

/// What the launcher tells of the flight.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FlightNews {
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
    /// The first line.
    Setup(Box<ViewerSetup>),
    /// The flight has changed.
    Flight(FlightNews),
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
    /// The flight is to be flown like this.
    Fly {
        /// Size of its pictures, pixels.
        size: [u32; 2],
        /// How it draws.
        settings: StreamSettings,
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

    #[test]
    fn settings_are_checked_and_become_flags() {
        let settings = StreamSettings { facet_px: Some(4.0), technique: Some("mesh".into()), ..Default::default() };
        assert_eq!(settings.fault(), None);
        assert_eq!(settings.flags(), ["--technique", "mesh", "--facet-px", "4"]);
        assert_eq!(settings.picture_flags(), ["--technique", "mesh"]);
        for wrong in [
            StreamSettings { fps: Some(f64::NAN), ..Default::default() },
            StreamSettings { facet_px: Some(0.0), ..Default::default() },
            StreamSettings { technique: Some("--output".into()), ..Default::default() },
            StreamSettings { overlay: Some("x".into()), ..Default::default() },
        ] {
            assert!(wrong.fault().is_some(), "{wrong:?}");
        }
    }
}
