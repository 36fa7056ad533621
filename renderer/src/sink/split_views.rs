//! Each view of a frame into a sink of its own, as the picture that its camera alone would make.

use super::{FrameSink, Picture, SinkError};
use crate::pixels::PixelPlaces;
use terravision_common::rig::{View, Views};

/// Hands each view on by itself.
pub struct SplitViewsSink {
    /// The views' names, and where they go, in the order of the rig.
    sinks: Vec<(String, Box<dyn FrameSink>)>,
    rgba: Vec<u8>,
    depth: Vec<f32>,
}

impl std::fmt::Debug for SplitViewsSink {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_list().entries(self.sinks.iter().map(|(name, _)| name)).finish()
    }
}

impl SplitViewsSink {
    /// Views of these names into these sinks, in the order of the rig.
    #[must_use]
    pub fn new(sinks: Vec<(String, Box<dyn FrameSink>)>) -> Self {
        Self { sinks, rgba: Vec::new(), depth: Vec::new() }
    }
}

impl FrameSink for SplitViewsSink {
    /// Views are cut out of pictures in memory.
    fn needs(&self) -> PixelPlaces {
        let is_any = self.sinks.iter().any(|(_, sink)| sink.needs() != PixelPlaces::NOWHERE);
        if is_any { PixelPlaces::HOST } else { PixelPlaces::NOWHERE }
    }

    fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
        if picture.views.len() != self.sinks.len() {
            return Err(SinkError::ViewCount { found: picture.views.len(), expected: self.sinks.len() });
        }
        for (view, (name, sink)) in picture.views.iter().zip(&mut self.sinks) {
            cut_out(picture.rgba, 4, picture.size, view, &mut self.rgba);
            let reversed_depth = picture.reversed_depth.map(|depth| {
                cut_out(depth, 1, picture.size, view, &mut self.depth);
                &self.depth[..]
            });
            sink.write(&Picture {
                view: Some(name),
                views: Views::single(&view.camera),
                size: view.size(),
                rgba: &self.rgba,
                reversed_depth,
                on_device: None,
                ..*picture
            })?;
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        self.sinks.iter_mut().try_for_each(|(_, sink)| sink.finish())
    }
}

/// Copies a view out of a plane that has `per_pixel` numbers a pixel.
fn cut_out<T: Copy>(plane: &[T], per_pixel: usize, size: [u32; 2], view: &View, out: &mut Vec<T>) {
    let [left, top] = view.at.map(|at| at as usize);
    let [width, height] = view.size().map(|side| side as usize);
    out.clear();
    for row in plane.chunks_exact((size[0] as usize * per_pixel).max(1)).skip(top).take(height) {
        out.extend_from_slice(&row[left * per_pixel..(left + width) * per_pixel]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::{Arc, Mutex};
    use terravision_common::camera::{Camera, CameraFields};
    use terravision_common::ids::FrameNumber;

    type Log = Arc<Mutex<Vec<(String, [u32; 2], Vec<u8>, Vec<f32>)>>>;

    struct Keep(Log);

    impl FrameSink for Keep {
        fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
            let reds = picture.rgba.iter().step_by(4).copied().collect();
            let depth = picture.reversed_depth.unwrap_or_default().to_vec();
            let name = picture.view.unwrap_or_default().to_owned();
            self.0.lock().unwrap().push((name, picture.size, reds, depth));
            Ok(())
        }

        fn finish(&mut self) -> Result<(), SinkError> {
            Ok(())
        }
    }

    #[test]
    fn each_view_is_cut_out_of_the_picture_and_named() {
        let view = |at, [width, height]: [u32; 2]| View {
            camera: Camera::new(CameraFields { width, height, ..*Camera::default().fields() }).expect("valid"),
            at,
        };
        let views = Views::new([view([0, 0], [2, 2]), view([3, 1], [1, 1])]).unwrap();
        // Two rows of four pixels, numbered.
        let rgba: Vec<u8> = (0..8).flat_map(|n| [n, 0, 0, 255]).collect();
        let depth: Vec<f32> = (0..8u8).map(f32::from).collect();
        let picture = Picture {
            frame: FrameNumber::new(3),
            view: None,
            size: [4, 2],
            rgba: &rgba,
            reversed_depth: Some(&depth),
            on_device: None,
            views,
            is_settled: true,
        };
        let log = Log::default();
        let keep = |name: &str| (name.to_owned(), Box::new(Keep(Arc::clone(&log))) as Box<dyn FrameSink>);
        let mut sink = SplitViewsSink::new(vec![keep("left"), keep("down")]);
        sink.write(&picture).unwrap();
        let expected = [
            ("left".to_owned(), [2, 2], vec![0, 1, 4, 5], vec![0.0, 1.0, 4.0, 5.0]),
            ("down".to_owned(), [1, 1], vec![7], vec![7.0]),
        ];
        assert_eq!(*log.lock().unwrap(), expected);
        let error = SplitViewsSink::new(vec![keep("left")]).write(&picture).unwrap_err().to_string();
        assert!(error.contains("2 views") && error.contains("expected 1"), "{error}");
    }
}
