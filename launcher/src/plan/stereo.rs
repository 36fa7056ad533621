//! A stereo pair: how far apart the eyes are, and where their pictures meet.

use super::checks::in_range;
use crate::cli::stereo::{StereoArg, StereoArgs};
use crate::failure::Failure;
use crate::path::{Ground, Pose};
use crate::rig_file::{Pictures, RigFile};
use anyhow::anyhow;
use terravision_common::rig::USUAL_SEPARATION;
use terravision_common::surface;

/// Eyes are at most this share of that distance apart: beyond it no one fuses what is seen.
const WIDEST: f64 = 1.0;
/// Where the first picture's middle shows no ground, its pictures meet this many times the eye's
/// height above ground away.
const OF_HEIGHT: f64 = 10.0;
/// Without any ground under the eye either, metres.
const UNKNOWN_M: f64 = 1000.0;
/// The line of sight is followed in steps of this share of the way so far, from this many metres
/// on, up to this many.
const STEP: f64 = 0.01;
const FIRST_M: f64 = 1.0;
const FARTHEST_M: f64 = 1e6;

/// The pair that was asked for, of which this is the first pose, and a note of its measures.
///
/// # Errors
/// Bad input: a number out of range, or a distance that has to be given because there is no path.
pub(super) fn pair(
    args: &StereoArgs,
    pose: Option<&Pose>,
    ground: &dyn Ground,
) -> Result<Option<(RigFile, String)>, Failure> {
    let Some(how) = args.stereo else { return Ok(None) };
    let convergence_m = match (args.convergence, pose) {
        (Some(metres), _) => in_range("--convergence", metres, 0.01, FARTHEST_M, "metres from 0.01 to 1000000")?,
        (None, Some(pose)) => ground_ahead(pose, ground),
        (None, None) => {
            return Err(Failure::bad_input(anyhow!(
                "--stereo with --camera: expected --convergence, the distance in metres at which the pictures of both eyes \
                 meet, as the poses that will come are not known"
            )));
        }
    };
    let separation_m = args.eye_separation.unwrap_or(USUAL_SEPARATION * convergence_m);
    let most = WIDEST * convergence_m;
    if !(separation_m >= 0.0 && separation_m <= most) {
        return Err(Failure::bad_input(anyhow!(
            "--eye-separation {separation_m}: expected metres from 0 to the {most} of --convergence"
        )));
    }
    let pictures = match how {
        StereoArg::SideBySide => Pictures::SideBySide,
        StereoArg::Anaglyph => Pictures::Anaglyph,
        StereoArg::Pair => Pictures::Separate,
    };
    let note = format!(
        "stereo: eyes {} m apart, in the plane of the screen what is {} m away",
        rounded(separation_m),
        rounded(convergence_m)
    );
    Ok(Some((RigFile::stereo(pictures, separation_m, convergence_m), note)))
}

/// How far along the line of sight the ground is.
pub(crate) fn ground_ahead(pose: &Pose, ground: &dyn Ground) -> f64 {
    let [_, forward] = surface::look(pose.heading_rad, pose.pitch_rad);
    let mut way = FIRST_M;
    while way < FARTHEST_M {
        let at = pose.position + forward * way;
        if ground.height_m(at.x, at.y).is_some_and(|height| at.z <= height) {
            return way;
        }
        way += STEP * way;
    }
    let position = pose.position;
    let above = ground.height_m(position.x, position.y).map(|height| position.z - height);
    above.filter(|above| *above > 0.0).map_or(UNKNOWN_M, |above| OF_HEIGHT * above).clamp(FIRST_M, FARTHEST_M)
}

/// Three digits, for people.
fn rounded(metres: f64) -> String {
    let digits = (2.0 - metres.abs().max(1e-3).log10().floor()).max(0.0) as usize;
    format!("{metres:.digits$}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    /// Level ground at 100 m, where x is positive.
    struct Level;

    impl Ground for Level {
        fn height_m(&self, x: f64, _y: f64) -> Option<f64> {
            (x >= 0.0).then_some(100.0)
        }
    }

    fn pose(x: f64, pitch_deg: f64) -> Pose {
        let position = DVec3::new(x, 0.0, 1100.0);
        Pose { position, heading_rad: 0.0, pitch_rad: f64::to_radians(pitch_deg), roll_rad: 0.0 }
    }

    fn args(eye_separation: Option<f64>, convergence: Option<f64>) -> StereoArgs {
        StereoArgs { stereo: Some(StereoArg::Anaglyph), eye_separation, convergence }
    }

    #[test]
    fn pictures_meet_on_the_ground_in_the_middle() {
        let (rig, note) = pair(&args(None, None), Some(&pose(50.0, -30.0)), &Level).unwrap().expect("a pair");
        let rig = rig.rig([1280, 720], 1.0).unwrap();
        let [left, right] = [&rig.views()[0], &rig.views()[1]];
        assert!((left.offset_m[0] + 2000.0 / 60.0).abs() < 0.4 && left.offset_m[0] == -right.offset_m[0]);
        assert_eq!(left.lens_shift_px, -right.lens_shift_px);
        assert!((left.lens_shift_px - 360.0 / 0.5f64.tan() / 60.0).abs() < 1e-9, "{}", left.lens_shift_px);
        assert!(note.starts_with("stereo: eyes 6") && note.contains("what is 20"), "{note}");
    }

    #[test]
    fn the_sky_ahead_leaves_the_height_and_nothing_at_all_a_kilometre() {
        assert_eq!(ground_ahead(&pose(50.0, 10.0), &Level), 10_000.0);
        assert_eq!(ground_ahead(&pose(-50.0, 10.0), &Level), 1000.0);
        assert_eq!([0.0651, 33.333, 2004.4, 0.0].map(rounded), ["0.0651", "33.3", "2004", "0.00000"]);
    }

    #[test]
    fn numbers_that_no_eyes_see_are_refused() {
        let refused = |args: StereoArgs, pose| pair(&args, pose, &Level).unwrap_err().to_string();
        let here = pose(50.0, -30.0);
        assert!(refused(args(None, Some(0.0)), Some(&here)).contains("--convergence 0"));
        assert!(refused(args(Some(-1.0), Some(50.0)), Some(&here)).contains("--eye-separation -1: expected metres"));
        assert!(refused(args(Some(51.0), Some(50.0)), Some(&here)).contains("from 0 to the 50 of --convergence"));
        assert!(refused(args(Some(f64::NAN), None), Some(&here)).contains("--eye-separation NaN"));
        assert!(refused(args(None, None), None).contains("--stereo with --camera: expected --convergence"));
        let none = StereoArgs { stereo: None, eye_separation: None, convergence: None };
        assert!(pair(&none, None, &Level).unwrap().is_none());
    }
}
