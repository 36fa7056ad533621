//! A device that is lost is opened again, and the pictures are the same.

mod support;

use std::sync::{Arc, Mutex};
use support::{Scene, camera, node, options, world};
use terravision_renderer::engine::{EngineError, EngineOptions};
use terravision_renderer::gpu::ElevationPath;
use terravision_renderer::run::{RunError, RunSummary, run};
use terravision_renderer::sink::workers::SinkWorkers;
use terravision_renderer::sink::{FrameSink, Picture, SinkError};
use terravision_renderer::source::{RecordedSource, Recording};
use terravision_renderer::technique::DrawError;

const SIZE: [u32; 2] = [64, 48];
const FRAMES: u32 = 12;

/// Number and pixels of every picture.
type Pictures = Vec<(u64, Vec<u8>)>;

/// Keeps them.
#[derive(Clone, Default)]
struct Album(Arc<Mutex<Pictures>>);

impl FrameSink for Album {
    fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
        self.0.lock().expect("no test panics with it").push((picture.frame.get(), picture.rgba.to_vec()));
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        Ok(())
    }
}

fn flight() -> Arc<Recording> {
    let checks =
        |x: f64, y: f64| if ((x / 10.0) as i64 + (y / 10.0) as i64) % 2 == 0 { [200, 40, 10] } else { [10, 60, 220] };
    let mut scene = Scene::new(world([16, 16]), &|x, _| 0.1 * x, &checks);
    let views: Vec<_> =
        (0..FRAMES).map(|i| camera([60.0 + f64::from(i), 70.0, 150.0], f64::from(i), -80.0, SIZE)).collect();
    let tiles: Vec<_> = (0..4).map(|i| scene.leaf(node(i % 2, i / 2, 0), &views[0], [0; 4])).collect();
    for camera in &views {
        let mut own = tiles.clone();
        for tile in &mut own {
            let node = tile.node().expect("the recording is whole");
            tile.elevation_position = scene.add_array(node, camera);
        }
        scene.frame(camera, own);
    }
    scene.finish()
}

fn play(recording: &Arc<Recording>, options: EngineOptions) -> (Result<RunSummary, RunError>, Pictures) {
    let album = Album::default();
    let workers = SinkWorkers::start(vec![Box::new(album.clone()) as Box<dyn FrameSink>]).expect("threads start");
    let mut source = RecordedSource::new(Arc::clone(recording), 1);
    let summary = run(options, &mut source, workers, &mut |_, _| {}, &mut |_| {});
    let pictures = album.0.lock().expect("no test panics with it").clone();
    (summary, pictures)
}

#[test]
fn after_a_lost_device_the_pictures_are_the_same() {
    let recording = flight();
    for frames_in_flight in [1, 3] {
        for elevation_path in [ElevationPath::Best, ElevationPath::Staged] {
            let whole = EngineOptions {
                frames_in_flight,
                elevation_path,
                can_import_colors: elevation_path == ElevationPath::Best,
                ..options(SIZE)
            };
            let (summary, expected) = play(&recording, whole.clone());
            assert_eq!(summary.expect("nothing is lost").uploads, 4);
            assert_eq!(expected.len(), FRAMES as usize);
            // Each device draws four frames at most, so that at least three are lost.
            let (summary, pictures) = play(&recording, EngineOptions { lose_device_at: Some(5), ..whole });
            let summary = summary.expect("another device is opened");
            assert!(pictures == expected, "{} pictures", pictures.len());
            assert_eq!(summary.frames, u64::from(FRAMES));
            assert!(summary.uploads >= 3 * 4, "each device has its own copy of the tiles: {}", summary.uploads);
        }
    }
}

#[test]
fn a_device_that_is_lost_with_every_frame_is_given_up() {
    let (summary, pictures) = play(&flight(), EngineOptions { lose_device_at: Some(1), ..options(SIZE) });
    let error = summary.expect_err("no frame can be drawn");
    assert!(
        matches!(&error, RunError::Engine { source: EngineError::Draw { source: DrawError::Gpu { .. } } }),
        "{error:?}"
    );
    assert!(error.to_string().contains("device was lost") && pictures.is_empty(), "{error}");
    assert!(!error.is_bad_input() && !error.is_stopping(), "{error}");
}
