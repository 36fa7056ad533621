//! The ping-pong buffer: a half belongs to one side at a time.

use super::{HeapItems, KIND, model, wait};
use crate::shm::cursor::{ReadCursor, WriteCursor};
use loom::sync::Arc;

#[test]
fn loom_ping_pong_gives_each_half_to_one_side_at_a_time() {
    model(|| {
        // A half is written and read in place, in several steps, between the cursor's calls, as the
        // handles do it.
        let halves = HeapItems::new(2);
        let mut writer = WriteCursor::attach(&halves.positions, KIND, 2).unwrap();
        let mut reader = ReadCursor::attach(&halves.positions, KIND, 2).unwrap();
        let generator = {
            let halves = Arc::clone(&halves);
            loom::thread::spawn(move || {
                for tree in 1..=3u64 {
                    wait(halves.positions.writable(), || {
                        (writer.room(&halves.positions, 1).unwrap() > 0).then_some(())
                    });
                    let half = (writer.position() & 1) as usize;
                    // SAFETY: the half is ours; loom checks that.
                    halves.cells[half].with_mut(|cell| unsafe { *cell = 100 * tree });
                    // SAFETY: as above.
                    halves.cells[half].with_mut(|cell| unsafe { *cell += tree });
                    writer.publish(&halves.positions, 1);
                }
            })
        };
        for tree in 1..=3u64 {
            wait(halves.positions.readable(), || (reader.filled(&halves.positions).unwrap() > 0).then_some(()));
            let half = (reader.position() & 1) as usize;
            for _ in 0..2 {
                // SAFETY: the half is ours until the release; loom checks that.
                assert_eq!(halves.cells[half].with(|cell| unsafe { *cell }), 101 * tree);
            }
            reader.release(&halves.positions, 1);
        }
        generator.join().unwrap();
    });
}
