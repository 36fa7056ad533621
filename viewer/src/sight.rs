//! From the depths of a picture back to the ground that it shows.

use crate::picture::Picture;
use glam::{DVec2, DVec3};
use terravision_common::camera::{Camera, CameraError, CameraFields};
use terravision_common::rig::USUAL_SEPARATION;
use terravision_common::surface::CrsFrame;
use terravision_common::viewer::{StreamSettings, ViewerPose};

/// Columns of a picture that its outline on the ground has.
const OUTLINE_COLUMNS: usize = 32;

/// A picture, and the cameras that it was drawn with: of a stereo pair two.
pub(crate) struct Sight<'a> {
    picture: &'a Picture,
    crs: CrsFrame,
    /// Size of one eye's picture.
    size: [u32; 2],
    /// Left and right; one for a picture that is not a pair side by side.
    eyes: Vec<Camera>,
    exaggeration: f64,
}

/// A place on the ground, without exaggeration, and how far it is from the eye.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Seen {
    pub(crate) place: DVec3,
    pub(crate) distance_m: f64,
}

impl<'a> Sight<'a> {
    /// `settings`: how the picture's flight draws.
    pub(crate) fn new(picture: &'a Picture, settings: &StreamSettings, crs: CrsFrame) -> Result<Self, CameraError> {
        let ViewerPose { x, y, z, heading, pitch, roll, vfov } = picture.pose;
        let size = settings.eye_size(picture.size);
        let pose = Camera::new(CameraFields {
            eye_in_world: crs.position([x, y, z].into()).to_array(),
            heading_rad: heading.to_radians(),
            pitch_rad: pitch.to_radians(),
            roll_rad: roll.to_radians(),
            vfov_rad: vfov.to_radians(),
            width: size[0],
            height: size[1],
            timestamp_nanos: 0,
        })?;
        let eyes = match settings.convergence.filter(|_| settings.stereo().is_some()) {
            None => vec![pose],
            Some(convergence_m) => {
                let separation_m = settings.eye_separation.unwrap_or(USUAL_SEPARATION * convergence_m);
                // In an anaglyph depths are those of the left eye.
                let count = if size == picture.size { 1 } else { 2 };
                let sides = [-0.5, 0.5].into_iter().take(count);
                sides.map(|side| eye(&pose, side * separation_m, convergence_m)).collect::<Result<_, _>>()?
            }
        };
        let exaggeration = settings.exaggeration.unwrap_or(1.0);
        Ok(Self { picture, crs, size, eyes, exaggeration })
    }

    /// What a point shows, from 0 to 1 from the upper left corner; `None` for sky.
    pub(crate) fn at(&self, point: [f64; 2]) -> Option<Seen> {
        // The depth is that at the pixel's centre.
        let [column, row] = [0, 1].map(|axis| {
            let side = self.picture.size[axis];
            ((point[axis] * f64::from(side)).floor() as usize).min(side as usize - 1)
        });
        self.of_pixel(column, row)
    }

    fn of_pixel(&self, column: usize, row: usize) -> Option<Seen> {
        let (width, eye_width) = (self.picture.size[0] as usize, self.size[0] as usize);
        let depth = self.picture.frame.depth.get(row * width + column).copied().filter(|depth| depth.is_finite())?;
        let camera = self.eyes.get(column / eye_width)?;
        let way = camera.ray_in_world((column % eye_width) as f64 + 0.5, row as f64 + 0.5) * f64::from(depth);
        let place = self.crs.place(camera.eye() + way);
        // Exaggerated by 0 all ground is flat.
        let height = if self.exaggeration == 0.0 { 0.0 } else { place.z / self.exaggeration };
        Some(Seen { place: place.truncate().extend(height), distance_m: way.length() })
    }

    /// The outline of the ground that is seen: along the lower edge of the picture to the right,
    /// and along the skyline, or the upper edge, back. Empty where no ground is seen.
    pub(crate) fn outline(&self) -> Vec<DVec2> {
        let [width, height] = self.size.map(|side| side as usize);
        let columns = OUTLINE_COLUMNS.min(width);
        let (mut near, mut far) = (Vec::new(), Vec::new());
        for i in 0..columns {
            let column = i * (width - 1) / (columns - 1).max(1);
            let lowest = (0..height).rev().find_map(|row| self.of_pixel(column, row));
            let highest = (0..height).find_map(|row| self.of_pixel(column, row));
            near.extend(lowest.map(|seen| seen.place.truncate()));
            far.extend(highest.map(|seen| seen.place.truncate()));
        }
        near.extend(far.into_iter().rev());
        near
    }
}

/// An eye of a pair, so far to the right of the pose, whose pictures meet at a distance.
fn eye(pose: &Camera, right_m: f64, convergence_m: f64) -> Result<Camera, CameraError> {
    let [right, _, _] = pose.axes_in_world();
    let eye_in_world = (pose.eye() + right * right_m).to_array();
    let camera = Camera::new(CameraFields { eye_in_world, ..*pose.fields() })?;
    camera.with_lens_shift(-right_m * pose.focal_px() / convergence_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::SentPose;
    use std::time::Instant;
    use terravision_common::shm::SharedFrame;
    use terravision_common::viewer::SIDE_BY_SIDE;

    /// A picture straight down from a kilometre above level ground.
    fn picture(size: [u32; 2]) -> Picture {
        let pose = ViewerPose { x: 500.0, y: 700.0, z: 1000.0, heading: 0.0, pitch: -90.0, roll: 0.0, vfov: 90.0 };
        let sent = SentPose { pose, time_s: 0.0, client: 1, id: 1, received_ms: 0.0 };
        let frame = SharedFrame { depth: vec![1000.0; (size[0] * size[1]) as usize], ..SharedFrame::default() };
        let since = Instant::now();
        Picture { flight: 1, size, pose, sent, number: 1, is_settled: true, drawn_ms: 0.0, since, frame }
    }

    #[test]
    fn a_point_shows_a_place_and_the_outline_is_what_is_seen() {
        let picture = picture([200, 100]);
        let sight = Sight::new(&picture, &StreamSettings::default(), CrsFrame::new([0.0, 0.0])).unwrap();
        let seen = sight.at([0.5, 0.5]).unwrap();
        assert!(seen.place.distance(DVec3::new(510.0, 690.0, 0.0)) < 1e-6, "{seen:?}");
        let outline = sight.outline();
        let reach = |axis: usize| {
            outline
                .iter()
                .map(|place| place[axis])
                .fold([f64::MAX, f64::MIN], |[low, high], value| [low.min(value), high.max(value)])
        };
        let ([west, east], [south, north]) = (reach(0), reach(1));
        assert!((west + 1490.0).abs() < 1e-6 && (east - 2490.0).abs() < 1e-6, "{west} {east}");
        assert!((south + 290.0).abs() < 1e-6 && (north - 1690.0).abs() < 1e-6, "{south} {north}");
    }

    #[test]
    fn both_eyes_see_a_place_where_their_pictures_meet() {
        let settings = StreamSettings {
            stereo: Some(SIDE_BY_SIDE.into()),
            convergence: Some(1000.0),
            eye_separation: Some(80.0),
            ..Default::default()
        };
        let picture = picture([400, 100]);
        let sight = Sight::new(&picture, &settings, CrsFrame::new([0.0, 0.0])).unwrap();
        let [left, right] = [0.2, 0.7].map(|u| sight.at([u, 0.5]).unwrap());
        assert!(left.place.distance(right.place) < 1e-6, "{left:?} {right:?}");
        assert!((left.place.x - 110.0).abs() < 1e-6, "{left:?}");
    }
}
