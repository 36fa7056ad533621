//! Flights of the program `terravision`, started as a user would start them, and their reports.

use crate::cli::Options;
use crate::session::sibling;
use anyhow::{Context, bail};
use serde_json::json;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use terravision_common::report::Report;

/// A flight over a world, into nowhere, that writes its report into this file.
///
/// # Errors
/// When the program is not beside this one.
pub fn command(world: impl AsRef<OsStr>, report: &Path, options: &Options) -> anyhow::Result<Command> {
    let mut command = Command::new(sibling("terravision")?);
    command.arg("fly").arg(world).args(["--quiet", "-o", "/dev/null"]).arg("--report").arg(report);
    command.arg("--facet-px").arg(options.facet_px.to_string()).arg("--texel-px").arg(options.texel_px.to_string());
    command.arg("--memory").arg(format!("{}MiB", options.memory_mib)).stdin(Stdio::null());
    Ok(command)
}

/// Writes a path with a pose per frame for pictures of the benches' size. Returns the file.
///
/// # Errors
/// When it cannot be written.
pub fn write_path(folder: &Path, poses: &[serde_json::Value], fps: f64, options: &Options) -> anyhow::Result<PathBuf> {
    let path = folder.join("path.json");
    let [width, height] = options.size;
    let text = json!({"width": width, "height": height, "vfov_deg": 60, "fps": fps, "frames": poses});
    std::fs::write(&path, text.to_string()).with_context(|| format!("cannot write {}", path.display()))?;
    Ok(path)
}

/// A flight that is under way. It does not outlive this value.
#[derive(Debug)]
pub struct Launched {
    child: Child,
    report: PathBuf,
}

impl Launched {
    /// Starts a flight that writes its report into this file.
    ///
    /// # Errors
    /// When the system does not start it.
    pub fn start(mut command: Command, report: PathBuf) -> anyhow::Result<Self> {
        let program = command.get_program().to_owned();
        let child = command.spawn().with_context(|| format!("cannot start {}", program.display()))?;
        Ok(Self { child, report })
    }

    /// Process id of the launcher.
    #[must_use]
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Whether it has ended well.
    ///
    /// # Errors
    /// When it has failed.
    pub fn has_ended(&mut self) -> anyhow::Result<bool> {
        let status = self.child.try_wait().context("cannot wait for the flight")?;
        status.map_or(Ok(false), |status| succeeded(status).map(|()| true))
    }

    /// Waits for its end and reads its report.
    ///
    /// # Errors
    /// When it has failed, or there is no report.
    pub fn wait(mut self) -> anyhow::Result<Report> {
        succeeded(self.child.wait().context("cannot wait for the flight")?)?;
        let text = std::fs::read(&self.report).with_context(|| format!("cannot read {}", self.report.display()))?;
        serde_json::from_slice(&text).with_context(|| format!("{} is not a report", self.report.display()))
    }
}

fn succeeded(status: ExitStatus) -> anyhow::Result<()> {
    if !status.success() {
        bail!("the flight ended with {status}");
    }
    Ok(())
}

impl Drop for Launched {
    fn drop(&mut self) {
        // Fails when it has ended, as it should have.
        self.child.kill().unwrap_or_default();
        drop(self.child.wait());
    }
}
