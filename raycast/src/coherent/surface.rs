//! Finds the intersection of a ray with the surface, once samples have found it: between two
//! samples, on the border of the ground, or at the top of a hill that is narrower than a sampling
//! interval.

use super::voxels::{Current, cell};
use super::walk::VoxelRays;
use crate::counts::Counts;
use crate::model::THRESHOLD;
use crate::scene::Place;
use crate::view::Ray;
use glam::Vec3;

/// A sample in the ground.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sample {
    pub(crate) plane: u32,
    /// Its density, if it was sampled.
    pub(crate) inside: Option<f32>,
    /// The density of the sample before, if it was sampled.
    pub(crate) outside: Option<f32>,
    /// The interval between the sample before, which is in the air, and this one, which may be in
    /// the air too, in which the ray crosses the surface.
    pub(crate) crossing: Option<[Point; 2]>,
}

/// A point of a ray: its parameter and the density there.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Point {
    s: f32,
    density: f32,
}

/// How often a sampling interval is halved in search of the top of a hill: ground narrower than an
/// eighth of the interval is missed.
const HALVINGS: u32 = 3;
/// Share of a ray's length up to where it leaves the ground's bounds, so that after rounding the
/// point is still within them.
const JUST_BEFORE: f32 = 1.0 - 1e-6;

impl VoxelRays<'_> {
    /// Looks for ground between plane `k` and the plane before, when the ray is in the air at both:
    /// the top of a hill that is narrower than a sampling interval. Without this, silhouettes show
    /// the planes as steps. `densities`: at both planes, at least one of them known.
    #[inline(always)]
    pub(crate) fn between<const APPROXIMATE: bool>(
        &self,
        ray: &Ray,
        k: usize,
        densities: [Option<f32>; 2],
        fall_per_s: f32,
        current: &Current<'_>,
        counts: &mut Counts,
    ) -> Option<Sample> {
        // `fall` says the same, but this is known at compile time and costs nothing.
        if APPROXIMATE {
            return None;
        }
        let s = [self.planes.s()[k - 1], self.planes.s()[k]];
        let fall = fall_per_s * (s[1] - s[0]);
        // An unknown density counts as air.
        let [from, to] = densities.map(|density| density.unwrap_or(THRESHOLD));
        if from + to + fall <= 2.0 * THRESHOLD {
            return None;
        }
        self.between_near::<APPROXIMATE>(ray, k, densities, fall, current, counts)
    }

    #[inline(never)]
    fn between_near<const APPROXIMATE: bool>(
        &self,
        ray: &Ray,
        k: usize,
        densities: [Option<f32>; 2],
        fall: f32,
        current: &Current<'_>,
        counts: &mut Counts,
    ) -> Option<Sample> {
        let mut points = [Point { s: 0.0, density: 0.0 }; 2];
        for (at, point) in points.iter_mut().enumerate() {
            let s = self.planes.s()[k - 1 + at];
            let density = densities[at].or_else(|| self.density_at::<APPROXIMATE>(ray, s, current))?;
            *point = Point { s, density };
        }
        let crossing = self.crossing::<APPROXIMATE>(ray, points, fall, HALVINGS, current, counts)?;
        Some(Sample { plane: k as u32, inside: None, outside: None, crossing: Some(crossing) })
    }

    /// The first place between two points in the air at which a ray enters the ground, as a point
    /// before it and a point after it. `fall`: the largest change of density from one point to the
    /// other.
    fn crossing<const APPROXIMATE: bool>(
        &self,
        ray: &Ray,
        [from, to]: [Point; 2],
        fall: f32,
        halvings: u32,
        current: &Current<'_>,
        counts: &mut Counts,
    ) -> Option<[Point; 2]> {
        if halvings == 0 || from.density + to.density + fall <= 2.0 * THRESHOLD {
            return None;
        }
        counts.samples += 1;
        let s = 0.5 * (from.s + to.s);
        let middle = Point { s, density: self.density_at::<APPROXIMATE>(ray, s, current)? };
        if middle.density > THRESHOLD {
            return Some([from, middle]);
        }
        let mut half =
            |points| self.crossing::<APPROXIMATE>(ray, points, 0.5 * fall, halvings - 1, current, &mut *counts);
        half([from, middle]).or_else(|| half([middle, to]))
    }

    /// Whether a ray without a sample in the ground before `plane` is in the ground where it leaves
    /// the ground's bounds: planes do not lie on the border.
    #[inline(always)]
    pub(crate) fn at_border<const APPROXIMATE: bool>(
        &self,
        ray: &Ray,
        plane: u32,
        current: &Current<'_>,
        counts: &mut Counts,
    ) -> Option<Sample> {
        let s = self.scene.departure(ray) * JUST_BEFORE;
        if !(s.is_finite() && s * ray.direction.z < self.scene.highest) {
            return None;
        }
        let after = self.planes.at_or_after(s);
        if after > plane || after == 0 {
            return None;
        }
        counts.samples += 1;
        let before = self.planes.s()[after as usize - 1];
        let point = |s: f32| self.density_at::<APPROXIMATE>(ray, s, current).map(|density| Point { s, density });
        let points = [point(before)?, point(s)?];
        let crossing = if points[1].density > THRESHOLD {
            Some(points)
        } else {
            let fall = self.fall * ray.direction.length() * current.per_m * (s - before);
            self.crossing::<APPROXIMATE>(ray, points, fall, HALVINGS, current, counts)
        };
        crossing.map(|crossing| Sample { plane: after, inside: None, outside: None, crossing: Some(crossing) })
    }

    /// The tile at a parameter of a ray: the current one or a neighbour.
    #[inline(always)]
    pub(crate) fn tile_at(&self, ray: &Ray, s: f32, current: &Current<'_>) -> u32 {
        if current.is_over(current.at(ray.direction * current.per_m, s)) {
            return current.index;
        }
        match self.scene.find(ray, s) {
            Place::Tile(tile) => tile,
            Place::HoleUntil(_) | Place::Left => current.index,
        }
    }

    /// The intersection before a sample in the ground: the last plane in the air, and the parameter
    /// between it and the next plane, interpolated from the two densities.
    #[inline(always)]
    pub(crate) fn refined<const APPROXIMATE: bool>(
        &self,
        ray: &Ray,
        sample: Sample,
        current: &Current<'_>,
        counts: &mut Counts,
    ) -> (u32, f32) {
        let planes = self.planes.s();
        let mut plane = sample.plane as usize;
        if let Some([from, to]) = sample.crossing {
            return (sample.plane - 1, surface_between(from, to));
        }
        let density = |plane: usize| self.density_at::<APPROXIMATE>(ray, planes[plane], current);
        let mut here = sample.inside;
        let mut before = sample.outside;
        while plane > 0 {
            before = before.or_else(|| density(plane - 1));
            let Some(outside) = before else { break };
            if outside <= THRESHOLD {
                let inside = here.or_else(|| density(plane)).unwrap_or(255.0);
                let from = Point { s: planes[plane - 1], density: outside };
                let to = Point { s: planes[plane], density: inside };
                // If rays look between samples, the next ray has to look between the last sample in
                // the air and the one after it.
                return (plane as u32 - u32::from(self.looks_between()), surface_between(from, to));
            }
            counts.steps_back += 1;
            plane -= 1;
            (here, before) = (before, None);
        }
        (plane as u32, planes[plane])
    }

    #[inline(always)]
    fn looks_between(&self) -> bool {
        self.fall.is_finite()
    }

    /// Density at a parameter of a ray that is in a tile or near it; `None` where there is no
    /// ground.
    #[inline(always)]
    fn density_at<const APPROXIMATE: bool>(&self, ray: &Ray, s: f32, current: &Current<'_>) -> Option<f32> {
        let at = current.at(ray.direction * current.per_m, s);
        if current.is_over(at) {
            Some(Self::density_in::<APPROXIMATE>(current, at))
        } else {
            self.density_elsewhere::<APPROXIMATE>(ray, s)
        }
    }

    #[inline(never)]
    fn density_elsewhere<const APPROXIMATE: bool>(&self, ray: &Ray, s: f32) -> Option<f32> {
        let Place::Tile(tile) = self.scene.find(ray, s) else { return None };
        let current = self.enter(tile)?;
        let mut at = current.at(ray.direction * current.per_m, s);
        let inside = |at: f32, cells: u32| at.clamp(0.01, cells as f32 - 0.01);
        (at.x, at.y) = (inside(at.x, current.cells[0]), inside(at.y, current.cells[1]));
        Some(Self::density_in::<APPROXIMATE>(&current, at))
    }

    #[inline(always)]
    fn density_in<const APPROXIMATE: bool>(current: &Current<'_>, at: Vec3) -> f32 {
        let ((i, low_u), (j, low_v)) = (cell(at.x), cell(at.y));
        if APPROXIMATE || !current.is_accurate {
            return current.density_by_height([i, j], [low_u, low_v], at);
        }
        current.density([i, j], [low_u, low_v], at)
    }
}

/// The parameter of the surface between a point in the air and one in the ground.
#[inline(always)]
fn surface_between(from: Point, to: Point) -> f32 {
    let share = (THRESHOLD - from.density) / (to.density - from.density).max(1e-3);
    from.s + (to.s - from.s) * share.clamp(0.0, 1.0)
}
