//! A strip: neighboring lines between their sweep and their shading. One per worker, used again.

use super::edges::{Edge, Edges};
use terravision_common::simd::{LANES, Simd};

/// Lines of a strip: eight blocks. What it has of a picture of 720 rows fits into a core's second
/// cache.
pub(super) const LINES: usize = 8 * LANES;

/// One over depth at the middle of a row, 0 for sky, and its change from row to row, of each line.
/// Behind the last line there is room to be read, not looked at.
#[derive(Debug, Clone)]
pub(super) struct StripRow {
    pub(super) nearness: [f32; LINES + LANES],
    pub(super) per_row: [f32; LINES + LANES],
}

/// Rows of sixteen lines: of each from its `low` row up to before its `high` one, in which it sees
/// `base + row·per_row`.
pub(super) struct Rows<S: Simd> {
    pub(super) low: S::Floats,
    pub(super) high: S::Floats,
    pub(super) base: S::Floats,
    pub(super) per_row: S::Floats,
}

/// The rows of neighboring lines, from the bottom.
#[derive(Debug)]
pub(super) struct Strip {
    rows: Vec<StripRow>,
    /// Where the ground of each line ends and the sky begins: rows, not whole ones.
    pub(super) skyline: [f32; LINES + LANES],
    /// Where ground of each line ends before other ground, or the sky.
    pub(super) edges: Edges,
}

impl Default for Strip {
    fn default() -> Self {
        Self { rows: Vec::new(), skyline: [0.0; LINES + LANES], edges: Edges::default() }
    }
}

impl Strip {
    /// Takes memory for this many rows, if it is not there.
    pub(super) fn reserve(&mut self, rows: usize) {
        if self.rows.len() < rows {
            self.rows.resize(rows, StripRow { nearness: [0.0; LINES + LANES], per_row: [0.0; LINES + LANES] });
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

    /// Fills rows of sixteen lines, which are those from `first` on.
    #[inline(always)]
    pub(super) fn fill<S: Simd>(&mut self, simd: S, first: usize, lines: &Rows<S>) {
        let (from, to) = (simd.smallest(lines.low) as usize, simd.largest(lines.high) as usize);
        let Some(rows) = self.rows.get_mut(from..to) else { return };
        for (row, number) in rows.iter_mut().zip(from..) {
            let number = simd.floats(number as f32);
            let (Some((nearness, _)), Some((per_row, _))) = (
                row.nearness.get_mut(first..).and_then(|row| row.split_first_chunk_mut::<LANES>()),
                row.per_row.get_mut(first..).and_then(|row| row.split_first_chunk_mut::<LANES>()),
            ) else {
                return;
            };
            let filled = simd.at_most(lines.low, number) & simd.less(number, lines.high);
            simd.store_where(filled, lines.base + number * lines.per_row, nearness);
            simd.store_where(filled, lines.per_row, per_row);
        }
    }

    /// Puts edges of those of sixteen lines for which `are` holds: where they are, and the first row
    /// behind each.
    #[inline(always)]
    pub(super) fn put_edges<S: Simd>(&mut self, simd: S, first: usize, [at, behind]: [S::Floats; 2], are: S::Mask) {
        let mut left = simd.bits(are);
        if left == 0 {
            return;
        }
        let mut places = [[0.0; LANES]; 2];
        simd.store(at, &mut places[0]);
        simd.store(behind, &mut places[1]);
        while left != 0 {
            let k = left.trailing_zeros() as usize % LANES;
            self.edges.put(first + k, Edge { at: places[0][k], behind: places[1][k] as u32 });
            left &= left - 1;
        }
    }

    /// The rows of sixteen lines from `next` on are sky, which begins at the rows `skyline`.
    #[inline(always)]
    pub(super) fn put_sky<S: Simd>(&mut self, simd: S, first: usize, [next, skyline]: [S::Floats; 2], rows: [f32; 2]) {
        if let Some((lines, _)) = self.skyline.get_mut(first..).and_then(|lines| lines.split_first_chunk_mut::<LANES>())
        {
            simd.store(skyline, lines);
        }
        let zero = simd.floats(0.0);
        self.fill(simd, first, &Rows { low: next, high: simd.floats(rows[1]), base: zero, per_row: zero });
    }
}
