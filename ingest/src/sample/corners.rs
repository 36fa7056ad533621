//! The outer corners of files. Ground without data that is connected to one of them is the rim left
//! by warping or rotating; other ground without data is a gap, even if it reaches a side of a file.
//!
//! A corner is an outer one if no file lies diagonally beyond it nor beside it on either side. So a
//! gap where sheets meet stays a gap. Of a file that was cropped the world's corners take the place
//! of its own.

use super::elevation::is_outside;
use crate::error::IngestError;
use crate::plan::Plan;
use crate::source::{Raster, TargetCrs};
use crate::store::{Level, Rect};
use gdal::spatial_ref::CoordTransform;
use std::collections::BTreeSet;
use std::path::Path;

/// How far beyond a corner to look for other files: pixels, or posts if their distance is larger.
const BEYOND: f64 = 2.0;

/// A post by its column and row.
pub(crate) type Post = [u64; 2];

/// The posts of the finest level that lie at outer corners of files. `heights` tells which posts
/// lie in a file at all.
///
/// # Errors
/// [`IngestError`].
pub(crate) fn outer_corners<V>(
    plan: &Plan,
    target: &TargetCrs,
    sources: &[(Raster, V)],
    heights: &Level<f32>,
    folder: &Path,
) -> Result<BTreeSet<Post>, IngestError> {
    let mut posts = BTreeSet::new();
    let last = heights.size().map(|n| n - 1);
    for ((raster, _), bounds) in sources.iter().zip(&plan.elevation_bounds) {
        if raster.crop().is_some() {
            posts.extend([[0, 0], [last[0], 0], [0, last[1]], last]);
            continue;
        }
        let beyond = BEYOND * (plan.elevation.step / bounds.pixel).max(1.0);
        let places = places_in_world(raster, target, &corner_pixels(raster, beyond))?;
        let near = |[x, y]: [f64; 2]| {
            let at = [x, y].into_iter().zip(plan.elevation.first).map(|(v, first)| (v - first) / plan.elevation.step);
            let at: Vec<f64> = at.map(f64::round).collect();
            // Not finite where the point cannot be transformed; large enough to include the
            // neighbours of a post.
            at.iter().all(|v| v.abs() < 1e15).then(|| [at[0] as i64, at[1] as i64])
        };
        for corner in places.chunks_exact(4) {
            let mut is_outer = true;
            for post in corner[1..].iter().filter_map(|place| near(*place)).filter_map(|at| inside(at, last)) {
                let height = heights.read(Rect::new(post.map(|v| v as i64), [1, 1]));
                let height = height.map_err(|source| IngestError::Output { source, path: folder.to_owned() })?;
                is_outer &= is_outside(height[0]);
            }
            if let Some([x, y]) = near(corner[0]).filter(|_| is_outer) {
                let around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| [x + dx, y + dy]));
                posts.extend(around.filter_map(|at| inside(at, last)));
            }
        }
    }
    Ok(posts)
}

fn inside(at: [i64; 2], last: Post) -> Option<Post> {
    (0..2).all(|k| (0..=last[k] as i64).contains(&at[k])).then(|| at.map(|v| v as u64))
}

/// Four pixel positions for each corner of a raster: the centre of its pixel, diagonally beyond it,
/// and beside it on both sides.
fn corner_pixels(raster: &Raster, beyond: f64) -> Vec<[f64; 2]> {
    let [width, height] = raster.size().map(|v| v as f64);
    let corners = [([0.0, 0.0], [1.0, 1.0]), ([width, 0.0], [-1.0, 1.0]), ([0.0, height], [1.0, -1.0])];
    let corners = corners.into_iter().chain([([width, height], [-1.0, -1.0])]);
    corners
        .flat_map(|(corner, inwards)| {
            [[0.5, 0.5], [-beyond, -beyond], [-beyond, beyond], [beyond, -beyond]]
                .map(|by| [0, 1].map(|k| corner[k] + by[k] * inwards[k]))
        })
        .collect()
}

/// Easting and northing of pixel positions in the world's CRS; not finite where they cannot be
/// transformed.
fn places_in_world(raster: &Raster, target: &TargetCrs, pixels: &[[f64; 2]]) -> Result<Vec<[f64; 2]>, IngestError> {
    let (mut x, mut y): (Vec<f64>, Vec<f64>) =
        pixels.iter().map(|[column, row]| raster.affine().apply(*column, *row)).map(|[x, y]| (x, y)).unzip();
    if !target.is_of(raster) {
        let transform = CoordTransform::new(&raster.srs()?, &target.srs()?);
        let transform = transform.map_err(|e| raster.fails("cannot be brought to the world's CRS", &e))?;
        // Points that cannot be transformed come back infinite.
        transform.transform_coords(&mut x, &mut y, &mut []).ok();
    }
    Ok(x.into_iter().zip(y).map(|(x, y)| [x, y]).collect())
}
