//! JPEG files of pictures: each picture is encoded once in each quality, for all clients, and only
//! when a client is to have it.

use crate::picture::{Level, Picture, Scene};
use bytes::Bytes;
use jpeg_encoder::{ColorType, EncodingError, SamplingFactor};
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
    Encoder(#[from] EncodingError),
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
        let encoded = tokio::task::spawn_blocking(move || encode(&picture.frame.rgba, picture.size, level)).await;
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

fn encode(rgba: &[u8], [width, height]: [u32; 2], level: Level) -> Result<Vec<u8>, EncodingError> {
    let mut file = Vec::with_capacity(rgba.len() / 16);
    let mut encoder = jpeg_encoder::Encoder::new(&mut file, level.quality());
    let halved = SamplingFactor::F_2_2;
    encoder.set_sampling_factor(if level == Level::Moving { halved } else { SamplingFactor::F_1_1 });
    let [width, height] = [width, height].map(|side| u16::try_from(side).unwrap_or(u16::MAX));
    encoder.encode(rgba, width, height, ColorType::Rgba)?;
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn better_quality_is_a_larger_file_and_sizes_may_be_odd() {
        let rgba: Vec<u8> = (0..63 * 31).flat_map(|i: u32| [i as u8, (i / 7) as u8, (i * i) as u8, 255]).collect();
        let sizes = [Level::Moving, Level::Rest].map(|level| encode(&rgba, [63, 31], level).unwrap().len());
        assert!(sizes[0] > 300 && sizes[1] > sizes[0], "{sizes:?}");
    }

    #[test]
    fn the_median_is_in_the_middle() {
        assert_eq!(median(&VecDeque::from([3.0, 1.0, 2.0])), Some(2.0));
        assert_eq!(median(&VecDeque::new()), None);
    }
}
