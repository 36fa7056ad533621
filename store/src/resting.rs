//! Tiles that could not be had are left alone for a while.

use crate::error::{Cause, FetchError};
use std::collections::{HashMap, HashSet};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use terravision_common::database::{Layer, Tile};
use terravision_common::node::NodeId;

/// After its first failure a tile rests so long, twice as long after the next...
const FIRST_REST: Duration = Duration::from_secs(2);
/// ... up to this.
const LONGEST_REST: Duration = Duration::from_secs(60);
/// A failure that will not pass by itself is not asked about for this long.
const LONG_REST: Duration = Duration::from_secs(300);
/// More tiles than these are not remembered: those whose rest is over are forgotten first.
const MOST_TILES: usize = 1 << 16;

/// Failures that say something about the server, or the way to it, rather than about a tile.
fn is_of_the_way(error: &FetchError) -> bool {
    matches!(error.cause(), Some(Cause::Connect | Cause::Name | Cause::Timeout | Cause::Interrupted))
}

#[derive(Debug)]
struct Rest {
    until: Instant,
    failures: u32,
    error: FetchError,
}

/// The tiles that rest.
#[derive(Debug, Default)]
pub(crate) struct Resting {
    tiles: Mutex<HashMap<(Layer, NodeId), Rest>>,
    /// The coarsest levels, which stand in for all that is missing: whatever the failure, they do not rest for long.
    vital: HashSet<Tile>,
    /// Without it there is no picture: it never rests for longer than the first time.
    root: Option<NodeId>,
}

impl Resting {
    /// Nothing rests; the tiles of `vital` and of the root never do for long.
    pub(crate) fn new(root: NodeId, vital: impl IntoIterator<Item = Tile>) -> Self {
        Self { vital: vital.into_iter().collect(), root: Some(root), ..Self::default() }
    }

    /// Whether a tile is of the coarsest levels.
    pub(crate) fn is_vital(&self, layer: Layer, node: NodeId) -> bool {
        self.vital.contains(&Tile { layer, node })
    }

    /// Why a tile is not to be asked for now.
    pub(crate) fn find(&self, layer: Layer, node: NodeId) -> Option<FetchError> {
        self.find_at(layer, node, Instant::now())
    }

    fn find_at(&self, layer: Layer, node: NodeId, now: Instant) -> Option<FetchError> {
        let tiles = self.tiles.lock().unwrap_or_else(PoisonError::into_inner);
        tiles.get(&(layer, node)).filter(|rest| rest.until > now).map(|rest| rest.error.clone())
    }

    /// Notes how a read ended.
    pub(crate) fn note(&self, layer: Layer, node: NodeId, error: Option<&FetchError>) {
        self.note_at(layer, node, error, Instant::now());
    }

    fn note_at(&self, layer: Layer, node: NodeId, error: Option<&FetchError>, now: Instant) {
        let mut tiles = self.tiles.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(error) = error else {
            tiles.remove(&(layer, node));
            // The server answers: what failed on the way there need not rest for as long as the silence has taught.
            for rest in tiles.values_mut().filter(|rest| is_of_the_way(&rest.error)) {
                rest.until = rest.until.min(now + FIRST_REST);
            }
            return;
        };
        // What a directory does not have, or a cache, is found out without asking anybody.
        if matches!(error.cause(), None | Some(Cause::Offline | Cause::Closed)) {
            return;
        }
        if tiles.len() >= MOST_TILES {
            tiles.retain(|_, rest| rest.until > now);
            if tiles.len() >= MOST_TILES {
                tiles.clear();
            }
        }
        let failures = tiles.get(&(layer, node)).map_or(0, |rest| rest.failures);
        let rest = match error.is_passing() || self.is_vital(layer, node) {
            _ if self.root == Some(node) => FIRST_REST,
            true => FIRST_REST.saturating_mul(1 << failures.min(10)).min(LONGEST_REST),
            false => LONG_REST,
        };
        tiles.insert((layer, node), Rest { until: now + rest, failures: failures + 1, error: error.clone() });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tile_rests_longer_after_each_failure_and_is_forgotten_when_it_comes() {
        let resting = Resting::default();
        let node = NodeId::new(1, 2, 3).expect("a node");
        let error = FetchError::failed(Cause::Server, "500", "x");
        let mut now = Instant::now();
        let mut rests = Vec::new();
        for _ in 0..8 {
            resting.note_at(Layer::Color, node, Some(&error), now);
            assert!(resting.find_at(Layer::Elevation, node, now).is_none());
            let start = now;
            while resting.find_at(Layer::Color, node, now).is_some() {
                now += Duration::from_secs(1);
            }
            rests.push((now - start).as_secs());
        }
        assert_eq!(rests, [2, 4, 8, 16, 32, 60, 60, 60]);
        resting.note_at(Layer::Color, node, None, now);
        resting.note_at(Layer::Color, node, Some(&error), now);
        assert!(resting.find_at(Layer::Color, node, now + FIRST_REST).is_none(), "it began anew");
    }

    #[test]
    fn an_answer_shortens_the_rest_of_what_failed_on_the_way() {
        let resting = Resting::default();
        let node = |m| NodeId::new(m, 2, 3).expect("a node");
        let now = Instant::now();
        for (m, cause) in [(1, Cause::Connect), (2, Cause::Server)] {
            for _ in 0..6 {
                resting.note_at(Layer::Color, node(m), Some(&FetchError::failed(cause, "", "")), now);
            }
        }
        resting.note_at(Layer::Color, node(3), None, now);
        let rests = |m, secs| resting.find_at(Layer::Color, node(m), now + Duration::from_secs(secs)).is_some();
        assert_eq!([rests(1, 1), rests(1, 2), rests(2, 30)], [true, false, true]);
    }

    #[test]
    fn what_does_not_pass_rests_long_and_what_nobody_is_asked_for_not_at_all() {
        let resting = Resting::default();
        let node = NodeId::new(1, 2, 3).expect("a node");
        let now = Instant::now();
        for cause in [Cause::Offline, Cause::Closed] {
            resting.note_at(Layer::Color, node, Some(&FetchError::failed(cause, "", "")), now);
        }
        resting.note_at(Layer::Color, node, Some(&FetchError::Absent), now);
        assert!(resting.find_at(Layer::Color, node, now).is_none());
        resting.note_at(Layer::Color, node, Some(&FetchError::failed(Cause::NotFound, "", "")), now);
        assert!(resting.find_at(Layer::Color, node, now + LONG_REST / 2).is_some());
    }

    #[test]
    fn what_stands_in_for_all_that_is_missing_does_not_rest_for_long_and_the_root_least() {
        let [root, below] = [5, 4].map(|q| NodeId::new(0, 0, q).expect("a node"));
        let tile = |node| Tile { layer: Layer::Color, node };
        let resting = Resting::new(root, [root, below].map(tile));
        let now = Instant::now();
        for cause in [Cause::NotFound, Cause::Server, Cause::WebPage, Cause::Denied] {
            for (layer, node) in [(Layer::Color, root), (Layer::Color, below), (Layer::Elevation, below)] {
                resting.note_at(layer, node, Some(&FetchError::failed(cause, "", "")), now);
            }
        }
        let rests = |layer, node, rest| resting.find_at(layer, node, now + rest).is_some();
        assert!(!rests(Layer::Color, root, FIRST_REST));
        assert!(rests(Layer::Color, below, FIRST_REST * 7) && !rests(Layer::Color, below, FIRST_REST * 8));
        assert!(rests(Layer::Elevation, below, LONG_REST / 2));
    }
}
