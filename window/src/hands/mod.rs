//! Hands: pure functions from what they do, and what the ground answers, to poses. They are those
//! of the page (`viewer/web/src/view`), so that who knows one knows the other.
//!
//! ```text
//! Input ──▶ Hands ──▶ pose
//!            │  ▲
//!  Question  ▼  │ Answer (a moment later)
//!           ground
//! ```
//!
//! * [`view`]: what a pose sees. [`navigate`]: poses out of poses. `motion`: what moves by itself.
//! * `pointer`: the mouse. `keys`: keys that are held. `player`: a path that is played.

mod input;
mod keys;
mod motion;
pub mod navigate;
mod player;
mod pointer;
pub mod view;

pub use input::{Answer, Grip, HeldKey, Input, Question};

use glam::DVec3;
use keys::Keys;
use motion::{Planned, Zoom};
use navigate::{above_ground, duration_s};
use player::Player;
use pointer::Pointer;
use terravision_common::viewer::ViewerPose;
use view::{Point, Size, eye_of, ray_through, wrap};

/// Longest step, seconds: a window that did not run for a while does not jump.
const LONGEST_STEP_S: f64 = 0.1;
/// Nearest distance that a zoom leaves, metres.
const NEAREST_ZOOM_M: f64 = 3.0;

/// What hands know of the world, and where they begin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct World {
    /// Its longer side, metres.
    pub side_m: f64,
    /// The middle of its heights as they are drawn, metres.
    pub middle_m: f64,
    /// Where the camera begins, and comes back to.
    pub start: ViewerPose,
}

/// What a place is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Purpose {
    Drag,
    Wheel,
    FlyThere,
    Keys,
    NorthUp,
}

/// The camera in a person's hands.
#[derive(Debug)]
pub struct Hands {
    world: World,
    pose: ViewerPose,
    size: Size,
    ground_m: Option<f64>,
    planned: Option<Planned>,
    zoom: Option<Zoom>,
    player: Option<Player>,
    keys: Keys,
    pointer: Pointer,
    /// Places that were asked for, and what for.
    asked: Vec<(u64, Purpose)>,
    next_id: u64,
    questions: Vec<Question>,
    /// Where the ground was asked for last, and whether the answer is still to come.
    asked_below: Option<[f64; 2]>,
    awaits_below: bool,
    /// Time of the last step, seconds.
    before_s: f64,
}

impl Hands {
    /// At the world's start, or at another pose; `size` is the window's.
    #[must_use]
    pub fn new(world: World, pose: ViewerPose, size: Size) -> Self {
        let mut hands = Self {
            world,
            pose,
            size,
            ground_m: None,
            planned: None,
            zoom: None,
            player: None,
            keys: Keys::default(),
            pointer: Pointer::default(),
            asked: Vec::new(),
            next_id: 1,
            questions: Vec::new(),
            asked_below: None,
            awaits_below: false,
            before_s: 0.0,
        };
        hands.ask_below();
        hands
    }

    /// The same hands, with a path to play: a pose for each frame, `fps` frames a second.
    #[must_use]
    pub fn with_path(mut self, poses: Vec<ViewerPose>, fps: f64) -> Self {
        self.player = Player::new(poses, fps);
        self
    }

    /// Where on the path the camera is, and how long the path takes, seconds; while it is played.
    #[must_use]
    pub fn playing_s(&self) -> Option<[f64; 2]> {
        self.player.as_ref().filter(|player| player.is_playing()).map(Player::progress_s)
    }

    /// Where the camera is.
    #[must_use]
    pub fn pose(&self) -> &ViewerPose {
        &self.pose
    }

    /// Height of the eye above ground, at least a metre.
    #[must_use]
    pub fn clearance_m(&self) -> f64 {
        (self.pose.z - self.ground_m.unwrap_or(self.world.middle_m)).max(1.0)
    }

    /// Whether the camera moves by itself: [`Hands::tick`] is to be called with the display's
    /// frames.
    #[must_use]
    pub fn is_moving(&self) -> bool {
        self.planned.is_some() || self.zoom.is_some() || self.keys.are_held() || self.playing_s().is_some()
    }

    /// Questions since the last call. Their answers come by [`Hands::answer`].
    pub fn take_questions(&mut self) -> Vec<Question> {
        std::mem::take(&mut self.questions)
    }

    /// Something that hands do, at a time in seconds.
    pub fn input(&mut self, now_s: f64, input: Input) {
        if !self.is_moving() {
            self.before_s = now_s;
        }
        if input.takes_the_camera()
            && let Some(player) = &mut self.player
        {
            player.pause();
        }
        match input {
            Input::Hold(key) => self.hold(key),
            Input::LetGo(key) => self.keys.let_go(key),
            Input::Shift(is_down) => self.keys.is_shifted = is_down,
            Input::Blur => {
                self.keys.clear();
                self.pointer.drag = None;
            }
            Input::Point(at) => self.point(at),
            Input::Press(grip) => self.press(now_s, grip),
            Input::Release => self.release(now_s),
            Input::Wheel(pixels) => self.wheel(now_s, pixels),
            Input::NorthUp => self.ask_place(self.middle(), Purpose::NorthUp),
            Input::Reset => self.go_to(self.world.start),
            Input::Play => self.play_or_pause(),
            Input::Stop => self.stop(),
            Input::Resize(size) => self.size = size,
        }
    }

    /// What the ground answers.
    pub fn answer(&mut self, now_s: f64, answer: Answer) {
        if !self.is_moving() {
            self.before_s = now_s;
        }
        match answer {
            Answer::Below(height_m) => {
                self.awaits_below = false;
                self.ground_m = height_m;
                // A camera that plays a path has gone on since, and is not in the ground.
                if self.playing_s().is_some() { self.ask_below() } else { self.set_pose(self.pose) }
            }
            Answer::Place { id, place } => {
                let Some(index) = self.asked.iter().position(|(asked, _)| *asked == id) else { return };
                let (_, purpose) = self.asked.swap_remove(index);
                self.found(purpose, id, place);
            }
        }
    }

    fn found(&mut self, purpose: Purpose, id: u64, place: Option<DVec3>) {
        match purpose {
            Purpose::Drag => self.pointer.hold(id, place),
            Purpose::Wheel => self.turn_wheel(id, place),
            Purpose::FlyThere => {
                if let Some(place) = place {
                    self.go_to(navigate::zoom_to(&self.pose, place, pointer::FLY_THERE, [20.0, f64::INFINITY]));
                }
            }
            Purpose::Keys => self.keys.middle = place,
            Purpose::NorthUp => {
                self.stop();
                self.set_pose(ViewerPose { roll: 0.0, ..self.pose });
                self.planned = Some(Planned::north_up(&self.pose, place));
            }
        }
    }

    /// Moves what moves by itself.
    pub fn tick(&mut self, now_s: f64) {
        let seconds = (now_s - self.before_s).clamp(0.0, LONGEST_STEP_S);
        self.before_s = now_s;
        if let Some(player) = self.player.as_mut().filter(|player| player.is_playing()) {
            // The launcher has lifted it out of the ground.
            let pose = player.step(seconds);
            self.pose = ViewerPose { heading: wrap(pose.heading), ..pose };
            self.ask_below();
            return;
        }
        let mut pose = self.step_keys(&self.pose, seconds);
        if let Some(mut zoom) = self.zoom.take() {
            let (zoomed, goes_on) = zoom.step(&pose, seconds, self.zoom_bounds());
            pose = zoomed;
            self.zoom = goes_on.then_some(zoom);
        }
        if let Some(mut planned) = self.planned.take()
            && let Some(next) = planned.step(&pose, seconds)
        {
            pose = next;
            self.planned = Some(planned);
        }
        self.set_pose(pose);
    }

    /// The flight has lifted the camera out of the ground, say: it is here.
    fn set_pose(&mut self, pose: ViewerPose) {
        let pose = ViewerPose { heading: wrap(pose.heading), ..above_ground(pose, self.ground_m) };
        if pose.fault().is_none() {
            self.pose = pose;
        }
        self.ask_below();
    }

    /// Ends a planned motion where it is.
    fn stop(&mut self) {
        (self.planned, self.zoom) = (None, None);
    }

    fn play_or_pause(&mut self) {
        self.stop();
        match &mut self.player {
            Some(player) if player.is_playing() => player.pause(),
            Some(player) => {
                player.play();
                // What hands hold and have asked for does not move the camera from now on.
                self.keys.clear();
                self.pointer.let_go();
                self.asked.clear();
            }
            None => {}
        }
    }

    /// Flies to a pose.
    fn go_to(&mut self, to: ViewerPose) {
        self.stop();
        let from = self.pose;
        let ground_m = self.ground_m.unwrap_or(self.world.middle_m).min(from.z - 1.0).min(to.z - 1.0);
        let duration_s = duration_s(&from, &to, self.clearance_m());
        self.planned = Some(Planned::Flight { from, to, ground_m, duration_s, passed_s: 0.0 });
    }

    fn middle(&self) -> Point {
        self.size.map(|side| 0.5 * side)
    }

    fn zoom_bounds(&self) -> [f64; 2] {
        [NEAREST_ZOOM_M, 1.5 * self.world.side_m]
    }

    /// A place in the direction of a point, as far away as the ground below is, or somewhat farther.
    fn ahead(&self, at: Point) -> DVec3 {
        eye_of(&self.pose) + ray_through(&self.pose, self.size, at) * (3.0 * self.clearance_m())
    }

    /// Asks what a point shows; returns the question's number through `asked`.
    fn ask_place(&mut self, at: Point, purpose: Purpose) {
        let id = self.next_id;
        self.next_id += 1;
        // A newer question of a purpose is the one that counts.
        self.asked.retain(|(_, other)| *other != purpose);
        self.asked.push((id, purpose));
        self.questions.push(Question::Place { id, pose: self.pose, size: self.size, at });
    }

    /// Asks for the ground under the camera, where that is not known.
    fn ask_below(&mut self) {
        let place = [self.pose.x, self.pose.y];
        if self.awaits_below || self.asked_below == Some(place) {
            return;
        }
        (self.asked_below, self.awaits_below) = (Some(place), true);
        self.questions.push(Question::Below(place));
    }
}

#[cfg(test)]
mod tests;
