//! Frame ring and segment of poses of the flight that there is: a thread takes the newest frame and
//! waits for no client.

use crate::hub::{Hub, Pace, Room, Tally};
use crate::picture::{Picture, SentPose};
use std::io;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use terravision_common::shm::{FrameInfo, FrameRingReader, PoseSender, SharedFrame, SharedName};
use terravision_common::viewer::ViewerPose;

/// Between two looks for a frame.
const LOOK_EVERY: Duration = Duration::from_millis(1);
/// Between two looks for a flight, or for frames that nobody sees.
const IDLE: Duration = Duration::from_millis(20);

/// Takes frames until the hub ends.
pub(crate) fn start(hub: Arc<Hub>) -> io::Result<JoinHandle<()>> {
    std::thread::Builder::new().name("frames".into()).spawn(move || {
        let Ok(name) = SharedName::parse(&hub.setup().share) else { return };
        let mut attached: Option<Attached> = None;
        let mut spare = SharedFrame::default();
        while !*hub.ending.borrow() {
            let (number, pid) = {
                let flight = hub.flight.borrow();
                (flight.number, flight.pid)
            };
            if attached.as_ref().is_some_and(|attached| attached.flight != number || attached.reader.is_ended()) {
                attached = None;
                hub.poses.detach();
            }
            if attached.is_none() && pid != 0 {
                attached = attach(&hub, &name, number, pid);
            }
            let Some(flight) = &mut attached else {
                std::thread::sleep(IDLE);
                continue;
            };
            // One of each flight is taken in any case: it says that the flight flies.
            if flight.has_flown && hub.clients() == 0 {
                std::thread::sleep(IDLE);
                continue;
            }
            match flight.reader.read(&mut spare) {
                Ok(true) => spare = flight.show(&hub, spare),
                Ok(false) => std::thread::sleep(LOOK_EVERY),
                Err(error) => {
                    tracing::warn!(%error, "a frame cannot be read");
                    std::thread::sleep(IDLE);
                }
            }
        }
    })
}

/// The segments of a flight.
struct Attached {
    flight: u32,
    reader: FrameRingReader,
    has_flown: bool,
    pace: Pace,
}

/// Opens the segments of this flight, once they are there.
fn attach(hub: &Hub, name: &SharedName, flight: u32, pid: u32) -> Option<Attached> {
    let reader = FrameRingReader::open(name).ok()?;
    // Those of a flight that was killed keep the name until they are replaced.
    if reader.launcher_pid() != pid || reader.is_ended() {
        return None;
    }
    // The launcher of the flight makes it before the ring.
    let sender = PoseSender::open(name).ok()?;
    let settings = hub.flight.borrow().settings.clone();
    // Two eyes are always drawn at the flight's own size.
    let room = Room { size: reader.shape().size, has_sizes: settings.stereo().is_none() };
    if reader.newest() == 0 || hub.pictures.borrow().is_some() {
        hub.poses.attach(sender, room);
    } else {
        // This viewer is the successor of one that died: the camera stays where it is.
        hub.poses.attach_quietly(sender, room);
    }
    Some(Attached { flight, reader, has_flown: false, pace: Pace::new(settings.fps) })
}

impl Attached {
    /// Makes a frame the newest picture. Returns memory for the next.
    fn show(&mut self, hub: &Hub, mut frame: SharedFrame) -> SharedFrame {
        let Some(info) = frame.info else { return frame };
        Tally::count(&hub.tally.frames, 1);
        let sent = hub.sent_pose(info.pose_time_s).unwrap_or_else(|| hub.poses.adopt(pose_of(&info), info.pose_time_s));
        let before = hub.pictures.borrow().clone();
        let is_same = |before: &&Arc<Picture>| before.flight == self.flight && before.sent.time_s == sent.time_s;
        let since = before.as_ref().filter(is_same).map_or_else(Instant::now, |before| before.since);
        let drawn_ms = info.published_nanos as f64 / 1e6;
        let picture = Picture {
            flight: self.flight,
            size: info.size,
            pose: drawn_pose(&sent, &info),
            sent,
            number: info.frame,
            is_settled: info.is_settled,
            drawn_ms,
            since,
            frame: std::mem::take(&mut frame),
        };
        drop(before);
        let picture = Arc::new(picture);
        let replaced = hub.recent.note(Arc::clone(&picture));
        hub.pictures.send_replace(Some(picture));
        if let Some(share) = self.pace.note(drawn_ms, hub.poses.newest().received_ms) {
            hub.poses.set_share(share);
        }
        if !std::mem::replace(&mut self.has_flown, true) {
            hub.note_flying(self.flight);
        }
        // Who still encodes or sends it keeps it.
        replaced.and_then(Arc::into_inner).map_or_else(SharedFrame::default, |picture| picture.frame)
    }
}

fn pose_of(info: &FrameInfo) -> ViewerPose {
    let [x, y, z] = info.position;
    let FrameInfo { heading_deg: heading, pitch_deg: pitch, roll_deg: roll, vfov_deg: vfov, .. } = *info;
    ViewerPose { x, y, z, heading, pitch, roll, vfov }
}

/// The pose as it was sent, whose numbers have not been through radians, but at the height at which
/// it was drawn.
fn drawn_pose(sent: &SentPose, info: &FrameInfo) -> ViewerPose {
    let [_, _, z] = info.position;
    let is_lifted = z > sent.pose.z;
    ViewerPose { z: if is_lifted { z } else { sent.pose.z }, ..sent.pose }
}
