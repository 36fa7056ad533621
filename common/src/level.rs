//! The level functions: the level of detail that a point needs.
//!
//! *Screen resolution* `r(p)` is the number of pixels that a metre on the ground covers at terrain
//! point `p`:
//!
//! ```text
//! r = focal / w · g      w = max(depth of p, |p − eye|·cos(half diagonal field of view), 0.1 m)
//!                        g = 1, √s or s by measure;  s = clamp(|eye_z − p_z| / |p − eye|, 0.15, 1)
//! ```
//!
//! `s` is the sine of the angle at which level ground is seen: a step along the line of sight is
//! shortened by it, one across is not. Inside the picture `w` is the depth; outside of it, where
//! depth goes to zero, it follows the distance.
//!
//! Levels are in **tree levels**: a node of level `q` is fine enough at `p` for elevation when `q
//! <= elevation level`, that is `s_z(q) <= √2·r_z / r(p)`, and for colour when `q <= colour level`.
//! (With absolute levels these are `L_z − l_z(0)` and `L_c − l_c(0)`; `s0` cancels out, so that the
//! tree does not depend on it.)

//!
//! A facet is a triangle, half of a lattice cell. The side of the square with its area is what
//! `r_z` measures, so a cell is `√2·r_z` pixels wide and a picture of a million pixels takes 10,000
//! facets at 10 px (terravision-1995 §2.3).

use crate::camera::Camera;
use crate::rig::{MAX_VIEWS, Views};
use crate::surface::{Column, Columns, EyeFrame, NodeBounds, Row, Sight};
use crate::world::World;
use serde::{Deserialize, Serialize};
use std::f64::consts::SQRT_2;

/// How the screen resolution r(x, y), pixels per metre of a horizontal step, is measured from the
/// two steps across and along the line of sight.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Measure {
    /// The smaller one: fewest facets, but blurred where the ground is seen at a glancing angle.
    Min,
    /// Their geometric mean: facets and texels of constant *area* on level ground; slopes that face
    /// the camera get too few of both.
    Area,
    /// The larger one: the best picture for its number of triangles, because slopes that face the
    /// camera get full resolution.
    #[default]
    Max,
}

/// Lower bound of `w`, metres: the eye may be inside a box or on the smooth surface.
const NEAREST_M: f64 = 0.1;
/// Lower bound of `s`: towards the horizon facets would grow without limit.
const LEAST_SLANT: f64 = 0.15;
/// Safety of the lower bound, in levels, over the rounding of the exact evaluation (about 1e-8 at
/// 1000 km).
const BOUND_MARGIN: f64 = 1e-6;

/// The level functions of one frame: at each point the finest level that one of its views wants.
/// The same inputs give the same bits in every process and for every caller: plain IEEE operations
/// in one order, no fused multiply-add, and [`log2_approximate`] for the logarithm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LevelFunction {
    frame: EyeFrame,
    exaggeration: f64,
    measure: Measure,
    views: [ViewLevel; MAX_VIEWS],
    view_count: usize,
    /// Colour level minus elevation level, everywhere.
    color_minus_elevation: f64,
}

/// The level function of one view.
#[derive(Debug, Clone, Copy, PartialEq)]
struct ViewLevel {
    frame: EyeFrame,
    /// cos² of half the diagonal field of view.
    cos2_half_diagonal: f64,
    /// Elevation level where the scale `w/g` is 1 m.
    elevation_offset: f64,
}

impl LevelFunction {
    /// The level functions of a frame with one view. `r_z_px` and `r_c_px`, the wanted screen
    /// resolutions in pixels, must be positive. Heights are multiplied by `exaggeration`.
    #[must_use]
    pub fn new(
        camera: &Camera,
        world: &World,
        exaggeration: f64,
        measure: Measure,
        r_z_px: f64,
        r_c_px: f64,
    ) -> LevelFunction {
        Self::for_views(camera, &Views::single(camera), world, exaggeration, measure, r_z_px, r_c_px)
    }

    /// The level functions of a frame with these views, carried by `pose`.
    #[must_use]
    pub fn for_views(
        pose: &Camera,
        views: &Views,
        world: &World,
        exaggeration: f64,
        measure: Measure,
        r_z_px: f64,
        r_c_px: f64,
    ) -> LevelFunction {
        let cell_px = SQRT_2 * r_z_px;
        let color_over_elevation =
            r_c_px * f64::from(world.color_tile()) / (cell_px * f64::from(world.elevation_tile()));
        let mut levels = [ViewLevel::new(&views[0].camera, world, cell_px); MAX_VIEWS];
        for (level, camera) in levels.iter_mut().zip(views.cameras()).skip(1) {
            *level = ViewLevel::new(camera, world, cell_px);
        }
        LevelFunction {
            frame: world.surface().seen_by(pose.eye(), pose.axes_in_world()[2]),
            exaggeration,
            measure,
            views: levels,
            view_count: views.len(),
            color_minus_elevation: log2_approximate(color_over_elevation),
        }
    }

    /// Factor on all heights.
    #[must_use]
    pub fn exaggeration(&self) -> f64 {
        self.exaggeration
    }

    /// The surface as the eye of the frame's pose sees it.
    #[inline(always)]
    #[must_use]
    pub fn frame(&self) -> &EyeFrame {
        &self.frame
    }

    /// Colour level minus elevation level: the same at all points.
    #[must_use]
    pub fn color_minus_elevation(&self) -> f64 {
        self.color_minus_elevation
    }

    /// The elevation level wanted at a point whose height is already exaggerated.
    #[must_use]
    pub fn elevation_level_at(&self, column: Column, row: Row, height_m: f64) -> f64 {
        let mut out = [0.0];
        self.levels_of_row([&[column.x], &[column.y]], &row, &[height_m], &mut out);
        out[0]
    }

    /// The elevation levels wanted at the points of a row, heights exaggerated already: the form
    /// that compiles to SIMD. All slices have the length of `out`; longer ones are cut.
    pub fn elevation_levels(&self, columns: &Columns, row: Row, heights_m: &[f64], out: &mut [f64]) {
        self.levels_of_row([&columns.x, &columns.y], &row, heights_m, out);
    }

    #[inline(always)]
    fn levels_of_row(&self, columns: [&[f64]; 2], row: &Row, heights_m: &[f64], out: &mut [f64]) {
        let (first, others) = self.views().split_first().expect("a frame has one view at least");
        first.levels(self.measure, columns, (row, heights_m), out, |_, level| level);
        for view in others {
            view.levels(self.measure, columns, (row, heights_m), out, f64::min);
        }
    }

    fn views(&self) -> &[ViewLevel] {
        &self.views[..self.view_count]
    }

    /// Lower bound of the elevation level over a box.
    #[must_use]
    pub fn elevation_bound(&self, bounds: &NodeBounds) -> f64 {
        self.views().iter().map(|view| view.elevation_bound(self.measure, bounds)).fold(f64::INFINITY, f64::min)
    }

    /// Lower bound of the colour level over a box.
    #[must_use]
    pub fn color_bound(&self, bounds: &NodeBounds) -> f64 {
        self.elevation_bound(bounds) + self.color_minus_elevation
    }
}

impl ViewLevel {
    fn new(camera: &Camera, world: &World, cell_px: f64) -> Self {
        let [tx, ty] = camera.picture_plane().reach();
        let elevation_scale = cell_px / (world.surface().unit_m() * camera.focal_px());
        Self {
            frame: world.surface().seen_by(camera.eye(), camera.axes_in_world()[2]),
            cos2_half_diagonal: 1.0 / (1.0 + tx * tx + ty * ty),
            elevation_offset: log2_approximate(elevation_scale),
        }
    }

    /// Combines the levels at a row of points with those in `out`: the finer ones remain.
    #[inline(always)]
    fn levels(
        &self,
        measure: Measure,
        columns: [&[f64]; 2],
        row: (&Row, &[f64]),
        out: &mut [f64],
        with: impl Fn(f64, f64) -> f64 + Copy,
    ) {
        match measure {
            Measure::Max => self.row(columns, row, out, 0.5, |w2, _| w2, with),
            Measure::Min => self.row(columns, row, out, 0.5, |w2, slant| w2 * slant, with),
            Measure::Area => self.row(columns, row, out, 0.25, |w2, slant| w2 * w2 * slant, with),
        }
    }

    #[inline(always)]
    fn row(
        &self,
        [xs, ys]: [&[f64]; 2],
        (row, heights_m): (&Row, &[f64]),
        out: &mut [f64],
        slope: f64,
        argument: impl Fn(f64, f64) -> f64 + Copy,
        with: impl Fn(f64, f64) -> f64 + Copy,
    ) {
        let level_of =
            |sight: &Sight| slope * log2_approximate(self.argument_of(sight, argument)) + self.elevation_offset;
        match &self.frame {
            EyeFrame::Plane(frame) => {
                let row = frame.row(row.x);
                for ((column, height_m), out) in xs.iter().zip(heights_m).zip(out) {
                    *out = with(*out, level_of(&frame.sight(row, *column, *height_m)));
                }
            }
            EyeFrame::Globe(frame) => {
                for (((x, y), height_m), out) in xs.iter().zip(ys).zip(heights_m).zip(out) {
                    let column = Column { x: *x, y: *y };
                    *out = with(*out, level_of(&frame.sight(row, &column, *height_m)));
                }
            }
        }
    }

    /// `w` to the fourth power over `s²` or the like, by measure; grows with depth and the
    /// distances, falls with the difference in height.
    #[inline(always)]
    fn argument_of(&self, sight: &Sight, argument: impl Fn(f64, f64) -> f64) -> f64 {
        let depth = sight.depth.max(NEAREST_M);
        let w2 = (depth * depth).max(sight.distance2 * self.cos2_half_diagonal);
        // 1/s²: |p − eye|² / dz² between its limits. The tiny divisor keeps 0/0 out: level ground
        // is seen edge-on.
        let slant = (1.0 + sight.horizontal2 / sight.vertical2.max(1e-200)).min(1.0 / (LEAST_SLANT * LEAST_SLANT));
        argument(w2, slant)
    }

    fn elevation_bound(&self, measure: Measure, bounds: &NodeBounds) -> f64 {
        let sight = self.frame.bound(bounds);
        let of = |argument: fn(f64, f64) -> f64| self.argument_of(&sight, argument);
        let level = match measure {
            Measure::Max => 0.5 * log2_approximate(of(|w2, _| w2)),
            Measure::Min => 0.5 * log2_approximate(of(|w2, slant| w2 * slant)),
            Measure::Area => 0.25 * log2_approximate(of(|w2, slant| w2 * w2 * slant)),
        };
        level + self.elevation_offset - BOUND_MARGIN + self.frame.narrower_by_levels(bounds)
    }
}

/// log2 of a positive normal number to within 7.2e-6: continuous, monotone, exact at powers of two,
/// and the same bits on every machine. The mantissa's part is `f + f(1−f)·p(f)` with `p` of degree
/// 4 through the five Chebyshev nodes of [0, 1], coefficients rounded to 8 decimals; the error was
/// taken on 100 001 points.
#[inline(always)]
#[must_use]
pub fn log2_approximate(x: f64) -> f64 {
    let bits = x.to_bits();
    // The exponent as a float with no integer conversion (SSE2 has none for 64 bits): put it below
    // the mantissa of 2^52 and subtract 2^52 and the bias.
    let exponent = f64::from_bits(0x4330_0000_0000_0000 | (bits >> 52)) - (4_503_599_627_370_496.0 + 1023.0);
    let f = f64::from_bits(0x3ff0_0000_0000_0000 | (bits & 0x000f_ffff_ffff_ffff)) - 1.0;
    let p = (((0.025_691_26 * f - 0.097_201_83) * f + 0.184_100_83) * f - 0.276_569_5) * f + 0.442_654_07;
    exponent + (f + f * (1.0 - f) * p)
}

/// Levels that a colour leaf may lie below its elevation leaf. Its block is then two cells wide at
/// least: where the edge of a restricted tree's leaf collapses every other vertex, no facet reaches
/// into the next block.
#[must_use]
pub fn deepest_color_below(world: &World) -> u8 {
    (world.elevation_tile().ilog2() as u8 - 1).saturating_sub(world.surface().lag())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::CameraFields;
    use crate::surface::WorldBox;
    use crate::world::WorldFields;
    use glam::DVec3;
    use proptest::prelude::*;

    fn world() -> World {
        World::new(WorldFields {
            origin: [0.0; 2],
            lattice_unit_m: 10.0,
            extent: [4096, 4096],
            elevation_tile: 32,
            color_tile: 256,
            levels: 8,
            finest_elevation_level: 0,
            finest_color_level: 2,
            body: None,
        })
        .expect("valid")
    }

    fn camera(eye: [f64; 3], angles: [f64; 3], vfov_rad: f64) -> Camera {
        Camera::new(CameraFields {
            eye_in_world: eye,
            heading_rad: angles[0],
            pitch_rad: angles[1],
            roll_rad: angles[2],
            vfov_rad,
            width: 1280,
            height: 720,
            timestamp_nanos: 0,
        })
        .expect("valid")
    }

    fn level_at(level: &LevelFunction, x: f64, y: f64, height_m: f64) -> f64 {
        level.elevation_level_at(Column { x, y: 0.0 }, Row { x: y, ..Row::default() }, height_m)
    }

    fn measures() -> impl Strategy<Value = Measure> {
        prop_oneof![Just(Measure::Min), Just(Measure::Area), Just(Measure::Max)]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn the_bound_is_never_above_the_level_at_a_point_of_the_box(
            eye in prop::array::uniform3(-3000.0f64..3000.0),
            angles in prop::array::uniform3(-3.2f64..3.2),
            vfov in 0.05f64..2.8,
            corner in prop::array::uniform3(-3000.0f64..3000.0),
            log_size in prop::array::uniform3(-8.0f64..13.0),
            inside in prop::collection::vec(prop::array::uniform3(0.0f64..=1.0), 12),
            near in any::<bool>(),
            measure in measures(),
        ) {
            let camera = camera(eye, angles, vfov);
            let level = LevelFunction::new(&camera, &world(), 1.0, measure, 10.0, 1.0);
            let size = DVec3::from_array(log_size.map(f64::exp2));
            let mut min = DVec3::from_array(corner);
            if near {
                // Around or beside the eye.
                min = camera.eye() - size * DVec3::from_array(inside[0]) * 1.5;
            }
            let bounds = WorldBox { min, max: min + size };
            let bound = level.elevation_bound(&NodeBounds::Plane(bounds, false));
            let corners = (0..8u8).map(|c| [c & 1, c >> 1 & 1, c >> 2].map(f64::from));
            let eye_inside = (camera.eye().clamp(bounds.min, bounds.max) - min) / size;
            for t in inside.iter().copied().chain(corners).chain([eye_inside.to_array()]) {
                let p = (min + size * DVec3::from_array(t)).clamp(bounds.min, bounds.max);
                let at = level_at(&level, p.x, p.y, p.z);
                prop_assert!(at.is_finite());
                prop_assert!(bound <= at, "bound {bound}, at {p} {at}");
            }
        }

        #[test]
        fn the_logarithm_is_close_and_monotone(x in 1e-30f64..1e30, step in 1e-12f64..0.5) {
            prop_assert!((log2_approximate(x) - x.log2()).abs() < 8e-6);
            prop_assert!(log2_approximate(x) <= log2_approximate(x * (1.0 + step)));
        }
    }

    #[test]
    fn the_logarithm_is_exact_and_continuous_at_powers_of_two() {
        for e in -1000..1000 {
            let x = f64::exp2(f64::from(e));
            assert_eq!(log2_approximate(x), f64::from(e));
            let below = log2_approximate(x.next_down());
            assert!(below <= f64::from(e) && f64::from(e) - below < 1e-12);
        }
    }

    #[test]
    fn a_facet_of_the_wanted_level_has_the_wanted_size_on_screen() {
        // Straight down from 6235.38 m (focal 623.538 px): 10 px are 100 m, and a cell of two
        // facets is √2 as wide.
        let camera = camera([0.0, 0.0, 6235.38], [0.0, -std::f64::consts::FRAC_PI_2, 0.0], 60f64.to_radians());
        for measure in [Measure::Min, Measure::Area, Measure::Max] {
            let level = LevelFunction::new(&camera, &world(), 1.0, measure, 10.0, 1.0);
            let at = level_at(&level, 0.0, 0.0, 0.0);
            assert!((at - (SQRT_2 * 10.0).log2()).abs() < 1e-4, "{measure:?} {at}");
            // A texel of 1 px is 10 m; colour of level q has texels of 10·2^q·32/256 m.
            let color = at + level.color_minus_elevation();
            assert!((color - 8f64.log2()).abs() < 1e-4, "{measure:?} {color}");
        }
    }

    #[test]
    fn measures_are_ordered_and_agree_within_the_least_slant() {
        let camera = camera([0.0, 0.0, 1000.0], [0.0, 0.0, 0.0], 1.0);
        let [min, area, max] = [Measure::Min, Measure::Area, Measure::Max].map(|measure| {
            level_at(&LevelFunction::new(&camera, &world(), 1.0, measure, 10.0, 1.0), 0.0, 50_000.0, 0.0)
        });
        assert!(max < area && area < min);
        assert!((min - max - (1.0 / LEAST_SLANT).log2()).abs() < 1e-4);
        assert!((area - (min + max) / 2.0).abs() < 1e-4);
    }
}
