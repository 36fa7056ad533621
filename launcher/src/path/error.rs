//! Why a camera path cannot be flown.

use super::MAX_FRAMES;
use super::crs::CrsError;
use std::path::PathBuf;

/// Why a camera path cannot be flown.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PathError {
    /// The file cannot be read.
    #[error("cannot read the camera path {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        #[source]
        source: std::io::Error,
    },
    /// It is a folder, a pipe or a device: reading it might never end.
    #[error("the camera path {} is {kind}: expected a file; write the path into a file and name that", path.display())]
    NotAFile {
        /// What was named.
        path: PathBuf,
        /// What it is, in words.
        kind: &'static str,
    },
    /// The file is larger than any path.
    #[error(
        "the camera path {} has more than {} MiB, the most that is read: cut it into several paths, or leave out what \
         is not flown", path.display(), limit >> 20
    )]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// The largest size that is read, bytes.
        limit: u64,
    },
    /// It is neither JSON nor XML.
    #[error(
        "{} is not a camera path: expected JSON (poses, CZML or GeoJSON), a KML file (or KMZ) or a GPX track, \
         found {found} (docs/camera-paths.md shows each)", path.display()
    )]
    UnknownFormat {
        /// The file.
        path: PathBuf,
        /// How it begins.
        found: String,
    },
    /// The archive cannot be unpacked.
    #[error("the camera path {} cannot be unpacked: {reason}", path.display())]
    Archive {
        /// The file.
        path: PathBuf,
        /// Why, in words.
        reason: String,
    },
    /// The JSON is malformed.
    #[error("the camera path {} is not valid JSON: {source}", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// Where and why.
        #[source]
        source: serde_json::Error,
    },
    /// The XML is malformed.
    #[error("the camera path {} is not valid XML: line {line}: {reason}", path.display())]
    Xml {
        /// The file.
        path: PathBuf,
        /// Where.
        line: u32,
        /// Why, in words.
        reason: String,
    },
    /// One value is not what it has to be.
    #[error("{}: {place}: {key}: expected {expected}, found {found}", path.display())]
    BadValue {
        /// The file.
        path: PathBuf,
        /// Where in the file, e.g. "frame 3" or "line 12".
        place: String,
        /// Name of the value.
        key: String,
        /// What was expected, in words.
        expected: &'static str,
        /// What was found.
        found: String,
    },
    /// There is nothing to fly in it.
    #[error("{} has nothing to fly: expected {expected}, found {found}", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
        /// What was expected, in words.
        expected: &'static str,
        /// What is there instead, and what to do.
        found: String,
    },
    /// There is no vehicle in it, or too many.
    #[error(
        "{} has no vehicles that can be drawn: expected CZML with packets that have a position, or GeoJSON with lines or \
         points that have times, found {found} (docs/vehicles.md)", path.display()
    )]
    NoVehicles {
        /// The file.
        path: PathBuf,
        /// What is there instead.
        found: String,
    },
    /// `--agl` was given for a path that says itself how high it is flown.
    #[error(
        "--agl is the height above ground of a track, and {} ({kind}) has heights of its own: leave --agl out",
        path.display()
    )]
    HasHeights {
        /// The file.
        path: PathBuf,
        /// What it is, in words.
        kind: &'static str,
    },
    /// Its coordinates cannot be brought into the world's CRS.
    #[error("{}: {place}: {source}", path.display())]
    Crs {
        /// The file.
        path: PathBuf,
        /// Where in the file.
        place: String,
        /// Why.
        #[source]
        source: Box<CrsError>,
    },
    /// A path that is given in time has too many frames.
    #[error(
        "the path has {frames:.0} frames at {fps} frames a second, at most {MAX_FRAMES} are flown: it lasts {hours:.1} \
         hours, so --speed {speed} makes it short enough (or a smaller --fps)"
    )]
    TooLong {
        /// Its frames.
        frames: f64,
        /// Frames per second.
        fps: f64,
        /// How long it lasts in its own time.
        hours: f64,
        /// A speed at which it is short enough.
        speed: f64,
    },
}
