//! Block culling: the part of a colour leaf's block that is seen.
//!
//! The generator culls by node; at the border of the picture most of a node may be outside, and ground behind a ridge is
//! hidden. Here every vertex is known, so rows and columns of facets of which all vertices are outside of one frustum plane,
//! or which lie below the [`horizon`](crate::horizon), are not drawn at all. What is culled would not have produced a
//! pixel.

use crate::horizon::Horizon;
use glam::Vec3;
use terravision_common::camera::Camera;
use terravision_common::node::NodeId;
use terravision_common::slot::TileSlot;
use terravision_common::surface::{EyeFrame, Vertices};
use terravision_common::validity::GROUND_PLANE;
use terravision_common::world::World;

/// A vertex counts as inside of a plane when it is outside by less than this share of its distance from the eye, plus
/// a millimetre: the renderer works in single precision, and so does this.
const MARGIN: f32 = 1e-4;
const MARGIN_M: f32 = 1e-3;
const PLANES: usize = 5;

/// Culls blocks; keeps its buffers.
#[derive(Debug)]
pub struct BlockCulling {
    world: World,
    posts: usize,
    normals: [Vec3; PLANES],
    /// Of the frame's camera.
    frame: Option<EyeFrame>,
    /// Columns and rows of the entered leaf from the eye.
    columns: Vec<f32>,
    rows: Vec<f32>,
    /// A bit per plane that the vertex is outside of; as wide as a coordinate, for SIMD.
    outside: Vec<u32>,
    horizon: Horizon,
    /// Whether anything of the entered leaf is seen.
    is_seen: bool,
}

impl BlockCulling {
    /// Buffers for leaves of a world.
    #[must_use]
    pub fn new(world: &World) -> Self {
        let posts = world.elevation_posts() as usize;
        Self {
            world: *world,
            posts,
            normals: [Vec3::ZERO; PLANES],
            frame: None,
            columns: vec![0.0; posts],
            rows: vec![0.0; posts],
            outside: vec![0; posts * posts],
            horizon: Horizon::new(world),
            is_seen: false,
        }
    }

    /// Takes the frustum of a frame's camera; `ground_m` is the height of the ground under the eye, of any level.
    pub fn look(&mut self, camera: &Camera, ground_m: f64) {
        let [a, b, c, d] = camera.frustum_normals_in_world();
        self.normals = [a, b, c, d, camera.axes_in_world()[2]].map(|normal| normal.as_vec3());
        self.frame = Some(self.world.surface().seen_by(camera));
        self.horizon.look(camera, ground_m);
    }

    /// Takes the array of an elevation leaf, near to far: heights relative to the eye, as the slots of its blocks have it, and
    /// behind them the shares of ground of a world with validity.
    /// `snaps`: log2 of the steps between vertices that are drawn, inside and on its west, east, south and north edge. Rows
    /// between them are not looked at.
    pub fn enter(&mut self, node: NodeId, array: &[f32], snaps: (u8, [u8; 4])) {
        let heights = &array[..self.posts * self.posts];
        self.place(node);
        let grid = 1 << snaps.0;
        if grid > 1 {
            // Rows that are not drawn have no say in what is outside.
            self.outside.fill(u32::MAX);
        }
        let vertices = Vertices { columns: &self.columns, rows: &self.rows, heights };
        let rows = vertices.by_row().zip(self.outside.chunks_exact_mut(self.posts));
        for (row, outside) in rows.step_by(grid) {
            for (vertex, outside) in row.zip(outside) {
                let margin = -MARGIN_M - MARGIN * (vertex.x.abs() + vertex.y.abs() + vertex.z.abs());
                let mut bits = 0;
                for (plane, normal) in self.normals.iter().enumerate() {
                    bits |= u32::from(vertex.dot(*normal) < margin) << plane;
                }
                *outside = bits;
            }
        }
        self.horizon.enter(vertices, grid, snaps.1.map(|snap| 1 << snap));
        let shares = array.get(GROUND_PLANE * heights.len()..).filter(|_| self.world.has_validity());
        let mut rows =
            shares.into_iter().flat_map(|shares| shares.chunks_exact(self.posts).take(self.posts).step_by(grid));
        if rows.any(|row| row.iter().any(|share| *share < 1.0)) {
            self.horizon.enter_hole();
        }
        self.is_seen = false;
    }

    /// Where the columns and rows of a leaf lie from the eye.
    fn place(&mut self, node: NodeId) {
        let surface = self.world.surface();
        let Some(frame) = self.frame else { return };
        for (column, x) in self.columns.iter_mut().zip(surface.posts(node, 0)) {
            *column = frame.column_from_eye(surface.column(x));
        }
        for (row, y) in self.rows.iter_mut().zip(surface.posts(node, 1)) {
            *row = frame.row_from_eye(surface.row(y));
        }
    }

    /// All blocks of the entered leaf were culled: what is seen of it hides what comes after it.
    pub fn leave(&mut self) {
        if self.is_seen {
            self.horizon.leave();
        }
    }

    /// Cuts a block of the entered leaf down to what is seen, or marks it as hidden; `false` when nothing of it is in the
    /// picture.
    pub fn cull(&mut self, slot: &mut TileSlot) -> bool {
        if !cull_by(slot, |from, to| self.is_outside(from, to)) {
            return false;
        }
        let mut seen = *slot;
        if cull_by(&mut seen, |from, to| self.is_outside(from, to) || self.horizon.is_hidden(from, to)) {
            *slot = seen;
            self.is_seen = true;
        } else {
            slot.is_hidden = 1;
        }
        true
    }

    /// Whether all vertices of a closed range of the array are outside of the same plane.
    fn is_outside(&self, [x0, y0]: [usize; 2], [x1, y1]: [usize; 2]) -> bool {
        let mut all = u32::MAX;
        for row in self.outside.chunks_exact(self.posts).take(y1 + 1).skip(y0) {
            all = row[x0..=x1].iter().fold(all, |all, bits| all & bits);
            if all == 0 {
                return false;
            }
        }
        all != 0
    }
}

/// Takes strips off a block while they are unseen; `false`, and the block as it was, when nothing is left.
fn cull_by(slot: &mut TileSlot, is_unseen: impl Fn([usize; 2], [usize; 2]) -> bool) -> bool {
    // Vertices on an edge that snaps move within such steps, so strips of them are culled whole.
    let step = 1u16 << slot.edge_snap.into_iter().max().unwrap_or(0);
    let is_unseen = |from: [u16; 2], to: [u16; 2]| is_unseen(from.map(usize::from), to.map(usize::from));
    let (mut start, mut end) = (slot.start, slot.end);
    loop {
        let [x0, y0] = start;
        let [x1, y1] = end;
        if x0 >= x1 || y0 >= y1 {
            return false;
        }
        if is_unseen([x0, y0], [x1, (y0 + step).min(y1)]) {
            start[1] = y0 + step;
        } else if is_unseen([x0, last_strip(y0, y1, step)], [x1, y1]) {
            end[1] = last_strip(y0, y1, step);
        } else if is_unseen([x0, y0], [(x0 + step).min(x1), y1]) {
            start[0] = x0 + step;
        } else if is_unseen([last_strip(x0, x1, step), y0], [x1, y1]) {
            end[0] = last_strip(x0, x1, step);
        } else {
            (slot.start, slot.end) = (start, end);
            return true;
        }
    }
}

/// Where the last strip of `from..to` begins.
fn last_strip(from: u16, to: u16, step: u16) -> u16 {
    ((to - 1) / step * step).max(from)
}
