//! Colour tiles of a body.

use super::archive::{Archive, ArchivePlan};
use super::grid::Grid;
use super::image::{Image, Strip};
use crate::IngestError;
use crate::archive::{Tile, encode_color_tile};
use crate::store::Rgb;
use crate::work::Work;
use pmtiles::TileType;
use std::io;
use terravision_common::database::{ArchiveRecord, tile_coord};
use terravision_common::node::NodeId;
use terravision_common::world::COLOR_BORDER;

/// Texels that a thread holds at a time: nodes of a row are made in groups.
const MOST_TEXELS: usize = 4 << 20;

/// Writes all colour tiles.
pub(super) fn write(
    grid: &Grid,
    image: &Image,
    quality: u8,
    plan: &ArchivePlan<'_>,
    work: &Work,
) -> Result<ArchiveRecord, IngestError> {
    let fail = |source| IngestError::Output { source, path: plan.path.to_owned() };
    let finest = grid.world.finest_color_level();
    let mut archive = Archive::create(plan, TileType::Jpeg, finest)?;
    let stored = grid.world.color_stored() as usize;
    for q in (finest..grid.world.levels()).rev() {
        let at_once = (MOST_TEXELS / (stored * stored)).max(1) as u32;
        let group = |first: NodeId| {
            let count = grid.world.columns_of_row(q, first.n());
            (0..count).step_by(at_once as usize).map(move |m| (first.n(), m..(m + at_once).min(count)))
        };
        let groups: Vec<_> = grid.node_rows(q).flat_map(group).collect();
        work.in_order(
            "colour tiles",
            groups.len(),
            || Ok(()),
            |(), index| {
                let (n, columns) = groups[index].clone();
                tiles(grid, image, quality, q, n, columns).map_err(fail)
            },
            |tiles| tiles.into_iter().try_for_each(|tile| archive.add(tile)),
        )?;
    }
    archive.finish()
}

/// Tiles of some nodes of a row.
fn tiles(
    grid: &Grid,
    image: &Image,
    quality: u8,
    q: u8,
    n: u32,
    columns: std::ops::Range<u32>,
) -> io::Result<Vec<Tile>> {
    let (texels, stored) = (grid.world.color_tile() as usize, grid.world.color_stored() as usize);
    let border = COLOR_BORDER as usize;
    let count = columns.len() * texels + 2 * border;
    let none = || io::Error::other("a node has no place in archives");
    let first = NodeId::new(columns.start, n, q).ok_or_else(none)?;
    // By rows from the north, as pictures have them.
    let mut lines: Vec<Vec<Rgb>> = Vec::with_capacity(stored);
    for k in (0..stored).rev() {
        let strip = strip(grid, first, k as i64 - border as i64);
        let line = image.texels(grid, &strip, count)?;
        lines.push(line.iter().map(|texel| texel.map(|v| v.round().clamp(0.0, 255.0) as u8)).collect());
    }
    columns
        .enumerate()
        .map(|(at, m)| {
            let node = NodeId::new(m, n, q).ok_or_else(none)?;
            let picture: Vec<Rgb> = lines.iter().flat_map(|line| &line[at * texels..][..stored]).copied().collect();
            let first = picture[0];
            let is_plain = picture.iter().all(|texel| *texel == first);
            let key = is_plain.then(|| u64::from_le_bytes([first[0], first[1], first[2], 0, 0, 0, 0, 0]));
            let coord = tile_coord(&grid.world, node).ok_or_else(none)?;
            Ok((coord, encode_color_tile(&picture, stored as u16, quality)?, key))
        })
        .collect()
}

/// Texel row `k` of a node, counted from the south edge of its nominal square, from the first texel of
/// its border on.
fn strip(grid: &Grid, node: NodeId, k: i64) -> Strip {
    let lattice = grid.lattice();
    let texels = f64::from(grid.world.color_tile());
    let [log_columns, log_rows] = lattice.log_steps(node);
    let [width, height] = [log_columns, log_rows].map(|log| (u64::from(lattice.cells()) << log) as f64);
    let south = grid.nominal_south(node);
    let (step, row_step) = (width / texels, height / texels);
    let last = f64::from(grid.rows());
    let mut rows = [south + k as f64 * row_step, south + (k + 1) as f64 * row_step];
    let mut first = f64::from(node.m()) * width - f64::from(COLOR_BORDER) * step;
    let middle = 0.5 * (rows[0] + rows[1]);
    // Beyond a pole, half a turn away.
    if middle < 0.0 || middle > last {
        let mirror = if middle < 0.0 { 0.0 } else { 2.0 * last };
        rows = [mirror - rows[1], mirror - rows[0]];
        first += 0.5 * f64::from(grid.columns());
    }
    rows = rows.map(|row| row.clamp(0.0, last));
    let least_width = row_step * grid.columns_per_row_at(0.5 * (rows[0] + rows[1]));
    Strip { rows, first, step, least_width }
}
