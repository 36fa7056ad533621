//! The lines of pixels in which a picture is cast: its columns, or, when the camera rolls, parallel
//! scan-converted lines that stay perpendicular to the horizon (voxel-flythrough-1999 §5).
//!
//! ```text
//!    roll 0          rolled: every line is the same one, moved sideways
//!    0 1 2 3         . 0 1 2        one array for all of them: does the line
//!    0 1 2 3         0 1 2 3        shift by a pixel after this step?
//!    0 1 2 3         0 1 2 3
//!    0 1 2 3         1 2 3 4        bottom: where lines begin
//! ```
//!
//! A pixel belongs to the line `minor - offset(major)`: exactly one, so that lines are a partition
//! of the picture.

use std::f64::consts::FRAC_1_SQRT_2;

/// The lines of pictures of one size at one roll.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Lines {
    size: [u32; 2],
    /// Lines step along rows and shift along columns.
    is_x_major: bool,
    /// Steps along the major axis go to smaller coordinates.
    is_major_down: bool,
    /// Shifts along the minor axis go to smaller coordinates.
    is_minor_down: bool,
    /// Whether the line shifts between step k and step k + 1: the bit array.
    shifts: Vec<bool>,
    /// The steps after which it shifts.
    shift_steps: Vec<u32>,
}

impl Lines {
    /// The lines of pictures of `size` with the camera rolled by `roll_rad`, clockwise.
    #[must_use]
    pub fn new(size: [u32; 2], roll_rad: f64) -> Self {
        let mut lines = Self::default();
        lines.set(size, roll_rad);
        lines
    }

    /// The same in place: allocates nothing when the size is unchanged.
    pub fn set(&mut self, size: [u32; 2], roll_rad: f64) {
        let (sin, cos) = roll_rad.sin_cos();
        // The direction of the world's up axis in the picture, y downwards.
        let up = [-sin, -cos];
        self.size = size;
        self.is_x_major = cos.abs() < FRAC_1_SQRT_2;
        let [major, minor] = if self.is_x_major { [0, 1] } else { [1, 0] };
        self.is_major_down = up[major] < 0.0;
        self.is_minor_down = up[minor] < 0.0;
        // Bresenham's line in fixed point: the offset after k steps is k·slope, rounded.
        let slope = ((up[minor] / up[major]).abs().min(1.0) * f64::from(1u32 << 31) * 2.0) as u64;
        let offset = |k: u64| (k * slope + (1 << 31)) >> 32;
        let steps = u64::from(size[major]);
        self.shifts.clear();
        self.shift_steps.clear();
        // The largest number of shifts for any roll, so that turning does not allocate either.
        let longest = size[0].max(size[1]) as usize;
        self.shifts.reserve(longest);
        self.shift_steps.reserve(longest);
        for k in 0..steps.saturating_sub(1) {
            let is_shift = offset(k + 1) > offset(k);
            self.shifts.push(is_shift);
            if is_shift {
                self.shift_steps.push(k as u32);
            }
        }
    }

    /// Width and height of the picture.
    #[must_use]
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    fn minor_size(&self) -> usize {
        self.size[usize::from(self.is_x_major)] as usize
    }

    /// How many lines cover the picture: one per pixel of its lower edge, and one per shift.
    #[must_use]
    pub fn count(&self) -> usize {
        self.minor_size() + self.shift_steps.len()
    }

    /// The pixels of line `n < count()`, bottom up: columns and rows from the picture's upper left
    /// corner.
    pub fn pixels(&self, n: usize) -> impl Iterator<Item = [u32; 2]> + '_ {
        let left = self.shift_steps.len();
        // Lines of the left part begin at the edge, one step after a shift.
        let (start, first) = match left.checked_sub(n + 1) {
            Some(shift) => (self.shift_steps[shift] as usize + 1, 0),
            None => (0, n - left),
        };
        let end = self.minor_size();
        let mut minor = first;
        let steps = self.shifts.len() + 1;
        (start..steps).map_while(move |k| {
            if k > start && self.shifts[k - 1] {
                minor += 1;
            }
            (minor < end).then(|| self.pixel(k as u32, minor as u32))
        })
    }

    /// The same into a list, whose contents are replaced.
    pub(crate) fn fill(&self, n: usize, pixels: &mut Vec<[u16; 2]>) {
        pixels.clear();
        let narrow = |pixel: [u32; 2]| pixel.map(|at| at as u16);
        if self.shift_steps.is_empty() {
            pixels.extend((0..self.shifts.len() as u32 + 1).map(|k| narrow(self.pixel(k, n as u32))));
        } else {
            pixels.extend(self.pixels(n).map(narrow));
        }
    }

    #[inline(always)]
    fn pixel(&self, step: u32, shifted: u32) -> [u32; 2] {
        let turn = |at: u32, axis: usize, is_down: bool| if is_down { self.size[axis] - 1 - at } else { at };
        if self.is_x_major {
            [turn(step, 0, self.is_major_down), turn(shifted, 1, self.is_minor_down)]
        } else {
            [turn(shifted, 0, self.is_minor_down), turn(step, 1, self.is_major_down)]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn without_roll_lines_are_columns_bottom_up() {
        let lines = Lines::new([3, 4], 0.0);
        assert_eq!(lines.count(), 3);
        let last: Vec<_> = lines.pixels(2).collect();
        assert_eq!(last, [[2, 3], [2, 2], [2, 1], [2, 0]]);
        assert!(Lines::new([3, 4], std::f64::consts::PI).pixels(0).map(|p| p[1]).eq(0..4));
    }

    #[test]
    fn at_45_degrees_there_are_as_many_lines_as_the_two_edges_have_pixels() {
        let lines = Lines::new([50, 40], 45f64.to_radians());
        assert_eq!(lines.count(), 50 + 39);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]

        #[test]
        fn every_pixel_is_on_one_line_for_any_roll(
            width in 1u32..70, height in 1u32..70, roll_deg in -180.0f64..=180.0, quarter in prop::option::of(-4i32..=4),
        ) {
            let roll_deg = quarter.map_or(roll_deg, |quarter| f64::from(45 * quarter));
            let lines = Lines::new([width, height], roll_deg.to_radians());
            let mut times = vec![0u32; (width * height) as usize];
            for n in 0..lines.count() {
                let mut last: Option<[u32; 2]> = None;
                let mut listed = vec![[7; 2]];
                lines.fill(n, &mut listed);
                prop_assert!(listed.iter().map(|pixel| pixel.map(u32::from)).eq(lines.pixels(n)));
                for [x, y] in lines.pixels(n) {
                    prop_assert!(x < width && y < height);
                    times[(y * width + x) as usize] += 1;
                    if let Some([lx, ly]) = last {
                        prop_assert!(x.abs_diff(lx).max(y.abs_diff(ly)) == 1, "a line has no gap");
                    }
                    last = Some([x, y]);
                }
            }
            prop_assert!(times.iter().all(|&n| n == 1), "{times:?}");
        }

        #[test]
        fn lines_go_up_and_stay_within_a_pixel_of_the_vertical(roll_deg in -180.0f64..=180.0) {
            let (sin, cos) = roll_deg.to_radians().sin_cos();
            let lines = Lines::new([64, 48], roll_deg.to_radians());
            for n in 0..lines.count() {
                let pixels: Vec<_> = lines.pixels(n).collect();
                let [x0, y0] = pixels[0].map(f64::from);
                for [x, y] in &pixels[1..] {
                    let (dx, dy) = (f64::from(*x) - x0, y0 - f64::from(*y));
                    let (along, across) = (dy * cos - dx * sin, dx * cos + dy * sin);
                    prop_assert!(along > 0.0 && across.abs() <= 1.0 + 1e-6, "{along} {across}");
                }
            }
        }
    }
}
