//! `terravision path`: the poses of a camera path, one per frame, as a JSON path.

use crate::cli::path::PathArgs;
use crate::failure::Failure;
use crate::flight::progress::Progress;
use crate::output::TemporaryFile;
use crate::path::{PathSettings, Pose};
use crate::plan::{self, LoadedPath};
use crate::world::open_world;
use anyhow::{Context, anyhow};
use serde_json::{Map, Value, json};
use std::io::{self, Write};
use std::path::Path;
use terravision_common::shm::RunId;

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
    let (fps, speed) = plan::pace(&args.course, &path)?;
    let [first, end] = plan::frame_range(args.course.frames, &path.course, fps, speed)?;
    let crs = &database.manifest().fields().crs;
    let name = crs.epsg.map_or_else(|| crs.name.clone(), |epsg| format!("EPSG:{epsg}"));
    let head = head(&name, fps, &settings);
    let poses = (first..end).map(|frame| path.course.pose(frame, fps, speed));
    if args.output == Path::new("-") {
        let mut out = io::stdout().lock();
        return write(&mut out, &head, poses).context("cannot write to standard output").map_err(Failure::failed);
    }
    let run = RunId::new_for_this_process().map_err(Failure::failed)?.to_string();
    let file = TemporaryFile::create(&args.output, &run).map_err(Failure::bad_input)?;
    file.finish_with(|writer| write(writer, &head, poses)).map_err(|error| Failure::failed(anyhow!(error)))
}

fn head(crs: &str, fps: f64, settings: &PathSettings) -> Map<String, Value> {
    let mut head = Map::new();
    head.insert("crs".into(), json!(crs));
    head.insert("fps".into(), json!(fps));
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
    poses: impl Iterator<Item = Option<Pose>>,
) -> io::Result<()> {
    writer.write_all(b"{")?;
    for (key, value) in head {
        write!(writer, "{}: {value}, ", Value::from(key.as_str()))?;
    }
    writer.write_all(b"\"frames\": [")?;
    for (i, pose) in poses.flatten().enumerate() {
        let [x, y, z] = pose.position.to_array();
        let (heading, pitch) = (pose.heading_rad.to_degrees(), pose.pitch_rad.to_degrees());
        let mut frame = json!({"x": x, "y": y, "z": z, "heading": heading, "pitch": pitch});
        if pose.roll_rad != 0.0 {
            frame["roll"] = json!(pose.roll_rad.to_degrees());
        }
        write!(writer, "{}\n  {frame}", if i == 0 { "" } else { "," })?;
    }
    writer.write_all(b"\n]}\n")?;
    writer.flush()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::path::Course;
    use crate::path::tests::parse_text;
    use glam::DVec3;

    #[test]
    fn what_is_written_reads_back_as_the_same_path() {
        let pose = Pose { position: DVec3::new(5e5, 4e6, 2.5), heading_rad: 1.0, pitch_rad: -0.25, roll_rad: 0.125 };
        let settings = PathSettings { vfov_rad: Some(0.75), sky_rgb: Some([1, 2, 3]), ..PathSettings::default() };
        let mut bytes = Vec::new();
        write(&mut bytes, &head("EPSG:32610", 25.0, &settings), [Some(pose); 3].into_iter()).unwrap();
        let path = parse_text(&String::from_utf8(bytes).unwrap()).unwrap();
        assert_eq!((path.settings.sky_rgb, path.settings.fps), (Some([1, 2, 3]), Some(25.0)));
        assert!((path.settings.vfov_rad.unwrap() - 0.75).abs() < 1e-12);
        let Course::Frames(poses) = path.course else { panic!("not frames") };
        assert_eq!(poses.len(), 3);
        assert_eq!(poses[0].position, pose.position);
        assert!((poses[0].roll_rad - pose.roll_rad).abs() < 1e-12);
    }
}
