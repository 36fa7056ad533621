//! Terrain for load tests that takes many bytes and little time: gigabytes of tiles, no two of them
//! equal. It looks like hills under a grainy film; its purpose is to be read, cached and evicted.
//!
//! Heights are value noise of five wavelengths, from one table of random numbers: the same function
//! of position on every level. Colours are a tone, value noise too, one for each block of 8 x 8
//! texels, and grain, which is one of some thousand blocks that are made and encoded once. The
//! index of the block is a hash of its position, the same for all tiles that contain it. The grain
//! of each level is as fine as its texels: a half-band filter removes that of the finer level.

mod jpeg;

use crate::sample::elevation::quantized;
use crate::synth::noise::{hash, unit};
use jpeg::{BLOCK, Frame, Packed};
use std::io;
use terravision_common::world::COLOR_BORDER;

/// Numbers along a side of the table that value noise is made from; a power of two.
const TABLE: usize = 256;
/// Wavelengths of the heights, lattice units, and their amplitudes, metres.
const HEIGHTS: [(f64, f32); 5] = [(512.0, 420.0), (97.0, 140.0), (19.0, 45.0), (4.3, 12.0), (1.0, 1.5)];
const MEAN_M: f32 = 700.0;
/// Wavelengths of the tone, lattice units, and their amplitudes.
const TONES: [(f64, f32); 3] = [(700.0, 40.0), (61.0, 25.0), (11.0, 20.0)];
/// Blocks of grain, a power of two.
const BLOCKS: u32 = 4096;
/// Number of non-zero coefficients of a block, of brightness and of colour differences, and the
/// largest of them. They give tiles of about 60 kB.
const COEFFICIENTS: [i64; 2] = [50, 29];
const MOST: f32 = 3.5;

// Blocks of neighbours lie one upon the other where their tiles overlap.
const _: () = assert!(2 * COLOR_BORDER == BLOCK);

/// The tables.
#[derive(Debug, Clone)]
pub(crate) struct Bulk {
    /// Numbers from -1 to 1.
    table: Vec<f32>,
    frame: Frame,
    /// Of brightness and of colour differences.
    grain: [Vec<Packed>; 2],
}

impl Bulk {
    /// For colour tiles of `side`² texels, border included.
    pub(crate) fn new(side: u32, quality: u8) -> io::Result<Self> {
        let number = |x: i64, y: i64, seed: u32| 2.0 * unit(hash(x, y, seed)) - 1.0;
        let table = (0..TABLE * TABLE).map(|k| number((k % TABLE) as i64, (k / TABLE) as i64, 5)).collect();
        let frame = Frame::new(side, quality)?;
        let grain = [0, 1].map(|kind| {
            let block = |b: i64| -> Vec<i32> {
                (0..COEFFICIENTS[kind]).map(|c| (MOST * number(b, c, 6 + kind as u32)).round() as i32).collect()
            };
            (0..i64::from(BLOCKS)).map(|b| frame.pack(kind, &block(b))).collect()
        });
        Ok(Self { table, frame, grain })
    }

    /// Value noise from -1 to 1, of wavelength 1.
    fn noise(&self, x: f64, y: f64) -> f32 {
        let cell = |v: f64| {
            // Positions are not negative, except within a border's width.
            let v = v + TABLE as f64;
            let whole = v as usize;
            (whole, (v - whole as f64) as f32)
        };
        let ((i, u), (j, v)) = (cell(x), cell(y));
        let at = |i: usize, j: usize| self.table[(j % TABLE) * TABLE + i % TABLE];
        let fade = |t: f32| t * t * (3.0 - 2.0 * t);
        let (u, v) = (fade(u), fade(v));
        let along = |j: usize| at(i, j) + u * (at(i + 1, j) - at(i, j));
        let (south, north) = (along(j), along(j + 1));
        south + v * (north - south)
    }

    fn sum(&self, bands: &[(f64, f32)], x: f64, y: f64) -> f32 {
        // Each wavelength has its own part of the table.
        let band = |(k, (wave, most)): (usize, &(f64, f32))| {
            most * self.noise(x / wave + 31.0 * k as f64, y / wave + 57.0 * k as f64)
        };
        bands.iter().enumerate().map(band).sum()
    }

    /// Height at a place in lattice units, metres.
    pub(crate) fn height(&self, x: f64, y: f64) -> f32 {
        quantized(MEAN_M + self.sum(&HEIGHTS, x, y))
    }

    /// The colour tile of a column and row of tiles, on the level whose texels have this size,
    /// lattice units; `tile` is their number along its side, without the border.
    pub(crate) fn color_tile(&self, at: [u32; 2], tile: u32, texel: f64) -> Vec<u8> {
        let blocks = i64::from(tile / BLOCK);
        self.frame.tile(|column, row| {
            let x = i64::from(at[0]) * blocks + i64::from(column);
            let y = (i64::from(at[1]) + 1) * blocks - i64::from(row);
            let side = f64::from(BLOCK) * texel;
            let tone = self.sum(&TONES, x as f64 * side, y as f64 * side) as i32;
            let chance = hash(x, y, texel.to_bits() as u32 ^ (texel.to_bits() >> 32) as u32);
            let block = |kind: usize, shift: u32| &self.grain[kind][(chance >> shift & (BLOCKS - 1)) as usize];
            ([tone - 8, -tone / 6 - 9, tone / 8], [block(0, 0), block(1, 10), block(1, 20)])
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use terravision_common::database::decode_color_tile;

    #[test]
    fn tiles_continue_each_other() {
        let (tile, stored) = (64, 72);
        let bulk = Bulk::new(stored, 90).unwrap();
        let decoded = |at: [u32; 2]| {
            let mut out = vec![0; (stored * stored * 4 * 2) as usize];
            decode_color_tile(&bulk.color_tile(at, tile, 0.5), stored, &mut out).unwrap();
            out
        };
        let (middle, east, north) = (decoded([3, 7]), decoded([4, 7]), decoded([3, 8]));
        let texel = |tile: &[u8], x: u32, y: u32| {
            let at = ((y * stored + x) * 4) as usize;
            [tile[at], tile[at + 1], tile[at + 2]]
        };
        for along in 0..stored {
            for across in 0..2 * COLOR_BORDER {
                assert_eq!(texel(&middle, tile + across, along), texel(&east, across, along), "{across}, {along}");
                // The first row is in the north.
                assert_eq!(texel(&middle, along, across), texel(&north, along, tile + across), "{across}, {along}");
            }
        }
    }

    #[test]
    fn heights_are_hills_without_steps() {
        let bulk = Bulk::new(72, 90).unwrap();
        let heights: Vec<f32> = (0..20_000).map(|k| bulk.height(f64::from(k) * 0.1, 77.3)).collect();
        let (low, high) = heights.iter().fold((f32::MAX, f32::MIN), |(low, high), h| (low.min(*h), high.max(*h)));
        assert!(low > 0.0 && high < 1400.0 && high - low > 200.0, "{low} to {high}");
        assert!(heights.windows(2).all(|pair| (pair[0] - pair[1]).abs() < 5.0));
    }
}
