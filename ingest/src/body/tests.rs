//! Made-up bodies.

use super::base::Base;
use super::grid::Grid;
use super::posts::Posts;
use crate::sample::elevation::quantized;
use crate::store::{Level, Rect};
use crate::work::Work;
use std::collections::HashMap;
use terravision_common::node::NodeId;
use terravision_common::surface::globe::GlobeLattice;
use terravision_common::world::{BodyGrid, World, WorldFields};

/// A moon of these columns and rows, of nodes of this many cells.
pub(super) fn world([columns, rows]: [u32; 2], cells: u32) -> World {
    let lattice = GlobeLattice::new(columns, rows, cells).unwrap();
    let row_step_deg = 180.0 / f64::from(rows - 1);
    let semi_major_m = 1_737_400.0;
    let unit = semi_major_m * f64::to_radians(row_step_deg) / f64::from(1u32 << lattice.rows_level());
    World::new(WorldFields {
        origin: [0.0, -90.0],
        lattice_unit_m: unit,
        extent: [columns, rows],
        elevation_tile: cells,
        color_tile: 16,
        levels: lattice.top() + 1,
        finest_elevation_level: 0,
        finest_color_level: lattice.rows_level(),
        body: Some(BodyGrid {
            semi_major_m,
            flattening: 0.0,
            west_deg: 0.0,
            first_row_deg: -90.0 + 0.5 * row_step_deg,
            row_step_deg,
        }),
    })
    .unwrap()
}

fn sample(column: u64, row: u64) -> f32 {
    let hash = (column as u32).wrapping_mul(0x9e37_79b9) ^ (row as u32).wrapping_mul(0x85eb_ca6b);
    quantized((hash.wrapping_mul(0xc2b2_ae35) >> 16) as f32 / 64.0)
}

fn rough(grid: &Grid) -> Level<f32> {
    let [columns, last] = [u64::from(grid.columns()), u64::from(grid.rows())];
    let level = Level::create(&std::env::temp_dir(), [columns, last + 1]).unwrap();
    for row in 0..=last {
        let at = |column: u64| if row == 0 || row == last { 12.5 } else { sample(column, row) };
        let line: Vec<f32> = (0..columns).map(at).collect();
        level.write(Rect::new([0, row as i64], [line.len(), 1]), &line).unwrap();
    }
    level
}

/// Heights of a node's posts by their lattice points.
fn posts_of(posts: &Posts<'_>, node: NodeId) -> Vec<([u64; 2], f32)> {
    let lattice = posts.grid().lattice();
    let mut all = Vec::new();
    for l in 0..=lattice.cells() {
        let row = lattice.row_post(node, l);
        let line = posts.line(node.q(), row).unwrap();
        for k in 0..=lattice.cells() {
            let column = lattice.column_post(node, k);
            all.push((lattice.canonical([column, row]), line.at(column)));
        }
    }
    all
}

#[test]
fn nodes_of_a_level_agree_on_every_post_that_they_share() {
    for size in [[256, 129], [180, 90], [101, 60]] {
        let grid = Grid::of(world(size, 8)).unwrap();
        let (folder, work) = (std::env::temp_dir(), Work::quiet(2));
        let base = Base::of(grid, rough(&grid), &folder, &work).unwrap();
        let posts = Posts::of(&base, &folder, &work).unwrap();
        for q in 0..grid.world.levels() {
            let mut seen: HashMap<[u64; 2], f32> = HashMap::new();
            for first in grid.node_rows(q) {
                for m in 0..grid.world.columns_of_row(q, first.n()) {
                    for (point, height) in posts_of(&posts, NodeId::new(m, first.n(), q).unwrap()) {
                        let other = *seen.entry(point).or_insert(height);
                        assert_eq!(other.to_bits(), height.to_bits(), "level {q}, point {point:?} of {size:?}");
                    }
                }
            }
        }
    }
}

#[test]
fn the_finest_nodes_have_the_samples() {
    let grid = Grid::of(world([180, 91], 8)).unwrap();
    let (folder, work) = (std::env::temp_dir(), Work::quiet(2));
    let base = Base::of(grid, rough(&grid), &folder, &work).unwrap();
    let posts = Posts::of(&base, &folder, &work).unwrap();
    let mut seen = 0;
    for q in 0..grid.world.levels() {
        for first in grid.node_rows(q) {
            for m in 0..grid.world.columns_of_row(q, first.n()) {
                let node = NodeId::new(m, first.n(), q).unwrap();
                if grid.world.children(node).next().is_some() {
                    continue;
                }
                for ([column, row], height) in posts_of(&posts, node) {
                    let is_pole = row == 0 || row == 91;
                    assert_eq!(height, if is_pole { 12.5 } else { sample(column, row) }, "{node}");
                    seen += 1;
                }
            }
        }
    }
    assert!(seen > 180 * 91);
}

#[test]
fn coarser_levels_are_smooth_across_the_seam_and_the_poles() {
    // A tilted wave on the sphere, which no filter of a few posts changes much.
    let grid = Grid::of(world([256, 129], 8)).unwrap();
    let height = |column: u64, row: u64| {
        let place = grid.globe.place([column, row], 0.0);
        let up = terravision_common::surface::globe::Ellipsoid::up(place);
        (1000.0 * (up.x + 0.5 * up.y + 2.0 * up.z)) as f32
    };
    let level = Level::create(&std::env::temp_dir(), [256, 130]).unwrap();
    for row in 0..130u64 {
        let line: Vec<f32> = (0..256).map(|column| height(column, row)).collect();
        level.write(Rect::new([0, row as i64], [256, 1]), &line).unwrap();
    }
    let (folder, work) = (std::env::temp_dir(), Work::quiet(2));
    let base = Base::of(grid, level, &folder, &work).unwrap();
    let posts = Posts::of(&base, &folder, &work).unwrap();
    for q in 0..grid.world.levels() - 2 {
        for row in grid.post_rows(q) {
            let line = posts.line(q, row).unwrap();
            let step = 1u64 << grid.log_columns(q, row);
            for column in (0..256).step_by(step as usize) {
                let error = (line.at(column) - height(column, row)).abs();
                assert!(error < 40.0, "level {q}, row {row}, column {column}: {error} m of 2000");
            }
        }
    }
}
