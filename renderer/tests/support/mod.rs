//! Hand-made recordings: small worlds with a known shape and known colours.
#![allow(dead_code, unreachable_pub, reason = "each test binary uses a part of it")]

use bytemuck::Zeroable;
use std::sync::Arc;
use std::time::Duration;
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::ids::SlotKey;
use terravision_common::node::NodeId;
use terravision_common::rig::Views;
use terravision_common::slot::{ElevationTile, FrameEnd, FrameMarker, TileSlot};
use terravision_common::texels::{TexelFormat, compress_tile};
use terravision_common::world::{COLOR_BORDER, COLOR_MIPS, World, WorldFields};
use terravision_renderer::engine::{self, Engine, EngineError, EngineOptions, Finished};
use terravision_renderer::frame::FrameReader;
use terravision_renderer::gpu::ElevationPath;
use terravision_renderer::source::{FrameSource, RecordedFrame, RecordedSource, Recording, RecordingBuilder};
use terravision_testkit::worlds::fields;

/// A sky that no texture has.
pub const SKY: [u8; 3] = [255, 0, 255];

/// A world of `2^k` nodes of level 0 a side: 10 m posts, 8 intervals and 32 texels a tile.
pub fn world(extent: [u32; 2]) -> World {
    World::new(WorldFields { origin: [500_000.0, 4_000_000.0], ..fields(extent, 10.0, [8, 32]) })
        .expect("the numbers are those of a world")
}

/// A camera over the world, metres and degrees.
pub fn camera(eye: [f64; 3], heading: f64, pitch: f64, size: [u32; 2]) -> Camera {
    Camera::new(CameraFields {
        eye_in_world: eye,
        heading_rad: heading.to_radians(),
        pitch_rad: pitch.to_radians(),
        roll_rad: 0.0,
        vfov_rad: 60f64.to_radians(),
        width: size[0],
        height: size[1],
        timestamp_nanos: 0,
    })
    .expect("valid")
}

/// Builds one frame after the other.
pub struct Scene<'a> {
    pub world: World,
    pub builder: RecordingBuilder,
    pub height: &'a dyn Fn(f64, f64) -> f64,
    /// Colour of the texel centre at a point of the world.
    pub color: &'a dyn Fn(f64, f64) -> [u8; 3],
    /// Of a world with validity, the shares of ground and of measured ground at a post.
    pub shares: &'a dyn Fn(f64, f64) -> [f32; 2],
    texels: TexelFormat,
    frame: u64,
    next_slot: u32,
}

impl<'a> Scene<'a> {
    pub fn new(world: World, height: &'a dyn Fn(f64, f64) -> f64, color: &'a dyn Fn(f64, f64) -> [u8; 3]) -> Self {
        let texels = TexelFormat::Rgba8;
        let builder = RecordingBuilder::new(world);
        Self { world, builder, height, color, shares: &|_, _| [1.0; 2], texels, frame: 0, next_slot: 0 }
    }

    /// Not all of its ground was measured.
    pub fn with_shares(self, shares: &'a dyn Fn(f64, f64) -> [f32; 2]) -> Self {
        Self { shares, ..self }
    }

    /// Colour tiles are kept in this format.
    pub fn with_texels(self, texels: TexelFormat) -> Self {
        Self { builder: self.builder.with_texels(texels), texels, ..self }
    }

    /// A tile with its own elevation array and colour tile: a leaf at `node`.
    pub fn leaf(&mut self, node: NodeId, camera: &Camera, edge_snap: [u8; 4]) -> TileSlot {
        let side = self.world.elevation_tile() as u16;
        let origin = self.world.node_origin(node).map(|v| v as u32);
        let position = self.add_array(node, camera);
        let color_slot = self.add_color(node);
        TileSlot {
            node: node.pack(),
            elevation_position: position,
            elevation_origin: origin,
            color_origin: origin,
            start: [0, 0],
            end: [side, side],
            color_slot,
            color_generation: 1,
            elevation_level: node.q(),
            color_level: node.q(),
            edge_snap,
            ..TileSlot::zeroed()
        }
    }

    pub fn add_array(&mut self, node: NodeId, camera: &Camera) -> u64 {
        let origin = self.world.node_origin(node);
        let extent = self.world.extent();
        let unit = self.world.lattice_unit_m();
        let mut planes = [const { Vec::new() }; 3];
        for j in 0..u64::from(self.world.elevation_posts()) {
            for i in 0..u64::from(self.world.elevation_posts()) {
                let at = |axis: usize, k: u64| (origin[axis] + (k << node.q())).min(extent[axis].into()) as f64 * unit;
                let [ground, measured] = (self.shares)(at(0, i), at(1, j));
                let height = ((self.height)(at(0, i), at(1, j)) - camera.fields().eye_in_world[2]) as f32;
                planes.iter_mut().zip([height, ground, measured]).for_each(|(plane, value)| plane.push(value));
            }
        }
        self.builder.add_elevations(&planes[..self.world.elevation_planes()].concat())
    }

    pub fn add_color(&mut self, node: NodeId) -> u32 {
        let mut texels = Vec::new();
        let [x0, y0] = self.world.node_origin(node).map(|v| v as f64 * self.world.lattice_unit_m());
        let side_m = self.world.node_side_m(node.q());
        for mip in 0..COLOR_MIPS {
            let stored = self.world.color_stored() >> mip;
            let border = f64::from(COLOR_BORDER >> mip);
            let spacing = side_m / f64::from(self.world.color_tile() >> mip);
            for row in 0..stored {
                for column in 0..stored {
                    let x = x0 + (f64::from(column) + 0.5 - border) * spacing;
                    let y = y0 + side_m - (f64::from(row) + 0.5 - border) * spacing;
                    let [r, g, b] = (self.color)(x, y);
                    texels.extend([r, g, b, 255]);
                }
            }
        }
        let slot = self.next_slot;
        self.next_slot += 1;
        if self.texels.is_compressed() {
            let side = self.world.color_stored();
            let rgba = std::mem::take(&mut texels);
            texels.resize(self.texels.tile_bytes(side) as usize, 0);
            compress_tile(&rgba, side, &mut texels);
        }
        self.builder.add_color(SlotKey::new(slot, 1), &texels);
        slot
    }

    /// Tiles of the elevation pool of all nodes down to a level, a node after the one above it.
    pub fn elevation_tiles(&mut self, q: u8) -> Vec<ElevationTile> {
        let levels = (q..self.world.levels()).rev();
        let nodes: Vec<NodeId> = levels
            .flat_map(|q| {
                let [columns, rows] = self.world.nodes_at(q);
                (0..rows * columns).map(move |i| node(i % columns, i / columns, q))
            })
            .collect();
        nodes
            .into_iter()
            .map(|node| {
                let (origin, unit) = (self.world.node_origin(node), self.world.lattice_unit_m());
                let extent = self.world.extent();
                let posts = u64::from(self.world.elevation_posts());
                let at = |axis: usize, k: u64| (origin[axis] + (k << node.q())).min(extent[axis].into()) as f64 * unit;
                let heights: Vec<f32> =
                    (0..posts * posts).map(|k| (self.height)(at(0, k % posts), at(1, k / posts)) as f32).collect();
                self.builder.add_elevation_tile(node, &heights)
            })
            .collect()
    }

    /// A leaf whose heights are those of one of these tiles of the elevation pool.
    pub fn leaf_in_place(&mut self, elevations: &[ElevationTile], at: usize) -> TileSlot {
        let node = elevations[at].node().expect("a node");
        let side = self.world.elevation_tile() as u16;
        let origin = self.world.node_origin(node).map(|v| v as u32);
        let color_slot = self.add_color(node);
        TileSlot {
            node: node.pack(),
            elevation_position: at as u64,
            elevation_origin: origin,
            color_origin: origin,
            end: [side, side],
            color_slot,
            color_generation: 1,
            elevation_level: node.q(),
            color_level: node.q(),
            ..TileSlot::zeroed()
        }
    }

    /// Adds a frame whose heights lie in the elevation pool.
    pub fn frame_in_place(&mut self, camera: &Camera, elevations: &[ElevationTile], tiles: Vec<TileSlot>) {
        self.frame(camera, tiles);
        self.builder.name_elevation_tiles(elevations);
    }

    /// Adds a frame of these tiles.
    pub fn frame(&mut self, camera: &Camera, tiles: Vec<TileSlot>) {
        self.frame_of_views(camera, Views::single(camera), tiles);
    }

    /// Adds a frame of these tiles, whose heights are above the pose's eye, seen by these views.
    pub fn frame_of_views(&mut self, pose: &Camera, views: Views, tiles: Vec<TileSlot>) {
        let (frame, camera) = (self.frame, *pose.fields());
        let picture = views.picture();
        let marker = FrameMarker { frame, camera, r_z_px: 10.0, r_c_px: 1.0, picture, ..FrameMarker::zeroed() };
        let end = FrameEnd {
            frame: self.frame,
            tile_count: tiles.len() as u32,
            elevation_end: self.builder.arrays(),
            ..FrameEnd::zeroed()
        };
        self.builder.add_frame(RecordedFrame { marker, views, elevations: Vec::new(), tiles, end });
        self.frame += 1;
    }

    pub fn finish(self) -> Arc<Recording> {
        Arc::new(self.builder.finish())
    }
}

pub fn node(m: u32, n: u32, q: u8) -> NodeId {
    NodeId::new(m, n, q).expect("test nodes are small")
}

/// Options of all tests: validation on, a size, nothing else special.
pub fn options(size: [u32; 2]) -> EngineOptions {
    EngineOptions { size, sky_rgb: SKY, has_validation: true, ..EngineOptions::default() }
}

/// Draws all frames of a recording.
pub fn draw(options: &EngineOptions, recording: &Arc<Recording>) -> Result<Vec<Finished>, EngineError> {
    let mut source = RecordedSource::new(Arc::clone(recording), 1);
    let mut engine = engine::open(options.clone(), &source)?;
    draw_on(&mut *engine, options, &mut source)
}

/// Draws all frames of a source on an engine.
pub fn draw_on(
    engine: &mut dyn Engine,
    options: &EngineOptions,
    source: &mut RecordedSource,
) -> Result<Vec<Finished>, EngineError> {
    let mut reader = FrameReader::new(source.shape(), options.size)?;
    let mut finished = Vec::new();
    while reader.remaining() > 0 {
        while !engine.has_room() {
            finished.extend(engine.poll(Duration::from_secs(20))?);
        }
        reader.read(source, true)?;
        let pixels = engine.new_pixels()?;
        engine.submit(reader.frame(), source, pixels)?;
    }
    while engine.is_busy() {
        finished.extend(engine.poll(Duration::from_secs(20))?);
    }
    engine.check_validation()?;
    Ok(finished)
}

/// The pixel of a picture.
pub fn pixel(finished: &Finished, x: u32, y: u32) -> [u8; 3] {
    let [width, _] = finished.pixels.size();
    let start = (y * width + x) as usize * 4;
    let rgba = &finished.pixels.rgba()[start..start + 4];
    assert_eq!(rgba[3], 255);
    [rgba[0], rgba[1], rgba[2]]
}

/// Number of pixels of sky.
pub fn sky_pixels(finished: &Finished) -> usize {
    finished.pixels.rgba().chunks_exact(4).filter(|texel| texel[..3] == SKY).count()
}

/// All ways in which elevations and colours reach the device.
pub fn paths(options: &EngineOptions) -> [EngineOptions; 2] {
    let staged = EngineOptions { elevation_path: ElevationPath::Staged, can_import_colors: false, ..options.clone() };
    [options.clone(), staged]
}

/// Writes a picture for a person to look at, when `TERRAVISION_TEST_PICTURES` names a folder.
pub fn keep(finished: &Finished, name: &str) {
    let Some(folder) = std::env::var_os("TERRAVISION_TEST_PICTURES") else { return };
    let [width, height] = finished.pixels.size();
    let path = std::path::Path::new(&folder).join(format!("{name}.png"));
    image::save_buffer(path, finished.pixels.rgba(), width, height, image::ExtendedColorType::Rgba8)
        .expect("the folder for pictures can be written");
}
