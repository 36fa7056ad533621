//! Where the posts of a tile lie along an axis of the lattice.

use super::tile::CellPosition;

/// The lattice coordinates of the posts of a tile along longitude or latitude, or east or north: evenly
/// apart, but that those beyond an end of the ground lie on it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct PostLine {
    /// Of the first post, were there no end; it may lie before the lattice's first line.
    origin: i64,
    /// From post to post, as a power of two.
    log_step: u8,
    cells: u32,
    /// Posts lie between these two.
    ends: [i64; 2],
}

impl PostLine {
    /// Of posts from `origin` on, between two ends.
    #[must_use]
    pub const fn new(origin: i64, log_step: u8, cells: u32, ends: [i64; 2]) -> Self {
        Self { origin, log_step, cells, ends }
    }

    /// Of a tile whose cells all have their full width, also beyond the end of the ground.
    #[must_use]
    pub const fn even(origin: u64, log_step: u8, cells: u32) -> Self {
        Self::new(origin.cast_signed(), log_step, cells, [i64::MIN / 4, i64::MAX / 4])
    }

    /// The first post's place, were there no end.
    #[must_use]
    pub const fn origin(&self) -> i64 {
        self.origin
    }

    /// From post to post, as a power of two of lattice lines.
    #[must_use]
    pub const fn log_step(&self) -> u8 {
        self.log_step
    }

    /// Cells between its posts.
    #[must_use]
    pub const fn cells(&self) -> u32 {
        self.cells
    }

    /// The place of the last post.
    #[must_use]
    pub fn end(&self) -> i64 {
        self.post(self.cells)
    }

    /// The last of the posts that lie where the first one does.
    #[must_use]
    pub fn first_inside(&self) -> u32 {
        let before = (self.ends[0] - self.origin).max(0) >> self.log_step;
        (before as u32).min(self.cells)
    }

    /// The first of the posts that lie where the last one does.
    #[must_use]
    pub fn last_inside(&self) -> u32 {
        let inside = self.ends[1].min(self.origin + (i64::from(self.cells) << self.log_step)) - self.origin;
        let step = 1i64 << self.log_step;
        ((inside + step - 1) >> self.log_step) as u32
    }

    /// The place of a post.
    #[inline]
    #[must_use]
    pub fn post(&self, index: u32) -> i64 {
        (self.origin + (i64::from(index) << self.log_step)).clamp(self.ends[0], self.ends[1])
    }

    /// The place of a post in units of steps from where the line begins, were there no end.
    #[must_use]
    pub fn in_posts(&self, index: u32) -> f32 {
        ((self.post(index) - self.origin) as f64 / (1u64 << self.log_step) as f64) as f32
    }

    /// Every second post of the line.
    #[must_use]
    pub const fn every_second(self) -> Self {
        Self { log_step: self.log_step + 1, cells: self.cells / 2, ..self }
    }

    /// The cell of a place, and where in it. A place before the first post or behind the last is taken
    /// to that post; the last post belongs to the last cell.
    #[inline]
    #[must_use]
    pub fn position(&self, at: u64) -> CellPosition {
        let last = i64::from(self.cells) << self.log_step;
        let inside = (at.cast_signed() - self.origin).clamp(0, last);
        let cell = ((inside >> self.log_step) as u32).min(self.cells - 1);
        let [low, high] = [self.post(cell), self.post(cell + 1)];
        let (rest, width) = (self.origin + inside - low, high - low);
        if width == 1 << self.log_step {
            return CellPosition { cell, offset: rest as f64 / width as f64 };
        }
        let offset = if width > 0 { (rest as f64 / width as f64).clamp(0.0, 1.0) } else { 0.0 };
        CellPosition { cell, offset }
    }

    /// The place of a point of the line, in cells from its first post.
    #[must_use]
    pub fn place(&self, at: f64) -> f64 {
        let nominal = (at - self.origin as f64) / (1u64 << self.log_step) as f64;
        let cell = nominal.floor().clamp(0.0, f64::from(self.cells - 1)) as u32;
        let [low, high] = [self.post(cell), self.post(cell + 1)];
        if high - low == 1 << self.log_step || high <= low {
            return nominal.clamp(0.0, f64::from(self.cells));
        }
        f64::from(cell) + ((at - low as f64) / (high - low) as f64).clamp(0.0, 1.0)
    }
}
