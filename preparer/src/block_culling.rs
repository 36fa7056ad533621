//! Block culling: the part of a colour leaf's block that is seen.
//!
//! The generator culls by node; at the border of the picture most of a node may be outside, and
//! ground behind a ridge is hidden. Here every vertex is known. So rows and columns of facets are
//! culled if all their vertices are outside of one frustum plane, or if they lie below the
//! [`horizon`](crate::horizon). Where walls go down from the world's border, vertices on it are
//! outside only if the walls' feet are. Culled facets would not have produced a pixel. With several views,
//! only facets that no view can see are culled. The slot says which views see nothing of its block
//! ([`TileSlot::unseen_by`]), so that no view draws what only another one sees.

use crate::horizon::Horizon;
use glam::Vec3;
use terravision_common::camera::Camera;
use terravision_common::node::NodeId;
use terravision_common::slot::TileSlot;
use terravision_common::surface::{EyeFrame, VertexTerms};
use terravision_common::validity::GROUND_PLANE;
use terravision_common::world::World;

/// A vertex counts as inside a plane when it is outside by less than this share of its distance
/// from the eye, plus a millimetre: the renderer computes in single precision, and so does this
/// module.
const MARGIN: f32 = 1e-4;
const MARGIN_M: f32 = 1e-3;
const PLANES: usize = 5;

/// A view, for [`BlockCulling::look`].
#[derive(Debug, Clone, Copy)]
pub struct Sight<'a> {
    /// Its camera.
    pub camera: &'a Camera,
    /// Height of the ground under its eye, metres, at any level; `None` when leaves are not in
    /// near-to-far order for this eye, so that nothing may be hidden from it.
    pub ground_m: Option<f64>,
}

/// Culls blocks; keeps its buffers.
#[derive(Debug)]
pub struct BlockCulling {
    world: World,
    /// One for each view of the frame; earlier frames with more views may have left more.
    eyes: Vec<Eye>,
    view_count: usize,
    /// How far down walls go from the world's border, metres; `None` without.
    skirt_low_m: Option<f64>,
    /// Whether any part of the entered leaf is seen.
    is_seen: bool,
}

/// What one view sees of the entered leaf.
#[derive(Debug)]
struct Eye {
    world: World,
    posts: usize,
    normals: [Vec3; PLANES],
    /// The frame of the view's camera.
    frame: Option<EyeFrame>,
    /// The datum of heights, metres above this eye.
    datum_m: f32,
    /// Columns and rows of the entered leaf, relative to the eye.
    terms: VertexTerms,
    /// For an eye beside the world, which may see walls: the height of their feet, relative to the
    /// eye.
    foot_m: Option<f32>,
    /// Which columns and rows of the entered leaf lie on the world's border, if there are walls.
    border: [Vec<usize>; 2],
    /// The height of the feet for each vertex.
    feet: Vec<f32>,
    /// Heights relative to the eye, if it is not at the height of the datum.
    heights: Vec<f32>,
    /// For each vertex a bit per plane that it is outside of; as wide as a coordinate, for SIMD.
    outside: Vec<u32>,
    horizon: Horizon,
}

impl BlockCulling {
    /// Buffers for leaves of a world.
    #[must_use]
    pub fn new(world: &World) -> Self {
        Self { world: *world, eyes: vec![Eye::new(world)], view_count: 0, skirt_low_m: None, is_seen: false }
    }

    /// Keeps what walls go down from, as far as the walls may be seen.
    #[must_use]
    pub fn with_skirts(self, skirt_low_m: Option<f64>) -> Self {
        Self { skirt_low_m, ..self }
    }

    /// Takes the views of a frame, whose heights are relative to the eye of `pose`.
    pub fn look<'a>(&mut self, pose: &Camera, views: impl Iterator<Item = Sight<'a>>) {
        self.view_count = 0;
        for view in views {
            if self.view_count == self.eyes.len() {
                self.eyes.push(Eye::new(&self.world));
            }
            self.eyes[self.view_count].look(pose, view, self.skirt_low_m);
            self.view_count += 1;
        }
    }

    fn eyes(&mut self) -> &mut [Eye] {
        &mut self.eyes[..self.view_count]
    }

    /// Takes the array of an elevation leaf, near to far: heights relative to the pose's eye, as in
    /// the slots of its blocks, followed by the shares of ground of a world with validity. `snaps`:
    /// log2 of the steps between drawn vertices, in the interior and on the west, east, south and
    /// north edge. Rows in between are ignored.
    pub fn enter(&mut self, node: NodeId, array: &[f32], snaps: (u8, [u8; 4])) {
        let posts = self.world.elevation_posts() as usize;
        let heights = &array[..posts * posts];
        let shares = array.get(GROUND_PLANE * heights.len()..).filter(|_| self.world.has_validity());
        let mut rows =
            shares.into_iter().flat_map(|shares| shares.chunks_exact(posts).take(posts).step_by(1 << snaps.0));
        let has_hole = rows.any(|row| row.iter().any(|share| *share < 1.0));
        for eye in self.eyes() {
            eye.enter(node, heights, snaps);
            if has_hole {
                eye.horizon.enter_hole();
            }
        }
        self.is_seen = false;
    }

    /// To be called when all blocks of the entered leaf have been culled: what is seen of it hides
    /// what comes after it.
    pub fn leave(&mut self) {
        if self.is_seen {
            self.eyes().iter_mut().for_each(|eye| eye.horizon.leave());
        }
    }

    /// Shrinks a block of the entered leaf to the part that is seen, and marks the views that see
    /// nothing of it. Returns `false` when no part of it is in any view.
    pub fn cull(&mut self, slot: &mut TileSlot) -> bool {
        let eyes = &self.eyes[..self.view_count];
        if !cull_by(slot, |from, to| eyes.iter().all(|eye| eye.is_outside(from, to))) {
            return false;
        }
        let mut seen = *slot;
        let is_unseen = |eye: &Eye, from, to| eye.is_outside(from, to) || eye.horizon.is_hidden(from, to);
        if cull_by(&mut seen, |from, to| eyes.iter().all(|eye| is_unseen(eye, from, to))) {
            *slot = seen;
            self.is_seen = true;
            let [from, to] = [slot.start, slot.end].map(|post| post.map(usize::from));
            slot.unseen_by = bits(eyes.iter().map(|eye| is_unseen(eye, from, to)));
        } else {
            slot.unseen_by = bits(eyes.iter().map(|_| true));
        }
        true
    }
}

impl Eye {
    fn new(world: &World) -> Self {
        let posts = world.elevation_posts() as usize;
        Self {
            world: *world,
            posts,
            normals: [Vec3::ZERO; PLANES],
            frame: None,
            datum_m: 0.0,
            terms: VertexTerms::default(),
            foot_m: None,
            border: Default::default(),
            feet: vec![0.0; posts * posts],
            heights: Vec::new(),
            outside: vec![0; posts * posts],
            horizon: Horizon::new(world),
        }
    }

    fn look(&mut self, pose: &Camera, Sight { camera, ground_m }: Sight<'_>, skirt_low_m: Option<f64>) {
        let [a, b, c, d] = camera.frustum_normals_in_world();
        self.normals = [a, b, c, d, camera.axes_in_world()[2]].map(|normal| normal.as_vec3());
        let surface = self.world.surface();
        let frame = surface.seen_by(camera.eye(), camera.axes_in_world()[2]);
        self.datum_m = frame.height_from_eye(surface.height_m(pose.eye()));
        let foot_m = skirt_low_m.filter(|_| !surface.is_over(camera.eye()));
        self.foot_m = foot_m.map(|low_m| frame.height_from_eye(low_m));
        self.feet.fill(self.foot_m.unwrap_or_default());
        self.frame = Some(frame);
        self.horizon.look(camera, ground_m);
    }

    fn enter(&mut self, node: NodeId, heights: &[f32], snaps: (u8, [u8; 4])) {
        self.place(node);
        let heights = if self.datum_m == 0.0 {
            heights
        } else {
            self.heights.clear();
            self.heights.extend(heights.iter().map(|height| height + self.datum_m));
            &self.heights
        };
        let grid = 1 << snaps.0;
        if grid > 1 {
            // Rows that are not drawn do not matter for what is outside.
            self.outside.fill(u32::MAX);
        }
        let vertices = self.terms.with_heights(heights);
        for (row, outside) in self.outside.chunks_exact_mut(self.posts).enumerate().step_by(grid) {
            vertices.for_row(row, |column, vertex| outside[column] = planes_outside(&self.normals, vertex));
        }
        let feet = vertices.at_heights(&self.feet);
        let mut lower = |column: usize, row: usize| {
            self.outside[row * self.posts + column] &= planes_outside(&self.normals, feet.at(column, row));
        };
        let [border_columns, border_rows] = &self.border;
        for column in border_columns {
            (0..self.posts).step_by(grid).for_each(|row| lower(*column, row));
        }
        for row in border_rows.iter().filter(|row| row.is_multiple_of(grid)) {
            (0..self.posts).for_each(|column| lower(column, *row));
        }
        self.horizon.enter(vertices, grid, snaps.1.map(|snap| 1 << snap));
    }

    /// Computes the positions of a leaf's columns and rows relative to the eye.
    fn place(&mut self, node: NodeId) {
        let surface = self.world.surface();
        let Some(frame) = self.frame else { return };
        surface.place_terms(&frame, node, &mut self.terms);
        for (axis, border) in self.border.iter_mut().enumerate() {
            border.clear();
            if self.foot_m.is_some() {
                let is_on_border = |at: u64| at == 0 || at == u64::from(self.world.extent()[axis]);
                let posts = surface.posts(node, axis).take(self.posts).enumerate();
                border.extend(posts.filter(|(_, at)| is_on_border(*at)).map(|(index, _)| index));
            }
        }
    }

    /// Whether all vertices of a closed range of the array are outside the same plane.
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

/// A bit for each plane that a vertex is outside of.
#[inline(always)]
fn planes_outside(normals: &[Vec3; PLANES], vertex: Vec3) -> u32 {
    let margin = -MARGIN_M - MARGIN * (vertex.x.abs() + vertex.y.abs() + vertex.z.abs());
    let mut bits = 0;
    for (plane, normal) in normals.iter().enumerate() {
        bits |= u32::from(vertex.dot(*normal) < margin) << plane;
    }
    bits
}

/// A bit for each view, that of the first the lowest.
fn bits(views: impl DoubleEndedIterator<Item = bool>) -> u8 {
    views.rev().fold(0, |bits, bit| bits << 1 | u8::from(bit))
}

/// Removes strips from a block while they are unseen. Returns `false`, with the block unchanged,
/// when nothing is left.
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
