//! What the user is told while a flight goes on: that something is not as usual, and what went
//! wrong.

use super::progress::Progress;
use crate::measure::collector::{Collector, RaysMethod};
use crate::plan::FlightPlan;
use terravision_common::run::RaysChoice;
use terravision_common::shm::Control;
use terravision_store::Cause;

/// What was not told yet.
#[derive(Debug)]
pub(super) struct Notices {
    /// Whether it is still to be told what casts rays: in real time the renderer tries.
    rays_are_open: bool,
    is_realtime: bool,
}

impl Notices {
    pub(super) fn new(plan: &FlightPlan) -> Self {
        let render = &plan.config.render;
        let is_realtime = plan.config.realtime.is_some();
        Self { rays_are_open: render.rays == RaysChoice::Auto && is_realtime, is_realtime }
    }

    /// Tells what is new.
    pub(super) fn look(&mut self, collector: &mut Collector, control: &Control, progress: &Progress) {
        if let Some(rays) = collector.rays().filter(|rays| self.rays_are_open && rays.is_final) {
            self.tell_rays(collector, &rays, progress);
        }
        let is_waiting = self.is_realtime && control.clock_start().is_none();
        tell_failures(collector, is_waiting, progress);
    }

    /// Tells at the end what was still open.
    pub(super) fn finish(&mut self, collector: &Collector, progress: &Progress) {
        if let Some(rays) = collector.rays().filter(|_| self.rays_are_open) {
            self.tell_rays(collector, &rays, progress);
        }
    }

    fn tell_rays(&mut self, collector: &Collector, rays: &RaysMethod, progress: &Progress) {
        self.rays_are_open = false;
        progress.say(&format!("--rays auto: {}, {}", collector.device(), rays.description));
    }
}

/// Tells of what goes wrong when it happens for the first time; how often it did is told at the
/// end. `is_waiting`: no picture can be drawn yet.
fn tell_failures(collector: &mut Collector, is_waiting: bool, progress: &Progress) {
    for (cause, message) in collector.failures.take_untold() {
        let then = match Cause::from_name(&cause) {
            // What asking again does not change.
            None | Some(Cause::Cache | Cause::Touched | Cause::Offline | Cause::Changed | Cause::Closed) => "",
            Some(_) if is_waiting => "; the flight begins when the coarsest tiles are there",
            Some(cause) if cause.is_passing() => "; it is asked again",
            Some(_) => "",
        };
        progress.warn(&format!("{message}{then}"));
    }
}
