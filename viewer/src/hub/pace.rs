//! Smaller pictures while the camera moves, where the flight does not hold its rate with whole ones.

use crate::picture::REST_AFTER;

/// Shares of a picture's sides, the whole first.
const SHARES: [f64; 3] = [1.0, 0.75, 0.5];
/// Frames a second of a flight that is not told another rate.
const USUAL_FPS: f64 = 30.0;
/// Frames that take this many times as long as they should are too slow, ...
const SLOW: f64 = 1.6;
/// ... and those that take at most this many times as long leave time for larger ones.
const QUICK: f64 = 1.1;
/// This many slow frames in a row decide for smaller pictures, ...
const SLOW_FRAMES: u32 = 6;
/// ... and this many quick ones for larger ones: going to and fro is worse than either.
const QUICK_FRAMES: u32 = 60;

/// Watches how quickly frames come while the camera moves.
#[derive(Debug)]
pub(crate) struct Pace {
    period_ms: f64,
    before_ms: f64,
    step: usize,
    slow: u32,
    quick: u32,
    /// The share that was told last.
    told: f64,
}

impl Pace {
    /// Of a flight that is to draw this many frames a second.
    pub(crate) fn new(fps: Option<f64>) -> Self {
        let period_ms = 1e3 / fps.unwrap_or(USUAL_FPS);
        Self { period_ms, before_ms: f64::NAN, step: 0, slow: 0, quick: 0, told: 1.0 }
    }

    /// A frame was drawn at this moment; the newest pose came at that one. Which share of their
    /// sides pictures are to have from now on, where it changes.
    pub(crate) fn note(&mut self, drawn_ms: f64, pose_ms: f64) -> Option<f64> {
        let took_ms = drawn_ms - std::mem::replace(&mut self.before_ms, drawn_ms);
        let moves = drawn_ms - pose_ms < 1e3 * REST_AFTER.as_secs_f64();
        if moves {
            let is = |is_so: bool, count: u32| if is_so { count + 1 } else { 0 };
            self.slow = is(took_ms > SLOW * self.period_ms, self.slow);
            self.quick = is(took_ms < QUICK * self.period_ms, self.quick);
            if self.slow >= SLOW_FRAMES && self.step + 1 < SHARES.len() {
                (self.step, self.slow) = (self.step + 1, 0);
            } else if self.quick >= QUICK_FRAMES && self.step > 0 {
                (self.step, self.quick) = (self.step - 1, 0);
            }
        }
        let share = if moves { SHARES[self.step] } else { 1.0 };
        (std::mem::replace(&mut self.told, share) != share).then_some(share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slow_frames_become_smaller_while_the_camera_moves_and_whole_at_rest() {
        let (mut pace, mut now) = (Pace::new(Some(20.0)), 0.0);
        let mut fly = |took_ms: f64, frames: u32, moves: bool| {
            let mut last = None;
            for _ in 0..frames {
                now += took_ms;
                last = pace.note(now, if moves { now - 10.0 } else { now - 500.0 }).or(last);
            }
            last
        };
        assert_eq!(fly(50.0, 50, true), None);
        assert_eq!(fly(120.0, 6, true), Some(0.75));
        assert_eq!(fly(120.0, 30, true), Some(0.5));
        assert_eq!(fly(120.0, 3, false), Some(1.0));
        assert_eq!(fly(50.0, 1, true), Some(0.5));
        assert_eq!(fly(50.0, 59, true), Some(0.75));
        assert_eq!(fly(50.0, 60, true), Some(1.0));
    }
}
