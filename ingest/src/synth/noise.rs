//! Gradient noise from hashes: a pure function of position and seed, with no table that limits its extent.
//!
//! Only additions, multiplications, `floor` and `sqrt` are used: the same bits on every machine.

/// Sixteen directions around the circle, unit length.
const DIRECTIONS: [[f32; 2]; 16] = [
    [1.0, 0.0],
    [0.923_879_5, 0.382_683_43],
    [0.707_106_77, 0.707_106_77],
    [0.382_683_43, 0.923_879_5],
    [0.0, 1.0],
    [-0.382_683_43, 0.923_879_5],
    [-0.707_106_77, 0.707_106_77],
    [-0.923_879_5, 0.382_683_43],
    [-1.0, 0.0],
    [-0.923_879_5, -0.382_683_43],
    [-0.707_106_77, -0.707_106_77],
    [-0.382_683_43, -0.923_879_5],
    [0.0, -1.0],
    [0.382_683_43, -0.923_879_5],
    [0.707_106_77, -0.707_106_77],
    [0.923_879_5, -0.382_683_43],
];

/// One of sixteen directions.
#[must_use]
pub fn direction(hash: u32) -> [f32; 2] {
    DIRECTIONS[(hash >> 28) as usize]
}

/// A hash of a lattice point (mixing constants of MurmurHash3's finaliser).
#[must_use]
pub fn hash(x: i64, y: i64, seed: u32) -> u32 {
    let mut h = (x as u32).wrapping_mul(0x9e37_79b1) ^ (y as u32).wrapping_mul(0x85eb_ca77).rotate_left(13) ^ seed;
    h ^= h >> 16;
    h = h.wrapping_mul(0x85eb_ca6b);
    h ^= h >> 13;
    h = h.wrapping_mul(0xc2b2_ae35);
    h ^ (h >> 16)
}

/// A hash as a number from 0 to 1.
#[must_use]
pub fn unit(hash: u32) -> f32 {
    (hash >> 8) as f32 * (1.0 / (1 << 24) as f32)
}

/// Gradient noise in about ±0.7, and its gradient (quintic interpolation; Perlin 2002).
#[must_use]
pub fn noise_and_slope(x: f64, y: f64, seed: u32) -> (f32, [f32; 2]) {
    let (fx, fy) = (x.floor(), y.floor());
    let (ix, iy) = (fx as i64, fy as i64);
    let (u, v) = ((x - fx) as f32, (y - fy) as f32);
    let fade = |t: f32| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
    let fade_slope = |t: f32| 30.0 * t * t * (t * (t - 2.0) + 1.0);
    let (su, sv) = (fade(u), fade(v));
    let (du, dv) = (fade_slope(u), fade_slope(v));
    let corner = |i: i64, j: i64| direction(hash(ix + i, iy + j, seed));
    let (a, b, c, d) = (corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1));
    let va = a[0] * u + a[1] * v;
    let vb = b[0] * (u - 1.0) + b[1] * v;
    let vc = c[0] * u + c[1] * (v - 1.0);
    let vd = d[0] * (u - 1.0) + d[1] * (v - 1.0);
    let k = va - vb - vc + vd;
    let value = va + su * (vb - va) + sv * (vc - va) + su * sv * k;
    let slope = [0, 1].map(|axis| {
        let along = a[axis] + su * (b[axis] - a[axis]) + sv * (c[axis] - a[axis]);
        along + su * sv * (a[axis] - b[axis] - c[axis] + d[axis])
    });
    (value, [slope[0] + du * (vb - va + sv * k), slope[1] + dv * (vc - va + su * k)])
}

/// Gradient noise in about ±0.7.
#[must_use]
pub fn noise(x: f64, y: f64, seed: u32) -> f32 {
    noise_and_slope(x, y, seed).0
}

/// Octaves of noise, each twice as fine and half as strong; about ±1.
#[must_use]
pub fn octaves(x: f64, y: f64, seed: u32, count: u32) -> f32 {
    let (mut sum, mut weight, mut scale) = (0.0, 1.0, 1.0);
    for octave in 0..count {
        sum += weight * noise(x * scale, y * scale, seed.wrapping_add(octave.wrapping_mul(0x51ed_270b)));
        weight *= 0.5;
        // Not quite two: lattices of octaves do not line up.
        scale *= 2.03;
    }
    sum
}

/// 0 below `low`, 1 above `high`, smooth between.
#[must_use]
pub fn smoothstep(low: f32, high: f32, v: f32) -> f32 {
    let t = ((v - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_slope_is_the_derivative(x in -1e4f64..1e4, y in -1e4f64..1e4, seed: u32) {
            let (value, slope) = noise_and_slope(x, y, seed);
            prop_assert!(value.abs() < 1.0);
            let step = 1e-3;
            let measured = [noise(x + step, y, seed), noise(x, y + step, seed)].map(|v| (v - value) / step as f32);
            for axis in 0..2 {
                prop_assert!((measured[axis] - slope[axis]).abs() < 0.02, "{:?} {:?}", measured, slope);
            }
        }
    }
}
