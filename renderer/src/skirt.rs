//! The skirt: walls from the world's border down to its lowest height, and a floor there, plainly
//! coloured, so that a world that is seen from beside it is a block of ground and not a sheet.
//!
//! It is drawn over finished pictures, whatever drew them: for an eye beside the world the wall is
//! the first thing that a ray can meet, so nothing has to be compared. A ray that enters the
//! world's rectangle below the ground that is drawn at that point of the border sees the wall; one
//! that enters below the lowest height and rises sees the floor. The top of the wall is the edge of
//! the ground as it is drawn: the same posts of the same arrays, or, where a sweep reads heights in
//! place, what it says of its edge.
//!
//! A world with holes has walls only where ground reaches its border, and no floor: what is under a
//! hole is seen through it.

use crate::engine::Engine;
use crate::frame::Frame;
use crate::pixels::Pixels;
use crate::source::{Pools, SourceError};
use crate::technique::NEAR_M;
use glam::{DVec2, DVec3};
use terravision_common::rig::View;
use terravision_common::slot::TileSlot;
use terravision_common::validity::{GROUND_PLANE, HALF};
use terravision_common::world::World;
use terravision_raycast::EdgeStretch;

/// Share of the distance up to which rays and rasterizers may find a ray on the other side of the
/// ground's edge than it is here: no sky is to show between ground and wall.
const ROUNDING: f64 = 5e-5;
/// Colour of walls, before each side's own shade.
const WALL: [f64; 3] = [122.0, 108.0, 94.0];
/// How bright the walls in the west, east, south and north are: corners show.
const SHADES: [f64; 4] = [0.84, 0.76, 1.0, 0.66];
/// Colour of the floor, seen from below.
const FLOOR: [u8; 3] = [58, 52, 46];
/// Where a pixel is looked at, from its corner: at its centre, or at the four places of samples
/// that all devices have.
const CENTRE: [[f64; 2]; 1] = [[0.5, 0.5]];
const SAMPLES: [[f64; 2]; 4] = [[0.375, 0.125], [0.875, 0.375], [0.125, 0.625], [0.625, 0.875]];

/// Draws skirts of a world's frames; keeps its buffer.
#[derive(Debug)]
pub struct Skirt {
    world: World,
    low_m: f64,
    array: Vec<f32>,
    /// What the array's heights are above, metres above the eye.
    datum_m: f64,
}

/// Ground along a stretch of the border, linear between its ends.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Stretch {
    /// Along the side, metres from its south or west end.
    ends: [f64; 2],
    /// Metres above the eye.
    heights: [f64; 2],
}

/// The border of one frame as the eye of one of its views sees it from beside the world.
#[derive(Debug, Clone, PartialEq)]
pub struct Border {
    view: View,
    /// The world's north east corner.
    end: DVec2,
    /// Metres above the eye.
    low: f64,
    /// Whether it is a block with a floor.
    has_floor: bool,
    /// Of the west, east, south and north side, in order.
    sides: [Vec<Stretch>; 4],
}

/// What a ray sees of the skirt.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Seen {
    rgb: [u8; 3],
    /// Metres along the view axis.
    depth: f64,
}

impl Skirt {
    /// Of a world whose lowest ground, exaggerated as it is drawn, is `low_m` high.
    #[must_use]
    pub fn new(world: &World, low_m: f64) -> Self {
        Self { world: *world, low_m, array: vec![0.0; world.elevation_values()], datum_m: 0.0 }
    }

    /// Whether any of a checked frame's views may see it.
    #[must_use]
    pub fn is_in_sight(&self, frame: &Frame) -> bool {
        let surface = self.world.plane();
        frame.views.iter().any(|view| !surface.is_over(view.camera.eye()))
    }

    /// The borders of a checked frame, of those of its views whose eye is beside the world: others
    /// see nothing of it.
    ///
    /// # Errors
    /// The source is damaged.
    pub fn borders(
        &mut self,
        frame: &Frame,
        pools: &mut dyn Pools,
        engine: &mut dyn Engine,
    ) -> Result<Vec<Border>, SourceError> {
        let mut borders = Vec::new();
        let surface = self.world.plane();
        for view in frame.views.iter().filter(|view| !surface.is_over(view.camera.eye())) {
            let sides = if frame.elevations.is_empty() {
                self.sides_of_arrays(view, frame, pools)?
            } else {
                sides_in_place(view, pools, engine)
            };
            let (end, low) = (surface.end(), self.low_m - surface.height_m(view.camera.eye()));
            borders.push(Border { view: *view, end, low, has_floor: !self.world.has_holes(), sides });
        }
        Ok(borders)
    }

    /// The edge of the ground by the elevation arrays of a frame.
    fn sides_of_arrays(
        &mut self,
        view: &View,
        frame: &Frame,
        pools: &mut dyn Pools,
    ) -> Result<[Vec<Stretch>; 4], SourceError> {
        let surface = self.world.plane();
        self.datum_m = surface.height_above(frame.pose.eye(), surface.height_m(view.camera.eye()));
        let mut sides: [Vec<Stretch>; 4] = Default::default();
        let mut position = None;
        for tile in &frame.tiles {
            let touched = touched_sides(&self.world, tile);
            if touched.iter().all(Option::is_none) {
                continue;
            }
            if position != Some(tile.elevation_position) {
                if !pools.read_elevation(tile.elevation_position, &mut self.array)? {
                    continue;
                }
                position = Some(tile.elevation_position);
            }
            for (side, (at, stretches)) in touched.into_iter().zip(&mut sides).enumerate() {
                if let Some(at) = at {
                    self.follow(tile, side / 2, at, stretches);
                }
            }
        }
        for stretches in &mut sides {
            stretches.sort_unstable_by(|a, b| a.ends[0].total_cmp(&b.ends[0]));
        }
        Ok(sides)
    }

    /// Adds the ground along column (`axis` 0) or row `at` of a tile's block.
    fn follow(&self, tile: &TileSlot, axis: usize, at: u32, out: &mut Vec<Stretch>) {
        let (other, step) = (1 - axis, 1u32 << tile.grid_snap);
        let [first, last] = [tile.start[other], tile.end[other]].map(u32::from);
        let surface = self.world.plane();
        let along = |k: u32| {
            let at = lattice(&self.world, tile, other, k).into();
            if other == 0 { surface.column(at) } else { surface.row(at) }
        };
        let cut = cut_of(&self.world, tile, axis, at);
        let mut k = first;
        while k + step <= last {
            let ends = [along(k), along(k + step)];
            let border = [k, k + step].map(|k| self.height(axis, at, k));
            // Past the extent all vertices lie on its corner.
            if ends[0] < ends[1] && border.iter().all(|height| height.is_finite()) {
                let inner = [k, k + step].map(|k| self.height(axis, at.saturating_sub(step), k));
                match ground_along([k, k + step].map(|k| self.ground_share(axis, at, k))) {
                    Some([0.0, 1.0]) => add_stretch(out, ends, border, cut.map(|share| (share, inner))),
                    Some(part) => {
                        let between = |v: [f64; 2]| part.map(|t| v[0] + t * (v[1] - v[0]));
                        out.push(Stretch { ends: between(ends), heights: between(border) });
                    }
                    None => {}
                }
            }
            k += step;
        }
    }

    /// The height in column (`axis` 0) or row `at` of the array that was read last.
    fn height(&self, axis: usize, at: u32, k: u32) -> f64 {
        self.value(0, axis, at, k).map_or(f64::NAN, |height| height + self.datum_m)
    }

    /// The share that is ground, likewise.
    fn ground_share(&self, axis: usize, at: u32, k: u32) -> f64 {
        self.value(GROUND_PLANE, axis, at, k).unwrap_or(1.0)
    }

    fn value(&self, plane: usize, axis: usize, at: u32, k: u32) -> Option<f64> {
        let (column, row) = if axis == 0 { (at, k) } else { (k, at) };
        let posts = self.world.elevation_posts() as usize;
        self.array.get((plane * posts + row as usize) * posts + column as usize).map(|value| f64::from(*value))
    }
}

/// The edge of the ground as a sweep draws it.
fn sides_in_place(view: &View, pools: &dyn Pools, engine: &mut dyn Engine) -> [Vec<Stretch>; 4] {
    let mut sides: [Vec<Stretch>; 4] = Default::default();
    for (side, stretches) in sides.iter_mut().enumerate() {
        engine.edge(&view.camera, pools, side, &mut |EdgeStretch { ends_m, heights_m, ground }| {
            if let Some(part) = ground_along(ground.map(f64::from)) {
                let between = |v: [f64; 2]| part.map(|t| v[0] + t * (v[1] - v[0]));
                stretches.push(Stretch { ends: between(ends_m), heights: between(heights_m) });
            }
        });
    }
    sides
}

/// The part of a stretch between two posts that is ground, given the shares of both.
fn ground_along([from, to]: [f64; 2]) -> Option<[f64; 2]> {
    let half = f64::from(HALF);
    let rim = (half - from) / (to - from);
    match (from >= half, to >= half) {
        (true, true) => Some([0.0, 1.0]),
        (true, false) => Some([0.0, rim]),
        (false, true) => Some([rim, 1.0]),
        (false, false) => None,
    }
}

/// How much of the cells before column or row `at` lies inside of the world, where its border cuts
/// them.
fn cut_of(world: &World, tile: &TileSlot, axis: usize, at: u32) -> Option<f64> {
    let step = 1u32 << tile.grid_snap;
    let before = u64::from(lattice(world, tile, axis, at.checked_sub(step)?));
    let inside = u64::from(lattice(world, tile, axis, at)) - before;
    let whole = u64::from(step) << tile.elevation_level;
    (inside > 0 && inside < whole).then(|| inside as f64 / whole as f64)
}

/// Adds a stretch of the border between two posts. A cell that the border cuts is cut into facets
/// after that by the mesh and before it by rays, whose ground then has a kink on the border: the
/// higher of the two, so that no sky shows with either.
fn add_stretch(out: &mut Vec<Stretch>, ends: [f64; 2], heights: [f64; 2], cut: Option<(f64, [f64; 2])>) {
    let Some((share, inner)) = cut else {
        out.push(Stretch { ends, heights });
        return;
    };
    let between = |v: [f64; 2]| v[0] + share * (v[1] - v[0]);
    let (at, kink) = (between(ends), between(inner) + heights[1] - inner[1]);
    let top = between(heights).max(kink);
    out.push(Stretch { ends: [ends[0], at], heights: [heights[0], top] });
    out.push(Stretch { ends: [at, ends[1]], heights: [top, heights[1]] });
}

/// Lattice coordinate of post `k` of a tile's array along an axis; posts past the extent lie on it.
fn lattice(world: &World, tile: &TileSlot, axis: usize, k: u32) -> u32 {
    let past = u64::from(tile.elevation_origin[axis]) + (u64::from(k) << tile.elevation_level);
    world.plane().canonical(axis, past) as u32
}

/// Which column or row of a tile's block lies on the world's west, east, south and north side.
fn touched_sides(world: &World, tile: &TileSlot) -> [Option<u32>; 4] {
    let mut sides = [None; 4];
    for axis in 0..2 {
        let [start, end] = [tile.start[axis], tile.end[axis]].map(u32::from);
        let place = |k: u32| lattice(world, tile, axis, k);
        sides[2 * axis] = (place(start) == 0).then_some(start);
        let mut on_far_side = (start..=end).step_by(1 << tile.grid_snap).filter(|k| place(*k) == world.extent()[axis]);
        sides[2 * axis + 1] = on_far_side.next().filter(|k| *k > start);
    }
    sides
}

impl Border {
    /// Draws walls and floor over the view in its frame's picture, and into the depth where there
    /// is one. `samples`: per pixel, 1 or 4.
    pub fn draw(&self, pixels: &mut Pixels, samples: u32) {
        if pixels.rgba().is_empty() {
            return;
        }
        let row_length = pixels.size()[0] as usize;
        let [left, top] = self.view.at.map(|at| at as usize);
        let [width, height] = self.view.size();
        let places: &[[f64; 2]] = if samples > 1 { &SAMPLES } else { &CENTRE };
        let (rgba, mut depths) = pixels.planes_mut();
        let rows = rgba.chunks_exact_mut(4 * row_length).skip(top).zip(0..height);
        for (row, y) in rows {
            for (texel, x) in row.chunks_exact_mut(4).skip(left).zip(0..width) {
                let ray = |[dx, dy]: [f64; 2]| self.view.camera.ray_in_world(f64::from(x) + dx, f64::from(y) + dy);
                let seen = |place: &[f64; 2]| self.seen(ray(*place));
                mix(texel, places.iter().map(seen));
                if let (Some(depths), Some(seen)) = (&mut depths, self.seen(ray(CENTRE[0]))) {
                    depths[(top + y as usize) * row_length + left + x as usize] = (NEAR_M / seen.depth) as f32;
                }
            }
        }
    }

    /// What a ray from the eye, of depth 1, sees.
    fn seen(&self, ray: DVec3) -> Option<Seen> {
        let eye = self.view.camera.eye();
        let (mut near, mut far, mut side) = (0.0f64, f64::INFINITY, None);
        for axis in 0..2 {
            let [a, b] = [-eye[axis] / ray[axis], (self.end[axis] - eye[axis]) / ray[axis]];
            if ray[axis] == 0.0 {
                if !(0.0..=self.end[axis]).contains(&eye[axis]) {
                    return None;
                }
                continue;
            }
            if a.min(b) > near {
                near = a.min(b);
                side = Some(2 * axis + usize::from(b < a));
            }
            far = far.min(a.max(b));
        }
        let side = side.filter(|_| near < far)?;
        let along = 1 - side / 2;
        let (z, at) = (near * ray.z, eye[along] + near * ray[along]);
        if z < self.low {
            if !self.has_floor {
                return None;
            }
            let depth = self.low / ray.z;
            return (ray.z > 0.0 && depth < far).then_some(Seen { rgb: FLOOR, depth });
        }
        let rgb = WALL.map(|v| (v * SHADES[side]).round() as u8);
        self.top(side, at).filter(|top| z < *top + ROUNDING * near).map(|_| Seen { rgb, depth: near })
    }

    /// Height of the ground on a side; `None` where none is drawn.
    fn top(&self, side: usize, at: f64) -> Option<f64> {
        let stretches = &self.sides[side];
        let after = stretches.partition_point(|stretch| stretch.ends[0] <= at);
        let Stretch { ends, heights } = *stretches.get(after.checked_sub(1)?)?;
        let share = (at - ends[0]) / (ends[1] - ends[0]);
        (share <= 1.0 + 1e-9).then(|| heights[0] + share * (heights[1] - heights[0]))
    }
}

/// Lays what the samples of a pixel see over it, by its share.
fn mix(texel: &mut [u8], samples: impl ExactSizeIterator<Item = Option<Seen>>) {
    let (count, mut sum, mut hits) = (samples.len() as u32, [0u32; 3], 0);
    for seen in samples.flatten() {
        hits += 1;
        (0..3).for_each(|c| sum[c] += u32::from(seen.rgb[c]));
    }
    if hits > 0 {
        // A wall is not ground that was made up; before a sky that is still to be drawn, alpha is its share.
        texel[3] += ((u32::from(255 - texel[3]) * hits + count / 2) / count) as u8;
        texel[3] |= 1;
        (0..3).for_each(|c| texel[c] = ((sum[c] + (count - hits) * u32::from(texel[c]) + count / 2) / count) as u8);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pixels::Raster;
    use terravision_common::camera::{Camera, CameraFields};
    use terravision_common::rig::{PictureLayout, Views};

    /// A square of 100 m whose west side rises from 0 m in the south to 50 m in the north, lowest
    /// ground -10 m; the eye 100 m west of it, 20 m high, looking east.
    fn border() -> Border {
        let camera = Camera::new(CameraFields {
            eye_in_world: [-100.0, 50.0, 20.0],
            heading_rad: std::f64::consts::FRAC_PI_2,
            pitch_rad: 0.0,
            roll_rad: 0.0,
            vfov_rad: std::f64::consts::FRAC_PI_2,
            width: 200,
            height: 200,
            timestamp_nanos: 0,
        })
        .expect("valid");
        let west = Stretch { ends: [0.0, 100.0], heights: [-20.0, 30.0] };
        Border {
            view: View { camera, at: [0; 2] },
            end: DVec2::splat(100.0),
            low: -30.0,
            has_floor: true,
            sides: [vec![west], vec![], vec![], vec![]],
        }
    }

    #[test]
    fn a_ray_that_enters_below_the_ground_sees_the_wall_and_one_that_rises_below_it_the_floor() {
        let border = border();
        let seen = |x: f64, y: f64| border.seen(border.view.camera.ray_in_world(x, y));
        // A pixel is a metre on the west side; the middle of the picture is its middle, 20 m high.
        let wall = Some(Seen { rgb: WALL.map(|v| (v * SHADES[0]).round() as u8), depth: 100.0 });
        assert_eq!(seen(100.5, 110.0), wall, "10 m high where the ground is 25 m");
        assert_eq!(seen(100.5, 90.0), None, "30 m high");
        assert_eq!(seen(60.0, 94.9), wall, "the north is higher");
        assert_eq!(seen(140.0, 114.0), None, "the south lower");
        assert_eq!(seen(160.0, 110.0), None, "past the corner");
        assert_eq!(seen(100.5, 129.0), wall, "just above the lowest height");
        assert_eq!(seen(100.5, 131.0), None, "below it");
        let from_below = Border { low: 30.0, ..border.clone() };
        let floor = from_below.seen(from_below.view.camera.ray_in_world(100.5, 80.0)).expect("the floor");
        assert!(floor.rgb == FLOOR && (floor.depth - 150.0).abs() < 1e-9);
    }

    #[test]
    fn walls_end_where_the_ground_does() {
        assert_eq!(ground_along([1.0, 1.0]), Some([0.0, 1.0]));
        assert_eq!(ground_along([0.0, 0.0]), None);
        assert_eq!(ground_along([0.0, 1.0]), Some([0.5, 1.0]));
        assert_eq!(ground_along([1.0, 0.0]), Some([0.0, 0.5]));
        // Seen from below there is no floor under holes.
        let holed = Border { low: 30.0, has_floor: false, ..border() };
        assert_eq!(holed.seen(holed.view.camera.ray_in_world(100.5, 80.0)), None);
    }

    #[test]
    fn walls_cover_picture_and_depth_and_leave_the_rest() {
        let border = border();
        for (samples, partly) in [(1, 0), (4, 1)] {
            let mut raster = Raster::new(true);
            raster.lay_out(PictureLayout::new([200, 200], &Views::single(&border.view.camera)));
            let mut pixels = Pixels::Memory(raster);
            border.draw(&mut pixels, samples);
            let drawn = pixels.rgba().chunks_exact(4).filter(|texel| texel[0] > 0).count();
            let whole = pixels.rgba().chunks_exact(4).filter(|texel| texel[0] == 102).count();
            // 3500 m² of wall between -10 m and the ground.
            assert!(drawn.abs_diff(3500) < 160 && (drawn > whole) == (partly > 0), "{drawn}, {whole}");
            let depths = pixels.reversed_depth().expect("it has them");
            let near = depths.iter().filter(|depth| **depth > 0.0).count();
            assert!(near.abs_diff(3500) < 110, "{near}");
            assert!(depths.iter().all(|depth| *depth == 0.0 || (*depth - 0.005).abs() < 1e-6));
        }
    }
}
