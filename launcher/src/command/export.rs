//! `terravision path`: the poses of a camera path, one per frame or as keyframes, as a JSON path.

use crate::cli::path::PathArgs;
use crate::failure::Failure;
use crate::flight::progress::Progress;
use crate::output::TemporaryFile;
use crate::path::spline::Spline;
use crate::path::{Course, PathSettings, Pose};
use crate::plan::{self, LoadedPath};
use crate::world::open_world;
use anyhow::{Context, anyhow};
use serde_json::{Map, Value, json};
use std::io::{self, Write};
use std::path::Path;
use terravision_common::shm::RunId;

/// Between the two keyframes of a cut, seconds.
const CUT_S: f64 = 1e-3;

/// Writes them.
///
/// # Errors
/// Bad input, or the output cannot be written to.
pub fn export(args: &PathArgs) -> Result<(), Failure> {
    let database = open_world(&args.world, &args.database)?;
    let LoadedPath { path, notes, warnings } = plan::load_path(&args.course, &database, args.exaggeration)?;
    let mut settings = path.settings;
    if let Some(vfov_rad) = plan::vfov_of_path(args.vfov)? {
        (settings.vfov_rad, settings.hfov_rad) = (Some(vfov_rad), None);
    }
    let progress = Progress::new(0, false);
    notes.iter().for_each(|note| progress.note(note));
    warnings.iter().for_each(|warning| progress.warn(warning));
    let crs = &database.manifest().fields().crs;
    let name = crs.epsg.map_or_else(|| crs.name.clone(), |epsg| format!("EPSG:{epsg}"));
    match &path.course {
        Course::Timed(pieces) if args.keyframes => {
            let mut head = head(&name, settings.fps, &settings);
            let target = pieces.first().and_then(Spline::target);
            target.map(|target| head.insert("target".into(), json!(target.to_array())));
            put_out(args, &head, "keyframes", keyframes(pieces))
        }
        course => {
            let (fps, speed) = plan::pace(&args.course, &path)?;
            let [first, end] = plan::frame_range(args.course.frames, course, fps, speed)?;
            let poses = (first..end).filter_map(|frame| course.pose(frame, fps, speed));
            put_out(args, &head(&name, Some(fps), &settings), "frames", poses.map(|pose| value(&pose)))
        }
    }
}

/// Writes to where it is asked for.
fn put_out(
    args: &PathArgs,
    head: &Map<String, Value>,
    list: &str,
    poses: impl Iterator<Item = Value>,
) -> Result<(), Failure> {
    if args.output == Path::new("-") {
        let mut out = io::stdout().lock();
        return write(&mut out, head, list, poses).context("cannot write to standard output").map_err(Failure::failed);
    }
    let run = RunId::new_for_this_process().map_err(Failure::failed)?.to_string();
    let file = TemporaryFile::create(&args.output, &run).map_err(Failure::bad_input)?;
    file.finish_with(|writer| write(writer, head, list, poses)).map_err(|error| Failure::failed(anyhow!(error)))
}

/// The keyframes of all pieces; a cut becomes two moments that nothing lies between.
fn keyframes(pieces: &[Spline]) -> impl Iterator<Item = Value> {
    let mut last = f64::NEG_INFINITY;
    pieces.iter().flat_map(Spline::keys).map(move |key| {
        let t = key.t.max(last + CUT_S);
        last = t;
        let mut keyframe = json!({"t": t});
        if let (Some(all), Value::Object(pose)) = (keyframe.as_object_mut(), value(&key.pose)) {
            all.extend(pose);
        }
        if key.is_stop {
            keyframe["rest"] = json!(true);
        }
        keyframe
    })
}

fn value(pose: &Pose) -> Value {
    let [x, y, z] = pose.position.to_array();
    let (heading, pitch) = (pose.heading_rad.to_degrees(), pose.pitch_rad.to_degrees());
    let mut value = json!({"x": x, "y": y, "z": z, "heading": heading, "pitch": pitch});
    if pose.roll_rad != 0.0 {
        value["roll"] = json!(pose.roll_rad.to_degrees());
    }
    value
}

fn head(crs: &str, fps: Option<f64>, settings: &PathSettings) -> Map<String, Value> {
    let mut head = Map::new();
    head.insert("crs".into(), json!(crs));
    fps.map(|fps| head.insert("fps".into(), json!(fps)));
    if let (Some(width), Some(height)) = (settings.width, settings.height) {
        head.insert("width".into(), json!(width));
        head.insert("height".into(), json!(height));
    }
    // A horizontal field of view becomes a vertical one by the size of the picture.
    let size = plan::DEFAULT_SIZE;
    let (width, height) = (settings.width.unwrap_or(size.width), settings.height.unwrap_or(size.height));
    if let Some(vfov_rad) = settings.vfov_of(width, height) {
        head.insert("vfov_deg".into(), json!(vfov_rad.to_degrees()));
    }
    if let Some(sky) = settings.sky_rgb {
        head.insert("sky_rgb".into(), json!(sky));
    }
    head
}

/// One frame a line: easy to edit, and to compare.
fn write(
    writer: &mut impl Write,
    head: &Map<String, Value>,
    list: &str,
    poses: impl Iterator<Item = Value>,
) -> io::Result<()> {
    writer.write_all(b"{")?;
    for (key, value) in head {
        write!(writer, "{}: {value}, ", Value::from(key.as_str()))?;
    }
    write!(writer, "\"{list}\": [")?;
    for (i, pose) in poses.enumerate() {
        write!(writer, "{}\n  {pose}", if i == 0 { "" } else { "," })?;
    }
    writer.write_all(b"\n]}\n")?;
    writer.flush()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::path::spline::Key;
    use crate::path::tests::parse_text;
    use glam::DVec3;

    #[test]
    fn what_is_written_reads_back_as_the_same_path() {
        let pose = Pose { position: DVec3::new(5e5, 4e6, 2.5), heading_rad: 1.0, pitch_rad: -0.25, roll_rad: 0.125 };
        let settings = PathSettings { vfov_rad: Some(0.75), sky_rgb: Some([1, 2, 3]), ..PathSettings::default() };
        let mut bytes = Vec::new();
        let head = head("EPSG:32610", Some(25.0), &settings);
        write(&mut bytes, &head, "frames", [pose; 3].iter().map(value)).unwrap();
        let path = parse_text(&String::from_utf8(bytes).unwrap()).unwrap();
        assert_eq!((path.settings.sky_rgb, path.settings.fps), (Some([1, 2, 3]), Some(25.0)));
        assert!((path.settings.vfov_rad.unwrap() - 0.75).abs() < 1e-12);
        let Course::Frames(poses) = path.course else { panic!("not frames") };
        assert_eq!(poses.len(), 3);
        assert_eq!(poses[0].position, pose.position);
        assert!((poses[0].roll_rad - pose.roll_rad).abs() < 1e-12);
    }

    #[test]
    fn keyframes_read_back_as_the_same_way_with_rests_cuts_and_target() {
        let pose =
            |x: f64| Pose { position: DVec3::new(x, 9.0, 5.0), heading_rad: 1.0, pitch_rad: -0.25, roll_rad: 0.0 };
        let piece = |first: f64, is_stop| {
            let keys = [0.0, 1.0, 3.0].map(|t| Key { is_stop, ..Key::passing(first + t, pose(10.0 * (first + t))) });
            Spline::new(&keys).unwrap().looking_at(Some(DVec3::ZERO))
        };
        let pieces = [piece(0.0, true), piece(3.0, false)];
        let mut bytes = Vec::new();
        let mut head = head("EPSG:32610", None, &PathSettings::default());
        head.insert("target".into(), json!([0.0, 0.0, 0.0]));
        write(&mut bytes, &head, "keyframes", keyframes(&pieces)).unwrap();
        let path = parse_text(&String::from_utf8(bytes).unwrap()).unwrap();
        let Course::Timed(read) = &path.course else { panic!("no keyframes") };
        assert_eq!((read.len(), read[0].keys().filter(|key| key.is_stop).count()), (1, 3));
        for t in [0.0, 0.5, 1.0, 2.9] {
            let [found, expected] = [read[0].pose(t), pieces[0].pose(t)];
            assert!(found.position.distance(expected.position) < 1e-9, "{t}: {found:?}");
            assert!((found.heading_rad - expected.heading_rad).abs() < 1e-9, "{t}: {found:?}");
        }
    }
}
