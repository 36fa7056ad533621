//! Synthetic bodies: `dem.tif` (whole metres) and `ortho.tif`, over all longitudes and latitudes.
//!
//! Height is a function of the direction from the middle of the body, so that there is neither seam nor
//! pole: continents, basins or plains of a few low degrees, fractal relief down to the distance of the
//! samples, and craters where there is no weather. Colours are those of height, slope and hollows, lit
//! from everywhere: a light from one side would turn around at the poles.

use super::noise::{smoothstep, unit};
use super::{BLOCK, Complaints, FILES, Parts, check_free, create, gdal_error, put};
use crate::body::BodyChoice;
use crate::error::IngestError;
use crate::job::quieten_gdal;
use crate::source::crs;
use crate::work::Work;
use glam::{DVec3, Vec3};
use std::fs;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// What is asked for, checked.
#[derive(Debug, Clone)]
pub struct SynthBodyOptions {
    /// Folder to write to.
    pub output: PathBuf,
    /// Which body's radius and looks it has.
    pub model: BodyModel,
    /// Samples around the equator: even. Half as many from pole to pole.
    pub columns: u32,
    /// Which world.
    pub seed: u64,
    /// Threads.
    pub threads: usize,
    /// Whether files that are there are replaced.
    pub may_overwrite: bool,
}

/// The bodies that can be made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BodyModel {
    /// Seas and continents.
    Earth,
    /// Lowlands and highlands, with craters.
    Mars,
    /// Plains and craters.
    Moon,
}

/// A picture has at most this many columns: colours are dearer than heights.
const MOST_PIXELS: u32 = 8192;

impl BodyModel {
    /// By its name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        [("earth", Self::Earth), ("mars", Self::Mars), ("moon", Self::Moon)]
            .into_iter()
            .find_map(|(known, model)| known.eq_ignore_ascii_case(name).then_some(model))
    }

    fn name(self) -> &'static str {
        match self {
            Self::Earth => "earth",
            Self::Mars => "mars",
            Self::Moon => "moon",
        }
    }

    fn radius_m(self) -> f64 {
        match self {
            Self::Earth => 6_371_000.0,
            Self::Mars => 3_396_190.0,
            Self::Moon => 1_737_400.0,
        }
    }
}

fn hash3([x, y, z]: [i64; 3], seed: u32) -> u32 {
    let mut h = (x as u32).wrapping_mul(0x9e37_79b1)
        ^ (y as u32).wrapping_mul(0x85eb_ca77).rotate_left(13)
        ^ (z as u32).wrapping_mul(0xc2b2_ae3d).rotate_left(21)
        ^ seed;
    h ^= h >> 16;
    h = h.wrapping_mul(0x85eb_ca6b);
    h ^= h >> 13;
    h = h.wrapping_mul(0xc2b2_ae35);
    h ^ (h >> 16)
}

/// Gradient noise in space, in about ±0.8.
fn noise3(at: DVec3, seed: u32) -> f32 {
    let floor = at.floor();
    let cell = [floor.x as i64, floor.y as i64, floor.z as i64];
    let [u, v, w] = (at - floor).as_vec3().to_array();
    let corner = |i: i64, j: i64, k: i64| {
        let h = hash3([cell[0] + i, cell[1] + j, cell[2] + k], seed);
        let (x, y, z) = (u - i as f32, v - j as f32, w - k as f32);
        // Twelve edges of a cube, four of them twice (Perlin 2002).
        match h >> 28 {
            0 | 12 => x + y,
            1 | 13 => y - x,
            2 => x - y,
            3 => -x - y,
            4 => x + z,
            5 => z - x,
            6 => x - z,
            7 => -x - z,
            8 => y + z,
            9 | 14 => z - y,
            10 => y - z,
            _ => -y - z,
        }
    };
    let fade = |t: f32| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
    let (su, sv, sw) = (fade(u), fade(v), fade(w));
    let mix = |a: f32, b: f32, s: f32| a + s * (b - a);
    let layer = |k: i64| {
        let south = mix(corner(0, 0, k), corner(1, 0, k), su);
        mix(south, mix(corner(0, 1, k), corner(1, 1, k), su), sv)
    };
    mix(layer(0), layer(1), sw)
}

/// Octaves of noise from a scale on, each twice as fine and `gain` times as strong.
fn octaves3(at: DVec3, seed: u32, count: u32, gain: f32) -> f32 {
    let (mut sum, mut weight, mut at) = (0.0, 1.0, at);
    for octave in 0..count {
        sum += weight * noise3(at, seed.wrapping_add(octave.wrapping_mul(0x51ed_270b)));
        weight *= gain;
        at = 2.0 * at + DVec3::new(17.3, -5.9, 9.1);
    }
    sum
}

/// The ground of a body.
#[derive(Debug, Clone, Copy)]
struct Ground {
    model: BodyModel,
    seed: u32,
    /// Octaves from a body's radius to twice the distance of samples.
    octaves: u32,
    /// Sizes of craters, each half the one before.
    crater_sizes: u32,
}

impl Ground {
    fn new(model: BodyModel, columns: u32, seed: u64) -> Self {
        let octaves = (columns / 8).max(2).ilog2();
        let crater_sizes = if model == BodyModel::Earth { 0 } else { octaves.saturating_sub(2).min(9) };
        Self { model, seed: (seed ^ (seed >> 32)) as u32 ^ 0x5ba1_1e57, octaves, crater_sizes }
    }

    fn seed(&self, kind: u32) -> u32 {
        self.seed.wrapping_mul(0x9e37_79b1).wrapping_add(kind.wrapping_mul(0x85eb_ca6b))
    }

    /// Height in a direction, metres.
    fn height(&self, up: DVec3) -> f32 {
        let bend = |kind| f64::from(octaves3(2.0 * up, self.seed(kind), 3, 0.5));
        let bent = up + 0.35 * DVec3::new(bend(1), bend(2), bend(3));
        let wide = octaves3(1.1 * bent, self.seed(4), 4, 0.5);
        let rough = octaves3(6.0 * bent, self.seed(5), self.octaves.saturating_sub(2).max(1), 0.52);
        match self.model {
            BodyModel::Earth => {
                let land = smoothstep(-0.12, 0.28, wide);
                let crest = 1.0 - 1.6 * octaves3(3.0 * bent, self.seed(6), self.octaves.max(1), 0.5).abs();
                let mountains = land * smoothstep(0.35, 1.0, crest) * 5500.0;
                -4600.0 + 5000.0 * land + mountains + (250.0 + 700.0 * land) * rough
            }
            BodyModel::Mars => {
                let tilt = (up.z as f32) * -2600.0;
                tilt + 2600.0 * wide + 900.0 * rough + self.volcanoes(up) + self.craters(up, 1.0)
            }
            BodyModel::Moon => {
                let highland = smoothstep(-0.3, 0.15, wide);
                -1800.0 + 2600.0 * highland + (150.0 + 900.0 * highland) * rough + self.craters(up, 0.35 + highland)
            }
        }
    }

    /// A few shields.
    fn volcanoes(&self, up: DVec3) -> f32 {
        (0..5u32)
            .map(|k| {
                let number = |i: u32| unit(hash3([k.into(), i.into(), 7], self.seed(9)));
                let place = DVec3::new(number(0).into(), number(1).into(), number(2).into()) * 2.0 - 1.0;
                let away = up.distance(place.normalize_or(DVec3::X)) as f32 / (0.06 + 0.09 * number(3));
                let caldera = 0.16 * smoothstep(-0.16, -0.10, -away);
                14_000.0 * number(4) * (smoothstep(-1.0, 0.0, -away).powi(2) - caldera).max(0.0)
            })
            .sum()
    }

    /// Craters of all sizes, metres; `share` of their depth.
    fn craters(&self, up: DVec3, share: f32) -> f32 {
        let radius_m = self.model.radius_m() as f32;
        let mut sum = 0.0;
        for size in 0..self.crater_sizes {
            let scale = 3.3 * f64::from(1u32 << size);
            let (at, seed) = (up * scale, self.seed(20 + size));
            // None reaches further than half a cell: eight cells have all that may lie here.
            let first = (at - 0.5).floor();
            for neighbor in 0..8i64 {
                let corner =
                    first + DVec3::new((neighbor & 1) as f64, (neighbor >> 1 & 1) as f64, (neighbor >> 2) as f64);
                let h = hash3([corner.x as i64, corner.y as i64, corner.z as i64], seed);
                // Most cells have one.
                if h & 3 == 0 {
                    continue;
                }
                let number = |i: u32| unit(h.wrapping_mul(0x9e37_79b1u32.wrapping_add(i.wrapping_mul(0xc657_cb56))));
                let middle = Vec3::new(number(1), number(2), number(3));
                let radius = 0.12 + 0.21 * number(4) * number(4);
                let away = (at - corner).as_vec3().distance(middle) / radius;
                if away < CRATER_REACH {
                    sum += crater(away) * depth_m(2.0 * radius * radius_m / scale as f32);
                }
            }
        }
        share * sum
    }

    /// Height, and what colours look at: slope (rise over run) and how much of a hollow it is.
    fn looks(&self, up: DVec3, step: f64) -> [f32; 3] {
        let east = up.any_orthonormal_vector();
        let north = up.cross(east);
        let around = [east, -east, north, -north].map(|way| self.height((up + step * way).normalize()));
        let height = self.height(up);
        let run = (2.0 * step * self.model.radius_m()) as f32;
        let slope = ((around[0] - around[1]) / run).hypot((around[2] - around[3]) / run);
        [height, slope, (around.iter().sum::<f32>() - 4.0 * height) / run]
    }

    fn color(&self, up: DVec3, step: f64) -> [u8; 3] {
        let [height, slope, hollow] = self.looks(up, step);
        let spots = octaves3(14.0 * up, self.seed(40), 4, 0.6);
        let ramp = |low: [f32; 3], high: [f32; 3], t: f32| {
            let t = t.clamp(0.0, 1.0);
            [0, 1, 2].map(|c| low[c] + t * (high[c] - low[c]))
        };
        let latitude = up.z.abs() as f32;
        let base = match self.model {
            BodyModel::Earth if height < 0.0 => ramp([58.0, 120.0, 150.0], [12.0, 36.0, 84.0], -height / 3500.0),
            BodyModel::Earth => {
                let dry = smoothstep(-0.2, 0.25, 0.45 - (latitude - 0.4).abs() * 2.0 + 0.6 * spots);
                let green = ramp([64.0, 96.0, 44.0], [176.0, 150.0, 98.0], dry);
                let rock = ramp(green, [122.0, 110.0, 98.0], (height - 900.0) / 2500.0);
                ramp(
                    rock,
                    [240.0, 244.0, 248.0],
                    (height + 5200.0 * (latitude - 0.35) + 600.0 * spots - 3300.0) / 700.0,
                )
            }
            BodyModel::Mars => {
                let dust = ramp([120.0, 70.0, 46.0], [206.0, 142.0, 92.0], 0.5 + height / 9000.0 + 0.35 * spots);
                ramp(dust, [236.0, 232.0, 228.0], (latitude - 0.975 + 0.012 * spots) / 0.006)
            }
            BodyModel::Moon => ramp([74.0, 74.0, 78.0], [178.0, 176.0, 170.0], 0.45 + height / 4500.0 + 0.12 * spots),
        };
        let is_sea = self.model == BodyModel::Earth && height < 0.0;
        let strength = if is_sea { 0.2 } else { 1.0 };
        let light = 1.0 - strength * (0.9 * slope.min(0.5) + (6.0 * hollow).clamp(-0.25, 0.35));
        base.map(|v| (v * light).round().clamp(0.0, 255.0) as u8)
    }
}

/// Radii of a crater at which its rim ends.
const CRATER_REACH: f32 = 1.5;

/// The profile of a crater by the distance from its middle in radii, in depths.
fn crater(away: f32) -> f32 {
    let bowl = (away * away - 1.0).max(-0.75);
    let rim = 0.28 * (-((away - 1.0) * (away - 1.0)) / 0.06).exp();
    if away < 1.0 { bowl + rim } else { rim * (1.0 - smoothstep(1.2, CRATER_REACH, away)) }
}

/// Depth of a fresh crater of a diameter, metres (Pike 1977: 0.196 D^1.01, beyond 15 km 1.044 D^0.301,
/// kilometres), half of it: most are old.
fn depth_m(diameter_m: f32) -> f32 {
    let km = diameter_m * 1e-3;
    500.0 * if km < 15.0 { 0.196 * km.powf(1.01) } else { 1.044 * km.powf(0.301) }
}

/// The direction of a pixel's middle.
fn direction([columns, rows]: [usize; 2], column: usize, row: usize) -> DVec3 {
    let longitude = ((column as f64 + 0.5) / columns as f64 - 0.5) * std::f64::consts::TAU;
    let latitude = (0.5 - (row as f64 + 0.5) / rows as f64) * std::f64::consts::PI;
    let ((sin, cos), (sin_lat, cos_lat)) = (longitude.sin_cos(), latitude.sin_cos());
    DVec3::new(cos_lat * cos, cos_lat * sin, sin_lat)
}

/// Writes both files. They get their names when they are complete.
///
/// # Errors
/// [`IngestError`].
pub fn write(options: &SynthBodyOptions, stop: Arc<AtomicBool>, shows_progress: bool) -> Result<(), IngestError> {
    quieten_gdal(256 << 20);
    let complaints = Complaints::listen();
    let folder = &options.output;
    check_free(folder, options.may_overwrite)?;
    let work = Work::new(options.threads, stop, shows_progress, folder.clone());
    let parts = Parts { paths: FILES.map(|name| folder.join(format!("{name}.part"))) };
    let ground = Ground::new(options.model, options.columns, options.seed);
    let size = |columns: u32| [columns as usize, columns as usize / 2];
    let (posts, pixels) = (size(options.columns), size(options.columns.min(MOST_PIXELS)));
    let text = BodyChoice::parse(options.model.name()).ok().and_then(|body| body.assumed_crs());
    let srs = crs::parse("the body", &text.unwrap_or_default())?;
    let transform = |size: [usize; 2]| {
        let step = 360.0 / size[0] as f64;
        [-180.0, step, 0.0, 90.0, 0.0, -step]
    };
    let mut dem = create::<i16>(&parts.paths[0], posts, 1, transform(posts), &srs)?;
    let blocks = |size: [usize; 2]| size.map(|n| n.div_ceil(BLOCK));
    let rect = |size: [usize; 2], index: usize| {
        let first = [index % blocks(size)[0] * BLOCK, index / blocks(size)[0] * BLOCK];
        (first, [0, 1].map(|axis| BLOCK.min(size[axis] - first[axis])))
    };
    let places = |(first, count): ([usize; 2], [usize; 2])| {
        (0..count[0] * count[1]).map(move |k| [first[0] + k % count[0], first[1] + k / count[0]])
    };
    work.in_order(
        "synthetic heights",
        blocks(posts).iter().product(),
        || Ok(()),
        |(), index| {
            let height = |[column, row]: [usize; 2]| ground.height(direction(posts, column, row)).round() as i16;
            Ok((rect(posts, index), places(rect(posts, index)).map(height).collect::<Vec<i16>>()))
        },
        |((first, count), heights)| put(&dem, &parts.paths[0], 1, first, count, heights),
    )?;
    dem.flush_cache().map_err(|e| gdal_error(&parts.paths[0], &e))?;
    dem.close().map_err(|e| gdal_error(&parts.paths[0], &e))?;
    let mut photo = create::<u8>(&parts.paths[1], pixels, 3, transform(pixels), &srs)?;
    let step = std::f64::consts::TAU / pixels[0] as f64;
    work.in_order(
        "synthetic colours",
        blocks(pixels).iter().product(),
        || Ok(()),
        |(), index| {
            let color = |[column, row]: [usize; 2]| ground.color(direction(pixels, column, row), step);
            Ok((rect(pixels, index), places(rect(pixels, index)).map(color).collect::<Vec<[u8; 3]>>()))
        },
        |((first, count), colors)| {
            (0..3).try_for_each(|band| {
                let samples = colors.iter().map(|color| color[band]).collect();
                put(&photo, &parts.paths[1], band + 1, first, count, samples)
            })
        },
    )?;
    photo.flush_cache().map_err(|e| gdal_error(&parts.paths[1], &e))?;
    photo.close().map_err(|e| gdal_error(&parts.paths[1], &e))?;
    complaints.none(folder)?;
    for (path, name) in parts.paths.iter().zip(FILES) {
        fs::rename(path, folder.join(name)).map_err(|source| IngestError::Output { source, path: path.clone() })?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bodies_have_relief_without_a_seam() {
        for model in [BodyModel::Earth, BodyModel::Mars, BodyModel::Moon] {
            let ground = Ground::new(model, 720, 1);
            let size = [720, 360];
            let heights: Vec<f32> = (0..360)
                .step_by(9)
                .flat_map(|row| (0..720).step_by(9).map(move |c| (c, row)))
                .map(|(c, row)| ground.height(direction(size, c, row)))
                .collect();
            let (low, high) = heights.iter().fold((f32::MAX, f32::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
            assert!(high - low > 4000.0 && low > -12_000.0 && high < 25_000.0, "{model:?}: {low} to {high}");
            for row in [0, 100, 200, 359] {
                let steps = (0..720).map(|c| {
                    (ground.height(direction(size, c, row)) - ground.height(direction(size, (c + 1) % 720, row))).abs()
                });
                let steps: Vec<f32> = steps.collect();
                let seam = steps[719];
                let most = steps[..719].iter().copied().fold(0.0, f32::max);
                assert!(seam <= most, "{model:?}, row {row}: {seam} m across the seam, {most} m elsewhere");
            }
        }
    }
}
