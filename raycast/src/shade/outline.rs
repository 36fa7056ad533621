//! Outlines of tiles over a drawn picture, computed from depth alone, so that they are the same for
//! all methods.

use crate::picture::Picture;
use crate::scene::Scene;
use crate::workers::Workers;
use glam::{Vec2, Vec3, Vec4};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Rows that one worker takes at a time: a hundredth of a picture of 720 rows, so that no worker
/// waits long for the last one.
const ROWS_AT_A_TIME: usize = 8;
/// Inwards from a tile's edge, the line is opaque for one pixel and fades over another; together
/// with the neighbour's line it is about three pixels wide, as in the mesh
/// (`renderer/shaders/mesh.wgsl`).
const WIDTH_PX: f32 = 2.0;
/// How much of the ground's colour a line hides: as in the mesh.
const OPACITY: f32 = 0.85;
/// Lower bound of the cosine between a facet's normal and a ray: a pixel of a facet that is more
/// nearly edge on spans the whole tile.
const LEAST_FACING: f32 = 1e-3;

/// Draws the outlines of tiles over a picture of this scene. `outlines`: the colour of each tile,
/// RGBA8, red in the lowest byte; a tile without a colour has no outline.
pub(crate) fn draw(scene: &Scene<'_>, outlines: &[u32], picture: &Picture, workers: &Workers) {
    let outliner = Outliner { scene, outlines };
    let height = picture.size()[1] as usize;
    let next = AtomicUsize::new(0);
    workers.run(|_worker| {
        loop {
            // Relaxed: the result does not depend on which worker takes which rows.
            let first = next.fetch_add(ROWS_AT_A_TIME, Ordering::Relaxed);
            if first >= height {
                return 0;
            }
            for y in first..height.min(first + ROWS_AT_A_TIME) {
                for ((color, depth), x) in picture.row(y).zip(0..) {
                    let pixel = [x, y as u32];
                    if let Some((outline, cover)) = outliner.at(pixel, depth) {
                        picture.put(pixel, mix(color, outline, cover), depth);
                    }
                }
            }
        }
    });
}

struct Outliner<'a> {
    scene: &'a Scene<'a>,
    outlines: &'a [u32],
}

impl Outliner<'_> {
    /// Colour of the outline at a pixel of this depth, and the share of the pixel that it covers.
    fn at(&self, pixel: [u32; 2], depth: f32) -> Option<(u32, f32)> {
        if depth.is_nan() {
            return None;
        }
        let direction = self.scene.view.direction(pixel);
        let point = direction.truncate() * depth;
        let index = self.scene.tile_at_point(point)? as usize;
        let (tile, placed) = (self.scene.ground.tiles().get(index)?, self.scene.placed.get(index)?);
        let outline = *self.outlines.get(index)?;
        let at = (point - placed.corner.truncate()) * placed.per_m;
        let cells = Vec2::new(tile.cells[0] as f32, tile.cells[1] as f32);
        let normal = (-self.scene.slope_at(index as u32, point)).extend(1.0);
        let toward = normal.dot(direction);
        let facing = toward.abs().max(LEAST_FACING).copysign(toward);
        // The step on the facet from this pixel to the next one, cells.
        let [column, row] = self.scene.view.steps().map(|step: Vec3| {
            let on_facet = step - direction * (normal.dot(step) / facing);
            on_facet.truncate() * depth * placed.per_m
        });
        let per_pixel = (column.abs() + row.abs()).max(Vec2::splat(1e-9));
        let from_edge = (at.min(cells - at) / per_pixel).min_element();
        let cover = (WIDTH_PX - from_edge).clamp(0.0, 1.0);
        (cover > 0.0).then_some((outline, cover))
    }
}

/// A colour over another one, with this coverage.
fn mix(under: u32, over: u32, cover: f32) -> u32 {
    let [under, over] = [under, over].map(|color| Vec4::from_array(color.to_le_bytes().map(f32::from)));
    let mixed = under + (over - under) * (OPACITY * cover);
    u32::from_le_bytes(mixed.to_array().map(|channel| (channel + 0.5) as u8))
}
