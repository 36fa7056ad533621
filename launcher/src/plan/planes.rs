//! Where depth and ground of a flight go.

use super::checks::has_extension;
use super::live::shared_name;
use crate::cli::fly::FlyArgs;
use crate::cli::realtime::Mode;
use crate::data_set::DataSet;
use crate::data_set::listing::Head;
use crate::failure::Failure;
use crate::output::FrameFolder;
use crate::rig_file::{RigFile, view_folder};
use anyhow::anyhow;
use std::path::{Path, PathBuf};
use terravision_common::run::{PlaneTarget, RunConfig, SinkConfig};
use terravision_store::Store;

/// Extensions of files that a user may name by mistake in place of a folder.
const FILES: [&str; 9] = ["tif", "tiff", "png", "jpg", "jpeg", "exr", "npy", "npz", "json"];

/// The folders of depth and ground, as asked for and made: one each, or one for each view, or none.
#[derive(Debug, Default)]
pub(super) struct PlaneFolders {
    pub depth: Vec<FrameFolder>,
    pub ground: Vec<FrameFolder>,
}

impl PlaneFolders {
    /// Checks what is asked for, and makes the folders.
    pub(super) fn create(args: &FlyArgs, rig: Option<&RigFile>, run: &str) -> Result<Self, Failure> {
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
        let folders = |path: Option<&Path>| -> Result<Vec<FrameFolder>, Failure> {
            let Some(path) = path else { return Ok(Vec::new()) };
            let paths = match rig {
                Some(rig) => rig.names().map(|name| view_folder(path, name)).collect(),
                None => vec![path.to_owned()],
            };
            paths.iter().map(|path| FrameFolder::create(path, run).map_err(Failure::bad_input)).collect()
        };
        Ok(Self { depth: folders(depth)?, ground: folders(ground)? })
    }

    /// As the renderer is told.
    pub(super) fn targets(&self) -> [Vec<PlaneTarget>; 2] {
        let target = |folder: &FrameFolder| PlaneTarget::Folder(folder.path().to_owned());
        [&self.depth, &self.ground].map(|folders| folders.iter().map(target).collect())
    }

    /// The data sets that come of it, one for each view, if any folder was asked for.
    pub(super) fn into_data_sets(self, config: &RunConfig, database: &Store) -> Vec<DataSet> {
        let crs = &database.manifest().fields().crs;
        let name = crs.epsg.map(|epsg| format!("EPSG:{epsg}")).or_else(|| crs.proj4.clone());
        let count = self.depth.len().max(self.ground.len());
        let (mut depth, mut ground) = (self.depth.into_iter(), self.ground.into_iter());
        let of_view = |index: usize| {
            let view = config.rig.as_ref().and_then(|rig| rig.views().get(index)).cloned();
            let size = view.as_ref().map_or([config.width, config.height], |view| view.size);
            let pictures = match &config.render.sink {
                SinkConfig::PngFolder(folder) if view.is_none() => Some(folder.clone()),
                SinkConfig::EachView(sinks) => match sinks.get(index) {
                    Some(SinkConfig::PngFolder(folder)) => Some(folder.clone()),
                    _ => None,
                },
                _ => None,
            };
            DataSet {
                head: Head::new(name.clone(), crs.name.clone(), size, config.fps, config.exaggeration),
                origin: database.world().fields().origin,
                view,
                depth: depth.next(),
                ground: ground.next(),
                pictures,
            }
        };
        (0..count).map(of_view).collect()
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
