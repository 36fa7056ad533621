//! From a camera to rays, and the planes that they are sampled on.
//!
//! Every ray of a frame is `eye + s·D`, sampled at the same parameters `s`. `D` has length 1 along a *guide*, a direction
//! in the vertical plane of the view axis that is as level as the picture allows: samples of one `s` lie in a nearly
//! vertical plane, and a ray that is higher in the picture passes it nearly above the lower one. That is what makes
//! coherence provable (see [`crate::coherent::cast`]).

use glam::{DVec3, Vec3};
use terravision_common::camera::Camera;

/// Rays are at most this far from the guide, as long as the field of view allows.
const WIDEST_RAD: f64 = 60.0 / 180.0 * std::f64::consts::PI;
/// Beyond, rays are sampled more coarsely instead: `D` is never longer than one over this.
const LEAST_ALONG_GUIDE: f32 = 0.25;

/// A frame's rays.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    eye_in_world: DVec3,
    /// Direction through the centre of the upper left pixel, of depth 1, and its change per column and row.
    first: Vec3,
    per_column: Vec3,
    per_row: Vec3,
    guide: Vec3,
    /// Of a point relative to the eye: column times depth, row times depth, and depth.
    inverse: [Vec3; 3],
    /// Depth of a sample at s = 1 on the view axis.
    forward_along_guide: f32,
    focal_px: f32,
}

/// One ray: `eye + s·direction`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Per unit of s, world space.
    pub direction: Vec3,
    /// Metres along the view axis per unit of s.
    pub depth: f32,
}

impl View {
    /// The rays of a camera, which is valid ([`Camera::is_valid`]).
    #[must_use]
    pub fn new(camera: &Camera) -> Self {
        let [_, _, forward] = camera.axes_in_world();
        let at = |x: f64, y: f64| camera.ray_in_world(x + 0.5, y + 0.5);
        let first = at(0.0, 0.0);
        let [tan_x, tan_y] = camera.half_tangents();
        let half_diagonal = tan_x.hypot(tan_y).atan();
        // The steepest ray, whichever way the camera rolls, decides how far the guide tips down (or up).
        let steepest = camera.pitch_rad.sin().asin();
        let tip = (steepest.abs() + half_diagonal - WIDEST_RAD).clamp(0.0, steepest.abs()).copysign(steepest);
        // A camera past the vertical looks over its back: the guide lies on the view axis' side.
        let side = if camera.pitch_rad.cos() < 0.0 { -1.0 } else { 1.0 };
        let (sin, cos) = camera.heading_rad.sin_cos();
        let guide = DVec3::new(side * sin * tip.cos(), side * cos * tip.cos(), tip.sin());
        let (per_column, per_row) = (at(1.0, 0.0) - first, at(0.0, 1.0) - first);
        // Rows of the inverse of the matrix of these three, by Cramer's rule.
        let [column, row, depth] = [
            (per_row.cross(first), per_column),
            (first.cross(per_column), per_row),
            (per_column.cross(per_row), first),
        ]
        .map(|(normal, own)| (normal / normal.dot(own)).as_vec3());
        Self {
            eye_in_world: camera.eye(),
            first: first.as_vec3(),
            per_column: per_column.as_vec3(),
            per_row: per_row.as_vec3(),
            guide: guide.as_vec3(),
            inverse: [column, row, depth],
            forward_along_guide: forward.dot(guide) as f32,
            focal_px: camera.focal_px() as f32,
        }
    }

    /// The eye, world space.
    #[must_use]
    #[inline]
    pub fn eye_in_world(&self) -> DVec3 {
        self.eye_in_world
    }

    /// Pixels per metre at a depth of one metre.
    #[must_use]
    #[inline]
    pub fn focal_px(&self) -> f32 {
        self.focal_px
    }

    /// What a length on the view axis is in s.
    #[must_use]
    pub fn s_per_depth(&self) -> f32 {
        self.forward_along_guide
    }

    /// Direction of depth 1 through a pixel's centre.
    #[inline(always)]
    #[must_use]
    pub fn direction(&self, [x, y]: [u32; 2]) -> Vec3 {
        self.direction_at(x as f32, y as f32)
    }

    /// Direction of depth 1 through any point of the picture, in pixels from the centre of the upper left one.
    #[inline(always)]
    #[must_use]
    pub fn direction_at(&self, x: f32, y: f32) -> Vec3 {
        self.first + self.per_column * x + self.per_row * y
    }

    /// What a point relative to the eye is multiplied with to get its column times its depth, its row times its depth, and its
    /// depth. Columns and rows count from the centre of the upper left pixel.
    #[must_use]
    #[inline]
    pub fn inverse(&self) -> [Vec3; 3] {
        self.inverse
    }

    /// The direction along which all rays advance by the same length per unit of s.
    #[must_use]
    #[inline]
    pub fn guide(&self) -> Vec3 {
        self.guide
    }

    /// Directions of depth 1 change by this from column to column and from row to row.
    #[must_use]
    #[inline]
    pub fn steps(&self) -> [Vec3; 2] {
        [self.per_column, self.per_row]
    }

    /// The ray through a pixel's centre.
    #[inline(always)]
    #[must_use]
    pub fn ray(&self, pixel: [u32; 2]) -> Ray {
        let direction = self.direction(pixel);
        let depth = 1.0 / self.along(direction).unwrap_or_else(|least| least);
        Ray { direction: direction * depth, depth }
    }

    /// The ray through any point of the picture; `None` where rays advance by another length along the guide than others.
    #[inline(always)]
    #[must_use]
    pub(crate) fn ray_along(&self, x: f32, y: f32) -> Option<Ray> {
        let direction = self.direction_at(x, y);
        let depth = 1.0 / self.along(direction).ok()?;
        Some(Ray { direction: direction * depth, depth })
    }

    /// How far a direction goes along the guide, or as an error the least that is taken in its place.
    #[inline(always)]
    fn along(&self, direction: Vec3) -> Result<f32, f32> {
        let along = direction.dot(self.guide);
        let least = LEAST_ALONG_GUIDE * LEAST_ALONG_GUIDE * direction.length_squared();
        if along > 0.0 && along * along > least { Ok(along) } else { Err(least.sqrt()) }
    }
}

/// The parameters that rays are sampled at: a sampling interval apart, in voxels of the finest level that is at this distance.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Planes {
    s: Vec<f32>,
    /// By place ([`place`]) from `first_place` on, the first plane of this place or a later one.
    first: Vec<u32>,
    first_place: u32,
    /// Of each stretch of s, from `first_stretch` on, the side of the finest voxels in it.
    sides: Vec<f32>,
    first_stretch: u32,
}

/// How densely rays are sampled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sampling {
    /// Voxels from sample to sample on the view axis.
    pub interval_voxels: f32,
    /// Voxels that are smaller on screen are sampled as if they had this size, pixels. 0: every voxel by its own size.
    pub voxel_px: f32,
}

/// Voxels and where they are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Voxels {
    /// The parameters of their nearest and of their furthest point.
    pub range: [f32; 2],
    /// Their side, metres.
    pub side_m: f32,
}

/// log2 of the stretches of s per octave.
const LOG_STRETCHES: u32 = 3;
/// Stretches in all: 24 octaves from the nearest plane on.
const STRETCHES: usize = 24 << LOG_STRETCHES;
/// log2 of the places of planes per octave.
const LOG_PLACES: u32 = 7;

/// A number's octave and its place in it, in `1 << log` steps: grows with positive numbers.
#[inline(always)]
fn place(s: f32, log: u32) -> u32 {
    s.to_bits() >> (23 - log)
}

impl Planes {
    /// Most planes: 0.6 voxels apart, about as many as a ray through a thousand tiles of 16 cells takes.
    pub const MOST: usize = 1 << 15;

    /// Sets them for a view of voxels, out to parameter `far`.
    pub fn set(&mut self, view: &View, sampling: &Sampling, voxels: impl Iterator<Item = Voxels> + Clone, far: f32) {
        self.s.clear();
        let finest_m = voxels.clone().map(|voxels| voxels.side_m).fold(f32::INFINITY, f32::min);
        let per_m = f64::from(sampling.interval_voxels * view.s_per_depth());
        let growth = f64::from(sampling.interval_voxels * sampling.voxel_px / view.focal_px());
        if finest_m.is_finite() && per_m * f64::from(finest_m) > 0.0 {
            self.fill_sides((per_m * f64::from(finest_m)) as f32, voxels, finest_m);
            let mut scale = 1.0;
            // Past the last plane no ground would be found: rather fewer planes everywhere.
            while !self.fill(scale * per_m, scale * growth, far) {
                scale *= 2.0;
            }
        }
        self.index();
    }

    /// `nearest`: the parameter of the second plane.
    fn fill_sides(&mut self, nearest: f32, voxels: impl Iterator<Item = Voxels>, finest_m: f32) {
        self.first_stretch = place(nearest, LOG_STRETCHES);
        self.sides.clear();
        self.sides.resize(STRETCHES, f32::INFINITY);
        for Voxels { range: [from, to], side_m } in voxels {
            let (first, last) = (self.stretch(from), self.stretch(to));
            self.sides[first..=last.max(first)].iter_mut().for_each(|side| *side = side.min(side_m));
        }
        // Where nothing is any interval will do: that before it.
        let mut before = finest_m;
        for side in &mut self.sides {
            *side = if side.is_finite() { *side } else { before };
            before = *side;
        }
    }

    /// What is behind the eye is in the first stretch, NaN too.
    fn stretch(&self, s: f32) -> usize {
        (place(s.max(0.0), LOG_STRETCHES).saturating_sub(self.first_stretch) as usize).min(STRETCHES - 1)
    }

    /// Sets planes `per_m` of a voxel's side apart, `growth` of the parameter at least; whether all have found room.
    fn fill(&mut self, per_m: f64, growth: f64, far: f32) -> bool {
        self.s.clear();
        let mut s = 0.0f64;
        while s < f64::from(far) {
            if self.s.len() == Self::MOST {
                return false;
            }
            self.s.push(s as f32);
            let at = self.stretch(s as f32);
            let interval = |at: usize| (per_m * f64::from(self.sides[at])).max(growth * s);
            let mut step = interval(at);
            if at + 1 < STRETCHES && interval(at + 1) < step {
                // Not past where finer voxels begin.
                let end = f32::from_bits((self.first_stretch + at as u32 + 1) << (23 - LOG_STRETCHES));
                step = step.min((f64::from(end) - s).max(interval(at + 1)));
            }
            s += step;
        }
        true
    }

    /// Of each place, the first plane that is not before it.
    fn index(&mut self) {
        self.first.clear();
        self.first_place = self.s.get(1).map_or(0, |s| place(*s, LOG_PLACES));
        for (plane, s) in self.s.iter().enumerate() {
            let at = place(*s, LOG_PLACES).saturating_sub(self.first_place) as usize;
            while self.first.len() <= at {
                self.first.push(plane as u32);
            }
        }
        self.first.push(self.s.len() as u32);
    }

    /// The parameters, rising from 0.
    #[must_use]
    pub fn s(&self) -> &[f32] {
        &self.s
    }

    /// The first plane at or after a parameter.
    #[must_use]
    #[inline(always)]
    pub fn at_or_after(&self, s: f32) -> u32 {
        if s <= 0.0 {
            return 0;
        }
        // Planes of earlier places are before it, those of later ones after it: places never fall while numbers rise.
        let at = place(s, LOG_PLACES).saturating_sub(self.first_place) as usize;
        let Some(&[from, to]) = self.first.get(at..at + 2) else { return self.s.len() as u32 };
        from + self.s[from as usize..to as usize].partition_point(|&plane| plane < s) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn rays_are_those_of_the_camera_and_no_sample_is_far_from_the_last(
            heading in -7.0f64..7.0, pitch in -1.6f64..1.6, roll in -4.0f64..4.0, vfov in 0.1f64..1.4,
            x in 0u32..320, y in 0u32..240,
        ) {
            let camera = Camera {
                eye_in_world: [10.0, 20.0, 30.0], heading_rad: heading, pitch_rad: pitch, roll_rad: roll,
                vfov_rad: vfov, width: 320, height: 240, timestamp_nanos: 0,
            };
            let view = View::new(&camera);
            let wanted = camera.ray_in_world(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let ray = view.ray([x, y]);
            let found = (ray.direction / ray.depth).as_dvec3();
            prop_assert!((found - wanted).length() < 1e-5, "{found} {wanted}");
            prop_assert!(ray.direction.length() <= 1.001 / LEAST_ALONG_GUIDE && ray.depth > 0.0);
            prop_assert!(view.s_per_depth() > 0.49);
            let point = (wanted * 700.0).as_vec3();
            let [column, row, depth] = view.inverse().map(|of| of.dot(point));
            prop_assert!((depth - 700.0).abs() < 0.01, "{depth}");
            let off = [column / depth - x as f32, row / depth - y as f32];
            prop_assert!(off.iter().all(|off| off.abs() < 0.01), "{off:?}");
        }
    }

    #[test]
    fn planes_are_an_interval_apart_in_the_finest_voxels_at_their_distance() {
        let camera = Camera {
            eye_in_world: [0.0; 3],
            heading_rad: 0.0,
            pitch_rad: -0.2,
            roll_rad: 0.0,
            vfov_rad: 0.8,
            width: 640,
            height: 480,
            timestamp_nanos: 0,
        };
        let view = View::new(&camera);
        let mut planes = Planes::default();
        let per_depth = view.s_per_depth();
        // Coarser voxels further off, and a patch of fine ones among them.
        let patch = [22_000.0, 24_000.0];
        let voxels = [([-500.0, 3000.0], 10.0), ([2000.0, 60_000.0], 40.0), (patch, 10.0)];
        let voxels = voxels.map(|(range, side_m)| Voxels { range, side_m });
        let sampling = Sampling { interval_voxels: 0.6, voxel_px: 1.0 };
        planes.set(&view, &sampling, voxels.into_iter(), 100_000.0);
        let s = planes.s();
        assert!(s[0] == 0.0 && (s[1] / per_depth - 6.0).abs() < 1e-3);
        for pair in s.windows(2) {
            let (from, to) = (pair[0], pair[1]);
            let finest = voxels.iter().filter(|v| v.range[0] <= from && to <= v.range[1]).map(|v| v.side_m);
            let wanted = finest.fold(f32::INFINITY, f32::min).max(from / per_depth / view.focal_px());
            assert!((to - from) / per_depth <= 0.601 * wanted, "{from} {to}");
        }
        let wide = s.windows(2).filter(|pair| pair[1] - pair[0] > 20.0 * per_depth).count();
        assert!(wide > 500 && s.len() < 3500, "{wide} of {}", s.len());
        let at = planes.at_or_after(90_000.0) as usize;
        let grown = 90_000.0 / view.focal_px();
        assert!(((s[at + 1] - s[at]) / (0.6 * grown) - 1.0).abs() < 0.01);
        for at in (0..40_000).map(|n| n as f32 * 3.1) {
            assert_eq!(planes.at_or_after(at), s.partition_point(|&plane| plane < at) as u32, "{at}");
        }
        for (k, at) in s.iter().enumerate() {
            assert_eq!(planes.at_or_after(*at), k as u32);
        }
        // More planes than there is room for: fewer everywhere, but all the way.
        let finest = Voxels { range: [0.0, 1e6], side_m: 1.0 };
        planes.set(&view, &Sampling { voxel_px: 0.0, ..sampling }, std::iter::once(finest), 1e5);
        assert!(planes.s().len() <= Planes::MOST && *planes.s().last().unwrap() > 99_990.0);
        planes.set(&view, &sampling, std::iter::empty(), 1e5);
        assert_eq!((planes.s().len(), planes.at_or_after(3.0)), (0, 0));
    }
}
