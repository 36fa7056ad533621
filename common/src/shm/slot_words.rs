//! The state of one pool slot, in atomics.
//!
//! ```text
//!             claim (free, or ready and no frame in flight names it)
//!    Free ──────────────▶ Filling ──publish──▶ Ready ──lock──▶ Locked
//!     ▲                      │                   │
//!     └──────abandon─────────┘                   └──claim──▶ Filling (another generation)
//! ```
//!
//! State, a tag of the generation, and the last frame that wanted the slot are in one word. So "no
//! frame wants it, reuse it" and "a frame wants it, keep it" are single atomic steps, across all
//! processes.

use crate::ids::{Generation, Sequence, SlotIndex, SlotKey};
use crate::node::NodeId;
use crate::sync::{AtomicU32, AtomicU64, Ordering, fence};

const STATE_BITS: u32 = 2;
const TAG_BITS: u32 = 14;
const TAG_MASK: u64 = (1 << TAG_BITS) - 1;
/// Sequences have 48 bits: 8,900 years at 1,000 frames a second.
pub(crate) const MAX_SEQUENCE: u64 = (1 << (64 - STATE_BITS - TAG_BITS)) - 1;

/// The state of a slot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SlotState {
    /// Empty.
    Free = 0,
    /// Being filled.
    Filling = 1,
    /// Holds a tile that may be evicted when no frame needs it.
    Ready = 2,
    /// Holds a tile that is never evicted.
    Locked = 3,
}

impl SlotState {
    /// Whether a tile can be read from it.
    #[must_use]
    pub fn is_readable(self) -> bool {
        matches!(self, Self::Ready | Self::Locked)
    }
}

fn tag_of(generation: Generation) -> u64 {
    u64::from(generation.get()) & TAG_MASK
}

/// The decoded use word.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Use {
    pub(crate) state: SlotState,
    pub(crate) tag: u64,
    pub(crate) sequence: Sequence,
}

impl Use {
    fn unpack(word: u64) -> Self {
        let state = match word & 3 {
            0 => SlotState::Free,
            1 => SlotState::Filling,
            2 => SlotState::Ready,
            _ => SlotState::Locked,
        };
        Self { state, tag: (word >> STATE_BITS) & TAG_MASK, sequence: Sequence::new(word >> (STATE_BITS + TAG_BITS)) }
    }

    fn pack(self) -> u64 {
        self.sequence.get().min(MAX_SEQUENCE) << (STATE_BITS + TAG_BITS) | self.tag << STATE_BITS | self.state as u64
    }

    /// Whether it may be refilled when all frames up to `completed` are completed.
    pub(crate) fn is_reusable(self, completed: Sequence) -> bool {
        match self.state {
            SlotState::Free => true,
            SlotState::Ready => self.sequence <= completed,
            SlotState::Filling | SlotState::Locked => false,
        }
    }

    fn is_of(self, generation: Generation) -> bool {
        self.tag == tag_of(generation)
    }
}

/// One entry of a pool's table; 32 bytes.
#[derive(Debug)]
#[repr(C)]
pub(crate) struct SlotWords {
    /// [`Use`], packed.
    usage: AtomicU64,
    /// [`NodeId::pack`] of the tile.
    node: AtomicU64,
    /// How often the slot was filled; never 0 for a slot that holds a tile.
    generation: AtomicU32,
    reserved: [AtomicU32; 3],
}

#[cfg(not(loom))]
const _: () = assert!(size_of::<SlotWords>() as u64 == super::geometry::TABLE_ENTRY_BYTES);

/// What a slot holds, read consistently.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SlotInfo {
    /// The slot.
    pub slot: SlotIndex,
    /// The tile's node; `None` for a slot that was never filled.
    pub node: Option<NodeId>,
    /// Its generation, which changes whenever the slot is refilled.
    pub generation: Generation,
    /// What the slot is doing.
    pub state: SlotState,
    /// Sequence of the last frame that wanted it.
    pub last_used: Sequence,
}

impl SlotInfo {
    /// The key of the tile that is in the slot now.
    #[must_use]
    pub fn key(&self) -> SlotKey {
        SlotKey { slot: self.slot, generation: self.generation }
    }
}

impl SlotWords {
    #[cfg(loom)]
    pub(crate) fn new() -> Self {
        Self {
            usage: AtomicU64::new(0),
            node: AtomicU64::new(0),
            generation: AtomicU32::new(0),
            reserved: [AtomicU32::new(0), AtomicU32::new(0), AtomicU32::new(0)],
        }
    }

    pub(crate) fn usage(&self) -> Use {
        // Acquire: SYNC pool.publish, the content of a readable slot is written.
        Use::unpack(self.usage.load(Ordering::Acquire))
    }

    pub(crate) fn generation(&self) -> Generation {
        // Relaxed: compared with the caller's value; the use word orders it.
        Generation::new(self.generation.load(Ordering::Relaxed))
    }

    /// Takes the slot to fill it, if it is reusable. `completed` was read with Acquire (SYNC
    /// control.completed), so that the old tile is no longer read. Returns the new generation.
    pub(crate) fn claim(&self, node: NodeId, sequence: Sequence, completed: Sequence) -> Option<Generation> {
        // Relaxed: the exchange below checks it.
        let word = self.usage.load(Ordering::Relaxed);
        let before = Use::unpack(word);
        if !before.is_reusable(completed) {
            return None;
        }
        let generation = self.generation().next();
        let after = Use { state: SlotState::Filling, tag: tag_of(generation), sequence };
        // Acquire: SYNC pool.free, an abandoned fill is over. A failure means that a reader wants
        // it now.
        self.usage.compare_exchange(word, after.pack(), Ordering::Acquire, Ordering::Relaxed).ok()?;
        // SYNC pool.refill: a reader that reads the new generation or node, and then fences, sees
        // that the slot is not ready.
        fence(Ordering::Release);
        self.generation.store(generation.get(), Ordering::Relaxed);
        self.node.store(node.pack(), Ordering::Relaxed);
        Some(generation)
    }

    /// Makes the tile visible. To be called once, by the filler of the slot.
    pub(crate) fn publish(&self) {
        // Exchanges bits, because readers may raise the sequence at the same time: Filling (1)
        // becomes Ready (2). Release: SYNC pool.publish, the tile's bytes come before.
        self.usage.fetch_xor(SlotState::Filling as u64 ^ SlotState::Ready as u64, Ordering::Release);
    }

    /// Gives up the slot unfilled. To be called once, by the filler of the slot.
    pub(crate) fn abandon(&self) {
        // Filling (1) becomes Free (0). Release: SYNC pool.free, our writes to the bytes come
        // before.
        self.usage.fetch_xor(SlotState::Filling as u64, Ordering::Release);
    }

    /// Pins the tile for frame `sequence`: it stays until that frame is completed. `false` when the
    /// slot no longer has this generation (`None`: any).
    pub(crate) fn touch(&self, generation: Option<Generation>, sequence: Sequence) -> bool {
        let mut word = self.usage.load(Ordering::Relaxed);
        loop {
            let before = Use::unpack(word);
            if before.state == SlotState::Free || generation.is_some_and(|wanted| !before.is_of(wanted)) {
                return false;
            }
            if before.sequence >= sequence {
                return true;
            }
            let after = Use { sequence, ..before };
            // Relaxed: the modification order of this word decides between a touch and a claim.
            match self.usage.compare_exchange_weak(word, after.pack(), Ordering::Relaxed, Ordering::Relaxed) {
                Ok(_) => return true,
                Err(other) => word = other,
            }
        }
    }

    /// Locks a readable slot, so that it is never reused; `false` when it is empty.
    pub(crate) fn lock(&self) -> bool {
        let mut word = self.usage.load(Ordering::Relaxed);
        loop {
            let before = Use::unpack(word);
            if !before.state.is_readable() {
                return false;
            }
            let after = Use { state: SlotState::Locked, ..before };
            // Relaxed: as in `touch`.
            match self.usage.compare_exchange_weak(word, after.pack(), Ordering::Relaxed, Ordering::Relaxed) {
                Ok(_) => return true,
                Err(other) => word = other,
            }
        }
    }

    /// Whether the slot holds the tile of this generation, readable.
    pub(crate) fn is_readable(&self, generation: Generation) -> bool {
        let usage = self.usage();
        generation != Generation::NEVER_FILLED
            && usage.state.is_readable()
            && usage.is_of(generation)
            && self.generation() == generation
    }

    /// A consistent copy of state, node and generation. A slot that changes meanwhile is reported
    /// as being filled.
    pub(crate) fn info(&self, slot: SlotIndex) -> SlotInfo {
        let before = self.usage();
        // Relaxed, both: ordered by the Acquire before and the fence after.
        let generation = self.generation();
        let node = self.node.load(Ordering::Relaxed);
        // SYNC pool.refill.
        fence(Ordering::Acquire);
        let after = Use::unpack(self.usage.load(Ordering::Relaxed));
        let is_same = before.tag == after.tag && before.state.is_readable() == after.state.is_readable();
        let state = if is_same { after.state } else { SlotState::Filling };
        let node = if generation == Generation::NEVER_FILLED { None } else { NodeId::unpack(node) };
        SlotInfo { slot, node, generation, state, last_used: after.sequence }
    }

    /// Frees a slot whose filler is dead. To be called by a new writer, before it fills any slot.
    pub(crate) fn recover(&self) {
        if self.usage().state == SlotState::Filling {
            self.abandon();
        }
    }
}
