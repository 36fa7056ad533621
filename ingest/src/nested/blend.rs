//! Blends finer heights into coarser ones, so that there is no step where two sources meet.

use crate::store::Rect;

/// Width of the blend in posts, inside of the finer data.
pub(super) const BLEND: usize = 16;

/// A post of a block: whether it comes from a source as fine as the level, and its height.
pub(super) type SourcePost = Option<(bool, f32)>;

/// The share of the finer height at each post of the middle of a block that is `BLEND` wider on
/// each side: 1 for posts that are far from coarser ones, less towards them.
pub(super) fn shares(posts: &[SourcePost], around: Rect) -> Vec<f32> {
    let [width, height] = around.size;
    let is_coarse = |k: usize| posts[k].is_some_and(|(is_fine, _)| !is_fine);
    let most = BLEND + 1;
    // Posts to the next coarse one along the row; exact distances are found from those of the rows
    // around.
    let mut along = vec![most; posts.len()];
    for row in 0..height {
        let line = row * width..(row + 1) * width;
        let mut distance = most;
        for k in line.clone() {
            distance = if is_coarse(k) { 0 } else { (distance + 1).min(most) };
            along[k] = distance;
        }
        distance = most;
        for k in line.rev() {
            distance = if is_coarse(k) { 0 } else { (distance + 1).min(most) };
            along[k] = along[k].min(distance);
        }
    }
    let mut out = Vec::with_capacity((width - 2 * BLEND) * (height - 2 * BLEND));
    for row in BLEND..height - BLEND {
        for column in BLEND..width - BLEND {
            let squared = (row - BLEND..=row + BLEND)
                .map(|other| along[other * width + column].pow(2) + row.abs_diff(other).pow(2))
                .min()
                .unwrap_or(most * most);
            let t = ((squared as f32).sqrt() / most as f32).min(1.0);
            out.push(t * t * (3.0 - 2.0 * t));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_rise_from_the_coarse_side_and_voids_are_no_side() {
        let side = 64 + 2 * BLEND;
        let around = Rect::new([0, 0], [side; 2]);
        let posts: Vec<SourcePost> =
            (0..side * side).map(|k| (k % side < 70 || k / side > 40).then_some((k % side >= 40, 0.0))).collect();
        let shares = shares(&posts, around);
        let row = |j: usize| &shares[j * 64..(j + 1) * 64];
        for line in [row(0), row(40)] {
            assert!(line[..40 - BLEND].iter().all(|s| *s == 0.0) && line[40..].iter().all(|s| *s > 0.99));
            assert!(line.windows(2).all(|w| w[0] <= w[1] && w[1] - w[0] < 0.1));
        }
    }
}
