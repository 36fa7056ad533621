//! Where vehicles are in each frame, out of the vehicle table, and who draws them.

use crate::technique::NEAR_M;
use std::sync::Arc;
use terravision_common::ids::FrameNumber;
use terravision_common::light::Sun;
use terravision_common::shm::{RunId, ShmError, VehicleTableReader};
use terravision_common::vehicle::{VehicleRecord, VehiclesConfig};
use terravision_vehicles::model::ModelError;
use terravision_vehicles::painter::Painter;

/// Why vehicles cannot be drawn.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VehicleFeedError {
    /// A model cannot be read.
    #[error(transparent)]
    Model {
        /// Why.
        #[from]
        source: ModelError,
    },
    /// The table cannot be opened, or not be believed.
    #[error(transparent)]
    Table {
        /// Why.
        #[from]
        source: ShmError,
    },
    /// The table does not have a frame that waits for it.
    #[error("the vehicle table does not say where the vehicles of frame {frame} are")]
    NoFrame {
        /// The frame.
        frame: FrameNumber,
    },
}

/// The vehicles of frames, in the order of frames.
#[derive(Debug)]
pub struct VehicleFeed {
    table: VehicleTableReader,
    painter: Arc<Painter>,
    has_gaps: bool,
    /// Against the clock: those of the frame before.
    newest: Vec<VehicleRecord>,
}

impl VehicleFeed {
    /// Of a run; `has_gaps`: against the clock, where vehicles that are not known yet stay where
    /// they were.
    ///
    /// # Errors
    /// [`VehicleFeedError`].
    pub fn open(
        run: &RunId,
        config: &VehiclesConfig,
        sun: Option<Sun>,
        has_gaps: bool,
    ) -> Result<Self, VehicleFeedError> {
        let painter = Painter::new(config, sun, NEAR_M)?;
        Ok(Self::new(VehicleTableReader::open(run)?, painter, has_gaps))
    }

    /// Likewise, of a table that was opened.
    #[must_use]
    pub fn new(table: VehicleTableReader, painter: Painter, has_gaps: bool) -> Self {
        Self { table, painter: Arc::new(painter), has_gaps, newest: Vec::new() }
    }

    /// Who draws them.
    #[must_use]
    pub fn painter(&self) -> Arc<Painter> {
        Arc::clone(&self.painter)
    }

    /// Those of a frame.
    ///
    /// # Errors
    /// The table has not got them, and nothing may be left out; or it is corrupt.
    pub fn of_frame(&mut self, frame: FrameNumber) -> Result<Vec<VehicleRecord>, VehicleFeedError> {
        match self.table.read(frame)? {
            Some((_, vehicles)) if self.has_gaps => {
                self.newest.clone_from(&vehicles);
                Ok(vehicles)
            }
            Some((_, vehicles)) => Ok(vehicles),
            None if self.has_gaps => Ok(self.newest.clone()),
            None => Err(VehicleFeedError::NoFrame { frame }),
        }
    }
}
