//! The sequence lock: whole values.

use super::model;
use crate::shm::seqlock::SeqLock;
use loom::sync::Arc;

#[test]
fn loom_seqlock_gives_whole_values() {
    model(|| {
        let lock = Arc::new(SeqLock::<2>::new());
        lock.write(&[1, 1]);
        // The reader is the thread that is started: the checker shows it older values of words than
        // it shows a first thread that has written them itself.
        let reader = {
            let lock = Arc::clone(&lock);
            loom::thread::spawn(move || {
                if let Some([a, b]) = lock.read() {
                    assert!(a == b && (a == 1 || a == 2));
                }
            })
        };
        lock.write(&[2, 2]);
        reader.join().unwrap();
        assert_eq!(lock.read(), Some([2, 2]));
    });
}
