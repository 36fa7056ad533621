//! Pictures of a ground.

use crate::coherent::cast::{Coherence, Counts, LineOptions};
use crate::exact::projected::Projected;
use crate::exact::strip::{Line, Strips};
use crate::frame::{Frame, Placed, is_beside_world, place};
use crate::lines::Lines;
use crate::model::{Ground, Tile};
use crate::picture::Picture;
use crate::steepness::Steepness;
use crate::view::{Planes, Sampling, View, Voxels};
use crate::workers::{Workers, WorkersError};
use glam::Vec2;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use terravision_common::camera::Camera;

/// Neighbouring lines that one worker takes at a time, of so many that are left. Neighbours share facets and cache lines, so that many at
/// once cost less; few at the end keep others from waiting for the last one: guided self-scheduling (Polychronopoulos and Kuck, 1987), for
/// up to about sixteen workers. Not by how many there really are: neighbours of a block share footprints, and the picture must
/// not depend on workers. The paper's interleave, worked out beforehand, lets all wait for a core that something else uses as well.
fn lines_at_a_time(left: usize) -> usize {
    (left / SHARES).clamp(FEWEST_LINES, Strips::MOST).min(left)
}

/// Parts of what is left, one of which is taken.
const SHARES: usize = 16;
/// Fewest lines at a time: 4 pixels of 8 bytes, half a cache line.
const FEWEST_LINES: usize = 4;

/// Share of the fall of densities across a surface with which they fall along a ray, at most: up to 45 degrees between the two.
/// With 1 rays look at a twentieth more samples and find the same; with a half they miss a twentieth of what is found, with a third
/// a quarter (pixels that are sky to them and ground to the mesh, in a view with hills before the sky).
const FALL_TRUSTED: f32 = 0.7;

/// How rays are cast.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Method {
    /// Lines of voxel samples, each ray starting where the one below it hit.
    #[default]
    Coherent,
    /// The same samples, every ray from where it comes below the top of the ground.
    Plain,
    /// The same samples, every ray from the eye: for comparison only.
    FromEye,
    /// As [`Method::Coherent`], never proving anything: wrong beside cliffs, for comparison only.
    ForwardOnly,
    /// One exact ray per pixel through a pyramid of maxima: no voxels, no assumption on lines. What a ground without voxels is
    /// always drawn with.
    Mipmap,
    /// The same, every ray from the beginning: for comparison only.
    PlainMipmap,
}

/// Options of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CastOptions {
    /// How rays are cast.
    pub method: Method,
    /// Whether tiles with voxels are drawn as if they had none, and no ray looks between its samples: the paper's approximate mode.
    pub is_approximate: bool,
    /// Whether rays look between samples for hills that are narrower than a sampling interval. The paper's do not.
    pub looks_between: bool,
    /// How densely rays are sampled.
    pub sampling: Sampling,
    /// Colour where no ground is.
    pub sky_rgb: [u8; 3],
    /// Whether the ground is seen from below by an eye over it, too: through holes.
    pub has_undersides: bool,
}

impl Default for CastOptions {
    fn default() -> Self {
        Self {
            method: Method::Coherent,
            is_approximate: false,
            looks_between: true,
            sampling: Sampling { interval_voxels: 0.6, voxel_px: 1.0 },
            sky_rgb: [150, 190, 235],
            has_undersides: false,
        }
    }
}

/// Draws pictures; keeps its memory from one to the next.
#[derive(Debug)]
pub struct Caster {
    workers: Workers,
    placed: Vec<Placed>,
    projected: Projected,
    planes: Planes,
    lines: Lines,
    steepness: Steepness,
    /// Of each worker.
    strips: Vec<Mutex<Strips>>,
}

impl Caster {
    /// With this many threads, the calling one among them.
    ///
    /// # Errors
    /// The system gives no threads.
    pub fn new(workers: usize) -> Result<Self, WorkersError> {
        let workers = Workers::new(workers)?;
        Ok(Self {
            strips: (0..workers.count()).map(|_| Mutex::default()).collect(),
            workers,
            placed: Vec::new(),
            projected: Projected::default(),
            planes: Planes::default(),
            lines: Lines::default(),
            steepness: Steepness::default(),
        })
    }

    /// Draws the ground as a camera sees it, which is valid and has the picture's size. The picture does not depend on the number of
    /// workers. Heights are as they are in the ground: whoever fills it exaggerates
    /// them. `colors`: RGBA8 of each layer, mip levels back to back, row 0 of each in the north; a layer that is not there, or is too
    /// short, is drawn black.
    ///
    /// # Panics
    /// When camera and picture differ in size, or a side is longer than 65,535 pixels.
    pub fn draw(
        &mut self,
        ground: &Ground,
        colors: &[&[u8]],
        camera: &Camera,
        options: &CastOptions,
        picture: &Picture,
    ) -> Counts {
        assert_eq!(picture.size(), [camera.width, camera.height], "a picture has its camera's size");
        assert!(picture.size().iter().all(|side| *side <= Line::LONGEST), "no side is longer than {}", Line::LONGEST);
        let view = View::new(camera);
        let bounds = place(ground, &view, &mut self.placed);
        self.lines.set(picture.size(), camera.roll_rad);
        let from_datum = (view.eye_in_world().z - ground.datum_m()) as f32;
        // No ground is further off than the furthest corner of its bounds, at its lowest or highest.
        let [lowest, highest] = ground.range_m().map(|height| (height - from_datum).abs());
        let far = bounds.min.abs().max(bounds.max.abs()).length().hypot(lowest.max(highest));
        let has_ground = ground.tile_count() > 0 && far.is_finite();
        // Without voxels there are heights alone.
        let method = match options.method {
            Method::PlainMipmap => Method::PlainMipmap,
            method if ground.has_voxels() => method,
            _ => Method::Mipmap,
        };
        let placed = self.placed.iter().zip(ground.tiles());
        let voxels = placed.map(|(placed, tile)| voxels_of(&view, placed, tile, ground.range_m(), from_datum));
        self.planes.set(&view, &options.sampling, voxels, if has_ground { far } else { 0.0 });
        if method == Method::Mipmap {
            self.projected.set(ground, &view, &self.placed, &self.workers);
        }
        let [r, g, b] = options.sky_rgb;
        let frame = Frame {
            ground,
            placed: &self.placed,
            projected: &self.projected,
            bounds,
            view,
            planes: &self.planes,
            colors,
            picture,
            sky: u32::from_le_bytes([r, g, b, 255]),
            datum: -from_datum,
            fall: if options.looks_between && !options.is_approximate {
                FALL_TRUSTED * ground.shape().filter.unwrap_or_default().fall()
            } else {
                f32::NEG_INFINITY
            },
            highest: if has_ground { ground.top_m() - from_datum } else { f32::NEG_INFINITY },
            has_undersides: options.has_undersides || is_beside_world(ground, &view),
        };
        let coherence = match method {
            Method::Coherent | Method::Mipmap => Coherence::Proven,
            Method::Plain | Method::PlainMipmap => Coherence::Plain,
            Method::FromEye => Coherence::FromEye,
            Method::ForwardOnly => Coherence::ForwardOnly,
        };
        if coherence == Coherence::Proven {
            let unit = ground.shape().lattice_unit_m;
            let eye = [view.eye_in_world().x / unit, view.eye_in_world().y / unit];
            self.steepness.set(ground, eye, from_datum, method != Method::Mipmap);
        }
        let line_options = LineOptions { coherence, steepness: &self.steepness };
        let (lines, strips) = (&self.lines, &self.strips);
        let next = AtomicUsize::new(0);
        let counts = self.workers.run(|worker| {
            let mut counts = Counts::default();
            // A worker's own. What a panic has left in it is not looked at.
            let mut strips = strips[worker].lock().unwrap_or_else(PoisonError::into_inner);
            let is_exact = matches!(method, Method::Mipmap | Method::PlainMipmap);
            if is_exact {
                strips.reserve(lines.size());
            }
            loop {
                // Whoever is free takes the next lines; which ones it gets shows nowhere.
                let after = |first: usize| first + lines_at_a_time(lines.count() - first);
                let take = |first: usize| (first < lines.count()).then(|| after(first));
                let Ok(first) = next.fetch_update(Ordering::Relaxed, Ordering::Relaxed, take) else { return counts };
                let block = first..after(first);
                if is_exact {
                    strips.begin();
                    let count = block.len();
                    for (at, line) in block.enumerate() {
                        counts = counts + frame.find_exact(&line_options, &mut strips.strip(at, lines, line));
                    }
                    frame.measure(&mut strips);
                    frame.paint(&strips.lines[..count], &strips.footprints);
                    continue;
                }
                for line in block {
                    let pixels = lines.pixels(line);
                    counts = counts
                        + match options.is_approximate {
                            true => frame.cast_line::<true>(&line_options, pixels),
                            false => frame.cast_line::<false>(&line_options, pixels),
                        };
                }
            }
        });
        if ground.is_partly_unmeasured() {
            frame.look_at_shares(&self.workers);
        }
        counts
    }

    /// The tiles of the ground that was drawn last.
    pub(crate) fn placed(&self) -> &[Placed] {
        &self.placed
    }

    /// Its threads.
    #[must_use]
    pub fn workers(&self) -> &Workers {
        &self.workers
    }
}

/// Where along rays the voxels of a tile are. `range_m`: of heights above a datum, which the eye is `eye_m` above.
fn voxels_of(view: &View, placed: &Placed, tile: &Tile, range_m: [f32; 2], eye_m: f32) -> Voxels {
    let guide = view.guide();
    let corner = placed.corner.truncate();
    let size = Vec2::new(tile.cells[0] as f32, tile.cells[1] as f32) * tile.spacing_m;
    let ends = |axis: usize| [guide[axis] * corner[axis], guide[axis] * (corner[axis] + size[axis])];
    let heights = range_m.map(|height| guide.z * (height - eye_m));
    let nearest_first = |[a, b]: [f32; 2]| [a.min(b), a.max(b)];
    let [x, y, z] = [ends(0), ends(1), heights].map(nearest_first);
    Voxels { range: [x[0] + y[0] + z[0], x[1] + y[1] + z[1]], side_m: tile.spacing_m }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_worker_of_sixteen_waits_long_for_the_last() {
        for lines in [1, 3, 500, 1280, 3840] {
            // Each line takes as long as any other; whoever is free first takes the next block.
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
