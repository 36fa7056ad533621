//! A picture of a whole body, and its halves, quarters, … of resolution: pixels are means over their
//! areas.

use super::grid::Grid;
use crate::IngestError;
use crate::store::{Level, Rect, Rgb};
use crate::work::Work;
use std::f64::consts::PI;
use std::io;
use std::path::Path;

/// How rows of pixels lie.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum RowMap {
    /// All as high in degrees, from pole to pole.
    Degrees,
    /// Their middles are the lattice's rows.
    Lattice,
}

/// The picture.
#[derive(Debug)]
pub(super) struct Image {
    levels: Vec<Level<Rgb>>,
    /// Longitude of the western edge of the first column, radians.
    west: f64,
    row_map: RowMap,
}

/// Halving ends at this many rows.
const FEWEST_ROWS: u64 = 16;

/// A stretch of one axis of pixels: the first, and the weights of it and those after it, which sum to
/// 1.
fn weights(from: f64, to: f64, count: u64) -> (u64, Vec<f32>) {
    let (from, to) = (from.max(0.0), to.min(count as f64));
    let first = (from.floor() as u64).min(count - 1);
    let last = (to.ceil() as u64).clamp(first + 1, count);
    let share = |k: u64| ((to.min((k + 1) as f64) - from.max(k as f64)) / (to - from).max(1e-12)).max(0.0) as f32;
    let mut weights: Vec<f32> = (first..last).map(share).collect();
    if weights.iter().sum::<f32>() <= 0.5 {
        weights = vec![1.0];
    }
    (first, weights)
}

impl Image {
    /// Of the finest level, row 0 in the south.
    pub(super) fn of(
        finest: Level<Rgb>,
        west: f64,
        row_map: RowMap,
        folder: &Path,
        work: &Work,
    ) -> Result<Self, IngestError> {
        let fail = |source| IngestError::Output { source, path: folder.to_owned() };
        let mut levels = vec![finest];
        while levels[levels.len() - 1].size()[1] > FEWEST_ROWS {
            let finer = &levels[levels.len() - 1];
            let size = finer.size().map(|n| n.div_ceil(2));
            let level = Level::create(folder, size).map_err(fail)?;
            work.each(
                "colour levels",
                size[1] as usize,
                || Ok(()),
                |(), row| {
                    let pixels = half(finer, size, row as u64).map_err(fail)?;
                    level.write(Rect::new([0, row as i64], [pixels.len(), 1]), &pixels).map_err(fail)
                },
            )?;
            levels.push(level);
        }
        Ok(Self { levels, west, row_map })
    }

    /// Pixels of the finest level, columns and rows.
    pub(super) fn size(&self) -> [u64; 2] {
        self.levels[0].size()
    }

    /// Where a lattice row, or a place between two, lies on the finest level, in rows of pixels.
    fn place_of(&self, grid: &Grid, row: f64) -> f64 {
        match self.row_map {
            RowMap::Lattice => row + 0.5,
            RowMap::Degrees => (grid.latitude_at(row) + 0.5 * PI) / PI * self.size()[1] as f64,
        }
    }

    /// Texels along a parallel, from the west.
    pub(super) fn texels(&self, grid: &Grid, strip: &Strip, count: usize) -> io::Result<Vec<[f32; 3]>> {
        let [south, north] = strip.rows.map(|row| self.place_of(grid, row));
        // As coarse as a texel is high, at most.
        let coarse = (north - south).max(1.0).log2().floor() as usize;
        let at = coarse.min(self.levels.len() - 1);
        let (level, finest) = (&self.levels[at], self.size()[1] as f64);
        let [columns, rows] = level.size();
        let scale = rows as f64 / finest;
        let (first, weights) = weights(south * scale, north * scale, rows);
        let pixels = level.read(Rect::new([0, first as i64], [columns as usize, weights.len()]))?;
        let line = mixed(&pixels, columns as usize, &weights);
        // Sums from the west on: means over any width are differences.
        let mut sums = Vec::with_capacity(line.len() + 1);
        let mut sum = [0.0f64; 3];
        sums.push(sum);
        for pixel in &line {
            (0..3).for_each(|c| sum[c] += f64::from(pixel[c]));
            sums.push(sum);
        }
        let per_column = columns as f64 / f64::from(grid.columns());
        // Lattice column 0 lies this many pixels from the picture's western edge.
        let turn = (grid.globe.longitude(0) - self.west) / (2.0 * PI) * columns as f64;
        let width = (strip.step.max(strip.least_width) * per_column).clamp(1e-9, columns as f64);
        let up_to = |x: f64| {
            let turns = (x / columns as f64).floor();
            let inside = (x - turns * columns as f64).clamp(0.0, columns as f64);
            let pixel = (inside.floor() as usize).min(line.len() - 1);
            let rest = inside - pixel as f64;
            [0, 1, 2].map(|c| turns * sum[c] + sums[pixel][c] + rest * f64::from(line[pixel][c]))
        };
        let texel = |k: usize| {
            let middle = (strip.first + (k as f64 + 0.5) * strip.step) * per_column + turn;
            let (before, after) = (up_to(middle - 0.5 * width), up_to(middle + 0.5 * width));
            [0, 1, 2].map(|c| ((after[c] - before[c]) / width) as f32)
        };
        Ok((0..count).map(texel).collect())
    }
}

/// Texels in a row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Strip {
    /// Lattice rows that they cover, within the body.
    pub(super) rows: [f64; 2],
    /// Lattice column at which the first begins.
    pub(super) first: f64,
    /// Their width, lattice columns.
    pub(super) step: f64,
    /// The mean is taken over at least this many lattice columns.
    pub(super) least_width: f64,
}

/// The weighted mean of rows of pixels.
fn mixed(pixels: &[Rgb], columns: usize, weights: &[f32]) -> Vec<[f32; 3]> {
    let mut line = vec![[0.0f32; 3]; columns];
    for (row, weight) in pixels.chunks_exact(columns).zip(weights) {
        for (to, from) in line.iter_mut().zip(row) {
            (0..3).for_each(|c| to[c] += weight * f32::from(from[c]));
        }
    }
    line
}

/// A row of the next coarser level of `size`.
fn half(finer: &Level<Rgb>, size: [u64; 2], row: u64) -> io::Result<Vec<Rgb>> {
    let [columns, rows] = finer.size();
    let scale = [columns as f64 / size[0] as f64, rows as f64 / size[1] as f64];
    let (first, across) = weights(row as f64 * scale[1], (row + 1) as f64 * scale[1], rows);
    let pixels = finer.read(Rect::new([0, first as i64], [columns as usize, across.len()]))?;
    let line = mixed(&pixels, columns as usize, &across);
    let texel = |k: u64| {
        let (first, along) = weights(k as f64 * scale[0], (k + 1) as f64 * scale[0], columns);
        let mut sum = [0.0f32; 3];
        for (pixel, weight) in line[first as usize..].iter().zip(&along) {
            (0..3).for_each(|c| sum[c] += weight * pixel[c]);
        }
        sum.map(|v| v.round().clamp(0.0, 255.0) as u8)
    };
    Ok((0..size[0]).map(texel).collect())
}
