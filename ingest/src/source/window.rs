//! A piece of a source in memory.

/// Pixels of a source, `size` from `origin` `[column, row]`, rows from the north as in the file.
#[derive(Debug, Clone)]
pub struct Window<const C: usize> {
    origin: [i64; 2],
    size: [usize; 2],
    /// Samples.
    pub pixels: Vec<[f32; C]>,
    /// True where there is no data; empty when there is data everywhere.
    voids: Vec<bool>,
}

impl<const C: usize> Window<C> {
    /// A window of zeros without voids.
    #[must_use]
    pub fn new(origin: [usize; 2], size: [usize; 2]) -> Self {
        Self::placed(origin.map(|v| v as i64), size)
    }

    /// The same on the grid of a source that it may lie beside.
    #[must_use]
    pub fn placed(origin: [i64; 2], size: [usize; 2]) -> Self {
        Self { origin, size, pixels: vec![[0.0; C]; size[0] * size[1]], voids: Vec::new() }
    }

    /// The same samples at another place.
    #[must_use]
    pub fn moved_to(self, origin: [i64; 2]) -> Self {
        Self { origin, ..self }
    }

    /// The pixel of a number, unless it is void.
    #[must_use]
    pub fn known(&self, at: usize) -> Option<[f32; C]> {
        let is_void = self.voids.get(at).copied().unwrap_or(false);
        (!is_void).then(|| self.pixels[at])
    }

    /// The pixel at a place of the source's grid, unless it is void; beyond the window its border
    /// is repeated.
    pub(crate) fn known_near(&self, place: [i64; 2]) -> Option<[f32; C]> {
        let [column, row] = [0, 1].map(|k| (place[k] - self.origin[k]).clamp(0, self.size[k] as i64 - 1) as usize);
        self.known(row * self.size[0] + column)
    }

    /// Makes a pixel void.
    pub fn mask(&mut self, at: usize) {
        if self.voids.is_empty() {
            self.voids = vec![false; self.pixels.len()];
        }
        self.voids[at] = true;
        self.pixels[at] = [0.0; C];
    }

    /// Where it begins on the source's grid.
    #[must_use]
    pub fn origin(&self) -> [i64; 2] {
        self.origin
    }

    /// Columns and rows.
    #[must_use]
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// The pixel of a column and row of the window, and whether it is void.
    #[must_use]
    pub fn at(&self, column: usize, row: usize) -> ([f32; C], bool) {
        let at = row * self.size[0] + column;
        (self.pixels[at], self.voids.get(at).copied().unwrap_or(false))
    }
}
