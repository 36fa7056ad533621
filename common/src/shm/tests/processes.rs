//! Two processes: the test, and this very binary started again to run one of the parts below.

use super::{DEADLINE, within_deadline};
use crate::ids::{RingPosition, Sequence};
use crate::node::NodeId;
use crate::shm::{
    CameraRecord, Consumer, Control, ElevationReader, ElevationWriter, Layout, PoolReader, PoolWriter, Producer, RunId,
    RunSegments, SegmentKind, Stage, TreeReader, TreeWriter, WaitError, reap_dead_runs,
};
use crate::slot::{FrameEnd, Slot, SlotContent, TileSlot};
use crate::tree::{TreeHeader, TreeNode};
use bytemuck::Zeroable;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

const PART: &str = "TERRAVISION_SHM_TEST_PART";
const RUN: &str = "TERRAVISION_SHM_TEST_RUN";
const FRAMES: u64 = 200;

/// The second process, killed when dropped.
struct Part(Child);

impl Part {
    fn start(part: &str, run: &str) -> Self {
        let name = "shm::tests::processes::the_second_process";
        let child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", name, "--ignored", "--nocapture", "--test-threads=1"])
            .env(PART, part)
            .env(RUN, run)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        Self(child)
    }

    fn wait(mut self) {
        let start = Instant::now();
        loop {
            if let Some(status) = self.0.try_wait().unwrap() {
                assert!(status.success(), "the second process failed: {status}");
                return;
            }
            assert!(start.elapsed() < DEADLINE, "the second process hangs");
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    fn kill(mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

impl Drop for Part {
    fn drop(&mut self) {
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

#[test]
#[ignore = "a part of other tests, which start it in a process of its own"]
fn the_second_process() {
    let (Ok(part), Ok(run)) = (std::env::var(PART), std::env::var(RUN)) else { return };
    match part.as_str() {
        "stages" => generate_and_prepare(&RunId::parse(&run).unwrap()),
        "flood" => flood(&RunId::parse(&run).unwrap()),
        "stalled" => hold_everything(&RunId::parse(&run).unwrap()),
        "launch" => launch(),
        other => panic!("no part {other}"),
    }
}

fn node(frame: u64) -> NodeId {
    NodeId::new(frame as u32, 1, 0).unwrap()
}

/// Generator and preparer in one process: a tree for each camera, and a slot, an array and a tile
/// for each tree.
fn generate_and_prepare(run: &RunId) {
    let control = Control::open(run).unwrap();
    control.register(Stage::Generator).unwrap();
    control.register(Stage::Preparer).unwrap();
    let mut cameras = Consumer::<CameraRecord>::open(run, SegmentKind::CameraRing).unwrap();
    let mut trees = TreeWriter::open(run).unwrap();
    let mut ring = Producer::<Slot>::open(run, SegmentKind::Ring).unwrap();
    let mut arrays = ElevationWriter::open(run).unwrap();
    let mut pool = PoolWriter::open(run, SegmentKind::ColorPool).unwrap();
    for sequence in 1..=FRAMES {
        let frame = cameras.pop(&control).unwrap().frame;
        trees
            .write(&control, |nodes| {
                nodes[..3].fill(TreeNode { node: node(frame).pack(), ..TreeNode::zeroed() });
                TreeHeader { frame, node_count: 3, ..TreeHeader::zeroed() }
            })
            .unwrap();
        let mut array = arrays.begin(&control).unwrap();
        array.fill(frame as f32);
        let elevation_position = array.publish();
        let mut guard = loop {
            if let Some(guard) = pool.allocate(node(frame), Sequence::new(sequence), control.completed_sequence()) {
                break guard;
            }
            control.wait_completed(control.completed_sequence().next()).unwrap();
        };
        guard.bytes_mut().fill(frame as u8);
        let key = guard.publish();
        let tile = TileSlot { node: node(frame).pack(), elevation_position, ..TileSlot::zeroed() }.with_color(key);
        let end = FrameEnd { frame, elevation_end: elevation_position + 1, ..FrameEnd::zeroed() };
        ring.push_all(&[Slot::new(&SlotContent::Tile(tile)), Slot::new(&SlotContent::End(end))], &control).unwrap();
    }
    // The pools and rings are read until the last frame is drawn.
    control.wait_completed(Sequence::new(FRAMES)).unwrap();
}

#[test]
fn frames_pass_from_process_to_process_through_every_segment() {
    within_deadline(|| {
        let run = RunId::unique_for_tests();
        let _segments = RunSegments::create(&run, &Layout::small()).unwrap();
        let part = Part::start("stages", &run.to_string());
        let control = Control::open(&run).unwrap();
        let mut cameras = Producer::<CameraRecord>::open(&run, SegmentKind::CameraRing).unwrap();
        let mut trees = TreeReader::open(&run).unwrap();
        let mut ring = Consumer::<Slot>::open(&run, SegmentKind::Ring).unwrap();
        let mut arrays = ElevationReader::open(&run).unwrap();
        let pool = PoolReader::open(&run, SegmentKind::ColorPool).unwrap();
        std::thread::scope(|scope| {
            scope.spawn(|| {
                for frame in 1000..1000 + FRAMES {
                    cameras.push(&CameraRecord { frame, ..CameraRecord::zeroed() }, &control).unwrap();
                }
            });
            for (sequence, frame) in (1..).zip(1000..1000 + FRAMES) {
                let tree = trees.next(&control).unwrap();
                assert_eq!((tree.header().frame, tree.len()), (frame, 3));
                assert!(tree.iter().all(|found| found.id() == Some(node(frame))));
                drop(tree);
                let Some(SlotContent::Tile(tile)) = ring.pop(&control).unwrap().read() else { panic!("no tile") };
                assert_eq!(tile.node, node(frame).pack());
                let values = arrays.read_array(tile.elevation_position).unwrap().unwrap();
                assert!(values.len() == 25 && values.iter().all(|&value| value == frame as f32));
                let bytes = pool.bytes(tile.color()).unwrap();
                assert!(bytes.iter().all(|&byte| byte == frame as u8));
                let Some(SlotContent::End(end)) = ring.pop(&control).unwrap().read() else { panic!("no end") };
                assert_eq!(end.frame, frame);
                arrays.released(RingPosition::new(end.elevation_end)).unwrap();
                control.set_completed_sequence(Sequence::new(sequence));
            }
        });
        part.wait();
    });
}

/// Pushes numbers until it is killed.
fn flood(run: &RunId) {
    let control = Control::open(run).unwrap();
    control.register(Stage::Preparer).unwrap();
    let mut ring = Producer::<Slot>::open(run, SegmentKind::Ring).unwrap();
    for frame in 0.. {
        let end = FrameEnd { frame, elevation_end: !frame, ..FrameEnd::zeroed() };
        if ring.push(&Slot::new(&SlotContent::End(end)), &control).is_err() {
            return;
        }
    }
}

fn pop_frame(ring: &mut Consumer<Slot>, control: &Control) -> Result<u64, WaitError> {
    let Some(SlotContent::End(end)) = ring.pop(control)?.read() else { panic!("a torn slot") };
    assert_eq!(end.elevation_end, !end.frame, "a torn slot");
    Ok(end.frame)
}

#[test]
fn a_producer_that_is_killed_leaves_whole_items_and_its_successor_goes_on() {
    within_deadline(|| {
        let run = RunId::unique_for_tests();
        let _segments = RunSegments::create(&run, &Layout::small()).unwrap();
        let control = Control::open(&run).unwrap();
        let mut ring = Consumer::<Slot>::open(&run, SegmentKind::Ring).unwrap();
        for generation in 1..=3 {
            let part = Part::start("flood", &run.to_string());
            let pid = part.0.id();
            for expected in 0..1000 * generation {
                assert_eq!(pop_frame(&mut ring, &control).unwrap(), expected);
            }
            assert_eq!(control.pid_of(Stage::Preparer), Some(pid));
            assert_eq!(control.generation_of(Stage::Preparer), generation);
            part.kill();
            // What it had published is all there, and no more comes: the wait says why.
            let mut expected = 1000 * generation;
            let ended = loop {
                match pop_frame(&mut ring, &control) {
                    Ok(frame) => assert_eq!(frame, expected),
                    Err(ended) => break ended,
                }
                expected += 1;
            };
            assert!(matches!(ended, WaitError::PeerGone { stage: Stage::Preparer }), "{ended}");
        }
    });
}

/// Holds a half that it reads, an array and a slot that it fills, says so, and never comes back.
fn hold_everything(run: &RunId) {
    let control = Control::open(run).unwrap();
    let mut trees = TreeReader::open(run).unwrap();
    let mut arrays = ElevationWriter::open(run).unwrap();
    let mut pool = PoolWriter::open(run, SegmentKind::ColorPool).unwrap();
    let tree = trees.next(&control).unwrap();
    let mut array = arrays.begin(&control).unwrap();
    array.fill(1.0);
    let mut guard = pool.allocate(node(1), Sequence::FIRST, Sequence::NONE).unwrap();
    guard.bytes_mut().fill(1);
    control.set_written_frames(1);
    std::thread::sleep(DEADLINE);
    drop((tree, array, guard));
}

#[test]
fn what_a_killed_process_held_is_free_for_its_successor() {
    within_deadline(|| {
        let run = RunId::unique_for_tests();
        let _segments = RunSegments::create(&run, &Layout::small()).unwrap();
        let control = Control::open(&run).unwrap();
        let mut trees = TreeWriter::open(&run).unwrap();
        trees.write(&control, |_| TreeHeader { frame: 7, ..TreeHeader::zeroed() }).unwrap();
        let part = Part::start("stalled", &run.to_string());
        control.wait_written(1).unwrap();
        assert!(ElevationWriter::open(&run).is_err() && TreeReader::open(&run).is_err());
        part.kill();
        // The tree was not given back: it is read again. The array and the tile were not published:
        // they never were.
        let mut reader = TreeReader::open(&run).unwrap();
        assert_eq!(reader.next(&control).unwrap().header().frame, 7);
        assert_eq!(ElevationWriter::open(&run).unwrap().begin(&control).unwrap().position(), 0);
        let mut pool = PoolWriter::open(&run, SegmentKind::ColorPool).unwrap();
        assert_eq!(pool.find(node(1)), None);
        let guards: Vec<_> = (0..8).map_while(|i| pool.allocate(node(i), Sequence::FIRST, Sequence::NONE)).collect();
        assert_eq!(guards.len(), 8, "a slot is lost");
    });
}

/// A launcher that makes segments and waits to be killed.
fn launch() {
    let run = RunId::new_for_this_process().unwrap();
    let _segments = RunSegments::create(&run, &Layout::small()).unwrap();
    println!("run {run}");
    std::thread::sleep(DEADLINE);
}

#[test]
fn stages_notice_a_killed_launcher_and_the_next_one_cleans_up_behind_it() {
    within_deadline(|| {
        let mut part = Part::start("launch", "");
        let lines = BufReader::new(part.0.stdout.take().unwrap()).lines();
        let run = lines.map_while(Result::ok).find_map(|line| Some(line.split_once("run tv-")?.1.to_owned())).unwrap();
        let run = RunId::parse(&format!("tv-{}", run.trim())).unwrap();
        let control = Control::open(&run).unwrap();
        assert!(control.is_launcher_alive());
        assert!(reap_dead_runs().iter().all(|name| !name.starts_with(&run.to_string())), "a live run was removed");
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| control.wait_completed(Sequence::FIRST));
            std::thread::sleep(Duration::from_millis(150));
            assert!(!waiting.is_finished());
            part.kill();
            assert!(matches!(waiting.join().unwrap(), Err(WaitError::LauncherGone)));
        });
        assert!(!control.is_launcher_alive());
        drop(reap_dead_runs());
        for kind in SegmentKind::ALL {
            assert!(!std::path::Path::new("/dev/shm").join(run.segment_name(kind)).exists(), "{kind}");
        }
        // A run whose launcher is dead is not waited for.
        assert!(Control::open(&run).is_err());
    });
}
