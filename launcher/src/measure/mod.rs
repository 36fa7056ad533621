//! What a run measured, while it goes on and afterwards.
//!
//! ```text
//! events of the stages ─▶ collector ─▶ stats ─▶ report (report.json) · trace (trace.json)
//! events, control block ─▶ metrics (Prometheus, while the run goes on)
//! /proc                 ─▶ memory ────▶ stats
//! ```

pub mod collector;
pub mod memory;
pub mod metrics;
pub mod report;
pub mod stats;
mod timing;
pub mod trace;
