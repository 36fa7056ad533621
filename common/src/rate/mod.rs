//! Feedback from measured frame times to the wanted screen resolutions of facets and texels.
//!
//! The number of triangles is proportional to 1/r_z², while pixels cost the same at any r_z. So the
//! controller works on u = log2 r_z, and every frame gives the u that it would have needed: u + ½
//! log2(time / setpoint). If all of the time is spent on triangles this is exact; otherwise the
//! step is too short, never too long. Each sample is relative to the u with which *it* was drawn,
//! so frames that are still in the pipeline after a change do not cause a second change.
//!
//! * **Coarser quickly**: three frames in a row that are clearly too slow move u at once, by the
//!   smallest change that any of them needs. One or two slow frames change nothing.
//! * **Finer slowly**: only frames that were drawn with the current u count, including slow ones,
//!   and the first step is small. Its cost shows which share of the time is spent on triangles, and
//!   so how large the next step may be: if facets cost next to nothing, recovery is quick.
//! * **Dead band**: while the median of a dozen frames lies inside the dead band, u does not
//!   change.
//! * **Patience grows with scatter**: on cores that are shared with other programs, every fifth
//!   frame takes 1.5 to 2 times as long. The controller measures scatter by the differences of
//!   successive frames. "Clearly too slow" means beyond that scatter, and after a change the next
//!   step to finer waits long enough not to look like an oscillation.
//! * **At rest** the dead band does not apply: the picture gets finer step by step, each step only
//!   as far as it fits into the frame time even if all of it is spent on triangles. With the first
//!   frame that moves, u is restored to its value before the rest.
//!
//! r_c follows u: texels cost little time but much memory and bandwidth, and blur is noticed first.
//! Texels keep the wanted size until facets are twice as large as wanted, and then grow with the
//! square root of the facets.

pub mod simulation;
#[cfg(test)]
mod tests;

use bytemuck::{Pod, Zeroable};
use std::collections::VecDeque;

/// The target share of the frame time. The rest is for what no feedback can foresee.
pub const SETPOINT: f64 = 0.82;
/// The dead band, as shares of the frame time. In log2 r_z it is symmetric around the setpoint.
pub const BAND: [f64; 2] = [0.73, 0.92];
/// Up to this share of the frame time, a camera at rest gets a finer picture.
pub const REST_SHARE: f64 = 0.9;

/// Three frames in a row that all need this much more of log2 r_z cause a change at once: 18 % over
/// the setpoint.
const FAST: f64 = 0.12;
const FRAMES_FAST: usize = 3;
/// ... or this many times the scatter of frames, if that is more.
const FAST_SCATTERS: f64 = 2.0;
/// Number of successive frames from whose differences scatter is computed: three quarters of them
/// differ by less than the scatter.
const FRAMES_SCATTER: usize = 48;
const SCATTER_SHARE: f64 = 0.75;
/// Frames that scatter less are calm. Otherwise, steps to coarser and to finer are small, and a
/// step to finer waits after a change: this many seconds for each unit of scatter beyond, up to a
/// maximum.
const CALM: f64 = 0.04;
const PATIENCE_S: f64 = 100.0;
const MOST_PATIENCE_S: f64 = 6.0;
/// A step to finer must leave room for slow frames: this share of frames has to fit.
const SLOW_SHARE: f64 = 0.8;
/// The largest growth of log2 r_z in one change: four times as large.
const MOST_COARSER: f64 = 2.0;
/// The largest first step to finer: 7 % of r_z ...
const FIRST_FINER: f64 = 0.1;
/// ... and the largest step whose cost is predicted from the step before.
const MOST_FINER: f64 = 0.5;
/// The assumed scatter of a median, as a share of it.
const SCATTER: f64 = 0.06;
/// From this much of log2 r_z on, there is time for a much finer picture.
const FAR: f64 = 0.25;
/// Frames from which the median is computed: for small changes, for large changes, and at rest.
const FRAMES_NEAR: usize = 12;
const FRAMES_FAR: usize = 5;
const FRAMES_AT_REST: usize = 3;
/// Largest step at rest, and the smallest that is worth a change.
const REST_STEP: f64 = 0.25;
const LEAST_STEP: f64 = 0.02;
/// A camera that does not move for this long is at rest.
const REST_NANOS: f64 = 0.25e9;
/// Times are clamped to this many octaves around the target.
const MOST_OCTAVES: f64 = 6.0;

/// Timing of a finished frame, from the renderer, for the feedback; stored in the control block.
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
    /// The renderer's own time: from when it began the frame, or finished the one before if that
    /// was later.
    pub work_nanos: u64,
    /// The whole interval, from the end of the frame before.
    pub interval_nanos: u64,
    /// End of its read-back, nanoseconds of the monotonic clock.
    pub finished_nanos: u64,
    /// When its camera was made.
    pub camera_nanos: u64,
}

const _: () = assert!(size_of::<FrameTiming>() == 64);

/// The target, and the limits that the user sets. Pixels, facets first, then texels.
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
    /// The name of the setting.
    pub what: &'static str,
    /// Its value.
    pub found: f64,
    /// What was expected, in words.
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

/// A frame in the units of the controller.
#[derive(Debug, Clone, Copy)]
struct Sample {
    /// log2 of the r_z that it was drawn with.
    u: f64,
    /// log2 of its time over the target.
    octaves: f64,
    /// The log2 r_z that it would have needed.
    needed: f64,
}

/// Chooses r_z and r_c for each frame. Uses no clock, and allocates nothing after construction.
#[derive(Debug, Clone)]
pub struct RateController {
    settings: RateSettings,
    /// log2 of the current r_z.
    u: f64,
    /// log2 of r_z before the rest; `None` while the camera moves.
    moving: Option<f64>,
    /// Frames that have to agree before the picture at rest becomes finer; all frames, once it had
    /// to become coarser.
    agreeing: usize,
    still_frames: u32,
    rest_after: u32,
    /// The newest frames, at any resolution.
    newest: VecDeque<Sample>,
    /// The log2 r_z that the last frame would have needed, and the differences of that between the
    /// newest frames.
    last_needed: Option<f64>,
    differences: VecDeque<f64>,
    /// Frames since the last change of u by feedback.
    unchanged: u32,
    /// The newest frames that were drawn with the current u.
    present: VecDeque<Sample>,
    /// u before the last step to finer, and log2 of its time over the target.
    before: Option<(f64, f64)>,
    scratch: Vec<f64>,
}

impl RateController {
    /// A controller that begins with the wanted resolutions.
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

    /// Records that a frame drawn with `r_z_px` took `work_nanos`. Invalid values are ignored.
    pub fn measured(&mut self, r_z_px: f64, work_nanos: f64) {
        let is_number = |value: f64| value.is_finite() && value > 0.0;
        if !is_number(r_z_px) || !is_number(work_nanos) {
            return;
        }
        let [finest, coarsest] = [self.settings.rest_px[0].log2(), self.settings.coarsest_px[0].log2()];
        let u = r_z_px.log2().clamp(finest, coarsest);
        let octaves = (work_nanos / self.settings.target_nanos).log2().clamp(-MOST_OCTAVES, MOST_OCTAVES);
        let sample = Sample { u, octaves, needed: u + 0.5 * (octaves - SETPOINT.log2()) };
        // A frame that was drawn coarser than now and had time left is no evidence against the
        // finer resolution.
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

    /// The scatter of frames, in log2 r_z: three quarters of successive frames differ by less.
    fn scatter(&mut self) -> f64 {
        quantile(self.differences.iter().copied(), SCATTER_SHARE, &mut self.scratch)
    }

    /// Whether enough frames have passed since the last change for a step to finer.
    fn is_patient(&mut self) -> bool {
        let wait_s = (PATIENCE_S * (self.scatter() - CALM)).min(MOST_PATIENCE_S);
        f64::from(self.unchanged) * self.settings.target_nanos >= 1e9 * wait_s
    }

    /// The resolutions of the next frame; `is_moving`: whether its camera differs from that of the
    /// frame before.
    pub fn next(&mut self, is_moving: bool) -> Resolutions {
        if is_moving {
            self.still_frames = 0;
            if let Some(moving) = self.moving.take() {
                // Coarser than before the rest only if even the picture at rest had to become
                // coarser.
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

    /// The current resolutions.
    #[must_use]
    pub fn resolutions(&self) -> Resolutions {
        let RateSettings { wanted_px, coarsest_px, rest_px, .. } = self.settings;
        // Powers and logarithms round; the wanted values are returned exactly.
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
        // Coarser at once: all of the newest frames need it.
        if self.newest.len() == FRAMES_FAST {
            let needed = self.newest.iter().map(|sample| sample.needed).fold(f64::INFINITY, f64::min);
            let scatter = self.scatter();
            if needed > self.u + FAST.max(FAST_SCATTERS * scatter) {
                // Occasional outliers must not make facets huge; a real change will repeat, or show
                // in the median.
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

    /// The log2 r_z that the newest frames drawn with the current u need: the median, and a high
    /// quantile.
    fn needed(&mut self, count: usize) -> [f64; 2] {
        let newest = || self.present.iter().rev().take(count).map(|sample| sample.needed);
        [0.5, SLOW_SHARE].map(|share| quantile(newest(), share, &mut self.scratch))
    }

    /// A step to finer that surely fits. `needed` is what would fit if all of the time were spent
    /// on triangles.
    fn finer(&mut self, needed: f64) {
        let octaves = 2.0 * (needed - self.u) + SETPOINT.log2();
        let time = octaves.exp2();
        let most = if self.scatter() > CALM { FIRST_FINER } else { MOST_FINER };
        let step = match self.before {
            Some((u, before)) if u > self.u => {
                // Time is a + b / r_z²: two settings determine b / r_z², the part that grows with
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

    /// At rest: the finest resolution that surely fits, judged by the slowest of the last few
    /// frames.
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
            // Slightly too slow for a long time.
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

/// The quantile of values at this share; of two neighbours the lower one, and 0 without values.
fn quantile(values: impl Iterator<Item = f64>, share: f64, scratch: &mut Vec<f64>) -> f64 {
    scratch.clear();
    scratch.extend(values);
    scratch.sort_unstable_by(f64::total_cmp);
    let at = scratch.len().saturating_sub(1) as f64 * share;
    scratch.get(at as usize).copied().unwrap_or(0.0)
}
