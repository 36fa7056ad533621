//! The resampling kernel.
//!
//! Catmull-Rom cubic: it passes through the samples, so a source on its own lattice is copied.
//! Where the target is coarser than the source the kernel is widened by the ratio, so that it
//! averages (as GDAL's warper does). Where a sample under the kernel is void, a triangle (bilinear)
//! kernel over the other samples is used instead, and the result is void if more than half of that
//! kernel's weight is.
//!
//! Heights whose spacing hardly changes are sampled by a sharper kernel, [`Kernel::of_heights`]
//! (`sharp`).

use super::sharp;
use crate::source::window::Window;

/// Catmull-Rom (cubic convolution with a = -1/2; Keys 1981).
fn cubic(x: f64) -> f64 {
    let x = x.abs();
    if x < 1.0 {
        (1.5 * x - 2.5) * x * x + 1.0
    } else if x < 2.0 {
        ((-0.5 * x + 2.5) * x - 4.0) * x + 2.0
    } else {
        0.0
    }
}

fn triangle(x: f64) -> f64 {
    (1.0 - x.abs()).max(0.0)
}

/// Samples windows; keeps the weights' buffers.
#[derive(Debug, Clone)]
pub struct Kernel {
    /// Source pixels per target sample along columns and rows.
    spacing: [f64; 2],
    /// The factor by which the kernel is widened, at least 1.
    scale: [f64; 2],
    is_sharp: bool,
    weights: [Vec<(usize, f64)>; 2],
    range: [f32; 2],
}

impl Kernel {
    /// A kernel for this many source pixels per target sample along columns and rows.
    #[must_use]
    pub fn new(spacing: [f64; 2]) -> Self {
        let scale = spacing.map(|s| s.max(1.0));
        Self { spacing, scale, is_sharp: false, weights: [Vec::new(), Vec::new()], range: [f32::MAX, f32::MIN] }
    }

    /// A kernel for heights: a sharp one that keeps summits where the spacing hardly changes.
    #[must_use]
    pub fn of_heights(spacing: [f64; 2]) -> Self {
        let kernel = Self::new(spacing);
        match spacing.iter().all(|s| sharp::SPACINGS.contains(s)) {
            true => Self { is_sharp: true, scale: [1.0; 2], ..kernel },
            false => kernel,
        }
    }

    /// Its radius, pixels.
    #[must_use]
    pub fn reach(&self) -> [usize; 2] {
        let support = if self.is_sharp { sharp::SUPPORT } else { 2.0 };
        self.scale.map(|s| (support * s).ceil() as usize + 1)
    }

    /// Smallest and largest sample (of the first channel) near the positions so far.
    #[must_use]
    pub fn range(&self) -> [f32; 2] {
        self.range
    }

    /// Taps along an axis around position `at` (pixel centres are whole) as indices in the window,
    /// with weights that sum to 1. Beyond the window (which ends only where the source does) its
    /// border is repeated.
    fn taps(&mut self, axis: usize, at: f64, origin: i64, count: usize, support: f64, shape: fn(f64) -> f64) {
        let scale = self.scale[axis];
        let taps = &mut self.weights[axis];
        taps.clear();
        let place = |index: f64| (index as i64 - origin).clamp(0, count as i64 - 1) as usize;
        let whole = at.round();
        if scale == 1.0 && (at - whole).abs() < SNAP_PX {
            taps.push((place(whole), 1.0));
            return;
        }
        let (first, last) = ((at - support * scale).ceil() as i64, (at + support * scale).floor() as i64);
        let mut sum = 0.0;
        for index in first..=last {
            let weight = shape((index as f64 - at) / scale);
            if weight != 0.0 {
                taps.push((place(index as f64), weight));
                sum += weight;
            }
        }
        taps.iter_mut().for_each(|(_, weight)| *weight /= sum);
    }

    fn all_taps<const C: usize>(
        &mut self,
        window: &Window<C>,
        position: [f64; 2],
        support: f64,
        shape: fn(f64) -> f64,
    ) {
        for (axis, at) in position.into_iter().enumerate() {
            self.taps(axis, at, window.origin()[axis], window.size()[axis], support, shape);
        }
    }

    /// The window's value at a position `[column, row]` in source pixels (centres are whole
    /// numbers); `None` where it is void.
    pub fn sample<const C: usize>(&mut self, window: &Window<C>, position: [f64; 2]) -> Option<[f32; C]> {
        if let Some(at) = self.pixel_at(window, position) {
            let pixel = window.known(at)?;
            self.range = [self.range[0].min(pixel[0]), self.range[1].max(pixel[0])];
            return Some(pixel);
        }
        if self.is_sharp {
            return self.sample_sharply(window, position);
        }
        self.all_taps(window, position, 2.0, cubic);
        self.weighted(window).or_else(|| self.sample_around_voids(window, position))
    }

    /// The pixel at a position, if pixels are copied: true for most samples of a source on its own
    /// lattice.
    fn pixel_at<const C: usize>(&self, window: &Window<C>, position: [f64; 2]) -> Option<usize> {
        let mut place = [0; 2];
        for axis in 0..2 {
            // Positions on a pixel are not below zero, where a cast would round up.
            let whole = (position[axis] + 0.5) as i64;
            if self.scale[axis] != 1.0 || (position[axis] - whole as f64).abs() >= SNAP_PX {
                return None;
            }
            place[axis] = (whole - window.origin()[axis]).clamp(0, window.size()[axis] as i64 - 1) as usize;
        }
        Some(place[1] * window.size()[0] + place[0])
    }

    fn sample_sharply<const C: usize>(&mut self, window: &Window<C>, position: [f64; 2]) -> Option<[f32; C]> {
        for (axis, at) in position.into_iter().enumerate() {
            let place = |index: i64| (index - window.origin()[axis]).clamp(0, window.size()[axis] as i64 - 1) as usize;
            let (taps, whole) = (&mut self.weights[axis], at.round());
            taps.clear();
            if (at - whole).abs() < SNAP_PX {
                taps.push((place(whole as i64), 1.0));
                continue;
            }
            let third = at.floor();
            let weights = sharp::weights(at - third);
            taps.extend((third as i64 - 2..).zip(weights).map(|(index, weight)| (place(index), weight)));
        }
        // Near voids, a narrower kernel avoids them.
        let mut value = self.weighted(window);
        if value.is_none() {
            self.all_taps(window, position, 2.0, cubic);
            value = self.weighted(window);
        }
        let value = value.or_else(|| self.sample_around_voids(window, position))?;
        Some(sharp::bounded(window, position, self.spacing, value))
    }

    /// The sum over the taps; `None` when a sample under one is void.
    fn weighted<const C: usize>(&mut self, window: &Window<C>) -> Option<[f32; C]> {
        let mut sum = [0.0f64; C];
        let mut has_void = false;
        let mut range = self.range;
        for &(row, down) in &self.weights[1] {
            for &(column, across) in &self.weights[0] {
                let (pixel, is_void) = window.at(column, row);
                has_void |= is_void;
                let weight = down * across;
                if !is_void && down > 0.0 && across > 0.0 {
                    range = [range[0].min(pixel[0]), range[1].max(pixel[0])];
                }
                sum.iter_mut().zip(pixel).for_each(|(s, v)| *s += weight * f64::from(v));
            }
        }
        if has_void {
            return None;
        }
        self.range = range;
        Some(sum.map(|v| v as f32))
    }

    fn sample_around_voids<const C: usize>(&mut self, window: &Window<C>, position: [f64; 2]) -> Option<[f32; C]> {
        self.all_taps(window, position, 1.0, triangle);
        let (mut sum, mut known) = ([0.0f64; C], 0.0);
        let mut range = self.range;
        for &(row, down) in &self.weights[1] {
            for &(column, across) in &self.weights[0] {
                let (pixel, is_void) = window.at(column, row);
                if !is_void {
                    let weight = down * across;
                    known += weight;
                    range = [range[0].min(pixel[0]), range[1].max(pixel[0])];
                    sum.iter_mut().zip(pixel).for_each(|(s, v)| *s += weight * f64::from(v));
                }
            }
        }
        if known < 0.5 {
            return None;
        }
        self.range = range;
        Some(sum.map(|v| (v / known) as f32))
    }
}

/// A position this close to a pixel's centre counts as on it, because of the rounding of
/// projections.
const SNAP_PX: f64 = 1e-4;

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp() -> Window<1> {
        let mut window = Window::new([10, 20], [8, 8]);
        for (at, pixel) in window.pixels.iter_mut().enumerate() {
            *pixel = [(at % 8) as f32 + 10.0 * (at / 8) as f32];
        }
        window
    }

    #[test]
    fn on_pixels_it_copies_and_between_them_it_keeps_a_plane() {
        let (window, mut kernel) = (ramp(), Kernel::new([1.0, 1.0]));
        assert_eq!(kernel.sample(&window, [13.000_01, 22.0]), Some([23.0]));
        let [between] = kernel.sample(&window, [13.25, 22.5]).unwrap();
        assert!((between - 28.25).abs() < 1e-5);
    }

    #[test]
    fn a_coarse_target_averages() {
        let mut window = Window::<1>::new([0, 0], [64, 64]);
        window.pixels.iter_mut().enumerate().for_each(|(at, p)| *p = [((at + at / 64) % 2) as f32]);
        let [mean] = Kernel::new([4.0, 4.0]).sample(&window, [31.3, 30.9]).unwrap();
        assert!((mean - 0.5).abs() < 0.01, "{mean}");
    }

    #[test]
    fn voids_are_left_out_and_do_not_bleed() {
        let mut window = ramp();
        window.mask(3 * 8 + 3);
        let mut kernel = Kernel::new([1.0, 1.0]);
        assert_eq!(kernel.sample(&window, [13.0, 23.0]), None);
        assert_eq!(kernel.sample(&window, [13.2, 23.2]), None);
        assert_eq!(kernel.sample(&window, [14.0, 23.0]), Some([34.0]));
        let [beside] = kernel.sample(&window, [13.9, 23.0]).unwrap();
        assert!((beside - 34.0).abs() < 1e-5, "{beside}");
    }
}
