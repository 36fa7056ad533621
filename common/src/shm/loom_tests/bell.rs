//! The bell: no wake is lost.

use super::{model, wait};
use crate::shm::bell::Bell;
use loom::sync::Arc;
use loom::sync::atomic::{AtomicU64, Ordering};

#[test]
fn loom_a_bell_that_two_threads_ring_loses_no_wake() {
    model(|| {
        let bell = Arc::new(Bell::new());
        let done = Arc::new(AtomicU64::new(0));
        let ringers = [1, 2].map(|bit| {
            let (bell, done) = (Arc::clone(&bell), Arc::clone(&done));
            loom::thread::spawn(move || {
                done.fetch_or(bit, Ordering::Release);
                bell.ring();
            })
        });
        wait(&bell, || (done.load(Ordering::Acquire) == 3).then_some(()));
        ringers.into_iter().for_each(|ringer| ringer.join().unwrap());
    });
}
