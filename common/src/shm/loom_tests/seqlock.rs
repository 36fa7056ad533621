//! The sequence lock: whole values.

use super::model;
use crate::shm::seqlock::SeqLock;
use loom::sync::Arc;

#[test]
fn loom_seqlock_gives_whole_values() {
    model(|| {
        let lock = Arc::new(SeqLock::<2>::new());
        lock.write(&[1, 1]);
        let writer = {
            let lock = Arc::clone(&lock);
            loom::thread::spawn(move || lock.write(&[2, 2]))
        };
        if let Some([a, b]) = lock.read() {
            assert!(a == b && (a == 1 || a == 2));
        }
        writer.join().unwrap();
        assert_eq!(lock.read(), Some([2, 2]));
    });
}
