//! `terravision view`, as typed.

use super::draw::DrawArgs;
use super::labels::LabelArgs;
use super::measurements::MeasurementArgs;
use super::realtime::Switch;
use super::supervision::SupervisionArgs;
use super::vehicles::VehicleArgs;
use clap::Args;
use std::path::PathBuf;

/// `terravision view`.
#[derive(Debug, Args)]
#[command(after_long_help = "\
EXAMPLES
  terravision view w.tv
  terravision view w.tv --full-screen --technique mesh
  terravision view w.tv --size 1600x900 --scale 0.5
  terravision view w.tv --path tour.kml --label 'My tour' --scale-bar

Drag holds the ground, right drag or Ctrl+drag turns and tilts, the wheel zooms, a double click
flies there. Arrows, W A S D, Q and E fly; with Shift, arrows turn and the others are faster.
+ and - zoom, N turns north, R goes back to the start, Space plays and pauses the path,
T draws the tree, F11 fills the screen, ? shows these keys, Esc stops. Closing the window, or
Ctrl+Q, ends it (docs/window.md).")]
pub struct ViewArgs {
    /// Frames per second to hold [default: 60 where a GPU draws, else 30]
    #[arg(long, value_name = "N", help_heading = WINDOW_HEADING)]
    pub fps: Option<f64>,
    /// Whether pictures change only between two refreshes of the screen
    ///
    /// 'off' shows them at once, where the desktop allows it: a few milliseconds earlier, and torn
    /// while the camera moves.
    #[arg(long, value_enum, value_name = "on|off", default_value_t = Switch::On, help_heading = WINDOW_HEADING)]
    pub vsync: Switch,
    /// Begin as large as the screen (F11 changes it)
    #[arg(long, help_heading = WINDOW_HEADING)]
    pub full_screen: bool,
    /// Pixels of the picture for each of the screen's, along a side: less is faster, and coarser
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, help_heading = WINDOW_HEADING)]
    pub scale: f64,
    /// A camera path that Space plays and pauses: a file (JSON, KML or KMZ, GPX,
    /// CZML, GeoJSON), or 'orbit'
    ///
    /// The window begins at its first pose. Moving the camera by hand pauses the path, and Space goes
    /// on where it was paused. docs/camera-paths.md describes the files.
    #[arg(long, value_name = "FILE|orbit", help_heading = WINDOW_HEADING)]
    pub path: Option<PathBuf>,
    /// Play the path N times as fast
    #[arg(long, value_name = "N", requires = "path", help_heading = WINDOW_HEADING)]
    pub speed: Option<f64>,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub draw: DrawArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub labels: LabelArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub vehicles: VehicleArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub supervision: SupervisionArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub measurements: MeasurementArgs,
}

/// Heading of the flags about the window.
const WINDOW_HEADING: &str = "Window";
