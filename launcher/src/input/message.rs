//! What a sender sends: a pose, or the end, or something that is neither.

use serde::Deserialize;
use terravision_common::shm::PoseRecord;

/// A pose as it came in: any numbers. Degrees, metres, the world's CRS.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SentPose {
    /// Easting, northing and height.
    pub position: [f64; 3],
    /// Heading, pitch and roll, degrees.
    pub angles_deg: [f64; 3],
    /// Vertical field of view, degrees; `None` for the flight's.
    pub vfov_deg: Option<f64>,
    /// Seconds in the sender's clock.
    pub time_s: Option<f64>,
    /// Width and height of its picture, pixels; `None` for those of the flight.
    pub size: Option<[u32; 2]>,
}

/// One message of a sender.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Message {
    /// A pose.
    Pose(SentPose),
    /// The flight is over.
    End,
    /// Neither.
    Unreadable,
    /// JSON has no such number, but some programs write it.
    NotFinite,
}

#[derive(Deserialize)]
struct Line {
    x: Option<f64>,
    y: Option<f64>,
    z: Option<f64>,
    heading: Option<f64>,
    pitch: Option<f64>,
    roll: Option<f64>,
    vfov: Option<f64>,
    t: Option<f64>,
    width: Option<u32>,
    height: Option<u32>,
    #[serde(default)]
    end: bool,
}

impl Message {
    /// Of a record in shared memory.
    #[must_use]
    pub fn of_record(record: PoseRecord) -> Self {
        if record.is_end {
            return Self::End;
        }
        Self::Pose(SentPose {
            position: record.position,
            angles_deg: [record.heading_deg, record.pitch_deg, record.roll_deg],
            vfov_deg: (record.vfov_deg != 0.0).then_some(record.vfov_deg),
            time_s: Some(record.time_s),
            size: (record.size != [0; 2]).then_some(record.size),
        })
    }

    /// Of a line of JSON. Unknown keys are ignored; roll, vfov, t, width and height may be missing.
    #[must_use]
    pub fn of_json(text: &[u8]) -> Self {
        let Ok(line) = serde_json::from_slice::<Line>(text) else {
            let has = |word: &[u8]| text.windows(word.len()).any(|part| part == word);
            return if has(b"NaN") || has(b"Infinity") { Self::NotFinite } else { Self::Unreadable };
        };
        if line.end {
            return Self::End;
        }
        let (Some(x), Some(y), Some(z), Some(heading), Some(pitch)) =
            (line.x, line.y, line.z, line.heading, line.pitch)
        else {
            return Self::Unreadable;
        };
        Self::Pose(SentPose {
            position: [x, y, z],
            angles_deg: [heading, pitch, line.roll.unwrap_or(0.0)],
            vfov_deg: line.vfov,
            time_s: line.t,
            // One without the other is no size.
            size: (line.width.is_some() || line.height.is_some())
                .then(|| [line.width, line.height].map(Option::unwrap_or_default)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn lines_are_poses_ends_or_neither() {
        let full = br#"{"x":1,"y":2.5,"z":-3,"heading":4,"pitch":5,"roll":6,"vfov":50,"t":7,"width":320,"height":180,"more":"x"}"#;
        let pose = SentPose {
            position: [1.0, 2.5, -3.0],
            angles_deg: [4.0, 5.0, 6.0],
            vfov_deg: Some(50.0),
            time_s: Some(7.0),
            size: Some([320, 180]),
        };
        assert_eq!(Message::of_json(full), Message::Pose(pose));
        let short = br#"{"x":1,"y":2.5,"z":-3,"heading":4,"pitch":5}"#;
        let short_pose = SentPose { angles_deg: [4.0, 5.0, 0.0], vfov_deg: None, time_s: None, size: None, ..pose };
        assert_eq!(Message::of_json(short), Message::Pose(short_pose));
        assert_eq!(Message::of_json(br#"{"end": true}"#), Message::End);
        assert_eq!(Message::of_json(br#"{"x": NaN, "y": 1}"#), Message::NotFinite);
        for bad in [&b""[..], b"{", b"[1,2]", br#"{"x":1}"#, br#"{"x":"1","y":2,"z":3,"heading":4,"pitch":5}"#, b"\xff"]
        {
            assert_eq!(Message::of_json(bad), Message::Unreadable, "{bad:?}");
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_a_message(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _message = Message::of_json(&bytes);
        }
    }
}
