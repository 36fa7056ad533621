//! The finest heights and colours of a database, whole, as the reference renderer wants them.

use anyhow::{Context, ensure};
use glam::DVec2;
use std::ops::Range;
use terravision_common::database::{Database, TileError, TileScratch, TileSource, color_tile_bytes};
use terravision_common::node::NodeId;
use terravision_common::surface::CrsFrame;
use terravision_common::surface::tile::node_ground;
use terravision_common::validity::Validity;
use terravision_common::world::{COLOR_BORDER, World};
use terravision_testkit::reference::{Colors, Heights, Picture, Scene};

/// Heights and colours, in world coordinates.
#[derive(Debug)]
pub(super) struct Truth {
    pub(super) heights: Heights,
    colors: Colors,
    /// Whether there is ground at each post; empty for a world without holes.
    is_ground: Vec<bool>,
    frame: CrsFrame,
}

/// Bytes that a post and a texel need here: with the pyramids above them, and what the reader keeps.
const POST_BYTES: u64 = 11;
const TEXEL_BYTES: u64 = 7;

impl Truth {
    /// Reads the finest level of both layers; where a sparse world does not have it, the finest that
    /// it has.
    ///
    /// # Errors
    /// When that needs more than `most_bytes`, or a tile cannot be read.
    pub(super) fn read(database: &Database, most_bytes: u64) -> anyhow::Result<Self> {
        let world = database.world();
        let grid = Grid::of_posts(world);
        let texels = Grid::of_texels(world);
        let bytes = grid.count() * POST_BYTES + texels.count() * TEXEL_BYTES;
        ensure!(
            bytes <= most_bytes,
            "the finest level of {} takes {} MiB in memory, and pictures are compared with all of it: expected at most {} MiB; \
             give more (--memory-mib), or measure a part of the world (terravision ingest --bounds)",
            database.path().display(),
            bytes >> 20,
            most_bytes >> 20,
        );
        let (heights, is_ground) = read_heights(database, &grid).context("cannot read the heights")?;
        let rgb = read_colors(database, &texels).context("cannot read the colours")?;
        Ok(Self {
            heights: Heights::new(grid.columns, grid.rows, [0.0; 2], grid.step_m, heights),
            colors: Colors::new(texels.columns, texels.rows, [0.0; 2], texels.step_m, rgb),
            is_ground,
            frame: world.crs_frame(),
        })
    }

    /// What the reference renderer looks at.
    #[must_use]
    pub(super) fn scene(&self) -> Scene<'_> {
        Scene { heights: &self.heights, colors: &self.colors }
    }

    /// Where the world lies in its CRS.
    #[must_use]
    pub(super) fn frame(&self) -> CrsFrame {
        self.frame
    }

    /// The reference's picture, in which a pixel that sees a place without ground is no land: the
    /// reference knows no holes.
    #[must_use]
    pub(super) fn masked(&self, mut picture: Picture) -> Picture {
        if !self.is_ground.is_empty() {
            for (is_land, [x, y, _]) in picture.is_land.iter_mut().zip(&picture.ground) {
                *is_land = *is_land && self.is_ground_around(DVec2::new(*x, *y));
            }
        }
        picture
    }

    fn is_ground_around(&self, foot: DVec2) -> bool {
        let [columns, rows] = self.heights.cells();
        let at = foot / self.heights.spacing_m();
        let (i, j) = ((at.x as usize).min(columns - 1), (at.y as usize).min(rows - 1));
        let stride = columns + 1;
        [j * stride + i, (j + 1) * stride + i].into_iter().all(|k| self.is_ground[k] && self.is_ground[k + 1])
    }
}

/// Points of the finest level of a layer, row 0 in the south.
struct Grid {
    columns: usize,
    rows: usize,
    step_m: f64,
    level: u8,
    /// Points along a node's side, but for the posts that it shares with the next one.
    side: usize,
}

impl Grid {
    /// Posts, up to the last whole cell.
    fn of_posts(world: &World) -> Self {
        let level = world.finest_elevation_level();
        let [columns, rows] = world.extent().map(|units| (units >> level) as usize + 1);
        Self { columns, rows, step_m: world.plane().spacing_m(level), level, side: world.elevation_tile() as usize }
    }

    /// Texels, up to the one that holds the border.
    fn of_texels(world: &World) -> Self {
        let level = world.finest_color_level();
        let step_m = world.plane().node_side_m(level) / f64::from(world.color_tile());
        let [columns, rows] = world.plane().end().to_array().map(|end| (end / step_m - 1e-6).ceil().max(1.0) as usize);
        Self { columns, rows, step_m, level, side: world.color_tile() as usize }
    }

    fn count(&self) -> u64 {
        self.columns as u64 * self.rows as u64
    }

    /// Every node that has points of the grid, with the columns and rows that are read of it. The last
    /// post of a row or column may be one of the node before it alone.
    fn nodes(&self) -> impl Iterator<Item = (NodeId, Range<usize>, Range<usize>)> {
        let Self { columns, rows, level, side, .. } = *self;
        let along =
            move |points: usize| (0..points.div_ceil(side)).map(move |n| n * side..((n + 1) * side).min(points));
        along(rows).flat_map(move |rows| {
            along(columns).filter_map(move |columns| {
                let [m, n] = [columns.start, rows.start].map(|at| (at / side) as u32);
                Some((NodeId::new(m, n, level)?, columns, rows.clone()))
            })
        })
    }
}

/// Reads the tile of a node, or of the finest ancestor that has one.
fn finest(
    world: &World,
    mut node: NodeId,
    mut read: impl FnMut(NodeId) -> Result<(), TileError>,
) -> Result<NodeId, TileError> {
    loop {
        match read(node) {
            Ok(()) => return Ok(node),
            Err(TileError::Missing { .. }) if node.q() < world.complete_level() => node = node.parent(),
            Err(error) => return Err(error),
        }
    }
}

fn read_heights(database: &Database, grid: &Grid) -> Result<(Vec<f32>, Vec<bool>), TileError> {
    let world = database.world();
    let mut scratch = TileScratch::default();
    let mut values = vec![0f32; world.elevation_values()];
    let mut heights = vec![0f32; grid.columns * grid.rows];
    let mut is_ground = vec![true; if world.has_holes() { heights.len() } else { 0 }];
    // Posts of the last column and row belong to nodes before them.
    let last = |at: usize, points: usize| at.min(points.saturating_sub(2)) / grid.side * grid.side;
    for (node, columns, rows) in grid.nodes() {
        let origin = [last(columns.start, grid.columns), last(rows.start, grid.rows)];
        let [m, n] = origin.map(|at| (at / grid.side) as u32);
        let node = NodeId::new(m, n, node.q()).unwrap_or(node);
        let found = finest(world, node, |node| database.read_elevation(node, &mut values, &mut scratch))?;
        for j in rows {
            for i in columns.clone() {
                let foot = DVec2::new(i as f64, j as f64) * grid.step_m;
                let ground = node_ground(world.surface(), found, &values, foot);
                heights[j * grid.columns + i] = ground.height_m as f32;
                if let Some(is_ground) = is_ground.get_mut(j * grid.columns + i) {
                    *is_ground = ground.validity != Validity::Hole;
                }
            }
        }
    }
    Ok((heights, is_ground))
}

fn read_colors(database: &Database, grid: &Grid) -> Result<Vec<[u8; 3]>, TileError> {
    let world = database.world();
    let mut scratch = TileScratch::default();
    let mut texels = vec![0u8; color_tile_bytes(world)];
    let mut rgb = vec![[0u8; 3]; grid.columns * grid.rows];
    let (stored, border) = (world.color_stored() as usize, COLOR_BORDER as usize);
    for (node, columns, rows) in grid.nodes() {
        let found = finest(world, node, |node| database.read_color(node, &mut texels, &mut scratch))?;
        let coarser = found.q() - node.q();
        let origin = [found.m(), found.n()].map(|n| n as usize * grid.side);
        for j in rows {
            let south = (j >> coarser) - origin[1];
            let row = (border + grid.side - 1 - south) * stored + border;
            for i in columns.clone() {
                let at = 4 * (row + (i >> coarser) - origin[0]);
                rgb[j * grid.columns + i] = [texels[at], texels[at + 1], texels[at + 2]];
            }
        }
    }
    Ok(rgb)
}
