//! The surface that a sweep draws of heights in place, one ray at a time.

use crate::model::{LevelDistances, Pyramid, Source, TileSource};
use crate::scene::{JUST_INSIDE, Scene};
use crate::view::Ray;
use glam::DVec2;

/// How much further a ray goes at least from facet to facet, as a share of its way and as such.
const LEAST_WAY: f64 = 1e-9;

/// A function of the point and of its distance from the eye.
pub(super) struct Plane<'a> {
    pub(super) scene: &'a Scene<'a>,
    pub(super) pyramid: &'a Pyramid,
    distances: &'a LevelDistances,
    /// The eye's place on the lattice.
    eye: DVec2,
}

impl<'a> Plane<'a> {
    /// The surface of a scene whose heights lie in the elevation pool.
    pub(super) fn new(scene: &'a Scene<'a>) -> Option<Self> {
        let (pyramid, distances) = scene.pyramid()?;
        let eye = scene.ground.shape().surface.lattice_of_way(DVec2::ZERO, scene.view.eye_in_world());
        Some(Self { scene, pyramid, distances, eye })
    }

    /// Where the ground under a ray is taken from.
    pub(super) fn source(&self, ray: &Ray, s: f32) -> Source {
        let away2 = (ray.direction * s).length_squared();
        self.pyramid.find(self.point(ray, f64::from(s)).to_array(), away2, self.distances)
    }

    /// The lattice point that a ray is over, within the ground.
    fn point(&self, ray: &Ray, s: f64) -> DVec2 {
        let end = DVec2::from_array(self.scene.ground.end().map(f64::from)) - JUST_INSIDE;
        (self.eye + self.per_s(ray) * s).clamp(DVec2::ZERO, end.max(DVec2::ZERO))
    }

    /// Where the ground at a lattice point is taken from, how high it is above the eye, metres, and the
    /// square of its distance, metres². The level goes by the distance and the height by the level, as
    /// where a sweep begins.
    pub(super) fn seen_at(&self, point: DVec2) -> (Source, f32, f32) {
        let surface = &self.scene.ground.shape().surface;
        let along = (point - self.eye) * surface.unit_m();
        let along2 = along.length_squared() as f32;
        let (mut away2, mut rise) = (along2, 0.0);
        for _ in 0..2 {
            if let Source::Tile(source) = self.pyramid.find(point.to_array(), away2, self.distances) {
                let height = self.pyramid.sample(&source, 0, point, away2, self.scene.heights);
                rise = height * self.pyramid.exaggeration() - self.scene.eye_height;
            }
            away2 = along2 + rise * rise;
        }
        (self.pyramid.find(point.to_array(), away2, self.distances), rise, away2)
    }

    /// Lattice units that a ray goes per unit of s.
    fn per_s(&self, ray: &Ray) -> DVec2 {
        ray.direction.truncate().as_dvec2() / self.scene.ground.shape().surface.unit_m()
    }

    /// A plane of the surface under a ray.
    pub(super) fn plane(&self, ray: &Ray, s: f64, source: &TileSource, plane: usize) -> f32 {
        let away2 = (ray.direction * s as f32).length_squared();
        self.pyramid.sample(source, plane, self.point(ray, s), away2, self.scene.heights)
    }

    /// How high a ray is above the surface, metres.
    pub(super) fn above(&self, ray: &Ray, s: f64, source: &TileSource) -> f64 {
        let height = self.plane(ray, s, source, 0) * self.pyramid.exaggeration();
        f64::from(self.scene.eye_height) - f64::from(height) + f64::from(ray.direction.z) * s
    }

    /// The next edge of a facet under a ray.
    pub(super) fn next_edge(&self, ray: &Ray, s: f64, source: &TileSource) -> f64 {
        let per_cell = 1.0 / f64::from(1u32 << source.level);
        let corner = DVec2::from_array(source.origin.map(f64::from));
        let at = (self.eye + self.per_s(ray) * s - corner) * per_cell;
        let by = self.per_s(ray) * per_cell;
        let to_whole = |at: f64, by: f64| match by {
            by if by > 0.0 => (at.floor() + 1.0 - at) / by,
            by if by < 0.0 => (at.ceil() - 1.0 - at) / by,
            _ => f64::INFINITY,
        };
        let way = to_whole(at.x, by.x).min(to_whole(at.y, by.y)).min(to_whole(at.x - at.y, by.x - by.y));
        s + way.max(s * LEAST_WAY + LEAST_WAY)
    }
}
