//! `frames.json` and `transforms.json`.
//!
//! One frame a line. What earlier flights have listed is kept as the text that it is, so that
//! numbers do not change when frames are added.

use super::FlownFrame;
use super::geometry::{Rows4, camera_to_world, eye_in_crs, intrinsics, with_opengl_axes, world_to_camera};
use serde::{Deserialize, Serialize};
use serde_json::json;
use serde_json::value::{RawValue, to_raw_value};
use std::collections::BTreeMap;
use std::fs;
use std::io::{self, Write};
use std::path::Path;
use terravision_common::camera::Camera;

/// The schema of `frames.json`; keys are only ever added to it.
const SCHEMA: &str = "terravision-frames-1";
/// Largest listing that is read, bytes: half a million frames.
const MAX_BYTES: u64 = 1 << 30;
/// `crs_offset` is a multiple of this, metres.
const OFFSET_STEP_M: f64 = 1000.0;

const CONVENTION: &str = "Camera space is x right, y down, z forward, metres. World is easting, northing, height * exaggeration, \
    metres in the CRS. (x, y, z, 1) = world_to_camera * (easting, northing, height * exaggeration, 1); depth = z; \
    pixel = (K * (x, y, z)) / z, from the upper left corner of the picture: the centre of the pixel in column i and row j, both \
    from 0, is (i + 0.5, j + 0.5). Matrices are lists of rows. Heading, pitch, roll and vfov are degrees: heading clockwise from \
    grid north, then pitch up, then roll clockwise. depth: float32 metres along the view axis; ground: float64 easting, northing, \
    height without exaggeration; NaN for sky.";
const TRANSFORMS_CONVENTION: &str = "transform_matrix: camera to world; camera axes of OpenGL (x right, y up, z backwards); world is \
    x east, y north, z up, metres. Add crs_offset to get easting, northing and height * exaggeration in the CRS: \
    those do not fit float32. Depth files are float32 metres along the view axis, NaN for sky: \
    for nerfstudio --depth-unit-scale-factor 1.";

/// What the frames of a data set have in common.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Head {
    schema: &'static str,
    /// CRS as camera paths name it.
    #[serde(skip_serializing_if = "Option::is_none")]
    crs: Option<String>,
    crs_name: String,
    /// Width of all pictures, pixels.
    width: u32,
    /// Height of all pictures, pixels.
    height: u32,
    vfov_deg: f64,
    /// Frames per second.
    fps: f64,
    /// Factor on the terrain's heights.
    exaggeration: f64,
    convention: &'static str,
}

impl Head {
    /// Of pictures of this size. `crs`: `EPSG:N` or a PROJ string, if it has one.
    #[must_use]
    pub fn new(crs: Option<String>, crs_name: String, size: [u32; 2], fps: f64, exaggeration: f64) -> Self {
        let [width, height] = size;
        let (schema, convention, vfov_deg) = (SCHEMA, CONVENTION, 0.0);
        Self { schema, crs, crs_name, width, height, vfov_deg, fps, exaggeration, convention }
    }

    /// With the field of view of the first camera; each frame has its own beside.
    #[must_use]
    pub fn with_vfov(mut self, camera: Option<&Camera>) -> Self {
        self.vfov_deg = camera.map_or(self.vfov_deg, |camera| degrees(camera.vfov_rad()));
        self
    }
}

/// A frame of `frames.json`. Its position and angles are those of a camera path, so that the
/// listing can be flown again.
#[derive(Debug, Serialize)]
pub struct Entry {
    frame: u64,
    time_s: f64,
    x: f64,
    y: f64,
    z: f64,
    heading: f64,
    pitch: f64,
    roll: f64,
    vfov: f64,
    #[serde(rename = "K")]
    k: [[f64; 3]; 3],
    world_to_camera: Rows4,
    camera_to_world: Rows4,
    #[serde(skip_serializing_if = "Option::is_none")]
    color: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    depth: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ground: Option<String>,
}

impl Entry {
    /// Of a frame; `file` names its files by key.
    pub fn new(flown: &FlownFrame, origin: [f64; 2], file: impl Fn(&str) -> Option<String>) -> Self {
        let camera = &flown.camera;
        let eye = eye_in_crs(camera, origin);
        Self {
            frame: flown.frame.get(),
            time_s: flown.time_s,
            x: eye.x,
            y: eye.y,
            z: eye.z,
            heading: degrees(camera.heading_rad()),
            pitch: degrees(camera.pitch_rad()),
            roll: degrees(camera.roll_rad()),
            vfov: degrees(camera.vfov_rad()),
            k: intrinsics(camera),
            world_to_camera: world_to_camera(camera, origin),
            camera_to_world: camera_to_world(camera, origin),
            color: file("color"),
            depth: file("depth"),
            ground: file("ground"),
        }
    }
}

/// Degrees without the noise of the last bits: 90, not 90.00000000000001.
fn degrees(radians: f64) -> f64 {
    (radians.to_degrees() * 1e10).round() / 1e10
}

/// A listing as it is read back.
#[derive(Deserialize)]
struct Before<'a> {
    #[serde(borrow)]
    schema: &'a RawValue,
    #[serde(borrow, default)]
    crs: Option<&'a RawValue>,
    #[serde(borrow)]
    crs_name: &'a RawValue,
    #[serde(borrow)]
    width: &'a RawValue,
    #[serde(borrow)]
    height: &'a RawValue,
    #[serde(borrow)]
    fps: &'a RawValue,
    #[serde(borrow)]
    exaggeration: &'a RawValue,
    frames: Vec<Box<RawValue>>,
}

impl Before<'_> {
    /// Whether its frames go with those of this head.
    fn is_of(&self, head: &Head) -> bool {
        let text = |value: serde_json::Result<Box<RawValue>>| value.map(|raw| raw.get().to_owned()).ok();
        let is = |found: &RawValue, own| text(own).as_deref() == Some(found.get());
        is(self.schema, to_raw_value(head.schema))
            && self.crs.map(|raw| raw.get().to_owned()) == head.crs.as_ref().and_then(|crs| text(to_raw_value(crs)))
            && is(self.crs_name, to_raw_value(&head.crs_name))
            && is(self.width, to_raw_value(&head.width))
            && is(self.height, to_raw_value(&head.height))
            && is(self.fps, to_raw_value(&head.fps))
            && is(self.exaggeration, to_raw_value(&head.exaggeration))
    }
}

/// What has to be known of a listed frame.
#[derive(Deserialize)]
struct Known {
    frame: u64,
    #[serde(rename = "K")]
    k: [[Box<RawValue>; 3]; 3],
    camera_to_world: [[Box<RawValue>; 4]; 4],
    color: Option<String>,
    depth: Option<String>,
    ground: Option<String>,
}

impl Known {
    fn files(&self) -> impl Iterator<Item = &String> {
        [&self.color, &self.depth, &self.ground].into_iter().flatten()
    }
}

/// The number that a text is, to the last bit.
fn number(raw: &RawValue) -> io::Result<f64> {
    raw.get()
        .parse()
        .map_err(|error| io::Error::new(io::ErrorKind::InvalidData, format!("{} is not a number: {error}", raw.get())))
}

/// Frames by number, each as its text.
#[derive(Debug)]
pub struct Listing {
    head: Head,
    frames: BTreeMap<u64, Box<RawValue>>,
}

impl Listing {
    /// The listing that is there, as far as its frames go with `head` and their files, named from
    /// `folder`, are still there; and how many frames did not go with it. An empty one where there
    /// is not a file, or not a listing.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn read(path: &Path, head: Head, folder: &Path) -> io::Result<(Self, usize)> {
        let mut listing = Self { head, frames: BTreeMap::new() };
        match fs::metadata(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok((listing, 0)),
            Ok(found) if found.len() > MAX_BYTES => {
                let text = format!("it has {} bytes, at most {MAX_BYTES} are read", found.len());
                return Err(io::Error::new(io::ErrorKind::InvalidData, text));
            }
            Err(error) => return Err(error),
            Ok(_) => {}
        }
        let text = String::from_utf8_lossy(&fs::read(path)?).into_owned();
        let Ok(before) = serde_json::from_str::<Before<'_>>(&text) else { return Ok((listing, 0)) };
        if !before.is_of(&listing.head) {
            return Ok((listing, before.frames.len()));
        }
        for frame in before.frames {
            if let Ok(known) = serde_json::from_str::<Known>(frame.get())
                && known.files().all(|file| folder.join(file).is_file())
            {
                listing.frames.insert(known.frame, frame);
            }
        }
        Ok((listing, 0))
    }

    /// Number of frames.
    #[must_use]
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// Whether it is empty.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// Lists a frame, in place of what was listed under its number.
    ///
    /// # Errors
    /// A number is not finite.
    pub fn put(&mut self, frame: u64, entry: Entry) -> io::Result<()> {
        self.frames.insert(frame, to_raw_value(&entry)?);
        Ok(())
    }

    /// Writes `frames.json`.
    ///
    /// # Errors
    /// The writer's.
    pub fn write(&self, writer: &mut impl Write) -> io::Result<()> {
        write_lines(
            writer,
            &serde_json::to_string(&self.head)?,
            self.frames.values().map(|raw| Ok(raw.get().to_owned())),
        )
    }

    /// Writes `transforms.json`, of the frames that have a picture.
    ///
    /// # Errors
    /// The writer's, or a listed frame is not as it was written.
    pub fn write_transforms(&self, writer: &mut impl Write) -> io::Result<()> {
        let frames: Result<Vec<Known>, _> = self.frames.values().map(|raw| serde_json::from_str(raw.get())).collect();
        let frames: Vec<Known> = frames?.into_iter().filter(|known| known.color.is_some()).collect();
        let mut views = Vec::with_capacity(frames.len());
        for known in &frames {
            views.push((numbers(&known.k)?, numbers(&known.camera_to_world)?));
        }
        let first = views.first().map_or([0.0; 2], |(_, matrix)| [matrix[0][3], matrix[1][3]]);
        let [east, north] = first.map(|at| (at / OFFSET_STEP_M).round() * OFFSET_STEP_M);
        // Where all frames have one camera, it stands once.
        let shared = views.first().map(|(k, _)| *k).filter(|first| views.iter().all(|(k, _)| k == first));
        let mut head = json!({
            "camera_model": "OPENCV", "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0,
            "w": self.head.width, "h": self.head.height,
            "crs_offset": [east, north, 0.0], "crs": self.head.crs, "exaggeration": self.head.exaggeration,
            "convention": TRANSFORMS_CONVENTION,
        });
        if let Some(k) = shared {
            add_intrinsics(&mut head, &k);
        }
        let lines = frames.iter().zip(&views).map(|(known, (k, matrix))| {
            let mut matrix = with_opengl_axes(*matrix);
            matrix[0][3] -= east;
            matrix[1][3] -= north;
            let mut line = json!({"file_path": known.color, "transform_matrix": matrix});
            if let Some(depth) = &known.depth {
                line["depth_file_path"] = json!(depth);
            }
            if shared.is_none() {
                add_intrinsics(&mut line, k);
            }
            Ok(line.to_string())
        });
        write_lines(writer, &head.to_string(), lines)
    }
}

fn numbers<const N: usize>(rows: &[[Box<RawValue>; N]; N]) -> io::Result<[[f64; N]; N]> {
    let mut out = [[0.0; N]; N];
    for (to, from) in out.iter_mut().flatten().zip(rows.iter().flatten()) {
        *to = number(from)?;
    }
    Ok(out)
}

fn add_intrinsics(to: &mut serde_json::Value, k: &[[f64; 3]; 3]) {
    for (key, value) in [("fl_x", k[0][0]), ("fl_y", k[1][1]), ("cx", k[0][2]), ("cy", k[1][2])] {
        to[key] = json!(value);
    }
}

/// A JSON object with one more member, `frames`, one of them a line.
fn write_lines(
    writer: &mut impl Write,
    head: &str,
    frames: impl Iterator<Item = io::Result<String>>,
) -> io::Result<()> {
    writer.write_all(head.trim_end_matches('}').as_bytes())?;
    writer.write_all(b",\n\"frames\":[")?;
    for (n, frame) in frames.enumerate() {
        write!(writer, "{}\n{}", if n == 0 { "" } else { "," }, frame?)?;
    }
    writer.write_all(b"\n]}\n")
}
