//! Nodes of a body: places in them, their posts, their order from near to far.

use super::{Geodetic, Globe, GlobeBounds};
use crate::node::NodeId;
use crate::surface::{Column, PostLine, Row};
use glam::{DVec2, DVec3};
use std::f64::consts::TAU;

/// Positions and nodes. A foot is longitude and latitude, degrees; a position has the height above the
/// ellipsoid behind them, metres.
impl Globe {
    /// The lattice place of a foot: columns from column 0, within 0 to W, and rows from the south pole.
    #[must_use]
    pub fn lattice_of_foot(&self, foot: DVec2) -> DVec2 {
        let [columns, rows] = self.lattice.size();
        let turns = (foot.x.to_radians() - self.west) / TAU;
        let column = (turns - turns.floor()) * f64::from(columns);
        let latitude = foot.y.to_radians();
        let last = f64::from(rows - 1);
        // Rows are evenly apart but for those of the poles.
        let row = 1.0 + (latitude - self.first_row) / self.row_step;
        let row = if row < 1.0 {
            let south = self.latitude(0);
            (latitude - south) / (self.first_row - south)
        } else if row > last {
            let at = self.latitude(u64::from(rows - 1));
            last + (latitude - at) / (self.latitude(rows.into()) - at)
        } else {
            row
        };
        DVec2::new(column, row.clamp(0.0, rows.into()))
    }

    /// The node of a level that contains a foot; where there is none as fine, the finest.
    #[must_use]
    pub fn node_at(&self, foot: DVec2, q: u8) -> Option<NodeId> {
        self.lattice.node_at(self.lattice_of_foot(foot), q)
    }

    /// The foot at a share of a node's sides from its corner, and the area of all of the node were it as
    /// it is there, square metres.
    #[must_use]
    pub fn foot_in_node(&self, node: NodeId, share: DVec2) -> Option<(DVec2, f64)> {
        let [columns, rows] = self.lattice.span(node);
        let between = |a: f64, b: f64, share: f64| a + share * (b - a);
        let [west, east] = [columns.start, columns.end].map(|column| self.longitude(column));
        let [south, north] = [rows.start, rows.end].map(|row| self.latitude(row));
        let latitude = between(south, north, share.y);
        let sides =
            [self.body.meridian(latitude)[0] * (east - west), self.body.meridional_m(latitude) * (north - south)];
        let foot = DVec2::new(between(west, east, share.x), latitude);
        Some((DVec2::new(foot.x.to_degrees(), foot.y.to_degrees()), sides[0] * sides[1]))
    }

    /// The position of a foot in the tile of a node that contains it, in cells from its corner.
    #[must_use]
    pub fn place_in_node(&self, foot: DVec2, node: NodeId) -> DVec2 {
        let at = self.lattice_of_foot(foot);
        let [columns, rows] = self.lattice.post_lines(node);
        // A foot on the seam is at both ends of a row.
        let width = f64::from(self.lattice.size()[0]);
        let column = if at.x == 0.0 && columns.end() as f64 >= width { width } else { at.x };
        DVec2::new(columns.place(column), rows.place(at.y))
    }

    /// The term that the vertices of a column share.
    #[must_use]
    pub fn column(&self, column: u64) -> Column {
        let (sin, cos) = self.longitude(column % u64::from(self.lattice.size()[0])).sin_cos();
        Column { x: cos, y: sin }
    }

    /// The term that the vertices of a row share.
    #[must_use]
    pub fn row(&self, row: u64) -> Row {
        let latitude = self.latitude(row);
        let [from_axis, z] = self.body.meridian(latitude);
        let (sin, cos) = latitude.sin_cos();
        // A pole is on the axis.
        if row == 0 || row >= u64::from(self.lattice.size()[1]) {
            return Row { x: 0.0, y: z, from_axis: 0.0, along: sin };
        }
        Row { x: from_axis, y: z, from_axis: cos, along: sin }
    }

    /// Children of a node, nearest to an eye (degrees and metres) first: their numbers among all.
    #[must_use]
    pub fn near_to_far(&self, children: impl Iterator<Item = NodeId>, eye: DVec3, out: &mut [u8]) -> usize {
        let eye = self.body.position(Geodetic::of_degrees(eye));
        let mut apart = [f64::INFINITY; crate::surface::MOST_CHILDREN];
        let mut count = 0;
        for (child, (out, apart)) in children.zip(out.iter_mut().zip(&mut apart)) {
            *apart = (GlobeBounds::new(self, child, [0.0; 2]).middle() - eye).length_squared();
            *out = count as u8;
            count += 1;
        }
        out[..count].sort_by(|a, b| apart[usize::from(*a)].total_cmp(&apart[usize::from(*b)]));
        count
    }

    /// The lattice columns and rows of a node's posts.
    #[must_use]
    pub fn post_lines(&self, node: NodeId) -> [PostLine; 2] {
        self.lattice.post_lines(node)
    }

    /// The unit normal of ground at a foot in the tile of a node, where it rises by this much over a
    /// cell of the tile, metres east and north: east, north and up in the local frame of the foot.
    #[must_use]
    pub fn normal(&self, foot: DVec2, node: NodeId, [per_east, per_north]: [f64; 2]) -> DVec3 {
        let latitude = foot.y.to_radians();
        let [log_columns, log_rows] = self.lattice.log_steps(node);
        let columns = f64::from(self.lattice.size()[0]);
        let [from_axis, _] = self.body.meridian(latitude);
        let east_m = from_axis * TAU / columns * f64::from(1u32 << log_columns);
        let north_m = self.body.meridional_m(latitude) * self.row_step * f64::from(1u32 << log_rows);
        // At a pole no column is beside another one.
        let east = if east_m > 1e-6 { -per_east / east_m } else { 0.0 };
        DVec3::new(east, -per_north / north_m, 1.0).normalize()
    }
}
