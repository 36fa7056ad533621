//! The ground that a camera sees, read directly from a terrain database: tiles at the levels that
//! screen resolution requires, read when first needed and kept.
//!
//! Elevation and colour have separate levels: a tile of elevation is drawn with the colour tile of
//! the ancestor whose texels have the wanted size.

use crate::model::color::{ColorLayout, ColorPlace};
use crate::model::{Filter, Ground, GroundError, GroundShape, TileSpec};
use std::collections::HashMap;
use terravision_common::camera::Camera;
use terravision_common::database::{Layer, TileError, TileScratch, TileSource, color_tile_bytes};
use terravision_common::level::LevelFunction;
use terravision_common::node::NodeId;
use terravision_common::surface::NodeBounds;
use terravision_common::traversal::{Frustum, HeightRanges, node_box};
use terravision_common::world::World;

/// Why a ground could not be filled.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FillError {
    /// A tile cannot be read.
    #[error(transparent)]
    Tile {
        /// Why.
        #[from]
        source: TileError,
    },
    /// A tile cannot be added to the ground.
    #[error("the elevation tile of node {node} cannot be drawn: {source}")]
    Ground {
        /// The node.
        node: NodeId,
        /// Why.
        #[source]
        source: GroundError,
    },
}

/// Geometry of a ground for a world.
#[must_use]
pub fn ground_shape(world: &World, filter: Option<Filter>) -> GroundShape {
    GroundShape { surface: world.plane(), levels: world.levels(), color: ColorLayout::of(world), filter }
}

/// Reads tiles for views of a world.
#[derive(Debug)]
pub struct WorldTiles<'s, S, R> {
    source: &'s S,
    ranges: &'s R,
    world: World,
    elevations: HashMap<NodeId, Vec<f32>>,
    layers: HashMap<NodeId, u32>,
    colors: Vec<Vec<u8>>,
    scratch: TileScratch,
}

impl<'s, S: TileSource, R: HeightRanges> WorldTiles<'s, S, R> {
    /// Tiles of a world from a source; `ranges` are of the same.
    #[must_use]
    pub fn new(world: &World, source: &'s S, ranges: &'s R) -> Self {
        Self {
            source,
            ranges,
            world: *world,
            elevations: HashMap::new(),
            layers: HashMap::new(),
            colors: Vec::new(),
            scratch: TileScratch::default(),
        }
    }

    /// The layers of colour for which tiles have been read.
    #[must_use]
    pub fn layers(&self) -> Vec<&[u8]> {
        self.colors.iter().map(Vec::as_slice).collect()
    }

    /// Fills a ground with what a camera sees, at the levels of `level`, which must be made for
    /// that camera. Tiles that begin within `accurate_m` of the eye get voxels. Blocks on storage.
    ///
    /// # Errors
    /// [`FillError`]; the ground is then incomplete.
    pub fn fill(
        &mut self,
        ground: &mut Ground,
        camera: &Camera,
        level: &LevelFunction,
        accurate_m: f64,
    ) -> Result<(), FillError> {
        ground.clear(self.world.plane().height_m(camera.eye()));
        let frustum = Frustum::new(camera);
        let frame = self.world.surface().seen_by(camera.eye(), camera.axes_in_world()[2]);
        let mut open = vec![self.world.root()];
        while let Some(node) = open.pop() {
            let Some(bounds) = node_box(&self.world, self.ranges, level.exaggeration(), node) else { continue };
            // Rays enter the ground within the frustum from the near side, never from the nodes
            // around it.
            if !frustum.may_see(&frame.box_from_eye(&bounds)) {
                continue;
            }
            let is_too_coarse = f64::from(node.q()) > level.elevation_bound(&bounds).max(0.0);
            let is_above = node.q() > self.world.finest_elevation_level();
            if is_too_coarse && is_above && self.ranges.has_children(Layer::Elevation, node) {
                open.extend((0..4).filter_map(|n| node.child(n)));
                continue;
            }
            self.add(ground, node, &bounds, level, accurate_m)?;
        }
        ground.finish();
        Ok(())
    }

    fn add(
        &mut self,
        ground: &mut Ground,
        node: NodeId,
        bounds: &NodeBounds,
        level: &LevelFunction,
        accurate_m: f64,
    ) -> Result<(), FillError> {
        let world = self.world;
        let wanted = level.color_bound(bounds).floor().max(f64::from(node.q())) as u8;
        let mut color_node = node.ancestor(wanted.clamp(world.finest_color_level().max(node.q()), world.root().q()));
        // Colour may end above elevation.
        if let Some(coarsest_without) = (color_node.q()..world.root().q())
            .rev()
            .find(|q| !self.ranges.has_children(Layer::Color, color_node.ancestor(q + 1)))
        {
            color_node = color_node.ancestor(coarsest_without + 1);
        }
        let color_origin = world.node_origin(color_node).map(|v| v as u32);
        let layer = self.layer_of(color_node)?;
        let posts = world.elevation_posts();
        if !self.elevations.contains_key(&node) {
            let mut values = vec![0.0; world.elevation_values()];
            self.source.read_elevation(node, &mut values, &mut self.scratch)?;
            let exaggeration = level.exaggeration() as f32;
            values[..(posts * posts) as usize].iter_mut().for_each(|height| *height *= exaggeration);
            self.elevations.insert(node, values);
        }
        let origin = world.node_origin(node).map(|v| v as u32);
        // Posts beyond the extent repeat its border.
        let inside = world.plane().cells_inside(world.node_origin(node), node.q());
        let cells = inside.map(|cells| cells.unwrap_or_default().min(u64::from(posts - 1)) as u32);
        let distance = level.frame().bound(bounds).distance2.sqrt();
        let mut planes = self.elevations[&node].chunks_exact((posts * posts) as usize);
        let heights = planes.next().unwrap_or_default();
        let spec = TileSpec {
            origin,
            level: node.q(),
            log_spacing: node.q(),
            cells,
            heights,
            shares: planes.next().zip(planes.next()).map(|(ground, measured)| [ground, measured]),
            stride: posts as usize,
            datum_m: 0.0,
            color: ColorPlace::of_tile(&world, layer, color_origin, color_node.q()),
            is_accurate: distance <= accurate_m,
        };
        ground.add(&spec).map_err(|source| FillError::Ground { node, source })
    }

    fn layer_of(&mut self, node: NodeId) -> Result<u32, FillError> {
        if let Some(layer) = self.layers.get(&node) {
            return Ok(*layer);
        }
        let mut bytes = vec![0; color_tile_bytes(&self.world)];
        self.source.read_color(node, &mut bytes, &mut self.scratch)?;
        let layer = self.colors.len() as u32;
        self.colors.push(bytes);
        self.layers.insert(node, layer);
        Ok(layer)
    }
}
