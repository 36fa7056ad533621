//! Poses on their way to the flight, and which frame shows which.

use super::lock;
use crate::picture::{SentPose, now_ms};
use std::collections::VecDeque;
use std::sync::Mutex;
use terravision_common::shm::{PoseRecord, PoseSender};
use terravision_common::viewer::ViewerPose;
use tokio::sync::watch;

/// Poses that are remembered until their frames come.
const KEPT_POSES: usize = 512;
/// Size of pictures until a pilot's window says otherwise.
const FIRST_SIZE: [u32; 2] = [960, 540];
/// Two poses are this far apart in time at least, seconds.
const LEAST_STEP_S: f64 = 1e-6;

/// The sizes that a flight can draw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Room {
    /// The largest.
    pub(crate) size: [u32; 2],
    /// Whether poses may ask for smaller ones.
    pub(crate) has_sizes: bool,
}

#[derive(Debug)]
struct Sending {
    /// Of the flight that there is.
    sender: Option<PoseSender>,
    /// Poses that were sent, the newest last; never empty.
    sent: VecDeque<SentPose>,
    newest: SentPose,
    /// Of the flight that there is.
    room: Room,
    /// Wanted size of pictures.
    size: [u32; 2],
    /// Share of their sides that pictures have while the camera moves.
    share: f64,
    /// Where the camera is is not known yet: an earlier viewer has steered it.
    is_quiet: bool,
}

/// Poses on their way to the flight.
#[derive(Debug)]
pub(crate) struct Poses {
    sending: Mutex<Sending>,
    /// Time of the newest pose.
    pub(crate) changed: watch::Sender<f64>,
}

impl Poses {
    pub(crate) fn new(start: ViewerPose) -> Self {
        let newest = SentPose { pose: start, time_s: now_ms() / 1e3, client: 0, id: 0, received_ms: now_ms() };
        let sent = VecDeque::from([newest]);
        let (room, size) = (Room { size: [0; 2], has_sizes: false }, FIRST_SIZE);
        let sending = Sending { sender: None, sent, newest, room, size, share: 1.0, is_quiet: false };
        Self { sending: Mutex::new(sending), changed: watch::Sender::new(newest.time_s) }
    }

    /// The camera goes there.
    pub(crate) fn send(&self, client: u32, id: u32, pose: ViewerPose) {
        let mut sending = lock(&self.sending);
        let (received_ms, time_s) = (now_ms(), sending.next_time_s());
        sending.replace(SentPose { pose, time_s, client, id, received_ms });
        self.changed.send_replace(time_s);
    }

    /// Pictures are to have this size, as far as the flight has room for it: they are drawn anew.
    pub(crate) fn set_size(&self, size: [u32; 2]) {
        let mut sending = lock(&self.sending);
        if sending.size != size {
            sending.size = size;
            self.again(&mut sending);
        }
    }

    /// The camera moves, or rests, and pictures have this share of their sides meanwhile.
    pub(crate) fn set_share(&self, share: f64) {
        let mut sending = lock(&self.sending);
        let is_larger = share > sending.share;
        sending.share = share;
        if is_larger {
            self.again(&mut sending);
        }
    }

    /// The size that pictures of the newest pose have, where nothing makes them smaller.
    pub(crate) fn size(&self) -> [u32; 2] {
        let sending = lock(&self.sending);
        // Before the first flight of this viewer it is what is asked for.
        let is_known = sending.room.size != [0; 2];
        if is_known && !sending.fits() { sending.room.size } else { sending.size }
    }

    /// The newest pose is drawn anew, as another scene.
    fn again(&self, sending: &mut Sending) {
        if sending.is_quiet {
            return;
        }
        let time_s = sending.next_time_s();
        sending.replace(SentPose { time_s, ..sending.newest });
        self.changed.send_replace(time_s);
    }

    /// A flight has begun: it goes where the camera is.
    pub(crate) fn attach(&self, sender: PoseSender, room: Room) {
        let mut sending = lock(&self.sending);
        (sending.sender, sending.room, sending.is_quiet) = (Some(sender), room, false);
        sending.tell();
    }

    /// A flight goes on that an earlier viewer has steered: it is not told where to go until its
    /// first frame has told where the camera is.
    pub(crate) fn attach_quietly(&self, sender: PoseSender, room: Room) {
        let mut sending = lock(&self.sending);
        (sending.sender, sending.room, sending.is_quiet) = (Some(sender), room, true);
    }

    /// The camera is where a frame of an earlier viewer shows it, which nobody here has moved yet.
    pub(crate) fn adopt(&self, pose: ViewerPose, time_s: f64) -> SentPose {
        let mut sending = lock(&self.sending);
        let adopted = SentPose { pose, time_s, client: 0, id: 0, received_ms: now_ms() };
        sending.remember(adopted);
        // Somebody may have moved it meanwhile.
        if sending.newest.client == 0 {
            sending.newest = adopted;
            self.changed.send_replace(time_s);
        }
        if std::mem::take(&mut sending.is_quiet) {
            // Somebody may have come with another window.
            self.again(&mut sending);
        }
        adopted
    }

    /// The flight has gone.
    pub(crate) fn detach(&self) {
        lock(&self.sending).sender = None;
    }

    /// Where the camera is to be now.
    pub(crate) fn newest(&self) -> SentPose {
        lock(&self.sending).newest
    }

    /// The pose of a time, if it was sent from here.
    pub(crate) fn of_time(&self, time_s: f64) -> Option<SentPose> {
        lock(&self.sending).sent.iter().rev().find(|sent| sent.time_s == time_s).copied()
    }
}

impl Sending {
    fn next_time_s(&self) -> f64 {
        (now_ms() / 1e3).max(self.newest.time_s + LEAST_STEP_S)
    }

    /// Whether the flight can draw the wanted size: it refuses poses with larger ones.
    fn fits(&self) -> bool {
        self.room.has_sizes && (0..2).all(|axis| self.size[axis] <= self.room.size[axis])
    }

    /// What the flight is told; zeros where it has one size only.
    fn told_size(&self) -> [u32; 2] {
        let smaller = |side: u32| ((f64::from(side) * self.share / 2.0).round() as u32 * 2).max(2);
        if !self.fits() {
            [0; 2]
        } else if self.share < 1.0 {
            self.size.map(smaller)
        } else {
            self.size
        }
    }

    fn replace(&mut self, pose: SentPose) {
        self.is_quiet = false;
        self.newest = pose;
        self.remember(pose);
        self.tell();
    }

    fn remember(&mut self, pose: SentPose) {
        self.sent.push_back(pose);
        if self.sent.len() > KEPT_POSES {
            self.sent.pop_front();
        }
    }

    fn tell(&self) {
        let SentPose { pose, time_s, .. } = self.newest;
        let record = PoseRecord {
            position: [pose.x, pose.y, pose.z],
            heading_deg: pose.heading,
            pitch_deg: pose.pitch,
            roll_deg: pose.roll,
            vfov_deg: pose.vfov,
            time_s,
            size: self.told_size(),
            is_end: false,
        };
        self.sender.iter().for_each(|sender| {
            sender.send(&record);
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_grow_and_frames_find_their_poses() {
        let start = ViewerPose { x: 0.0, y: 0.0, z: 9.0, heading: 0.0, pitch: 0.0, roll: 0.0, vfov: 60.0 };
        let poses = Poses::new(start);
        let first = poses.newest();
        for id in 1..=KEPT_POSES as u32 {
            poses.send(3, id, ViewerPose { x: f64::from(id), ..start });
        }
        let newest = poses.newest();
        assert_eq!((newest.id, newest.client, newest.pose.x), (KEPT_POSES as u32, 3, KEPT_POSES as f64));
        assert!(newest.time_s > first.time_s);
        assert_eq!(poses.of_time(newest.time_s), Some(newest));
        assert_eq!(poses.of_time(first.time_s), None);
        poses.adopt(start, 5.0);
        assert_eq!((poses.newest(), poses.of_time(5.0).map(|sent| sent.pose)), (newest, Some(start)));
        let poses = Poses::new(start);
        assert_eq!(poses.adopt(start, 5.0), poses.newest());
    }
}
