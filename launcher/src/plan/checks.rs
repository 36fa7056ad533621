//! Checks of single arguments and of the path against the world.

use crate::cli::course::CourseArgs;
use crate::cli::realtime::{Mode, RealtimeArgs, Switch};
use crate::cli::values::FrameRange;
use crate::failure::Failure;
use crate::ground::FAR_FROM_WORLD;
use crate::path::orbit::Extent;
use crate::path::{self, CameraPath, Course, Pose};
use anyhow::anyhow;
use glam::DVec3;
use std::path::Path;
use terravision_common::run::{Prediction, PrefetchConfig, RealtimeConfig};

/// Facets and texels may become this many times as large as wanted, by default.
const COARSEST: f64 = 4.0;

pub(super) const DEFAULT_FPS: f64 = 30.0;

/// Frames per second.
pub(super) fn fps(asked: Option<f64>) -> Result<f64, Failure> {
    in_range("--fps", asked.unwrap_or(DEFAULT_FPS), 0.001, 1000.0, "frames per second from 0.001 to 1000")
}

/// How many times as fast a path is flown.
pub(super) fn speed(asked: Option<f64>) -> Result<f64, Failure> {
    in_range("--speed", asked.unwrap_or(1.0), 1e-3, 1e4, "a factor from 0.001 to 10000")
}

/// Frames per second, and how many times as fast a path in time is flown.
///
/// # Errors
/// Bad input: a number out of range.
pub fn pace(args: &CourseArgs, path: &CameraPath) -> Result<(f64, f64), Failure> {
    let fps = fps(args.fps.or(path.settings.fps))?;
    let speed = speed(args.speed)?;
    const TIMED: &str = "--speed applies to paths with times (keyframes, KML, GPX, CZML, GeoJSON)";
    match (&path.course, args.speed) {
        (Course::Frames(_), Some(_)) => {
            Err(Failure::bad_input(anyhow!("{TIMED}; this one has a pose per frame, so --fps sets its speed")))
        }
        (Course::Round(poses), Some(_)) => {
            Err(Failure::bad_input(anyhow!("{TIMED}; the orbit has {} frames, so --fps sets its speed", poses.len())))
        }
        _ => Ok((fps, speed)),
    }
}

/// The frames to fly: those asked for, or all.
///
/// # Errors
/// Bad input: the path has fewer frames.
pub fn frame_range(asked: Option<FrameRange>, course: &Course, fps: f64, speed: f64) -> Result<[u64; 2], Failure> {
    let count = course.frame_count(fps, speed).map_err(Failure::bad_input)?;
    match (asked, count) {
        (Some(range), Some(count)) if range.end > count => Err(Failure::bad_input(anyhow!(
            "--frames {}..{}: expected frames within 0..{count}, which the path has at {fps} frames per second",
            range.first,
            range.end
        ))),
        (Some(range), _) if range.end - range.first > path::MAX_FRAMES => Err(Failure::bad_input(anyhow!(
            "--frames {}..{}: expected at most {} frames, in several runs if need be",
            range.first,
            range.end,
            path::MAX_FRAMES
        ))),
        (Some(range), _) => Ok([range.first, range.end]),
        (None, Some(count)) => Ok([0, count]),
        // A course without end is flown once.
        (None, None) => Ok([0, course.round_frames()]),
    }
}

/// A path that never comes near the world is an error, one that leaves it is worth a warning.
pub(super) fn check_distance(poses: &[Pose], extent: &Extent, warnings: &mut Vec<String>) -> Result<(), Failure> {
    let reach = FAR_FROM_WORLD * extent.size().max_element();
    let is_far = |pose: &&Pose| extent.distance(pose.position.truncate()) > reach;
    let far = poses.iter().filter(is_far).count();
    if far == poses.len() {
        let eye = poses.first().map_or(DVec3::ZERO, |pose| pose.position);
        return Err(Failure::bad_input(anyhow!(
            "the camera is nowhere near the world: it starts at {:.0}, {:.0}, and the world reaches from {:.0}, {:.0} \
             to {:.0}, {:.0}; is the path in another CRS than the world?",
            eye.x,
            eye.y,
            extent.low.x,
            extent.low.y,
            extent.high.x,
            extent.high.y
        )));
    }
    if far > 0 {
        warnings.push(format!("{far} of {} frames are far outside of the world", poses.len()));
    }
    Ok(())
}

pub(super) fn in_range(name: &str, value: f64, low: f64, high: f64, expected: &str) -> Result<f64, Failure> {
    if (low..=high).contains(&value) {
        Ok(value)
    } else {
        Err(Failure::bad_input(anyhow!("{name} {value}: expected {expected}")))
    }
}

/// The field of view that `terravision path` is asked to write, radians.
///
/// # Errors
/// Bad input: out of range.
pub fn vfov_of_path(asked: Option<f64>) -> Result<Option<f64>, Failure> {
    asked.map(|vfov| Ok(in_range("--vfov", vfov, 1.0, 170.0, "degrees from 1 to 170")?.to_radians())).transpose()
}

/// What a flight against the clock may do; `None` in exact mode. `wanted_px`: facets, then texels.
/// `rest_facet_px`: size of facets at rest, pixels, if nothing else is said.
pub(super) fn realtime(
    args: &RealtimeArgs,
    wanted_px: [f64; 2],
    rest_facet_px: f64,
) -> Result<Option<RealtimeConfig>, Failure> {
    if args.mode == Mode::Exact {
        let given = [
            ("--feedback", args.feedback.is_some()),
            ("--coarsest-facet-px", args.coarsest_facet_px.is_some()),
            ("--coarsest-texel-px", args.coarsest_texel_px.is_some()),
            ("--rest-facet-px", args.rest_facet_px.is_some()),
            ("--rest-texel-px", args.rest_texel_px.is_some()),
            ("--prediction", args.prediction.is_some()),
        ];
        return match given.into_iter().find(|(_, is_given)| *is_given) {
            Some((flag, _)) => Err(Failure::bad_input(anyhow!(
                "{flag} applies to --mode realtime only: in exact mode nothing changes with the clock"
            ))),
            None => Ok(None),
        };
    }
    let [facet, texel] = wanted_px;
    let coarsest = |name, asked: Option<f64>, wanted: f64| {
        in_range(name, asked.unwrap_or(COARSEST * wanted), wanted, 1e5, "pixels, no less than what is wanted")
    };
    let rest = |name, asked: Option<f64>, usual: f64, wanted: f64| {
        in_range(name, asked.unwrap_or(usual.min(wanted)), 0.1, wanted, "pixels from 0.1 to what is wanted")
    };
    Ok(Some(RealtimeConfig {
        has_feedback: args.feedback != Some(Switch::Off),
        coarsest_px: [
            coarsest("--coarsest-facet-px", args.coarsest_facet_px, facet)?,
            coarsest("--coarsest-texel-px", args.coarsest_texel_px, texel)?,
        ],
        rest_px: [
            rest("--rest-facet-px", args.rest_facet_px, rest_facet_px, facet)?,
            rest("--rest-texel-px", args.rest_texel_px, texel, texel)?,
        ],
    }))
}

pub(super) fn exaggeration(value: f64) -> Result<f64, Failure> {
    in_range("--exaggeration", value, 0.01, 100.0, "a factor from 0.01 to 100")
}

/// What the prefetcher does beyond what frames ask of it.
pub(super) fn prefetch(args: Option<&RealtimeArgs>) -> PrefetchConfig {
    match args.filter(|args| args.mode == Mode::Realtime) {
        Some(args) => PrefetchConfig::realtime(args.prediction.map_or(Prediction::Linear, Prediction::from)),
        None => PrefetchConfig::EXACT,
    }
}

/// Threads that decode tiles: as asked, as `RAYON_NUM_THREADS` says, or one per core.
pub(super) fn decoder_threads(asked: Option<u32>) -> Result<u32, Failure> {
    const EXPECTED: &str = "a whole number from 1 to 256";
    let cores = || std::thread::available_parallelism().map_or(1, |n| n.get().min(256) as u32);
    let (name, threads) = match (asked, std::env::var("RAYON_NUM_THREADS")) {
        (Some(threads), _) => ("--threads", threads),
        // Rayon takes 0 for "as many as there are cores".
        (None, Ok(text)) if text.trim().is_empty() || text.trim() == "0" => return Ok(cores()),
        (None, Ok(text)) => match text.trim().parse() {
            Ok(threads) => ("RAYON_NUM_THREADS", threads),
            Err(_not_a_number) => {
                return Err(Failure::bad_input(anyhow!("RAYON_NUM_THREADS={text}: expected {EXPECTED}")));
            }
        },
        (None, Err(_not_set)) => return Ok(cores()),
    };
    match threads {
        1..=256 => Ok(threads),
        _ => Err(Failure::bad_input(anyhow!("{name} {threads}: expected {EXPECTED}"))),
    }
}

pub(super) fn is_folder_name(path: &Path) -> bool {
    path.as_os_str().as_encoded_bytes().ends_with(b"/") || path.is_dir()
}

pub(super) fn has_extension(path: &Path, known: &[&str]) -> bool {
    path.extension().and_then(|e| e.to_str()).is_some_and(|e| known.contains(&e.to_ascii_lowercase().as_str()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec2;

    fn pose(x: f64) -> Pose {
        Pose { position: DVec3::new(x, 0.0, 0.0), heading_rad: 0.0, pitch_rad: 0.0, roll_rad: 0.0 }
    }

    #[test]
    fn a_path_far_from_the_world_is_an_error_and_one_that_leaves_it_a_warning() {
        let extent = Extent { low: DVec2::ZERO, high: DVec2::new(100.0, 50.0) };
        let mut warnings = Vec::new();
        assert!(check_distance(&[pose(50.0), pose(299.0)], &extent, &mut warnings).is_ok() && warnings.is_empty());
        assert!(check_distance(&[pose(50.0), pose(301.0)], &extent, &mut warnings).is_ok());
        assert_eq!(warnings, ["1 of 2 frames are far outside of the world"]);
        let failure = check_distance(&[pose(301.0)], &extent, &mut warnings).unwrap_err();
        assert!(failure.to_string().contains("nowhere near the world"), "{failure}");
    }

    #[test]
    fn frames_that_the_path_does_not_have_are_refused() {
        let course = Course::Frames(vec![pose(0.0); 10]);
        let range = |first, end| Some(FrameRange { first, end });
        assert_eq!(frame_range(range(3, 10), &course, 30.0, 1.0).unwrap(), [3, 10]);
        assert_eq!(frame_range(None, &course, 30.0, 1.0).unwrap(), [0, 10]);
        let message = frame_range(range(3, 11), &course, 30.0, 1.0).unwrap_err().to_string();
        assert!(message.contains("expected frames within 0..10"), "{message}");
        let round = Course::Round(vec![pose(0.0); 240]);
        assert_eq!(frame_range(None, &round, 30.0, 1.0).unwrap(), [0, 240]);
        assert_eq!(frame_range(range(200, 500), &round, 30.0, 1.0).unwrap(), [200, 500]);
        assert!(frame_range(range(0, 900_000_000), &round, 30.0, 1.0).is_err());
    }
}
