//! Worlds that are whole bodies: where their lattice lies.

use super::{WorldError, WorldFields};
use crate::node::NodeId;
use crate::surface::globe::{Ellipsoid, Globe, GlobeLattice};
use serde::{Deserialize, Serialize};

/// Where the lattice of a body lies on its ellipsoid. Rows 0 and H (the extent's second number) are
/// the poles; row `j` between them lies at latitude `first_row_deg + (j - 1)·row_step_deg`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BodyGrid {
    /// Semi-major axis of the ellipsoid, metres.
    pub semi_major_m: f64,
    /// Its flattening; 0 of a sphere.
    pub flattening: f64,
    /// Longitude of column 0, degrees east.
    pub west_deg: f64,
    /// Latitude of row 1, degrees north.
    pub first_row_deg: f64,
    /// From row to row, degrees.
    pub row_step_deg: f64,
}

/// More nodes than this across a level have no ids.
const MOST_COLUMNS: u32 = 1 << 28;
/// How far `lattice_unit_m` may be from what the grid makes it, relatively.
const UNIT_TOLERANCE: f64 = 1e-9;

/// The globe of a body's fields.
pub(super) fn globe_of(f: &WorldFields, grid: &BodyGrid) -> Result<Globe, WorldError> {
    let fail = |field, found, expected| Err(WorldError::OutOfRange { field, found, expected });
    if !(grid.semi_major_m.is_finite() && (1.0..1e9).contains(&grid.semi_major_m)) {
        return fail("body.semi_major_m", grid.semi_major_m, "a length from 1 m to a million km");
    }
    if !(0.0..0.5).contains(&grid.flattening) {
        return fail("body.flattening", grid.flattening, "0 or more, below 0.5");
    }
    if !(-360.0..=360.0).contains(&grid.west_deg) {
        return fail("body.west_deg", grid.west_deg, "a longitude from -360 to 360");
    }
    if !(grid.row_step_deg > 0.0 && grid.row_step_deg < 180.0) {
        return fail("body.row_step_deg", grid.row_step_deg, "an angle above 0, below 180");
    }
    let [columns, rows] = f.extent;
    if columns > MOST_COLUMNS {
        return fail("extent", f64::from(columns), "at most 2^28 columns around a body");
    }
    let Some(lattice) = GlobeLattice::new(columns, rows, f.elevation_tile) else {
        return fail(
            "extent",
            f64::from(columns),
            "columns around a body for at least two nodes at the poles, and two rows or more",
        );
    };
    let body = Ellipsoid::new(grid.semi_major_m, grid.flattening);
    let rows_rad = [grid.first_row_deg, grid.row_step_deg].map(f64::to_radians);
    let Some(globe) = Globe::new(body, lattice, grid.west_deg.to_radians(), rows_rad) else {
        return fail("body.first_row_deg", grid.first_row_deg, "a latitude that puts all rows between the poles");
    };
    if f.origin != [grid.west_deg, -90.0] {
        return fail("origin", f.origin[0], "the longitude of column 0 of the body, and -90");
    }
    if f.levels != lattice.top() + 1 {
        return fail("levels", f64::from(f.levels), "the levels that the body's lattice has");
    }
    if f.finest_elevation_level != 0 {
        return fail("finest_elevation_level", f64::from(f.finest_elevation_level), "0, because it is a body");
    }
    if f.finest_color_level < lattice.rows_level() {
        return fail("finest_color_level", f64::from(f.finest_color_level), "a level that cuts rows of the body");
    }
    if (f.lattice_unit_m / globe.unit_m() - 1.0).abs() > UNIT_TOLERANCE {
        return fail("lattice_unit_m", f.lattice_unit_m, "the step of the body's rows at the finest level");
    }
    Ok(globe)
}

/// The most columns that a row of a level has, and numbers of rows.
pub(super) fn nodes_at(lattice: &GlobeLattice, q: u8) -> [u32; 2] {
    let log_rows = q.saturating_sub(lattice.rows_level()).min(lattice.rows_level());
    let columns = u64::from(lattice.size()[0]).div_ceil(u64::from(lattice.cells()) << log_rows);
    [columns as u32, 2 << (lattice.rows_level() - log_rows)]
}

/// Number of nodes of a row; none where it does not exist.
pub(super) fn columns_of_row(lattice: &GlobeLattice, q: u8, n: u32) -> u32 {
    let Some(first) = NodeId::new(0, n, q).filter(|node| lattice.contains(*node)) else { return 0 };
    let [log_columns, _] = lattice.log_steps(first);
    u64::from(lattice.size()[0]).div_ceil(u64::from(lattice.cells()) << log_columns) as u32
}
