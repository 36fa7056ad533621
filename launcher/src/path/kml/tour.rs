//! Tours: `gx:FlyTo` with a view, and `gx:Wait`.
//!
//! A FlyTo of mode `smooth` is a knot of a curve without corner; one of mode `bounce` (KML's
//! default) starts and ends at rest and rises over the way between. The first FlyTo is where the
//! flight begins, its duration has no meaning here. A FlyTo of no duration is a cut, one without a
//! view a wait. What waits before the first view waits at it.

use super::super::spline::{Key, Spline};
use super::super::xml::Node;
use super::super::{Course, PathError};
use super::is_view;
use super::view::ViewReader;

/// How high a bounce rises half-way, as a part of the way's length.
const BOUNCE_RISE: f64 = 0.15;

/// The steps of a tour; some programs leave out the playlist around them.
pub(super) fn steps<'d>(tour: Node<'d>) -> impl Iterator<Item = Node<'d>> {
    tour.child("Playlist").unwrap_or(tour).children()
}

fn view<'d>(step: Node<'d>) -> Option<Node<'d>> {
    step.children().find(|node| is_view(*node))
}

/// Whether there is something to see in a tour.
pub(super) fn has_view(tour: Node<'_>) -> bool {
    steps(tour).any(|step| step.name() == "FlyTo" && view(step).is_some())
}

/// The flight of a tour that has a view.
pub(super) fn course(tour: Node<'_>, reader: &mut ViewReader<'_>) -> Result<Course, PathError> {
    let mut flight = Flight::default();
    for step in steps(tour) {
        match (step.name(), view(step)) {
            ("FlyTo", Some(view)) => {
                let duration = reader.duration(step)?;
                let is_bounce = reader.word(step, "flyToMode", &["bounce", "smooth"]) == "bounce";
                let pose = reader.pose(view)?;
                flight.fly_to(Key { t: 0.0, pose, is_stop: is_bounce, hop_m: 0.0 }, duration);
            }
            ("FlyTo" | "Wait", _) => flight.wait(reader.duration(step)?),
            // Sounds, pauses and balloons have no picture of the terrain; `unflown` tells of them.
            _ => {}
        }
    }
    flight.pieces.extend(Spline::new(&flight.keys));
    Ok(Course::Timed(flight.pieces))
}

/// A flight in the making.
#[derive(Default)]
struct Flight {
    pieces: Vec<Spline>,
    /// Keys since the last cut.
    keys: Vec<Key>,
    /// Seconds that were waited before the first view.
    early: f64,
}

impl Flight {
    fn fly_to(&mut self, key: Key, duration: f64) {
        let Some(last) = self.keys.last_mut() else {
            self.keys.push(key);
            let early = std::mem::take(&mut self.early);
            self.wait(early);
            return;
        };
        // A step so short that the time does not grow by it is a cut, too.
        let t = last.t + duration;
        if t > last.t {
            if key.is_stop {
                last.is_stop = true;
                last.hop_m = BOUNCE_RISE * last.pose.position.distance(key.pose.position);
            }
            self.keys.push(Key { t, ..key });
        } else {
            self.pieces.extend(Spline::new(&self.keys));
            self.keys = vec![Key { t, ..key }];
        }
    }

    fn wait(&mut self, duration: f64) {
        match self.keys.last_mut() {
            None => self.early += duration,
            Some(last) if last.t + duration > last.t => {
                last.is_stop = true;
                let rest = Key { t: last.t + duration, hop_m: 0.0, ..*last };
                self.keys.push(rest);
            }
            Some(_) => {}
        }
    }
}
