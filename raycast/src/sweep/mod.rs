//! The sweep: what ray coherence (voxel-flythrough-1999 §4 to §6) becomes on processors with wide
//! registers.
//!
//! All rays of a vertical plane through the eye lie over one line on the ground. A plane is swept
//! outwards once, front to back, and sixteen neighboring planes are the lanes of a vector. Nothing
//! is assumed of the ground, no ray steps back: for the surface that is sampled the picture is that
//! of plain ray casting.
//!
//! ```text
//! camera ─▶ sector: up to four parts around the vertical's vanishing point ─▶ fan: planes, steps outwards
//!    strips of 128 lines, to whichever worker is free:
//!    trace: heights under sixteen planes, horizon by horizon ─▶ strip: nearness of rows
//!    beyond: once more, for rows that met a hole ─▶ strip: nearness through holes
//!    shade: rows of pixels ─▶ place, footprint ─▶ texels, out of the tiles' layers in place ─▶ picture
//!    edges: at best, pixels on silhouettes: what their middle does not see is mixed in
//! ```
//!
//! The surface is that of all methods: facets of the ground's tiles. It is sampled at steps of so
//! many pixels, as if it faced the eye, and drawn straight between them. Kernels are written over
//! vectors of sixteen numbers (`terravision_common::simd`), done by the widest instructions that the processor
//! has ([`Instructions`]), with the same bits by all of them.

mod beyond;
mod border;
mod edges;
mod fan;
mod heights;
mod holes;
mod sector;
mod shade;
mod stretch;
mod strip;
mod surface;
#[cfg(test)]
mod tests;
mod texels;
mod through;
mod trace;

use crate::counts::Counts;
use crate::scene::Scene;
use crate::shade::Canvas;
use crate::workers::Workers;
pub use border::EdgeStretch;
use fan::{Block, Fan};
use sector::{Row, Sector};
use shade::Shader;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use strip::{LINES, Strip};
use surface::Plane;
use terravision_common::camera::Camera;
use terravision_common::simd::{Instructions, LANES, Simd, Work};
use trace::Tracer;

/// Blocks of a strip at most.
const BLOCKS: usize = LINES / LANES;
/// The share of the blocks that are left which a strip has, and blocks of one at least: the last ones
/// are narrow, so that no worker waits long for another one, while every strip adds half a vector to
/// each of its rows. (The picture must not depend on how many workers there are.)
const SHARE: usize = 3;
const FEWEST_BLOCKS: usize = 2;
/// A picture has no more sectors.
const MOST_SECTORS: usize = 4;

/// How densely the ground is sampled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SweepDetail {
    /// From step to step outwards, pixels of the picture at that distance: smaller steps follow
    /// crests more closely and cost more.
    pub step_px: f32,
    /// But no shorter than this share of the finest spacing of posts. Between two steps the ground is
    /// taken for straight, so that edges of facets are cut off by up to a step: the shorter, the
    /// truer is ground whose posts are many pixels apart.
    pub of_spacing: f32,
    /// From post to post at most, where heights lie in levels of the elevation pool: the level of
    /// a place is chosen by its distance.
    pub post_px: f32,
    /// Planes to a pixel where they are widest apart in the picture; between two is interpolated.
    pub lines_per_px: f32,
    /// Width of a texel, in lengths of a pixel's footprint along the line of sight.
    pub footprint_along: f32,
    /// The same across it. The larger one of both is taken.
    pub footprint_across: f32,
    /// Whether two texels of a footprint are averaged.
    pub has_two_taps: bool,
    /// Whether pixels on edges of ground, against ground behind it and the sky, show both sides.
    pub has_soft_edges: bool,
}

impl SweepDetail {
    /// Fewest samples for a good picture.
    pub const DEFAULT: Self = Self {
        step_px: 3.0,
        of_spacing: 0.25,
        post_px: 3.0,
        lines_per_px: 0.4,
        footprint_along: 0.5,
        footprint_across: 0.7,
        has_two_taps: false,
        has_soft_edges: false,
    };
    /// As near to the truth as it gets.
    pub const BEST: Self = Self {
        step_px: 1.0,
        of_spacing: 0.125,
        post_px: 1.0,
        lines_per_px: 0.6,
        has_two_taps: true,
        has_soft_edges: true,
        ..Self::DEFAULT
    };

    /// As densely as facets of this size are: a cell of two facets is as wide as the square root of
    /// two. Then no leaf of the tree is coarser than its distance wants. Steps are no longer than by
    /// default, however coarse heights are.
    #[must_use]
    pub fn for_facets(facet_px: f32) -> Self {
        let post_px = std::f32::consts::SQRT_2 * facet_px;
        let step_px = post_px.clamp(Self::BEST.step_px, Self::DEFAULT.step_px);
        let usual = if step_px <= 2.0 { Self::BEST } else { Self::DEFAULT };
        Self { step_px, post_px, ..usual }
    }
}

/// What sweeps keep from frame to frame.
#[derive(Debug)]
pub(crate) struct Sweep {
    instructions: Instructions,
    fans: Vec<Fan>,
    rows: Vec<Row>,
    /// Sector, and first and last block but one, of each strip.
    strips: Vec<(usize, Range<usize>)>,
    /// Of each worker.
    memory: Vec<Mutex<Strip>>,
}

impl Sweep {
    pub(crate) fn new(workers: usize) -> Self {
        Self {
            instructions: Instructions::widest(),
            fans: (0..MOST_SECTORS).map(|_| Fan::default()).collect(),
            rows: Vec::new(),
            strips: Vec::new(),
            memory: (0..workers).map(|_| Mutex::default()).collect(),
        }
    }

    /// By which instructions kernels are done.
    pub(crate) fn instructions(&self) -> Instructions {
        self.instructions
    }

    /// By which instructions kernels are done from now on.
    pub(crate) fn set_instructions(&mut self, instructions: Instructions) {
        self.instructions = instructions;
    }

    /// Draws a scene into its picture.
    pub(crate) fn draw(
        &mut self,
        canvas: &Canvas<'_>,
        camera: &Camera,
        detail: &SweepDetail,
        workers: &Workers,
    ) -> Counts {
        let has_holes = canvas.scene.has_holes_in_place();
        let count = self.set(canvas.scene, camera, detail, has_holes);
        let Self { instructions, fans, strips, memory, .. } = &*self;
        let fans = &fans[..count];
        let next = AtomicUsize::new(0);
        workers.run(|worker| {
            // A worker's own. What a panic has left in it is not looked at.
            let mut strip = memory[worker].lock().unwrap_or_else(PoisonError::into_inner);
            let mut counts = Counts::default();
            // Relaxed: which worker takes a strip shows nowhere.
            while let Some((fan, blocks)) = strips.get(next.fetch_add(1, Ordering::Relaxed)) {
                let work =
                    StripWork { canvas, fan: &fans[*fan], first: blocks.start, end: blocks.end, detail, has_holes };
                counts.samples += instructions.run(Trace { work, strip: &mut strip });
                counts.hits += instructions.run(Shade { work, strip: &strip });
            }
            counts
        })
    }

    /// Makes the sectors, planes and strips of a frame; how many sectors there are.
    fn set(&mut self, scene: &Scene<'_>, camera: &Camera, detail: &SweepDetail, has_holes: bool) -> usize {
        let Self { fans, rows, strips, memory, .. } = self;
        let size = [camera.width(), camera.height()];
        let longest = size[0].max(size[1]) as usize;
        for strip in memory {
            strip.get_mut().unwrap_or_else(PoisonError::into_inner).reserve(longest, has_holes);
        }
        fans.iter_mut().for_each(|fan| fan.reserve(scene, size, detail));
        rows.reserve(longest.saturating_sub(rows.len()));
        strips.clear();
        strips.reserve(fans.iter().map(|fan| fan.blocks.capacity() / FEWEST_BLOCKS + 1).sum());
        let mut count = 0;
        let mut put = |sector: Sector, rows: &[Row]| {
            fans[count].set(sector, rows, scene, detail);
            strips.extend(strips_of(fans[count].blocks.len()).map(|blocks| (count, blocks)));
            count += 1;
        };
        Sector::all(camera, f64::from(detail.lines_per_px), &mut put, rows);
        count
    }
}

/// The blocks of a sector's strips.
fn strips_of(count: usize) -> impl Iterator<Item = Range<usize>> {
    let mut first = 0;
    std::iter::from_fn(move || {
        let left = count - first;
        let blocks = first..first + (left / SHARE).clamp(FEWEST_BLOCKS, BLOCKS).min(left);
        first = blocks.end;
        (!blocks.is_empty()).then_some(blocks)
    })
}

/// The edge of a scene's ground along the west, east, south or north side of the world (0 to 3),
/// where its heights are in place.
pub(crate) fn edge(scene: &Scene<'_>, side: usize, has_validity: bool, put: &mut dyn FnMut(EdgeStretch)) {
    if let Some(surface) = Plane::new(scene) {
        surface.edge(side, has_validity, put);
    }
}

/// A strip to be swept and shaded.
#[derive(Clone, Copy)]
struct StripWork<'a> {
    canvas: &'a Canvas<'a>,
    fan: &'a Fan,
    /// Its first block, and the one behind its last.
    first: usize,
    end: usize,
    detail: &'a SweepDetail,
    /// Whether ground may be a hole, or may have been filled.
    has_holes: bool,
}

impl<'a> StripWork<'a> {
    fn blocks(&self) -> &'a [Block] {
        &self.fan.blocks[self.first..self.end]
    }
}

/// What its lines see; how many samples that took.
struct Trace<'a> {
    work: StripWork<'a>,
    strip: &'a mut Strip,
}

impl Work for Trace<'_> {
    type Output = u64;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> u64 {
        let Self { work, strip } = self;
        let mut samples = 0;
        for (number, block) in work.blocks().iter().enumerate() {
            let Some(mut tracer) = Tracer::new(simd, work.canvas.scene, work.fan, block) else { continue };
            tracer.trace(strip, number * LANES);
            if work.has_holes {
                tracer.look_beyond(strip, number * LANES);
            }
            samples += tracer.samples;
        }
        samples
    }
}

/// Its pixels; how many of them are ground.
struct Shade<'a> {
    work: StripWork<'a>,
    strip: &'a Strip,
}

impl Work for Shade<'_> {
    type Output = u64;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> u64 {
        let StripWork { canvas, fan, first, end, detail, has_holes } = self.work;
        let lines = first * LANES..end * LANES;
        let Some(mut shader) = Shader::new(simd, canvas, fan, detail) else { return 0 };
        if has_holes {
            shader.look_through_holes();
        }
        let ground = shader.shade(self.strip, lines.clone());
        if detail.has_soft_edges {
            shader.soften(self.strip, lines);
        }
        ground
    }
}
