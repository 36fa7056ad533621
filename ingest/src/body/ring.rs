//! Values around a parallel: those of the lattice columns 0, 2^s, 2·2^s, … below the number of columns
//! around, which need not be a multiple of 2^s. Between them, and so from the last to the first,
//! values are interpolated.

/// Radius of the low-pass filter, posts of the finer level.
pub(super) use crate::pyramid::elevation::REACH;
use crate::pyramid::elevation::filtered;

/// The places of values around a parallel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Ring {
    /// Lattice columns around.
    pub(super) columns: u32,
    /// Values lie at multiples of this power of two.
    pub(super) log_step: u8,
}

impl Ring {
    pub(super) fn new(columns: u32, log_step: u8) -> Self {
        Self { columns, log_step }
    }

    /// The next coarser one.
    pub(super) fn coarser(self) -> Self {
        Self { log_step: self.log_step + 1, ..self }
    }

    /// Number of values.
    pub(super) fn count(self) -> usize {
        u64::from(self.columns).div_ceil(1 << self.log_step) as usize
    }

    /// The value at any lattice column.
    fn at(self, values: &[f32], column: i64) -> f32 {
        let columns = i64::from(self.columns);
        let column = column.rem_euclid(columns);
        let before = (column >> self.log_step) as usize;
        let past = column - ((before as i64) << self.log_step);
        if past == 0 {
            return values[before];
        }
        let end = ((before as i64 + 1) << self.log_step).min(columns);
        let after = values[(before + 1) % values.len()];
        let share = past as f32 / (end - ((before as i64) << self.log_step)) as f32;
        values[before] + share * (after - values[before])
    }

    /// The values, with `margin` more on both sides.
    fn extended(self, values: &[f32], margin: usize) -> Vec<f32> {
        let at = |k: i64| self.at(values, k << self.log_step);
        let (margin, count) = (margin as i64, values.len() as i64);
        let mut all = Vec::with_capacity(values.len() + 2 * margin as usize);
        all.extend((-margin..0).map(at));
        all.extend_from_slice(values);
        all.extend((count..count + margin).map(at));
        all
    }

    /// The values half a turn away.
    pub(super) fn turned(self, values: &[f32]) -> Vec<f32> {
        let half = i64::from(self.columns / 2);
        (0..values.len() as i64).map(|k| self.at(values, (k << self.log_step) + half)).collect()
    }

    /// The next coarser values, low-passed.
    pub(super) fn halved(self, values: &[f32]) -> Vec<f32> {
        let extended = self.extended(values, REACH);
        (0..self.coarser().count()).map(|k| filtered(|d| extended[(REACH + 2 * k).wrapping_add_signed(d)])).collect()
    }

    /// The values low-passed to as many posts' width as `ratio` says: 1 leaves them, 2 takes what the
    /// next coarser level cannot show, between them it is a mixture.
    pub(super) fn smoothed(self, values: Vec<f32>, ratio: f64) -> Vec<f32> {
        let (mut values, mut ratio, mut reach) = (values, ratio, 1usize);
        // Wider than the whole parallel is no wider.
        while ratio > 1.0 && reach < values.len() {
            let share = (ratio - 1.0).min(1.0) as f32;
            let margin = REACH * reach;
            let extended = self.extended(&values, margin);
            for (k, value) in values.iter_mut().enumerate() {
                let low = filtered(|d| extended[(margin + k).wrapping_add_signed(d * reach as isize)]);
                *value += share * (low - *value);
            }
            (ratio, reach) = (0.5 * ratio, 2 * reach);
        }
        values
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_constant_stays_and_a_wave_around_has_no_seam() {
        for (columns, log_step) in [(720u32, 0u8), (720, 5), (101, 2), (7, 1)] {
            let ring = Ring::new(columns, log_step);
            let flat = vec![3.5; ring.count()];
            assert_eq!(ring.halved(&flat), vec![3.5; ring.coarser().count()]);
            assert!(ring.smoothed(flat.clone(), 9.3).iter().all(|v| (v - 3.5).abs() < 1e-4));
            assert_eq!(ring.turned(&flat), flat);
        }
        let wave = |column: f64| (column / 720.0 * std::f64::consts::TAU).sin() as f32;
        let ring = Ring::new(720, 0);
        let values: Vec<f32> = (0..720).map(|c| wave(f64::from(c))).collect();
        let coarse = ring.halved(&values);
        for (k, value) in coarse.iter().enumerate() {
            assert!((value - wave(2.0 * k as f64)).abs() < 1e-3, "at {k}: {value}");
        }
        assert!(ring.turned(&values).iter().zip(&values).all(|(a, b)| (a + b).abs() < 1e-5));
    }
}
