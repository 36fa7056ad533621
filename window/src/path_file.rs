//! The path that a window plays, as the launcher hands it over.

use crate::WindowError;
use std::fs::File;
use std::io::{self, Read};
use terravision_common::run::WindowPath;
use terravision_common::viewer::{ViewerPose, poses_from_bytes};

/// Most poses of a path: as many as the launcher takes.
const MOST_POSES: usize = 2_000_000;

/// Reads a path's poses.
///
/// # Errors
/// The file cannot be read, or is not a path.
pub(crate) fn read(path: &WindowPath) -> Result<Vec<ViewerPose>, WindowError> {
    let refuse = |source: io::Error| WindowError::Path { source, path: path.file.clone() };
    let most = (MOST_POSES * size_of::<ViewerPose>()) as u64;
    let mut bytes = Vec::new();
    let mut file = File::open(&path.file).map_err(refuse)?;
    file.by_ref().take(most + 1).read_to_end(&mut bytes).map_err(refuse)?;
    let poses = poses_from_bytes(&bytes);
    let is_path = bytes.len() as u64 <= most && path.fps > 0.0 && poses.iter().all(|pose| pose.fault().is_none());
    if is_path { Ok(poses) } else { Err(refuse(io::ErrorKind::InvalidData.into())) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use terravision_common::viewer::poses_to_bytes;

    #[test]
    fn poses_are_read_and_invalid_ones_refused() {
        let pose = ViewerPose { x: 1.0, y: 2.0, z: 3.0, heading: 4.0, pitch: 5.0, roll: 6.0, vfov: 7.0 };
        let file = std::env::temp_dir().join(format!("tv-window-path-{}", std::process::id()));
        let path = WindowPath { file: file.clone(), fps: 30.0 };
        let read_of = |poses: &[ViewerPose]| {
            std::fs::write(&file, poses_to_bytes(poses)).unwrap();
            read(&path)
        };
        assert_eq!(read_of(&[pose; 3]).unwrap(), [pose; 3]);
        assert!(read_of(&[pose, ViewerPose { pitch: f64::NAN, ..pose }]).is_err());
        std::fs::remove_file(&file).unwrap();
        let message = read(&path).unwrap_err().to_string();
        assert!(message.contains("the path cannot be read") && !message.contains('\n'), "{message}");
    }
}
