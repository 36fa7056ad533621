//! The engine of rays: the ground of a frame, its elevation arrays and colour tiles as they are in
//! shared memory, cast on the processor's cores. No Vulkan.

use super::cost::{DrawCost, DrawCosts};
use super::finished::InFlight;
use super::{Described, Engine, EngineError, EngineOptions, Finished, Submitted};
use crate::frame::{Frame, FrameError, TileFault};
use crate::pixels::{Pixels, Raster};
use crate::source::{ElevationPoolShape, FrameSource, Pools, SourceShape};
use crate::technique::{BlockReader, NEAR_M, outline_of};
use std::time::Duration;
use terravision_common::camera::Camera;
use terravision_common::event::monotonic_nanos;
use terravision_common::run::{RaysChoice, TechniqueChoice, UNDECIDED_RAYS as UNDECIDED};
use terravision_common::simd::Instructions;
use terravision_common::slot::ElevationTile;
use terravision_raycast::Sampling;
use terravision_raycast::model::world::ground_shape;
use terravision_raycast::model::{Detail, Filter, Ground, GroundError, PoolShape, PoolTile};
use terravision_raycast::workers::Workers;
use terravision_raycast::{CastOptions, CastTask, Caster, EdgeStretch, Method, Picture, SweepDetail};

/// Frames before both methods are tried on one: they take memory, and are slower than later ones.
const WARM_UP: u32 = 2;
/// How long a frame that lacks no tile is waited for, to try on.
const PATIENCE: Duration = Duration::from_secs(1);
/// Longest side of a picture, pixels: that of the software device.
const LONGEST_SIDE: u32 = 16384;
/// Distance of samples along rays through voxels, voxels.
const INTERVAL_VOXELS: f32 = 0.6;
/// Tiles up to this many times as far as the nearest one have voxels: an octave of distance, which
/// is a level. The others are drawn by their heights: as near to the truth, for less
/// (docs/techniques.md).
const ACCURATE_REACH: f64 = 2.0;
/// Bytes of voxels at most: those of 15,000 tiles of 16 x 16 cells of mountains. Cliffs take more.
const MOST_VOXEL_BYTES: usize = 64 << 20;

/// Draws frames by casting rays.
#[derive(Debug)]
pub struct RaysEngine {
    caster: Caster,
    /// Heights alone, and with voxels.
    grounds: [Ground; 2],
    blocks: BlockReader,
    /// The frame's, all of its views. Its colours are drawn where sinks read them, in memory of its
    /// pixels.
    picture: Picture,
    /// Of each tile of the ground its colours; empty between frames, kept for its memory.
    layers: Vec<&'static [u8]>,
    /// Of each tile the colour of its outline, where outlines are wanted.
    outlines: Vec<u32>,
    finished: Option<Finished>,
    /// How densely a sweep samples the frame that was cast last.
    detail: SweepDetail,
    /// Of the frame that was cast last.
    costs: DrawCosts,
    choice: Choice,
    /// Whether the world has holes.
    has_holes: bool,
    options: EngineOptions,
}

/// Which method, and how far that is known.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Choice {
    Asked(Method),
    /// [`METHODS`]' first, until the other has been tried. When the first frame began, and how many
    /// there were.
    Open {
        first_nanos: Option<u64>,
        drawn: u32,
    },
    /// What won, and how long each of [`METHODS`] took for the same frame.
    Tried {
        method: Method,
        took: [Duration; 2],
    },
}

/// The methods that are compared. The first draws until they have been.
const METHODS: [Method; 2] = [Method::Mipmap, Method::Coherent];

impl Choice {
    fn of(rays: RaysChoice) -> Self {
        match rays {
            // Without a device the processor casts the same rays.
            RaysChoice::Mipmap | RaysChoice::Compute => Self::Asked(Method::Mipmap),
            RaysChoice::Coherent => Self::Asked(Method::Coherent),
            RaysChoice::Sweep => Self::Asked(Method::Sweep),
            RaysChoice::Auto => Self::Open { first_nanos: None, drawn: 0 },
        }
    }

    fn method(&self) -> Method {
        match self {
            Self::Asked(method) | Self::Tried { method, .. } => *method,
            Self::Open { .. } => METHODS[0],
        }
    }

    /// A frame that began then has been drawn; whether both methods are to be tried on it, unseen.
    /// Not while tiles are being loaded, when frames are as cheap as none later, unless that takes
    /// long.
    fn is_trial_due(&mut self, began_nanos: u64, is_settled: bool) -> bool {
        let Self::Open { first_nanos, drawn } = self else { return false };
        let first = *first_nanos.get_or_insert(began_nanos);
        *drawn += 1;
        *drawn > WARM_UP && (is_settled || began_nanos.saturating_sub(first) >= PATIENCE.as_nanos() as u64)
    }

    fn decide(&mut self, took: [Duration; 2]) {
        *self = Self::Tried { method: METHODS[usize::from(took[1] < took[0])], took };
    }

    fn words(&self) -> String {
        let of = |method: Method| match method {
            Method::Mipmap => "mipmap: one exact ray a pixel",
            Method::Coherent => "coherent: voxels along lines of pixels",
            Method::Sweep => "sweep: vertical planes",
        };
        match self {
            Self::Asked(method @ Method::Sweep) => format!("{}, {}", of(*method), Instructions::widest().name()),
            Self::Asked(method) => of(*method).to_owned(),
            Self::Open { .. } => format!("{UNDECIDED} {}", of(METHODS[0])),
            Self::Tried { method, took } => {
                let [mipmap, coherent] = took.map(|took| 1e3 * took.as_secs_f64());
                format!("{}; tried on one frame: mipmap {mipmap:.1} ms, coherent {coherent:.1} ms", of(*method))
            }
        }
    }
}

impl RaysEngine {
    /// Makes all that frames of this source need.
    ///
    /// # Errors
    /// Something that rays cannot do is asked for, or the system gives no threads.
    pub fn new(options: EngineOptions, source: &dyn FrameSource) -> Result<Self, EngineError> {
        if options.samples != 1 {
            return Err(EngineError::MeshOnly { what: "several samples per pixel" });
        }
        if options.view_bounds().size.iter().any(|side| *side > LONGEST_SIDE) {
            return Err(EngineError::PictureSize { size: options.view_bounds().size, limit: LONGEST_SIDE });
        }
        if options.pixels.device {
            return Err(EngineError::MeshOnly { what: "pictures that stay on the device" });
        }
        let SourceShape { world, texels, elevation_pool, .. } = source.shape();
        if texels.is_compressed() {
            return Err(EngineError::MeshOnly { what: "block-compressed colour tiles" });
        }
        let [mut heights, voxels] =
            [None, Some(Filter::OrientedBox)].map(|filter| Ground::new(ground_shape(&world, filter)));
        if let Some(ElevationPoolShape { slots, stride }) = elevation_pool {
            let exaggeration = options.exaggeration as f32;
            let has_validity = world.has_validity();
            heights = heights.with_pool(PoolShape { slots, stride, exaggeration, has_validity });
        }
        Ok(Self {
            caster: Caster::new(options.workers)?,
            grounds: [heights, voxels],
            blocks: BlockReader::new(&world),
            picture: Picture::empty(options.has_depth),
            layers: Vec::with_capacity(4096),
            outlines: Vec::with_capacity(4096),
            finished: None,
            detail: SweepDetail::DEFAULT,
            costs: DrawCosts::default(),
            choice: Choice::of(options.rays),
            has_holes: world.has_holes(),
            options,
        })
    }
}

impl Engine for RaysEngine {
    fn describe(&self) -> Described {
        let workers = self.caster.workers().count();
        let device = format!("CPU, {workers} worker{}", if workers == 1 { "" } else { "s" });
        let (technique, reason) = (TechniqueChoice::Rays.name(), self.options.reason.clone());
        Described { technique, reason, device, driver: self.choice.words() }
    }

    fn frames_in_flight(&self) -> usize {
        1
    }

    fn new_pixels(&self) -> Result<Pixels, EngineError> {
        Ok(Pixels::Memory(Raster::new(self.options.has_depth)))
    }

    fn has_room(&self) -> bool {
        self.finished.is_none()
    }

    fn is_busy(&self) -> bool {
        self.finished.is_some()
    }

    /// Draws a frame.
    fn submit(&mut self, frame: &Frame, pools: &mut dyn Pools, pixels: Pixels) -> Result<Submitted, EngineError> {
        let started_nanos = monotonic_nanos();
        let mut raster = self.raster_of(pixels);
        if self.options.pixels.may_be_host() {
            raster.lay_out(frame.layout());
            self.picture.take_colors(std::mem::take(&mut raster.rgba));
        }
        let prepared_nanos = self.cast(self.choice.method(), frame, pools)?;
        let pixels = self.hand_over(frame, raster);
        self.finished = Some(InFlight::new(frame, self.costs, started_nanos, prepared_nanos).finish(pixels));
        let mut decided = None;
        if self.choice.is_trial_due(started_nanos, frame.end.unavailable_count == 0) {
            let took = self.try_both(frame, pools)?;
            self.choice.decide(took);
            decided = Some(self.choice.words());
        }
        Ok(Submitted { uploads: 0, upload_started_nanos: prepared_nanos, upload_nanos: 0, decided })
    }

    fn poll(&mut self, _timeout: Duration) -> Result<Option<Finished>, EngineError> {
        Ok(self.finished.take())
    }

    fn set_tree_overlay(&mut self, has_overlay: bool) -> Result<(), EngineError> {
        self.options.has_tree_overlay = has_overlay;
        Ok(())
    }

    fn edge(&mut self, camera: &Camera, pools: &dyn Pools, side: usize, put: &mut dyn FnMut(EdgeStretch)) {
        let [ground, _] = &self.grounds;
        self.caster.edge(ground, pools.elevation_pool(), camera, self.detail.post_px, side, put);
    }
}

impl RaysEngine {
    /// How long each of [`METHODS`] takes for a frame, whose picture has been handed over: nobody
    /// sees these. The frame is that much late, and the next one.
    fn try_both(&mut self, frame: &Frame, pools: &mut dyn Pools) -> Result<[Duration; 2], EngineError> {
        // The other one's memory.
        self.cast(METHODS[1], frame, pools)?;
        let mut took = [Duration::ZERO; 2];
        for (method, took) in METHODS.into_iter().zip(&mut took) {
            let started_nanos = monotonic_nanos();
            self.cast(method, frame, pools)?;
            *took = Duration::from_nanos(monotonic_nanos() - started_nanos);
        }
        Ok(took)
    }

    /// Casts the rays of a frame; when its ground was ready, nanoseconds of the monotonic clock.
    fn cast(&mut self, method: Method, frame: &Frame, pools: &mut dyn Pools) -> Result<u64, EngineError> {
        let fail = |index: usize, fault: TileFault| FrameError::Tile { frame: frame.number(), index, fault };
        if frame.elevations.is_empty() {
            self.fill(method, frame, pools)?;
        } else {
            self.fill_in_place(frame, pools)?;
        }
        let ground = &self.grounds[usize::from(method == Method::Coherent)];
        // A vector's memory serves slices of any lifetime, as long as it is empty in between.
        let mut layers: Vec<&[u8]> = std::mem::take(&mut self.layers);
        for (index, tile) in frame.tiles.iter().enumerate() {
            let colors = pools.color(tile.color());
            layers.push(colors.ok_or_else(|| fail(index, TileFault::Stale))?);
        }
        let prepared_nanos = monotonic_nanos();
        let sampling = Sampling {
            interval_voxels: INTERVAL_VOXELS,
            // Nobody sees more.
            voxel_px: 1.0,
        };
        self.detail = SweepDetail::for_facets(frame.marker.r_z_px as f32);
        let [r, g, b, sky_alpha] = self.options.sky_rgba();
        let options = CastOptions {
            method,
            sampling,
            sweep: self.detail,
            sky_rgb: [r, g, b],
            sky_alpha,
            has_undersides: self.has_holes,
            ..CastOptions::default()
        };
        self.costs = DrawCosts::default();
        // Outlines, holes and soft edges are found by how far pixels are.
        let has_depth = self.options.has_depth || self.options.has_tree_overlay;
        let has_validity = self.blocks.world().has_validity();
        self.picture.set_depth(has_depth || has_validity || options.sweep.has_soft_edges);
        self.picture.set_size(frame.layout().size);
        for (index, view) in frame.views.iter().enumerate() {
            self.picture.set_rectangle(view.at, view.size());
            // What the workers did for the ground is not this view's.
            self.caster.workers().take_busy();
            let heights = if frame.elevations.is_empty() { &[] } else { pools.elevation_pool() };
            self.caster.draw(&CastTask {
                ground,
                colors: &layers[..],
                heights,
                camera: &view.camera,
                options: &options,
                picture: &self.picture,
            });
            if self.options.has_tree_overlay {
                self.outlines.clear();
                self.outlines.extend(frame.tiles.iter().map(outline_of));
                self.caster.outline(ground, pools.elevation_pool(), &view.camera, &self.outlines, &self.picture);
            }
            self.costs.push(DrawCost {
                technique: TechniqueChoice::Rays,
                view: index,
                tiles: frame.tiles.len() as u32,
                triangles: 0,
                nanos: Some(self.caster.workers().take_busy().as_nanos() as u64),
            });
        }
        layers.clear();
        self.layers = layers.into_iter().map(|_| &[][..]).collect();
        check_residency(frame, pools)?;
        for (index, tile) in frame.tiles.iter().enumerate() {
            // A slot that was filled again meanwhile breaks the protocol: the picture is not shown.
            if pools.color(tile.color()).is_none() {
                return Err(fail(index, TileFault::Stale).into());
            }
        }
        Ok(prepared_nanos)
    }

    /// Fills the ground of a method with a frame's elevation arrays.
    fn fill(&mut self, method: Method, frame: &Frame, pools: &mut dyn Pools) -> Result<(), EngineError> {
        let fail = |index: usize, fault: TileFault| FrameError::Tile { frame: frame.number(), index, fault };
        let ground = &mut self.grounds[usize::from(method == Method::Coherent)];
        let eye = frame.pose.eye();
        let eye_m = ground.shape().surface.height_m(eye);
        ground.clear(eye_m);
        self.blocks.forget();
        for (index, tile) in frame.tiles.iter().enumerate() {
            let spec = self.blocks.read(tile, pools, eye_m, index as u32)?;
            let spec = spec.map_err(|fault| fail(index, fault))?;
            ground.add(&spec).map_err(|error| fail(index, fault_of(error)))?;
        }
        match method {
            Method::Sweep => ground.finish_for_sweep(),
            _ => ground.finish_for(&Detail { eye_in_world: eye, reach: ACCURATE_REACH, most_bytes: MOST_VOXEL_BYTES }),
        }
        Ok(())
    }

    /// Fills the ground of heights with a frame's tiles of the elevation pool, which stay there.
    fn fill_in_place(&mut self, frame: &Frame, pools: &dyn Pools) -> Result<(), EngineError> {
        let number = frame.number();
        check_residency(frame, pools)?;
        let [ground, _] = &mut self.grounds;
        let world = self.blocks.world();
        ground.clear_in_place();
        for (index, tile) in frame.elevations.iter().enumerate() {
            let fail = |fault: TileFault| FrameError::Elevation { frame: number, index, fault };
            let node = tile.node().ok_or(fail(TileFault::Node))?;
            let origin = world.node_origin(node).map(|v| v as u32);
            let ElevationTile { slot, generation, .. } = *tile;
            let tile = PoolTile { origin, level: node.q(), slot, generation };
            ground.add_pool_tile(&tile, pools.elevation_pool()).map_err(|error| fail(fault_of(error)))?;
        }
        for (index, tile) in frame.tiles.iter().enumerate() {
            let fail = |fault: TileFault| FrameError::Tile { frame: number, index, fault };
            let patch = self.blocks.patch(tile, index as u32).map_err(fail)?;
            ground.add_patch(&patch).map_err(|error| fail(fault_of(error)))?;
        }
        ground.finish_in_place();
        Ok(())
    }

    /// The plain memory of pixels.
    fn raster_of(&self, pixels: Pixels) -> Raster {
        match pixels {
            Pixels::Memory(raster) => raster,
            Pixels::Device(_) => Raster::new(self.options.has_depth),
        }
    }

    /// Gives the picture to sinks: its colours as they are, depth as they read it.
    fn hand_over(&mut self, frame: &Frame, mut raster: Raster) -> Pixels {
        if self.options.pixels.may_be_host() {
            raster.rgba = self.picture.give_colors();
            let size = raster.size();
            if let Some(depths) = &mut raster.reversed_depth {
                for view in frame.views.iter() {
                    self.picture.set_rectangle(view.at, view.size());
                    place_depths(&self.picture, self.caster.workers(), view.at, depths, size);
                }
            }
        }
        Pixels::Memory(raster)
    }
}

/// Writes the depths of a picture to its place in a plane of this size. It lies within it.
fn place_depths(picture: &Picture, workers: &Workers, at: [u32; 2], plane: &mut [f32], size: [u32; 2]) {
    let [x, y] = at.map(|at| at as usize);
    let ([width, height], row) = (picture.size().map(|side| side as usize), size[0] as usize);
    let Some(plane) = plane.get_mut(y * row..(y + height) * row) else { return };
    workers.split(height, plane, &|rows| rows * row, &|rows, out| {
        for (number, out) in rows.zip(out.chunks_exact_mut(row)) {
            for (out, depth) in out[x..x + width].iter_mut().zip(picture.depths(number)) {
                // NaN for the sky, which is infinitely far.
                *out = if depth.is_nan() { 0.0 } else { NEAR_M as f32 / depth.max(f32::MIN_POSITIVE) };
            }
        }
    });
}

/// Whether all tiles of the elevation pool that a frame names are there: one that was filled again
/// breaks the protocol.
fn check_residency(frame: &Frame, pools: &dyn Pools) -> Result<(), FrameError> {
    match frame.elevations.iter().position(|tile| !pools.has_elevation_tile(tile.key())) {
        Some(index) => Err(FrameError::Elevation { frame: frame.number(), index, fault: TileFault::StaleElevation }),
        None => Ok(()),
    }
}

fn fault_of(error: GroundError) -> TileFault {
    match error {
        GroundError::Height { .. } => TileFault::Height,
        GroundError::Occupied { .. } => TileFault::Occupied,
        GroundError::Unattached { .. } => TileFault::Node,
        _ => TileFault::Block,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_methods_are_tried_once_and_the_faster_one_is_taken() {
        let millis = |n: [u64; 2]| n.map(Duration::from_millis);
        for (took, winner) in [([9, 7], Method::Coherent), ([7, 9], Method::Mipmap), ([7, 7], Method::Mipmap)] {
            let mut choice = Choice::of(RaysChoice::Auto);
            assert!(choice.words().starts_with(UNDECIDED) && choice.method() == Method::Mipmap);
            // Nothing is tried while memory is taken and tiles are loaded.
            assert!(!choice.is_trial_due(0, true) && !choice.is_trial_due(1_000_000, true));
            assert!(!choice.is_trial_due(2_000_000, false) && choice.is_trial_due(3_000_000, true));
            choice.decide(millis(took));
            assert_eq!(choice.method(), winner);
            assert!(!choice.is_trial_due(u64::MAX, true));
            assert!(
                !choice.words().starts_with(UNDECIDED) && choice.words().contains("mipmap 7.0 ms") == (took[0] == 7)
            );
        }
        let mut never_settled = Choice::of(RaysChoice::Auto);
        assert!((0..9).all(|n| !never_settled.is_trial_due(n * 100_000_000, false)));
        assert!(never_settled.is_trial_due(1_000_000_000, false));
    }

    #[test]
    fn what_was_asked_for_is_never_tried() {
        for (rays, method) in [(RaysChoice::Mipmap, Method::Mipmap), (RaysChoice::Coherent, Method::Coherent)] {
            let mut choice = Choice::of(rays);
            assert!((0..9).all(|n| !choice.is_trial_due(n * 1_000_000_000, true)) && choice.method() == method);
        }
    }
}
