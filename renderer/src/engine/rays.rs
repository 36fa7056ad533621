//! The engine of rays: the ground of a frame, its elevation arrays and colour tiles as they are in shared memory, cast on the
//! processor's cores. No Vulkan.

use super::{Described, EngineError, EngineOptions, Finished, InFlight, Submitted};
use crate::frame::{Frame, FrameError, TileFault};
use crate::pixels::{Pixels, Raster};
use crate::source::{FrameSource, SourceShape};
use crate::technique::{BlockReader, NEAR_M};
use std::time::Duration;
use terravision_common::event::{Event, EventKind, monotonic_nanos};
use terravision_common::run::{RaysChoice, TechniqueChoice};
use terravision_raycast::ground::{Detail, Filter, Ground, GroundError};
use terravision_raycast::view::Sampling;
use terravision_raycast::world::ground_shape;
use terravision_raycast::{CastOptions, Caster, Method, Picture};

/// Frames by which each method is tried before the faster one is taken. The first of each warms up and does not count.
const TRIALS: u32 = 3;
/// Longest side of a picture, pixels: that of the software device.
const LONGEST_SIDE: u32 = 16384;
/// Distance of samples along rays through voxels, voxels.
const INTERVAL_VOXELS: f32 = 0.6;
/// Tiles up to this many times as far as the nearest one have voxels: an octave of distance, which is a level. The others are drawn
/// by their heights: as near to the truth, for less (docs/techniques.md).
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
    picture: Picture,
    /// Of each tile of the ground its colours; empty between frames, kept for its memory.
    layers: Vec<&'static [u8]>,
    finished: Option<Finished>,
    choice: Choice,
    options: EngineOptions,
}

/// Which method, and how far that is known.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Choice {
    Fixed(Method),
    /// Times of both methods so far.
    Trying {
        tried: u32,
        nanos: [u64; 2],
    },
}

/// The methods that are compared.
const METHODS: [Method; 2] = [Method::Mipmap, Method::Coherent];

impl Choice {
    fn of(rays: RaysChoice) -> Self {
        match rays {
            // Without a device the processor casts the same rays.
            RaysChoice::Mipmap | RaysChoice::Compute => Self::Fixed(Method::Mipmap),
            RaysChoice::Coherent => Self::Fixed(Method::Coherent),
            RaysChoice::Auto => Self::Trying { tried: 0, nanos: [0; 2] },
        }
    }

    fn method(&self) -> Method {
        match self {
            Self::Fixed(method) => *method,
            Self::Trying { tried, .. } => METHODS[*tried as usize % METHODS.len()],
        }
    }

    /// A frame took so long; whether the choice has been made with it.
    fn learn(&mut self, took: Duration) -> bool {
        let Self::Trying { tried, nanos } = self else { return false };
        let way = *tried as usize % METHODS.len();
        if *tried as usize >= METHODS.len() {
            nanos[way] += took.as_nanos() as u64;
        }
        *tried += 1;
        let is_over = *tried == TRIALS * METHODS.len() as u32;
        if is_over {
            *self = Self::Fixed(METHODS[usize::from(nanos[1] < nanos[0])]);
        }
        is_over
    }

    fn words(&self) -> &'static str {
        match self {
            Self::Fixed(Method::Mipmap) => "mipmap: one exact ray a pixel",
            Self::Fixed(_) => "coherent: voxels along lines of pixels",
            Self::Trying { .. } => "auto",
        }
    }
}

impl RaysEngine {
    /// Makes all that frames of this source need.
    ///
    /// # Errors
    /// Something that rays cannot do is asked for, or the system gives no threads.
    pub fn new(options: EngineOptions, source: &dyn FrameSource) -> Result<Self, EngineError> {
        if options.has_tree_overlay {
            return Err(EngineError::MeshOnly { what: "the leaves of the quad tree over the picture" });
        }
        if options.samples != 1 {
            return Err(EngineError::MeshOnly { what: "several samples per pixel" });
        }
        if options.size.iter().any(|side| *side > LONGEST_SIDE) {
            return Err(EngineError::PictureSize { size: options.size, limit: LONGEST_SIDE });
        }
        let SourceShape { world, texels, .. } = source.shape();
        if texels.is_compressed() {
            return Err(EngineError::MeshOnly { what: "block-compressed colour tiles" });
        }
        Ok(Self {
            caster: Caster::new(options.workers)?,
            grounds: [None, Some(Filter::OrientedBox)].map(|filter| Ground::new(ground_shape(&world, filter))),
            blocks: BlockReader::new(&world),
            picture: Picture::new(options.size),
            layers: Vec::with_capacity(4096),
            finished: None,
            choice: Choice::of(options.rays),
            options,
        })
    }

    /// What draws.
    #[must_use]
    pub fn describe(&self) -> Described {
        let workers = self.caster.workers().count();
        let device = format!("CPU, {workers} worker{}", if workers == 1 { "" } else { "s" });
        Described { technique: TechniqueChoice::Rays.name(), device, driver: self.choice.words().to_owned() }
    }

    /// A buffer for a picture.
    #[must_use]
    pub fn new_pixels(&self) -> Pixels {
        Pixels::Memory(Raster::new(self.options.size, self.options.has_depth))
    }

    /// Whether a frame has not been taken yet.
    #[must_use]
    pub fn is_busy(&self) -> bool {
        self.finished.is_some()
    }

    /// The frame that was drawn last.
    pub fn take_finished(&mut self) -> Option<Finished> {
        self.finished.take()
    }

    /// Draws a frame. There must be room.
    ///
    /// # Errors
    /// The frame names what is not there.
    pub fn submit(
        &mut self,
        frame: &Frame,
        source: &mut dyn FrameSource,
        pixels: Pixels,
    ) -> Result<Submitted, EngineError> {
        let started_nanos = monotonic_nanos();
        let fail = |index: usize, fault: TileFault| FrameError::Tile { frame: frame.marker.frame, index, fault };
        let method = self.choice.method();
        let ground = &mut self.grounds[usize::from(method != Method::Mipmap)];
        ground.clear(frame.marker.camera.eye_in_world[2]);
        self.blocks.forget();
        for (index, tile) in frame.tiles.iter().enumerate() {
            let spec = self.blocks.read(tile, source, frame.marker.camera.eye_in_world[2], index as u32)?;
            let spec = spec.map_err(|fault| fail(index, fault))?;
            ground.add(&spec).map_err(|error| fail(index, fault_of(error)))?;
        }
        ground.finish_for(&Detail {
            eye_in_world: frame.marker.camera.eye_in_world.into(),
            reach: ACCURATE_REACH,
            most_bytes: MOST_VOXEL_BYTES,
        });
        // A vector's memory serves slices of any lifetime, as long as it is empty in between.
        let mut layers: Vec<&[u8]> = std::mem::take(&mut self.layers);
        for (index, tile) in frame.tiles.iter().enumerate() {
            let colors = source.color(tile.color_slot, tile.color_generation);
            layers.push(colors.ok_or_else(|| fail(index, TileFault::Stale))?);
        }
        let prepared_nanos = monotonic_nanos();
        let sampling = Sampling {
            interval_voxels: INTERVAL_VOXELS,
            // Nobody sees more.
            voxel_px: 1.0,
        };
        let options = CastOptions { method, is_approximate: false, sampling, sky_rgb: self.options.sky_rgb };
        self.caster.draw(ground, &layers[..], &frame.marker.camera, &options, &self.picture);
        layers.clear();
        self.layers = layers.into_iter().map(|_| &[][..]).collect();
        for (index, tile) in frame.tiles.iter().enumerate() {
            // Whoever filled a slot anew meanwhile broke the protocol: the picture is not shown.
            if source.color(tile.color_slot, tile.color_generation).is_none() {
                return Err(fail(index, TileFault::Stale).into());
            }
        }
        let pixels = self.hand_over(pixels);
        let finished = InFlight::new(frame, 0, started_nanos, prepared_nanos).finish(None, pixels);
        if self.choice.learn(Duration::from_nanos(finished.finished_nanos - started_nanos)) {
            for event in Event::text(EventKind::DriverName, self.choice.words()) {
                source.event(&event);
            }
        }
        self.finished = Some(finished);
        Ok(Submitted { uploads: 0, upload_started_nanos: prepared_nanos, upload_nanos: 0 })
    }

    /// Copies the picture to where sinks read it.
    fn hand_over(&self, pixels: Pixels) -> Pixels {
        let mut raster = match pixels {
            Pixels::Memory(raster) if raster.size == self.options.size => raster,
            Pixels::Memory(_) | Pixels::Device(_) => Raster::new(self.options.size, self.options.has_depth),
        };
        let ([width, height], workers) = (self.options.size.map(|side| side as usize), self.caster.workers());
        workers.split(height, &mut raster.rgba, &|row| row * width, &|rows, out| {
            for (out, (texel, _)) in out.iter_mut().zip(self.picture.rows(rows)) {
                *out = texel.to_le();
            }
        });
        if let Some(depths) = &mut raster.reversed_depth {
            workers.split(height, depths, &|row| row * width, &|rows, out| {
                for (out, (_, depth)) in out.iter_mut().zip(self.picture.rows(rows)) {
                    // NaN for the sky, which is infinitely far.
                    *out = if depth.is_nan() { 0.0 } else { NEAR_M as f32 / depth.max(f32::MIN_POSITIVE) };
                }
            });
        }
        Pixels::Memory(raster)
    }
}

fn fault_of(error: GroundError) -> TileFault {
    match error {
        GroundError::Height { .. } => TileFault::Height,
        GroundError::Occupied { .. } => TileFault::Occupied,
        _ => TileFault::Block,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_faster_method_is_taken_after_both_were_tried_alike() {
        let mut choice = Choice::of(RaysChoice::Auto);
        let mut methods = Vec::new();
        for turn in 1..=6 {
            methods.push(choice.method());
            let millis = match choice.method() {
                Method::Mipmap if turn > 2 => 9,
                Method::Mipmap => 1,
                _ => 7,
            };
            assert_eq!(choice.learn(Duration::from_millis(millis)), turn == 6);
        }
        assert_eq!(methods, [METHODS, METHODS, METHODS].concat());
        assert_eq!(choice, Choice::Fixed(Method::Coherent), "{choice:?}");
        assert!(!choice.learn(Duration::ZERO));
    }
}
