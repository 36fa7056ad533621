//! Two views as one picture for glasses, red at the left eye and cyan at the right one.

use super::{FrameSink, Picture, SinkError, SizedRgba};
use crate::pixels::PixelPlaces;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use terravision_common::ids::FrameNumber;
use terravision_common::rig::{View, Views};

/// Shares of the left eye's red, green and blue in each channel of the picture, then those of the
/// right eye's, in 1/65536: the least squares of what each eye then sees against what it should see
/// (E. Dubois, "A projection method to generate anaglyph stereo images", 2001), for sRGB screens.
const SHARES: [[i32; 6]; 3] = [
    [29_891, 32_800, 11_559, -2_849, -5_763, -102],
    [-2_627, -2_479, -1_033, 24_804, 48_080, -1_209],
    [-997, -1_350, -358, -4_729, -7_403, 80_373],
];

/// Hands both views on as one picture of the size of a view, with the depths of the left one, where
/// there are any.
pub struct AnaglyphSink {
    sink: Box<dyn FrameSink>,
    rgba: Vec<u8>,
    reversed_depth: Vec<f32>,
}

impl std::fmt::Debug for AnaglyphSink {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("AnaglyphSink").finish_non_exhaustive()
    }
}

impl AnaglyphSink {
    /// Pictures for glasses into this sink.
    #[must_use]
    pub fn new(sink: Box<dyn FrameSink>) -> Self {
        Self { sink, rgba: Vec::new(), reversed_depth: Vec::new() }
    }
}

impl FrameSink for AnaglyphSink {
    fn needs(&self) -> PixelPlaces {
        if self.sink.needs() == PixelPlaces::NOWHERE { PixelPlaces::NOWHERE } else { PixelPlaces::HOST }
    }

    fn tree_overlay(&self) -> Option<Arc<AtomicBool>> {
        self.sink.tree_overlay()
    }

    fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
        let [left, right] = picture.views[..] else {
            return Err(SinkError::ViewCount { found: picture.views.len(), expected: 2 });
        };
        let [width, height] = left.size().map(|side| side as usize);
        let stride = picture.size[0] as usize;
        self.rgba.clear();
        for row in 0..if picture.rgba.is_empty() { 0 } else { height } {
            let of = |[x, y]: [u32; 2]| {
                let first = (y as usize + row) * stride + x as usize;
                picture.rgba[4 * first..4 * (first + width)].chunks_exact(4)
            };
            self.rgba.extend(of(left.at).zip(of(right.at)).flat_map(|(left, right)| combine(left, right)));
        }
        self.reversed_depth.clear();
        for row in 0..picture.reversed_depth.map_or(0, |_| height) {
            let first = (left.at[1] as usize + row) * stride + left.at[0] as usize;
            self.reversed_depth.extend(&picture.reversed_depth.unwrap_or_default()[first..first + width]);
        }
        self.sink.write(&Picture {
            // Both are all of it.
            views: Views::new([left, right].map(|view| View { at: [0; 2], ..view })).unwrap_or(picture.views),
            size: left.size(),
            rgba: &self.rgba,
            reversed_depth: picture.reversed_depth.map(|_| &self.reversed_depth[..]),
            on_device: None,
            ..*picture
        })
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        self.sink.finish()
    }

    fn read_back(&mut self, frame: FrameNumber) -> Result<Option<SizedRgba>, SinkError> {
        self.sink.read_back(frame)
    }
}

/// One pixel. What was made up for one eye is made up.
fn combine(left: &[u8], right: &[u8]) -> [u8; 4] {
    let seen = [left[0], left[1], left[2], right[0], right[1], right[2]].map(i32::from);
    let channel = |shares: &[i32; 6]| {
        let sum: i32 = shares.iter().zip(seen).map(|(share, value)| share * value).sum();
        ((sum + (1 << 15)) >> 16).clamp(0, 255) as u8
    };
    let [red, green, blue] = SHARES.each_ref().map(channel);
    [red, green, blue, left[3] & right[3]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::{Arc, Mutex};
    use terravision_common::camera::{Camera, CameraFields};

    struct Keep(Arc<Mutex<Vec<SizedRgba>>>);

    impl FrameSink for Keep {
        fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
            self.0.lock().unwrap().push((picture.size, picture.rgba.to_vec()));
            Ok(())
        }

        fn finish(&mut self) -> Result<(), SinkError> {
            Ok(())
        }
    }

    #[test]
    fn what_both_eyes_see_alike_keeps_its_grey() {
        for grey in [0, 1, 60, 128, 200, 255] {
            let [red, green, blue, alpha] = combine(&[grey, grey, grey, 255], &[grey, grey, grey, 254]);
            assert!([red, green, blue].iter().all(|value| value.abs_diff(grey) <= 3), "{grey}: {red} {green} {blue}");
            assert_eq!(alpha, 254);
        }
        let [red, green, blue, _] = combine(&[255; 4], &[0, 0, 0, 255]);
        assert!(red == 255 && green == 0 && blue == 0, "the left eye alone is red: {red} {green} {blue}");
        let [red, green, blue, _] = combine(&[0, 0, 0, 255], &[255; 4]);
        assert!(red == 0 && green == 255 && blue == 255, "the right eye alone is cyan: {red} {green} {blue}");
    }

    #[test]
    fn two_views_become_one_picture_of_their_size() {
        let camera = Camera::new(CameraFields { width: 2, height: 1, ..*Camera::default().fields() }).unwrap();
        let view = |x| View { camera, at: [x, 0] };
        let rgba: Vec<u8> = [255, 0, 255, 255].into_iter().flat_map(|grey| [grey, grey, grey, 255]).collect();
        let picture = Picture {
            frame: FrameNumber::new(0),
            view: None,
            size: [4, 1],
            rgba: &rgba,
            reversed_depth: Some(&[1.0, 2.0, 3.0, 4.0]),
            on_device: None,
            views: Views::new([view(0), view(2)]).unwrap(),
            is_settled: true,
        };
        let log = Arc::default();
        let mut sink = AnaglyphSink::new(Box::new(Keep(Arc::clone(&log))));
        sink.write(&picture).unwrap();
        let (size, made) = log.lock().unwrap().pop().unwrap();
        assert_eq!((size, &made[4..]), ([2, 1], &[0, 255, 255, 255][..]));
        let alone = Picture { views: Views::single(&camera), ..picture };
        assert!(sink.write(&alone).unwrap_err().to_string().contains("1 views, expected 2"));
    }
}
