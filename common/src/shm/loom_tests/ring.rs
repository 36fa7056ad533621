//! The ring: items in order, none lost, none torn, no wake lost.

use super::{HeapItems, KIND, model, wait};
use crate::shm::ring_core::{ReadEnd, WriteEnd};
use loom::sync::Arc;

#[test]
fn loom_ring_hands_over_every_item_in_order_and_loses_no_wake() {
    model(|| {
        let items = HeapItems::new(2);
        let mut producer = WriteEnd::attach(Arc::clone(&items), KIND, 2).unwrap();
        let mut consumer = ReadEnd::attach(Arc::clone(&items), KIND, 2).unwrap();
        let writer = loom::thread::spawn(move || {
            let items = Arc::clone(&producer.items);
            for item in 1..=3 {
                wait(items.positions.writable(), || producer.try_push(&item).unwrap().then_some(()));
            }
        });
        for expected in 1..=3 {
            let item = wait(items.positions.readable(), || consumer.try_pop().unwrap());
            assert_eq!(item, expected);
        }
        writer.join().unwrap();
    });
}

#[test]
fn loom_ring_publishes_a_batch_as_far_as_it_fits() {
    model(|| {
        let items = HeapItems::new(2);
        let mut producer = WriteEnd::attach(Arc::clone(&items), KIND, 2).unwrap();
        let mut consumer = ReadEnd::attach(Arc::clone(&items), KIND, 2).unwrap();
        let writer = loom::thread::spawn(move || {
            let items = Arc::clone(&producer.items);
            let mut rest: &[u64] = &[1, 2, 3];
            while !rest.is_empty() {
                let count = wait(items.positions.writable(), || {
                    Some(producer.try_push_some(rest).unwrap()).filter(|&count| count > 0)
                });
                rest = &rest[count..];
            }
        });
        for expected in 1..=3 {
            assert_eq!(wait(items.positions.readable(), || consumer.try_pop().unwrap()), expected);
        }
        writer.join().unwrap();
    });
}

#[test]
fn loom_ring_touches_no_item_that_is_held_and_gives_it_again() {
    model(|| {
        let items = HeapItems::new(2);
        let mut producer = WriteEnd::attach(Arc::clone(&items), KIND, 2).unwrap();
        let mut consumer = ReadEnd::attach(Arc::clone(&items), KIND, 2).unwrap();
        let writer = loom::thread::spawn(move || {
            let items = Arc::clone(&producer.items);
            for item in 1..=3 {
                wait(items.positions.writable(), || producer.try_push(&item).unwrap().then_some(()));
            }
        });
        let take = |consumer: &mut ReadEnd<_>| wait(items.positions.readable(), || consumer.try_take().unwrap());
        assert_eq!((take(&mut consumer), take(&mut consumer)), (1, 2));
        // Its reader was killed; the one after it finds both again.
        drop(consumer);
        let mut consumer = ReadEnd::attach(Arc::clone(&items), KIND, 2).unwrap();
        assert_eq!((take(&mut consumer), take(&mut consumer)), (1, 2));
        consumer.give_back(1);
        assert_eq!((take(&mut consumer), consumer.held()), (3, 2));
        writer.join().unwrap();
    });
}
