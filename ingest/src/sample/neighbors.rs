//! Files that continue another one: sheets on the same grid that are adjacent or overlap.
//!
//! Near the edge of a sheet, a kernel needs samples beyond it. If another file of the layer has
//! them on the same grid (same CRS, same pixel size, offset by a whole number of pixels), they are
//! taken from there, as if the sheets were one raster. Otherwise there would be a terrace of the
//! kernel's width along every sheet's border.

use crate::source::Raster;
use crate::store::Rect;

/// Allowed offset from the grid of another file, pixels, because producers round the positions of
/// corners.
const TOLERANCE_PX: f64 = 0.1;

/// A file with samples on the grid of another one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Neighbor {
    /// Its number in the layer.
    pub source: usize,
    /// Its pixels, counted on the grid of the other one.
    pub place: Rect,
}

/// The intersection of two rectangles.
pub(super) fn common(a: Rect, b: Rect) -> Option<Rect> {
    let low = [0, 1].map(|k| a.origin[k].max(b.origin[k]));
    let high = [0, 1].map(|k| (a.origin[k] + a.size[k] as i64).min(b.origin[k] + b.size[k] as i64));
    (0..2).all(|k| low[k] < high[k]).then(|| Rect::new(low, [0, 1].map(|k| (high[k] - low[k]) as usize)))
}

/// Where pixel (0, 0) of `other` lies on the grid of `raster`; `None` when it is on another grid.
fn offset(raster: &Raster, other: &Raster) -> Option<[i64; 2]> {
    if raster.wkt() != other.wkt() {
        return None;
    }
    let inverse = raster.affine().inverse()?;
    let size = other.size().map(|v| v as f64);
    let place = |x: f64, y: f64| {
        let [x, y] = other.affine().apply(x, y);
        inverse.apply(x, y)
    };
    let first = place(0.0, 0.0).map(f64::round);
    let is_on = |x: f64, y: f64| {
        let found = place(x, y);
        (found[0] - first[0] - x).abs() < TOLERANCE_PX && (found[1] - first[1] - y).abs() < TOLERANCE_PX
    };
    // Three corners check size, direction and position of its pixels.
    let is_same = is_on(0.0, 0.0) && is_on(size[0], size[1]) && is_on(size[0], 0.0);
    (is_same && first.iter().all(|v| v.abs() < 1e12)).then(|| first.map(|v| v as i64))
}

/// Pixels around the body, for a raster in degrees that has a whole number of them.
fn turn(raster: &Raster) -> Option<i64> {
    let turn = 360.0 / raster.affine().0[1].abs();
    let is_whole =
        raster.is_geographic() && raster.affine().is_axis_parallel() && (turn - turn.round()).abs() < TOLERANCE_PX;
    is_whole.then_some(turn.round() as i64)
}

/// All files of a layer with pixels at most `reach` away from those of file `index`, in the layer's
/// order, itself among them.
pub(super) fn neighbors<V>(sources: &[(Raster, V)], index: usize, reach: [usize; 2]) -> Vec<Neighbor> {
    let raster = &sources[index].0;
    let own = Rect::new([0, 0], raster.size());
    let around = Rect::new(reach.map(|v| -(v as i64)), [0, 1].map(|k| raster.size()[k] + 2 * reach[k]));
    let shifts: Vec<i64> = turn(raster).map_or(vec![0], |turn| vec![0, -turn, turn]);
    let mut found = Vec::new();
    for (source, (other, _)) in sources.iter().enumerate() {
        let Some([x, y]) = (if source == index { Some([0, 0]) } else { offset(raster, other) }) else { continue };
        let places = shifts.iter().map(|shift| Rect::new([x + shift, y], other.size()));
        found.extend(
            places
                .filter(|place| (source == index && *place == own) || common(*place, around).is_some())
                .map(|place| Neighbor { source, place }),
        );
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::Affine;

    fn raster(origin: [f64; 2], size: [usize; 2], pixel: f64, is_geographic: bool) -> (Raster, ()) {
        let affine = Affine([origin[0], pixel, 0.0, origin[1], 0.0, -pixel]);
        (Raster::without_file(size, affine, is_geographic), ())
    }

    #[test]
    fn files_of_one_grid_that_touch_are_neighbors() {
        let west = raster([500.0, 900.0], [10, 20], 10.0, false);
        // Rounded as producers do, and at the corner.
        let east = raster([600.02, 900.0], [10, 20], 10.0, false);
        let corner = raster([600.0, 700.0], [5, 5], 10.0, false);
        let far = raster([900.0, 900.0], [5, 5], 10.0, false);
        let half_off = raster([605.0, 900.0], [5, 5], 10.0, false);
        let finer = raster([600.0, 900.0], [5, 5], 5.0, false);
        let all = [west, east, corner, far, half_off, finer];
        let found = neighbors(&all, 0, [3, 3]);
        let place = |origin, size| Rect::new(origin, size);
        let expected = [(0, place([0, 0], [10, 20])), (1, place([10, 0], [10, 20])), (2, place([10, 20], [5, 5]))];
        assert_eq!(found, expected.map(|(source, place)| Neighbor { source, place }));
        assert_eq!(neighbors(&all, 5, [3, 3]).len(), 1);
    }

    #[test]
    fn the_globe_continues_where_it_ends() {
        let globe = raster([-180.0, 90.0], [360, 180], 1.0, true);
        let places: Vec<_> = neighbors(&[globe], 0, [4, 4]).iter().map(|n| n.place.origin[0]).collect();
        assert_eq!(places, [0, -360, 360]);
        let part = raster([0.0, 60.0], [20, 20], 1.0, true);
        assert_eq!(neighbors(&[part], 0, [4, 4]).len(), 1);
    }
}
