//! The planes of a sector, sixteen at a time, and how far apart they are sampled outwards.

use super::SweepDetail;
use super::sector::{Row, Sector};
use crate::scene::Scene;
use glam::Vec2;
use terravision_common::simd::{LANES, Sixteen};

/// The first step is this share of the finest spacing away from the eye's foot, if ground may be
/// seen there.
const NEAREST: f32 = 1.0 / 64.0;

/// Sixteen neighboring planes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Block {
    /// Directions on the ground, of length 1.
    pub(super) east: Sixteen<f32>,
    pub(super) north: Sixteen<f32>,
    /// Of a point a metre away at the eye's height: height above the middle of the picture, and
    /// depth, on the plane of depth 1.
    pub(super) rise: Sixteen<f32>,
    pub(super) depth: Sixteen<f32>,
    /// Rows of the sector in which pixels are beside their lines.
    pub(super) rows: [f32; 2],
    /// Slopes along the lower edge of the first of them, and along the upper edge of the last.
    pub(super) lowest: Sixteen<f32>,
    pub(super) highest: Sixteen<f32>,
    /// Where the ground begins and ends, metres from the eye.
    pub(super) begin: Sixteen<f32>,
    pub(super) end: Sixteen<f32>,
    /// Whether there is any, of each plane.
    pub(super) has_ground: [bool; LANES],
}

/// A step outwards.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step {
    /// Metres from the eye along the ground.
    pub(super) distance: f32,
    /// One over it.
    pub(super) nearness: f32,
}

/// A sector that is ready to be swept. Memory is used again.
#[derive(Debug, Default)]
pub(super) struct Fan {
    pub(super) sector: Option<Sector>,
    pub(super) rows: Vec<Row>,
    pub(super) blocks: Vec<Block>,
    pub(super) steps: Vec<Step>,
    /// Whether edges of ground are looked for.
    pub(super) finds_edges: bool,
}

impl Fan {
    /// Takes memory for pictures of this size in any attitude, if it is not there.
    pub(super) fn reserve(&mut self, scene: &Scene<'_>, size: [u32; 2], detail: &SweepDetail) {
        let longest = size[0].max(size[1]);
        reserve(&mut self.rows, longest as usize);
        // Where lines are widest apart, a sector is as wide as the picture, and leans by at most its
        // height to both sides.
        let lines = 4.0 * longest as f32 * detail.lines_per_px;
        reserve(&mut self.blocks, lines as usize / LANES + 2);
        // Equal steps near the eye, growing ones beyond.
        let per_e = scene.view.focal_px() / detail.step_px;
        let equal = detail.of_spacing * finest_spacing(scene);
        let octaves = (scene.far / (equal * per_e)).max(1.0).ln();
        let steps = per_e * (2.0 + octaves);
        if steps.is_finite() {
            reserve(&mut self.steps, steps as usize + 3);
        }
    }

    /// Makes the planes and steps of a sector.
    pub(super) fn set(&mut self, sector: Sector, rows: &[Row], scene: &Scene<'_>, detail: &SweepDetail) {
        self.sector = Some(sector);
        self.finds_edges = detail.has_soft_edges;
        self.rows.clear();
        self.rows.extend_from_slice(rows);
        self.blocks.clear();
        for first in (0..sector.lines).step_by(LANES) {
            self.blocks.push(Block::new(&sector, rows, first, scene));
        }
        self.set_steps(scene, detail);
    }

    fn set_steps(&mut self, scene: &Scene<'_>, detail: &SweepDetail) {
        self.steps.clear();
        let (mut lowest, mut far, mut near) = (f32::INFINITY, 0.0f32, f32::INFINITY);
        for block in &self.blocks {
            for k in (0..LANES).filter(|k| block.has_ground[*k]) {
                lowest = lowest.min(block.lowest[k]);
                far = far.max(block.end[k]);
                near = near.min(block.begin[k]);
            }
        }
        let spacing = finest_spacing(scene);
        if near >= far || !spacing.is_finite() {
            return;
        }
        let focal = scene.view.focal_px();
        // How far the eye is above all ground: nothing is nearer.
        let above = (-scene.highest).max(0.0);
        let mut distance = first_distance(scene, lowest).max(near).max(NEAREST * spacing);
        while distance < far {
            self.steps.push(Step { distance, nearness: 1.0 / distance });
            let away = (distance * distance + above * above).sqrt();
            distance += (detail.of_spacing * spacing).max(detail.step_px * away / focal);
        }
        // Of the furthest plane the last step lies on the border.
        self.steps.push(Step { distance: far, nearness: 1.0 / far });
    }
}

/// Room for this many.
fn reserve<T>(list: &mut Vec<T>, count: usize) {
    list.reserve(count.saturating_sub(list.len()));
}

/// Metres from post to post where they are densest; infinite without ground.
fn finest_spacing(scene: &Scene<'_>) -> f32 {
    scene.ground.tiles().iter().fold(f32::INFINITY, |finest, tile| finest.min(tile.spacing_m))
}

/// Ground nearer than this is below all lines of sight, of which none is lower than this slope.
fn first_distance(scene: &Scene<'_>, lowest: f32) -> f32 {
    if lowest >= 0.0 || scene.highest >= 0.0 {
        return 0.0;
    }
    let mut distance = scene.highest / lowest;
    for _ in 0..80 {
        let further = distance * 1.1;
        let square = crate::scene::Bounds { min: Vec2::splat(-further), max: Vec2::splat(further) };
        if scene.rises_above(lowest * further, square, [0.0, 1.5 * further]) {
            break;
        }
        distance = further;
    }
    distance
}

impl Block {
    fn new(sector: &Sector, rows: &[Row], first: usize, scene: &Scene<'_>) -> Self {
        let seen = sector.rows_of_lines(rows, first, first + LANES - 1);
        let mut block = Self {
            east: [0.0; LANES],
            north: [0.0; LANES],
            rise: [0.0; LANES],
            depth: [0.0; LANES],
            rows: seen.map(|row| row as f32),
            lowest: [0.0; LANES],
            highest: [0.0; LANES],
            begin: [0.0; LANES],
            end: [0.0; LANES],
            has_ground: [false; LANES],
        };
        for k in 0..LANES {
            let plane = sector.plane(first + k, seen);
            let direction = plane.direction.as_vec2();
            let [begin, end] = scene.ground_along(direction);
            [block.east[k], block.north[k]] = direction.to_array();
            block.rise[k] = plane.rise as f32;
            block.depth[k] = plane.depth as f32;
            [block.lowest[k], block.highest[k]] = plane.slopes.map(|slope| slope as f32);
            block.begin[k] = begin;
            block.end[k] = end;
            block.has_ground[k] = begin < end && seen[0] < seen[1];
        }
        // Planes without ground follow one that has some, so that they cost nothing.
        if let Some(other) = (0..LANES).find(|k| block.has_ground[*k]) {
            for k in 0..LANES {
                if block.has_ground[k] {
                    continue;
                }
                block.east[k] = block.east[other];
                block.north[k] = block.north[other];
                block.begin[k] = block.begin[other];
                block.end[k] = block.end[other];
            }
        }
        block
    }
}
