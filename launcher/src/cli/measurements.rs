//! What a run says about itself, as typed.

use crate::measure::metrics::MetricsAddress;
use clap::Args;
use std::path::PathBuf;

/// What a run says about itself; shared by `fly` and `still`.
#[derive(Debug, Args)]
#[command(next_help_heading = "Measurements")]
pub struct MeasurementArgs {
    /// Write a report of the run, JSON (docs/report.md)
    #[arg(long, value_name = "FILE.json")]
    pub report: Option<PathBuf>,
    /// Write what every process did when, as a trace that Perfetto (ui.perfetto.dev) opens
    #[arg(long, value_name = "FILE.json")]
    pub trace: Option<PathBuf>,
    /// Serve metrics of the run while it goes on, for Prometheus: http://ADDRESS/metrics
    ///
    /// A port alone is on 127.0.0.1, where only this machine can read it; 0 is any free port, and
    /// the run says which. docs/report.md lists the metrics.
    #[arg(long, value_name = "ADDRESS")]
    pub metrics: Option<MetricsAddress>,
}
