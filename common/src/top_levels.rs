//! The top levels of both pyramids, which are never evicted from the pools, so that there is always
//! a picture.

use crate::database::{Layer, Tile};
use crate::node::NodeId;
use crate::world::World;

/// Nodes of the top levels: two levels below a root, 1 + 4 + 16.
const LOCKED_NODES: u64 = 21;

/// Tiles of the top levels, coarse to fine, and the level below them, if the world has more. Does
/// not include sparse levels.
#[must_use]
pub fn top_levels(world: &World) -> (Vec<Tile>, Option<u8>) {
    let mut tiles = Vec::new();
    let mut count = 0;
    for q in (0..world.levels()).rev() {
        let [columns, rows] = world.nodes_at(q);
        count += u64::from(columns) * u64::from(rows);
        // Without an index it is not known which nodes of a sparse level exist.
        if count > LOCKED_NODES || q < world.complete_level() {
            return (tiles, Some(q));
        }
        for node in (0..rows).flat_map(|n| (0..columns).filter_map(move |m| NodeId::new(m, n, q))) {
            if world.has_elevation(node) {
                tiles.push(Tile { layer: Layer::Elevation, node });
            }
            if world.has_color(node) {
                tiles.push(Tile { layer: Layer::Color, node });
            }
        }
    }
    (tiles, None)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::WorldFields;

    fn world(extent: [u32; 2], levels: u8, finest_color_level: u8) -> World {
        World::new(WorldFields {
            origin: [0.0; 2],
            lattice_unit_m: 1.0,
            extent,
            elevation_tile: 4,
            color_tile: 16,
            levels,
            finest_elevation_level: 0,
            finest_color_level,
            body: None,
        })
        .expect("valid")
    }

    #[test]
    fn three_full_levels_are_locked_and_more_where_nodes_are_few() {
        let (tiles, first) = top_levels(&world([256, 256], 7, 0));
        assert_eq!((tiles.len(), first), (42, Some(3)));
        // A strip: 1 + 1 + 2 + 4 + 8 nodes, then 16.
        let (tiles, first) = top_levels(&world([128, 1], 7, 0));
        assert_eq!((tiles.len(), first), (32, Some(1)));
        // All of a small world.
        let (tiles, first) = top_levels(&world([16, 16], 3, 0));
        assert_eq!((tiles.len(), first), (42, None));
        // Colour ends at level 5 of 7.
        let (tiles, first) = top_levels(&world([256, 256], 7, 5));
        assert_eq!((tiles.len(), first), (21 + 5, Some(3)));
        // Only the root and the level below it are everywhere.
        let (tiles, first) = top_levels(&world([256, 256], 7, 0).with_complete_level(5));
        assert_eq!((tiles.len(), first), (10, Some(4)));
    }
}
