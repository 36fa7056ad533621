//! Trimming: the part of a colour leaf's block that is seen.
//!
//! The generator culls by node; at the border of the picture most of a node may be outside, and ground behind a ridge is
//! hidden. Here every vertex is known, so rows and columns of facets of which all vertices are outside of one frustum plane,
//! or which lie below the [`horizon`](crate::horizon), are not drawn at all. What is trimmed would not have produced a
//! pixel.

use crate::horizon::{Horizon, Vertices};
use terravision_common::camera::Camera;
use terravision_common::slot::TileSlot;
use terravision_common::validity::GROUND_PLANE;
use terravision_common::world::World;

/// A vertex counts as inside of a plane when it is outside by less than this share of its distance from the eye, plus
/// a millimetre: the renderer works in single precision, and so does this.
const MARGIN: f32 = 1e-4;
const MARGIN_M: f32 = 1e-3;
const PLANES: usize = 5;

/// Trims blocks; keeps its buffers.
#[derive(Debug)]
pub struct Trim {
    posts: usize,
    has_validity: bool,
    unit: f64,
    extent: [u32; 2],
    normals: [glam::Vec3; PLANES],
    eye: glam::DVec3,
    xs: Vec<f32>,
    ys: Vec<f32>,
    /// A bit per plane that the vertex is outside of; as wide as a coordinate, for SIMD.
    outside: Vec<u32>,
    horizon: Horizon,
    /// Whether anything of the entered leaf is seen.
    is_seen: bool,
}

impl Trim {
    /// Buffers for leaves of a world.
    #[must_use]
    pub fn new(world: &World) -> Self {
        let posts = world.elevation_posts() as usize;
        Self {
            posts,
            has_validity: world.has_validity(),
            unit: world.lattice_unit_m(),
            extent: world.extent(),
            normals: [glam::Vec3::ZERO; PLANES],
            eye: glam::DVec3::ZERO,
            xs: vec![0.0; posts],
            ys: vec![0.0; posts],
            outside: vec![0; posts * posts],
            horizon: Horizon::new(world),
            is_seen: false,
        }
    }

    /// Takes the frustum of a frame's camera; `ground_m` is the height of the ground under the eye, of any level.
    pub fn look(&mut self, camera: &Camera, ground_m: f64) {
        let [a, b, c, d] = camera.frustum_normals_in_world();
        self.normals = [a, b, c, d, camera.axes_in_world()[2]].map(|normal| normal.as_vec3());
        self.eye = camera.eye();
        self.horizon.look(camera, ground_m);
    }

    /// Takes the array of an elevation leaf, near to far: heights relative to the eye, as the slots of its blocks have it, and
    /// behind them the shares of ground of a world with validity.
    /// `snaps`: log2 of the steps between vertices that are drawn, inside and on its west, east, south and north edge. Rows
    /// between them are not looked at.
    pub fn enter(&mut self, origin: [u64; 2], q: u8, array: &[f32], snaps: (u8, [u8; 4])) {
        let heights = &array[..self.posts * self.posts];
        let axes = [(&mut self.xs, self.eye.x), (&mut self.ys, self.eye.y)];
        for (axis, (metres, eye)) in axes.into_iter().enumerate() {
            for (index, metres) in (0u64..).zip(metres.iter_mut()) {
                let lattice = (origin[axis] + (index << q)).min(self.extent[axis].into());
                *metres = (lattice as f64 * self.unit - eye) as f32;
            }
        }
        let grid = 1 << snaps.0;
        if grid > 1 {
            // Rows that are not drawn have no say in what is outside.
            self.outside.fill(u32::MAX);
        }
        let rows = heights.chunks_exact(self.posts).zip(self.outside.chunks_exact_mut(self.posts));
        for ((row, outside), y) in rows.zip(&self.ys).step_by(grid) {
            for ((z, outside), x) in row.iter().zip(outside).zip(&self.xs) {
                let margin = -MARGIN_M - MARGIN * (x.abs() + y.abs() + z.abs());
                let mut bits = 0;
                for (plane, n) in self.normals.iter().enumerate() {
                    bits |= u32::from(x * n.x + y * n.y + z * n.z < margin) << plane;
                }
                *outside = bits;
            }
        }
        let vertices = Vertices { xs: &self.xs, ys: &self.ys, heights };
        self.horizon.enter(vertices, grid, snaps.1.map(|snap| 1 << snap));
        let shares = array.get(GROUND_PLANE * heights.len()..).filter(|_| self.has_validity);
        let mut rows =
            shares.into_iter().flat_map(|shares| shares.chunks_exact(self.posts).take(self.posts).step_by(grid));
        if rows.any(|row| row.iter().any(|share| *share < 1.0)) {
            self.horizon.enter_hole();
        }
        self.is_seen = false;
    }

    /// All blocks of the entered leaf were trimmed: what is seen of it hides what comes after it.
    pub fn leave(&mut self) {
        if self.is_seen {
            self.horizon.leave();
        }
    }

    /// Trims a block of the entered leaf, or marks it as hidden; `false` when nothing of it is in the picture.
    pub fn trim(&mut self, slot: &mut TileSlot) -> bool {
        if !trim_by(slot, |from, to| self.is_outside(from, to)) {
            return false;
        }
        let mut seen = *slot;
        if trim_by(&mut seen, |from, to| self.is_outside(from, to) || self.horizon.is_hidden(from, to)) {
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
fn trim_by(slot: &mut TileSlot, is_unseen: impl Fn([usize; 2], [usize; 2]) -> bool) -> bool {
    // Vertices on an edge that snaps move within such steps, so strips of them are trimmed whole.
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
