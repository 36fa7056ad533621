//! The want list: read whole or not at all, the newest never missed.

use super::{model, wait};
use crate::shm::want_core::{HEAD_WORDS, Look, WantEntry, WantWords};
use loom::sync::Arc;

struct HeapWants {
    words: WantWords,
    entries: Vec<WantEntry>,
}

impl HeapWants {
    fn new(capacity: usize) -> Arc<Self> {
        Arc::new(Self { words: WantWords::new(), entries: (0..capacity).map(|_| WantEntry::new()).collect() })
    }

    /// A list of `tiles` tiles whose head says of which.
    fn write(&self, sequence: u64, tiles: &[u64]) {
        let mut head = [0; HEAD_WORDS];
        (head[0], head[HEAD_WORDS - 1]) = (sequence, tiles.len() as u64);
        self.words.write(&self.entries, head, tiles.iter().copied());
    }
}

#[test]
fn loom_want_list_is_read_whole_or_not_at_all() {
    model(|| {
        let wants = HeapWants::new(2);
        wants.write(1, &[1, 1]);
        let writer = {
            let wants = Arc::clone(&wants);
            loom::thread::spawn(move || wants.write(2, &[2]))
        };
        let mut tiles = Vec::new();
        let looked = wants.words.read(&wants.entries, 0, &mut tiles);
        if let Look::Changed { head, version } = looked {
            let expected: &[u64] = if head[0] == 1 { &[1, 1] } else { &[2] };
            assert_eq!(tiles, expected);
            assert_eq!(version, 2 * head[0]);
        }
        writer.join().unwrap();
        assert!(matches!(wants.words.read(&wants.entries, 2, &mut tiles), Look::Changed { version: 4, .. }));
        assert_eq!(tiles, [2]);
    });
}

#[test]
fn loom_want_list_wakes_its_reader_for_the_newest() {
    model(|| {
        let wants = HeapWants::new(1);
        let writer = {
            let wants = Arc::clone(&wants);
            loom::thread::spawn(move || {
                for sequence in 1..=2 {
                    wants.write(sequence, &[sequence]);
                    wants.words.bell().ring();
                }
            })
        };
        // Lists may be missed, the last one never.
        let (mut seen, mut tiles) = (0, Vec::new());
        loop {
            let head = wait(wants.words.bell(), || match wants.words.read(&wants.entries, seen, &mut tiles) {
                Look::Changed { version, head } => {
                    seen = version;
                    Some(head)
                }
                Look::Unchanged | Look::Busy => None,
            });
            if head[0] == 2 {
                break;
            }
        }
        writer.join().unwrap();
    });
}
