//! Vertices of a leaf relative to an eye.

use glam::Vec3;

/// Vertices of a leaf relative to the eye, made of its columns, its rows and its heights. Row 0 is
/// the southern one.
#[derive(Debug, Clone, Copy)]
pub struct Vertices<'a> {
    /// [`super::EyeFrame::column_from_eye`] of each column.
    pub columns: &'a [f32],
    /// [`super::EyeFrame::row_from_eye`] of each row.
    pub rows: &'a [f32],
    /// Metres above the eye, by row, then column.
    pub heights: &'a [f32],
}

impl<'a> Vertices<'a> {
    /// Metres east, north and up of the eye. Panics outside of the leaf.
    #[inline(always)]
    #[must_use]
    pub fn at(&self, column: usize, row: usize) -> Vec3 {
        place(self.columns[column], self.rows[row], self.heights[row * self.columns.len() + column])
    }

    /// Row after row, each from west to east: metres east, north and up of the eye.
    #[inline(always)]
    pub fn by_row(&self) -> impl Iterator<Item = impl Iterator<Item = Vec3> + 'a> + 'a {
        let columns = self.columns;
        let rows = self.heights.chunks_exact(columns.len()).zip(self.rows);
        rows.map(move |(heights, row)| {
            heights.iter().zip(columns).map(move |(height, column)| place(*column, *row, *height))
        })
    }

    /// South west corner of the cell of `step` posts a side that is under (or over) the eye, if one
    /// is: its column and its row.
    #[must_use]
    pub fn cell_under_eye(&self, step: usize) -> Option<[usize; 2]> {
        let around_eye = |terms: &[f32]| {
            let holds_eye = |at: &usize| terms[*at] <= 0.0 && terms[at + step] >= 0.0;
            (0..terms.len() - 1).step_by(step).find(holds_eye)
        };
        Some([around_eye(self.columns)?, around_eye(self.rows)?])
    }

    /// The four corners of the leaf, at the height of the eye.
    #[must_use]
    pub fn level_corners(&self) -> [Vec3; 4] {
        let ends = |terms: &[f32]| [terms[0], terms[terms.len() - 1]];
        let ([west, east], [south, north]) = (ends(self.columns), ends(self.rows));
        [place(west, south, 0.0), place(west, north, 0.0), place(east, south, 0.0), place(east, north, 0.0)]
    }
}

#[inline(always)]
fn place(column: f32, row: f32, height: f32) -> Vec3 {
    Vec3::new(column, row, height)
}
