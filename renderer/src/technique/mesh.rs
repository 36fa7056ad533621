//! The mesh technique: each colour leaf is a block of its elevation leaf's array, drawn as
//! triangles.

use super::device_terms::DeviceTerms;
use super::view_parameters::view_parameters;
use super::{ArrayPlaces, Draw, DrawError, Technique, outline_of};
use crate::frame::{Frame, FrameError, TileFault};
use crate::gpu::{
    Block, ColorPool, Elevation, FrameRecording, GpuError, Sides, Target, TerrainPass, TerrainView, TileParameters,
    ViewParameters,
};
use std::ops::Range;
use terravision_common::camera::Camera;
use terravision_common::rig::MAX_VIEWS;
use terravision_common::run::TechniqueChoice;
use terravision_common::slot::TileSlot;
use terravision_common::surface::EyeCell;
use terravision_common::world::World;

/// Added to the mip level of colour sampling. The tree already chooses tiles whose texels are about
/// `r_c` pixels, so the hardware's choice among three mips matters at the far ends of a tile only.
/// 0 is the textbook value; negative is sharper and flickers.
pub const LOD_BIAS: f32 = 0.0;
/// Anisotropy on hardware devices (never on the processor's): the tree's measure is by area, so
/// texels at glancing angles are too coarse along the line of sight and too fine across it by up to
/// about this ratio.
pub const MAX_ANISOTROPY: f32 = 8.0;

/// Draws tiles as triangle meshes.
#[derive(Debug)]
pub struct MeshTechnique {
    pass: TerrainPass,
    world: World,
    views: Vec<MeshView>,
    /// All tiles of the frame, as seen from one eye after the other.
    tiles: Vec<TileParameters>,
    /// What is drawn of them, one draw after the other.
    blocks: Vec<(u32, Block)>,
    draws: Vec<MeshDraw>,
    /// Terms of columns and rows, of a body.
    terms: DeviceTerms,
}

/// A draw of the frame.
#[derive(Debug, Clone)]
struct MeshDraw {
    view: usize,
    /// Of the technique's blocks.
    blocks: Range<usize>,
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
    /// For pictures like those of `target`, and this many frame slots. `has_overlay`: outlines of
    /// the colour leaves.
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
            draws: Vec::with_capacity(MAX_VIEWS),
            terms: DeviceTerms::default(),
        })
    }
}

impl Technique for MeshTechnique {
    fn choice(&self) -> TechniqueChoice {
        TechniqueChoice::Mesh
    }

    fn wants_unseen(&self) -> bool {
        false
    }

    fn prepare(
        &mut self,
        recording: &mut FrameRecording<'_>,
        frame: &Frame,
        draws: &mut dyn Iterator<Item = Draw<'_>>,
        elevation: &Elevation,
        places: ArrayPlaces<'_>,
    ) -> Result<(), DrawError> {
        self.views.clear();
        self.tiles.clear();
        self.blocks.clear();
        self.draws.clear();
        self.terms.clear();
        let datum_m = self.world.surface().height_m(frame.pose.eye());
        for view in frame.views.iter() {
            self.add_view(frame, &view.camera, datum_m, places)?;
        }
        for Draw { view, tiles, .. } in draws {
            let Some(first_tile) = self.views.get(view).map(|view| view.first_tile) else { continue };
            let start = self.blocks.len();
            let drawn = tiles.of(&frame.tiles);
            self.blocks.extend(drawn.map(|(number, tile)| ((first_tile + number) as u32, block(tile))));
            self.draws.push(MeshDraw { view, blocks: start..self.blocks.len() });
        }
        Ok(self.pass.prepare(recording, elevation, &self.tiles, self.terms.numbers())?)
    }

    fn draw(&self, draw: usize, recording: &mut FrameRecording<'_>, colors: &ColorPool, is_depth_only: bool) {
        let Some(MeshDraw { view, blocks }) = self.draws.get(draw) else { return };
        let MeshView { parameters, sides, .. } = &self.views[*view];
        let blocks = &self.blocks[blocks.clone()];
        self.pass.draw(recording, colors, &TerrainView { parameters, blocks, sides: *sides, is_depth_only });
    }

    fn triangles(&self, draw: usize) -> u64 {
        let triangles = |Block { size, snap, .. }: &Block| 2 * u64::from(size[0] >> snap) * u64::from(size[1] >> snap);
        let drawn = self.draws.get(draw).map_or(0..0, |draw| draw.blocks.clone());
        self.blocks[drawn].iter().map(|(_, block)| triangles(block)).sum()
    }
}

impl MeshTechnique {
    /// Takes a view in, and the tiles as its eye sees them.
    fn add_view(
        &mut self,
        frame: &Frame,
        camera: &Camera,
        datum_m: f64,
        places: ArrayPlaces<'_>,
    ) -> Result<(), DrawError> {
        let (parameters, cell) = view_parameters(camera, &self.world, datum_m);
        let sides = visible_sides(camera, &self.world);
        // Eyes in one cell see the same tiles.
        // Of a body, terms are made for an eye.
        let is_same = |before: &&MeshView| before.cell.corner == cell.corner && self.world.globe().is_none();
        let seen = self.views.iter().find(is_same).map(|before| before.first_tile);
        self.terms.look(&self.world, camera);
        let first_tile = seen.unwrap_or(self.tiles.len());
        self.views.push(MeshView { parameters, sides, cell, first_tile });
        if seen.is_some() {
            return Ok(());
        }
        for (index, tile) in frame.tiles.iter().enumerate() {
            let array = tile.elevation_position.wrapping_sub(frame.elevation_start) as usize;
            let (frame, fault) = (frame.number(), TileFault::Elevation);
            let start = places.starts.get(array).ok_or(FrameError::Tile { frame, index, fault })?;
            let mut parameters = tile_parameters(tile, &self.world, cell, *start);
            self.terms.place(&self.world, tile, &mut parameters);
            self.tiles.push(parameters);
        }
        Ok(())
    }
}

/// Which sides of the ground the eye can see. Ground is a height field: an eye over it sees the
/// upper side first along any ray, so the lower one (the far slopes of ridges, from behind) need
/// not be drawn: a fifth of the time in mountains. An eye beside the world may look under its edge,
/// and any eye through holes.
fn visible_sides(camera: &Camera, world: &World) -> Sides {
    if world.surface().is_over(camera.eye()) && !world.has_holes() { Sides::Upper } else { Sides::Both }
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
        color_scale_north: 0.0,
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
