//! Feedback from measured frame times to the screen resolutions wanted of facets and texels (design
//! §8).
//!
//! Triangles go with 1/r_z², pixels cost the same whatever r_z is. So the controller works on u =
//! log2 r_z, and every frame tells which u it would have needed: u + ½ log2(time / setpoint). Where
//! all of the time is triangles that is right at once, else it goes too short, never too far; and
//! because each sample is taken relative to the u that *it* was drawn with, the frames that are
//! still in the pipeline after a change do not make the controller change twice.
//!
//! * **Coarser fast**: three frames in a row that are clearly too slow move u at once by what all
//!   of them ask for. One or two slow ones move nothing.
//! * **Finer slow**: only frames that were drawn with the present u count, the slow ones among them
//!   too, and the first step is small. What it cost tells how much of the time is triangles, and so
//!   how far the next one may go: where facets cost next to nothing the picture does not have to
//!   creep back.
//! * **Between, nothing**: while the median of a dozen frames lies inside the dead band, u stays as
//!   it is.
//! * **The more frames scatter, the more patience**: on cores that other programs use too, every
//!   fifth frame takes half as long again or twice as long, for no reason of ours. From the
//!   differences of successive frames the controller knows how much they scatter; "clearly too
//!   slow" is beyond that, and after a change the next step to finer waits, long enough that nobody
//!   would call it swinging.
//! * **At rest** the band is left: step by step finer, each step only as far as it fits into the
//!   frame's time even if all of it is triangles. With the first frame that moves, u is what it was
//!   before the rest.
//!
//! r_c follows u: texels cost little time but much memory and bandwidth, and blur is what people
//! see first. They stay as wanted until facets are twice as large as wanted, and then grow with the
//! root of the facets.

pub mod simulation;
#[cfg(test)]
mod tests;

use bytemuck::{Pod, Zeroable};
use std::collections::VecDeque;

/// The share of the frame's time that is aimed at. The rest is for what no feedback can foresee.
pub const SETPOINT: f64 = 0.82;
/// The dead band, shares of the frame's time. In log2 r_z it reaches as far to one side of the
/// setpoint as to the other.
pub const BAND: [f64; 2] = [0.73, 0.92];
/// Up to this share of the frame's time a camera at rest is given a finer picture.
pub const REST_SHARE: f64 = 0.9;

/// Three frames in a row that all ask for this much more of log2 r_z are believed at once: 18 %
/// over the setpoint.
const FAST: f64 = 0.12;
const FRAMES_FAST: usize = 3;
/// ... or for so many times as much as frames scatter, if that is more.
const FAST_SCATTERS: f64 = 2.0;
/// Successive frames whose differences tell how much frames scatter: three quarters of them differ
/// by less than the scatter.
const FRAMES_SCATTER: usize = 48;
const SCATTER_SHARE: f64 = 0.75;
/// Frames that scatter less are calm. Else fast steps and steps to finer stay small, and after a
/// change so many seconds pass for each unit of scatter beyond before there is one, at most so
/// many.
const CALM: f64 = 0.04;
const PATIENCE_S: f64 = 100.0;
const MOST_PATIENCE_S: f64 = 6.0;
/// A step to finer has to leave room for the slow ones too: this share of frames has to fit.
const SLOW_SHARE: f64 = 0.8;
/// Most that log2 r_z grows in one change: to four times as large.
const MOST_COARSER: f64 = 2.0;
/// Most that it shrinks in a first change: 7 % of r_z...
const FIRST_FINER: f64 = 0.1;
/// ... and in one whose cost is foreseen from what the change before cost.
const MOST_FINER: f64 = 0.5;
/// The scatter of a median that is reckoned with, as a share of it.
const SCATTER: f64 = 0.06;
/// From here on there is time for much more.
const FAR: f64 = 0.25;
/// Frames whose median is believed: when little is to be changed, when much is, at rest.
const FRAMES_NEAR: usize = 12;
const FRAMES_FAR: usize = 5;
const FRAMES_AT_REST: usize = 3;
/// Largest step at rest, and the smallest that is worth a change.
const REST_STEP: f64 = 0.25;
const LEAST_STEP: f64 = 0.02;
/// A camera that does not move for this long is at rest.
const REST_NANOS: f64 = 0.25e9;
/// Times outside of this many octaves around the target say no more than these.
const MOST_OCTAVES: f64 = 6.0;

/// What the renderer says of a frame that it has finished, for the feedback; travels through the
/// control block.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct FrameTiming {
    /// The frame's number.
    pub frame: u64,
    /// Counts the frames that were drawn from 1.
    pub sequence: u64,
    /// Screen resolution of facets that its tree was made for, pixels.
    pub r_z_px: f64,
    /// Screen resolution of texels that its tree was made for, pixels.
    pub r_c_px: f64,
    /// What the renderer itself took: from when it began with it, or was done with the one before
    /// if that was later.
    pub work_nanos: u64,
    /// The whole interval, from the end of the frame before.
    pub interval_nanos: u64,
    /// End of its read-back, nanoseconds of the monotonic clock.
    pub finished_nanos: u64,
    /// When its camera was made.
    pub camera_nanos: u64,
}

const _: () = assert!(size_of::<FrameTiming>() == 64);

/// What is to be held, and what the user allows for it. Pixels, facets first, then texels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RateSettings {
    /// Time of a frame, nanoseconds.
    pub target_nanos: f64,
    /// Wanted: the finest while the camera moves.
    pub wanted_px: [f64; 2],
    /// The coarsest that is allowed.
    pub coarsest_px: [f64; 2],
    /// The finest while the camera rests.
    pub rest_px: [f64; 2],
}

/// Why settings cannot be used.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("the {what} of the rate control is {found}, expected {expected}")]
pub struct BadSettings {
    /// Which.
    pub what: &'static str,
    /// What it is.
    pub found: f64,
    /// What it should be, in words.
    pub expected: &'static str,
}

/// Screen resolutions for one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Resolutions {
    /// Of facets, pixels.
    pub r_z_px: f64,
    /// Of texels, pixels.
    pub r_c_px: f64,
}

/// A frame in the controller's own measures.
#[derive(Debug, Clone, Copy)]
struct Sample {
    /// log2 of the r_z that it was drawn with.
    u: f64,
    /// log2 of its time over the target.
    octaves: f64,
    /// The log2 r_z that it would have needed.
    needed: f64,
}

/// Chooses r_z and r_c from frame to frame. Asks no clock and allocates nothing after it was made.
#[derive(Debug, Clone)]
pub struct RateController {
    settings: RateSettings,
    /// log2 of the present r_z.
    u: f64,
    /// What it is when the camera moves; `None` while it does.
    moving: Option<f64>,
    /// Frames that have to agree before the picture at rest becomes finer; all there are, once it
    /// had to become coarser.
    agreeing: usize,
    still_frames: u32,
    rest_after: u32,
    /// The newest frames, whatever they were drawn with.
    newest: VecDeque<Sample>,
    /// What the last frame would have needed, and by how much each of the newest differed in that
    /// from the one before.
    last_needed: Option<f64>,
    differences: VecDeque<f64>,
    /// Frames since u was changed for their sake.
    unchanged: u32,
    /// The newest frames that were drawn with the present u.
    present: VecDeque<Sample>,
    /// u before it became finer, and the log2 time over the target that it had then.
    before: Option<(f64, f64)>,
    scratch: Vec<f64>,
}

impl RateController {
    /// A controller that begins with what is wanted.
    ///
    /// # Errors
    /// [`BadSettings`].
    pub fn new(settings: RateSettings) -> Result<Self, BadSettings> {
        let positive = |what, found: f64| {
            let expected = "a positive number";
            if found.is_finite() && found > 0.0 { Ok(()) } else { Err(BadSettings { what, found, expected }) }
        };
        positive("frame time", settings.target_nanos)?;
        for axis in 0..2 {
            positive("finest resolution at rest", settings.rest_px[axis])?;
            positive("wanted resolution", settings.wanted_px[axis])?;
            positive("coarsest resolution", settings.coarsest_px[axis])?;
            let [rest, wanted, coarsest] =
                [settings.rest_px, settings.wanted_px, settings.coarsest_px].map(|r| r[axis]);
            if rest > wanted {
                let (what, expected) = ("finest resolution at rest", "no more than the wanted one");
                return Err(BadSettings { what, found: rest, expected });
            }
            if coarsest < wanted {
                let (what, expected) = ("coarsest resolution", "no less than the wanted one");
                return Err(BadSettings { what, found: coarsest, expected });
            }
        }
        let rest_after = (REST_NANOS / settings.target_nanos).ceil().clamp(3.0, 1000.0) as u32;
        Ok(Self {
            u: settings.wanted_px[0].log2(),
            settings,
            moving: None,
            agreeing: FRAMES_AT_REST,
            still_frames: 0,
            rest_after,
            newest: VecDeque::with_capacity(FRAMES_FAST + 1),
            last_needed: None,
            differences: VecDeque::with_capacity(FRAMES_SCATTER + 1),
            unchanged: u32::MAX,
            present: VecDeque::with_capacity(FRAMES_NEAR + 1),
            before: None,
            scratch: Vec::with_capacity(FRAMES_SCATTER + 1),
        })
    }

    /// The settings.
    #[must_use]
    pub fn settings(&self) -> &RateSettings {
        &self.settings
    }

    /// Whether the picture is being refined because the camera rests.
    #[must_use]
    pub fn is_resting(&self) -> bool {
        self.moving.is_some()
    }

    /// A frame drawn with `r_z_px` took `work_nanos`. Invalid values are ignored.
    pub fn measured(&mut self, r_z_px: f64, work_nanos: f64) {
        let is_number = |value: f64| value.is_finite() && value > 0.0;
        if !is_number(r_z_px) || !is_number(work_nanos) {
            return;
        }
        let [finest, coarsest] = [self.settings.rest_px[0].log2(), self.settings.coarsest_px[0].log2()];
        let u = r_z_px.log2().clamp(finest, coarsest);
        let octaves = (work_nanos / self.settings.target_nanos).log2().clamp(-MOST_OCTAVES, MOST_OCTAVES);
        let sample = Sample { u, octaves, needed: u + 0.5 * (octaves - SETPOINT.log2()) };
        // A frame that was drawn coarser than is drawn now, and had time over, does not speak
        // against having become finer.
        let is_outdated = u > self.u && sample.needed <= u;
        if !is_outdated {
            push(&mut self.newest, sample, FRAMES_FAST);
        }
        if (u - self.u).abs() < 1e-6 {
            push(&mut self.present, sample, FRAMES_NEAR);
        }
        if let Some(last) = self.last_needed.replace(sample.needed) {
            push(&mut self.differences, (sample.needed - last).abs(), FRAMES_SCATTER);
        }
        self.unchanged = self.unchanged.saturating_add(1);
        self.judge();
    }

    /// By how much of log2 r_z frames differ from one to the next, but for every fourth.
    fn scatter(&mut self) -> f64 {
        quantile(self.differences.iter().copied(), SCATTER_SHARE, &mut self.scratch)
    }

    /// Whether enough frames have passed since the last change for a step to finer.
    fn is_patient(&mut self) -> bool {
        let wait_s = (PATIENCE_S * (self.scatter() - CALM)).min(MOST_PATIENCE_S);
        f64::from(self.unchanged) * self.settings.target_nanos >= 1e9 * wait_s
    }

    /// The resolutions of the next frame; `is_moving`: whether its camera is another than that of
    /// the frame before.
    pub fn next(&mut self, is_moving: bool) -> Resolutions {
        if is_moving {
            self.still_frames = 0;
            if let Some(moving) = self.moving.take() {
                // Coarser than before the rest only if even the picture at rest had to be.
                self.change(moving.max(self.u));
            }
        } else {
            self.still_frames = self.still_frames.saturating_add(1);
            if self.still_frames >= self.rest_after && self.moving.is_none() {
                self.moving = Some(self.u);
                self.agreeing = FRAMES_AT_REST;
            }
        }
        self.resolutions()
    }

    /// The present resolutions.
    #[must_use]
    pub fn resolutions(&self) -> Resolutions {
        let RateSettings { wanted_px, coarsest_px, rest_px, .. } = self.settings;
        // Powers and logarithms round; what is wanted comes out exactly.
        let finest = if self.is_resting() { rest_px[0] } else { wanted_px[0] };
        let r_z_px = self.u.exp2().clamp(finest, coarsest_px[0]);
        let beyond = self.u - wanted_px[0].log2();
        let r_c_px = if beyond >= 0.0 {
            wanted_px[1] * (0.5 * (beyond - 1.0).max(0.0)).exp2()
        } else {
            let whole = (wanted_px[0] / rest_px[0]).log2();
            let share = if whole > 0.0 { (-beyond / whole).min(1.0) } else { 0.0 };
            wanted_px[1] * (rest_px[1] / wanted_px[1]).powf(share)
        };
        Resolutions { r_z_px, r_c_px: r_c_px.clamp(rest_px[1], coarsest_px[1]) }
    }

    fn judge(&mut self) {
        // Coarser, at once: all of the newest frames ask for it.
        if self.newest.len() == FRAMES_FAST {
            let needed = self.newest.iter().map(|sample| sample.needed).fold(f64::INFINITY, f64::min);
            let scatter = self.scatter();
            if needed > self.u + FAST.max(FAST_SCATTERS * scatter) {
                // What is chance now and then must not drive facets out of sight; what is not
                // chance comes again, or is seen by the median.
                let most = if scatter > CALM { FAST } else { MOST_COARSER };
                self.change(needed.min(self.u + most));
                return;
            }
        }
        if self.is_resting() {
            self.refine();
            return;
        }
        let band = BAND.map(|share| 0.5 * (share / SETPOINT).log2());
        let [median_far, slow_far] = self.needed(FRAMES_FAR);
        if self.present.len() >= FRAMES_FAR && slow_far < self.u - FAR && self.is_patient() {
            self.finer(median_far);
        } else if self.present.len() >= FRAMES_NEAR {
            let [median, slow] = self.needed(FRAMES_NEAR);
            if median > self.u + band[1] {
                self.change(median);
            } else if median < self.u + band[0] && slow < self.u + band[1] && self.is_patient() {
                self.finer(median);
            }
        }
    }

    /// What the newest frames drawn with the present u need: half of them, and nearly all.
    fn needed(&mut self, count: usize) -> [f64; 2] {
        let newest = || self.present.iter().rev().take(count).map(|sample| sample.needed);
        [0.5, SLOW_SHARE].map(|share| quantile(newest(), share, &mut self.scratch))
    }

    /// Finer, by what surely fits. `needed` is what would fit if all of the time were triangles.
    fn finer(&mut self, needed: f64) {
        let octaves = 2.0 * (needed - self.u) + SETPOINT.log2();
        let time = octaves.exp2();
        let most = if self.scatter() > CALM { FIRST_FINER } else { MOST_FINER };
        let step = match self.before {
            Some((u, before)) if u > self.u => {
                // Time is a + b / r_z²: two settings give b / r_z² here, of all that grows with
                // finer facets.
                let grown = (time - before.exp2()).max(0.0) + SCATTER * time;
                let triangles = (grown / (1.0 - (2.0 * (self.u - u)).exp2())).min(time);
                (0.5 * (1.0 + (SETPOINT - time) / triangles).log2()).min(most)
            }
            _ => (self.u - needed).min(FIRST_FINER),
        };
        let before = (self.u, octaves);
        self.change(self.u - step);
        self.before = Some(before);
    }

    /// At rest: as much finer as surely fits, judged by the slowest of the last few frames.
    fn refine(&mut self) {
        if self.present.len() < self.agreeing {
            return;
        }
        let slowest =
            self.present.iter().rev().take(self.agreeing).map(|s| s.octaves).fold(f64::NEG_INFINITY, f64::max);
        let step = (0.5 * (REST_SHARE.log2() - slowest)).min(REST_STEP);
        if step >= LEAST_STEP {
            self.change(self.u - step);
        } else if self.present.len() == FRAMES_NEAR {
            // Too slow for long, if not by much.
            let [needed, _] = self.needed(FRAMES_NEAR);
            if needed > self.u + 0.5 * (BAND[1] / SETPOINT).log2() {
                self.change(needed);
            }
        }
    }

    fn change(&mut self, u: f64) {
        let finest = if self.is_resting() { self.settings.rest_px[0] } else { self.settings.wanted_px[0] };
        let u = u.clamp(finest.log2(), self.settings.coarsest_px[0].log2());
        if u < self.u {
            self.newest.retain(|sample| sample.needed > sample.u);
        }
        if (u - self.u).abs() > 1e-9 {
            if u > self.u {
                self.agreeing = FRAMES_NEAR;
            }
            self.u = u;
            self.unchanged = 0;
            self.present.clear();
            self.before = None;
        }
    }
}

fn push<T>(values: &mut VecDeque<T>, value: T, most: usize) {
    if values.len() == most {
        values.pop_front();
    }
    values.push_back(value);
}

/// The value that this share of all values does not exceed, the lower one where it lies between
/// two; 0 of none.
fn quantile(values: impl Iterator<Item = f64>, share: f64, scratch: &mut Vec<f64>) -> f64 {
    scratch.clear();
    scratch.extend(values);
    scratch.sort_unstable_by(f64::total_cmp);
    let at = scratch.len().saturating_sub(1) as f64 * share;
    scratch.get(at as usize).copied().unwrap_or(0.0)
}
