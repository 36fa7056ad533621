//! This program as a process, and those beside it: signals, threads, and what `/proc` tells.

pub mod interrupt;
pub mod orphans;
pub mod signals;
pub mod thread;
pub(crate) mod vitals;

use crate::failure::{ExitStatus, Failure};
use anyhow::{Context, anyhow};
use rustix::process::{Signal, getppid, set_parent_process_death_signal};
use std::path::{Path, PathBuf};

/// Folder of all programs of TerraVision: that of this one.
///
/// # Errors
/// The system does not say where this program is.
pub fn own_folder() -> Result<PathBuf, Failure> {
    let own = std::env::current_exe().context("cannot find the folder of this program").map_err(Failure::failed)?;
    Ok(own.parent().unwrap_or(Path::new("/")).to_owned())
}

/// From now on this process is interrupted when the process that started it, which has this id,
/// ends.
///
/// # Errors
/// It has ended already.
pub fn end_with_parent(parent: u32) -> Result<(), Failure> {
    let set = set_parent_process_death_signal(Some(Signal::INT));
    set.context("cannot ask for the parent's death").map_err(Failure::failed)?;
    let found = getppid().map(|pid| pid.as_raw_pid().cast_unsigned());
    if found != Some(parent) {
        let error = anyhow!("the process {parent} that started this one has ended");
        return Err(Failure { status: ExitStatus::Interrupted, error });
    }
    Ok(())
}
