//! The planes on which rays through voxels are sampled: the same parameters for all rays of a
//! frame.

use crate::view::View;

/// The parameters at which rays are sampled: one sampling interval apart, measured in voxels of the
/// finest level at this distance.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Planes {
    s: Vec<f32>,
    /// By step ([`step_of`]) from `first_step` on, the first plane of this step or a later one.
    first: Vec<u32>,
    first_step: u32,
    /// For each stretch of s, from `first_stretch` on, the side of the finest voxels in it.
    sides: Vec<f32>,
    first_stretch: u32,
}

/// How densely rays through voxels are sampled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sampling {
    /// Voxels from sample to sample on the view axis.
    pub interval_voxels: f32,
    /// Voxels that are smaller on screen than this, pixels, are sampled as if they had this size.
    /// 0: every voxel is sampled by its own size.
    pub voxel_px: f32,
}

/// Voxels of one size, and the interval of the ray parameter in which they lie.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct VoxelStretch {
    /// The parameters of their nearest and of their furthest point.
    pub(crate) range: [f32; 2],
    /// Their side, metres.
    pub(crate) side_m: f32,
}

/// log2 of the stretches of s per octave; for each stretch the finest voxels are stored. Levels are
/// an octave apart, so that an eighth of an octave is a tenth of a leaf's distance.
const LOG_STRETCHES: u32 = 3;
/// Stretches in all: 24 octaves from the nearest plane on, from a decimetre to 1,600 km.
const STRETCHES: usize = 24 << LOG_STRETCHES;
/// log2 of the steps per octave of the index of planes. With 0.6 voxels from plane to plane and
/// voxels as large as a pixel, a step holds few planes ([`Planes::at_or_after`] searches those of
/// one step).
const LOG_STEPS: u32 = 7;

/// The octave of a number and its place within the octave, in `1 << log` steps. Monotonic for
/// positive numbers.
#[inline(always)]
fn step_of(s: f32, log: u32) -> u32 {
    s.to_bits() >> (23 - log)
}

impl Planes {
    /// Upper bound of the number of planes: about as many as a ray needs through a thousand tiles
    /// of 16 cells, at 0.6 voxels.
    pub(crate) const MOST: usize = 1 << 15;

    /// Sets them for a view of voxels, out to parameter `far`.
    pub(crate) fn set(
        &mut self,
        view: &View,
        sampling: &Sampling,
        voxels: impl Iterator<Item = VoxelStretch> + Clone,
        far: f32,
    ) {
        self.s.clear();
        let finest_m = voxels.clone().map(|voxels| voxels.side_m).fold(f32::INFINITY, f32::min);
        let per_m = f64::from(sampling.interval_voxels * view.s_per_depth());
        let growth = f64::from(sampling.interval_voxels * sampling.voxel_px / view.focal_px());
        if finest_m.is_finite() && per_m * f64::from(finest_m) > 0.0 {
            self.fill_sides((per_m * f64::from(finest_m)) as f32, voxels, finest_m);
            let mut scale = 1.0;
            // No ground would be found behind the last plane: better fewer planes everywhere.
            while !self.fill(scale * per_m, scale * growth, far) {
                scale *= 2.0;
            }
        }
        self.index();
    }

    /// `nearest`: the parameter of the second plane.
    fn fill_sides(&mut self, nearest: f32, voxels: impl Iterator<Item = VoxelStretch>, finest_m: f32) {
        self.first_stretch = step_of(nearest, LOG_STRETCHES);
        self.sides.clear();
        self.sides.resize(STRETCHES, f32::INFINITY);
        for VoxelStretch { range: [from, to], side_m } in voxels {
            let (first, last) = (self.stretch(from), self.stretch(to));
            self.sides[first..=last.max(first)].iter_mut().for_each(|side| *side = side.min(side_m));
        }
        // Where there are no voxels any interval is fine: use the one before.
        let mut before = finest_m;
        for side in &mut self.sides {
            *side = if side.is_finite() { *side } else { before };
            before = *side;
        }
    }

    /// Points behind the eye are in the first stretch, and so is NaN.
    fn stretch(&self, s: f32) -> usize {
        (step_of(s.max(0.0), LOG_STRETCHES).saturating_sub(self.first_stretch) as usize).min(STRETCHES - 1)
    }

    /// Sets planes `per_m` of a voxel's side apart, but at least `growth` of the parameter. Returns
    /// whether all of them fit.
    fn fill(&mut self, per_m: f64, growth: f64, far: f32) -> bool {
        self.s.clear();
        let mut s = 0.0f64;
        while s < f64::from(far) {
            if self.s.len() == Self::MOST {
                return false;
            }
            self.s.push(s as f32);
            let at = self.stretch(s as f32);
            let interval = |at: usize| (per_m * f64::from(self.sides[at])).max(growth * s);
            let mut step = interval(at);
            if at + 1 < STRETCHES && interval(at + 1) < step {
                // Do not step over the place where finer voxels begin.
                let end = f32::from_bits((self.first_stretch + at as u32 + 1) << (23 - LOG_STRETCHES));
                step = step.min((f64::from(end) - s).max(interval(at + 1)));
            }
            s += step;
        }
        true
    }

    /// For each step, the first plane that is not before it.
    fn index(&mut self) {
        self.first.clear();
        self.first_step = self.s.get(1).map_or(0, |s| step_of(*s, LOG_STEPS));
        for (plane, s) in self.s.iter().enumerate() {
            let at = step_of(*s, LOG_STEPS).saturating_sub(self.first_step) as usize;
            while self.first.len() <= at {
                self.first.push(plane as u32);
            }
        }
        self.first.push(self.s.len() as u32);
    }

    /// The parameters, rising from 0.
    pub(crate) fn s(&self) -> &[f32] {
        &self.s
    }

    /// The first plane at or after a parameter.
    #[inline(always)]
    pub(crate) fn at_or_after(&self, s: f32) -> u32 {
        if s <= 0.0 {
            return 0;
        }
        // Planes of earlier steps are before it, those of later ones after it: steps never fall
        // while numbers rise.
        let at = step_of(s, LOG_STEPS).saturating_sub(self.first_step) as usize;
        let Some(&[from, to]) = self.first.get(at..at + 2) else { return self.s.len() as u32 };
        from + self.s[from as usize..to as usize].partition_point(|&plane| plane < s) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use terravision_common::camera::{Camera, CameraFields};

    #[test]
    fn planes_are_an_interval_apart_in_the_finest_voxels_at_their_distance() {
        let camera = Camera::new(CameraFields {
            eye_in_world: [0.0; 3],
            heading_rad: 0.0,
            pitch_rad: -0.2,
            roll_rad: 0.0,
            vfov_rad: 0.8,
            width: 640,
            height: 480,
            timestamp_nanos: 0,
        })
        .expect("valid");
        let view = View::new(&camera);
        let mut planes = Planes::default();
        let per_depth = view.s_per_depth();
        // Coarser voxels further off, and a patch of fine ones among them.
        let patch = [22_000.0, 24_000.0];
        let voxels = [([-500.0, 3000.0], 10.0), ([2000.0, 60_000.0], 40.0), (patch, 10.0)];
        let voxels = voxels.map(|(range, side_m)| VoxelStretch { range, side_m });
        let sampling = Sampling { interval_voxels: 0.6, voxel_px: 1.0 };
        planes.set(&view, &sampling, voxels.into_iter(), 100_000.0);
        let s = planes.s();
        assert!(s[0] == 0.0 && (s[1] / per_depth - 6.0).abs() < 1e-3);
        for pair in s.windows(2) {
            let (from, to) = (pair[0], pair[1]);
            let finest = voxels.iter().filter(|v| v.range[0] <= from && to <= v.range[1]).map(|v| v.side_m);
            let wanted = finest.fold(f32::INFINITY, f32::min).max(from / per_depth / view.focal_px());
            assert!((to - from) / per_depth <= 0.601 * wanted, "{from} {to}");
        }
        let wide = s.windows(2).filter(|pair| pair[1] - pair[0] > 20.0 * per_depth).count();
        assert!(wide > 500 && s.len() < 3500, "{wide} of {}", s.len());
        let at = planes.at_or_after(90_000.0) as usize;
        let grown = 90_000.0 / view.focal_px();
        assert!(((s[at + 1] - s[at]) / (0.6 * grown) - 1.0).abs() < 0.01);
        for at in (0..40_000).map(|n| n as f32 * 3.1) {
            assert_eq!(planes.at_or_after(at), s.partition_point(|&plane| plane < at) as u32, "{at}");
        }
        for (k, at) in s.iter().enumerate() {
            assert_eq!(planes.at_or_after(*at), k as u32);
        }
        // More planes than fit: fewer everywhere, but up to the end.
        let finest = VoxelStretch { range: [0.0, 1e6], side_m: 1.0 };
        planes.set(&view, &Sampling { voxel_px: 0.0, ..sampling }, std::iter::once(finest), 1e5);
        assert!(planes.s().len() <= Planes::MOST && *planes.s().last().unwrap() > 99_990.0);
        planes.set(&view, &sampling, std::iter::empty(), 1e5);
        assert_eq!((planes.s().len(), planes.at_or_after(3.0)), (0, 0));
    }
}
