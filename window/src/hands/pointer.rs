//! The mouse: drags, the wheel and double clicks.

use super::motion::Zoom;
use super::navigate::{drag_ground, drag_sky, look, tilt_about, turn_about};
use super::view::{Point, eye_of};
use super::{Grip, Hands, Purpose};
use glam::DVec3;
use terravision_common::viewer::ViewerPose;

/// Degrees for each pixel of a drag that turns.
const TURN_PER_PIXEL: f64 = 0.3;
/// A drag shorter than this is a click, pixels.
const CLICK_PX: f64 = 4.0;
/// Two clicks within this time and distance are one double click.
const DOUBLE_CLICK_S: f64 = 0.4;
/// A double click goes this share of the way's rest to the place.
pub(super) const FLY_THERE: f64 = 0.35;
/// Pixels of a wheel's turn that count at once, and the logarithm of the factor of one.
const MOST_WHEEL_PX: f64 = 240.0;
const ZOOM_PER_PX: f64 = 0.002;
/// A wheel that turns on within this time, where it is, zooms to the same place.
const WHEEL_S: f64 = 0.35;
const WHEEL_PX: f64 = 3.0;
/// Near the horizon a pixel is a mile: a drag goes this many times the place's distance at most.
const MOST_DRAG: f64 = 4.0;

/// What a drag holds.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Held {
    /// Not known yet: the answer to this question tells.
    Unknown(u64),
    Sky,
    Ground(DVec3),
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Drag {
    grip: Grip,
    start: Point,
    last: Point,
    held: Held,
    is_click: bool,
}

/// A wheel that turns.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Wheel {
    at: Point,
    until_s: f64,
    /// The question for its place.
    id: u64,
    place: Option<DVec3>,
    /// Factors that wait for the place.
    waiting: f64,
}

/// The mouse, and what it holds.
#[derive(Debug, Default)]
pub(super) struct Pointer {
    at: Point,
    pub(super) drag: Option<Drag>,
    wheel: Option<Wheel>,
    /// When and where the last click was.
    clicked: Option<(f64, Point)>,
}

impl Pointer {
    /// Whatever it holds, turns or has clicked does not count any more.
    pub(super) fn let_go(&mut self) {
        (self.drag, self.wheel, self.clicked) = (None, None, None);
    }

    /// The ground has answered what a drag holds.
    pub(super) fn hold(&mut self, id: u64, place: Option<DVec3>) {
        if let Some(drag) = self.drag.as_mut().filter(|drag| drag.held == Held::Unknown(id)) {
            drag.held = place.map_or(Held::Sky, Held::Ground);
        }
    }
}

fn distance([x, y]: Point, [u, v]: Point) -> f64 {
    (x - u).hypot(y - v)
}

impl Hands {
    pub(super) fn press(&mut self, _now_s: f64, grip: Grip) {
        if self.pointer.drag.is_some() {
            return;
        }
        self.stop();
        let at = self.pointer.at;
        let held = Held::Unknown(self.next_id);
        self.ask_place(at, Purpose::Drag);
        self.pointer.drag = Some(Drag { grip, start: at, last: at, held, is_click: true });
    }

    pub(super) fn point(&mut self, at: Point) {
        self.pointer.at = at;
        let Some(mut drag) = self.pointer.drag else { return };
        drag.is_click &= distance(at, drag.start) <= CLICK_PX;
        // Until it is known what is held; the way so far is made up for then.
        if !matches!(drag.held, Held::Unknown(_)) && !drag.is_click {
            let moved = match drag.grip {
                Grip::Ground => self.dragged(&drag, at),
                Grip::Turn => self.turned(&drag, at),
            };
            drag.last = at;
            self.set_pose(moved);
        }
        self.pointer.drag = Some(drag);
    }

    fn dragged(&self, drag: &Drag, at: Point) -> ViewerPose {
        let Held::Ground(place) = drag.held else { return drag_sky(&self.pose, self.size, drag.last, at) };
        let Some(next) = drag_ground(&self.pose, self.size, place, at) else { return self.pose };
        let most = MOST_DRAG * (eye_of(&self.pose) - place).length();
        if (eye_of(&next) - eye_of(&self.pose)).length() > most { self.pose } else { next }
    }

    fn turned(&self, drag: &Drag, at: Point) -> ViewerPose {
        let heading = (at[0] - drag.last[0]) * TURN_PER_PIXEL;
        let pitch = (drag.last[1] - at[1]) * TURN_PER_PIXEL;
        let Held::Ground(place) = drag.held else { return look(&self.pose, heading, pitch) };
        tilt_about(&turn_about(&self.pose, place, heading), place, pitch)
    }

    pub(super) fn release(&mut self, now_s: f64) {
        let Some(drag) = self.pointer.drag.take() else { return };
        if !drag.is_click || drag.grip != Grip::Ground {
            self.pointer.clicked = None;
            return;
        }
        let is_second =
            |(then_s, at): (f64, Point)| now_s - then_s <= DOUBLE_CLICK_S && distance(at, drag.start) <= CLICK_PX;
        if self.pointer.clicked.is_some_and(is_second) {
            self.pointer.clicked = None;
            self.ask_place(drag.start, Purpose::FlyThere);
        } else {
            self.pointer.clicked = Some((now_s, drag.start));
        }
    }

    pub(super) fn wheel(&mut self, now_s: f64, pixels: f64) {
        let factor = (pixels.clamp(-MOST_WHEEL_PX, MOST_WHEEL_PX) * ZOOM_PER_PX).exp();
        let at = self.pointer.at;
        let is_same = |wheel: &Wheel| now_s < wheel.until_s && distance(wheel.at, at) < WHEEL_PX;
        // One place for as long as the wheel turns: it stays under the cursor.
        let wheel = match self.pointer.wheel.filter(is_same) {
            Some(wheel) => wheel,
            None => {
                let id = self.next_id;
                self.ask_place(at, Purpose::Wheel);
                Wheel { at, until_s: 0.0, id, place: None, waiting: 1.0 }
            }
        };
        self.pointer.wheel = Some(Wheel { until_s: now_s + WHEEL_S, waiting: wheel.waiting * factor, ..wheel });
        self.zoom_to_wheel();
    }

    /// The place of a wheel is known; for sky one far ahead, so that the wheel moves on.
    pub(super) fn turn_wheel(&mut self, id: u64, place: Option<DVec3>) {
        let Some(at) = self.pointer.wheel.filter(|wheel| wheel.id == id).map(|wheel| wheel.at) else { return };
        let place = place.unwrap_or_else(|| self.ahead(at));
        self.pointer.wheel = self.pointer.wheel.map(|wheel| Wheel { place: Some(place), ..wheel });
        self.zoom_to_wheel();
    }

    fn zoom_to_wheel(&mut self) {
        let Some(wheel) = &mut self.pointer.wheel else { return };
        let Some(place) = wheel.place else { return };
        let factor = std::mem::replace(&mut wheel.waiting, 1.0);
        self.planned = None;
        self.zoom = Some(Zoom::to(place, factor, self.zoom));
    }
}
