//! Eviction: when a tile needs a slot, the least recently wanted (or predicted) tile is evicted, of
//! those that no frame in flight uses.

use super::PoolWriter;
use crate::ids::{Sequence, SlotIndex, SlotKey};
use crate::node::NodeId;
use crate::shm::pool::SlotState;
use crate::shm::pool::reader::numbered;
use crate::shm::slot_words::SlotWords;

/// Eviction candidates that are collected in one scan of the table.
const CANDIDATES: usize = 256;

impl PoolWriter {
    /// The sequence at which a reusable slot's tile was last wanted or predicted;
    /// [`Sequence::NONE`] for a free slot. `None` for a slot that is in use.
    pub(super) fn rank(&self, slot: SlotIndex, words: &SlotWords, completed: Sequence) -> Option<Sequence> {
        let usage = words.usage();
        match usage.state {
            SlotState::Free => Some(Sequence::NONE),
            // Never `Sequence::NONE`: a tile without a known use (from before a restart of the
            // writer) is evicted only when no slot is free.
            _ if usage.is_reusable(completed) => {
                Some(usage.sequence.max(self.expected_at[slot.index()]).max(Sequence::FIRST))
            }
            _ => None,
        }
    }

    /// A slot for a tile of `node` that frame `sequence` wants: a free one, otherwise the least
    /// recently wanted one, if that was before `limit`.
    pub(super) fn claim(
        &mut self,
        node: NodeId,
        sequence: Sequence,
        completed: Sequence,
        limit: Option<Sequence>,
    ) -> Option<SlotKey> {
        let mut looks = 0;
        loop {
            if self.candidates.is_empty() {
                // Candidates of a fresh scan fail only when readers pin them at this very moment.
                if looks == 2 {
                    return None;
                }
                looks += 1;
                self.find_candidates(completed);
            }
            let (seen, slot) = self.candidates.pop()?;
            let words = self.place.words(slot)?;
            // A slot that was wanted since the scan is no longer a candidate.
            if self.rank(slot, words, completed) != Some(seen) {
                continue;
            }
            if looks == 0 && seen > self.looked_at && completed > self.looked_at {
                // It is predicted, and frames that were completed since may have left slots that
                // are not.
                self.candidates.clear();
                continue;
            }
            if limit.is_some_and(|limit| seen >= limit) {
                // So are all others; but this one may be evicted for a wanted tile.
                self.candidates.push((seen, slot));
                return None;
            }
            if let Some(generation) = words.claim(node, sequence, completed) {
                return Some(SlotKey { slot, generation });
            }
        }
    }

    /// Collects the least recently wanted reusable slots. Candidates of later scans were all wanted
    /// later than these (except predicted ones, which `claim` handles), so several scans give the
    /// same order as one.
    fn find_candidates(&mut self, completed: Sequence) {
        self.looked_at = completed;
        let mut candidates = std::mem::take(&mut self.candidates);
        for (slot, words) in numbered(&self.place.segment) {
            if let Some(rank) = self.rank(slot, words, completed) {
                candidates.push((rank, slot));
            }
        }
        self.candidates = candidates;
        let newest_first = |a: &(Sequence, SlotIndex), b: &(Sequence, SlotIndex)| b.cmp(a);
        let surplus = self.candidates.len().saturating_sub(CANDIDATES);
        if surplus > 0 {
            self.candidates.select_nth_unstable_by(surplus, newest_first);
            self.candidates.drain(..surplus);
        }
        self.candidates.sort_unstable_by(newest_first);
    }
}
