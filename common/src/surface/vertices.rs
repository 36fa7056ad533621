//! Vertices of a leaf relative to an eye.

use super::globe::{GlobeColumn, GlobeEye, GlobeRow};
use glam::Vec3;

/// The terms of the columns and rows of a leaf's vertices, relative to an eye; keeps its buffers.
#[derive(Debug, Clone, Default)]
pub struct VertexTerms {
    pub(super) columns: Vec<f32>,
    pub(super) rows: Vec<f32>,
    pub(super) globe_columns: Vec<GlobeColumn>,
    pub(super) globe_rows: Vec<GlobeRow>,
    /// The eye, if they are those of a body.
    pub(super) globe: Option<GlobeEye>,
}

impl VertexTerms {
    /// Of a plane: metres east and metres north of the eye.
    #[must_use]
    pub fn of_plane(columns: Vec<f32>, rows: Vec<f32>) -> Self {
        Self { columns, rows, ..Self::default() }
    }

    /// Vertices of these columns and rows, with heights above the eye, by row, then column.
    #[must_use]
    pub fn with_heights<'a>(&'a self, heights: &'a [f32]) -> Vertices<'a> {
        Vertices { terms: self, heights }
    }
}

/// Vertices of a leaf relative to the eye, made of its columns, its rows and its heights. Row 0 is
/// the southern one.
#[derive(Debug, Clone, Copy)]
pub struct Vertices<'a> {
    terms: &'a VertexTerms,
    /// Metres above the eye, by row, then column.
    heights: &'a [f32],
}

impl<'a> Vertices<'a> {
    /// The same columns and rows at other heights.
    #[must_use]
    pub fn at_heights<'b>(&self, heights: &'b [f32]) -> Vertices<'b>
    where
        'a: 'b,
    {
        Vertices { terms: self.terms, heights }
    }

    fn columns(&self) -> usize {
        self.terms.columns.len().max(self.terms.globe_columns.len())
    }

    /// Metres east, north and up of the eye. Panics outside of the leaf.
    #[inline(always)]
    #[must_use]
    pub fn at(&self, column: usize, row: usize) -> Vec3 {
        let height = self.heights[row * self.columns() + column];
        match &self.terms.globe {
            None => place(self.terms.columns[column], self.terms.rows[row], height),
            Some(eye) => eye.vertex_above(self.terms.globe_columns[column], self.terms.globe_rows[row], height),
        }
    }

    /// Each vertex of a row from west to east, with its number: metres east, north and up of the eye.
    #[inline(always)]
    pub fn for_row(&self, row: usize, mut each: impl FnMut(usize, Vec3)) {
        let width = self.columns();
        let heights = &self.heights[row * width..(row + 1) * width];
        match &self.terms.globe {
            None => {
                let north = self.terms.rows[row];
                for (index, (height, column)) in heights.iter().zip(&self.terms.columns).enumerate() {
                    each(index, place(*column, north, *height));
                }
            }
            Some(eye) => {
                let row = self.terms.globe_rows[row];
                for (index, (height, column)) in heights.iter().zip(&self.terms.globe_columns).enumerate() {
                    each(index, eye.vertex_above(*column, row, *height));
                }
            }
        }
    }

    /// South west corner of the cell of `step` posts a side that is under (or over) the eye, if one
    /// is: its column and its row. For planes.
    #[must_use]
    pub fn cell_under_eye(&self, step: usize) -> Option<[usize; 2]> {
        let around_eye = |terms: &[f32]| {
            let holds_eye = |at: &usize| terms[*at] <= 0.0 && terms[at + step] >= 0.0;
            (0..terms.len().saturating_sub(1)).step_by(step).find(holds_eye)
        };
        Some([around_eye(&self.terms.columns)?, around_eye(&self.terms.rows)?])
    }

    /// The four corners of the leaf, at the height of the eye. For planes.
    #[must_use]
    pub fn level_corners(&self) -> [Vec3; 4] {
        let ends = |terms: &[f32]| [terms[0], terms[terms.len() - 1]];
        let ([west, east], [south, north]) = (ends(&self.terms.columns), ends(&self.terms.rows));
        [place(west, south, 0.0), place(west, north, 0.0), place(east, south, 0.0), place(east, north, 0.0)]
    }
}

#[inline(always)]
fn place(column: f32, row: f32, height: f32) -> Vec3 {
    Vec3::new(column, row, height)
}
