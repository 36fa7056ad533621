//! The mesh technique: each colour leaf is a block of its elevation leaf's array, drawn as triangles.

use super::view::view_parameters;
use super::{ArrayPlaces, Technique, TechniqueError, outline_of};
use crate::frame::Frame;
use crate::gpu::{
    Block, ColorPool, Elevation, GpuError, Recording, Sides, Target, TerrainPass, TerrainView, TileParameters,
    ViewParameters,
};
use terravision_common::camera::Camera;
use terravision_common::rig::MAX_VIEWS;
use terravision_common::run::TechniqueChoice;
use terravision_common::slot::TileSlot;
use terravision_common::surface::EyeCell;
use terravision_common::world::World;

/// Added to the mip level of colour sampling. The tree already chooses tiles whose texels are about `r_c` pixels, so the
/// hardware's choice among three mips matters at the far ends of a tile only. 0 is the textbook value; negative is
/// sharper and flickers.
pub const LOD_BIAS: f32 = 0.0;
/// Anisotropy on hardware devices (never on the processor's): the tree's measure is by area, so texels at glancing
/// angles are too coarse along the line of sight and too fine across it by up to about this ratio.
pub const MAX_ANISOTROPY: f32 = 8.0;

/// Draws tiles as triangle meshes.
#[derive(Debug)]
pub struct MeshTechnique {
    pass: TerrainPass,
    world: World,
    views: Vec<MeshView>,
    /// The tiles of all views: as seen from one eye after the other.
    tiles: Vec<TileParameters>,
    blocks: Vec<Block>,
    triangles: u64,
}

/// A view of the frame.
#[derive(Debug, Clone, Copy)]
struct MeshView {
    parameters: ViewParameters,
    sides: Sides,
    /// The lattice cell of its eye.
    cell: EyeCell,
    /// Its first tile.
    first_tile: usize,
}

impl MeshTechnique {
    /// For pictures like those of `target`, and this many frame slots. `has_overlay`: outlines of the colour leaves.
    ///
    /// # Errors
    /// The device is out of memory.
    pub fn new(
        colors: &ColorPool,
        target: &Target,
        world: &World,
        has_overlay: bool,
        slots: usize,
    ) -> Result<Self, GpuError> {
        Ok(Self {
            pass: TerrainPass::new(colors, target, world, has_overlay, slots)?,
            world: *world,
            views: Vec::with_capacity(MAX_VIEWS),
            tiles: Vec::with_capacity(4096),
            blocks: Vec::with_capacity(4096),
            triangles: 0,
        })
    }
}

impl Technique for MeshTechnique {
    fn name(&self) -> &'static str {
        TechniqueChoice::Mesh.name()
    }

    fn prepare(
        &mut self,
        recording: &mut Recording<'_>,
        frame: &Frame,
        elevation: &Elevation,
        places: ArrayPlaces<'_>,
    ) -> Result<(), TechniqueError> {
        self.views.clear();
        self.tiles.clear();
        self.blocks.clear();
        let datum_m = self.world.surface().height_m(frame.pose.eye());
        for view in frame.views.iter() {
            let (parameters, cell) = view_parameters(&view.camera, &self.world, datum_m);
            let sides = visible_sides(&view.camera, &self.world);
            // Eyes in one cell see the same tiles.
            let seen =
                self.views.iter().find(|before| before.cell.corner == cell.corner).map(|before| before.first_tile);
            let first_tile = seen.unwrap_or(self.tiles.len());
            self.views.push(MeshView { parameters, sides, cell, first_tile });
            if seen.is_none() {
                self.tiles.extend(
                    drawn_tiles(frame, places).map(|(tile, start)| tile_parameters(tile, &self.world, cell, start)),
                );
            }
        }
        self.blocks.extend(drawn_tiles(frame, places).map(|(tile, _)| block(tile)));
        let triangles = |Block { size, snap, .. }: &Block| 2 * u64::from(size[0] >> snap) * u64::from(size[1] >> snap);
        self.triangles = frame.views.len() as u64 * self.blocks.iter().map(triangles).sum::<u64>();
        Ok(self.pass.prepare(recording, elevation, &self.tiles)?)
    }

    fn draw(&self, view: usize, recording: &mut Recording<'_>, colors: &ColorPool, is_depth_only: bool) {
        let Some(MeshView { parameters, sides, first_tile, .. }) = self.views.get(view) else { return };
        let (blocks, sides, first_tile) = (&self.blocks[..], *sides, *first_tile);
        self.pass.draw(recording, colors, &TerrainView { parameters, blocks, first_tile, sides, is_depth_only });
    }

    fn triangles(&self) -> u64 {
        self.triangles
    }
}

/// Which sides of the ground the eye can see. Ground is a height field: an eye over it sees the upper side first along
/// any ray, so the lower one (the far slopes of ridges, from behind) need not be drawn: a fifth of the time in mountains.
/// An eye beside the world may look under its edge, and any eye through holes.
fn visible_sides(camera: &Camera, world: &World) -> Sides {
    if world.surface().is_over(camera.eye()) && !world.has_holes() { Sides::Upper } else { Sides::Both }
}

/// The tiles that are drawn, each with the first value of its elevation array.
fn drawn_tiles<'a>(frame: &'a Frame, places: ArrayPlaces<'a>) -> impl Iterator<Item = (&'a TileSlot, u32)> {
    frame.tiles.iter().filter(|tile| tile.is_hidden == 0).filter_map(move |tile| {
        let array = tile.elevation_position.wrapping_sub(frame.elevation_start) as usize;
        // `FrameReader` checked that every tile's array is one of the frame's.
        Some((tile, *places.starts.get(array)?))
    })
}

fn block(tile: &TileSlot) -> Block {
    let start = tile.start.map(u32::from);
    let size = [0, 1].map(|axis| u32::from(tile.end[axis]) - start[axis]);
    Block { start, size, snap: tile.grid_snap.into() }
}

fn tile_parameters(tile: &TileSlot, world: &World, cell: EyeCell, array_start: u32) -> TileParameters {
    let relative = |origin: [u32; 2]| [0, 1].map(|axis| cell.count(axis, origin[axis]));
    let texels_per_unit = f64::from(world.color_tile()) / world.node_side(tile.color_level) as f64;
    let [west, east, south, north] = tile.edge_snap.map(u32::from);
    let pair = |v: [u16; 2]| u32::from(v[0]) | u32::from(v[1]) << 16;
    TileParameters {
        origin_from_cell: relative(tile.elevation_origin),
        color_origin_from_cell: relative(tile.color_origin),
        array_start,
        level_and_snap: u32::from(tile.elevation_level) | west << 8 | east << 12 | south << 16 | north << 20,
        color_scale: (texels_per_unit / f64::from(world.color_stored())) as f32,
        color_layer: tile.color_slot,
        block_start: pair(tile.start),
        block_end: pair(tile.end),
        outline: outline_of(tile),
        reserved: 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use terravision_testkit::worlds;

    #[test]
    fn a_slot_becomes_parameters_relative_to_the_eyes_cell() {
        let world = worlds::world([256; 2], 10.0, [32, 256]);
        let tile = TileSlot {
            elevation_origin: [64, 0],
            color_origin: [64, 0],
            elevation_level: 1,
            color_level: 1,
            edge_snap: [1, 2, 3, 0],
            start: [0, 16],
            end: [16, 32],
            color_slot: 7,
            ..TileSlot::zeroed()
        };
        let made = tile_parameters(&tile, &world, EyeCell { corner: [70, -5], eye_m: [0.0; 2] }, 99);
        assert_eq!(made.origin_from_cell, [-6, 5]);
        assert_eq!(made.level_and_snap, 1 | 1 << 8 | 2 << 12 | 3 << 16);
        assert_eq!((made.array_start, made.color_layer), (99, 7));
        assert_eq!((made.block_start, made.block_end), (16 << 16, 16 | 32 << 16));
        // The tile's 64 lattice units are 256 of its 264 stored texels.
        assert!((made.color_scale * 64.0 - 256.0 / 264.0).abs() < 1e-6);
    }
}
