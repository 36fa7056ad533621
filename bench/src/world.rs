//! The world that is flown over, and what it costs to ingest it.

use crate::cli::Options;
use crate::findings::Findings;
use crate::measurement::Measurement;
use crate::session::sibling;
use anyhow::{Context, bail};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

/// The folder with the database: the one that was named, else the synthetic one, which is made if
/// need be.
///
/// # Errors
/// When it cannot be made.
pub fn database(options: &Options) -> anyhow::Result<PathBuf> {
    if let Some(world) = &options.world {
        return Ok(world.clone());
    }
    let folder = synthetic(options.world_size)?;
    let database = folder.join(DATABASE);
    if !database.join("manifest.json").exists() {
        ingest_into(&folder, &database)?;
    }
    Ok(database)
}

/// Another name when the defaults of ingest change, so that no world of earlier ones is flown over.
const DATABASE: &str = "world-2.tv";

/// Where worlds of benches are kept.
fn cache() -> PathBuf {
    let cache = std::env::var_os("XDG_CACHE_HOME")
        .map(PathBuf::from)
        .or_else(|| Some(PathBuf::from(std::env::var_os("HOME")?).join(".cache")))
        .unwrap_or_else(std::env::temp_dir);
    cache.join("terravision/bench")
}

/// Nodes of the finest level along the side of a sparse world's detailed square.
const DETAILED_NODES: &str = "64";

/// A detailed square in a plain; the side of the whole is doubled so often.
///
/// # Errors
/// When it cannot be made.
pub fn sparse(doublings: u8) -> anyhow::Result<PathBuf> {
    let folder = cache().join(format!("sparse-{DETAILED_NODES}-{doublings}.tv"));
    if !folder.join("manifest.json").exists() {
        std::fs::create_dir_all(cache()).context("cannot make the cache folder")?;
        let doublings = doublings.to_string();
        let [verb, nodes, count, doubled, out] = ["sparse", "--detailed-nodes", DETAILED_NODES, "--doublings", "-o"];
        let words = [verb, nodes, count, doubled, &doublings, out].map(AsRef::<std::ffi::OsStr>::as_ref);
        ingest_program(&[&words[..], &[folder.as_os_str()]].concat())?;
    }
    Ok(folder)
}

/// Folder with `dem.tif` and `ortho.tif`.
fn synthetic(size: u32) -> anyhow::Result<PathBuf> {
    let folder = cache().join(format!("synth-{size}"));
    if !(folder.join("dem.tif").exists() && folder.join("ortho.tif").exists()) {
        std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
        let size = size.to_string();
        let words = ["synth", "--overwrite", "--size", &size, "-o"].map(AsRef::<std::ffi::OsStr>::as_ref);
        ingest_program(&[&words[..], &[folder.as_os_str()]].concat())?;
    }
    Ok(folder)
}

fn ingest_into(folder: &Path, database: &Path) -> anyhow::Result<()> {
    let (dem, ortho) = (folder.join("dem.tif"), folder.join("ortho.tif"));
    ingest_program(&[
        "ingest".as_ref(),
        "--elevation".as_ref(),
        dem.as_os_str(),
        "--color".as_ref(),
        ortho.as_os_str(),
        "--overwrite".as_ref(),
        "-o".as_ref(),
        database.as_os_str(),
    ])
}

fn ingest_program(arguments: &[&std::ffi::OsStr]) -> anyhow::Result<()> {
    let program = sibling("terravision-ingest")?;
    let mut command = Command::new(program);
    let output = command.args(arguments).stdin(Stdio::null()).output().context("cannot start terravision-ingest")?;
    if !output.status.success() {
        bail!("terravision-ingest {arguments:?}: {}", String::from_utf8_lossy(&output.stderr).trim());
    }
    Ok(())
}

/// Ingests the synthetic rasters once more, and says how fast.
///
/// # Errors
/// When that fails.
pub fn ingest(options: &Options, findings: &mut Findings) -> anyhow::Result<()> {
    let folder = synthetic(options.world_size)?;
    let database = folder.join("bench.tv");
    let start = Instant::now();
    ingest_into(&folder, &database)?;
    let seconds = start.elapsed().as_secs_f64();
    let bytes_in = |folder: &Path, names: &[&str]| {
        names.iter().filter_map(|name| Some(folder.join(name).metadata().ok()?.len())).sum::<u64>() as f64
    };
    let written = bytes_in(&database, &["elevation.pmtiles", "color.pmtiles", "nodes.tvn", "manifest.json"]);
    std::fs::remove_dir_all(&database).with_context(|| format!("cannot remove {}", database.display()))?;
    // Elevation float32, colour twice as fine, three bytes.
    let posts = f64::from(options.world_size) * f64::from(options.world_size);
    let pixels = posts * 4.0 + 4.0 * posts * 3.0;
    let mut add = |name: &str, value: f64, unit: &'static str| {
        findings.measurements.push(Measurement::new("ingest", name, value, unit, 1));
    };
    add("source pixels", pixels / 1e6 / seconds, "MB/s");
    add("source posts and texels", 5.0 * posts / 1e6 / seconds, "Mpix/s");
    add("database written", written / 1e6 / seconds, "MB/s");
    add("database against source pixels", written / pixels, "ratio");
    add("time", seconds, "s");
    Ok(())
}
