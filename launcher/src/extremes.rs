//! Where the highest and the lowest ground of a database is.

use std::cmp::Ordering;
use terravision_common::database::{TileScratch, TileSource};
use terravision_common::node::NodeId;
use terravision_store::Store;

/// Tiles that are read for one of the two. The ranges of nodes tell which ones can have it: a few around a summit.
const MOST_TILES: usize = 256;
/// Heights in tiles are this exact, metres.
const STEP_M: f64 = 1.0 / 128.0;

/// A place in the CRS of the database.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extreme {
    /// Height, metres.
    pub height_m: f64,
    /// Easting and northing.
    pub place: [f64; 2],
}

/// The highest and the lowest post of the finest level, where they can be found by reading few tiles. Blocks on storage.
#[must_use]
pub fn extremes(database: &Store) -> [Option<Extreme>; 2] {
    let [low, high] = database.manifest().elevation.range_m;
    [find(database, high, 1.0), find(database, low, -1.0)]
}

/// The post of that height, which is the greatest (`sign` 1) or the least (-1).
fn find(database: &Store, height_m: f64, sign: f64) -> Option<Extreme> {
    let world = database.world();
    let q = world.finest_elevation_level();
    let [columns, rows] = world.nodes_at(q);
    let side = if sign > 0.0 { 1 } else { 0 };
    let bound = |node: NodeId| database.ranges().range(node).map(|range| f64::from(range[side]));
    let nodes = (0..rows).flat_map(|n| (0..columns).filter_map(move |m| NodeId::new(m, n, q)));
    let mut candidates: Vec<(f64, NodeId)> = nodes
        .filter_map(|node| bound(node).map(|bound| (bound, node)))
        .filter(|(bound, _)| sign * (bound - height_m) >= -STEP_M)
        .take(1 << 20)
        .collect();
    // The range of a node bounds coarser levels too: the one that is nearest to the height most likely has it.
    candidates.sort_by(|a, b| (a.0 - height_m).abs().partial_cmp(&(b.0 - height_m).abs()).unwrap_or(Ordering::Equal));
    let posts = world.elevation_posts() as usize;
    let (mut heights, mut scratch) = (vec![0.0f32; posts * posts], TileScratch::default());
    for (_, node) in candidates.into_iter().take(MOST_TILES) {
        if database.read_elevation(node, &mut heights, &mut scratch).is_err() {
            continue;
        }
        // The border beyond the extent repeats what is within.
        let Some(at) = heights.iter().position(|h| (f64::from(*h) - height_m).abs() <= STEP_M) else { continue };
        let spacing = world.elevation_spacing_m(q);
        let (side_m, [x, y], [width, height]) = (world.node_side_m(q), world.fields().origin, world.extent_m());
        let along =
            |index: u32, post: usize, extent: f64| (f64::from(index) * side_m + post as f64 * spacing).min(extent);
        let place = [x + along(node.m(), at % posts, width), y + along(node.n(), at / posts, height)];
        return Some(Extreme { height_m: f64::from(heights[at]), place });
    }
    None
}
