//! What is known of the frames of a run so far, added up from events.

use crate::measure::timing::ON_TIME_PERIODS;
use terravision_common::event::{Event, EventContent};
use terravision_common::ids::FrameNumber;
use terravision_common::outcome::TileFailure;
use terravision_common::run::RunConfig;

/// Upper bounds of the histogram of frame times, seconds: from a tenth of a frame at 60 Hz to 10 s.
pub(super) const BOUNDS_S: [f64; 14] =
    [0.002, 0.005, 0.01, 0.0167, 0.02, 0.0334, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0];

/// What is known of frames.
#[derive(Debug, Clone, Default)]
pub struct FrameTally {
    first_frame: FrameNumber,
    /// Of a flight against the clock.
    period_nanos: Option<f64>,
    /// Frames drawn.
    pub(super) drawn: u64,
    /// By bound, those above all of them last.
    pub(super) by_time: [u64; BOUNDS_S.len() + 1],
    pub(super) time_s: f64,
    pub(super) late: u64,
    pub(super) skipped: u64,
    last: Option<u64>,
    /// Of the newest frame.
    pub(super) wanted: u64,
    pub(super) lacked: u64,
    /// By [`TileFailure`], in the order of all of them.
    pub(super) unavailable: [u64; TileFailure::ALL.len()],
}

impl FrameTally {
    /// For a run.
    #[must_use]
    pub fn new(config: &RunConfig) -> Self {
        let period_nanos = config.realtime.as_ref().map(|_| config.period_nanos());
        Self { first_frame: config.frame_numbers().start, period_nanos, ..Self::default() }
    }

    /// Takes an event of any stage. `clock_start`: moment of the first frame of a flight against
    /// the clock.
    pub fn take(&mut self, event: &Event, clock_start: Option<u64>) {
        match event.content() {
            Some(EventContent::FrameDone { .. }) => self.frame_done(event, clock_start),
            Some(EventContent::FrameWanted { tiles, .. }) => {
                self.wanted = tiles.into();
                if self.period_nanos.is_none() {
                    // It is prepared when nothing is lacking, or what lacks cannot be read.
                    self.lacked = 0;
                }
            }
            Some(EventContent::FrameLacked { tiles, .. }) => self.lacked = tiles.into(),
            Some(EventContent::TileUnavailable { failure, .. }) => {
                self.unavailable[usize::from(failure.number() - 1)] += 1;
            }
            _ => {}
        }
    }

    fn frame_done(&mut self, event: &Event, clock_start: Option<u64>) {
        let seconds = event.duration_nanos as f64 / 1e9;
        self.drawn += 1;
        self.time_s += seconds;
        self.by_time[BOUNDS_S.iter().position(|bound| seconds <= *bound).unwrap_or(BOUNDS_S.len())] += 1;
        let index = event.frame().since(self.first_frame).unwrap_or(0);
        if let (Some(period), Some(start)) = (self.period_nanos, clock_start) {
            let due = start as f64 + (index as f64 + ON_TIME_PERIODS) * period;
            self.late += u64::from(index > 0 && event.start_nanos as f64 > due);
            // A wrong frame number must not make it count for ever.
            let before = self.last.map_or(index, |last| last + 1);
            self.skipped = self.skipped.saturating_add(index.saturating_sub(before));
        }
        self.last = Some(index);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::report::tests::config;
    use terravision_common::database::{Layer, Tile};
    use terravision_common::node::NodeId;
    use terravision_common::run::RealtimeConfig;

    const MS: u64 = 1_000_000;

    #[test]
    fn frames_are_counted_by_time_and_against_the_clock() {
        let realtime = RealtimeConfig { has_feedback: true, coarsest_px: [40.0, 4.0], rest_px: [3.0, 1.0] };
        let config = RunConfig { realtime: Some(realtime), fps: 100.0, ..config() };
        let mut tally = FrameTally::new(&config);
        let mut take = |content: EventContent, frame: u64, at: u64, took: u64| {
            tally.take(
                &Event::new(content).of_frame(FrameNumber::new(frame)).at(at * MS).lasting(took * MS),
                Some(100 * MS),
            );
        };
        // Moments are 100, 110, 120...; a frame has 20 ms. The first frame is number 5.
        for (frame, at, took) in [(5, 100, 60), (6, 130, 30), (8, 151, 21), (9, 154, 3)] {
            take(EventContent::FrameDone { triangles: 1 }, frame, at, took);
        }
        take(EventContent::FrameWanted { tiles: 99, nodes: 7 }, 9, 0, 0);
        take(EventContent::FrameLacked { tiles: 12, sharp_share: 0.5 }, 9, 0, 0);
        let tile = Tile { layer: Layer::Color, node: NodeId::new(3, 4, 1).unwrap() };
        take(EventContent::TileUnavailable { tile, failure: TileFailure::Damaged }, 9, 0, 0);
        assert_eq!((tally.drawn, tally.late, tally.skipped), (4, 1, 1));
        assert_eq!(tally.by_time.iter().sum::<u64>(), 4);
        assert!((tally.time_s - 0.114).abs() < 1e-9);
        assert_eq!((tally.wanted, tally.lacked, tally.unavailable), (99, 12, [0, 1, 0, 0, 0]));
    }
}
