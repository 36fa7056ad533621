//! Which poses are flown: finite, in range, near the world, newer than the one before. Others are
//! refused and counted.

use super::Incoming;
use super::message::{Message, SentPose};
use crate::ground::{self, CLEARANCE_M, FAR_FROM_WORLD};
use crate::path::{Ground, Pose, orbit::Extent};
use glam::DVec3;
use std::fmt;
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::event::monotonic_nanos;
use terravision_common::surface::CrsFrame;

const LARGEST_ANGLE_DEG: f64 = 1e6;
/// No clock shows more, not even one in nanoseconds that is given for seconds.
const LARGEST_TIME: f64 = 1e20;
/// This many poses from the past, each newer than the one before, are those of a sender that
/// started again: its clock counts.
const CLOCK_SET_BACK: u32 = 30;

/// Causes for which a pose is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(usize)]
pub enum Cause {
    /// It is not a pose.
    Unreadable = 0,
    /// A number is NaN or infinite.
    NotFinite,
    /// An angle or the time is out of range.
    OutOfRange,
    /// So far from the world that nothing of it is seen.
    FarAway,
    /// Not newer than the pose before.
    FromThePast,
    /// Of a picture that the flight cannot have.
    OtherSize,
}

impl Cause {
    const ALL: [Self; 6] =
        [Self::Unreadable, Self::NotFinite, Self::OutOfRange, Self::FarAway, Self::FromThePast, Self::OtherSize];
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Unreadable => "not a JSON object with the numbers x, y, z, heading and pitch",
            Self::NotFinite => "with a number that is not finite",
            Self::OutOfRange => "with an angle or a time out of range (pitch -90 to 90, vfov 1 to 170 degrees)",
            Self::FarAway => "far outside of the world",
            Self::FromThePast => "from the past: not newer than the pose before",
            Self::OtherSize => {
                "with another picture size than the flight has (sizes up to --size need a flight without files or a film)"
            }
        })
    }
}

/// A pose was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Refusal {
    /// Why.
    pub cause: Cause,
}

/// What poses are made into, and checked against.
#[derive(Debug, Clone, Copy)]
pub struct GateSettings {
    /// Picture size of poses that have none, pixels, and the largest of others.
    pub size: [u32; 2],
    /// Whether poses may have pictures of other sizes.
    pub has_sizes: bool,
    /// Vertical field of view of poses that have none, radians.
    pub vfov_rad: f64,
    /// Extent of the world in its CRS.
    pub extent: Extent,
}

/// Checks poses; keeps count.
#[derive(Debug)]
pub struct Gate {
    settings: GateSettings,
    /// Time of the newest pose.
    newest_s: Option<f64>,
    /// Time of the last pose from the past, and how many of them came one behind the other with
    /// growing times.
    past: (f64, u32),
    accepted: u64,
    lifted: u64,
    refused: [u64; Cause::ALL.len()],
}

impl Gate {
    /// A gate that no pose has passed yet.
    #[must_use]
    pub fn new(settings: GateSettings) -> Self {
        Self {
            settings,
            newest_s: None,
            past: (f64::NEG_INFINITY, 0),
            accepted: 0,
            lifted: 0,
            refused: [0; Cause::ALL.len()],
        }
    }

    /// Poses that became frames.
    #[must_use]
    pub fn accepted(&self) -> u64 {
        self.accepted
    }

    /// Messages that did not.
    #[must_use]
    pub fn refused(&self) -> u64 {
        self.refused.iter().sum()
    }

    /// Lets a message pass, or counts why not; the first refusal of each cause is told.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn pass(
        &mut self,
        message: &Message,
        ground: &dyn Ground,
        tell: &mut dyn FnMut(String),
    ) -> Result<Incoming, Refusal> {
        let checked = match message {
            Message::End => return Ok(Incoming::End),
            Message::Unreadable => Err(Cause::Unreadable),
            Message::NotFinite => Err(Cause::NotFinite),
            Message::Pose(sent) => self.check(sent),
        };
        let lifted = checked.and_then(|(mut pose, vfov_rad, size)| {
            let is_lifted = ground::lift(&mut pose, ground);
            Ok((self.camera(&pose, vfov_rad, size)?, is_lifted))
        });
        let (camera, is_lifted) = match lifted {
            Ok(lifted) => lifted,
            Err(cause) => {
                let count = &mut self.refused[cause as usize];
                *count += 1;
                if *count == 1 {
                    tell(format!("a pose was refused: {cause}; further ones are counted, not reported"));
                }
                return Err(Refusal { cause });
            }
        };
        let time_s =
            if let Message::Pose(SentPose { time_s: Some(time_s), .. }) = message { *time_s } else { f64::NAN };
        if !time_s.is_nan() {
            self.newest_s = Some(time_s);
            self.past = (f64::NEG_INFINITY, 0);
        }
        self.accepted += 1;
        self.lifted += u64::from(is_lifted);
        Ok(Incoming::Pose { camera, time_s })
    }

    /// A pose as a camera of the flight's. What [`Gate::check`] has passed makes one, unless the
    /// world itself is too large.
    fn camera(&self, pose: &Pose, vfov_rad: f64, [width, height]: [u32; 2]) -> Result<Camera, Cause> {
        let crs_frame = CrsFrame::new(self.settings.extent.low.to_array());
        let fields = CameraFields {
            eye_in_world: crs_frame.position(pose.position).to_array(),
            heading_rad: pose.heading_rad,
            pitch_rad: pose.pitch_rad,
            roll_rad: pose.roll_rad,
            vfov_rad,
            width,
            height,
            timestamp_nanos: monotonic_nanos(),
        };
        Camera::new(fields).or(Err(Cause::FarAway))
    }

    fn check(&mut self, sent: &SentPose) -> Result<(Pose, f64, [u32; 2]), Cause> {
        let [heading, pitch, roll] = sent.angles_deg;
        let times = [sent.vfov_deg.unwrap_or(60.0), sent.time_s.unwrap_or(0.0)];
        if !sent.position.iter().chain(&sent.angles_deg).chain(&times).all(|number| number.is_finite()) {
            return Err(Cause::NotFinite);
        }
        let is_angle = |degrees: f64| degrees.abs() <= LARGEST_ANGLE_DEG;
        let has_vfov = sent.vfov_deg.is_none_or(|degrees| (1.0..=170.0).contains(&degrees));
        let has_time = sent.time_s.is_none_or(|time| time.abs() <= LARGEST_TIME);
        if !is_angle(heading) || !is_angle(roll) || !(-90.0..=90.0).contains(&pitch) || !has_vfov || !has_time {
            return Err(Cause::OutOfRange);
        }
        let position = DVec3::from_array(sent.position);
        let extent = &self.settings.extent;
        let reach = FAR_FROM_WORLD * extent.size().max_element();
        if extent.distance(position.truncate()) > reach || position.z.abs() > 1e9 {
            return Err(Cause::FarAway);
        }
        let size = self.size(sent.size)?;
        if let (Some(newest), Some(time)) = (self.newest_s, sent.time_s)
            && time <= newest
        {
            // One wrong time must not be the last pose that is flown.
            self.past = (time, if time > self.past.0 { self.past.1 + 1 } else { 1 });
            if self.past.1 < CLOCK_SET_BACK {
                return Err(Cause::FromThePast);
            }
        }
        let pose = Pose {
            position,
            heading_rad: heading.to_radians(),
            pitch_rad: pitch.to_radians(),
            roll_rad: roll.to_radians(),
        };
        Ok((pose, sent.vfov_deg.map_or(self.settings.vfov_rad, f64::to_radians), size))
    }

    /// The size of a picture for which this one was asked.
    fn size(&self, asked: Option<[u32; 2]>) -> Result<[u32; 2], Cause> {
        let GateSettings { size: largest, has_sizes, .. } = self.settings;
        let Some(size) = asked else { return Ok(largest) };
        let fits = (0..2).all(|axis| (1..=largest[axis]).contains(&size[axis]));
        if size == largest || (has_sizes && fits) { Ok(size) } else { Err(Cause::OtherSize) }
    }

    /// What was not flown as it came, a sentence each.
    #[must_use]
    pub fn summary(&self) -> Vec<String> {
        let mut said = Vec::new();
        let causes = Cause::ALL.into_iter().filter(|cause| self.refused[*cause as usize] > 0);
        let causes: Vec<String> = causes.map(|cause| format!("{} {cause}", self.refused[cause as usize])).collect();
        if !causes.is_empty() {
            let (refused, accepted) = (self.refused(), self.accepted);
            said.push(format!("{refused} of {} poses were refused: {}", refused + accepted, causes.join("; ")));
        }
        if self.lifted > 0 {
            let (lifted, accepted) = (self.lifted, self.accepted);
            said.push(format!(
                "{lifted} of {accepted} frames were lifted: their poses were less than {CLEARANCE_M} m above the ground"
            ));
        }
        said
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec2;
    use proptest::prelude::*;

    struct Flat;

    impl Ground for Flat {
        fn height_m(&self, _x: f64, _y: f64) -> Option<f64> {
            Some(100.0)
        }
    }

    fn gate() -> Gate {
        let extent = Extent { low: DVec2::new(5e5, 4e6), high: DVec2::new(5.1e5, 4.01e6) };
        Gate::new(GateSettings { size: [64, 36], has_sizes: true, vfov_rad: 1.0, extent })
    }

    fn sent(time_s: f64) -> SentPose {
        SentPose {
            position: [505_000.0, 4_005_000.0, 500.0],
            angles_deg: [90.0, -20.0, 0.0],
            vfov_deg: None,
            time_s: Some(time_s),
            size: None,
        }
    }

    #[test]
    fn good_poses_become_cameras_of_the_world() {
        let mut gate = gate();
        let pose = Message::Pose(SentPose { vfov_deg: Some(50.0), ..sent(3.0) });
        let Ok(Incoming::Pose { camera, time_s }) = gate.pass(&pose, &Flat, &mut |_| {}) else { panic!("refused") };
        assert_eq!((camera.fields().eye_in_world, time_s), ([5000.0, 5000.0, 500.0], 3.0));
        assert!((camera.vfov_rad() - 50f64.to_radians()).abs() < 1e-12);
        let low = Message::Pose(SentPose { position: [505_000.0, 4_005_000.0, 5.0], ..sent(4.0) });
        let Ok(Incoming::Pose { camera, .. }) = gate.pass(&low, &Flat, &mut |_| {}) else { panic!("refused") };
        assert_eq!((camera.fields().eye_in_world[2], camera.vfov_rad()), (102.0, 1.0));
        assert_eq!(gate.pass(&Message::End, &Flat, &mut |_| {}), Ok(Incoming::End));
        assert_eq!((gate.accepted(), gate.refused()), (2, 0));
        assert_eq!(gate.summary(), ["1 of 2 frames were lifted: their poses were less than 2 m above the ground"]);
    }

    #[test]
    fn each_cause_is_told_once_and_counted_and_good_poses_still_pass() {
        let mut gate = gate();
        let mut told = Vec::new();
        let with = |change: fn(&mut SentPose)| {
            let mut pose = sent(2.0);
            change(&mut pose);
            Message::Pose(pose)
        };
        assert!(gate.pass(&Message::Pose(sent(1.0)), &Flat, &mut |_| {}).is_ok());
        let bad = [
            (with(|pose| pose.position[2] = f64::NAN), Cause::NotFinite),
            (with(|pose| pose.angles_deg[0] = f64::INFINITY), Cause::NotFinite),
            (with(|pose| pose.time_s = Some(f64::NAN)), Cause::NotFinite),
            (Message::NotFinite, Cause::NotFinite),
            (with(|pose| pose.angles_deg[1] = 90.5), Cause::OutOfRange),
            (with(|pose| pose.vfov_deg = Some(0.0)), Cause::OutOfRange),
            (with(|pose| pose.vfov_deg = Some(180.0)), Cause::OutOfRange),
            (with(|pose| pose.position[0] = 0.0), Cause::FarAway),
            (with(|pose| pose.position[2] = 1e300), Cause::FarAway),
            (with(|pose| pose.time_s = Some(1e300)), Cause::OutOfRange),
            (with(|pose| pose.size = Some([65, 36])), Cause::OtherSize),
            (with(|pose| pose.size = Some([64, 0])), Cause::OtherSize),
            (with(|pose| pose.time_s = Some(1.0)), Cause::FromThePast),
            (with(|pose| pose.time_s = Some(0.5)), Cause::FromThePast),
            (Message::Unreadable, Cause::Unreadable),
        ];
        for (message, cause) in bad {
            let outcome = gate.pass(&message, &Flat, &mut |sentence| told.push(sentence));
            assert_eq!(outcome, Err(Refusal { cause }), "{message:?}");
        }
        assert_eq!(told.len(), 6, "{told:?}");
        assert!(gate.pass(&Message::Pose(sent(1.5)), &Flat, &mut |_| {}).is_ok());
        assert_eq!((gate.accepted(), gate.refused()), (2, 15));
        let summary = gate.summary();
        assert!(summary[0].starts_with("15 of 17 poses were refused: 1 not a JSON object"), "{summary:?}");
        assert!(summary[0].contains("4 with a number that is not finite") && summary[0].contains("2 from the past"));
    }

    #[test]
    fn pictures_are_as_large_as_poses_ask_where_the_flight_can_have_that() {
        let size_of = |gate: &mut Gate, time, size| {
            let pose = Message::Pose(SentPose { size, ..sent(time) });
            match gate.pass(&pose, &Flat, &mut |_| {}) {
                Ok(Incoming::Pose { camera, .. }) => Some([camera.width(), camera.height()]),
                _refused => None,
            }
        };
        let mut any = gate();
        assert_eq!(size_of(&mut any, 1.0, None), Some([64, 36]));
        assert_eq!(size_of(&mut any, 2.0, Some([20, 30])), Some([20, 30]));
        let mut one = Gate::new(GateSettings { has_sizes: false, ..any.settings });
        assert_eq!(size_of(&mut one, 1.0, Some([64, 36])), Some([64, 36]));
        assert_eq!(size_of(&mut one, 2.0, Some([20, 30])), None);
    }

    #[test]
    fn a_sender_that_starts_again_is_flown_again_and_a_late_pose_is_not() {
        let mut gate = gate();
        let mut pass = |time| gate.pass(&Message::Pose(sent(time)), &Flat, &mut |_| {}).is_ok();
        // A time that is wrong, far in the future.
        assert!(pass(1.0) && pass(1e9));
        let flown: Vec<bool> = (0..40).map(|i| pass(1.1 + 0.1 * f64::from(i))).collect();
        assert_eq!(flown.iter().position(|flown| *flown), Some(CLOCK_SET_BACK as usize - 1));
        assert!(flown[CLOCK_SET_BACK as usize - 1..].iter().all(|flown| *flown));
        // Poses that overtake each other never count for a clock.
        for i in 0..200 {
            let t = 100.0 + f64::from(i);
            assert!(pass(t) && !pass(t - 0.5));
        }
    }

    #[test]
    fn poses_without_a_time_come_in_the_order_of_their_arrival() {
        let mut gate = gate();
        let untimed = Message::Pose(SentPose { time_s: None, ..sent(0.0) });
        for message in [Message::Pose(sent(9.0)), untimed, untimed, Message::Pose(sent(10.0))] {
            assert!(gate.pass(&message, &Flat, &mut |_| {}).is_ok());
        }
    }

    proptest! {
        #[test]
        fn whatever_passes_is_a_camera(numbers: [u64; 8]) {
            let number = |i: usize| f64::from_bits(numbers[i]);
            let pose = SentPose {
                position: [number(0), number(1), number(2)],
                angles_deg: [number(3), number(4), number(5)],
                vfov_deg: Some(number(6)),
                time_s: Some(number(7)),
                size: Some([numbers[0] as u32, numbers[1] as u32]),
            };
            if let Ok(Incoming::Pose { camera, .. }) = gate().pass(&Message::Pose(pose), &Flat, &mut |_| {}) {
                prop_assert!(Camera::new(*camera.fields()).is_ok());
            }
        }
    }
}
