//! One ray against the height field: a walk through the pyramid of maxima (Tevs, Ihrke, Seidel:
//! "Maximum mipmaps for fast, accurate, and scalable dynamic height field rendering", I3D 2008),
//! then the exact root of the bilinear cell.

use super::Heights;
use glam::DVec3;

/// Where a ray meets the ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Ray parameter: metres along the view axis, for rays of depth 1.
    pub t: f64,
    /// The point: easting, northing, exaggerated height.
    pub point: DVec3,
    /// Upward normal of the bilinear surface, not of unit length.
    pub normal: DVec3,
}

/// The ray in grid units: cells east and north, metres up.
struct GridRay {
    origin: DVec3,
    direction: DVec3,
}

impl GridRay {
    fn at(&self, t: f64) -> DVec3 {
        self.origin + self.direction * t
    }

    /// Parameter at which coordinate `axis` leaves `[low, high]`.
    fn exit(&self, axis: usize, low: f64, high: f64) -> f64 {
        let (o, d) = (self.origin[axis], self.direction[axis]);
        if d > 0.0 {
            (high - o) / d
        } else if d < 0.0 {
            (low - o) / d
        } else {
            f64::INFINITY
        }
    }
}

/// The first point, from above, where the ray `eye + t·direction`, `t >= 0`, meets the ground of
/// heights times `exaggeration`. A ray that enters the field below its surface (through the side of
/// the block) sees nothing.
pub(super) fn cast(heights: &Heights, exaggeration: f64, eye: DVec3, direction: DVec3) -> Option<Hit> {
    let [east, north] = heights.origin();
    let scale = 1.0 / heights.spacing_m();
    let ray = GridRay {
        origin: DVec3::new((eye.x - east) * scale, (eye.y - north) * scale, eye.z),
        direction: DVec3::new(direction.x * scale, direction.y * scale, direction.z),
    };
    let [columns, rows] = heights.cells();
    let (mut t, end) = clip(&ray, [columns as f64, rows as f64])?;
    let top = heights.coarsest_level();
    let highest = heights.maximum(top, 0, 0) * exaggeration;
    if ray.direction.z < 0.0 {
        t = t.max((highest - ray.origin.z) / ray.direction.z);
    }
    let start = ray.at(t);
    let (mut level, mut i, mut j) = (top, 0usize, 0usize);
    if t < end {
        let ground = surface(heights, exaggeration, start);
        if start.z < ground - 1e-6 {
            return None;
        }
    }
    while t < end {
        let size = (1usize << level) as f64;
        let (low_x, low_y) = (i as f64 * size, j as f64 * size);
        let exit_x = ray.exit(0, low_x, low_x + size);
        let exit_y = ray.exit(1, low_y, low_y + size);
        let exit = exit_x.min(exit_y).min(end).max(t);
        let lowest = ray.at(t).z.min(ray.at(exit).z);
        if lowest <= heights.maximum(level, i, j) * exaggeration {
            if level > 0 {
                level -= 1;
                let middle = ray.at(t);
                let half = 0.5 * size;
                let grid = [columns.div_ceil(1 << level), rows.div_ceil(1 << level)];
                i = (2 * i + usize::from(middle.x >= low_x + half)).min(grid[0] - 1);
                j = (2 * j + usize::from(middle.y >= low_y + half)).min(grid[1] - 1);
                continue;
            }
            if let Some(hit) = cell_root(heights, exaggeration, &ray, [i, j], [t, exit]) {
                let point = eye + direction * hit;
                return Some(Hit { t: hit, point, normal: normal(heights, exaggeration, ray.at(hit), [i, j]) });
            }
        }
        t = exit;
        if exit >= end || (ray.direction.z >= 0.0 && ray.at(t).z > highest) {
            return None;
        }
        let grid = [columns.div_ceil(1 << level), rows.div_ceil(1 << level)];
        let before = (i >> 1, j >> 1);
        if exit_x <= exit_y {
            i = step(i, ray.direction.x, grid[0])?;
        } else {
            j = step(j, ray.direction.y, grid[1])?;
        }
        if level < top && before != (i >> 1, j >> 1) {
            level += 1;
            i >>= 1;
            j >>= 1;
        }
    }
    None
}

fn step(index: usize, direction: f64, count: usize) -> Option<usize> {
    if direction > 0.0 { (index + 1 < count).then_some(index + 1) } else { index.checked_sub(1) }
}

/// The stretch of the ray over the field's rectangle.
fn clip(ray: &GridRay, size: [f64; 2]) -> Option<(f64, f64)> {
    let (mut start, mut end) = (0.0f64, f64::INFINITY);
    for (axis, size) in size.into_iter().enumerate() {
        let (o, d) = (ray.origin[axis], ray.direction[axis]);
        if d == 0.0 {
            if !(0.0..=size).contains(&o) {
                return None;
            }
            continue;
        }
        let (a, b) = ((0.0 - o) / d, (size - o) / d);
        start = start.max(a.min(b));
        end = end.min(a.max(b));
    }
    if end.is_infinite() {
        // Straight down (or up): the field has no side that ends the ray.
        end = 1e7;
    }
    (start < end).then_some((start, end))
}

/// Coefficients of the height in cell `(i, j)`: a + b·u + c·v + d·u·v, u and v from its south west
/// corner.
fn coefficients(heights: &Heights, exaggeration: f64, cell: [usize; 2]) -> [f64; 4] {
    let [a, b, c, d] = heights.corners(cell[0], cell[1]).map(|h| h * exaggeration);
    [a, b - a, c - a, a - b - c + d]
}

fn surface(heights: &Heights, exaggeration: f64, p: DVec3) -> f64 {
    let [columns, rows] = heights.cells();
    let i = (p.x.max(0.0) as usize).min(columns - 1);
    let j = (p.y.max(0.0) as usize).min(rows - 1);
    let [a, b, c, d] = coefficients(heights, exaggeration, [i, j]);
    let (u, v) = (p.x - i as f64, p.y - j as f64);
    a + b * u + c * v + d * u * v
}

/// First root of (ray height - surface) in the cell for t in the span; the start when the ray is
/// below already.
fn cell_root(
    heights: &Heights,
    exaggeration: f64,
    ray: &GridRay,
    cell: [usize; 2],
    [start, end]: [f64; 2],
) -> Option<f64> {
    let [a, b, c, d] = coefficients(heights, exaggeration, cell);
    let o = ray.at(start);
    let (u, v) = (o.x - cell[0] as f64, o.y - cell[1] as f64);
    let r = ray.direction;
    // f(s) = q2 s^2 + q1 s + q0, s = t - start.
    let q0 = o.z - (a + b * u + c * v + d * u * v);
    if q0 <= 0.0 {
        return Some(start);
    }
    let q1 = r.z - (b * r.x + c * r.y + d * (u * r.y + v * r.x));
    let q2 = -d * r.x * r.y;
    let span = end - start;
    let inside = |s: f64| (s >= 0.0 && s <= span).then_some(start + s);
    if q2.abs() < 1e-300 {
        return (q1 < 0.0).then(|| -q0 / q1).and_then(inside);
    }
    let discriminant = q1 * q1 - 4.0 * q2 * q0;
    if discriminant < 0.0 {
        return None;
    }
    let q = -0.5 * (q1 + discriminant.sqrt().copysign(q1));
    let (s0, s1) = (q / q2, if q == 0.0 { f64::INFINITY } else { q0 / q });
    inside(s0.min(s1)).or_else(|| inside(s0.max(s1)))
}

fn normal(heights: &Heights, exaggeration: f64, p: DVec3, cell: [usize; 2]) -> DVec3 {
    let [_, b, c, d] = coefficients(heights, exaggeration, cell);
    let (u, v) = (p.x - cell[0] as f64, p.y - cell[1] as f64);
    let scale = 1.0 / heights.spacing_m();
    DVec3::new(-(b + d * v) * scale, -(c + d * u) * scale, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn rough(seed: u64) -> Heights {
        let mut state = seed | 1;
        let values = (0..37 * 29)
            .map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                ((state >> 40) as f32) / 16_777_216.0 * 30.0
            })
            .collect();
        Heights::new(37, 29, [500_000.0, 4_000_000.0], 10.0, values)
    }

    /// The same by very small steps.
    fn march(heights: &Heights, eye: DVec3, direction: DVec3) -> Option<f64> {
        let dt = 0.02 / direction.length();
        let mut t = 0.0;
        while t < 800.0 / direction.length() {
            let p = eye + direction * t;
            if let Some(ground) = heights.at(p.x, p.y)
                && p.z <= ground
            {
                return Some(t);
            }
            t += dt;
        }
        None
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]
        #[test]
        fn the_first_hit_is_the_one_that_small_steps_find(
            seed: u64, x in 5.0..355.0f64, y in 5.0..275.0f64, z in 31.0..120.0f64,
            heading in 0.0..std::f64::consts::TAU, slope in -3.0..0.05f64,
        ) {
            let heights = rough(seed);
            let eye = DVec3::new(500_000.0 + x, 4_000_000.0 + y, z);
            let direction = DVec3::new(heading.sin(), heading.cos(), slope);
            let hit = cast(&heights, 1.0, eye, direction);
            match (hit, march(&heights, eye, direction)) {
                (Some(hit), Some(t)) => prop_assert!((hit.t - t).abs() * direction.length() < 0.05, "{hit:?} against {t}"),
                // Small steps may step over a grazed ridge, never over more than that.
                (Some(hit), None) => {
                    let ahead = hit.point + direction * 0.02;
                    let above = ahead.z - heights.at(ahead.x, ahead.y).unwrap_or(f64::NEG_INFINITY);
                    prop_assert!(above > -0.05, "small steps missed {hit:?}");
                }
                (None, found) => prop_assert_eq!(found, None),
            }
            if let Some(hit) = hit {
                let ground = heights.at(hit.point.x, hit.point.y).unwrap();
                prop_assert!((ground - hit.point.z).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn straight_down_and_up() {
        let heights = Heights::new(3, 3, [0.0, 0.0], 1.0, vec![2.0; 9]);
        let eye = DVec3::new(0.7, 1.2, 10.0);
        assert_eq!(cast(&heights, 1.0, eye, -DVec3::Z).map(|hit| hit.t), Some(8.0));
        assert_eq!(cast(&heights, 2.0, eye, -DVec3::Z).map(|hit| hit.t), Some(6.0));
        assert_eq!(cast(&heights, 1.0, eye, DVec3::Z), None);
    }
}
