//! What hands do, what they ask of the ground, and what they want besides moving the camera.

use super::view::{Point, Size};
use glam::DVec3;
use terravision_common::viewer::ViewerPose;

/// A key that moves the camera for as long as it is down.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum HeldKey {
    /// Ahead in the level plane; with Shift, look up.
    Up,
    /// Back; with Shift, look down.
    Down,
    /// To the left; with Shift, turn left.
    Left,
    /// To the right; with Shift, turn right.
    Right,
    /// Along the line of sight.
    Forward,
    /// Against the line of sight.
    Backward,
    /// To the left as an aircraft flies.
    LeftWing,
    /// To the right as an aircraft flies.
    RightWing,
    /// Up.
    Rise,
    /// Down.
    Sink,
    /// Nearer to what is in the middle.
    ZoomIn,
    /// Away from it.
    ZoomOut,
}

/// What a mouse button holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Grip {
    /// The ground under the cursor.
    Ground,
    /// Turns and tilts about the point under the cursor.
    Turn,
}

/// Something that hands do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Input {
    /// A key goes down.
    Hold(HeldKey),
    /// A key comes up.
    LetGo(HeldKey),
    /// Whether Shift is down from now on.
    Shift(bool),
    /// The window has lost the keyboard: nothing is held any more.
    Blur,
    /// The cursor is here.
    Point(Point),
    /// A button goes down where the cursor is.
    Press(Grip),
    /// The button comes up.
    Release,
    /// The wheel is turned towards the user, pixels of a page that scrolls.
    Wheel(f64),
    /// Turn until north is up.
    NorthUp,
    /// Back to the start.
    Reset,
    /// Plays the path, where there is one, or pauses it.
    Play,
    /// Whatever moves by itself stops.
    Stop,
    /// The window has this size.
    Resize(Size),
}

impl Input {
    /// Whether it moves the camera by hand, or stops it: a path that is played is paused.
    pub(super) fn takes_the_camera(self) -> bool {
        match self {
            Self::Hold(_) | Self::Press(_) | Self::Wheel(_) | Self::NorthUp | Self::Reset | Self::Stop => true,
            Self::LetGo(_)
            | Self::Shift(_)
            | Self::Blur
            | Self::Point(_)
            | Self::Release
            | Self::Play
            | Self::Resize(_) => false,
        }
    }
}

/// A question about the ground, of a number that its answer repeats.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Question {
    /// What a point of the picture shows.
    Place {
        /// The number.
        id: u64,
        /// The camera.
        pose: ViewerPose,
        /// The picture's size.
        size: Size,
        /// The point.
        at: Point,
    },
    /// How high the ground is there, easting and northing.
    Below([f64; 2]),
}

/// What there is to know of the ground, heights as they are drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Answer {
    /// The place of a question; `None` for sky.
    Place {
        /// The question's number.
        id: u64,
        /// Easting, northing and height.
        place: Option<DVec3>,
    },
    /// How high the ground is under the camera; `None` beside the world.
    Below(Option<f64>),
}
