//! JPEG files of pictures: each picture is encoded once in each quality, for all clients, and only
//! when a client is to have it.

use crate::jpeg::{JpegError, JpegQuality, encode};
use crate::picture::{Level, Picture, Scene};
use bytes::Bytes;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Files that are kept: clients of one moment want the same one or two.
const KEPT_FILES: usize = 4;
/// Times that the median is of.
const KEPT_TIMES: usize = 64;

/// Why a picture does not become a file.
#[derive(Debug, thiserror::Error)]
pub(crate) enum EncodeError {
    /// The encoder refuses.
    #[error("a picture cannot be encoded: {0}")]
    Encoder(#[from] JpegError),
    /// The process is about to end.
    #[error("the viewer is about to end")]
    Ending,
}

#[derive(Debug)]
struct Kept {
    scene: Scene,
    number: u64,
    level: Level,
    file: Bytes,
}

/// Encodes pictures, one at a time.
#[derive(Debug, Default)]
pub(crate) struct Encoder {
    kept: tokio::sync::Mutex<VecDeque<Kept>>,
    times_ms: Mutex<VecDeque<f64>>,
}

impl Encoder {
    /// The picture as a JPEG. Who asks for one that is just being encoded waits for it.
    pub(crate) async fn jpeg(&self, picture: &Arc<Picture>, level: Level) -> Result<Bytes, EncodeError> {
        let mut kept = self.kept.lock().await;
        let (scene, number) = (picture.scene(), picture.number);
        let is_it = |kept: &&Kept| kept.scene == scene && kept.number == number && kept.level == level;
        if let Some(kept) = kept.iter().find(is_it) {
            return Ok(kept.file.clone());
        }
        let picture = Arc::clone(picture);
        let begun = Instant::now();
        let quality = JpegQuality { quality: level.quality(), has_halved_chroma: level == Level::Moving };
        let encoded = tokio::task::spawn_blocking(move || encode(&picture.frame.rgba, picture.size, quality)).await;
        let file = Bytes::from(encoded.map_err(|_ending| EncodeError::Ending)??);
        let mut times = self.times_ms.lock().unwrap_or_else(PoisonError::into_inner);
        times.push_back(begun.elapsed().as_secs_f64() * 1e3);
        if times.len() > KEPT_TIMES {
            times.pop_front();
        }
        if kept.len() >= KEPT_FILES {
            kept.pop_front();
        }
        kept.push_back(Kept { scene, number, level, file: file.clone() });
        Ok(file)
    }

    /// The median of the times that the last pictures took.
    pub(crate) fn median_ms(&self) -> Option<f64> {
        median(&self.times_ms.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// The median of some numbers.
pub(crate) fn median(numbers: &VecDeque<f64>) -> Option<f64> {
    let mut sorted: Vec<f64> = numbers.iter().copied().collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_is_in_the_middle() {
        assert_eq!(median(&VecDeque::from([3.0, 1.0, 2.0])), Some(2.0));
        assert_eq!(median(&VecDeque::new()), None);
    }
}
