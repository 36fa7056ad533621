//! The frame ring: whole frames, and the one that was gone for.

use super::model;
use crate::shm::frame_core::{FrameSlot, Outlet, begin, newest, publish};
use loom::sync::Arc;
use loom::sync::atomic::{AtomicU64, Ordering};

const FRAME_WORDS: usize = 2;

/// A frame ring of two slots.
struct HeapFrames {
    newest: AtomicU64,
    sequences: [AtomicU64; 2],
    words: [[AtomicU64; FRAME_WORDS]; 2],
}

impl HeapFrames {
    fn new() -> Arc<Self> {
        let words = || std::array::from_fn(|_| AtomicU64::new(0));
        let sequences = [AtomicU64::new(0), AtomicU64::new(0)];
        Arc::new(Self { newest: AtomicU64::new(0), sequences, words: [words(), words()] })
    }

    fn slot(&self, number: u64) -> FrameSlot<'_> {
        let index = (number.wrapping_sub(1) % 2) as usize;
        FrameSlot { sequence: &self.sequences[index], words: &self.words[index] }
    }

    fn out(&self, number: u64) -> Words<'_> {
        Words { sequence: self.slot(number).sequence, newest: &self.newest }
    }

    fn write(&self, number: u64) {
        let mut out = self.out(number);
        let Ok(()) = begin(&mut out, number);
        for word in self.slot(number).words {
            word.store(100 + number, Ordering::Relaxed);
        }
        let Ok(()) = publish(&mut out, number);
    }

    /// Number and words of the newest frame, if the copy was not overtaken.
    fn read(&self) -> Option<(u64, Vec<u64>)> {
        let number = newest(&self.newest);
        if number == 0 {
            return None;
        }
        let copy = |words: &[AtomicU64]| words.iter().map(|word| word.load(Ordering::Relaxed)).collect();
        Some((number, self.slot(number).copy(number, copy)?))
    }
}

/// A slot's sequence and the ring's newest number.
struct Words<'a> {
    sequence: &'a AtomicU64,
    newest: &'a AtomicU64,
}

impl Outlet for Words<'_> {
    type Error = std::convert::Infallible;

    fn sequence(&mut self, value: u64) -> Result<(), Self::Error> {
        self.sequence.store(value, Ordering::Relaxed);
        Ok(())
    }

    fn newest(&mut self, number: u64) -> Result<(), Self::Error> {
        self.newest.store(number, Ordering::Relaxed);
        Ok(())
    }
}

#[test]
fn loom_frame_ring_gives_whole_frames_and_the_one_that_was_asked_for() {
    model(|| {
        let ring = HeapFrames::new();
        ring.write(1);
        let writer = {
            let ring = Arc::clone(&ring);
            // The third frame takes the place of the first.
            loom::thread::spawn(move || (2..=3).for_each(|number| ring.write(number)))
        };
        if let Some((number, words)) = ring.read() {
            assert_eq!(words, vec![100 + number; FRAME_WORDS]);
        }
        writer.join().unwrap();
        assert_eq!(ring.read(), Some((3, vec![103; FRAME_WORDS])));
    });
}

#[test]
fn loom_frame_ring_always_has_a_newest_frame_that_is_whole_unless_it_is_overtaken() {
    model(|| {
        let ring = HeapFrames::new();
        ring.write(1);
        let writer = {
            let ring = Arc::clone(&ring);
            loom::thread::spawn(move || ring.write(2))
        };
        // One more frame does not overtake the reader: the copy cannot fail.
        let (number, words) = ring.read().expect("a frame was published");
        assert_eq!(words, vec![100 + number; FRAME_WORDS]);
        writer.join().unwrap();
    });
}

#[test]
fn loom_frame_ring_goes_on_after_a_writer_that_died_in_a_frame() {
    model(|| {
        let ring = HeapFrames::new();
        ring.write(1);
        // Killed in the middle of frame 2.
        let Ok(()) = begin(&mut ring.out(2), 2);
        ring.slot(2).words[0].store(7, Ordering::Relaxed);
        let successor = {
            let ring = Arc::clone(&ring);
            loom::thread::spawn(move || ring.write(newest(&ring.newest) + 1))
        };
        let (number, words) = ring.read().expect("a frame was published");
        assert_eq!(words, vec![100 + number; FRAME_WORDS]);
        successor.join().unwrap();
    });
}

#[test]
fn loom_frame_slot_is_whole_also_for_who_does_not_go_by_the_newest() {
    model(|| {
        let ring = HeapFrames::new();
        let writer = {
            let ring = Arc::clone(&ring);
            loom::thread::spawn(move || ring.write(1))
        };
        let copy = |words: &[AtomicU64]| words.iter().map(|word| word.load(Ordering::Relaxed)).collect();
        let words: Option<Vec<u64>> = ring.slot(1).copy(1, copy);
        assert!(words.is_none_or(|words| words == vec![101; FRAME_WORDS]));
        writer.join().unwrap();
    });
}
