//! Pictures of a ground.

use crate::coherent::{self, Planes, Sampling, VoxelLines, VoxelRays};
use crate::counts::Counts;
use crate::exact::{CHUNK, ExactRays, Follower, HighestSeen, Projected, Target};
use crate::lines::Lines;
use crate::model::Ground;
use crate::picture::Picture;
use crate::proof::steepness::Plane;
use crate::proof::{StartRule, Steepness};
use crate::scene::{Placed, Scene};
use crate::shade::strip::{Line, Strips};
use crate::shade::{Canvas, Footprints, outline};
use crate::sweep::{self, EdgeStretch, Sweep, SweepDetail};
use crate::view::View;
use crate::workers::{Workers, WorkersError};
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use terravision_common::camera::Camera;
use terravision_common::simd::Instructions;

/// How rays are cast.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Method {
    /// Lines of voxel samples, each ray starting where the one below it hit.
    #[default]
    Coherent,
    /// One exact ray per pixel through a pyramid of maxima: no voxels, no assumption about lines. A
    /// ground without voxels is always drawn with this method.
    Mipmap,
    /// Vertical planes, swept outwards once: heights sampled at steps of some pixels.
    Sweep,
}

/// Options of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CastOptions {
    /// How rays are cast.
    pub method: Method,
    /// The paper's approximate mode: tiles with voxels are drawn as if they had none, and no ray
    /// looks between its samples.
    pub is_approximate: bool,
    /// Whether rays look between samples for hills that are narrower than a sampling interval. The
    /// rays of the paper do not.
    pub looks_between: bool,
    /// How densely rays are sampled.
    pub sampling: Sampling,
    /// How densely the ground is sampled by a sweep.
    pub sweep: SweepDetail,
    /// Colour where no ground is.
    pub sky_rgb: [u8; 3],
    /// Alpha there: 255, or 0 for who has to know later how much of a pixel is ground.
    pub sky_alpha: u8,
    /// Whether an eye above the ground also sees its underside, through holes.
    pub has_undersides: bool,
}

impl Default for CastOptions {
    fn default() -> Self {
        Self {
            method: Method::Coherent,
            is_approximate: false,
            looks_between: true,
            sampling: Sampling { interval_voxels: 0.6, voxel_px: 1.0 },
            sweep: SweepDetail::DEFAULT,
            sky_rgb: [150, 190, 235],
            sky_alpha: 255,
            has_undersides: false,
        }
    }
}

/// A picture to draw: what of, from where, how, and into what.
#[derive(Debug, Clone, Copy)]
pub struct CastTask<'a> {
    /// The ground. Heights are drawn as stored: apply vertical exaggeration when filling it.
    pub ground: &'a Ground,
    /// RGBA8 of each layer, mip levels back to back, row 0 of each in the north; a layer that is
    /// missing or too short is drawn black.
    pub colors: &'a [&'a [u8]],
    /// The elevation pool, for a ground whose heights lie in it; it is drawn by a sweep alone.
    pub heights: &'a [f32],
    /// The camera: valid, and of the picture's size.
    pub camera: &'a Camera,
    /// How.
    pub options: &'a CastOptions,
    /// What is drawn into. A picture has depth of a ground that is partly unmeasured,
    /// and where a sweep has soft edges.
    pub picture: &'a Picture,
}

/// Draws pictures; keeps its memory from one to the next.
#[derive(Debug)]
pub struct Caster {
    workers: Workers,
    lines: Lines,
    placed: Vec<Placed>,
    steepness: Steepness,
    /// For coherent rays.
    planes: Planes,
    /// For exact rays that follow the ground.
    projected: Projected,
    /// For exact rays, one for each worker.
    exact: Vec<Mutex<ExactMemory>>,
    sweep: Sweep,
}

/// What a worker needs for a block of lines of exact rays.
#[derive(Debug, Default)]
struct ExactMemory {
    strips: Strips,
    footprints: Footprints,
    seen: Vec<HighestSeen>,
}

impl Caster {
    /// With this many threads, the calling one among them.
    ///
    /// # Errors
    /// The system gives no threads.
    pub fn new(workers: usize) -> Result<Self, WorkersError> {
        let workers = Workers::new(workers)?;
        Ok(Self {
            exact: (0..workers.count()).map(|_| Mutex::default()).collect(),
            sweep: Sweep::new(workers.count()),
            workers,
            lines: Lines::default(),
            placed: Vec::new(),
            steepness: Steepness::default(),
            planes: Planes::default(),
            projected: Projected::default(),
        })
    }

    /// Draws a picture, which does not depend on the number of workers.
    ///
    /// # Panics
    /// When camera and picture differ in size, or a side is longer than 65,535 pixels.
    pub fn draw(&mut self, task: &CastTask<'_>) -> Counts {
        let ground = task.ground;
        let method = method_for(ground, task.options);
        if method == Method::Sweep {
            return self.sweep(task);
        }
        let eye = task.camera.eye();
        let plane = ground.shape().surface;
        let on_lattice = plane.lattice_of_foot(plane.foot(eye)).to_array();
        let above_datum = plane.height_above(eye, ground.datum_m()) as f32;
        let surface = if method == Method::Coherent { Plane::Voxels } else { Plane::Facets };
        let mut steepness = std::mem::take(&mut self.steepness);
        steepness.set(ground, on_lattice, above_datum, surface);
        let counts = self.draw_by(&steepness, task);
        self.steepness = steepness;
        counts
    }

    fn sweep(&mut self, task: &CastTask<'_>) -> Counts {
        let &CastTask { ground, colors, heights, camera, options, picture } = task;
        assert_eq!(picture.size(), [camera.width(), camera.height()], "a picture has its camera's size");
        assert!(picture.has_depth() || !options.sweep.has_soft_edges, "edges are found by depth");
        let Self { workers, placed, sweep, .. } = self;
        let scene = Scene::new(ground, View::new(camera), placed, options.has_undersides)
            .in_place(heights, options.sweep.post_px);
        let canvas = Canvas { scene: &scene, colors, picture, sky: sky(options) };
        let rays = u64::from(camera.width()) * u64::from(camera.height());
        let is_partly_unmeasured = ground.is_partly_unmeasured();
        assert!(picture.has_depth() || !is_partly_unmeasured, "holes are looked for where pixels lie");
        let counts = Counts { rays, ..sweep.draw(&canvas, camera, &options.sweep, workers) };
        if is_partly_unmeasured && ground.pyramid().is_none() {
            canvas.look_at_shares(workers);
        }
        counts
    }

    /// By which instructions sweeps are done: the widest that there are, unless another choice has
    /// been made.
    #[must_use]
    pub fn instructions(&self) -> Instructions {
        self.sweep.instructions()
    }

    /// Has sweeps done by other instructions, to compare with. The picture does not depend on them.
    pub fn set_instructions(&mut self, instructions: Instructions) {
        self.sweep.set_instructions(instructions);
    }

    /// The same with another start rule, for comparisons. A sweep, which has no rays that start, is
    /// drawn by exact rays.
    ///
    /// # Panics
    /// As [`Caster::draw`].
    pub fn draw_by<R: StartRule>(&mut self, rule: &R, task: &CastTask<'_>) -> Counts {
        let &CastTask { ground, colors, camera, options, picture, .. } = task;
        assert_eq!(picture.size(), [camera.width(), camera.height()], "a picture has its camera's size");
        assert!(ground.pyramid().is_none(), "heights in place are drawn by a sweep alone");
        assert!(picture.size().iter().all(|side| *side <= Line::LONGEST), "no side is longer than {}", Line::LONGEST);
        self.lines.set(picture.size(), camera.roll_rad());
        let Self { workers, lines, placed, planes, projected, exact, .. } = self;
        let scene = Scene::new(ground, View::new(camera), placed, options.has_undersides);
        let canvas = Canvas { scene: &scene, colors, picture, sky: sky(options) };
        let counts = match method_for(ground, options) {
            Method::Coherent => {
                planes.set_for(&scene, &options.sampling);
                draw_coherent(workers, lines, &canvas, planes, rule, options)
            }
            Method::Mipmap | Method::Sweep => {
                if rule.slopes().is_some() {
                    projected.set(&scene, workers);
                }
                draw_exact(workers, lines, &canvas, projected, rule, exact)
            }
        };
        if ground.is_partly_unmeasured() {
            assert!(picture.has_depth(), "holes are looked for where pixels lie");
            canvas.look_at_shares(workers);
        }
        counts
    }

    /// Draws the outlines of tiles over the picture that was drawn last, which must be of this
    /// ground and camera. `outlines`: the colour of each tile, RGBA8, red in the lowest byte; a
    /// tile without a colour has no outline. `heights`: as in [`CastTask`]. The result does not depend
    /// on the number of workers.
    pub fn outline(&mut self, ground: &Ground, heights: &[f32], camera: &Camera, outlines: &[u32], picture: &Picture) {
        let scene = Scene::new(ground, View::new(camera), &mut self.placed, false).in_place(heights, 1.0);
        outline::draw(&scene, outlines, picture, &self.workers);
    }

    /// The edge of a ground in place along the west, east, south or north side of the world (0 to 3),
    /// as a sweep with posts at most `post_px` pixels apart draws it: stretches in order, from the
    /// south or west. `heights`: as in [`CastTask`].
    pub fn edge(
        &mut self,
        ground: &Ground,
        heights: &[f32],
        camera: &Camera,
        post_px: f32,
        side: usize,
        put: &mut dyn FnMut(EdgeStretch),
    ) {
        let scene = Scene::new(ground, View::new(camera), &mut self.placed, false).in_place(heights, post_px);
        let has_validity = scene.pyramid().is_some_and(|(pyramid, _)| pyramid.has_validity());
        sweep::edge(&scene, side, has_validity, put);
    }

    /// Its threads.
    #[must_use]
    pub fn workers(&self) -> &Workers {
        &self.workers
    }
}

/// The method that a ground can be drawn with: a ground without voxels has only heights.
fn method_for(ground: &Ground, options: &CastOptions) -> Method {
    match options.method {
        _ if ground.pyramid().is_some() => Method::Sweep,
        Method::Coherent if !ground.has_voxels() => Method::Mipmap,
        method => method,
    }
}

fn sky(options: &CastOptions) -> u32 {
    let [r, g, b] = options.sky_rgb;
    u32::from_le_bytes([r, g, b, options.sky_alpha])
}

fn draw_coherent<R: StartRule>(
    workers: &Workers,
    lines: &Lines,
    canvas: &Canvas<'_>,
    planes: &Planes,
    rule: &R,
    options: &CastOptions,
) -> Counts {
    let looks_between = options.looks_between && !options.is_approximate;
    let filter = canvas.scene.ground.shape().filter;
    let fall = if looks_between { coherent::fall(filter) } else { f32::NEG_INFINITY };
    let rays = VoxelRays { scene: canvas.scene, planes, fall };
    let voxel_lines = VoxelLines { rays, canvas, rule };
    share_lines(workers, lines.count(), |_worker, block| {
        let cast = |line: usize| match options.is_approximate {
            true => voxel_lines.cast_line::<true>(lines.pixels(line)),
            false => voxel_lines.cast_line::<false>(lines.pixels(line)),
        };
        block.map(cast).fold(Counts::default(), |sum, counts| sum + counts)
    })
}

fn draw_exact<R: StartRule>(
    workers: &Workers,
    lines: &Lines,
    canvas: &Canvas<'_>,
    projected: &Projected,
    rule: &R,
    memory: &[Mutex<ExactMemory>],
) -> Counts {
    let scene = canvas.scene;
    let follower = rule.slopes().map(|slopes| Follower { scene, projected, slopes });
    let rays = ExactRays { scene, rule, follower };
    share_lines(workers, lines.count(), |worker, block| {
        // Used by one worker only. Contents left by a panic are overwritten before they are read.
        let mut memory = memory[worker].lock().unwrap_or_else(PoisonError::into_inner);
        let ExactMemory { strips, footprints, seen } = &mut *memory;
        let longest = lines.size()[0].max(lines.size()[1]) as usize;
        strips.begin(longest);
        footprints.reserve(Strips::MOST * longest);
        seen.clear();
        seen.resize(2 * (longest / CHUNK + 2), HighestSeen::NOTHING);
        let count = block.len();
        let mut counts = Counts::default();
        for (at, line) in block.enumerate() {
            let strip = strips.strip(at, lines, line);
            counts = counts + rays.find_line(&mut Target { strip, seen: &mut *seen });
        }
        footprints.measure(scene, &strips.runs);
        canvas.paint(&strips.lines[..count], footprints);
        counts
    })
}

/// The share of the remaining lines that a worker takes: one in this many.
const SHARES: usize = 16;
/// Fewest lines at a time: 4 pixels of 8 bytes, half a cache line.
const FEWEST_LINES: usize = 4;

/// How many neighbouring lines a worker takes at a time when `left` lines remain. Neighbours share
/// facets and cache lines, so large blocks cost less; small blocks at the end keep other workers
/// from waiting for the last one. This is guided self-scheduling (Polychronopoulos and Kuck, 1987),
/// for up to about sixteen workers. It does not use the real number of workers: lines of a block
/// share footprints, and the picture must not depend on workers. The paper interleaves lines
/// statically, so that all workers wait for a core that another process uses too.
fn lines_at_a_time(left: usize) -> usize {
    (left / SHARES).clamp(FEWEST_LINES, Strips::MOST).min(left)
}

/// Lets workers draw blocks of neighbouring lines until all are drawn; `draw` gets the number of
/// the worker.
fn share_lines(workers: &Workers, count: usize, draw: impl Fn(usize, Range<usize>) -> Counts + Sync) -> Counts {
    let next = AtomicUsize::new(0);
    workers.run(|worker| {
        let mut counts = Counts::default();
        loop {
            let after = |first: usize| first + lines_at_a_time(count - first);
            let take = |first: usize| (first < count).then(|| after(first));
            // Relaxed: any free worker takes the next lines, and the result does not depend on
            // which worker it is.
            let Ok(first) = next.fetch_update(Ordering::Relaxed, Ordering::Relaxed, take) else { return counts };
            counts = counts + draw(worker, first..after(first));
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_worker_of_sixteen_waits_long_for_the_last() {
        for lines in [1, 3, 500, 1280, 3840] {
            // Each line takes equally long; the first free worker takes the next block.
            let mut busy_until = [0usize; 16];
            let mut first = 0;
            while first < lines {
                let count = lines_at_a_time(lines - first);
                assert!(count > 0 && count <= Strips::MOST && first + count <= lines);
                *busy_until.iter_mut().min().unwrap() += count;
                first += count;
            }
            let [least, most] = [busy_until.iter().min().unwrap(), busy_until.iter().max().unwrap()];
            assert!(most - least <= 2 * FEWEST_LINES, "{lines} lines: {busy_until:?}");
        }
    }
}
