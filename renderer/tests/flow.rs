//! The whole flow: sources, frame loop, workers and sinks.

mod support;

use std::fs;
use std::io;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use support::{Scene, camera, node, options, world};
use terravision_common::camera::Camera;
use terravision_common::event::{Event, EventContent};
use terravision_common::film::{self, FrameEncoding};
use terravision_common::ids::Sequence;
use terravision_common::run::PlaneTarget;
use terravision_common::shm::{Control, ElevationWriter, PoolWriter, Producer, RunState, memory};
use terravision_common::slot::{FrameMarker, Slot, SlotContent, ViewSlot};
use terravision_common::texels::TexelFormat;
use terravision_common::world::{World, WorldFields};
use terravision_renderer::engine::EngineOptions;
use terravision_renderer::gpu::{DeviceChoice, ElevationPath};
use terravision_renderer::run::{RunError, RunSummary, run};
use terravision_renderer::sink::workers::SinkWorkers;
use terravision_renderer::sink::{
    AllOf, DepthSink, FrameSink, GroundSink, NullSink, Picture, PngFileSink, PngFolderSink, SinkError, StreamSink,
};
use terravision_renderer::source::{LiveSource, Pools, RecordedSource, Recorder, Recording};

const SIZE: [u32; 2] = [64, 48];

fn flat(_: f64, _: f64) -> f64 {
    0.0
}

fn checks(x: f64, y: f64) -> [u8; 3] {
    if ((x / 10.0) as i64 + (y / 10.0) as i64) % 2 == 0 { [200, 40, 10] } else { [10, 60, 220] }
}

fn views(count: u32) -> Vec<Camera> {
    (0..count).map(|i| camera([60.0 + f64::from(i), 70.0, 150.0], f64::from(i), -80.0, SIZE)).collect()
}

fn flight(frames: u32) -> Arc<Recording> {
    let mut scene = Scene::new(world([16, 16]), &flat, &checks);
    // All frames share the colour tiles, as in a flight.
    let first = views(1)[0];
    let tiles: Vec<_> = (0..4).map(|i| scene.leaf(node(i % 2, i / 2, 0), &first, [0; 4])).collect();
    for camera in views(frames) {
        let mut own = tiles.clone();
        for tile in &mut own {
            tile.elevation_position = scene.add_array(tile.node().expect("the recording is whole"), &camera);
        }
        scene.frame(&camera, own);
    }
    scene.finish()
}

fn play(recording: &Arc<Recording>, laps: u64, sinks: Vec<Box<dyn FrameSink>>) -> Result<RunSummary, RunError> {
    let mut source = RecordedSource::new(Arc::clone(recording), laps);
    let workers = SinkWorkers::start(sinks)?;
    run(options(SIZE), &mut source, workers, &mut |_, _| {}, &mut |_| {})
}

fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("terravision-flow-{name}-{}", std::process::id()));
    drop(fs::remove_dir_all(&folder));
    fs::create_dir_all(&folder).expect("the recording is whole");
    folder
}

fn names(folder: &PathBuf) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(folder)
        .expect("the recording is whole")
        .map(|entry| entry.expect("the recording is whole").file_name().into_string().expect("the recording is whole"))
        .collect();
    names.sort();
    names
}

#[test]
fn a_folder_of_pictures_is_the_same_with_one_lane_and_with_three() {
    let recording = flight(9);
    let base = folder("workers");
    for (name, workers) in [("a", 1), ("b", 3)] {
        let sinks = (0..workers)
            .map(|_| Box::new(PngFolderSink::new(&base.join(name)).unwrap()) as Box<dyn FrameSink>)
            .collect();
        let summary = play(&recording, 1, sinks).unwrap();
        assert_eq!(summary, RunSummary { frames: 9, unsettled: 0, uploads: 4 });
    }
    let files = names(&base.join("a"));
    assert_eq!(files.len(), 9);
    assert_eq!((files[0].as_str(), files[8].as_str()), ("frame-000000.png", "frame-000008.png"));
    assert_eq!(files, names(&base.join("b")));
    for file in &files {
        let [a, b] = ["a", "b"].map(|name| fs::read(base.join(name).join(file)).unwrap());
        assert_eq!(a, b, "{file}");
    }
    let picture = image::open(base.join("a").join(&files[0])).unwrap().to_rgb8();
    assert_eq!(picture.dimensions(), (64, 48));
    fs::remove_dir_all(base).unwrap();
}

#[test]
fn a_still_has_picture_depth_and_ground() {
    let base = folder("still");
    let mut scene = Scene::new(world([16, 16]), &|x, _| 0.1 * x, &checks);
    let camera = camera([80.0, 80.0, 150.0], 30.0, -70.0, SIZE);
    let tile = scene.leaf(node(0, 0, 1), &camera, [0; 4]);
    scene.frame(&camera, vec![tile]);
    let recording = scene.finish();
    let fields = WorldFields { origin: [500_000.0, 4_000_000.0], ..*world([16, 16]).fields() };
    let placed = World::new(fields).unwrap();
    let [png, depth, ground] = ["a.png", "d.tif", "g.tif"].map(|name| base.join(name));
    let sinks: Vec<Box<dyn FrameSink>> = vec![Box::new(AllOf(vec![
        Box::new(PngFileSink::new(&png)),
        Box::new(DepthSink::new(&PlaneTarget::File(depth.clone())).unwrap()),
        Box::new(GroundSink::new(&PlaneTarget::File(ground.clone()), placed, 1.0).unwrap()),
    ]))];
    let mut source = RecordedSource::new(recording, 1);
    let with_depth = EngineOptions { has_depth: true, ..options(SIZE) };
    run(with_depth, &mut source, SinkWorkers::start(sinks).unwrap(), &mut |_, _| {}, &mut |_| {}).unwrap();
    assert_eq!(names(&base), ["a.png", "d.tif", "g.tif"]);
    let read = |path| tiff::decoder::Decoder::new(fs::File::open(path).unwrap()).unwrap().read_image().unwrap();
    let tiff::decoder::DecodingResult::F32(depths) = read(&depth) else { panic!("depth is float32") };
    let tiff::decoder::DecodingResult::F64(places) = read(&ground) else { panic!("ground is float64") };
    assert_eq!((depths.len(), places.len()), (64 * 48, 3 * 64 * 48));
    let mut seen = 0;
    for (index, place) in places.chunks_exact(3).enumerate() {
        assert_eq!(depths[index].is_nan(), place[0].is_nan());
        if place[0].is_nan() {
            continue;
        }
        seen += 1;
        // The ground is the plane z = x / 10; and the point lies on the pixel's ray at its depth.
        let local = [place[0] - 500_000.0, place[1] - 4_000_000.0, place[2]];
        assert!((local[2] - 0.1 * local[0]).abs() < 0.01, "{local:?}");
        assert!((0.0..=160.0).contains(&local[0]) && (-0.01..=160.01).contains(&local[1]), "{local:?}");
        let along: f64 = camera.axes_in_world()[2].dot(glam::DVec3::from_array(local) - camera.eye());
        assert!((along - f64::from(depths[index])).abs() < 0.01);
    }
    assert!(seen > 1000, "{seen} pixels of ground");
    fs::remove_dir_all(base).unwrap();
}

/// Keeps what it gets, in order.
#[derive(Clone, Default)]
struct Kept(Arc<Mutex<Frames>>);

/// Numbers and pixels of frames.
type Frames = Vec<(u64, Vec<u8>)>;

/// How a live run ended, what its sink got, and what it told of.
type Lived = (Result<RunSummary, RunError>, Frames, Vec<Event>);

impl FrameSink for Kept {
    fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
        self.0.lock().expect("no sink panics").push((picture.frame.get(), picture.rgba.to_vec()));
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        self.0.lock().expect("no sink panics").push((u64::MAX, Vec::new()));
        Ok(())
    }
}

#[test]
fn frames_reach_a_sink_in_order_and_a_recording_of_a_recording_is_the_same() {
    let recording = flight(7);
    let (first, second) = (Kept::default(), Kept::default());
    let mut recorder = Recorder::new(RecordedSource::new(Arc::clone(&recording), 2));
    let workers = SinkWorkers::start(vec![Box::new(first.clone())]).unwrap();
    run(options(SIZE), &mut recorder, workers, &mut |_, _| {}, &mut |_| {}).unwrap();
    let again = Arc::new(recorder.finish());
    assert_eq!(again.frames().len(), 14);
    play(&again, 1, vec![Box::new(second.clone())]).unwrap();
    let (first, second) = (first.0.lock().unwrap(), second.0.lock().unwrap());
    assert_eq!(
        first.iter().map(|(frame, _)| *frame).collect::<Vec<_>>(),
        (0..14).chain([u64::MAX]).collect::<Vec<_>>()
    );
    assert!(*first == *second);
    // The second lap shows what the first showed.
    assert_eq!(first[0].1, first[7].1);
}

struct Failing(u64);

impl FrameSink for Failing {
    fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
        if picture.frame.get() < self.0 {
            return Ok(());
        }
        Err(SinkError::Write { source: io::ErrorKind::StorageFull.into(), path: "somewhere".into() })
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        panic!("a failed sink is not finished")
    }
}

#[test]
fn a_sink_that_fails_ends_the_run_with_its_sentence() {
    let recording = flight(6);
    for sinks in [vec![Box::new(Failing(3)) as Box<dyn FrameSink>], vec![Box::new(NullSink), Box::new(Failing(0))]] {
        let error = play(&recording, 20, sinks).unwrap_err();
        assert!(error.to_string().starts_with("cannot write somewhere: "), "{error}");
        assert!(!error.is_bad_input() && !error.is_stopping(), "{error}");
    }
}

#[test]
fn a_full_disk_is_said_and_leaves_no_part_of_a_picture() {
    let recording = flight(3);
    let error = play(&recording, 1, vec![Box::new(PngFileSink::new("/dev/full".as_ref()))]).unwrap_err();
    assert!(error.to_string().contains("/dev/full"), "{error}");
    let base = folder("unwritable");
    fs::write(base.join("file"), b"").unwrap();
    let error = PngFolderSink::new(&base.join("file/below")).unwrap_err();
    assert!(error.to_string().starts_with("cannot write "), "{error}");
    fs::remove_dir_all(base).unwrap();
}

#[test]
fn y4m_is_read_by_ffmpeg_with_the_colours_that_were_drawn() {
    let (ring, mut reader) = memory::stream_ring(2, FrameEncoding::Y4m.frame_bytes(SIZE) as u32).unwrap();
    let control = Arc::new(memory::control().unwrap());
    let sink = StreamSink::new(io::sink(), ring, control, FrameEncoding::Y4m, SIZE).unwrap();
    play(&flight(2), 1, vec![Box::new(sink)]).unwrap();
    let base = folder("y4m");
    let [y4m, back] = ["a.y4m", "a.png"].map(|name| base.join(name));
    // As the launcher makes it: the header, then the frames.
    let mut stream = film::y4m_header(SIZE, 25.0).into_bytes();
    (0..2).for_each(|position| stream.extend(reader.read_array(position).unwrap().unwrap()));
    fs::write(&y4m, stream).unwrap();
    let status = std::process::Command::new("ffmpeg")
        .args(["-v", "error", "-i"])
        .arg(&y4m)
        .args(["-vf", "scale=in_color_matrix=bt601:in_range=tv:out_range=pc:flags=accurate_rnd+full_chroma_int"])
        .args(["-pix_fmt", "rgb24", "-frames:v", "1"])
        .arg(&back)
        .status()
        .unwrap();
    assert!(status.success());
    let kept = Kept::default();
    play(&flight(2), 1, vec![Box::new(kept.clone())]).unwrap();
    let picture = image::open(&back).unwrap().to_rgb8();
    let kept = kept.0.lock().unwrap();
    let worst = picture
        .pixels()
        .zip(kept[0].1.chunks_exact(4))
        .flat_map(|(a, b)| (0..3).map(move |c| a.0[c].abs_diff(b[c])))
        .max();
    assert!(worst.unwrap() <= 4, "{worst:?}");
    fs::remove_dir_all(base).unwrap();
}

#[test]
fn a_picture_that_is_too_large_is_bad_input() {
    let recording = flight(1);
    let mut source = RecordedSource::new(recording, 1);
    let workers = SinkWorkers::start(vec![Box::new(NullSink)]).unwrap();
    let too_large = EngineOptions { size: [60_000, 60_000], ..options(SIZE) };
    let error = run(too_large, &mut source, workers, &mut |_, _| {}, &mut |_| {}).unwrap_err();
    assert!(error.is_bad_input(), "{error}");
    assert!(error.to_string().contains("60000x60000"), "{error}");
}

#[test]
fn a_device_that_is_not_there_is_said() {
    let mut source = RecordedSource::new(flight(1), 1);
    let workers = SinkWorkers::start(vec![Box::new(NullSink)]).unwrap();
    let wanted = EngineOptions { device: DeviceChoice::Matching("abacus".into()), ..options(SIZE) };
    let error = run(wanted, &mut source, workers, &mut |_, _| {}, &mut |_| {}).unwrap_err();
    assert!(error.to_string().starts_with("no Vulkan device matches \"abacus\"; there are: 0: "), "{error}");
}

/// What a preparer and a prefetcher do for the frames of a recording, until the renderer is gone or
/// the run is stopped.
fn feed(
    recording: &Arc<Recording>,
    stop_after: Option<usize>,
    control: &Control,
    mut ring: Producer<Slot>,
    mut arrays: ElevationWriter,
    mut pool: PoolWriter,
) {
    let world = recording.world();
    let mut inner = RecordedSource::new(Arc::clone(recording), 1);
    let mut tile_bytes = vec![0; (0..3).map(|mip| (world.color_stored() as usize >> mip).pow(2) * 4).sum()];
    let mut placed = std::collections::HashMap::new();
    for (sequence, frame) in recording.frames().iter().enumerate() {
        if stop_after == Some(sequence) {
            control.set_state(RunState::Stopping);
            return;
        }
        let (sequence, elevation_start) = (sequence as u64 + 1, arrays.next_position());
        let marker = FrameMarker { sequence, elevation_start, maker: 1, ..frame.marker };
        if ring.push(&Slot::new(&SlotContent::Marker(marker)), control).is_err() {
            return;
        }
        for (index, view) in (0..).zip(frame.views.iter()) {
            let count = frame.views.len() as u32;
            let view = ViewSlot::new(view, index, count);
            if ring.push(&Slot::new(&SlotContent::View(view)), control).is_err() {
                return;
            }
        }
        let mut tiles = frame.tiles.clone();
        for tile in &mut tiles {
            let mut values = vec![0.0; world.elevation_posts().pow(2) as usize];
            assert!(
                inner
                    .read_elevation(tile.elevation_position, &mut values)
                    .expect("memory of this process holds the recording")
            );
            let Ok(mut guard) = arrays.begin(control) else { return };
            guard.values_mut().copy_from_slice(&values);
            tile.elevation_position = guard.publish();
            let node = tile.node().expect("memory of this process holds the recording");
            let key = *placed.entry(tile.color_slot).or_insert_with(|| {
                assert!(inner.read_color(tile.color(), &mut tile_bytes));
                let mut fill = pool
                    .allocate(node, Sequence::new(sequence), control.completed_sequence())
                    .expect("memory of this process holds the recording");
                fill.bytes_mut()[..tile_bytes.len()].copy_from_slice(&tile_bytes);
                fill.publish()
            });
            *tile = tile.with_color(key);
            if ring.push(&Slot::new(&SlotContent::Tile(*tile)), control).is_err() {
                return;
            }
        }
        let end = terravision_common::slot::FrameEnd { elevation_end: arrays.next_position(), ..frame.end };
        if ring.push(&Slot::new(&SlotContent::End(end)), control).is_err() {
            return;
        }
    }
}

/// Plays a recording through shared memory of this process, as a preparer would, with small rings
/// that fill up.
fn live(recording: &Arc<Recording>, options: EngineOptions, stop_after: Option<usize>) -> Lived {
    let world = *recording.world();
    let posts = world.elevation_posts().pow(2);
    let control = Arc::new(memory::control().expect("memory of this process holds the recording"));
    let (ring, consumer) = memory::ring::<Slot>(4).expect("memory of this process holds the recording");
    let (arrays, elevation) = memory::elevation_ring(8, posts).expect("memory of this process holds the recording");
    let (pool, colors) = memory::pool(6, 16384).expect("memory of this process holds the recording");
    let (events, mut drained) = memory::ring::<Event>(1024).expect("memory of this process holds the recording");
    let frames = [0, recording.frames().len() as u64];
    let mut source = LiveSource::new(
        Arc::clone(&control),
        consumer,
        elevation,
        (colors, TexelFormat::Rgba8),
        Some(events),
        world,
        frames,
    )
    .expect("memory of this process holds the recording");
    let kept = Kept::default();
    let workers = SinkWorkers::start(vec![Box::new(kept.clone())]).expect("memory of this process holds the recording");
    let result = std::thread::scope(|scope| {
        let control = Arc::clone(&control);
        scope.spawn(move || feed(recording, stop_after, &control, ring, arrays, pool));
        run(options, &mut source, workers, &mut |_, _| {}, &mut |_| {})
    });
    let events =
        std::iter::from_fn(|| drained.try_pop().expect("memory of this process holds the recording")).collect();
    let kept = kept.0.lock().expect("memory of this process holds the recording").clone();
    if result.is_ok() {
        assert_eq!(control.completed_sequence().get(), frames[1]);
        assert_eq!(control.written_frames(), frames[1]);
    }
    (result, kept, events)
}

#[test]
fn live_frames_are_the_recorded_ones_by_both_paths() {
    let recording = flight(12);
    let kept = Kept::default();
    play(&recording, 1, vec![Box::new(kept.clone())]).unwrap();
    let kept = kept.0.lock().unwrap();
    for options in support::paths(&options(SIZE)) {
        let is_imported = options.elevation_path == ElevationPath::Best;
        let (result, live, events) = live(&recording, options, None);
        assert_eq!(result.unwrap(), RunSummary { frames: 12, unsettled: 0, uploads: 4 });
        assert!(live == *kept, "imported: {is_imported}");
        let said: Vec<EventContent> = events.iter().filter_map(Event::content).collect();
        let of = |content: EventContent| said.iter().filter(|found| **found == content).count();
        assert_eq!(of(EventContent::FrameDone { triangles: 4 * 128 }), 12);
        assert_eq!(of(EventContent::FrameWritten { is_settled: true }), 12);
        assert_eq!(of(EventContent::FrameUploaded { tiles: 4 }), 1);
    }
}

#[test]
fn a_stopped_run_ends_with_130() {
    let (result, _, _) = live(&flight(12), options(SIZE), Some(6));
    assert!(result.unwrap_err().is_stopping());
}
