//! Contained panics reach no hook. A program of its own: hooks belong to the process.

use std::panic::{catch_unwind, set_hook};
use std::sync::atomic::{AtomicUsize, Ordering};
use terravision_common::bug::contained;

static TOLD: AtomicUsize = AtomicUsize::new(0);

#[test]
fn a_contained_panic_reaches_no_hook() {
    set_hook(Box::new(|_panic| _ = TOLD.fetch_add(1, Ordering::Relaxed)));
    assert!(contained(|| -> u8 { panic!("contained") }).is_err());
    assert_eq!(TOLD.load(Ordering::Relaxed), 0);
    assert!(catch_unwind(|| -> u8 { panic!("of our own") }).is_err());
    assert_eq!(TOLD.load(Ordering::Relaxed), 1);
}
