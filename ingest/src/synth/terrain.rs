//! Heights of the synthetic world.
//!
//! Mountains are a ridged multifractal (Musgrave, in Texturing and Modeling, 2003) over warped
//! space. Each octave is damped where the ones before are already steep, so that slopes are smooth
//! and crests and valley heads are rough: what erosion does, for the price of a derivative. Below,
//! valleys are filled to gently undulating floors, and what lies under the lake level is a lake.

use super::noise::{noise_and_slope, octaves, smoothstep};

/// Height of all lakes, metres.
pub const LAKE_M: f32 = 430.0;

/// The synthetic terrain.
#[derive(Debug, Clone, Copy)]
pub struct Terrain {
    seed: u32,
}

impl Terrain {
    /// The terrain of a seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self { seed: (seed ^ (seed >> 32)) as u32 ^ 0x7e44_a117 }
    }

    /// A seed for one kind of noise.
    #[must_use]
    pub fn seed(&self, kind: u32) -> u32 {
        self.seed.wrapping_mul(0x9e37_79b1).wrapping_add(kind.wrapping_mul(0x85eb_ca6b))
    }

    /// Height at a point, metres; x east and y north in metres.
    #[must_use]
    pub fn height(&self, x: f64, y: f64) -> f32 {
        let km = 1e-3;
        // Bend everything: straight noise looks like noise.
        let bend = |kind, size: f64, count| f64::from(octaves(x / size, y / size, self.seed(kind), count));
        let (wx, wy) = (x + 1700.0 * bend(1, 7000.0, 4), y + 1700.0 * bend(2, 7000.0, 4));
        // Ranges and basins, some 25 km apart.
        let range = octaves(wx / 21_000.0, wy / 21_000.0, self.seed(3), 2);
        let massif = smoothstep(-0.52, 0.42, range + 0.06);
        let ridges = self.ridges(wx * km / 8.0, wy * km / 8.0);
        let spurs = self.spurs(wx * km / 5.2, wy * km / 5.2);
        let relief = 0.62 * ridges + 0.62 * spurs;
        let mountains = 120.0 + massif * (massif * 2700.0 + 700.0) * relief + 150.0 * relief;
        // Valley floors: what the mountains have lost.
        let floor = LAKE_M
            + 16.0
            + 90.0 * octaves(x / 14_000.0, y / 14_000.0, self.seed(6), 3)
            + 3.0 * octaves(x / 600.0, y / 600.0, self.seed(7), 3);
        let land = smooth_max(mountains, floor, 150.0);
        if land < LAKE_M { LAKE_M } else { land }
    }

    /// Ridged multifractal, about 0 to 1: crests.
    fn ridges(&self, x: f64, y: f64) -> f32 {
        const OCTAVES: u32 = 9;
        let (mut sum, mut amplitude, mut weight) = (0.0f32, 0.42f32, 1.0f32);
        let mut steep = [0.0f32; 2];
        let (mut x, mut y) = (x, y);
        for octave in 0..OCTAVES {
            let (value, slope) = noise_and_slope(x, y, self.seed(100 + octave));
            // A crest where the noise changes sign, rounded so that it is not a knife's edge.
            let rounded = (value * value + 0.0025).sqrt();
            let crest = 1.0 - rounded * 1.5;
            let signal = crest * crest;
            let side = -2.0 * crest * 1.5 * value / rounded;
            let damping = 1.0 / (1.0 + 0.4 * (steep[0] * steep[0] + steep[1] * steep[1]));
            sum += amplitude * weight * signal * damping;
            steep[0] += amplitude * weight * slope[0] * side;
            steep[1] += amplitude * weight * slope[1] * side;
            weight = (signal * 1.6).clamp(0.1, 1.0);
            amplitude *= 0.5;
            (x, y) = turned(x, y);
        }
        sum
    }

    /// Noise whose finer octaves fade where the coarser ones are steep, about 0 to 1: spurs and
    /// gullies between.
    fn spurs(&self, x: f64, y: f64) -> f32 {
        const OCTAVES: u32 = 10;
        let (mut sum, mut amplitude) = (0.0f32, 1.0f32);
        let mut steep = [0.0f32; 2];
        let (mut x, mut y) = (x, y);
        for octave in 0..OCTAVES {
            let (value, slope) = noise_and_slope(x, y, self.seed(200 + octave));
            steep[0] += slope[0] * 0.9;
            steep[1] += slope[1] * 0.9;
            sum += amplitude * value / (1.0 + steep[0] * steep[0] + steep[1] * steep[1]);
            amplitude *= 0.5;
            (x, y) = turned(x, y);
        }
        (0.42 + 0.75 * sum).max(0.0)
    }
}

/// Turned by about 37 degrees and doubled, so that features of octaves cross.
fn turned(x: f64, y: f64) -> (f64, f64) {
    (1.6 * x - 1.2 * y + 17.3, 1.2 * x + 1.6 * y - 5.9)
}

/// The larger of two, rounded within about `width` of where they meet (polynomial smooth maximum).
fn smooth_max(a: f32, b: f32, width: f32) -> f32 {
    let h = (width - (a - b).abs()).max(0.0) / width;
    a.max(b) + h * h * width * 0.25
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_are_mountains_plains_and_lakes() {
        let terrain = Terrain::new(1);
        let heights: Vec<f32> =
            (0..200 * 200).map(|k| terrain.height(f64::from(k % 200) * 205.0, f64::from(k / 200) * 205.0)).collect();
        let share = |is: &dyn Fn(f32) -> bool| heights.iter().filter(|h| is(**h)).count() as f32 / heights.len() as f32;
        assert!(share(&|h| h > 1800.0) > 0.03, "{}", share(&|h| h > 1800.0));
        assert!(share(&|h| h == LAKE_M) > 0.01 && share(&|h| h == LAKE_M) < 0.25);
        assert!(heights.iter().all(|h| (LAKE_M..4500.0).contains(h)));
    }

    #[test]
    fn another_seed_is_another_world() {
        let heights = [1, 2].map(|seed| Terrain::new(seed).height(1234.0, 5678.0));
        assert_ne!(heights[0], heights[1]);
    }
}
