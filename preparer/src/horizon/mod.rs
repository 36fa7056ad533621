//! Occlusion: facets that lie wholly behind ground that is drawn before them need not be drawn.
//!
//! Leaves are in near-to-far order. In a vertical plane through the eye, everything below the
//! highest ground so far is hidden by that ground: a ray to it would have to come up through the
//! surface. So it is sufficient to keep one number per direction, the *horizon*. Directions are
//! those of an upright picture plane ahead of the eye, on which facets remain triangles at any
//! pitch and roll of the camera:
//!
//! ```text
//! u = across / ahead     v = up / ahead      ahead = (p − eye) · heading, horizontal
//! ```
//!
//! The horizon of a bin of `u` is a lower bound of the ground's outline over the whole bin, taken
//! from the rows and columns of drawn edges; a block of facets is hidden when its highest vertex
//! lies below the horizon of every bin that it touches.
//!
//! Through a hole in the ground (`terravision_common::validity`) rays get below the surface, and
//! out again through another hole. So a leaf with a hole hides nothing, and neither does what comes
//! after it in the same directions. Nearer ground still hides: a ray that hits it has not passed a
//! hole before.

use glam::{DVec2, Vec2, Vec3};
use terravision_common::camera::Camera;
use terravision_common::surface::{Surface, Vertices};
use terravision_common::world::World;

/// Bins across the picture: a bin is narrower than a facet.
const BINS: usize = 512;
/// Only one in this many lines of vertices raises the horizon: each costs time, and a ridge is
/// wider than one line.
const LINES_APART: usize = 2;
/// How far below the horizon ground must be to count as hidden, pixels: the renderer works in
/// single precision, and rasterizes edges in 256ths of a pixel.
const MARGIN_PX: f64 = 0.25;
/// Steeper directions than this, as ahead over distance, are not projected onto the upright plane.
const LEAST_AHEAD: f64 = 0.2;
/// Leaves with a vertex nearer than this, metres ahead of the eye, neither hide nor are hidden.
const NEAREST_M: f32 = 0.1;

/// The horizon of one frame; keeps its buffers.
#[derive(Debug)]
pub struct Horizon {
    surface: Surface,
    is_active: bool,
    /// The camera's heading.
    ahead: Vec2,
    /// Takes `u` to bins: those of the picture are `0..BINS`.
    bins_per_u: f32,
    /// In `u` and `v`.
    margin: f32,
    bins: Vec<f32>,
    /// Bins that may be seen through a hole, from the first to the one past the last. They are no
    /// longer raised.
    holed: [usize; 2],
    /// Whether the entered leaf has a hole.
    has_hole: bool,
    /// Upright coordinates of the entered leaf's vertices, `u` in bins.
    us: Vec<f32>,
    vs: Vec<f32>,
    /// `None` when one of its vertices cannot be projected onto the upright plane.
    entered: Option<Leaf>,
    posts: usize,
}

/// Steps between the drawn vertices of a leaf.
#[derive(Debug, Clone, Copy)]
struct Leaf {
    grid: usize,
    /// On its west, east, south and north edge.
    edges: [usize; 4],
    /// The longest of all of them.
    step: usize,
}

/// The bounds of a set of vertices on the upright plane.
#[derive(Debug, Clone, Copy)]
struct Bounds {
    low_u: f32,
    high_u: f32,
    top: f32,
}

impl Bounds {
    const NONE: Self = Self { low_u: f32::INFINITY, high_u: f32::NEG_INFINITY, top: f32::NEG_INFINITY };
}

impl Horizon {
    /// Buffers for leaves of a world.
    #[must_use]
    pub fn new(world: &World) -> Self {
        let posts = world.elevation_posts() as usize;
        Self {
            surface: *world.surface(),
            is_active: false,
            ahead: Vec2::Y,
            bins_per_u: 1.0,
            margin: 0.0,
            bins: vec![f32::NEG_INFINITY; BINS],
            holed: [0; 2],
            has_hole: false,
            us: vec![0.0; posts * posts],
            vs: vec![0.0; posts * posts],
            entered: None,
            posts,
        }
    }

    /// Begins a frame. `ground_m` is the height of the ground under the eye, at any level,
    /// exaggerated; `None` when leaves are not in near-to-far order for this eye. Then nothing is
    /// hidden. Nothing is hidden either from an eye beside the world, which may see below its edge,
    /// from an eye below the ground, and in a steep view.
    pub fn look(&mut self, camera: &Camera, ground_m: Option<f64>) {
        let (sin, cos) = camera.heading_rad().sin_cos();
        let ahead = DVec2::new(sin, cos);
        let (width, height) = (f64::from(camera.width()), f64::from(camera.height()));
        let corners = [(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)];
        let corners = corners.map(|(x, y)| camera.ray_in_world(x, y).normalize().truncate());
        let eye = camera.eye();
        self.is_active = self.surface.is_over(eye)
            && ground_m.is_some_and(|ground_m| self.surface.height_m(eye) > ground_m)
            && corners.iter().all(|corner| corner.dot(ahead) >= LEAST_AHEAD);
        self.entered = None;
        self.holed = [0; 2];
        if self.is_active {
            let across = corners.map(|corner| (corner.perp_dot(ahead) / corner.dot(ahead)).abs());
            self.ahead = ahead.as_vec2();
            self.bins_per_u = (0.5 * BINS as f64 / across.into_iter().fold(1e-9, f64::max)) as f32;
            self.margin = (MARGIN_PX / camera.focal_px()) as f32;
            self.bins.fill(f32::NEG_INFINITY);
        }
    }

    /// Takes the vertices of the next leaf, near to far; afterwards [`is_hidden`](Self::is_hidden)
    /// tells which parts of it are hidden. The leaf is drawn with every `grid`-th vertex, and on
    /// its west, east, south and north edges with the steps `edges`; other vertices are ignored.
    pub fn enter(&mut self, vertices: Vertices<'_>, grid: usize, edges: [usize; 4]) {
        let leaf = Leaf { grid, edges, step: edges.into_iter().fold(grid, usize::max) };
        if self.is_active && self.is_under(vertices, leaf) {
            self.is_active = false;
        }
        self.entered = (self.is_active && self.project(vertices, leaf)).then_some(leaf);
        self.has_hole = false;
    }

    /// The entered leaf has a hole.
    pub fn enter_hole(&mut self) {
        self.has_hole = true;
    }

    /// To be called if the entered leaf is drawn, at least in part: it hides what comes after it.
    pub fn leave(&mut self) {
        let entered = self.entered.take();
        if self.has_hole {
            self.open(entered);
        } else if let Some(leaf) = entered {
            self.raise(leaf);
        }
    }

    /// Opens the directions of a leaf that has a hole; all directions if it cannot be projected.
    /// The open directions are kept as one range: holes are usually side by side, and the
    /// directions between two holes only cost time.
    fn open(&mut self, leaf: Option<Leaf>) {
        let Some(leaf) = leaf else {
            self.holed = [0, BINS];
            return;
        };
        let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
        for row in self.us.chunks_exact(self.posts).step_by(leaf.grid) {
            for u in row.iter().step_by(leaf.grid) {
                (low, high) = (low.min(*u), high.max(*u));
            }
        }
        // A bin more on both sides: rounding. Casts of negative numbers give 0.
        let [first, end] = [(low - 1.0) as usize, (high + 2.0) as usize].map(|bin| bin.min(BINS));
        let [before, after] = self.holed;
        self.holed = if before < after { [before.min(first), after.max(end)] } else { [first, end] };
    }

    /// Whether a part of the entered leaf, from `x0, y0` to `x1, y1` in posts, is hidden. The part
    /// is rounded up to blocks whose side is the longest step.
    #[must_use]
    pub fn is_hidden(&self, [x0, y0]: [usize; 2], [x1, y1]: [usize; 2]) -> bool {
        let Some(leaf) = self.entered else { return false };
        let first = |from: usize| from / leaf.step * leaf.step;
        (first(y0)..y1).step_by(leaf.step).all(|y| {
            let mut blocks = (first(x0)..x1).step_by(leaf.step);
            blocks.all(|x| self.is_block_hidden(leaf, [x, y]))
        })
    }

    fn is_block_hidden(&self, leaf: Leaf, [x, y]: [usize; 2]) -> bool {
        let mut bounds = Bounds::NONE;
        for row in (y..=y + leaf.step).step_by(leaf.grid) {
            let range = row * self.posts + x..=row * self.posts + x + leaf.step;
            let vertices = self.us[range.clone()].iter().zip(&self.vs[range]);
            for (u, v) in vertices.step_by(leaf.grid) {
                bounds.low_u = bounds.low_u.min(*u);
                bounds.high_u = bounds.high_u.max(*u);
                bounds.top = bounds.top.max(*v);
            }
        }
        let bins = self.bins_of(bounds);
        !bins.is_empty() && bins.iter().all(|bin| bounds.top + self.margin < *bin)
    }

    /// Whether the eye may be below the drawn surface, because that is still coarse: ground that is
    /// hidden from above is visible from there. An eye within the range of heights of a node's
    /// ground is in its box, so that this node is in the tree; an eye below the range is below the
    /// ground of every level.
    fn is_under(&self, vertices: Vertices<'_>, leaf: Leaf) -> bool {
        let Some([column, row]) = vertices.cell_under_eye(leaf.step) else { return false };
        let mut rows = (row..=row + leaf.step).step_by(leaf.grid);
        let columns = (column..=column + leaf.step).step_by(leaf.grid);
        rows.any(|row| columns.clone().any(|column| vertices.at(column, row).z >= 0.0))
    }

    /// Projects the vertices onto the upright plane. Returns `false` when one of them cannot be
    /// projected.
    fn project(&mut self, vertices: Vertices<'_>, leaf: Leaf) -> bool {
        let ahead = self.ahead;
        let is_ahead = |corner: Vec3| corner.x * ahead.x + corner.y * ahead.y >= NEAREST_M;
        if !vertices.level_corners().into_iter().all(is_ahead) {
            return false;
        }
        let (x_bins, y_bins) = (ahead.y * self.bins_per_u, ahead.x * self.bins_per_u);
        let rows = self.us.chunks_exact_mut(self.posts).zip(self.vs.chunks_exact_mut(self.posts));
        for (row, (us, vs)) in rows.enumerate().step_by(leaf.grid) {
            vertices.for_row(row, |column, vertex| {
                let per_metre = 1.0 / (vertex.x * ahead.x + vertex.y * ahead.y);
                us[column] = (vertex.x * x_bins - vertex.y * y_bins) * per_metre + 0.5 * BINS as f32;
                vs[column] = vertex.z * per_metre;
            });
        }
        true
    }

    /// The bins that some bounds touch; none beside the picture, which is left to frustum culling.
    fn bins_of(&self, bounds: Bounds) -> &[f32] {
        let margin = self.margin * self.bins_per_u;
        let (first, last) = (bounds.low_u - margin, bounds.high_u + margin);
        if last < 0.0 || first >= BINS as f32 {
            return &[];
        }
        // Casts of negative numbers give 0.
        &self.bins[first as usize..=(last as usize).min(BINS - 1)]
    }

    /// Raises the horizon by the drawn edges of the entered leaf. Edges on its border are used only
    /// where no vertices collapse on them.
    fn raise(&mut self, leaf: Leaf) {
        let Leaf { grid, edges: [west, east, south, north], .. } = leaf;
        let last = self.posts - 1;
        let first_of = |edge: usize| if edge > grid { grid } else { 0 };
        let end_of = |edge: usize| if edge > grid { last - grid } else { last };
        let (columns, rows) = ([first_of(west), end_of(east)], [first_of(south), end_of(north)]);
        // Lines that run across the view rather than along it.
        let is_by_rows = self.ahead.y.abs() >= self.ahead.x.abs();
        let (along, lines, strides) =
            if is_by_rows { (columns, rows, [1, self.posts]) } else { (rows, columns, [self.posts, 1]) };
        if along[0] < along[1] {
            for line in (lines[0]..=lines[1]).step_by(LINES_APART * grid) {
                self.raise_by_line(line * strides[1], along, grid, strides[0]);
            }
        }
    }

    /// Raises the horizon by a line of vertices, which is straight as seen from above, so that `u`
    /// is monotonic along it.
    fn raise_by_line(&mut self, start: usize, [from, to]: [usize; 2], grid: usize, stride: usize) {
        let is_rising = self.us[start + from * stride] < self.us[start + to * stride];
        let vertex = |step: usize| {
            let at = start + stride * if is_rising { from + step * grid } else { to - step * grid };
            (self.us[at], self.vs[at])
        };
        let mut previous = vertex(0);
        // Bins that the line covers completely.
        let mut bin = previous.0.ceil().max(0.0);
        let mut lowest = f32::INFINITY;
        let mut is_inside = false;
        for step in 1..=(to - from) / grid {
            let next = vertex(step);
            let across = next.0 - previous.0;
            if across > 0.0 {
                let slope = (next.1 - previous.1) / across;
                let height_at = |u: f32| previous.1 + (u - previous.0).min(across) * slope;
                if !is_inside && next.0 >= bin {
                    is_inside = true;
                    lowest = height_at(bin);
                }
                while is_inside && next.0 >= bin + 1.0 && bin < BINS as f32 {
                    let height = height_at(bin + 1.0);
                    if !(self.holed[0]..self.holed[1]).contains(&(bin as usize)) {
                        let place = &mut self.bins[bin as usize];
                        *place = place.max(lowest.min(height));
                    }
                    lowest = height;
                    bin += 1.0;
                }
            }
            lowest = if is_inside { lowest.min(next.1) } else { lowest };
            previous = next;
        }
    }
}

#[cfg(test)]
mod tests;
