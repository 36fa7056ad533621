//! Camera paths: where the camera is in every frame.
//!
//! A path comes from a JSON file with a pose per frame ([`json`]), a JSON file with poses at
//! moments, a KML file ([`kml`]: a tour, views, a track or a line), a GPX track ([`gpx`]), a CZML
//! document ([`czml`]), the lines or points of a GeoJSON file ([`geojson`]), or is the built-in
//! [`orbit`]. All become a [`CameraPath`] in the world's own CRS.

pub mod crs;
mod czml;
mod datum;
mod ecef;
mod error;
mod file;
mod geojson;
pub mod gpx;
pub mod json;
pub mod kml;
pub mod orbit;
mod raw_json;
mod recording;
pub mod spline;
mod text;
pub(crate) mod times;
mod track;
pub mod vehicles;
mod xml;
mod zip;

pub use error::PathError;

use crs::Georeference;
use glam::DVec3;
use spline::Spline;
use std::path::Path;

/// Most frames that one path may have: 18 hours at 30 frames a second.
pub const MAX_FRAMES: u64 = 2_000_000;
/// Largest JSON path that is read, bytes.
const MAX_JSON_BYTES: u64 = 256 << 20;
/// Largest KML or GPX text that is read, bytes, unpacked.
const MAX_XML_BYTES: u64 = 128 << 20;
/// Roots of KML: some programs leave out the `kml` around it.
const KML_ROOTS: [&str; 5] = ["kml", "Document", "Folder", "Placemark", "Tour"];
/// What is said where heights by their format are above the ellipsoid.
const ELLIPSOIDAL: &str = "its heights are, by the file's format, above the ellipsoid; they are flown unchanged, as heights \
                           in the world's vertical datum (where that is sea level, up to 107 m off)";
/// All roots that are read.
const ROOTS: [&str; 6] = ["gpx", "kml", "Document", "Folder", "Placemark", "Tour"];

/// Where the camera is and looks. The position is easting, northing and height in the world's CRS,
/// metres.
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
    /// Horizontal field of view, radians, where the path gives that one; the vertical one wins over
    /// it.
    pub hfov_rad: Option<f64>,
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
    /// Poses at moments, in pieces with cuts between them; each piece begins where the time of the
    /// one before ends.
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

    /// Whether there is ground at a position that was measured, not made up.
    fn is_measured(&self, x: f64, y: f64) -> bool {
        self.height_m(x, y).is_some()
    }

    /// A height that the ground at a position is surely not above, where one is known without
    /// reading the ground.
    fn bound_m(&self, _x: f64, _y: f64) -> Option<f64> {
        None
    }
}

/// How a path that is given in time or along the ground is flown.
#[derive(Debug, Clone, Copy, Default)]
pub struct CourseOptions {
    /// Height above ground of a track, metres; none for the way's own heights, where it has them,
    /// else for 150 m.
    pub agl_m: Option<f64>,
    /// Whether rests within a segment of a track are flown in full.
    pub keeps_rests: bool,
}

/// What is to be said about a path that can be flown.
#[derive(Debug, Default, Clone, PartialEq, Eq)]
pub struct Remarks {
    /// What is good to know, a sentence each.
    pub notes: Vec<String>,
    /// What may not be as meant, a sentence each.
    pub warnings: Vec<String>,
}

impl PathSettings {
    /// Vertical field of view of a picture of this size, radians, if the path says one.
    #[must_use]
    pub fn vfov_of(&self, width: u32, height: u32) -> Option<f64> {
        let of_horizontal = |hfov: f64| 2.0 * ((hfov / 2.0).tan() * f64::from(height) / f64::from(width)).atan();
        self.vfov_rad.or(self.hfov_rad.map(of_horizontal))
    }
}

/// Reads a path file of any kind; what is to be said about it goes into `remarks`.
///
/// # Errors
/// [`PathError`], a sentence with the file and the place in it.
pub fn load(
    path: &Path,
    world: &Georeference,
    ground: &dyn Ground,
    options: CourseOptions,
    remarks: &mut Remarks,
) -> Result<CameraPath, PathError> {
    let source = file::read(path)?;
    remarks.notes.extend(source.note);
    parse(&source.path, &source.text, world, ground, options, remarks)
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
    remarks: &mut Remarks,
) -> Result<CameraPath, PathError> {
    match text.trim_start().chars().next() {
        Some('[') => czml::parse(path, text, world, ground, options, remarks),
        Some('{') if geojson::is_geojson(text) => geojson::parse(path, text, world, ground, options, remarks),
        Some('{') => {
            if options.agl_m.is_some() {
                return Err(PathError::HasHeights { path: path.to_owned(), kind: "poses" });
            }
            json::parse(path, text, world)
        }
        Some('<') => {
            if text.len() as u64 > MAX_XML_BYTES {
                return Err(PathError::TooLarge { path: path.to_owned(), limit: MAX_XML_BYTES });
            }
            let document = xml::Document::parse(path, text, &ROOTS)?;
            if KML_ROOTS.contains(&document.root().name()) {
                kml::parse(path, &document, world, ground, options, remarks)
            } else {
                gpx::parse(path, &document, world, ground, options, remarks)
            }
        }
        _ => Err(PathError::UnknownFormat { path: path.to_owned(), found: what_is(text) }),
    }
}

/// A text that is neither JSON nor XML, and what to do.
fn what_is(text: &str) -> String {
    let start = text.trim_start();
    let is_binary =
        text.chars().take(400).any(|c| c == char::REPLACEMENT_CHARACTER || (c.is_control() && !c.is_whitespace()));
    match start.chars().next() {
        None => "an empty file".into(),
        _ if is_binary => "bytes that are not text".into(),
        Some('$') => "NMEA sentences; gpsbabel -i nmea -f FILE -o gpx -F FILE.gpx makes a GPX of them".into(),
        Some('A') if start.lines().any(|line| line.starts_with("HFDTE")) => {
            "an IGC recording; gpsbabel -i igc -f FILE -o gpx -F FILE.gpx makes a GPX of it".into()
        }
        Some(_) => format!("\"{}\"", printable(start)),
    }
}

/// The first characters of a text that came from outside, as they may go to a terminal.
pub(crate) fn printable(text: &str) -> String {
    let short = shorten(text);
    short.chars().fold(String::with_capacity(short.len()), |mut out, c| {
        if c.is_control() {
            out.extend(c.escape_default())
        } else {
            out.push(c)
        }
        out
    })
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
    /// Number of frames at `fps` frames per second, played `speed` times as fast; `None` for a
    /// course without end.
    ///
    /// # Errors
    /// [`PathError::TooLong`].
    pub fn frame_count(&self, fps: f64, speed: f64) -> Result<Option<u64>, PathError> {
        let frames = match self {
            Self::Round(_) => return Ok(None),
            Self::Frames(poses) => poses.len() as f64,
            Self::Timed(pieces) => {
                let seconds = pieces.last().map_or(0.0, Spline::end) - pieces.first().map_or(0.0, Spline::start);
                // The last moment is a frame too; the small term forgives a rounding error just
                // below it.
                (seconds * fps / speed + 1e-6).floor() + 1.0
            }
        };
        if frames > MAX_FRAMES as f64 {
            // Rounded up to two digits, so that it surely suffices.
            let least = frames * speed / MAX_FRAMES as f64;
            let digit = 10f64.powf(least.log10().floor() - 1.0);
            let enough = ((least / digit).ceil() * digit * 1e6).round() / 1e6;
            return Err(PathError::TooLong { frames, fps, hours: frames / fps * speed / 3600.0, speed: enough });
        }
        Ok(Some(frames as u64))
    }

    /// The pose of a frame below [`Course::frame_count`]; a function of the frame's number alone,
    /// so that any part of a flight is the same as in the whole.
    #[must_use]
    pub fn pose(&self, frame: u64, fps: f64, speed: f64) -> Option<Pose> {
        match self {
            Self::Frames(poses) => poses.get(usize::try_from(frame).ok()?).copied(),
            Self::Round(poses) => poses.get(usize::try_from(frame.checked_rem(poses.len() as u64)?).ok()?).copied(),
            Self::Timed(pieces) => {
                let t = pieces.first()?.start() + frame as f64 * speed / fps;
                let after = pieces.partition_point(|piece| piece.start() <= t);
                let piece = pieces.get(after.saturating_sub(1))?;
                Some(piece.pose(t))
            }
        }
    }

    /// Frames of one round of a course without end; 0 for others.
    #[must_use]
    pub fn round_frames(&self) -> u64 {
        match self {
            Self::Round(poses) => poses.len() as u64,
            Self::Frames(_) | Self::Timed(_) => 0,
        }
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
        parse_with(text, CourseOptions::default()).0
    }

    pub(crate) fn parse_with(text: &str, options: CourseOptions) -> (Result<CameraPath, PathError>, Remarks) {
        let mut remarks = Remarks::default();
        let path = parse(Path::new("p"), text, &utm10(), &Plain, options, &mut remarks);
        (path, remarks)
    }

    #[test]
    fn what_is_no_path_is_named_with_what_to_do() {
        for (text, expected) in [
            ("", "an empty file"),
            (" \n", "an empty file"),
            ("hello", "found \"hello\""),
            ("\u{fffd}PNG\r\n\u{1a}\n", "bytes that are not text"),
            ("<svg/>", "<svg>"),
            ("<kml", "not valid XML"),
            ("{", "not valid JSON"),
            ("[]", "found no packets but the document's"),
            ("[", "not valid JSON"),
            ("$GPGGA,1", "gpsbabel -i nmea"),
            ("AXXX\nHFDTE010524\n", "gpsbabel -i igc"),
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
    fn a_path_that_is_too_long_says_how_fast_it_is_short_enough() {
        let text = r#"{"keyframes":[{"t":0,"x":0,"y":0,"z":0,"heading":0,"pitch":0},{"t":200000,"x":1,"y":0,"z":0,"heading":0,"pitch":0}]}"#;
        let course = parse_text(text).unwrap().course;
        let PathError::TooLong { speed, hours, .. } = course.frame_count(30.0, 1.0).unwrap_err() else { panic!() };
        assert!(course.frame_count(30.0, speed).is_ok() && course.frame_count(30.0, 0.95 * speed).is_err(), "{speed}");
        assert!((hours - 55.6).abs() < 0.1);
        let message = course.frame_count(30.0, 1.0).unwrap_err().to_string();
        assert!(message.contains("6000001 frames") && message.contains("--speed 3.1 makes"), "{message}");
    }

    #[test]
    fn a_compressed_kmz_is_flown_as_its_kml() {
        let view = |lon: f64| {
            format!(
                "<gx:FlyTo><gx:duration>2</gx:duration><Camera><longitude>{lon}</longitude><latitude>45</latitude></Camera></gx:FlyTo>"
            )
        };
        let text = format!("<kml><gx:Tour><gx:Playlist>{}{}</gx:Playlist></gx:Tour></kml>", view(-122.0), view(-121.9));
        let path = std::env::temp_dir().join(format!("tv-path-{}.kmz", std::process::id()));
        let utf16: Vec<u8> = format!("\u{feff}{text}").encode_utf16().flat_map(u16::to_le_bytes).collect();
        for doc in [text.as_bytes(), &utf16] {
            std::fs::write(&path, zip::tests::archive(&[("files/a.png", &[0; 999]), ("doc.kml", doc)])).unwrap();
            let mut remarks = Remarks::default();
            let flown = load(&path, &utm10(), &Plain, CourseOptions::default(), &mut remarks).unwrap();
            assert_eq!((flown, remarks), (parse_text(&text).unwrap(), Remarks::default()));
        }
        // Messages name the file in the archive.
        std::fs::write(&path, zip::tests::archive(&[("tour.kml", b"<kml>\n<a></kml>")])).unwrap();
        let error = load(&path, &utm10(), &Plain, CourseOptions::default(), &mut Remarks::default()).unwrap_err();
        assert!(error.to_string().contains(".kmz/tour.kml is not valid XML: line 2: expected </a>"), "{error}");
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn cuts_are_found_by_their_time() {
        let pose = |x| Pose { position: DVec3::new(x, 0.0, 0.0), heading_rad: 0.0, pitch_rad: 0.0, roll_rad: 0.0 };
        let piece = |i: usize| {
            let keys = [0.0, 1.0].map(|t| spline::Key::passing(i as f64 + t, pose(10.0 * i as f64 + t)));
            Spline::new(&keys).unwrap()
        };
        let course = Course::Timed((0..5).map(piece).collect());
        let xs: Vec<f64> = (0..=10).map(|frame| course.pose(frame, 2.0, 1.0).unwrap().position.x).collect();
        assert_eq!(xs, [0.0, 0.5, 10.0, 10.5, 20.0, 20.5, 30.0, 30.5, 40.0, 40.5, 41.0]);
    }

    #[test]
    fn a_horizontal_field_of_view_becomes_a_vertical_one_by_the_picture() {
        let settings = PathSettings { hfov_rad: Some(1.0), ..PathSettings::default() };
        let vfov = settings.vfov_of(1280, 720).unwrap();
        assert!(((vfov / 2.0).tan() * 1280.0 / 720.0 - 0.5f64.tan()).abs() < 1e-12);
        assert!((settings.vfov_of(500, 500).unwrap() - 1.0).abs() < 1e-12);
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
