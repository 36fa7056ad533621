//! Columns and rows of a body's leaves, as the device has them: terms that are made for an eye, once for
//! all leaves that share them.

use crate::gpu::TileParameters;
use std::collections::HashMap;
use terravision_common::camera::Camera;
use terravision_common::slot::TileSlot;
use terravision_common::surface::PostLine;
use terravision_common::surface::globe::GlobeEye;
use terravision_common::world::World;

/// The terms of a frame; keeps its buffers.
#[derive(Debug, Default)]
pub(super) struct DeviceTerms {
    eye: Option<GlobeEye>,
    numbers: Vec<f32>,
    columns: HashMap<PostLine, i32>,
    rows: HashMap<PostLine, i32>,
}

impl DeviceTerms {
    /// Begins a frame.
    pub(super) fn clear(&mut self) {
        self.numbers.clear();
    }

    /// All of them, for the shader.
    pub(super) fn numbers(&self) -> &[f32] {
        &self.numbers
    }

    /// Begins with a view of a body; nothing of a plane.
    pub(super) fn look(&mut self, world: &World, camera: &Camera) {
        self.columns.clear();
        self.rows.clear();
        self.eye = world.globe().map(|globe| globe.eye(camera.eye()));
    }

    /// Completes the parameters of a tile of a body; leaves those of a plane as they are.
    pub(super) fn place(&mut self, world: &World, tile: &TileSlot, parameters: &mut TileParameters) {
        let (Some(globe), Some(eye), Some(node)) = (world.globe(), self.eye, tile.node()) else { return };
        let surface = world.surface();
        let leaf = surface.post_lines(surface.ancestor(node, tile.elevation_level));
        let color = surface.post_lines(surface.ancestor(node, tile.color_level));
        let [columns, rows] = leaf;
        let numbers = &mut self.numbers;
        let posts = |line: PostLine| {
            (0..=line.cells()).map(move |index| (line.post(index).cast_unsigned(), line.in_posts(index)))
        };
        let first_column = *self.columns.entry(columns).or_insert_with(|| {
            let first = numbers.len() as i32;
            for (column, at) in posts(columns) {
                numbers.extend(globe.eye_column(&eye, column).numbers());
                numbers.push(at);
            }
            first
        });
        let first_row = *self.rows.entry(rows).or_insert_with(|| {
            let first = numbers.len() as i32;
            for (row, at) in posts(rows) {
                numbers.extend(globe.eye_row(&eye, row).numbers());
                numbers.push(at);
            }
            first
        });
        parameters.origin_from_cell = [first_column, first_row];
        let [_, east, south, north] = surface.edge_posts(surface.ancestor(node, tile.elevation_level));
        let middle = if south > 0 { 128 | south } else { north };
        parameters.level_and_snap = parameters.level_and_snap & 0x00ff_ff00 | east | middle << 24;
        // A colour tile begins at a post of the leaf, or before it by as many as a whole number.
        parameters.color_origin_from_cell =
            [0, 1].map(|axis| ((color[axis].origin() - leaf[axis].origin()) >> leaf[axis].log_step()) as i32);
        let scale = |axis: usize| {
            let cells = f64::from(leaf[axis].cells()) * f64::from(1u32 << color[axis].log_step());
            let tiles_per_post = f64::from(1u32 << leaf[axis].log_step()) / cells;
            (tiles_per_post * f64::from(world.color_tile()) / f64::from(world.color_stored())) as f32
        };
        (parameters.color_scale, parameters.color_scale_north) = (scale(0), scale(1));
    }
}
