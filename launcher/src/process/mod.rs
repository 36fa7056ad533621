//! This program as a process, and those beside it: signals, threads, and what `/proc` tells.

pub mod interrupt;
pub mod orphans;
pub mod signals;
pub mod thread;
pub(crate) mod vitals;

use crate::failure::Failure;
use anyhow::Context;
use std::path::{Path, PathBuf};

/// Folder of all programs of TerraVision: that of this one.
///
/// # Errors
/// The system does not say where this program is.
pub fn own_folder() -> Result<PathBuf, Failure> {
    let own = std::env::current_exe().context("cannot find the folder of this program").map_err(Failure::failed)?;
    Ok(own.parent().unwrap_or(Path::new("/")).to_owned())
}
