//! The lattice of a body, and the nodes that it is cut into.
//!
//! Longitudes and latitudes of samples are lattice points where the source has them: column `i` of
//! `W` from the western edge on, row `j` from the south pole (0) to the north pole (`H`). Columns
//! go around: `W` is 0 again. All of a pole's row is one point.
//!
//! A plain quad tree over this lattice has slivers at the poles. So a row of nodes is as much wider as
//! it is nearer to a pole: rows are counted from the nearer pole at their level, and the row `r` is
//! `2^⌈log2(r+1)⌉` times as finely cut along longitude as row 0.
//!
//! ```text
//!   pole  ·───────────·───────────·      row 0: a few columns, at every level
//!         │     ·     │     ·     │      row 1: twice as many
//!         │  ·  ·  ·  │  ·  ·  ·  │      rows 2 and 3: four times, rows 4 to 7: eight times, …
//! ```
//!
//! A node's children are two rows of two nodes; of a polar node the one at the pole, as wide as
//! itself, and two. Both hemispheres are cut from their pole to the row nearest to the equator, where
//! the last nodes of each end, as all nodes end at the seam: their posts beyond lie on it.
//!
//! Where rows cannot be cut any more, nodes are cut along longitude alone, down to the lattice's own
//! columns: to the level 0 at the poles, and to [`GlobeLattice::rows_level`] around the equator. So
//! every lattice point is a post, and a level is as fine along longitude wherever it exists.

use crate::node::{MAX_LEVEL, NodeId};
use crate::surface::{MOST_CHILDREN, PostLine};
use glam::DVec2;
use std::ops::Range;

/// Which edge of a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// To the west.
    West,
    /// To the east.
    East,
    /// To the south.
    South,
    /// To the north.
    North,
}

/// The lattice of a body: integers alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GlobeLattice {
    /// Lattice columns around: W.
    columns: u32,
    /// Lattice rows from pole to pole: H. Row H is the north pole.
    rows: u32,
    /// Cells along a side of a node.
    cells: u32,
    /// The finest level at which rows are cut; and as many more levels are above it, up to the one at
    /// which each hemisphere is one row of nodes.
    rows_level: u8,
}

/// The nodes of one row, at one level.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct NodeRow {
    /// Counted from the nearer pole.
    from_pole: u32,
    is_north: bool,
    /// A step along longitude is this power of two of columns.
    log_step: u8,
}

fn ceil_log2(number: u32) -> u8 {
    number.next_power_of_two().trailing_zeros() as u8
}

impl GlobeLattice {
    /// A lattice of `columns` around and `rows` from pole to pole, whose nodes have `cells` cells (a
    /// power of two) a side. `None` when a polar node would be wider than half a turn or
    /// narrower than a quarter of it, or there are more nodes than ids.
    #[must_use]
    pub fn new(columns: u32, rows: u32, cells: u32) -> Option<Self> {
        let half = rows.div_ceil(2);
        if rows < 2 || !cells.is_power_of_two() {
            return None;
        }
        let lattice = Self { columns, rows, cells, rows_level: ceil_log2(half.div_ceil(cells)) };
        // There is a level above all nodes: that of the crown.
        let is_in_ids = lattice.rows_level < MAX_LEVEL / 2 && columns.div_ceil(cells) < 1 << 28;
        // No node may be wider than half a turn.
        let widest = u64::from(cells) << lattice.rows_level.min(31);
        let roots = u64::from(columns).div_ceil(widest);
        let is_wide = 2 * widest <= columns.into() && roots <= MOST_CHILDREN as u64 / 2;
        (is_in_ids && is_wide).then_some(lattice)
    }

    /// Lattice columns around, and rows from pole to pole.
    #[must_use]
    pub const fn size(&self) -> [u32; 2] {
        [self.columns, self.rows]
    }

    /// Cells along a side of a node.
    #[must_use]
    pub const fn cells(&self) -> u32 {
        self.cells
    }

    /// The coarsest level: that of the roots.
    #[must_use]
    pub const fn top(&self) -> u8 {
        2 * self.rows_level
    }

    /// The finest level that cuts rows; finer ones cut columns alone.
    #[must_use]
    pub const fn rows_level(&self) -> u8 {
        self.rows_level
    }

    /// A step along latitude at a level, as a power of two of rows.
    const fn log_rows(&self, q: u8) -> u8 {
        q.saturating_sub(self.rows_level)
    }

    /// The lattice row at which the hemispheres meet.
    const fn middle(&self) -> u32 {
        self.rows / 2
    }

    /// Lattice rows from a pole to the middle.
    const fn half(&self, is_north: bool) -> u32 {
        if is_north { self.rows - self.middle() } else { self.middle() }
    }

    /// A row of nodes; `None` where its columns are as fine as the lattice's at a coarser level.
    fn row_of(&self, q: u8, from_pole: u32, is_north: bool) -> Option<NodeRow> {
        let widest = self.rows_level - ceil_log2(from_pole + 1).min(self.rows_level - self.log_rows(q));
        let log_step = widest.checked_sub(self.rows_level.saturating_sub(q))?;
        Some(NodeRow { from_pole, is_north, log_step })
    }

    /// Numbers of rows at a level, of which those around the middle do not exist.
    const fn numbers(&self, q: u8) -> u32 {
        2 << (self.rows_level - self.log_rows(q))
    }

    fn row_at(&self, q: u8, n: u32) -> Option<NodeRow> {
        let is_north = n >= self.numbers(q) / 2;
        self.row_of(q, if is_north { self.numbers(q) - 1 - n } else { n }, is_north)
    }

    /// The row of a node that exists.
    fn row(&self, node: NodeId) -> NodeRow {
        let none = NodeRow { from_pole: 0, is_north: false, log_step: 0 };
        self.row_at(node.q(), node.n()).unwrap_or(none)
    }

    /// Number of a row, counted from the south.
    fn number(&self, q: u8, from_pole: u32, is_north: bool) -> u32 {
        if is_north { self.numbers(q) - 1 - from_pole } else { from_pole }
    }

    /// Rows of nodes of a hemisphere at a level.
    fn rows_of(&self, q: u8, is_north: bool) -> u32 {
        (u64::from(self.half(is_north)).div_ceil(u64::from(self.cells) << self.log_rows(q))) as u32
    }

    /// Nodes of a row.
    fn columns_of(&self, row: &NodeRow) -> u32 {
        u64::from(self.columns).div_ceil(u64::from(self.cells) << row.log_step) as u32
    }

    /// Whether a node is one of the body.
    #[must_use]
    pub fn contains(&self, node: NodeId) -> bool {
        if node.q() > self.top() || node.n() >= self.numbers(node.q()) {
            return false;
        }
        let is_in =
            |row: NodeRow| row.from_pole < self.rows_of(node.q(), row.is_north) && node.m() < self.columns_of(&row);
        self.row_at(node.q(), node.n()).is_some_and(is_in)
    }

    /// The node above all roots, which has no tiles of its own.
    #[must_use]
    pub const fn crown(&self) -> NodeId {
        NodeId::root(self.top() + 2)
    }

    /// The nodes of the coarsest level: the south's, then the north's.
    pub fn roots(&self) -> impl Iterator<Item = NodeId> + use<> {
        let top = self.top();
        let columns = self.row_of(top, 0, false).map_or(0, |row| self.columns_of(&row));
        (0..2).flat_map(move |n| (0..columns).filter_map(move |m| NodeId::new(m, n, top)))
    }

    /// The children of a node, those that there are: from the west, the southern row first.
    pub fn children(&self, node: NodeId) -> impl Iterator<Item = NodeId> + use<> {
        let lattice = *self;
        let cuts_rows = node.q() > self.rows_level;
        (0..if cuts_rows { 4 } else { 2u32 }).filter_map(move |index| {
            let q = node.q().checked_sub(1)?;
            let n = if cuts_rows { 2 * node.n() + (index >> 1) } else { node.n() };
            let is_as_wide = lattice.row_at(q, n)?.log_step == lattice.row(node).log_step;
            if is_as_wide && index & 1 == 1 {
                return None;
            }
            let m = if is_as_wide { node.m() } else { 2 * node.m() + (index & 1) };
            NodeId::new(m, n, q).filter(|child| lattice.contains(*child))
        })
    }

    /// The node of the next coarser level that has this one as a child; `None` for a root.
    #[must_use]
    pub fn parent(&self, node: NodeId) -> Option<NodeId> {
        let q = node.q() + 1;
        let n = if q > self.rows_level { node.n() / 2 } else { node.n() };
        if q > self.top() {
            return None;
        }
        let is_as_wide = self.row_at(q, n)?.log_step == self.row(node).log_step;
        NodeId::new(if is_as_wide { node.m() } else { node.m() / 2 }, n, q)
    }

    /// The nodes of the same level beside a node: one to the west and the east, none beyond a pole, one
    /// or two (of which the second may be missing at the seam) to the south and the north. A row
    /// beside it of which the level does not exist has those of the next coarser level, which do.
    pub fn neighbors(&self, node: NodeId, side: Side) -> impl Iterator<Item = NodeId> + use<> {
        let row = self.row(node);
        let columns = self.columns_of(&row);
        let (q, n, nodes) = match side {
            Side::West => (node.q(), node.n(), self.one((node.m() + columns - 1) % columns)),
            Side::East => (node.q(), node.n(), self.one((node.m() + 1) % columns)),
            Side::South | Side::North => self.across(node, row, side == Side::North),
        };
        nodes.filter_map(move |m| NodeId::new(m, n, q))
    }

    /// The nodes that touch a corner of a node from the row beside it: those at the ends of the edge
    /// across, and the ones beside them.
    #[must_use]
    pub fn across_corner(&self, node: NodeId, is_east: bool, is_north: bool) -> [Option<NodeId>; 2] {
        let side = if is_north { Side::North } else { Side::South };
        let beside =
            if is_east { self.neighbors(node, Side::East).next() } else { self.neighbors(node, Side::West).next() };
        let across = beside.and_then(|beside| {
            let mut nodes = self.neighbors(beside, side);
            let first = nodes.next();
            if is_east { first } else { nodes.last().or(first) }
        });
        [across, None]
    }

    const fn one(&self, m: u32) -> Range<u32> {
        m..m + 1
    }

    /// Level and number of the row of nodes to the north or the south, and its nodes along an edge.
    fn across(&self, node: NodeId, row: NodeRow, is_northwards: bool) -> (u8, u32, Range<u32>) {
        let q = node.q();
        let is_polewards = is_northwards == row.is_north;
        let (from_pole, is_north) = match (is_polewards, row.from_pole) {
            (true, 0) => return (q, 0, 0..0),
            (true, from_pole) => (from_pole - 1, row.is_north),
            (false, from_pole) if from_pole + 1 < self.rows_of(q, row.is_north) => (from_pole + 1, row.is_north),
            (false, _) => (self.rows_of(q, !row.is_north) - 1, !row.is_north),
        };
        // Rows beside each other differ by one level at most, and only where rows are not cut.
        let at = |q: u8| self.row_of(q, from_pole, is_north).map(|beside| (q, beside));
        let Some((level, beside)) = at(q).or_else(|| at(q + 1)) else { return (q, 0, 0..0) };
        let span = self.columns_spanned(node.m(), &row);
        let side = u64::from(self.cells) << beside.log_step;
        let nodes = (span.start / side) as u32..span.end.div_ceil(side) as u32;
        (level, self.number(level, from_pole, is_north), nodes)
    }

    /// Lattice columns of a node, clipped at the seam, where they end at W.
    fn columns_spanned(&self, m: u32, row: &NodeRow) -> Range<u64> {
        let side = u64::from(self.cells) << row.log_step;
        let end = (u64::from(m) + 1) * side;
        u64::from(m) * side..end.min(self.columns.into())
    }

    /// Lattice columns and rows of a node, clipped at the seam, where columns end at W, and at the
    /// middle.
    #[must_use]
    pub fn span(&self, node: NodeId) -> [Range<u64>; 2] {
        let posts = |k: u32| self.row_post(node, k);
        [self.columns_spanned(node.m(), &self.row(node)), posts(0)..posts(self.cells)]
    }

    /// From post to post of a node along longitude and latitude, as powers of two of the lattice's.
    #[must_use]
    pub fn log_steps(&self, node: NodeId) -> [u8; 2] {
        [self.row(node).log_step, self.log_rows(node.q())]
    }

    /// The lattice column of a node's post column `k`, 0 to the number of cells; canonical.
    #[must_use]
    pub fn column_post(&self, node: NodeId, k: u32) -> u64 {
        let row = self.row(node);
        let column = u64::from(node.m()) * (u64::from(self.cells) << row.log_step) + (u64::from(k) << row.log_step);
        if column >= self.columns.into() { 0 } else { column }
    }

    /// The lattice row of a node's post row `k`, from the south.
    #[must_use]
    pub fn row_post(&self, node: NodeId, k: u32) -> u64 {
        let row = self.row(node);
        let cells = u64::from(self.cells);
        let half = u64::from(self.half(row.is_north));
        let from_pole = if row.is_north { cells - u64::from(k) } else { u64::from(k) };
        let from_pole = ((u64::from(row.from_pole) * cells + from_pole) << self.log_rows(node.q())).min(half);
        if row.is_north { u64::from(self.rows) - from_pole } else { from_pole }
    }

    /// The one name of a lattice point: columns go around, and a pole is one point.
    #[must_use]
    pub fn canonical(&self, [column, row]: [u64; 2]) -> [u64; 2] {
        let is_pole = row == 0 || row >= self.rows.into();
        [if is_pole { 0 } else { column % u64::from(self.columns) }, row.min(self.rows.into())]
    }

    /// The node of a level at a lattice place, or of the finest level that there is.
    #[must_use]
    pub fn node_at(&self, at: DVec2, q: u8) -> Option<NodeId> {
        let is_north = at.y >= f64::from(self.middle());
        let from_pole = if is_north { f64::from(self.rows) - at.y } else { at.y };
        (q..=self.top()).find_map(|q| {
            let side = f64::from(self.cells) * f64::from(1u32 << self.log_rows(q));
            let from_pole = ((from_pole / side) as u32).min(self.rows_of(q, is_north) - 1);
            let row = self.row_of(q, from_pole, is_north)?;
            let width = (u64::from(self.cells) << row.log_step) as f64;
            let m = ((at.x / width) as u32).min(self.columns_of(&row) - 1);
            NodeId::new(m, self.number(q, from_pole, is_north), q)
        })
    }

    /// The lattice columns and rows of a node's posts. Columns end at W, not at its other name 0.
    #[must_use]
    pub fn post_lines(&self, node: NodeId) -> [PostLine; 2] {
        let row = self.row(node);
        let (cells, log_rows) = (i64::from(self.cells), self.log_rows(node.q()));
        let side = cells << row.log_step;
        let columns = PostLine::new(i64::from(node.m()) * side, row.log_step, self.cells, [0, self.columns.into()]);
        let (rows, middle) = (i64::from(self.rows), i64::from(self.middle()));
        let from_pole = i64::from(row.from_pole) * (cells << log_rows);
        let rows = match row.is_north {
            true => PostLine::new(rows - from_pole - (cells << log_rows), log_rows, self.cells, [middle, rows]),
            false => PostLine::new(from_pole, log_rows, self.cells, [0, middle]),
        };
        [columns, rows]
    }

    /// The lattice rows of the south and the north edge of a node, where the nodes beside have every
    /// second column of this one; `None` where they have the same columns.
    #[must_use]
    pub fn joined_rows(&self, node: NodeId) -> [Option<u64>; 2] {
        let row = self.row(node);
        [(false, 0), (true, self.cells)].map(|(is_north, post)| {
            let (q, n, nodes) = self.across(node, row, is_north);
            let beside = self.row_at(q, n).filter(|_| q == node.q() && !nodes.is_empty())?;
            (beside.log_step > row.log_step).then(|| self.row_post(node, post))
        })
    }
}
