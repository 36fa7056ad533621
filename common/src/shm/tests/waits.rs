//! How waits end.

use super::within_deadline;
use crate::camera::{Camera, CameraFields};
use crate::ids::Sequence;
use crate::shm::control::{Control, RunState};
use crate::shm::control_words::ControlWords;
use crate::shm::cursor::Positions;
use crate::shm::kind::{SegmentKind, Stage};
use crate::shm::memory::{self, segment};
use crate::shm::process::ProcessId;
use crate::shm::ring::{Consumer, Producer};
use crate::shm::{ShmError, WaitError};
use crate::sync::Ordering;
use std::sync::Arc;
use std::time::Duration;

#[test]
fn every_wait_ends_when_the_run_is_stopped_or_has_failed() {
    within_deadline(|| {
        for (state, is_stopping) in [(RunState::Stopping, true), (RunState::Failed, false)] {
            let control = memory::control().unwrap();
            let (mut producer, mut consumer) = memory::ring::<u64>(2).unwrap();
            let (mut full, _reader) = memory::ring::<u64>(1).unwrap();
            full.try_push(1).unwrap();
            let (_tree_writer, mut trees) = memory::ping_pong(4).unwrap();
            let (mut arrays, _array_reader) = memory::elevation_ring(1, 4).unwrap();
            arrays.begin(&control).unwrap().publish();
            std::thread::scope(|scope| {
                let control = &control;
                let waits = [
                    scope.spawn(move || consumer.pop(control).map(|_| ())),
                    scope.spawn(move || full.push(&2, control)),
                    scope.spawn(move || trees.next(control).map(|_| ())),
                    scope.spawn(move || arrays.begin(control).map(|_| ())),
                    scope.spawn(move || control.wait_completed(Sequence::FIRST).map(|_| ())),
                    scope.spawn(move || control.wait_written(1).map(|_| ())),
                ];
                std::thread::sleep(Duration::from_millis(20));
                assert!(waits.iter().all(|wait| !wait.is_finished()));
                control.set_state(state);
                for wait in waits {
                    assert_eq!(wait.join().unwrap().unwrap_err().is_stopping(), is_stopping);
                }
            });
            // What needs no wait still works.
            producer.push(&1, &control).unwrap();
        }
    });
}

#[test]
fn a_run_that_has_failed_does_not_stop_in_good_order_any_more() {
    let control = memory::control().unwrap();
    assert_eq!(control.state(), RunState::Running);
    control.set_state(RunState::Failed);
    control.set_state(RunState::Stopping);
    control.set_state(RunState::Running);
    assert_eq!(control.state(), RunState::Failed);
}

#[test]
fn a_wait_notices_a_launcher_that_is_gone() {
    within_deadline(|| {
        let own = ProcessId::own().unwrap();
        let gone = ProcessId { start_time: own.start_time + 1, ..own };
        let control = Control::attach(&segment(SegmentKind::Control, 1, 0).unwrap(), gone).unwrap();
        assert!(!control.is_launcher_alive());
        assert!(matches!(control.wait_completed(Sequence::FIRST), Err(WaitError::LauncherGone)));
    });
}

#[test]
fn a_wait_notices_a_peer_that_is_gone_and_was_not_replaced() {
    within_deadline(|| {
        let block = segment(SegmentKind::Control, 1, 0).unwrap();
        let own = ProcessId::own().unwrap();
        let control = Control::attach(&block, own).unwrap();
        control.register(Stage::Preparer).unwrap();
        assert_eq!(control.pid_of(Stage::Preparer), Some(own.pid));
        // A process that was here before us: it had our id, and it is dead.
        let words: &ControlWords = block.words();
        words.stages[Stage::Preparer as usize].start_time.store(own.start_time + 1, Ordering::Release);
        let (_producer, mut consumer) = memory::ring::<u64>(2).unwrap();
        let error = consumer.pop(&control).unwrap_err();
        assert!(matches!(error, WaitError::PeerGone { stage: Stage::Preparer }), "{error}");
        assert_eq!(error.to_string(), "the preparer is gone");
    });
}

#[test]
fn a_wait_ends_with_an_error_when_the_peer_writes_nonsense() {
    within_deadline(|| {
        let ring = segment(SegmentKind::Ring, 4, 8).unwrap();
        let control = memory::control().unwrap();
        let mut consumer = Consumer::<u64>::attach(&ring).unwrap();
        let nonsense = Arc::clone(&ring);
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| consumer.pop(&control));
            std::thread::sleep(Duration::from_millis(10));
            nonsense.words::<Positions>().overwrite(5, 0);
            let error = waiting.join().unwrap().unwrap_err();
            assert!(matches!(error, WaitError::PeerCorrupt { source: ShmError::Corrupt { found: 5, .. } }), "{error}");
        });
        let mut producer = Producer::<u64>::attach(&segment(SegmentKind::Ring, 1, 8).unwrap()).unwrap();
        producer.try_push(1).unwrap();
        assert_eq!(producer.try_push(2), Err(2));
    });
}

#[test]
fn numbers_of_the_control_block_read_back() {
    let control = memory::control().unwrap();
    assert_eq!((control.camera(), control.r_z_px(), control.heartbeat_of(Stage::Renderer)), (None, None, None));
    let camera = Camera::new(CameraFields {
        eye_in_world: [1.0, 2.0, 3.0],
        heading_rad: 0.5,
        pitch_rad: -0.25,
        roll_rad: 0.0,
        vfov_rad: 1.0,
        width: 1280,
        height: 720,
        timestamp_nanos: 5,
    })
    .expect("valid");
    control.publish_camera(&camera);
    assert_eq!(control.camera(), Some(camera));
    let words = bytemuck::cast(CameraFields { vfov_rad: f64::NAN, ..*camera.fields() });
    control.words().camera.0.write(&words);
    assert_eq!(control.camera(), None);
    control.set_resolutions(10.0, 1.5);
    assert_eq!((control.r_z_px(), control.r_c_px()), (Some(10.0), Some(1.5)));
    control.set_resolutions(f64::NAN, -1.0);
    assert_eq!((control.r_z_px(), control.r_c_px()), (None, None));
    control.set_completed_sequence(Sequence::new(7));
    control.set_completed_sequence(Sequence::new(6));
    assert_eq!((control.completed_sequence().get(), control.wait_completed(Sequence::new(7)).unwrap().get()), (7, 7));
    control.set_written_frames(3);
    assert_eq!(control.wait_written(2).unwrap(), 3);
    for (by, counter) in (1..).zip(super::super::control_words::Counter::ALL) {
        control.count(counter, by);
        control.count(counter, by);
        assert_eq!(control.counter(counter), 2 * by);
        assert_eq!(control.counters()[counter as usize], 2 * by);
    }
}
