//! Exact rays by a Vulkan device: the same surface and the same walk as the processor's
//! (`terravision_raycast`), one thread a pixel.

use super::rays::{SlotBlock, block_of};
use super::view_parameters::{NEAR_M, datum_above_eye_m};
use super::{ArrayPlaces, Draw, DrawError, Technique, outline_of};
use crate::frame::{Frame, FrameError, TileFault};
use crate::gpu::{ColorPool, Elevation, FrameRecording, RayNode, RayTile, RayView, RaysPass, Target};
use glam::DVec2;
use terravision_common::camera::Camera;
use terravision_common::run::TechniqueChoice;
use terravision_common::slot::TileSlot;
use terravision_common::world::{COLOR_BORDER, World};
use terravision_raycast::model::{Link, Tree};
use terravision_raycast::view::View;

/// Casts rays through tiles.
#[derive(Debug)]
pub struct ComputeRays {
    pass: RaysPass,
    world: World,
    /// Of each draw its view.
    views: Vec<RayView>,
    tree: Tree,
    tiles: Vec<RayTile>,
    nodes: Vec<RayNode>,
}

impl ComputeRays {
    /// For views no larger than `target` at first, and this many frame slots, each with this many
    /// draws. `has_overlay`: outlines of the colour leaves.
    ///
    /// # Errors
    /// The device is out of memory.
    pub fn new(
        colors: &ColorPool,
        target: &Target,
        world: &World,
        has_overlay: bool,
        slots_and_draws: [usize; 2],
    ) -> Result<Self, DrawError> {
        Ok(Self {
            pass: RaysPass::new(colors, target, has_overlay, slots_and_draws)?,
            world: *world,
            views: Vec::with_capacity(slots_and_draws[1]),
            tree: Tree::default(),
            tiles: Vec::with_capacity(4096),
            nodes: Vec::with_capacity(4096),
        })
    }
}

impl Technique for ComputeRays {
    fn choice(&self) -> TechniqueChoice {
        TechniqueChoice::Rays
    }

    /// Rays meet ground that facets, as they are drawn, hide to the last pixel's edge.
    fn wants_unseen(&self) -> bool {
        true
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
        for draw in draws {
            self.prepare_draw(draw, recording, frame, elevation, places)?;
        }
        Ok(())
    }

    fn draw(&self, draw: usize, recording: &mut FrameRecording<'_>, colors: &ColorPool, _is_depth_only: bool) {
        if let Some(parameters) = self.views.get(draw) {
            self.pass.draw(recording, colors, (draw, parameters));
        }
    }

    fn triangles(&self, _draw: usize) -> u64 {
        0
    }
}

impl ComputeRays {
    fn prepare_draw(
        &mut self,
        draw: Draw<'_>,
        recording: &mut FrameRecording<'_>,
        frame: &Frame,
        elevation: &Elevation,
        places: ArrayPlaces<'_>,
    ) -> Result<(), DrawError> {
        let (world, surface) = (&self.world, self.world.plane());
        let fail = |index: usize, fault: TileFault| FrameError::Tile { frame: frame.number(), index, fault };
        let camera = &frame.views[draw.view.min(frame.views.len() - 1)].camera;
        self.tiles.clear();
        self.tree.clear(world.elevation_tile().ilog2(), u32::from(world.root().q()));
        let mut ground = [DVec2::INFINITY, DVec2::NEG_INFINITY];
        for (index, tile) in draw.tiles.of(&frame.tiles) {
            let array = tile.elevation_position.wrapping_sub(frame.elevation_start) as usize;
            let start = *places.starts.get(array).ok_or_else(|| fail(index, TileFault::Elevation))?;
            let block = block_of(world, tile).ok_or_else(|| fail(index, TileFault::Block))?;
            let origin = world.node_origin(block.node).map(|v| v as u32);
            let level = u32::from(block.node.q());
            let is_free = self.tree.insert(origin, level, self.tiles.len() as u32, f32::INFINITY);
            is_free.map_err(|_occupied| fail(index, TileFault::Occupied))?;
            let made = ray_tile(tile, &block, world, camera, start);
            let corner = surface.foot_of_lattice(DVec2::from_array(origin.map(f64::from)));
            let side = DVec2::from_array(block.cells.map(f64::from)) * spacing_m(tile, world);
            ground = [ground[0].min(corner), ground[1].max(corner + side)];
            self.tiles.push(made);
        }
        // Cells may reach over the world's border.
        ground[1] = ground[1].min(surface.end());
        self.nodes.clear();
        let eye = surface.foot(camera.eye());
        place_nodes(&self.tree, world, eye, &mut self.nodes);
        let view = RayView {
            has_undersides: u32::from(!surface.is_over(camera.eye()) || world.has_holes()),
            plane: if world.has_validity() { world.elevation_posts().pow(2) } else { 0 },
            datum_m: datum_above_eye_m(camera, world, surface.height_m(frame.pose.eye())),
            root: code(self.tree.root()),
            root_low: (-eye).as_vec2().to_array(),
            root_side: surface.node_side_m(world.root().q()) as f32,
            ..ray_view(camera, [ground[0] - eye, ground[1] - eye])
        };
        let index = self.views.len();
        self.views.push(view);
        let Self { pass, tiles, nodes, .. } = self;
        Ok(recording
            .timed(draw.number, |recording| pass.prepare(recording, elevation, (index, &view), tiles, nodes))?)
    }
}

/// Distance of the posts of a slot's block, metres.
fn spacing_m(tile: &TileSlot, world: &World) -> f64 {
    world.plane().spacing_m(tile.elevation_level + tile.grid_snap)
}

fn ray_tile(tile: &TileSlot, block: &SlotBlock, world: &World, camera: &Camera, array_start: u32) -> RayTile {
    let surface = world.plane();
    let from_eye = |lattice: [f64; 2]| surface.lattice_from_eye(DVec2::from_array(lattice), camera.eye());
    let posts = world.elevation_posts();
    let step = 1u32 << tile.grid_snap;
    let color_side_m = surface.node_side_m(tile.color_level);
    let color_per_m = f64::from(world.color_tile()) / color_side_m / f64::from(world.color_stored());
    let border_m = color_side_m * f64::from(COLOR_BORDER) / f64::from(world.color_tile());
    RayTile {
        corner: from_eye(world.node_origin(block.node).map(|v| v as f64)).as_vec2().to_array(),
        cells_per_m: (1.0 / spacing_m(tile, world)) as f32,
        array_start: array_start + block.start[1] * posts + block.start[0],
        cells: block.cells,
        strides: [step, step * posts],
        stretch: block.stretch,
        maxima_start: 0,
        color_layer: tile.color_slot,
        color_corner: (from_eye(tile.color_origin.map(f64::from)) - border_m).as_vec2().to_array(),
        color_per_m: color_per_m as f32,
        outline: outline_of(tile),
    }
}

/// The view, but for the tree. `ground`: corners of all ground, metres from the eye.
fn ray_view(camera: &Camera, ground: [DVec2; 2]) -> RayView {
    let view = View::new(camera);
    let [per_column, per_row] = view.steps();
    RayView {
        first: view.direction([0, 0]).to_array(),
        near_m: NEAR_M as f32,
        per_column: per_column.to_array(),
        root: RayNode::EMPTY,
        per_row: per_row.to_array(),
        size: camera.width() | camera.height() << 16,
        bounds_low: ground[0].as_vec2().to_array(),
        bounds_high: ground[1].as_vec2().to_array(),
        root_low: [0.0; 2],
        root_side: 0.0,
        turn: 0,
        has_undersides: 0,
        plane: 0,
        datum_m: 0.0,
        reserved: 0,
    }
}

/// What a link is for the shader.
fn code(link: Link) -> u32 {
    match link {
        Link::Empty => RayNode::EMPTY,
        Link::Tile(tile) => tile | RayNode::IS_TILE,
        Link::Node(node) => node,
    }
}

/// Puts the nodes of a tree where the eye sees them.
fn place_nodes(tree: &Tree, world: &World, eye: DVec2, out: &mut Vec<RayNode>) {
    out.extend(tree.nodes().iter().map(|node| RayNode {
        children: node.children.map(code),
        middle: [0.0; 2],
        reserved: [0; 2],
    }));
    place_node(tree, tree.root(), DVec2::ZERO, world.plane().node_side_m(world.root().q()), eye, out);
}

fn place_node(tree: &Tree, link: Link, corner: DVec2, side_m: f64, eye: DVec2, out: &mut [RayNode]) {
    let Link::Node(index) = link else { return };
    let half = 0.5 * side_m;
    if let Some(node) = out.get_mut(index as usize) {
        node.middle = (corner + half - eye).as_vec2().to_array();
    }
    for (n, child) in tree.nodes()[index as usize].children.into_iter().enumerate() {
        let by = DVec2::new((n & 1) as f64, (n >> 1) as f64) * half;
        place_node(tree, child, corner + by, half, eye, out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_meet_where_their_tiles_do_seen_from_the_eye() {
        let mut tree = Tree::default();
        tree.clear(3, 2);
        tree.insert([0, 0], 1, 0, 0.0).unwrap();
        tree.insert([24, 16], 0, 1, 0.0).unwrap();
        let world = terravision_testkit::worlds::world([32; 2], 10.0, [8, 64]);
        let mut nodes = Vec::new();
        place_nodes(&tree, &world, DVec2::new(100.0, 200.0), &mut nodes);
        let (is_tile, empty) = (RayNode::IS_TILE, RayNode::EMPTY);
        assert_eq!(code(tree.root()), 0);
        // The root's middle is at 160 m, that of its north eastern child at 240 m.
        assert_eq!((nodes[0].middle, nodes[0].children), ([60.0, -40.0], [is_tile, empty, empty, 1]));
        assert_eq!((nodes[1].middle, nodes[1].children), ([140.0, 40.0], [empty, is_tile | 1, empty, empty]));
        assert_eq!(nodes.len(), 2);
    }
}
