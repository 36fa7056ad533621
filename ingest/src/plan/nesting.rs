//! Whether the finest levels exist only where there are data.

use super::footprint::Footprint;
use terravision_common::world::World;

/// Below this share of the world, data that are finer than the rest get levels of their own.
const MOST_NESTED: f64 = 0.75;
/// Number of places along a side at which the coverage of sources is tested.
const PROBES: usize = 64;

/// The level for a source whose spacing is `ratio` times that of the finest level: at most 7 %
/// coarser than the source.
pub(super) fn own_level(world: &World, ratio: f64, finest: u8) -> u8 {
    let above = (ratio.log2() + 0.1).floor().max(0.0) as u8;
    finest.saturating_add(above).min(world.root().q())
}

/// Whether data of the finest levels cover so little of the world that these levels are only made
/// there.
pub(super) fn is_nested(world: &World, elevation: (&[Footprint], &[u8]), color: (&[Footprint], &[u8])) -> bool {
    let (origin, size) = (world.fields().origin, world.extent_m());
    let share = |prints: &[&Footprint]| {
        let place = |k: usize, axis: usize| origin[axis] + size[axis] * (k as f64 + 0.5) / PROBES as f64;
        let covers = |k: &usize| {
            let at = [place(k % PROBES, 0), place(k / PROBES, 1)];
            prints.iter().any(|p| (0..2).all(|a| p.low[a] - p.spacing <= at[a] && at[a] <= p.high[a] + p.spacing))
        };
        (0..PROBES * PROBES).filter(covers).count() as f64 / (PROBES * PROBES) as f64
    };
    let finest_of = |(prints, levels): (&[Footprint], &[u8]), finest: u8| -> Vec<Footprint> {
        prints.iter().zip(levels).filter(|(_, level)| **level == finest).map(|(print, _)| *print).collect()
    };
    let is_mixed = |levels: &[u8], finest: u8| levels.iter().any(|level| *level > finest);
    let [z, c] = [world.finest_elevation_level(), world.finest_color_level()];
    let (fine_z, fine_c) = (finest_of(elevation, z), finest_of(color, c));
    // If no elevation is as fine as the finest level, that level exists for much finer colour.
    let wants: Vec<&Footprint> = if fine_z.is_empty() { fine_c.iter().collect() } else { fine_z.iter().collect() };
    let is_elevation_nested = is_mixed(elevation.1, z) && share(&wants) < MOST_NESTED;
    let is_above_tint = i32::from(c) < i32::from(z) + world.elevation_over_color_levels();
    let is_color_mixed = is_mixed(color.1, c) || is_above_tint || is_mixed(elevation.1, z);
    let has_color = !color.0.is_empty();
    let is_color_nested = has_color && is_color_mixed && share(&fine_c.iter().collect::<Vec<_>>()) < MOST_NESTED;
    is_elevation_nested || is_color_nested
}
