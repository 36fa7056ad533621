//! What is to be flown: the validated plan that is made of the command line, the path file and the
//! world. Nothing in it is left to interpret.
//!
//! * [`fly()`], [`still()`], [`view()`]: the plans of these commands, by way of a [`draft`]. [`start`]: where a
//!   person begins.
//!   [`picture_choice`]: how the picture is made.
//! * [`course`], [`pose`]: where the camera goes. [`shown_path`]: a path that a window plays.
//!   [`planes`], [`film`], [`live`]: where frames go, and where poses come from.
//! * [`light`]: where the sun stands.
//! * [`drawing`]: what draws, and how tiles are kept for it. [`supervision`]: what becomes of stages that die.
//!   [`checks`]: single arguments.

mod body;
mod checks;
mod course;
mod draft;
mod drawing;
mod film;
mod fly;
mod light;
mod live;
mod picture_choice;
mod planes;
mod pose;
mod shown_path;
mod start;
mod stereo;
mod still;
pub mod supervision;
mod view;

pub use body::check_hands;
pub use checks::{frame_range, pace, vfov_of_path};
pub use course::{LoadedPath, georeference, load_path};
pub use fly::fly;
pub use picture_choice::DEFAULT_SIZE;
pub use start::start_pose;
pub use still::still;
pub use view::view;

use crate::data_set::DataSet;
use crate::fleet::FleetPlan;
use crate::input::LiveCamera;
use crate::measure::metrics::MetricsSocket;
use crate::output::{FrameFolder, TemporaryFile};
use crate::stream::StreamTarget;
use std::fs::File;
use supervision::RestartRules;
use terravision_common::camera::Camera;
use terravision_common::run::RunConfig;
use terravision_common::shm::{Layout, RunId};
use terravision_store::Store;

/// Names of pictures end with one of these.
const PICTURES: [&str; 7] = ["png", "jpg", "jpeg", "tif", "tiff", "webp", "bmp"];

/// A run of the pipeline, ready to start.
#[derive(Debug)]
pub struct FlightPlan {
    /// The run's name.
    pub run: RunId,
    /// What the stages are told.
    pub config: RunConfig,
    /// The run's shared memory.
    pub layout: Layout,
    /// The camera of each frame, from the first; none when another program sends them.
    pub cameras: Vec<Camera>,
    /// Where poses come from in place of `cameras`.
    pub live: Option<LiveCamera>,
    /// The vehicles, if there are any.
    pub fleet: Option<FleetPlan>,
    /// Files that get their final names at the end.
    pub files: Vec<TemporaryFile>,
    /// Depth and ground of every frame, if they go into files, of each view by itself. Before the
    /// folders of frames, in which their folders may be.
    pub data_sets: Vec<DataSet>,
    /// The folder of frames, or one for each view, if that is where they go.
    pub folders: Vec<FrameFolder>,
    /// The stream, if that is where frames go.
    pub stream: Option<StreamTarget>,
    /// The report, if one is wanted.
    pub report: Option<TemporaryFile>,
    /// The trace, if one is wanted.
    pub trace: Option<TemporaryFile>,
    /// Where figures are served while the run goes on, if they are wanted.
    pub metrics: Option<MetricsSocket>,
    /// What is good to know of the flight, a sentence each.
    pub notes: Vec<String>,
    /// What is done differently than asked, a sentence each.
    pub warnings: Vec<String>,
    /// Whether the run says nothing but warnings and errors.
    pub is_quiet: bool,
    /// The world. The stages use its index as long as it is open.
    pub database: Store,
    /// Where the pictures go, for people.
    pub destination: String,
    /// The poses that a window plays; the window finds the file by its number.
    pub shown_path: Option<File>,
    /// Which deaths of stages the run survives.
    pub restarts: RestartRules,
}
