//! What comes out of a run while it goes on: events of the stages, memory of the processes, gauges
//! of the control block.

use super::stage::StageProcess;
use crate::failure::Failure;
use crate::measure::collector::Collector;
use crate::measure::memory::MemoryPeaks;
use crate::measure::metrics::Metrics;
use crate::measure::stats::PrefetchWindow;
use crate::plan::FlightPlan;
use terravision_common::event::Event;
use terravision_common::shm::{Consumer, Control, ShmError, Stage};

/// What is known so far.
pub(super) struct Telemetry {
    events: Vec<(Stage, Consumer<Event>)>,
    pub(super) collector: Collector,
    pub(super) memory: MemoryPeaks,
    pub(super) window: PrefetchWindow,
    pub(super) metrics: Option<Metrics>,
}

impl Telemetry {
    pub(super) fn open(plan: &FlightPlan) -> Result<Self, Failure> {
        let events: Result<Vec<_>, ShmError> =
            Stage::ALL.into_iter().map(|stage| Ok((stage, Consumer::open(&plan.run, stage.events())?))).collect();
        let mut collector = Collector::new(plan.config.frame_numbers().start, plan.cameras.len(), plan.trace.is_some());
        if plan.live.is_some() {
            // Exact flights of poses list each frame with its camera.
            collector = collector.open_ended(plan.report.is_none() && plan.config.realtime.is_some());
        }
        collector.failures.note_told(&plan.warnings);
        Ok(Self {
            events: events.map_err(Failure::failed)?,
            collector,
            memory: MemoryPeaks::default(),
            window: PrefetchWindow::default(),
            metrics: None,
        })
    }

    /// Looks at the processes and the control block; `encoder` is the process id of a film's
    /// encoder.
    pub(super) fn sample(&mut self, control: &Control, stages: &[StageProcess], encoder: Option<u32>) {
        let processes = stages.iter().map(|stage| (stage.stage().name(), stage.pid()));
        self.memory.sample(processes.chain(encoder.map(|pid| ("encoder", pid))));
        self.window.sample(control);
    }

    /// Takes the events that have come.
    pub(super) fn drain(&mut self, control: &Control) {
        let mut tally = self.metrics.as_ref().map(Metrics::tally);
        let clock_start = control.clock_start();
        for (stage, ring) in &mut self.events {
            // At most a ring full at a time, so that a stage that floods its ring cannot keep the
            // launcher from watching.
            for _ in 0..ring.capacity() {
                match ring.try_pop() {
                    Ok(Some(event)) => {
                        tally.iter_mut().for_each(|tally| tally.take(&event, clock_start));
                        self.collector.take(*stage, event);
                    }
                    Ok(None) => break,
                    Err(_corrupt) => {
                        self.collector.malformed_events += 1;
                        break;
                    }
                }
            }
        }
    }
}
