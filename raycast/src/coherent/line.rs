//! Rays of a line, from the bottom up (voxel-flythrough-1999 §4): each starts where its witness hit
//! ([`crate::proof`]). If a start lies in the ground nevertheless, the ray steps back.

use super::voxels::Current;
use super::walk::{End, VoxelRays};
use crate::counts::Counts;
use crate::proof::{Recent, StartRule, Unproven};
use crate::shade::Canvas;
use crate::view::Ray;

/// The lines of a frame.
#[derive(Debug)]
pub(crate) struct VoxelLines<'a, R> {
    pub(crate) rays: VoxelRays<'a>,
    pub(crate) canvas: &'a Canvas<'a>,
    pub(crate) rule: &'a R,
}

/// A ray that has been cast: in the air at all planes from `entry` up to `reach`.
#[derive(Debug, Clone, Copy)]
struct Known {
    ray: Ray,
    entry: u32,
    reach: u32,
}

/// A ray that is being cast.
#[derive(Debug, Clone, Copy)]
struct Casting<'r> {
    ray: &'r Ray,
    /// The plane at which it enters the ground's bounds.
    entry: u32,
    /// The plane after which it is above all ground, or outside its bounds.
    end: u32,
}

impl<R: StartRule> VoxelLines<'_, R> {
    /// Casts the rays of a line's pixels, bottom up.
    pub(crate) fn cast_line<const APPROXIMATE: bool>(&self, pixels: impl Iterator<Item = [u32; 2]>) -> Counts {
        let mut counts = Counts::default();
        let Some(mut current) = self.rays.enter(0) else {
            for pixel in pixels {
                counts.rays += 1;
                self.canvas.put_sky(pixel);
            }
            return counts;
        };
        let (scene, planes) = (self.rays.scene, self.rays.planes);
        let mut recent: Recent<Known> = Recent::new();
        let is_beside = scene.is_eye_beside_tiles();
        for pixel in pixels {
            counts.rays += 1;
            let ray = scene.view.ray(pixel);
            if scene.has_undersides
                && let Some(seen) = scene.seen_from_below(&ray, &mut counts)
            {
                counts.hits += u64::from(seen.is_some());
                match seen {
                    Some((tile, s)) => self.canvas.put_ground(pixel, tile, &ray, s),
                    None => self.canvas.put_sky(pixel),
                }
                recent.push(None);
                continue;
            }
            let entry = if is_beside { planes.at_or_after(scene.entry(&ray)) } else { 0 };
            let casting = Casting { ray: &ray, entry, end: self.rays.end_of(&ray) };
            let below = recent.nearest_first(usize::MAX);
            let witness = self.rule.find_witness(&ray, below, |below| {
                (&below.ray, planes.s().get(below.reach as usize).copied().unwrap_or(f32::INFINITY))
            });
            let end = match witness {
                Some((witness, unproven)) => {
                    self.cast_behind::<APPROXIMATE>(&casting, &witness, unproven, &mut current, &mut counts)
                }
                None => self.cast_alone::<APPROXIMATE>(&casting, &mut current, &mut counts),
            };
            let reach = self.put::<APPROXIMATE>(pixel, &casting, end, &current, &mut counts);
            recent.push(Some(Known { ray, entry, reach }));
        }
        counts
    }

    /// Casts a ray that starts where its witness hit, after checking the intervals that the witness
    /// does not prove.
    #[inline(always)]
    fn cast_behind<'f, const APPROXIMATE: bool>(
        &'f self,
        casting: &Casting<'_>,
        witness: &Known,
        unproven: Unproven,
        current: &mut Current<'f>,
        counts: &mut Counts,
    ) -> End {
        let Casting { ray, entry, end } = *casting;
        let planes = self.rays.planes;
        // Before the witness entered the ground's bounds, it proves nothing.
        let before = witness.entry.min(witness.reach).min(end);
        let gap = if entry < before { (before + 1).min(end) } else { before };
        let start = witness.reach.max(entry);
        let mut found = End::Left(gap);
        if entry < gap {
            found = self.rays.walk::<APPROXIMATE, false>(ray, entry, gap, current, counts);
        }
        let mut is_looked_at = false;
        for [from, to] in unproven {
            // It hit, or passed a corner of the ground.
            if !matches!(found, End::Left(plane) if plane >= gap) {
                break;
            }
            // A plane more on both sides: rounding.
            let from = planes.at_or_after(from).saturating_sub(1).max(entry).max(gap);
            let to = (planes.at_or_after(to) + 1).min(start + 1).min(end);
            if from < to {
                is_looked_at = true;
                let found_here = self.rays.walk::<APPROXIMATE, true>(ray, from, to, current, counts);
                if matches!(found_here, End::Hit(_)) {
                    found = found_here;
                }
            }
        }
        counts.partly_proven += u64::from(is_looked_at);
        match found {
            End::Left(plane) if plane >= gap => self.rays.walk::<APPROXIMATE, false>(ray, start, end, current, counts),
            _ => found,
        }
    }

    /// Casts a ray without a witness.
    #[inline(always)]
    fn cast_alone<'f, const APPROXIMATE: bool>(
        &'f self,
        casting: &Casting<'_>,
        current: &mut Current<'f>,
        counts: &mut Counts,
    ) -> End {
        let Casting { ray, entry, end } = *casting;
        counts.without_witness += 1;
        let start = if R::STARTS_BELOW_TOP { entry.max(self.rays.start_below_top(ray)) } else { entry };
        if R::RELIES {
            self.rays.walk::<APPROXIMATE, true>(ray, start, end, current, counts)
        } else {
            self.rays.walk::<APPROXIMATE, false>(ray, start, end, current, counts)
        }
    }

    /// Writes what a ray has hit into the picture. Returns the plane up to which the ray is in the
    /// air.
    #[inline(always)]
    fn put<const APPROXIMATE: bool>(
        &self,
        pixel: [u32; 2],
        casting: &Casting<'_>,
        found: End,
        current: &Current<'_>,
        counts: &mut Counts,
    ) -> u32 {
        let (rays, ray) = (&self.rays, casting.ray);
        let found = match found {
            End::Left(plane) => rays.at_border::<APPROXIMATE>(ray, plane, current, counts).map_or(found, End::Hit),
            End::Hit(_) => found,
        };
        let plane = match found {
            End::Hit(sample) => {
                let (reach, s) = rays.refined::<APPROXIMATE>(ray, sample, current, counts);
                counts.hits += 1;
                self.canvas.put_ground(pixel, rays.tile_at(ray, s, current), ray, s);
                return reach;
            }
            End::Left(plane) => plane,
        };
        self.canvas.put_sky(pixel);
        // A ray that rose above all ground stays in the air. Beyond the ground's border it proves
        // nothing.
        if plane >= casting.end && !rays.scene.ground.is_cut() {
            rays.planes.s().len() as u32
        } else {
            plane.min(rays.planes.at_or_after(rays.scene.departure(ray))).saturating_sub(1)
        }
    }
}

impl VoxelRays<'_> {
    /// The plane after which a ray is above all ground, or outside its bounds.
    #[inline(always)]
    fn end_of(&self, ray: &Ray) -> u32 {
        let rising = self.end_of_rising(ray);
        // Cells may reach beyond the border.
        if self.scene.ground.is_cut() { rising.min(self.planes.at_or_after(self.scene.departure(ray))) } else { rising }
    }

    #[inline(always)]
    fn end_of_rising(&self, ray: &Ray) -> u32 {
        let count = self.planes.s().len() as u32;
        let highest = self.scene.highest;
        if ray.direction.z > 0.0 {
            // One more plane, for the interval before it.
            let after = self.planes.at_or_after(highest.max(0.0) / ray.direction.z) + 1;
            after.min(count)
        } else if ray.direction.z == 0.0 && highest < 0.0 {
            0
        } else {
            count
        }
    }

    /// The last plane at which a falling ray is above all ground.
    fn start_below_top(&self, ray: &Ray) -> u32 {
        let highest = self.scene.highest;
        if ray.direction.z < 0.0 && highest < 0.0 {
            self.planes.at_or_after(highest / ray.direction.z).saturating_sub(1)
        } else {
            0
        }
    }
}
