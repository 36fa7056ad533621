//! Pictures of several sizes from one engine, and pictures that are needed on the device, or
//! nowhere.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

mod support;

use std::sync::{Arc, Mutex};
use support::{Scene, camera, draw, node, options, world};
use terravision_common::camera::Camera;
use terravision_common::film::FrameEncoding;
use terravision_common::rig::{View, Views};
use terravision_common::run::{RaysChoice, TechniqueChoice};
use terravision_common::shm::memory;
use terravision_common::slot::TileSlot;
use terravision_renderer::engine::{EngineOptions, ViewBounds};
use terravision_renderer::gpu::DevicePicture;
use terravision_renderer::pixels::PixelPlaces;
use terravision_renderer::run::run;
use terravision_renderer::sink::workers::SinkWorkers;
use terravision_renderer::sink::{AllOf, FrameSink, NullSink, Picture, SinkError, StreamSink};
use terravision_renderer::source::{RecordedSource, Recording};

fn rough(x: f64, y: f64) -> f64 {
    30.0 * (x * 0.031).sin() * (y * 0.023).cos()
}

fn checks(x: f64, y: f64) -> [u8; 3] {
    [0.11, 0.07, 0.04].map(|k| (127.0 + 60.0 * (x * k).sin() * (y * k).cos()) as u8)
}

/// A frame for each of these views of one pose.
fn recording(pose: &Camera, frames: &[Views]) -> Arc<Recording> {
    let mut scene = Scene::new(world([64, 64]), &rough, &checks);
    let tiles: Vec<TileSlot> = (0..16).map(|i| scene.leaf(node(i % 4, i / 4, 1), pose, [0; 4])).collect();
    for views in frames {
        let mut own = tiles.clone();
        for tile in &mut own {
            tile.elevation_position = scene.add_array(tile.node().unwrap(), pose);
        }
        scene.frame_of_views(pose, *views, own);
    }
    scene.finish()
}

fn pose(size: [u32; 2]) -> Camera {
    camera([300.0, 40.0, 150.0], 15.0, -25.0, size)
}

fn rays(rays: RaysChoice, plain: &EngineOptions) -> EngineOptions {
    EngineOptions { technique: TechniqueChoice::Rays, rays, ..plain.clone() }
}

#[test]
fn frames_of_other_sizes_have_the_bytes_of_engines_of_their_own() {
    let single = |size| Views::single(&pose(size));
    // Three of one view, one of two that leave a gap, and the first once more.
    let pair = Views::new([View { camera: pose([60, 50]), at: [0, 7] }, View { camera: pose([40, 60]), at: [70, 0] }]);
    let frames = [single([128, 96]), single([75, 100]), single([128, 96]), pair.unwrap(), single([128, 96])];
    let recording_of = |frames: &[Views]| recording(&pose([128, 96]), frames);
    let plain = EngineOptions { has_depth: true, ..options([128, 100]) };
    for (name, options) in [
        ("mesh", plain.clone()),
        ("mesh of four samples", EngineOptions { samples: 4, ..plain.clone() }),
        ("exact rays", rays(RaysChoice::Mipmap, &plain)),
        ("coherent rays", rays(RaysChoice::Coherent, &plain)),
        ("rays of a device", rays(RaysChoice::Compute, &plain)),
    ] {
        let bounds = Some(ViewBounds { size: [128, 100], count: 2 });
        let shared = EngineOptions { views: bounds, ..options.clone() };
        let together = draw(&shared, &recording_of(&frames)).unwrap();
        for (index, (frame, views)) in together.iter().zip(&frames).enumerate() {
            let bounds = ViewBounds { size: views.picture(), count: views.len() };
            let own = EngineOptions { size: views.picture(), views: Some(bounds), ..options.clone() };
            let own = draw(&own, &recording_of(&[*views])).unwrap().pop().unwrap();
            assert_eq!((frame.size, frame.pixels.size()), (views.picture(), views.picture()));
            assert!(frame.pixels.rgba() == own.pixels.rgba(), "{name}: colours of frame {index}");
            assert!(frame.pixels.reversed_depth() == own.pixels.reversed_depth(), "{name}: depths of frame {index}");
        }
        assert!(together[0].pixels.rgba() == together[2].pixels.rgba(), "{name}");
        assert!(together[0].pixels.rgba() == together[4].pixels.rgba(), "{name}");
    }
}

fn play(options: EngineOptions, recording: &Arc<Recording>, sink: Box<dyn FrameSink>) -> Result<(), String> {
    let mut source = RecordedSource::new(Arc::clone(recording), 1);
    let workers = SinkWorkers::start(vec![sink]).unwrap();
    run(options, &mut source, workers, &mut |_, _| {}, &mut |_| {}).map(|_| ()).map_err(|error| error.to_string())
}

#[test]
fn a_stream_of_one_size_refuses_another_and_no_picture_is_larger_than_the_runs() {
    let frames = [[64, 48], [40, 48]].map(|size| Views::single(&pose(size)));
    let recording = recording(&pose([64, 48]), &frames);
    let (ring, _reader) = memory::stream_ring(2, FrameEncoding::Y4m.frame_bytes([64, 48]) as u32).unwrap();
    let control = Arc::new(memory::control().unwrap());
    let stream = StreamSink::new(std::io::sink(), ring, control, FrameEncoding::Y4m, [64, 48]).unwrap();
    let error = play(options([64, 48]), &recording, Box::new(stream)).unwrap_err();
    assert!(
        error.starts_with("frame 1 is a picture of 40x48 pixels, but a film or a stream takes 64x48 only"),
        "{error}"
    );
    assert_eq!(play(options([64, 48]), &recording, Box::new(NullSink)), Ok(()));
    let error = play(options([40, 48]), &recording, Box::new(NullSink)).unwrap_err();
    assert!(error.contains("frame 0") && error.contains("64x48 pixels, expected one of 40x48 at most"), "{error}");
}

type Shown = Arc<Mutex<Vec<(u64, [u32; 2], Vec<u8>)>>>;

/// Shows pictures in a window that is an image on the device.
struct Window {
    surface: Option<DevicePicture>,
    shown: Shown,
    has_host_pixels: bool,
}

impl FrameSink for Window {
    fn needs(&self) -> PixelPlaces {
        PixelPlaces::DEVICE
    }

    fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
        assert_eq!(picture.rgba.is_empty(), !self.has_host_pixels);
        let image = picture.on_device.expect("it is needed");
        if self.surface.as_ref().is_none_or(|surface| surface.size() != image.size()) {
            self.surface = Some(image.like()?);
        }
        let surface = self.surface.as_mut().unwrap();
        surface.copy_from(image)?;
        self.shown.lock().unwrap().push((picture.frame.get(), picture.size, surface.read()?));
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        Ok(())
    }
}

/// Keeps pictures that were read back.
struct Album(Shown);

impl FrameSink for Album {
    fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
        self.0.lock().unwrap().push((picture.frame.get(), picture.size, picture.rgba.to_vec()));
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        Ok(())
    }
}

#[test]
fn a_window_shows_on_the_device_what_would_be_read_back() {
    let pair = Views::new([View { camera: pose([60, 50]), at: [0, 7] }, View { camera: pose([40, 60]), at: [70, 0] }]);
    let frames = [Views::single(&pose([128, 96])), pair.unwrap(), Views::single(&pose([75, 96]))];
    let recording = recording(&pose([128, 96]), &frames);
    let plain = EngineOptions { views: Some(ViewBounds { size: [128, 96], count: 2 }), ..options([128, 96]) };
    for options in [plain.clone(), EngineOptions { samples: 4, ..plain.clone() }, rays(RaysChoice::Compute, &plain)] {
        let read_back = Shown::default();
        play(options.clone(), &recording, Box::new(Album(Arc::clone(&read_back)))).unwrap();
        let read_back = read_back.lock().unwrap().clone();
        assert_eq!(read_back.len(), 3);
        for has_host_pixels in [false, true] {
            let shown = Shown::default();
            let window = Window { surface: None, shown: Arc::clone(&shown), has_host_pixels };
            let mut sinks: Vec<Box<dyn FrameSink>> = vec![Box::new(window)];
            if has_host_pixels {
                sinks.push(Box::new(Album(Shown::default())));
            }
            play(options.clone(), &recording, Box::new(AllOf(sinks))).unwrap();
            assert!(*shown.lock().unwrap() == read_back);
        }
    }
    // The processor has no such image.
    let window = Window { surface: None, shown: Shown::default(), has_host_pixels: false };
    let error = play(rays(RaysChoice::Mipmap, &plain), &recording, Box::new(window)).unwrap_err();
    assert!(error.contains("pictures that stay on the device") && error.contains("--technique mesh"), "{error}");
}

#[test]
fn what_no_sink_needs_is_not_read_back() {
    let recording = recording(&pose([64, 48]), &[Views::single(&pose([64, 48]))]);
    for options in [options([64, 48]), rays(RaysChoice::Mipmap, &options([64, 48]))] {
        let mut source = RecordedSource::new(Arc::clone(&recording), 2);
        let workers = SinkWorkers::start(vec![Box::new(NullSink)]).unwrap();
        let mut pixels = Vec::new();
        run(options, &mut source, workers, &mut |_, _| {}, &mut |finished| {
            pixels.push((finished.pixels.rgba().len(), finished.pixels.on_device().is_some(), finished.size));
        })
        .unwrap();
        assert_eq!(pixels, [(0, false, [64, 48]); 2]);
    }
}
