//! PSNR and SSIM over a mask, and the median of what is not colour.

/// How near a picture is to its reference, over the masked pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quality {
    /// Peak signal to noise ratio over all three channels, decibels; infinite for equal pictures.
    pub psnr_db: f64,
    /// Mean structural similarity of the luma (Wang et al. 2004: Gaussian window 11 x 11, sigma
    /// 1.5, K1 0.01, K2 0.03), over the pixels whose whole window is in the mask.
    pub ssim: f64,
    /// Pixels in the mask.
    pub pixels: usize,
}

/// Compares two pictures of `width` columns where `mask` is set.
///
/// # Panics
/// When the arrays differ in length, or the mask holds no 11 x 11 window.
#[must_use]
pub fn compare(width: usize, picture: &[[u8; 3]], reference: &[[u8; 3]], mask: &[bool]) -> Quality {
    try_compare(width, picture, reference, mask).expect("the mask holds a whole window")
}

/// The same; `None` when the mask holds no 11 x 11 window.
///
/// # Panics
/// When the arrays differ in length.
#[must_use]
pub fn try_compare(width: usize, picture: &[[u8; 3]], reference: &[[u8; 3]], mask: &[bool]) -> Option<Quality> {
    assert!(picture.len() == reference.len() && picture.len() == mask.len(), "pictures and mask have one size");
    let mut squares = 0.0;
    let mut pixels = 0usize;
    for ((a, b), _) in picture.iter().zip(reference).zip(mask).filter(|(_, land)| **land) {
        pixels += 1;
        squares += a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum::<f64>();
    }
    let mean_square = squares / (3 * pixels) as f64;
    let ssim = ssim(width, picture, reference, mask)?;
    Some(Quality { psnr_db: 10.0 * (255.0 * 255.0 / mean_square).log10(), ssim, pixels })
}

const RADIUS: usize = 5;

/// Rec. 601 luma.
fn luma(rgb: [u8; 3]) -> f64 {
    let [r, g, b] = rgb.map(f64::from);
    0.299 * r + 0.587 * g + 0.114 * b
}

fn gaussian() -> [f64; 2 * RADIUS + 1] {
    let weights: [f64; 2 * RADIUS + 1] =
        std::array::from_fn(|i| (-(i as f64 - RADIUS as f64).powi(2) / (2.0 * 1.5 * 1.5)).exp());
    let sum: f64 = weights.iter().sum();
    weights.map(|w| w / sum)
}

/// Separable filter; values within `RADIUS` of the border are left 0 and not used.
fn blurred(width: usize, values: &[f64]) -> Vec<f64> {
    let weights = gaussian();
    let height = values.len() / width;
    let mut rows = vec![0.0; values.len()];
    for y in 0..height {
        for x in RADIUS..width - RADIUS {
            let at = y * width + x - RADIUS;
            rows[y * width + x] = weights.iter().zip(&values[at..]).map(|(w, v)| w * v).sum();
        }
    }
    let mut out = vec![0.0; values.len()];
    for y in RADIUS..height - RADIUS {
        for x in RADIUS..width - RADIUS {
            out[y * width + x] = (0..=2 * RADIUS).map(|k| weights[k] * rows[(y + k - RADIUS) * width + x]).sum();
        }
    }
    out
}

fn ssim(width: usize, picture: &[[u8; 3]], reference: &[[u8; 3]], mask: &[bool]) -> Option<f64> {
    let a: Vec<f64> = picture.iter().map(|p| luma(*p)).collect();
    let b: Vec<f64> = reference.iter().map(|p| luma(*p)).collect();
    let product = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).collect::<Vec<_>>();
    let (mean_a, mean_b) = (blurred(width, &a), blurred(width, &b));
    let (aa, bb, ab) =
        (blurred(width, &product(&a, &a)), blurred(width, &product(&b, &b)), blurred(width, &product(&a, &b)));
    let whole = eroded(width, mask, RADIUS);
    let (c1, c2) = ((0.01f64 * 255.0).powi(2), (0.03f64 * 255.0).powi(2));
    let mut sum = 0.0;
    let mut count = 0usize;
    for (i, _) in whole.iter().enumerate().filter(|(_, whole)| **whole) {
        let (ma, mb) = (mean_a[i], mean_b[i]);
        let (va, vb, cov) = (aa[i] - ma * ma, bb[i] - mb * mb, ab[i] - ma * mb);
        sum += (2.0 * ma * mb + c1) * (2.0 * cov + c2) / ((ma * ma + mb * mb + c1) * (va + vb + c2));
        count += 1;
    }
    (count > 0).then(|| sum / count as f64)
}

/// The pixels whose whole square of `radius` around them is in the mask and in the picture.
pub(super) fn eroded(width: usize, mask: &[bool], radius: usize) -> Vec<bool> {
    let height = mask.len() / width;
    let mut rows = vec![false; mask.len()];
    for y in 0..height {
        let row = &mask[y * width..][..width];
        for x in radius..width.saturating_sub(radius) {
            rows[y * width + x] = row[x - radius..=x + radius].iter().all(|set| *set);
        }
    }
    let mut out = vec![false; mask.len()];
    for y in radius..height.saturating_sub(radius) {
        for x in 0..width {
            out[y * width + x] = (y - radius..=y + radius).all(|y| rows[y * width + x]);
        }
    }
    out
}

/// Median of |a - b| over the pairs where both are numbers; NaN without pairs.
#[must_use]
pub fn median_absolute_error(pairs: impl Iterator<Item = (f64, f64)>) -> f64 {
    let mut errors: Vec<f64> = pairs.map(|(a, b)| (a - b).abs()).filter(|e| e.is_finite()).collect();
    if errors.is_empty() {
        return f64::NAN;
    }
    let middle = errors.len() / 2;
    *errors.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(amplitude: u32) -> Vec<[u8; 3]> {
        let mut state = 7u32;
        (0..64 * 48)
            .map(|k| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                [(40 + (k % 64) * 2) as u8 + ((state >> 16) % (amplitude + 1)) as u8; 3]
            })
            .collect()
    }

    #[test]
    fn equal_pictures_are_perfect_and_a_known_offset_gives_its_psnr() {
        let a = noise(40);
        let mask = vec![true; a.len()];
        let same = compare(64, &a, &a, &mask);
        assert!(same.psnr_db.is_infinite() && (same.ssim - 1.0).abs() < 1e-12);
        let brighter: Vec<_> = a.iter().map(|p| p.map(|v| v + 10)).collect();
        let offset = compare(64, &brighter, &a, &mask);
        assert!((offset.psnr_db - 20.0 * (25.5f64).log10()).abs() < 1e-9);
        assert!(offset.ssim > 0.95);
    }

    #[test]
    fn lost_detail_costs_similarity_and_masked_pixels_do_not_count() {
        let (a, flat) = (noise(40), noise(0));
        let mut mask = vec![true; a.len()];
        assert!(compare(64, &flat, &a, &mask).ssim < 0.6);
        let mut spoiled = a.clone();
        for y in 0..48 {
            for x in 0..20 {
                spoiled[y * 64 + x] = [255, 0, 255];
                mask[y * 64 + x] = false;
            }
        }
        assert!(compare(64, &spoiled, &a, &mask).psnr_db.is_infinite());
        assert!((compare(64, &spoiled, &a, &mask).ssim - 1.0).abs() < 1e-12);
    }

    #[test]
    fn medians_pass_over_what_is_not_a_number() {
        let pairs = [(1.0, 2.0), (f64::NAN, 0.0), (5.0, 2.0), (0.0, 2.0)];
        assert_eq!(median_absolute_error(pairs.into_iter()), 2.0);
    }
}
