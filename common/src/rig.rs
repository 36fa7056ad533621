//! Rigs: several cameras that one pose carries and that draw one frame from one tree: a stereo
//! pair, the cameras of a drone, the six faces of a cube.
//!
//! A run has one rig ([`crate::run::RunConfig::rig`]). Every stage derives the same [`Views`] from
//! a frame's pose, so that the rings carry only poses. Without a rig a frame has one view, the
//! camera of the pose.

use crate::camera::{Camera, CameraError, CameraFields};
use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};
use std::f64::consts::FRAC_PI_2;
use std::ops::Deref;

/// Most views of a frame: the faces of a cube.
pub const MAX_VIEWS: usize = 6;

/// Eyes of a stereo pair are this share of the distance apart at which their pictures meet, if
/// nothing else is said: what is infinitely far is then seen a thirtieth of that distance apart,
/// which eyes still fuse on a screen.
pub const USUAL_SEPARATION: f64 = 1.0 / 30.0;

/// A camera whose forward axis is this close to the vertical has no defined heading (sine of the
/// angle).
const VERTICAL: f64 = 1e-9;

/// One camera of a rig, relative to the pose that carries it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigView {
    /// Its name, part of file names: unique in its rig.
    pub name: String,
    /// Offset of its eye, metres to the right, ahead and above in the frame of the pose's camera.
    pub offset_m: [f64; 3],
    /// Yaw to the right, radians; applied before pitch and roll.
    pub yaw_rad: f64,
    /// Pitch, radians up.
    pub pitch_rad: f64,
    /// Roll, radians clockwise.
    pub roll_rad: f64,
    /// Vertical field of view, radians.
    pub vfov_rad: f64,
    /// How far right of its line of sight the middle of its picture is, pixels.
    pub lens_shift_px: f64,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Its upper left corner in the frame's picture, pixels.
    pub at: [u32; 2],
}

/// The cameras of a run: 1 to [`MAX_VIEWS`], each with a name of its own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Vec<RigView>", into = "Vec<RigView>")]
pub struct Rig {
    /// In the order of their pictures.
    views: Vec<RigView>,
}

/// Cameras are not a rig.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum RigError {
    /// They are none, or too many.
    #[error("a rig has {found} views, expected 1 to {MAX_VIEWS}")]
    Count {
        /// How many.
        found: usize,
    },
    /// Two have one name.
    #[error("two views of a rig are called {name:?}, expected a name of its own for each")]
    SameName {
        /// The name.
        name: String,
    },
    /// One has no pixels, or lies too far to the right or below.
    #[error(
        "view {name:?} of a rig has {}x{} pixels at {},{}, expected at least one pixel, and numbers of 32 bits",
        .size[0], .size[1], .at[0], .at[1]
    )]
    Place {
        /// The view.
        name: String,
        /// Its size, pixels.
        size: [u32; 2],
        /// Its place, pixels.
        at: [u32; 2],
    },
}

impl TryFrom<Vec<RigView>> for Rig {
    type Error = RigError;

    fn try_from(views: Vec<RigView>) -> Result<Self, RigError> {
        Self::new(views)
    }
}

impl From<Rig> for Vec<RigView> {
    fn from(rig: Rig) -> Self {
        rig.views
    }
}

/// One view of a frame: a camera, which has the size of its picture, and the place of that in the
/// frame's picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// The camera.
    pub camera: Camera,
    /// Upper left corner in the frame's picture, pixels.
    pub at: [u32; 2],
}

impl View {
    /// Width and height, pixels.
    #[must_use]
    pub fn size(&self) -> [u32; 2] {
        [self.camera.width(), self.camera.height()]
    }

    /// Whether all of it lies within a picture of this size.
    #[must_use]
    pub fn is_within(&self, picture: [u32; 2]) -> bool {
        (0..2).all(|axis| self.at[axis].checked_add(self.size()[axis]).is_some_and(|end| end <= picture[axis]))
    }
}

/// The views of one frame, at least one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Views {
    views: [View; MAX_VIEWS],
    count: usize,
}

impl Views {
    /// One view, which is the whole picture.
    #[must_use]
    pub fn single(camera: &Camera) -> Self {
        Self { views: [View { camera: *camera, at: [0; 2] }; MAX_VIEWS], count: 1 }
    }

    /// These views; `None` for none or too many.
    #[must_use]
    pub fn new(views: impl IntoIterator<Item = View>) -> Option<Self> {
        let mut views = views.into_iter();
        let first = views.next()?;
        let mut made = Self { views: [first; MAX_VIEWS], count: 1 };
        for view in views {
            *made.views.get_mut(made.count)? = view;
            made.count += 1;
        }
        Some(made)
    }

    /// Their cameras.
    pub fn cameras(&self) -> impl Iterator<Item = &Camera> + Clone {
        self.iter().map(|view| &view.camera)
    }

    /// Width and height of the picture that holds all of them, pixels.
    #[must_use]
    pub fn picture(&self) -> [u32; 2] {
        let end = |axis: usize| self.iter().map(|view| view.at[axis].saturating_add(view.size()[axis])).max();
        [end(0).unwrap_or(0), end(1).unwrap_or(0)]
    }
}

/// Where the views of a frame lie in its picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PictureLayout {
    /// Width and height of the picture, pixels.
    pub size: [u32; 2],
    /// Upper left corner and size of each view; zeros behind the last.
    views: [[u32; 4]; MAX_VIEWS],
}

impl PictureLayout {
    /// Of views in a picture of this size.
    #[must_use]
    pub fn new(size: [u32; 2], views: &Views) -> Self {
        let mut layout = Self { size, ..Self::default() };
        for (place, view) in layout.views.iter_mut().zip(views.iter()) {
            *place = [view.at[0], view.at[1], view.size()[0], view.size()[1]];
        }
        layout
    }

    /// One view that is the whole picture.
    #[must_use]
    pub fn whole(size: [u32; 2]) -> Self {
        let mut layout = Self { size, ..Self::default() };
        layout.views[0] = [0, 0, size[0], size[1]];
        layout
    }

    /// Whether one view is the whole picture.
    #[must_use]
    pub fn is_single(&self) -> bool {
        self.views[0] == [0, 0, self.size[0], self.size[1]]
    }
}

impl Deref for Views {
    type Target = [View];

    fn deref(&self) -> &[View] {
        &self.views[..self.count]
    }
}

impl Rig {
    /// These cameras, in the order of their pictures.
    ///
    /// # Errors
    /// [`RigError`]: they are none or too many, two have one name, or one has no place in a picture.
    pub fn new(views: Vec<RigView>) -> Result<Self, RigError> {
        if !(1..=MAX_VIEWS).contains(&views.len()) {
            return Err(RigError::Count { found: views.len() });
        }
        for (index, view) in views.iter().enumerate() {
            let RigView { name, size, at, .. } = view;
            if views[..index].iter().any(|before| before.name == *name) {
                return Err(RigError::SameName { name: name.clone() });
            }
            if (0..2).any(|axis| size[axis] == 0 || at[axis].checked_add(size[axis]).is_none()) {
                return Err(RigError::Place { name: name.clone(), size: *size, at: *at });
            }
        }
        Ok(Self { views })
    }

    /// The cameras, in the order of their pictures.
    #[must_use]
    pub fn views(&self) -> &[RigView] {
        &self.views
    }

    /// The views of a frame whose pose is this camera's.
    ///
    /// # Errors
    /// [`CameraError`] of the first view that is not a camera from there.
    pub fn views_from(&self, pose: &Camera) -> Result<Views, CameraError> {
        let mut is_lost = Ok(());
        // Without a list on the way: a frame allocates nothing.
        let views = Views::new(self.views.iter().map_while(|view| {
            let camera = view.camera(pose).map_err(|error| is_lost = Err(error)).ok()?;
            Some(View { camera, at: view.at })
        }));
        is_lost.map(|()| views.unwrap_or(Views::single(pose)))
    }

    /// Width and height of the picture that holds all views, pixels.
    #[must_use]
    pub fn picture(&self) -> [u32; 2] {
        let end = |axis: usize| self.views.iter().map(|view| view.at[axis] + view.size[axis]).max();
        [end(0).unwrap_or(1), end(1).unwrap_or(1)]
    }

    /// The largest width and the largest height of all views, pixels.
    #[must_use]
    pub fn view_size(&self) -> [u32; 2] {
        [0, 1].map(|axis| self.views.iter().map(|view| view.size[axis]).max().unwrap_or(1))
    }

    /// Pixels of all views together.
    #[must_use]
    pub fn pixels(&self) -> u64 {
        self.views.iter().map(|view| u64::from(view.size[0]) * u64::from(view.size[1])).sum()
    }
}

impl RigView {
    /// The camera of this view, carried by a pose.
    ///
    /// # Errors
    /// [`CameraError`]: the view lies too far from the pose, or a number of it is wrong.
    pub fn camera(&self, pose: &Camera) -> Result<Camera, CameraError> {
        let [right, up, forward] = pose.axes_in_world();
        let [across, ahead, above] = self.offset_m;
        let mut eye = pose.eye();
        if self.offset_m != [0.0; 3] {
            eye += right * across + forward * ahead + up * above;
        }
        let [heading_rad, pitch_rad, roll_rad] = self.angles(pose)?;
        let [width, height] = self.size;
        Camera::new(CameraFields {
            eye_in_world: eye.to_array(),
            heading_rad,
            pitch_rad,
            roll_rad,
            vfov_rad: self.vfov_rad,
            width,
            height,
            timestamp_nanos: pose.timestamp_nanos(),
        })?
        .with_lens_shift(self.lens_shift_px)
    }

    /// Heading, pitch and roll. Angles are added where possible, so that a view that is not rotated
    /// has exactly the angles of the pose.
    fn angles(&self, pose: &Camera) -> Result<[f64; 3], CameraError> {
        let Self { yaw_rad, pitch_rad, roll_rad, .. } = *self;
        if [yaw_rad, pitch_rad] == [0.0; 2] {
            return Ok([pose.heading_rad(), pose.pitch_rad(), pose.roll_rad() + roll_rad]);
        }
        if [pose.pitch_rad(), pose.roll_rad()] == [0.0; 2] {
            return Ok([pose.heading_rad() + yaw_rad, pitch_rad, roll_rad]);
        }
        let [right, up, forward] = pose.axes_in_world();
        let world_from_pose = DMat3::from_cols(right, forward, up);
        // As a pose in the carrying camera's own space: x right, y ahead, z above.
        let turned = Camera::new(CameraFields { heading_rad: yaw_rad, pitch_rad, roll_rad, ..*pose.fields() })?;
        Ok(angles_of(turned.axes_in_world().map(|axis| world_from_pose * axis)))
    }
}

/// Heading, pitch and roll of a camera with these unit vectors right, up and forward.
fn angles_of([right, up, forward]: [DVec3; 3]) -> [f64; 3] {
    let level = forward.truncate().length();
    if level < VERTICAL {
        // Straight up or down: heading and roll are not unique; roll 0 is chosen.
        return [(-right.y).atan2(right.x), FRAC_PI_2.copysign(forward.z), 0.0];
    }
    [forward.x.atan2(forward.y), forward.z.atan2(level), (-right.z).atan2(up.z)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn view() -> RigView {
        RigView {
            name: "one".to_owned(),
            offset_m: [0.0; 3],
            yaw_rad: 0.0,
            pitch_rad: 0.0,
            roll_rad: 0.0,
            vfov_rad: 1.0,
            lens_shift_px: 0.0,
            size: [64, 48],
            at: [0, 0],
        }
    }

    fn pose(angles: [f64; 3]) -> Camera {
        Camera::new(CameraFields {
            eye_in_world: [10.0, 20.0, 30.0],
            heading_rad: angles[0],
            pitch_rad: angles[1],
            roll_rad: angles[2],
            vfov_rad: 1.0,
            width: 64,
            height: 48,
            timestamp_nanos: 9,
        })
        .expect("valid")
    }

    #[test]
    fn a_view_that_is_neither_moved_nor_turned_is_the_pose_to_the_bit() {
        let pose = pose([0.3, -0.7, 0.1]);
        assert_eq!(view().camera(&pose), Ok(pose));
    }

    #[test]
    fn offsets_are_seen_from_the_camera() {
        // Looking east, 30 degrees down.
        let pose = pose([FRAC_PI_2, -30f64.to_radians(), 0.0]);
        let eye = |offset_m| RigView { offset_m, ..view() }.camera(&pose).unwrap().eye() - pose.eye();
        assert!((eye([2.0, 0.0, 0.0]) - DVec3::new(0.0, -2.0, 0.0)).length() < 1e-12, "right is south");
        assert!((eye([0.0, 2.0, 0.0]) - 2.0 * pose.axes_in_world()[2]).length() < 1e-12);
        assert!(eye([0.0, 0.0, 2.0]).z > 1.7 && eye([0.0, 0.0, 2.0]).x > 0.9, "above leans ahead");
    }

    #[test]
    fn the_faces_of_a_cube_look_along_the_axes_of_a_tilted_pose() {
        let pose = pose([0.4, -0.5, 0.2]);
        let [right, up, forward] = pose.axes_in_world();
        let turned = |yaw: f64, pitch: f64| {
            let view = RigView { yaw_rad: yaw.to_radians(), pitch_rad: pitch.to_radians(), ..view() };
            view.camera(&pose).unwrap().axes_in_world()
        };
        let near = |a: DVec3, b: DVec3| (a - b).length() < 1e-12;
        assert!(near(turned(90.0, 0.0)[2], right) && near(turned(90.0, 0.0)[1], up));
        assert!(near(turned(180.0, 0.0)[2], -forward) && near(turned(-90.0, 0.0)[2], -right));
        assert!(near(turned(0.0, 90.0)[2], up) && near(turned(0.0, 90.0)[0], right));
        assert!(near(turned(0.0, -90.0)[2], -up) && near(turned(0.0, -90.0)[1], forward));
    }

    #[test]
    fn straight_down_from_a_level_pose_is_exact() {
        let down = RigView { pitch_rad: -FRAC_PI_2, ..view() }.camera(&pose([1.2, 0.0, 0.0])).unwrap();
        assert_eq!([down.heading_rad(), down.pitch_rad(), down.roll_rad()], [1.2, -FRAC_PI_2, 0.0]);
    }

    #[test]
    fn the_picture_holds_all_views() {
        let views = [view(), RigView { name: "two".to_owned(), at: [64, 10], ..view() }];
        let rig = Rig::new(views.into()).unwrap();
        let made = rig.views_from(&pose([0.0; 3])).unwrap();
        assert_eq!((made.len(), made.picture(), rig.pixels()), (2, [128, 58], 2 * 64 * 48));
        assert!(made[1].is_within([128, 58]) && !made[1].is_within([127, 58]));
        let far = View { at: [u32::MAX, 0], ..made[0] };
        assert!(!far.is_within([u32::MAX, 48]));
        let lost = RigView { name: "lost".to_owned(), offset_m: [1e12, 0.0, 0.0], ..view() };
        let lost = Rig::new(vec![view(), lost]).unwrap();
        assert!(lost.views_from(&pose([0.0; 3])).unwrap_err().to_string().starts_with("its eye is "));
        assert!(Views::new([]).is_none() && Views::new([made[0]; MAX_VIEWS + 1]).is_none());
    }

    #[test]
    fn cameras_that_are_no_rig_are_refused_wherever_they_come_from() {
        let named = |n: usize| RigView { name: n.to_string(), ..view() };
        let rig = |count: usize| Rig::new((0..count).map(named).collect());
        assert_eq!((rig(0), rig(7)), (Err(RigError::Count { found: 0 }), Err(RigError::Count { found: 7 })));
        let six = rig(MAX_VIEWS).unwrap();
        assert_eq!(six.views().len(), MAX_VIEWS);
        let json = serde_json::to_string(&six).unwrap();
        assert_eq!(serde_json::from_str::<Rig>(&json).unwrap(), six);
        let error = serde_json::from_str::<Rig>(&json.replace("\"name\":\"1\"", "\"name\":\"0\"")).unwrap_err();
        assert!(error.to_string().contains("two views of a rig are called \"0\""), "{error}");
        for (size, at) in [([0, 9], [0, 0]), ([9, 9], [0, u32::MAX])] {
            let error = Rig::new(vec![RigView { size, at, ..view() }]).unwrap_err();
            assert_eq!(error, RigError::Place { name: "one".to_owned(), size, at });
        }
    }

    proptest! {
        #[test]
        fn angles_give_back_the_axes(heading in -3.0f64..3.0, pitch in -1.57f64..1.57, roll in -3.0f64..3.0) {
            let axes = pose([heading, pitch, roll]).axes_in_world();
            let again = pose(angles_of(axes)).axes_in_world();
            for (a, b) in axes.into_iter().zip(again) {
                prop_assert!((a - b).length() < 1e-9, "{a} {b}");
            }
        }
    }
}
