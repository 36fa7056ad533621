//! The negative cache: tiles that could not be read, and until when they are not requested again.

use super::FailedTiles;
use crate::error::{Cause, FetchError};
use crate::lock;
use std::collections::{HashMap, HashSet};
use std::sync::Mutex;
use std::time::{Duration, Instant};
use terravision_common::database::Tile;

/// After its first failure a tile rests for this long, then twice as long after each further
/// failure ...
const FIRST_REST: Duration = Duration::from_secs(2);
/// ... up to this.
const LONGEST_REST: Duration = Duration::from_secs(60);
/// The rest of a tile that the database does not contain: it costs little to find that out again.
const ABSENT_REST: Duration = Duration::from_secs(60);
/// The rest after a failure that will not pass by itself.
const LONG_REST: Duration = Duration::from_secs(300);
/// Maximum number of entries: tiles whose rest is over are removed first.
const MOST_TILES: usize = 1 << 16;

/// Whether a failure says something about the server or the network, rather than about a tile.
fn is_of_the_way(error: &FetchError) -> bool {
    matches!(error.cause(), Some(Cause::Connect | Cause::Name | Cause::Timeout | Cause::Interrupted))
}

#[derive(Debug)]
struct Entry {
    /// When it may be requested again; `None`: never.
    until: Option<Instant>,
    failures: u32,
    error: FetchError,
    /// It failed while the breaker of its file was open, perhaps without a request.
    is_of_silence: bool,
}

impl Entry {
    fn is_over(&self, now: Instant) -> bool {
        self.until.is_some_and(|until| until <= now)
    }
}

/// The tiles that are not requested now. Used by any thread.
#[derive(Debug)]
pub struct NegativeCache {
    tiles: Mutex<HashMap<Tile, Entry>>,
    failed_tiles: FailedTiles,
    /// The coarsest levels, which are drawn in place of missing tiles: they never rest for long,
    /// whatever the failure.
    vital: HashSet<Tile>,
    /// There is no picture without it: its rest never gets longer than the first one.
    /// The level of the coarsest tiles.
    root: u8,
}

impl NegativeCache {
    /// An empty cache; the tiles of `vital` and of the root never rest for long.
    #[must_use]
    pub fn new(failed_tiles: FailedTiles, root: u8, vital: impl IntoIterator<Item = Tile>) -> Self {
        Self { tiles: Mutex::default(), failed_tiles, vital: vital.into_iter().collect(), root }
    }

    /// Whether a tile belongs to the coarsest levels.
    #[must_use]
    pub fn is_vital(&self, tile: Tile) -> bool {
        self.vital.contains(&tile)
    }

    /// Why a tile must not be requested at this moment; `None` when it may be.
    #[must_use]
    pub fn find(&self, tile: Tile, now: Instant) -> Option<FetchError> {
        lock(&self.tiles).get(&tile).filter(|entry| !entry.is_over(now)).map(|entry| entry.error.clone())
    }

    /// Records the end of a read: an error, or the tile.
    pub fn note(&self, tile: Tile, error: Option<&FetchError>, now: Instant) {
        let mut tiles = lock(&self.tiles);
        let Some(error) = error else {
            tiles.remove(&tile);
            // The server answers: tiles that failed because of the network need not rest as long as
            // during the outage. Tiles that failed because their whole file was silent need not
            // rest at all.
            for (other, entry) in tiles.iter_mut() {
                let most = match entry.is_of_silence && other.layer == tile.layer {
                    true => now,
                    false if is_of_the_way(&entry.error) => now + FIRST_REST,
                    false => continue,
                };
                entry.until = entry.until.map(|until| until.min(most));
            }
            return;
        };
        // The store is being closed; that says nothing about a tile.
        if error.cause() == Some(Cause::Closed) {
            return;
        }
        if tiles.len() >= MOST_TILES {
            tiles.retain(|_, entry| !entry.is_over(now));
            if tiles.len() >= MOST_TILES {
                tiles.clear();
            }
        }
        let failures = tiles.get(&tile).map_or(0, |entry| entry.failures);
        let until = self.rest(tile, error, failures).map(|rest| now + rest);
        let failures = failures.saturating_add(1);
        tiles.insert(tile, Entry { until, failures, error: error.clone(), is_of_silence: false });
    }

    /// Records a read that failed while the breaker of its file was open: the next tile of the same
    /// layer that arrives ends its rest.
    pub fn note_silence(&self, tile: Tile, error: &FetchError, now: Instant) {
        self.note(tile, Some(error), now);
        if let Some(entry) = lock(&self.tiles).get_mut(&tile) {
            entry.is_of_silence = true;
        }
    }

    /// The rest of a tile with this many earlier failures; `None`: for ever.
    fn rest(&self, tile: Tile, error: &FetchError, failures: u32) -> Option<Duration> {
        if self.failed_tiles == FailedTiles::Final {
            return None;
        }
        match error.cause() {
            None => Some(ABSENT_REST),
            // No server is asked, so nothing changes.
            Some(Cause::Offline) => None,
            Some(_) if self.root == tile.node.q() => Some(FIRST_REST),
            Some(cause) if cause.is_passing() || cause == Cause::Disk || self.is_vital(tile) => {
                Some(FIRST_REST.saturating_mul(1 << failures.min(10)).min(LONGEST_REST))
            }
            Some(_) => Some(LONG_REST),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use terravision_common::database::Layer;
    use terravision_common::node::NodeId;

    fn color(m: u32) -> Tile {
        Tile { layer: Layer::Color, node: NodeId::new(m, 2, 3).expect("a node") }
    }

    fn root() -> NodeId {
        NodeId::new(0, 0, 5).expect("a node")
    }

    fn cache() -> NegativeCache {
        NegativeCache::new(FailedTiles::Rest, root().q(), [])
    }

    #[test]
    fn a_tile_rests_longer_after_each_failure_and_is_forgotten_when_it_comes() {
        let (cache, tile) = (cache(), color(1));
        let error = FetchError::failed(Cause::Server, "500", "x");
        let mut now = Instant::now();
        let mut rests = Vec::new();
        for _ in 0..8 {
            cache.note(tile, Some(&error), now);
            assert!(cache.find(Tile { layer: Layer::Elevation, ..tile }, now).is_none());
            let start = now;
            while cache.find(tile, now).is_some() {
                now += Duration::from_secs(1);
            }
            rests.push((now - start).as_secs());
        }
        assert_eq!(rests, [2, 4, 8, 16, 32, 60, 60, 60]);
        cache.note(tile, None, now);
        cache.note(tile, Some(&error), now);
        assert!(cache.find(tile, now + FIRST_REST).is_none(), "it began anew");
    }

    #[test]
    fn an_answer_shortens_the_rest_of_what_failed_on_the_way() {
        let cache = cache();
        let now = Instant::now();
        for (m, cause) in [(1, Cause::Connect), (2, Cause::Server)] {
            for _ in 0..6 {
                cache.note(color(m), Some(&FetchError::failed(cause, "", "")), now);
            }
        }
        cache.note(color(3), None, now);
        let rests = |m, secs| cache.find(color(m), now + Duration::from_secs(secs)).is_some();
        assert_eq!([rests(1, 1), rests(1, 2), rests(2, 30)], [true, false, true]);
    }

    #[test]
    fn an_answer_ends_the_rest_of_what_failed_because_its_file_was_silent() {
        let cache = cache();
        let now = Instant::now();
        let error = FetchError::failed(Cause::Server, "500", "x");
        let of_elevation = Tile { layer: Layer::Elevation, ..color(1) };
        for _ in 0..3 {
            cache.note_silence(color(1), &error, now);
            cache.note_silence(of_elevation, &error, now);
        }
        assert!(cache.find(color(1), now).is_some());
        cache.note(color(3), None, now);
        assert!(cache.find(color(1), now).is_none() && cache.find(of_elevation, now).is_some());
        let exact = NegativeCache::new(FailedTiles::Final, root().q(), []);
        exact.note_silence(color(1), &error, now);
        exact.note(color(3), None, now);
        assert!(exact.find(color(1), now).is_some(), "a picture must not depend on time");
    }

    #[test]
    fn what_does_not_pass_rests_long_what_nobody_is_asked_for_stays_away_and_an_end_says_nothing() {
        let (cache, tile, now) = (cache(), color(1), Instant::now());
        cache.note(tile, Some(&FetchError::failed(Cause::Closed, "", "")), now);
        assert!(cache.find(tile, now).is_none());
        cache.note(tile, Some(&FetchError::Absent), now);
        assert!(cache.find(tile, now + ABSENT_REST / 2).is_some() && cache.find(tile, now + ABSENT_REST).is_none());
        cache.note(tile, Some(&FetchError::failed(Cause::NotFound, "", "")), now);
        assert!(cache.find(tile, now + LONG_REST / 2).is_some() && cache.find(tile, now + LONG_REST).is_none());
        cache.note(tile, Some(&FetchError::failed(Cause::Offline, "", "")), now);
        assert!(cache.find(tile, now + 1000 * LONG_REST).is_some());
    }

    #[test]
    fn what_stands_in_for_all_that_is_missing_does_not_rest_for_long_and_the_root_least() {
        let below = NodeId::new(0, 0, 4).expect("a node");
        let tile = |node| Tile { layer: Layer::Color, node };
        let cache = NegativeCache::new(FailedTiles::Rest, root().q(), [root(), below].map(tile));
        let now = Instant::now();
        let of_elevation = Tile { layer: Layer::Elevation, node: below };
        for cause in [Cause::NotFound, Cause::Server, Cause::WebPage, Cause::Denied] {
            for tile in [tile(root()), tile(below), of_elevation] {
                cache.note(tile, Some(&FetchError::failed(cause, "", "")), now);
            }
        }
        let rests = |tile, rest| cache.find(tile, now + rest).is_some();
        assert!(!rests(tile(root()), FIRST_REST));
        assert!(rests(tile(below), FIRST_REST * 7) && !rests(tile(below), FIRST_REST * 8));
        assert!(rests(of_elevation, LONG_REST / 2));
    }

    #[test]
    fn where_a_picture_must_not_depend_on_time_no_tile_is_asked_for_again() {
        let cache = NegativeCache::new(FailedTiles::Final, root().q(), []);
        let now = Instant::now();
        let of_root = Tile { layer: Layer::Color, node: root() };
        for tile in [of_root, color(1)] {
            cache.note(tile, Some(&FetchError::failed(Cause::Timeout, "", "")), now);
        }
        // Another tile arrives: the server answers again.
        cache.note(color(2), None, now);
        assert!([of_root, color(1)].into_iter().all(|tile| cache.find(tile, now + 1000 * LONG_REST).is_some()));
    }
}
