//! Exact mode: a frame waits until every tile that it wants is in its pool, or known to be
//! unavailable.

use crate::frame_tree::Tile;
use crate::loader::{TileLoader, TileState};
use std::time::{Duration, Instant};
use terravision_common::database::Layer;
use terravision_common::ids::{FrameNumber, Sequence};
use terravision_common::node::NodeId;
use terravision_common::shm::{Control, Layout, WaitError};
use terravision_common::texels::TexelFormat;
use terravision_common::top_levels::top_levels;
use terravision_common::world::World;

/// Why waiting for a frame's tiles failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AwaitError {
    /// The pools are too small.
    #[error(
        "frame {frame} needs {needed_mib} MiB of tiles and --memory gives {given_mib} MiB: \
         allow more, or ask for less with a larger --texel-px or --facet-px"
    )]
    TooLittleMemory {
        /// The frame.
        frame: FrameNumber,
        /// The value that `--memory` would need.
        needed_mib: u64,
        /// The size of the pools.
        given_mib: u64,
    },
    /// The pools have their maximum size.
    #[error(
        "frame {frame} needs {needed} {layer} tiles at once and a pool holds {capacity} at most: \
         ask for less with a larger --texel-px or --facet-px"
    )]
    TooManyTiles {
        /// The frame.
        frame: FrameNumber,
        /// The pyramid.
        layer: Layer,
        /// Tiles that it needs.
        needed: u64,
        /// What the pool holds.
        capacity: u64,
    },
    /// The run ended.
    #[error(transparent)]
    Wait {
        /// How.
        #[from]
        source: WaitError,
    },
}

/// Waits for tiles; keeps its buffers.
#[derive(Debug)]
pub struct TileWait {
    world: World,
    texels: TexelFormat,
    pending: Vec<Tile>,
    /// The top levels, which are always in the pools.
    locked: Vec<Tile>,
    /// The coarsest level that is not locked; `None` when all are.
    first_unlocked: Option<u8>,
}

impl TileWait {
    /// Buffers for frames that want up to `wanted` tiles, whose colours the pool holds in this
    /// format.
    #[must_use]
    pub fn new(world: &World, texels: TexelFormat, wanted: usize) -> Self {
        let (locked, first_unlocked) = top_levels(world);
        Self { world: *world, texels, pending: Vec::with_capacity(wanted.max(locked.len())), locked, first_unlocked }
    }

    /// Waits until the top levels of both pyramids are resident. The prefetcher never evicts them,
    /// so that from then on there is always a picture.
    ///
    /// # Errors
    /// [`AwaitError`].
    pub fn settle_top_levels(&mut self, loader: &mut impl TileLoader, control: &Control) -> Result<(), AwaitError> {
        self.pending.clear();
        self.pending.extend_from_slice(&self.locked);
        self.settle(loader, FrameNumber::default(), Sequence::NONE, control)?;
        Ok(())
    }

    /// Waits up to `patience` until the top levels are resident, also when some of them could not
    /// be read at first: a server may be down for longer than a single read may take. Tiles that
    /// the server refuses are not waited for, except for the root, without which there is no
    /// picture. Returns whether the root is resident.
    ///
    /// # Errors
    /// [`AwaitError`].
    pub fn insist_on_top_levels(
        &mut self,
        loader: &mut impl TileLoader,
        patience: Duration,
        control: &Control,
    ) -> Result<bool, AwaitError> {
        let world = self.world;
        let end = Instant::now() + patience;
        loop {
            loader.drain()?;
            // This wait is ended by its own clock.
            control.progress();
            let (mut is_root_there, mut is_over) = (true, true);
            // All of them are wanted, whatever the state of the first.
            for tile in &self.locked {
                let (is_there, is_awaited) = match loader.want(*tile, FrameNumber::default(), Sequence::NONE, control) {
                    TileState::Resident => (true, false),
                    TileState::Unavailable { may_come } => (false, may_come || world.is_root(tile.node)),
                    TileState::Loading | TileState::NoRoom => (false, true),
                };
                is_root_there &= is_there || !world.is_root(tile.node);
                is_over &= !is_awaited;
            }
            loader.ask(FrameNumber::default(), Sequence::NONE);
            if is_over || Instant::now() >= end {
                return Ok(is_root_there);
            }
            loader.wait(control)?;
        }
    }

    /// The first of the root's tiles that is missing: without them there is no picture. To be
    /// called when the top levels are settled; does not block.
    pub fn missing_of_root(&mut self, loader: &mut impl TileLoader, control: &Control) -> Option<Tile> {
        let world = self.world;
        let mut of_root = self.locked.iter().filter(|tile| world.is_root(tile.node));
        of_root
            .find(|tile| loader.want(**tile, FrameNumber::default(), Sequence::NONE, control) != TileState::Resident)
            .copied()
    }

    /// Waits until each wanted tile is resident, and returns how many are unavailable instead.
    ///
    /// # Errors
    /// [`AwaitError`]; at once when the pools cannot hold what is wanted, however long one waits.
    pub fn settle_frame(
        &mut self,
        wanted: &[Tile],
        loader: &mut impl TileLoader,
        frame: FrameNumber,
        sequence: Sequence,
        control: &Control,
    ) -> Result<u32, AwaitError> {
        self.check_room(wanted, loader, frame)?;
        self.pending.clear();
        self.pending.extend_from_slice(wanted);
        self.settle(loader, frame, sequence, control)
    }

    fn settle(
        &mut self,
        loader: &mut impl TileLoader,
        frame: FrameNumber,
        sequence: Sequence,
        control: &Control,
    ) -> Result<u32, AwaitError> {
        let mut unavailable = 0;
        loop {
            let completed = control.completed_sequence();
            let (mut without_room, before) = (None, self.pending.len());
            loader.drain()?;
            self.pending.retain(|tile| match loader.want(*tile, frame, sequence, control) {
                TileState::Resident => false,
                TileState::Unavailable { .. } => {
                    unavailable += 1;
                    false
                }
                TileState::Loading => true,
                TileState::NoRoom => {
                    without_room = Some(tile.layer);
                    true
                }
            });
            loader.ask(frame, sequence);
            if self.pending.is_empty() {
                return Ok(unavailable);
            }
            if self.pending.len() < before {
                control.progress();
            }
            match without_room {
                Some(layer) if loader.in_flight() == 0 => {
                    if completed.next() >= sequence {
                        // No earlier frame holds a slot, so nothing would end the wait.
                        let capacity = u64::from(loader.capacity(layer));
                        return Err(self.too_small(layer, capacity + 1, capacity, frame));
                    }
                    // Earlier frames hold the slots; all of these frames are in the ring, so that
                    // one of them will be completed.
                    control.wait_completed(completed.next())?;
                }
                _ => loader.wait(control)?,
            }
        }
    }

    fn check_room(&self, wanted: &[Tile], loader: &impl TileLoader, frame: FrameNumber) -> Result<(), AwaitError> {
        let needed = |layer: Layer| {
            let locked = self.locked.iter().filter(|t| t.layer == layer).count();
            let is_unlocked = |node: NodeId| self.first_unlocked.is_some_and(|first| node.q() <= first);
            let others = wanted.iter().filter(|t| t.layer == layer && is_unlocked(t.node));
            (locked + others.count()) as u64
        };
        for layer in [Layer::Color, Layer::Elevation] {
            let (needed, capacity) = (needed(layer), u64::from(loader.capacity(layer)));
            if needed > capacity {
                return Err(self.too_small(layer, needed, capacity, frame));
            }
        }
        Ok(())
    }

    /// The error for pools that are too small, with the memory that would suffice, if any.
    fn too_small(&self, layer: Layer, needed: u64, capacity: u64, frame: FrameNumber) -> AwaitError {
        let slots = |memory: u64| {
            let layout = Layout::for_run(&self.world, memory, self.texels).ok()?;
            Some(u64::from(if layer == Layer::Color { layout.color_slots() } else { layout.elevation_slots() }))
        };
        // Pools grow with memory in steps of at most a MiB: find the smallest that suffices by
        // bisection.
        let least = |wanted: u64| {
            let (mut low, mut high) = (0u64, 1 << 20);
            while low < high {
                let middle = u64::midpoint(low, high);
                if slots(middle << 20).is_some_and(|s| s >= wanted) { high = middle } else { low = middle + 1 }
            }
            (low < 1 << 20).then_some(low)
        };
        match (least(needed), least(capacity)) {
            (Some(needed_mib), Some(given_mib)) => AwaitError::TooLittleMemory { frame, needed_mib, given_mib },
            _ => AwaitError::TooManyTiles { frame, layer, needed, capacity },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use terravision_common::ids::SlotKey;
    use terravision_common::shm::memory;
    use terravision_testkit::worlds;

    /// Answers from a script: `states(tile, round)`; each wait ends a round.
    struct Scripted<F> {
        round: usize,
        states: F,
    }

    impl<F> crate::truncation::Tiles for Scripted<F> {
        fn color(&self, _node: NodeId) -> Option<SlotKey> {
            None
        }

        fn elevation(&self, _node: NodeId) -> Option<&[f32]> {
            None
        }

        fn elevation_key(&self, _node: NodeId) -> Option<SlotKey> {
            None
        }
    }

    impl<F: Fn(Tile, usize) -> TileState> TileLoader for Scripted<F> {
        fn want(&mut self, tile: Tile, _frame: FrameNumber, _sequence: Sequence, _control: &Control) -> TileState {
            (self.states)(tile, self.round)
        }

        fn ask(&mut self, _frame: FrameNumber, _sequence: Sequence) {}

        fn wait(&mut self, _control: &Control) -> Result<(), WaitError> {
            self.round += 1;
            Ok(())
        }

        fn drain(&mut self) -> Result<(), WaitError> {
            Ok(())
        }

        fn in_flight(&self) -> usize {
            0
        }

        fn capacity(&self, _layer: Layer) -> u32 {
            100
        }

        fn close(&mut self) {}
    }

    /// The number of rounds waited, and whether the root is resident afterwards.
    fn rounds(patience: Duration, states: impl Fn(Tile, NodeId, usize) -> TileState) -> (usize, bool) {
        let world = worlds::world([64; 2], 1.0, [4, 16]);
        let control = memory::control().expect("a control block");
        let mut wait = TileWait::new(&world, TexelFormat::Rgba8, 64);
        let mut loader = Scripted { round: 0, states: |tile, round| states(tile, world.root(), round) };
        let is_there = wait.insist_on_top_levels(&mut loader, patience, &control).expect("waits");
        (loader.round, is_there)
    }

    const FOREVER: Duration = Duration::from_secs(1 << 30);
    const FAILING: TileState = TileState::Unavailable { may_come: true };
    const REFUSED: TileState = TileState::Unavailable { may_come: false };

    #[test]
    fn a_start_waits_for_all_that_may_come_and_for_the_root_whatever_is_said_of_it() {
        let resident_from = |at: usize, round: usize, before: TileState| {
            if round >= at { TileState::Resident } else { before }
        };
        let not_root = |tile: Tile, root: NodeId| tile.node != root;
        // A tile other than the root that failed is waited for.
        assert_eq!(
            rounds(FOREVER, |tile, root, round| resident_from(
                if not_root(tile, root) { 7 } else { 0 },
                round,
                FAILING
            )),
            (7, true)
        );
        // A refused tile is not waited for, unless it is the root's.
        assert_eq!(
            rounds(FOREVER, |t, root, _| if not_root(t, root) { REFUSED } else { TileState::Resident }),
            (0, true)
        );
        assert_eq!(rounds(FOREVER, |_, _, round| resident_from(3, round, REFUSED)), (3, true));
        // Patience ends.
        assert_eq!(
            rounds(Duration::ZERO, |t, root, _| if not_root(t, root) { FAILING } else { TileState::Resident }),
            (0, true)
        );
        assert_eq!(rounds(Duration::ZERO, |_, _, _| FAILING), (0, false));
    }
}
