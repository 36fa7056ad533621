//! A simulated renderer, for tests and plots of the rate control: time = (pixels + triangles /
//! r_z²) · load · noise, with frames in the pipeline between the choice of a resolution and the
//! measured time. Uses no clock, so that results are the same on every machine.

use super::{RateController, Resolutions};
use std::collections::VecDeque;

/// The cost of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cost {
    /// Nanoseconds that do not depend on the resolution.
    pub pixels_nanos: f64,
    /// Nanoseconds of the triangles at an r_z of one pixel.
    pub triangles_nanos: f64,
}

impl Cost {
    /// A frame of `nanos` at `r_z_px`, of which `share` (0 to 1) are triangles.
    #[must_use]
    pub fn of_frame(nanos: f64, r_z_px: f64, share: f64) -> Self {
        Self { pixels_nanos: nanos * (1.0 - share), triangles_nanos: nanos * share * r_z_px * r_z_px }
    }

    /// The time of a frame.
    #[must_use]
    pub fn nanos(&self, r_z_px: f64) -> f64 {
        self.pixels_nanos + self.triangles_nanos / (r_z_px * r_z_px)
    }
}

/// One simulated frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimulatedFrame {
    /// Its resolutions.
    pub resolutions: Resolutions,
    /// Its time, nanoseconds.
    pub nanos: f64,
}

/// The renderer and its controller.
#[derive(Debug, Clone)]
pub struct Simulation {
    cost: Cost,
    controller: Option<RateController>,
    free: Resolutions,
    /// Frames between the choice and the measurement.
    delay: usize,
    /// Half the width of the noise, as a share.
    noise: f64,
    is_contended: bool,
    is_held_up: bool,
    random: u64,
    pipeline: VecDeque<SimulatedFrame>,
    frames: Vec<SimulatedFrame>,
}

impl Simulation {
    /// A simulation with feedback, or with constant resolutions.
    #[must_use]
    pub fn new(cost: Cost, controller: RateController, has_feedback: bool) -> Self {
        Self {
            cost,
            free: controller.resolutions(),
            controller: has_feedback.then_some(controller),
            delay: 2,
            noise: 0.0,
            is_contended: false,
            is_held_up: false,
            random: 0x9e37_79b9_7f4a_7c15,
            pipeline: VecDeque::new(),
            frames: Vec::new(),
        }
    }

    /// Sets the number of frames between choice and measurement.
    #[must_use]
    pub fn with_delay(self, delay: usize) -> Self {
        Self { delay, ..self }
    }

    /// Adds uniform noise of this share to both sides.
    #[must_use]
    pub fn with_noise(self, noise: f64) -> Self {
        Self { noise, ..self }
    }

    /// Simulates cores that another program uses too. Of 480 frames measured there, a fifth took at
    /// least 1.3 times the median, 6 % 1.8 times, 3 % twice; after a slow frame 41 % were slow too;
    /// the others scattered by 20 %.
    #[must_use]
    pub fn with_contention(self) -> Self {
        Self { is_contended: true, noise: 0.2, ..self }
    }

    /// All frames so far.
    #[must_use]
    pub fn frames(&self) -> &[SimulatedFrame] {
        &self.frames
    }

    /// The controller.
    #[must_use]
    pub fn controller(&self) -> Option<&RateController> {
        self.controller.as_ref()
    }

    /// One frame, `load` times as slow as usual.
    pub fn frame(&mut self, load: f64, is_moving: bool) -> SimulatedFrame {
        let resolutions = self.controller.as_mut().map_or(self.free, |controller| controller.next(is_moving));
        let mut nanos = self.cost.nanos(resolutions.r_z_px) * load * (1.0 + self.noise * (2.0 * self.random() - 1.0));
        if self.is_contended {
            let chance = if self.is_held_up { 0.41 } else { 0.15 };
            self.is_held_up = self.random() < chance;
            if self.is_held_up {
                nanos *= 1.3 - 0.4 * (1.0 - self.random()).ln();
            }
        }
        let frame = SimulatedFrame { resolutions, nanos };
        self.frames.push(frame);
        self.pipeline.push_back(frame);
        if self.pipeline.len() > self.delay
            && let Some(done) = self.pipeline.pop_front()
            && let Some(controller) = &mut self.controller
        {
            controller.measured(done.resolutions.r_z_px, done.nanos);
        }
        frame
    }

    /// From 0 to 1 (xorshift64; Marsaglia, 2003).
    fn random(&mut self) -> f64 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        (self.random >> 11) as f64 / (1u64 << 53) as f64
    }
}
