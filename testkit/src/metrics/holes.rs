//! Background seen through the ground.

use super::quality::eroded;
use crate::reference::Picture;

/// Pixels of the colour of the sky where there is no sky.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Holes {
    /// Sky pixels of the picture where the reference sees land, `tolerance` pixels or more away
    /// from any of its sky.
    pub count: usize,
    /// The first of them, column and row.
    pub first: Option<[usize; 2]>,
    /// Pixels that were looked at.
    pub looked_at: usize,
}

/// Counts pixels that are sky where the exact ray caster sees land. Facets move a silhouette, a
/// needle's by its whole height; so pixels count only when they are farther than `tolerance_px` (a
/// square's radius) from all sky and all partly covered pixels of the reference, and when no path
/// through sky leads to such a pixel: a hole has ground all around.
#[must_use]
pub fn count_holes(is_sky: &[bool], reference: &Picture, tolerance_px: usize) -> Holes {
    // Beyond the picture's border nothing is known of the ground; the mask is extended by itself
    // there.
    let (width, height) = (reference.width, reference.height);
    let (wide, high) = (width + 2 * tolerance_px, height + 2 * tolerance_px);
    let mut mask = vec![false; wide * high];
    for y in 0..high {
        for x in 0..wide {
            let inside = |v: usize, n: usize| v.saturating_sub(tolerance_px).min(n - 1);
            mask[y * wide + x] = reference.is_land[inside(y, height) * width + inside(x, width)];
        }
    }
    let ground = eroded(wide, &mask, tolerance_px);
    let open_sky = open_sky(is_sky, reference);
    let mut holes = Holes { count: 0, first: None, looked_at: 0 };
    for y in 0..height {
        for x in 0..width {
            if !ground[(y + tolerance_px) * wide + x + tolerance_px] {
                continue;
            }
            holes.looked_at += 1;
            if is_sky[y * width + x] && !open_sky[y * width + x] {
                holes.count += 1;
                holes.first.get_or_insert([x, y]);
            }
        }
    }
    holes
}

/// Sky pixels of the picture that hang together (eight neighbours) with the reference's sky.
fn open_sky(is_sky: &[bool], reference: &Picture) -> Vec<bool> {
    let (width, height) = (reference.width, reference.height);
    let mut is_open = vec![false; width * height];
    let mut stack: Vec<usize> = (0..width * height).filter(|k| !reference.is_land[*k] && is_sky[*k]).collect();
    stack.iter().for_each(|k| is_open[*k] = true);
    while let Some(at) = stack.pop() {
        let (x, y) = (at % width, at / width);
        for v in y.saturating_sub(1)..height.min(y + 2) {
            for u in x.saturating_sub(1)..width.min(x + 2) {
                let next = v * width + u;
                if is_sky[next] && !is_open[next] {
                    is_open[next] = true;
                    stack.push(next);
                }
            }
        }
    }
    is_open
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sky_below_the_horizon_counts_and_sky_at_the_horizon_does_not() {
        let (width, height) = (32, 24);
        let is_land: Vec<bool> = (0..width * height).map(|k| k / width >= 10).collect();
        let reference = Picture {
            width,
            height,
            rgb: Vec::new(),
            is_sky: is_land.iter().map(|land| !land).collect(),
            is_land,
            depth: Vec::new(),
            ground: Vec::new(),
        };
        let mut is_sky: Vec<bool> = (0..width * height).map(|k| k / width < 11).collect();
        assert_eq!(count_holes(&is_sky, &reference, 2).count, 0);
        is_sky[23 * width] = true;
        is_sky[15 * width + 7] = true;
        let holes = count_holes(&is_sky, &reference, 2);
        assert_eq!((holes.count, holes.first, holes.looked_at), (2, Some([7, 15]), width * 12));
    }
}
