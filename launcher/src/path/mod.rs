//! Camera paths: where the camera is in every frame.
//!
//! A path comes from a JSON file with a pose per frame ([`json`]), a JSON file with poses at moments, a KML tour
//! ([`kml`]), a GPX track ([`gpx`]), or is the built-in [`orbit`]. All become a [`CameraPath`] in the world's own CRS.

pub mod crs;
mod datum;
pub mod gpx;
pub mod json;
pub mod kml;
pub mod orbit;
pub mod spline;

use crs::{CrsError, Georeference};
use glam::DVec3;
use spline::Spline;
use std::path::{Path, PathBuf};

/// Most frames that one path may have: 18 hours at 30 frames a second.
pub const MAX_FRAMES: u64 = 2_000_000;
/// Largest JSON path that is read, bytes.
const MAX_JSON_BYTES: u64 = 256 << 20;
/// Largest KML or GPX file that is read, bytes. Its tree in memory is several times larger.
const MAX_XML_BYTES: u64 = 64 << 20;
/// Most XML nodes that are read.
pub(crate) const MAX_XML_NODES: u32 = 4_000_000;

/// Where the camera is and looks. The position is easting, northing and height in the world's CRS, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Easting, northing, height, metres.
    pub position: DVec3,
    /// Radians clockwise from grid north.
    pub heading_rad: f64,
    /// Radians up from the horizontal.
    pub pitch_rad: f64,
    /// Radians clockwise.
    pub roll_rad: f64,
}

/// What a path file says about the picture; a flag on the command line wins over it.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct PathSettings {
    /// Width of the picture, pixels.
    pub width: Option<u32>,
    /// Height of the picture, pixels.
    pub height: Option<u32>,
    /// Vertical field of view, radians.
    pub vfov_rad: Option<f64>,
    /// Frames per second.
    pub fps: Option<f64>,
    /// Colour of the sky.
    pub sky_rgb: Option<[u8; 3]>,
}

/// Where the camera goes.
#[derive(Debug, Clone, PartialEq)]
pub enum Course {
    /// One pose per frame.
    Frames(Vec<Pose>),
    /// A round of poses, one per frame, that is flown again and again.
    Round(Vec<Pose>),
    /// Poses at moments, in pieces with cuts between them; each piece begins where the time of the one before ends.
    Timed(Vec<Spline>),
}

/// A camera path in the world's CRS.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraPath {
    /// What it says about the picture.
    pub settings: PathSettings,
    /// Where the camera goes.
    pub course: Course,
}

/// The terrain's height, exaggerated as it is drawn.
pub trait Ground {
    /// Height at a position in the world's CRS, metres; `None` outside the terrain.
    fn height_m(&self, x: f64, y: f64) -> Option<f64>;

    /// A height that the ground at a position is surely not above, where one is known without reading the ground.
    fn bound_m(&self, _x: f64, _y: f64) -> Option<f64> {
        None
    }
}

/// Why there is no camera path.
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
    /// The file is larger than any path.
    #[error("the camera path {} has {bytes} bytes, at most {limit} are read", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Its size.
        bytes: u64,
        /// The largest size that is read.
        limit: u64,
    },
    /// It is neither JSON nor KML nor GPX.
    #[error(
        "{} is no camera path: expected a JSON object, a KML tour or a GPX track, found {found} \
         (docs/camera-paths.md shows each)", path.display()
    )]
    UnknownFormat {
        /// The file.
        path: PathBuf,
        /// How it begins.
        found: String,
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
    #[error("the camera path {} is not valid XML: {source}", path.display())]
    Xml {
        /// The file.
        path: PathBuf,
        /// Where and why.
        #[source]
        source: roxmltree::Error,
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
    #[error("{} has nothing to fly: expected {expected}", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
        /// What was expected, in words.
        expected: &'static str,
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
    /// It has too many frames.
    #[error("the path has {frames} frames at {fps} frames a second, at most {MAX_FRAMES} are flown")]
    TooLong {
        /// Its frames.
        frames: f64,
        /// Frames per second.
        fps: f64,
    },
}

/// How a path that is given in time or along the ground is flown.
#[derive(Debug, Clone, Copy)]
pub struct CourseOptions {
    /// Height above ground of a GPX track, metres.
    pub agl_m: f64,
}

/// Reads a path file of any kind.
///
/// # Errors
/// [`PathError`], a sentence with the file and the place in it.
pub fn load(
    path: &Path,
    world: &Georeference,
    ground: &dyn Ground,
    options: CourseOptions,
) -> Result<CameraPath, PathError> {
    let read = |source| PathError::Read { path: path.to_owned(), source };
    let bytes = std::fs::metadata(path).map_err(read)?.len();
    if bytes > MAX_JSON_BYTES {
        return Err(PathError::TooLarge { path: path.to_owned(), bytes, limit: MAX_JSON_BYTES });
    }
    let text = std::fs::read(path).map_err(read)?;
    // Some editors of other systems put a byte order mark first; neither JSON nor the XML reader wants it.
    let text = text.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(&text);
    let Ok(text) = std::str::from_utf8(text) else {
        return Err(PathError::UnknownFormat { path: path.to_owned(), found: "bytes that are no UTF-8 text".into() });
    };
    parse(path, text, world, ground, options)
}

/// Reads the text of a path file; `path` is for messages.
///
/// # Errors
/// [`PathError`], a sentence with the file and the place in it.
pub fn parse(
    path: &Path,
    text: &str,
    world: &Georeference,
    ground: &dyn Ground,
    options: CourseOptions,
) -> Result<CameraPath, PathError> {
    let unknown = |found: String| PathError::UnknownFormat { path: path.to_owned(), found };
    match text.trim_start().chars().next() {
        Some('{') => json::parse(path, text, world),
        Some('<') => {
            if text.len() as u64 > MAX_XML_BYTES {
                let bytes = text.len() as u64;
                return Err(PathError::TooLarge { path: path.to_owned(), bytes, limit: MAX_XML_BYTES });
            }
            let parsing = roxmltree::ParsingOptions { nodes_limit: MAX_XML_NODES, ..Default::default() };
            let document = roxmltree::Document::parse_with_options(text, parsing)
                .map_err(|source| PathError::Xml { path: path.to_owned(), source })?;
            match document.root_element().tag_name().name() {
                "kml" => kml::parse(path, &document, world, ground),
                "gpx" => gpx::parse(path, &document, world, ground, options),
                other => Err(unknown(format!("XML of the kind <{}>", shorten(other)))),
            }
        }
        Some(_) if text.starts_with("PK") => {
            Err(unknown("a ZIP archive; unpack a KMZ file and fly its doc.kml".into()))
        }
        Some(_) => Err(unknown(format!("{:?}", shorten(text.trim_start())))),
        None => Err(unknown("an empty file".into())),
    }
}

/// The first characters of a text that came from outside, for a message.
pub(crate) fn shorten(text: &str) -> String {
    const MAX_CHARS: usize = 40;
    let mut short: String = text.chars().take(MAX_CHARS).collect();
    if short.len() < text.len() {
        short.push('…');
    }
    short
}

impl Course {
    /// Number of frames at `fps` frames per second, played `speed` times as fast; `None` for a course without end.
    ///
    /// # Errors
    /// [`PathError::TooLong`].
    pub fn frame_count(&self, fps: f64, speed: f64) -> Result<Option<u64>, PathError> {
        let frames = match self {
            Self::Round(_) => return Ok(None),
            Self::Frames(poses) => poses.len() as f64,
            Self::Timed(pieces) => {
                let seconds = pieces.last().map_or(0.0, Spline::end) - pieces.first().map_or(0.0, Spline::start);
                // The last moment is a frame too; the small term forgives a rounding error just below it.
                (seconds * fps / speed + 1e-6).floor() + 1.0
            }
        };
        if frames > MAX_FRAMES as f64 {
            return Err(PathError::TooLong { frames, fps });
        }
        Ok(Some(frames as u64))
    }

    /// The pose of a frame below [`Course::frame_count`]; a function of the frame's number alone, so that any part of
    /// a flight is the same as in the whole.
    #[must_use]
    pub fn pose(&self, frame: u64, fps: f64, speed: f64) -> Option<Pose> {
        match self {
            Self::Frames(poses) => poses.get(usize::try_from(frame).ok()?).copied(),
            Self::Round(poses) => poses.get(usize::try_from(frame.checked_rem(poses.len() as u64)?).ok()?).copied(),
            Self::Timed(pieces) => {
                let t = pieces.first()?.start() + frame as f64 * speed / fps;
                let piece = pieces.iter().rev().find(|piece| piece.start() <= t).or(pieces.first())?;
                Some(piece.pose(t))
            }
        }
    }

    /// Whether the number of frames depends on the frames per second.
    #[must_use]
    pub fn is_timed(&self) -> bool {
        matches!(self, Self::Timed(_))
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A plain at 100 m.
    #[derive(Debug)]
    pub(crate) struct Plain;

    impl Ground for Plain {
        fn height_m(&self, _x: f64, _y: f64) -> Option<f64> {
            Some(100.0)
        }
    }

    pub(crate) fn utm10() -> Georeference {
        Georeference::new("WGS 84 / UTM zone 10N".into(), Some(32610), None)
    }

    pub(crate) fn parse_text(text: &str) -> Result<CameraPath, PathError> {
        parse(Path::new("p"), text, &utm10(), &Plain, CourseOptions { agl_m: 150.0 })
    }

    #[test]
    fn what_is_no_path_is_named() {
        for (text, expected) in [
            ("", "an empty file"),
            ("hello", "hello"),
            ("PK\x03\x04", "unpack a KMZ"),
            ("<svg/>", "<svg>"),
            ("<kml", "not valid XML"),
            ("{", "not valid JSON"),
            ("[]", "expected a JSON object"),
        ] {
            let message = parse_text(text).unwrap_err().to_string();
            assert!(message.contains(expected) && !message.contains('\n'), "{text}: {message}");
        }
    }

    #[test]
    fn entities_cannot_read_files_or_explode() {
        let text = "<!DOCTYPE kml [<!ENTITY x SYSTEM \"file:///etc/passwd\">]><kml>&x;</kml>";
        assert!(parse_text(text).unwrap_err().to_string().contains("not valid XML"));
    }

    #[test]
    fn a_round_is_flown_again_and_again() {
        let pose = |x| Pose { position: DVec3::new(x, 0.0, 0.0), heading_rad: 0.0, pitch_rad: 0.0, roll_rad: 0.0 };
        let course = Course::Round(vec![pose(0.0), pose(1.0), pose(2.0)]);
        assert_eq!(course.frame_count(30.0, 1.0).unwrap(), None);
        assert_eq!(course.pose(4, 30.0, 1.0), Some(pose(1.0)));
    }

    proptest! {
        #[test]
        fn garbage_never_panics(text in "[<{]\\PC{0,200}") {
            drop(parse_text(&text));
        }

        #[test]
        fn bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            drop(parse_text(&String::from_utf8_lossy(&bytes)));
        }
    }
}
