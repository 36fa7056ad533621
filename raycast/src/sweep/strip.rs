//! A strip: neighboring lines between their sweep and their shading. One per worker, used again.

use super::lanes::{Floats, LANES};

/// Lines of a strip: eight blocks. What it has of a picture of 720 rows fits into a core's second
/// cache.
pub(super) const LINES: usize = 8 * LANES;

/// One over depth at the middle of a row, 0 for sky, and its change from row to row, of each line.
#[derive(Debug, Clone)]
pub(super) struct StripRow {
    pub(super) nearness: [f32; LINES],
    pub(super) per_row: [f32; LINES],
}

/// The rows of neighboring lines, from the bottom.
#[derive(Debug, Default)]
pub(super) struct Strip {
    rows: Vec<StripRow>,
}

impl Strip {
    /// Takes memory for this many rows, if it is not there.
    pub(super) fn reserve(&mut self, rows: usize) {
        if self.rows.len() < rows {
            self.rows.resize(rows, StripRow { nearness: [0.0; LINES], per_row: [0.0; LINES] });
        }
    }

    pub(super) fn row(&self, row: usize) -> &StripRow {
        &self.rows[row]
    }

    /// Puts what one line sees in a row.
    pub(super) fn put(&mut self, row: usize, line: usize, nearness: f32, per_row: f32) {
        if let Some(row) = self.rows.get_mut(row) {
            row.nearness[line] = nearness;
            row.per_row[line] = per_row;
        }
    }

    /// Fills rows of sixteen lines: of each from its `low` row up to before its `high` one, `base +
    /// row·per_row`.
    #[inline(always)]
    pub(super) fn fill(
        &mut self,
        first: usize,
        [from, to]: [usize; 2],
        [low, high]: [&Floats; 2],
        [base, per_row]: [&Floats; 2],
    ) {
        let Some(rows) = self.rows.get_mut(from..to) else { return };
        for (row, number) in rows.iter_mut().zip(from..) {
            let number = number as f32;
            let (Some(nearness), Some(slopes)) = (
                row.nearness.get_mut(first..first + LANES).and_then(|row| row.first_chunk_mut::<LANES>()),
                row.per_row.get_mut(first..first + LANES).and_then(|row| row.first_chunk_mut::<LANES>()),
            ) else {
                return;
            };
            for k in 0..LANES {
                let is_filled = (low[k] <= number) & (number < high[k]);
                nearness[k] = if is_filled { base[k] + number * per_row[k] } else { nearness[k] };
                slopes[k] = if is_filled { per_row[k] } else { slopes[k] };
            }
        }
    }

    /// The rows of sixteen lines from `next` on are sky.
    #[inline(always)]
    pub(super) fn put_sky(&mut self, first: usize, next: &Floats, rows: [f32; 2]) {
        self.fill(
            first,
            [super::lanes::smallest(next) as usize, rows[1] as usize],
            [next, &[f32::INFINITY; LANES]],
            [&[0.0; LANES]; 2],
        );
    }
}
