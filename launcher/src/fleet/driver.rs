//! The driver: writes the vehicle table, frame by frame.

use super::FleetPlan;
use crate::ground::WorldGround;
use terravision_common::database::TileSource;
use terravision_common::ids::FrameNumber;
use terravision_common::shm::{Control, TableHead, VehicleTableWriter, WaitError};
use terravision_common::vehicle::VehicleRecord;

/// Frames that are written before their time comes, against the clock.
const AHEAD: u64 = 16;

/// Writes where vehicles are, of one thread.
#[derive(Debug)]
pub struct Driver<'a> {
    plan: &'a FleetPlan,
    ground: WorldGround<'a>,
    table: VehicleTableWriter,
    first: u64,
    fps: f64,
    /// Against the clock: the frame that comes next.
    next: u64,
    records: Vec<VehicleRecord>,
}

impl<'a> Driver<'a> {
    /// For frames from `first` on, `fps` a second.
    #[must_use]
    pub fn new(plan: &'a FleetPlan, table: VehicleTableWriter, first: u64, fps: f64) -> Self {
        let database = &plan.database;
        let source: &dyn TileSource = database;
        let ground = WorldGround::finest(source, database.world(), plan.exaggeration).bounded(database.ranges());
        Self { plan, ground, table, first, fps, next: first, records: Vec::new() }
    }

    /// The vehicles of a frame, before it is asked for; waits until the frame whose place they take
    /// is written.
    ///
    /// # Errors
    /// The run ended.
    pub fn drive(&mut self, frame: u64, control: &Control) -> Result<(), WaitError> {
        // Sinks of several threads write frames in any order; half of the table is more than they
        // are apart.
        let before = (frame - self.first).saturating_sub(self.table.frames() / 2);
        control.wait_written(before)?;
        self.write(frame);
        Ok(())
    }

    /// The vehicles of the frames about now.
    pub fn drive_by_the_clock(&mut self, now: u64) {
        for frame in self.next.max(now.saturating_sub(AHEAD))..=now + AHEAD {
            self.write(frame);
            self.next = frame + 1;
        }
    }

    fn write(&mut self, frame: u64) {
        let time_s = self.plan.time(frame, self.fps);
        self.plan.fleet.at(time_s, &self.ground, self.plan.database.world(), &mut self.records);
        self.table.write(TableHead { frame: FrameNumber::new(frame), time_s }, &self.records);
    }
}
