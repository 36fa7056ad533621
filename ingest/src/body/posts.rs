//! Heights of the posts of every level of a body: a function of lattice point and level alone, so that
//! nodes that share a post agree on it.
//!
//! A level has a lattice row's posts as far apart as the finest row of nodes has them that shares it.
//! At the finest level of such a row they are the source's samples. Otherwise they are low-passed: along
//! latitude as the level is, along longitude to the posts' distance, and where that is closer on the
//! ground than rows are, towards a pole, to the rows' distance.

use super::base::Base;
use super::grid::Grid;
use super::ring::Ring;
use crate::IngestError;
use crate::sample::elevation::quantized;
use crate::store::{Level, Rect};
use crate::work::Work;
use std::io;
use std::path::Path;

/// Where a row's posts are stored.
#[derive(Debug, Clone, Copy)]
enum Stored {
    /// They are the source's samples.
    Source,
    /// From this number on.
    At(u64),
}

/// Posts of one level.
#[derive(Debug)]
struct PostLevel {
    /// Lattice rows, from the south.
    rows: Vec<u64>,
    stored: Vec<(Stored, u8)>,
    values: Level<f32>,
}

/// Posts of all levels.
#[derive(Debug)]
pub(super) struct Posts<'a> {
    base: &'a Base,
    levels: Vec<PostLevel>,
}

/// The posts of a level in one lattice row.
#[derive(Debug, Clone)]
pub(super) struct Line {
    log_step: u8,
    values: Vec<f32>,
}

impl Line {
    /// The height at a canonical lattice column that is a post.
    pub(super) fn at(&self, column: u64) -> f32 {
        self.values[(column >> self.log_step) as usize]
    }
}

impl<'a> Posts<'a> {
    /// Makes those of all levels.
    pub(super) fn of(base: &'a Base, folder: &Path, work: &Work) -> Result<Self, IngestError> {
        let fail = |source| IngestError::Output { source, path: folder.to_owned() };
        let grid = base.grid;
        let mut levels = Vec::new();
        for q in 0..=grid.lattice().top() {
            let rows = grid.post_rows(q);
            let mut total = 0;
            let place = |row: &u64| {
                let log_step = grid.log_columns(q, *row);
                if grid.is_exact(q, *row) {
                    return (Stored::Source, 0);
                }
                let at = total;
                total += Ring::new(grid.columns(), log_step).count() as u64;
                (Stored::At(at), log_step)
            };
            let stored: Vec<(Stored, u8)> = rows.iter().map(place).collect();
            let values = Level::create(folder, [total.max(1), 1]).map_err(fail)?;
            let level = PostLevel { rows, stored, values };
            work.each(
                "elevation posts",
                level.rows.len(),
                || Ok(()),
                |(), index| {
                    let (Stored::At(at), log_step) = level.stored[index] else { return Ok(()) };
                    let values = filtered_row(base, q, level.rows[index], log_step).map_err(fail)?;
                    level.values.write(Rect::new([at as i64, 0], [values.len(), 1]), &values).map_err(fail)
                },
            )?;
            levels.push(level);
        }
        Ok(Self { base, levels })
    }

    pub(super) fn grid(&self) -> &Grid {
        &self.base.grid
    }

    /// The posts of a level in a lattice row that has some.
    pub(super) fn line(&self, q: u8, row: u64) -> io::Result<Line> {
        let level = &self.levels[usize::from(q)];
        let index = level.rows.binary_search(&row).ok();
        let index = index.ok_or_else(|| io::Error::other("a row without posts was asked for"))?;
        let (stored, log_step) = level.stored[index];
        let count = Ring::new(self.base.grid.columns(), log_step).count();
        let values = match stored {
            Stored::Source => self.base.row(0, row as i64)?,
            Stored::At(at) => level.values.read(Rect::new([at as i64, 0], [count, 1]))?,
        };
        Ok(Line { log_step, values })
    }
}

/// Posts of a level `2^log_step` columns apart, in a row that has not the source's.
fn filtered_row(base: &Base, q: u8, row: u64, log_step: u8) -> io::Result<Vec<f32>> {
    let grid = &base.grid;
    let log_rows = grid.log_rows(q);
    let mut values = base.row(log_rows, row as i64)?;
    let is_pole = row == 0 || row == u64::from(grid.rows());
    for log in log_rows..log_step {
        values = base.ring(log).halved(&values);
    }
    if !is_pole && q >= grid.lattice().rows_level() {
        let ratio = grid.columns_per_row(row) * f64::from(1u32 << log_rows) / f64::from(1u32 << log_step);
        values = base.ring(log_step).smoothed(values, ratio);
    }
    values.iter_mut().for_each(|value| *value = quantized(*value));
    Ok(values)
}
