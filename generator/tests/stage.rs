//! The generator between its rings: every camera becomes a tree, in order; a record that is not a
//! camera ends it.

use bytemuck::Zeroable;
use std::sync::Arc;
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::event::{Event, EventContent, SpanName, monotonic_nanos};
use terravision_common::ids::Sequence;
use terravision_common::rate::FrameTiming;
use terravision_common::run::{RealtimeConfig, RunConfig};
use terravision_common::shm::{CameraRecord, Consumer, Control, Producer, RunState, TreeReader, memory};
use terravision_common::stage::{Events, StageError};
use terravision_common::synthetic::{Relief, SyntheticTerrain};
use terravision_common::traversal::TreeLimits;
use terravision_common::tree::TreeHeader;
use terravision_common::world::{World, WorldFields};
use terravision_generator::GeneratorError;
use terravision_generator::ports::Ports;
use terravision_generator::stage::Generator;
use terravision_testkit::runs::config;
use terravision_testkit::worlds::fields;

const NODES: u32 = 8192;

fn world() -> World {
    World::new(WorldFields { finest_color_level: 1, ..fields([2000, 1500], 10.0, [16, 128]) }).expect("valid")
}

fn camera(k: u64) -> Camera {
    Camera::new(CameraFields {
        eye_in_world: [3000.0 + 20.0 * k as f64, 2000.0, 900.0],
        heading_rad: 0.02 * k as f64,
        pitch_rad: -0.4,
        roll_rad: 0.0,
        vfov_rad: 1.0,
        width: 640,
        height: 360,
        timestamp_nanos: 0,
    })
    .expect("valid")
}

struct Sides {
    control: Arc<Control>,
    ports: Ports,
    cameras: Producer<CameraRecord>,
    trees: TreeReader,
    events: Consumer<Event>,
    generator: Generator<SyntheticTerrain>,
}

fn sides(frames: [u64; 2]) -> Sides {
    sides_of(&config(frames))
}

fn sides_of(config: &RunConfig) -> Sides {
    let control = Arc::new(memory::control().expect("a control block"));
    let (cameras, camera_reader) = memory::ring(64).expect("valid");
    let (tree_writer, trees) = memory::ping_pong(NODES).expect("valid");
    let (told, events) = memory::ring(256).expect("valid");
    let ports =
        Ports { control: Arc::clone(&control), cameras: camera_reader, trees: tree_writer, events: Events::new(told) };
    Sides { control, ports, cameras, trees, events, generator: generator(config) }
}

fn generator(config: &RunConfig) -> Generator<SyntheticTerrain> {
    let terrain = SyntheticTerrain::new(&world(), Relief::Mountains { height_m: 400.0 }, 1);
    Generator::new(&world(), terrain, config, TreeLimits { nodes: NODES, elevation_leaves: 1024 })
}

impl Sides {
    fn send(&mut self, frame: u64, camera: Camera) {
        self.send_fields(frame, *camera.fields());
    }

    fn send_fields(&mut self, frame: u64, camera: CameraFields) {
        self.cameras.push(&CameraRecord { frame, camera }, &self.control).expect("room");
    }

    fn frame(&mut self) -> Result<u32, GeneratorError> {
        self.generator.frame(&mut self.ports).map(|stats| stats.node_count)
    }
}

#[test]
fn cameras_become_trees_in_order() {
    let mut sides = sides([30, 50]);
    for k in 0..20 {
        sides.send(30 + k, camera(k));
        let nodes = sides.frame().expect("a tree");
        let tree = sides.trees.next(&sides.control).expect("published");
        let header = *tree.header();
        assert_eq!((header.frame, header.camera, header.node_count), (30 + k, *camera(k).fields(), nodes));
        assert_eq!((header.r_z_px, header.r_c_px, header.is_cut_short), (10.0, 1.0, 0));
        assert!(nodes > 20 && tree.len() == nodes as usize && header.started_nanos <= header.finished_nanos);
        assert_eq!(tree[0].id(), Some(world().root()));
    }
    let told: Vec<Event> = std::iter::from_fn(|| sides.events.try_pop().expect("not corrupt")).collect();
    assert_eq!(told.iter().map(|e| e.frame().get()).collect::<Vec<_>>(), (30..50).collect::<Vec<_>>());
    let span = EventContent::Span { name: SpanName::Generate, node: None };
    assert!(told.iter().all(|event| event.content() == Some(span)));
}

#[test]
fn a_generator_after_another_goes_on_behind_its_trees() {
    let mut sides = sides([30, 50]);
    let taken = |sides: &mut Sides| sides.trees.next(&sides.control).expect("published").header().frame;
    (0..5).for_each(|k| sides.send(30 + k, camera(k)));
    sides.frame().expect("a tree");
    assert_eq!(taken(&mut sides), 30);
    // It is killed during frame 31, while it holds the camera ...
    sides.ports.cameras.take(&sides.control).expect("sent");
    for (begun, expected) in [(false, 31), (true, 33)] {
        if begun {
            // ... and once more after the tree of frame 32, before it gave the camera back.
            let header = TreeHeader { frame: 32, ..TreeHeader::zeroed() };
            sides.ports.trees.write(&sides.control, |_| header).expect("room");
            assert_eq!(taken(&mut sides), 32);
        }
        sides.ports.cameras.put_back();
        sides.generator = generator(&config([30, 50]));
        sides.generator.resume(&mut sides.ports).expect("not corrupt");
        sides.frame().expect("a tree");
        assert_eq!(taken(&mut sides), expected);
    }
    assert_eq!(sides.ports.trees.published(), 4);
}

#[test]
fn what_is_no_camera_or_not_the_next_is_refused() {
    let mut wrong = sides([30, 50]);
    wrong.send(31, camera(0));
    let refused = wrong.frame().expect_err("refused").to_string();
    assert_eq!(refused, "the launcher sent the camera of frame 31, expected frame 30");
    let mut bad = sides([30, 50]);
    bad.send_fields(30, CameraFields { pitch_rad: f64::NAN, ..*camera(0).fields() });
    let refused = bad.frame().expect_err("refused").to_string();
    assert_eq!(refused, "frame 30 has no valid camera: its pitch is NaN, expected a finite angle");
}

#[test]
fn a_run_that_stops_ends_the_wait_for_a_camera() {
    let mut sides = sides([0, 1]);
    sides.control.set_state(RunState::Stopping);
    assert!(sides.frame().expect_err("stopped").is_stopping());
}

#[test]
fn a_frame_allocates_nothing() {
    let mut sides = sides([0, 40]);
    for k in 0..40 {
        sides.send(k, camera(k));
        let made = allocation_counter::measure(|| {
            sides.generator.frame(&mut sides.ports).expect("a tree");
        });
        assert!(k < 2 || made.count_total == 0, "frame {k}: {made:?}");
        drop(sides.trees.next(&sides.control).expect("published"));
    }
}

/// A frame every ten seconds: a test that is slow by some seconds is still within a frame's time.
const PERIOD_NANOS: u64 = 10_000_000_000;

fn realtime(frames: [u64; 2]) -> Sides {
    let realtime = RealtimeConfig { has_feedback: true, coarsest_px: [40.0, 4.0], rest_px: [3.0, 1.0] };
    sides_of(&RunConfig { fps: 0.1, realtime: Some(realtime), ..config(frames) })
}

impl Sides {
    /// The next tree's frame, camera and r_z.
    fn next(&mut self) -> (u64, Camera, f64) {
        self.frame().expect("a tree");
        let tree = self.trees.next(&self.control).expect("published");
        (tree.header().frame, Camera::new(tree.header().camera).expect("valid"), tree.header().r_z_px)
    }
}

#[test]
fn against_the_clock_frames_whose_moment_has_passed_are_left_out_but_the_last() {
    let mut sides = realtime([30, 35]);
    sides.control.publish_camera(&camera(0));
    assert_eq!(sides.next(), (30, camera(0), 10.0));
    // The moments of frames 31 and 32 have passed, 33 is not due yet.
    sides.control.set_completed_sequence(Sequence::new(1));
    sides.control.publish_camera(&camera(7));
    sides.control.start_clock(monotonic_nanos() - PERIOD_NANOS * 5 / 2);
    assert_eq!(sides.next(), (32, camera(7), 10.0));
    assert!(sides.generator.has_next());
    // Long after the end, the last frame is still made.
    sides.control.set_completed_sequence(Sequence::new(2));
    sides.control.start_clock(monotonic_nanos() - PERIOD_NANOS * 40);
    assert_eq!(sides.next(), (34, camera(7), 10.0));
    assert!(!sides.generator.has_next());
    let told: Vec<Event> = std::iter::from_fn(|| sides.events.try_pop().expect("not corrupt")).collect();
    let is_camera = |event: &&Event| matches!(event.content(), Some(EventContent::FrameCamera { .. }));
    let cameras: Vec<u64> = told.iter().filter(is_camera).map(|event| event.frame().get()).collect();
    assert_eq!(cameras, [30, 32, 34]);
}

#[test]
fn slow_frames_make_facets_coarser_within_what_is_allowed() {
    let mut sides = realtime([0, 100]);
    sides.control.publish_camera(&camera(0));
    sides.control.start_clock(monotonic_nanos() - PERIOD_NANOS * 200);
    let mut seen = Vec::new();
    for sequence in 1..20 {
        // Every frame is another view. The clock would skip all but the last; the test continues
        // from the first.
        sides.control.publish_camera(&camera(sequence));
        sides.control.start_clock(monotonic_nanos() - PERIOD_NANOS * (2 * sequence + 1) / 2);
        let (frame, _, r_z_px) = sides.next();
        assert_eq!(sides.control.r_z_px(), Some(r_z_px));
        seen.push(r_z_px);
        let work_nanos = 4 * PERIOD_NANOS;
        let timing = FrameTiming { frame, sequence, r_z_px, work_nanos, ..bytemuck::Zeroable::zeroed() };
        sides.control.publish_timing(&timing);
        sides.control.set_completed_sequence(Sequence::new(sequence));
    }
    assert_eq!((seen[0], seen[18]), (10.0, 40.0));
    assert!(seen.windows(2).all(|pair| pair[0] <= pair[1]), "{seen:?}");
}

#[test]
fn a_run_that_stops_ends_the_wait_for_the_clock() {
    let mut sides = realtime([0, 9]);
    sides.control.publish_camera(&camera(0));
    sides.frame().expect("the first needs no clock");
    sides.control.set_completed_sequence(Sequence::new(1));
    sides.control.set_state(RunState::Stopping);
    assert!(sides.frame().expect_err("stopped").is_stopping());
}
