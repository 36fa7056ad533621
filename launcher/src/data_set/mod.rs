//! Poses and intrinsics beside the depth and the ground of a flight: `frames.json`, and
//! `transforms.json` as nerfstudio reads it. Only frames whose files are whole are listed; frames
//! of earlier flights into the same folders stay listed.
//!
//! * [`geometry`]: the camera model, as matrices. [`listing`]: the two files. docs/data-sets.md
//!   explains them.

pub mod geometry;
pub mod listing;

use crate::output::{FrameFolder, OutputError};
use listing::{Entry, Head, Listing};
use std::collections::BTreeSet;
use std::io;
use std::path::{Component, Path, PathBuf};
use terravision_common::camera::Camera;
use terravision_common::ids::FrameNumber;
use terravision_common::rig::RigView;
use terravision_common::run::frame_file_name;

/// Lists the frames.
pub const FRAMES_FILE: &str = "frames.json";
/// The same for nerfstudio.
pub const TRANSFORMS_FILE: &str = "transforms.json";

/// A frame's pose, as a camera, in the coordinates of the world (not of its CRS).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlownFrame {
    /// Number in the flight.
    pub frame: FrameNumber,
    /// Seconds: of a path in its film, of poses in the clock of their sender.
    pub time_s: f64,
    /// The camera.
    pub camera: Camera,
}

/// Where the files of a data set go.
#[derive(Debug)]
pub struct DataSet {
    /// What all frames have in common.
    pub head: Head,
    /// Easting and northing of the world's origin.
    pub origin: [f64; 2],
    /// The camera of the rig that they are of; `None` for the pose's own.
    pub view: Option<RigView>,
    /// Folder of depths.
    pub depth: Option<FrameFolder>,
    /// Folder of ground positions.
    pub ground: Option<FrameFolder>,
    /// Folder of pictures, if they go into one.
    pub pictures: Option<PathBuf>,
}

/// What was listed.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub struct Listed {
    /// Frames in the listing, those of earlier flights too.
    pub frames: usize,
    /// Frames of another flight, with other settings, that are no longer listed.
    pub dropped: usize,
    /// Whether `transforms.json` was written.
    pub has_transforms: bool,
}

impl DataSet {
    /// The folder of the listings: that of the pictures, else of the depths, else of the ground.
    #[must_use]
    pub fn folder(&self) -> &Path {
        let planes = || self.planes().next().map(|(folder, _)| folder.path());
        self.pictures.as_deref().or_else(planes).unwrap_or(Path::new("."))
    }

    /// The folders of planes, and the keys of their files in a listing.
    pub fn planes(&self) -> impl Iterator<Item = (&FrameFolder, &'static str)> {
        let folders = [(&self.depth, "depth"), (&self.ground, "ground")];
        folders.into_iter().filter_map(|(folder, key)| Some((folder.as_ref()?, key)))
    }

    /// Frames of a range all of whose planes this run has written.
    #[must_use]
    pub fn whole_frames(&self, frames: [u64; 2]) -> BTreeSet<u64> {
        let whole = self.planes().map(|(folder, _)| folder.whole_frames("tif", frames));
        whole.reduce(|a, b| a.intersection(&b).copied().collect()).unwrap_or_default()
    }

    /// Bytes of the planes of these frames.
    pub fn plane_bytes(&self, frames: &BTreeSet<u64>) -> u64 {
        let sizes = self.planes().flat_map(|(folder, _)| {
            frames.iter().filter_map(|&frame| folder.path().join(frame_file_name(frame, "tif")).metadata().ok())
        });
        sizes.map(|file| file.len()).sum()
    }

    /// Lists these frames, beside those that are listed already. `run` makes the names of temporary
    /// files unique.
    ///
    /// # Errors
    /// The files cannot be read or written.
    pub fn list(&self, flown: &[FlownFrame], run: &str) -> Result<Listed, OutputError> {
        let folder = self.folder();
        let fail = |source: io::Error| OutputError::Write { path: folder.join(FRAMES_FILE), source };
        // Another flight into this folder lists its frames before or after, not meanwhile.
        let lock = crate::output::FolderLock::wait(folder);
        let flown: Vec<FlownFrame> = flown.iter().filter_map(|flown| self.seen_by(flown)).collect();
        let head = self.head.clone().with_vfov(flown.first().map(|flown| &flown.camera));
        let (mut listing, dropped) = Listing::read(&folder.join(FRAMES_FILE), head, folder).map_err(fail)?;
        for flown in &flown {
            let entry = Entry::new(flown, self.origin, |key| self.file(key, flown.frame));
            listing.put(flown.frame.get(), entry).map_err(fail)?;
        }
        let has_transforms = self.pictures.is_some();
        if has_transforms {
            crate::output::TemporaryFile::create_under(&lock, &folder.join(TRANSFORMS_FILE), run)?
                .finish_with(|writer| listing.write_transforms(writer))?;
        }
        crate::output::TemporaryFile::create_under(&lock, &folder.join(FRAMES_FILE), run)?
            .finish_with(|writer| listing.write(writer))?;
        Ok(Listed { frames: listing.len(), dropped, has_transforms })
    }

    /// The frame as the camera of these files has seen it; `None` where the rig has no valid
    /// camera: then nothing was drawn.
    fn seen_by(&self, flown: &FlownFrame) -> Option<FlownFrame> {
        let camera = self.view.as_ref().map_or(Ok(flown.camera), |view| view.camera(&flown.camera)).ok()?;
        Some(FlownFrame { camera, ..*flown })
    }

    /// The name of a frame's file, as seen from the folder of the listings.
    fn file(&self, key: &str, frame: FrameNumber) -> Option<String> {
        let (folder, extension) = match key {
            "color" => (self.pictures.as_deref(), "png"),
            "depth" => (self.depth.as_ref().map(FrameFolder::path), "tif"),
            _ => (self.ground.as_ref().map(FrameFolder::path), "tif"),
        };
        let path = relative(self.folder(), folder?).join(frame_file_name(frame.get(), extension));
        Some(path.to_string_lossy().into_owned())
    }
}

/// A folder as seen from another one: by its name below it, or by way of the folders above.
fn relative(from: &Path, to: &Path) -> PathBuf {
    let absolute = |path: &Path| std::fs::canonicalize(path).or_else(|_| std::path::absolute(path));
    let (Ok(from), Ok(to)) = (absolute(from), absolute(to)) else { return to.to_owned() };
    let shared = from.components().zip(to.components()).take_while(|(a, b)| a == b).count();
    let up = from.components().skip(shared).map(|_| Component::ParentDir);
    up.chain(to.components().skip(shared)).collect()
}

#[cfg(test)]
mod tests;
