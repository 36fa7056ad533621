//! The lattice of a body as ingest needs it: which posts each level has, and how fine they are.

use terravision_common::node::NodeId;
use terravision_common::surface::globe::{Globe, GlobeLattice};
use terravision_common::world::World;

/// A body's world and its lattice.
#[derive(Debug, Clone, Copy)]
pub(super) struct Grid {
    pub(super) world: World,
    pub(super) globe: Globe,
}

impl Grid {
    /// Of a world that is a body.
    pub(super) fn of(world: World) -> Option<Self> {
        world.globe().copied().map(|globe| Self { world, globe })
    }

    pub(super) fn lattice(&self) -> &GlobeLattice {
        self.globe.lattice()
    }

    /// Lattice columns around.
    pub(super) fn columns(&self) -> u32 {
        self.lattice().size()[0]
    }

    /// Number of the north pole's row.
    pub(super) fn rows(&self) -> u32 {
        self.lattice().size()[1]
    }

    /// Where the hemispheres meet.
    pub(super) fn middle(&self) -> u64 {
        u64::from(self.rows() / 2)
    }

    /// How often rows are halved at a level.
    pub(super) fn log_rows(&self, q: u8) -> u8 {
        q.saturating_sub(self.lattice().rows_level())
    }

    /// The first node of each row of a level that exists.
    pub(super) fn node_rows(&self, q: u8) -> impl Iterator<Item = NodeId> + use<> {
        let lattice = *self.lattice();
        let rows = 0..self.world.nodes_at(q)[1];
        rows.filter_map(move |n| NodeId::new(0, n, q).filter(|node| lattice.contains(*node)))
    }

    /// Rows of nodes that have a lattice row, counted from the pole, and their numbers; whether they
    /// exist or not.
    fn touching(&self, q: u8, row: u64) -> impl Iterator<Item = (u32, u32)> + use<> {
        let side = u64::from(self.lattice().cells()) << self.log_rows(q);
        let numbers = self.world.nodes_at(q)[1];
        let south = (row <= self.middle()).then_some((row, self.middle(), false));
        let from_north = u64::from(self.rows()) - row;
        let north = (row >= self.middle()).then(|| (from_north, u64::from(self.rows()) - self.middle(), true));
        [south, north].into_iter().flatten().flat_map(move |(from_pole, half, is_north)| {
            let last = half.div_ceil(side).saturating_sub(1);
            let own = (from_pole / side).min(last);
            let before = (from_pole % side == 0).then(|| (from_pole / side).checked_sub(1)).flatten();
            let number = move |r: u64| (r as u32, if is_north { numbers - 1 - r as u32 } else { r as u32 });
            [Some(own), before.filter(|r| *r <= last)].into_iter().flatten().map(number)
        })
    }

    /// Whether a level has the source's samples in a lattice row: it is the finest of a row of nodes
    /// that has it, or finer.
    pub(super) fn is_exact(&self, q: u8, row: u64) -> bool {
        let is_finest =
            |(from_pole, _): (u32, u32)| u32::from(q) <= (from_pole + 1).next_power_of_two().trailing_zeros();
        q == 0 || (q <= self.lattice().rows_level() && self.touching(q, row).any(is_finest))
    }

    /// How far apart the posts of a level are in a lattice row, as a power of two of columns: as its
    /// finest row of nodes has them.
    pub(super) fn log_columns(&self, q: u8, row: u64) -> u8 {
        if self.is_exact(q, row) {
            return 0;
        }
        let steps = self.touching(q, row).filter_map(|(_, n)| {
            let node = NodeId::new(0, n, q).filter(|node| self.lattice().contains(*node))?;
            Some(self.lattice().log_steps(node)[0])
        });
        steps.min().unwrap_or(0)
    }

    /// The lattice rows in which a level has posts, from the south.
    pub(super) fn post_rows(&self, q: u8) -> Vec<u64> {
        let cells = self.lattice().cells();
        let posts = |node: NodeId| (0..=cells).map(move |k| (node, k));
        let mut rows: Vec<u64> =
            self.node_rows(q).flat_map(posts).map(|(node, k)| self.lattice().row_post(node, k)).collect();
        rows.sort_unstable();
        rows.dedup();
        rows
    }

    /// From row to row, radians.
    fn row_step(&self) -> f64 {
        self.world.fields().body.map_or(0.0, |grid| grid.row_step_deg.to_radians())
    }

    /// How many times as wide, in columns, as it is high, in rows, a square on the ground is: more
    /// towards the poles.
    pub(super) fn columns_per_row(&self, row: u64) -> f64 {
        self.columns_per_row_at(row as f64)
    }

    /// The same between rows.
    pub(super) fn columns_per_row_at(&self, row: f64) -> f64 {
        let step = std::f64::consts::TAU / f64::from(self.columns());
        self.row_step() / (step * self.latitude_at(row).cos().max(1e-9))
    }

    /// Latitude of a place between rows, radians.
    pub(super) fn latitude_at(&self, row: f64) -> f64 {
        let row = row.clamp(0.0, f64::from(self.rows()));
        let (before, share) = (row.floor(), row - row.floor());
        let south = self.globe.latitude(before as u64);
        south + share * (self.globe.latitude(before as u64 + 1) - south)
    }

    /// The lattice row of the south edge of a node's nominal square, which may lie beyond the middle.
    pub(super) fn nominal_south(&self, node: NodeId) -> f64 {
        let side = (u64::from(self.lattice().cells()) << self.log_rows(node.q())) as f64;
        let numbers = self.world.nodes_at(node.q())[1];
        match node.n() < numbers / 2 {
            true => f64::from(node.n()) * side,
            false => f64::from(self.rows()) - f64::from(numbers - node.n()) * side,
        }
    }
}

/// The rows of a level whose rows are halved `log` times: multiples of a step from each pole, and the
/// row where the hemispheres meet.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rows {
    rows: u64,
    middle: u64,
    log: u8,
}

impl Rows {
    pub(super) fn new(grid: &Grid, log: u8) -> Self {
        Self { rows: u64::from(grid.rows()), middle: grid.middle(), log }
    }

    /// Rows before the middle, and behind it.
    fn halves(self) -> [u64; 2] {
        [self.middle, self.rows - self.middle].map(|half| half.div_ceil(1 << self.log))
    }

    pub(super) fn count(self) -> u64 {
        let [south, north] = self.halves();
        south + 1 + north
    }

    /// The lattice row of an index.
    pub(super) fn row(self, index: u64) -> u64 {
        let [south, _] = self.halves();
        match index {
            index if index < south => index << self.log,
            index if index == south => self.middle,
            index => self.rows - ((self.count() - 1 - index) << self.log),
        }
    }

    /// The indices before and after a lattice row, and its share of the way between them.
    pub(super) fn around(self, row: u64) -> (u64, u64, f32) {
        let [south, _] = self.halves();
        let before = match row {
            row if row < self.middle => row >> self.log,
            row if row == self.middle => south,
            row => (self.count() - 1) - (self.rows - row).div_ceil(1 << self.log).min(self.count() - 1 - south),
        };
        let at = self.row(before);
        if at == row {
            return (before, before, 0.0);
        }
        let end = self.row(before + 1);
        (before, before + 1, (row - at) as f32 / (end - at) as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::tests::world;

    #[test]
    fn rows_are_found_again() {
        for size in [[256u32, 129u32], [200, 100], [300, 151]] {
            let grid = Grid::of(world(size, 8)).unwrap();
            for log in 0..4 {
                let rows = Rows::new(&grid, log);
                let all: Vec<u64> = (0..rows.count()).map(|index| rows.row(index)).collect();
                assert!(all.windows(2).all(|pair| pair[0] < pair[1]), "{all:?}");
                assert_eq!((all[0], all[all.len() - 1]), (0, u64::from(grid.rows())));
                for row in 0..=u64::from(grid.rows()) {
                    let (before, after, share) = rows.around(row);
                    let at = rows.row(before) as f32 + share * (rows.row(after) - rows.row(before)) as f32;
                    assert!((at - row as f32).abs() < 1e-3 && (0.0..1.0).contains(&share));
                }
            }
            let q0 = grid.lattice().rows_level();
            for q in q0..=grid.lattice().top() {
                let rows = Rows::new(&grid, q - q0);
                let known: Vec<u64> = (0..rows.count()).map(|index| rows.row(index)).collect();
                assert_eq!(grid.post_rows(q), known, "level {q} of {size:?}");
            }
        }
    }

    #[test]
    fn the_finest_level_of_every_row_of_nodes_is_exact() {
        let grid = Grid::of(world([256, 129], 8)).unwrap();
        let lattice = grid.lattice();
        for q in 0..=lattice.top() {
            for node in grid.node_rows(q) {
                let is_finest = lattice.children(node).next().is_none();
                for k in 0..=lattice.cells() {
                    let row = lattice.row_post(node, k);
                    assert!(!is_finest || grid.is_exact(q, row), "node {node}, row {row}");
                    assert!(grid.log_columns(q, row) <= lattice.log_steps(node)[0]);
                }
                // Rows of its own are not, unless it is.
                let inner = lattice.row_post(node, lattice.cells() / 2);
                assert!(is_finest || !grid.is_exact(q, inner), "node {node}");
            }
        }
    }
}
