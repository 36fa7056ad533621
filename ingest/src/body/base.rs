//! Heights of a body's lattice, low-passed along both of its axes alike: level `s` has every `2^s`-th
//! column of every `2^s`-th row. All rows are whole parallels.

use super::grid::{Grid, Rows};
use super::ring::{REACH, Ring};
use crate::IngestError;
use crate::pyramid::elevation::filtered;
use crate::store::{Level, Rect};
use crate::work::Work;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::io;
use std::path::Path;

/// Rows of a level that are made at a time: as many as keep what a thread holds small.
const MOST_ROWS: usize = 24;
/// Samples that a thread may hold.
const MOST_SAMPLES: usize = 6 << 20;

/// The levels.
#[derive(Debug)]
pub(super) struct Base {
    pub(super) grid: Grid,
    /// Level 0 has the source's samples, row 0 in the south; the poles' rows are constant.
    levels: Vec<Level<f32>>,
}

impl Base {
    /// The coarser levels of a lattice of heights.
    pub(super) fn of(grid: Grid, finest: Level<f32>, folder: &Path, work: &Work) -> Result<Self, IngestError> {
        let mut base = Self { grid, levels: vec![finest] };
        for log in 1..=grid.lattice().top() - grid.lattice().rows_level() {
            let level = base.coarser(log, folder, work)?;
            base.levels.push(level);
        }
        Ok(base)
    }

    pub(super) fn ring(&self, log: u8) -> Ring {
        Ring::new(self.grid.columns(), log)
    }

    /// A stored row.
    fn stored(&self, log: u8, index: u64) -> io::Result<Vec<f32>> {
        self.levels[usize::from(log)].read(Rect::new([0, index as i64], [self.ring(log).count(), 1]))
    }

    /// The values of a level in any lattice row; beyond a pole those half a turn away.
    pub(super) fn row(&self, log: u8, row: i64) -> io::Result<Vec<f32>> {
        let last = i64::from(self.grid.rows());
        let inside = if row < 0 { -row } else { row };
        let inside = if inside > last { 2 * last - inside } else { inside };
        let inside = inside.clamp(0, last);
        let (before, after, share) = Rows::new(&self.grid, log).around(inside as u64);
        let mut values = self.stored(log, before)?;
        if after != before {
            let next = self.stored(log, after)?;
            values.iter_mut().zip(next).for_each(|(value, next)| *value += share * (next - *value));
        }
        Ok(if inside == row { values } else { self.ring(log).turned(&values) })
    }

    fn coarser(&self, log: u8, folder: &Path, work: &Work) -> Result<Level<f32>, IngestError> {
        let fail = |source| IngestError::Output { source, path: folder.to_owned() };
        let (finer, ring) = (log - 1, self.ring(log - 1));
        let rows = Rows::new(&self.grid, log);
        let level = Level::create(folder, [ring.coarser().count() as u64, rows.count()]).map_err(fail)?;
        let at_once = (MOST_SAMPLES / ring.count()).saturating_sub(4 * REACH).clamp(2, 2 * MOST_ROWS) / 2;
        let chunks = (rows.count() as usize).div_ceil(at_once);
        work.each(
            "elevation levels",
            chunks,
            || Ok(()),
            |(), chunk| {
                let mut near: HashMap<i64, Vec<f32>> = HashMap::new();
                let first = (chunk * at_once) as u64;
                for index in first..(first + at_once as u64).min(rows.count()) {
                    let row = rows.row(index) as i64;
                    let taps = (-(REACH as i64)..=REACH as i64).map(|d| row + (d << finer));
                    near.retain(|at, _| *at >= row - ((REACH as i64) << finer));
                    for tap in taps {
                        if let Entry::Vacant(entry) = near.entry(tap) {
                            entry.insert(self.row(finer, tap).map_err(fail)?);
                        }
                    }
                    let line = |d: isize| &near[&(row + ((d as i64) << finer))];
                    let lines: Vec<&Vec<f32>> = (-(REACH as isize)..=REACH as isize).map(line).collect();
                    let across: Vec<f32> =
                        (0..ring.count()).map(|k| filtered(|d| lines[REACH.wrapping_add_signed(d)][k])).collect();
                    let is_pole = row == 0 || row == i64::from(self.grid.rows());
                    let values =
                        if is_pole { vec![mean(&across); ring.coarser().count()] } else { ring.halved(&across) };
                    level.write(Rect::new([0, index as i64], [values.len(), 1]), &values).map_err(fail)?;
                }
                Ok(())
            },
        )?;
        Ok(level)
    }

    /// Heights of the source's lattice.
    pub(super) fn finest(&self) -> &Level<f32> {
        &self.levels[0]
    }

    /// The finest level with at most this many values, and how often it is halved.
    pub(super) fn overview(&self, most: u64) -> (&Level<f32>, u8) {
        let is_small = |level: &Level<f32>| level.size().iter().product::<u64>() <= most;
        let at = self.levels.iter().position(is_small).unwrap_or(self.levels.len() - 1);
        (&self.levels[at], at as u8)
    }
}

/// The mean of a row.
pub(super) fn mean(values: &[f32]) -> f32 {
    (values.iter().copied().map(f64::from).sum::<f64>() / values.len() as f64) as f32
}
