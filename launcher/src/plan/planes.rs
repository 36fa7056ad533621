//! Where depth and ground of a flight go.

use super::checks::has_extension;
use super::live::shared_name;
use crate::cli::fly::FlyArgs;
use crate::cli::realtime::Mode;
use crate::data_set::DataSet;
use crate::data_set::listing::Head;
use crate::failure::Failure;
use crate::output::FrameFolder;
use anyhow::anyhow;
use std::path::{Path, PathBuf};
use terravision_common::run::{PlaneTarget, RunConfig, SinkConfig};
use terravision_store::Store;

/// Extensions of files that a user may name by mistake in place of a folder.
const FILES: [&str; 9] = ["tif", "tiff", "png", "jpg", "jpeg", "exr", "npy", "npz", "json"];

/// The folders of depth and ground, as asked for and made.
#[derive(Debug, Default)]
pub(super) struct PlaneFolders {
    pub depth: Option<FrameFolder>,
    pub ground: Option<FrameFolder>,
}

impl PlaneFolders {
    /// Checks what is asked for, and makes the folders.
    pub(super) fn create(args: &FlyArgs, run: &str) -> Result<Self, Failure> {
        let folders = [("--depth", &args.planes.depth), ("--ground", &args.planes.ground)];
        let [depth, ground] = folders.map(|(_, asked)| asked.as_ref().and_then(Option::as_deref));
        for (flag, asked) in folders {
            match asked {
                Some(Some(path)) => check(flag, path, args.realtime.mode)?,
                Some(None) if args.live.share.is_none() && shared_name(&args.output).is_none() => {
                    return Err(Failure::bad_input(anyhow!(
                        "{flag} without a folder applies to shared frames (-o shared:NAME or --share NAME); for files add a \
                         folder: {flag} {}/",
                        flag.trim_start_matches('-')
                    )));
                }
                _ => {}
            }
        }
        let absolute = |path: &Path| std::path::absolute(path).map(|path| path.components().collect::<PathBuf>()).ok();
        if let (Some(depth), Some(ground)) = (depth, ground)
            && absolute(depth) == absolute(ground)
        {
            return Err(Failure::bad_input(anyhow!(
                "--depth and --ground both name {}: their files have the same names, so each needs its own folder",
                depth.display()
            )));
        }
        let folder = |path: Option<&Path>| {
            path.map(|path| FrameFolder::create(path, run).map_err(Failure::bad_input)).transpose()
        };
        Ok(Self { depth: folder(depth)?, ground: folder(ground)? })
    }

    /// As the renderer is told.
    pub(super) fn targets(&self) -> [Option<PlaneTarget>; 2] {
        [&self.depth, &self.ground]
            .map(|folder| folder.as_ref().map(|folder| PlaneTarget::Folder(folder.path().to_owned())))
    }

    /// The data set that comes of it, if any folder was asked for.
    pub(super) fn into_data_set(self, config: &RunConfig, database: &Store) -> Option<DataSet> {
        if self.depth.is_none() && self.ground.is_none() {
            return None;
        }
        let crs = &database.manifest().crs;
        let name = crs.epsg.map(|epsg| format!("EPSG:{epsg}")).or_else(|| crs.proj4.clone());
        let size = [config.width, config.height];
        Some(DataSet {
            head: Head::new(name, crs.name.clone(), size, config.fps, config.exaggeration),
            origin: database.world().fields().origin,
            depth: self.depth,
            ground: self.ground,
            pictures: match &config.render.sink {
                SinkConfig::PngFolder(folder) => Some(folder.clone()),
                _ => None,
            },
        })
    }
}

/// Whether a flight can have these files.
fn check(flag: &str, path: &Path, mode: Mode) -> Result<(), Failure> {
    if mode == Mode::Realtime {
        return Err(Failure::bad_input(anyhow!(
            "{flag} {}: a flight against the clock leaves frames out, so it writes no depth or ground into files; fly in exact \
             mode, or share the frames (--share NAME {flag})",
            path.display()
        )));
    }
    let is_slashed = path.as_os_str().as_encoded_bytes().ends_with(b"/");
    if path.is_file() || (!is_slashed && !path.is_dir() && has_extension(path, &FILES)) {
        return Err(Failure::bad_input(anyhow!(
            "{flag} {}: expected a folder, e.g. {flag} {}/: a flight writes a TIFF file for every frame",
            path.display(),
            flag.trim_start_matches('-')
        )));
    }
    Ok(())
}
