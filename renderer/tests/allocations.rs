//! The frame loop allocates nothing in the steady state.

mod support;

use std::sync::Arc;
use support::{Scene, camera, node, options, world};
use terravision_renderer::engine::EngineOptions;
use terravision_renderer::run::run;
use terravision_renderer::sink::workers::SinkWorkers;
use terravision_renderer::sink::{FrameSink, NullSink, Picture, SinkError};
use terravision_renderer::source::{RecordedSource, Recording};

const SIZE: [u32; 2] = [64, 48];

fn flight() -> Arc<Recording> {
    let flat = |_: f64, _: f64| 0.0;
    let green = |_: f64, _: f64| [0, 200, 0];
    let mut scene = Scene::new(world([16, 16]), &flat, &green);
    let camera = camera([80.0, 80.0, 150.0], 0.0, -80.0, SIZE);
    let tiles = (0..4).map(|i| scene.leaf(node(i % 2, i / 2, 0), &camera, [0; 4])).collect();
    scene.frame(&camera, tiles);
    scene.finish()
}

/// Looks at pictures, so that they are read back.
struct Look;

impl FrameSink for Look {
    fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
        assert_eq!(picture.rgba.len() as u32, 4 * SIZE[0] * SIZE[1]);
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        Ok(())
    }
}

#[test]
fn more_frames_take_no_more_allocations() {
    let recording = flight();
    let paths = support::paths(&EngineOptions { has_validation: false, ..options(SIZE) });
    for (change, is_looked_at) in paths.iter().flat_map(|change| [(change, true), (change, false)]) {
        let allocations = |laps: u64| {
            let mut source = RecordedSource::new(Arc::clone(&recording), laps);
            let sink: Box<dyn FrameSink> = if is_looked_at { Box::new(Look) } else { Box::new(NullSink) };
            let workers = SinkWorkers::start(vec![sink]).unwrap();
            let options = change.clone();
            // Of this thread: the frame loop's.
            let info = allocation_counter::measure(|| {
                run(options, &mut source, workers, &mut |_, _| {}, &mut |_| {}).unwrap();
            });
            info.count_total
        };
        // The first run also pays for what the process needs once.
        allocations(10);
        let (short, long) = (allocations(20), allocations(220));
        // A queue allocates the first time that somebody waits at it, which depends on timing: a
        // few per run, none a frame.
        assert!(long <= short + 4, "200 more frames allocated {} times", long as i64 - short as i64);
    }
}
