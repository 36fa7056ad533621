//! Worlds without a database, for tests of what needs no tile.

use terravision_common::world::{World, WorldFields};

/// A world of a number of lattice units, of a length in metres, whose tiles have numbers of
/// intervals of elevation and texels of colour: at the origin, with as many levels as it takes for
/// one root, and both elevation and colour down to the finest.
///
/// ```
/// use terravision_common::world::{World, WorldFields};
/// use terravision_testkit::worlds::fields;
///
/// // The same with coarser color.
/// World::new(WorldFields { finest_color_level: 1, ..fields([2000, 1500], 10.0, [16, 128]) }).unwrap();
/// ```
#[must_use]
pub fn fields(extent: [u32; 2], lattice_unit_m: f64, [elevation_tile, color_tile]: [u32; 2]) -> WorldFields {
    let nodes = extent[0].max(extent[1]).div_ceil(elevation_tile).next_power_of_two();
    WorldFields {
        origin: [0.0; 2],
        lattice_unit_m,
        extent,
        elevation_tile,
        color_tile,
        levels: nodes.ilog2() as u8 + 1,
        finest_elevation_level: 0,
        finest_color_level: 0,
        body: None,
    }
}

/// The world of these [`fields`].
///
/// # Panics
/// When there is no such world.
#[must_use]
pub fn world(extent: [u32; 2], lattice_unit_m: f64, tiles: [u32; 2]) -> World {
    World::new(fields(extent, lattice_unit_m, tiles)).expect("these are the fields of a world")
}
