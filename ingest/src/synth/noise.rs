//! Gradient noise from hashes: a pure function of position and seed, with no table that limits its
//! extent.
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
#[inline]
pub fn direction(hash: u32) -> [f32; 2] {
    DIRECTIONS[(hash >> 28) as usize]
}

/// A hash of a lattice point (mixing constants of MurmurHash3's finaliser).
#[must_use]
#[inline]
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
#[inline]
pub fn unit(hash: u32) -> f32 {
    (hash >> 8) as f32 * (1.0 / (1 << 24) as f32)
}

/// The lattice cell of a point, and where in it the point is. (A cast and a step down: `floor` is a
/// call into the C library on processors as old as the ones that we build for.)
#[inline]
fn cell(x: f64) -> (i64, f32) {
    let whole = x as i64;
    let whole = whole - i64::from(x < whole as f64);
    (whole, (x - whole as f64) as f32)
}

/// What both kinds of noise begin with: gradients at a cell's corners, and the four planes at a
/// point in it.
#[inline]
fn planes(x: f64, y: f64, seed: u32) -> ([f32; 2], [[f32; 2]; 4], [f32; 4]) {
    let ((ix, u), (iy, v)) = (cell(x), cell(y));
    let corners = [
        direction(hash(ix, iy, seed)),
        direction(hash(ix + 1, iy, seed)),
        direction(hash(ix, iy + 1, seed)),
        direction(hash(ix + 1, iy + 1, seed)),
    ];
    let [a, b, c, d] = corners;
    let values = [
        a[0] * u + a[1] * v,
        b[0] * (u - 1.0) + b[1] * v,
        c[0] * u + c[1] * (v - 1.0),
        d[0] * (u - 1.0) + d[1] * (v - 1.0),
    ];
    ([u, v], corners, values)
}

#[inline]
fn fade(t: f32) -> f32 {
    t * t * t * (t * (t * 6.0 - 15.0) + 10.0)
}

/// Gradient noise in about ±0.7, and its gradient (quintic interpolation; Perlin 2002).
#[must_use]
#[inline]
pub fn noise_and_slope(x: f64, y: f64, seed: u32) -> (f32, [f32; 2]) {
    let ([u, v], [a, b, c, d], [va, vb, vc, vd]) = planes(x, y, seed);
    let fade_slope = |t: f32| 30.0 * t * t * (t * (t - 2.0) + 1.0);
    let (su, sv) = (fade(u), fade(v));
    let k = va - vb - vc + vd;
    let value = va + su * (vb - va) + sv * (vc - va) + su * sv * k;
    let along = |a: f32, b: f32, c: f32, d: f32| a + su * (b - a) + sv * (c - a) + su * sv * (a - b - c + d);
    let east = along(a[0], b[0], c[0], d[0]) + fade_slope(u) * (vb - va + sv * k);
    let north = along(a[1], b[1], c[1], d[1]) + fade_slope(v) * (vc - va + su * k);
    (value, [east, north])
}

/// Gradient noise in about ±0.7.
#[must_use]
#[inline]
pub fn noise(x: f64, y: f64, seed: u32) -> f32 {
    let ([u, v], _, [va, vb, vc, vd]) = planes(x, y, seed);
    let (su, sv) = (fade(u), fade(v));
    va + su * (vb - va) + sv * (vc - va) + su * sv * (va - vb - vc + vd)
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
