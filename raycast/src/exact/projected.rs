//! Posts of tiles projected into the picture: once a frame, for all columns of pixels that follow
//! the ground over them.

use crate::model::Tile;
use crate::scene::{Placed, Scene};
use crate::workers::Workers;
use glam::{Vec2, Vec4};

/// Posts nearer to the eye along the view axis than this, metres, are not projected: a millimetre,
/// the rounding of heights.
const NEAREST_M: f32 = 1e-3;
/// A post that is not projected.
const NOWHERE: [f32; 4] = [f32::NAN; 4];

/// The posts of all tiles.
#[derive(Debug, Default)]
pub(crate) struct Projected {
    /// Column and row in pixels from the centre of the upper left one, one over depth, and height
    /// above the datum; each tile has a border of posts that are not projected.
    posts: Vec<[f32; 4]>,
    /// For each tile the index of its first post, and posts per row; the last entry is the end of
    /// all.
    tiles: Vec<(usize, usize)>,
}

/// A tile's posts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Posts<'a> {
    posts: &'a [[f32; 4]],
    stride: usize,
}

impl<'a> Posts<'a> {
    #[inline(always)]
    pub(crate) fn get(&self, post: usize) -> Option<&'a [f32; 4]> {
        self.posts.get(post)
    }

    /// Column, row, one over depth, height.
    #[inline(always)]
    pub(crate) fn place(&self, post: usize) -> &'a [f32; 4] {
        self.posts.get(post).unwrap_or(&NOWHERE)
    }

    #[inline(always)]
    pub(crate) fn height(&self, post: usize) -> f32 {
        self.place(post)[3]
    }

    /// The index of the post at a column and row of the tile; `None` beyond the border of posts
    /// around it.
    #[inline(always)]
    pub(crate) fn index(&self, [i, j]: [i32; 2]) -> Option<usize> {
        let [i, j] = [usize::try_from(i + 1).ok()?, usize::try_from(j + 1).ok()?];
        (i < self.stride).then_some(j * self.stride + i)
    }

    /// The column and row of a post.
    #[inline(always)]
    pub(crate) fn cell(&self, post: usize) -> [i32; 2] {
        [(post % self.stride) as i32 - 1, (post / self.stride) as i32 - 1]
    }

    /// The number of the facet of three posts: twice the number of the south western one, plus 1
    /// for the south eastern half of a cell.
    #[inline(always)]
    pub(crate) fn facet(&self, [a, b, c]: [usize; 3]) -> usize {
        let (first, last) = (a.min(b).min(c), a.max(b).max(c));
        let middle = a.wrapping_add(b).wrapping_add(c).wrapping_sub(first).wrapping_sub(last);
        2 * first + usize::from(middle == first + 1)
    }

    /// Metres up per cell east and north on a facet.
    #[inline(always)]
    pub(crate) fn slope(&self, facet: usize) -> Vec2 {
        let first = facet / 2;
        let is_south_east = !facet.is_multiple_of(2);
        let middle = first + if is_south_east { 1 } else { self.stride };
        let [first_m, middle_m, last_m] = [first, middle, first + self.stride + 1].map(|post| self.height(post));
        let (rise, further) = (middle_m - first_m, last_m - middle_m);
        if is_south_east { Vec2::new(rise, further) } else { Vec2::new(further, rise) }
    }
}

impl Projected {
    /// Projects the posts of all tiles.
    pub(crate) fn set(&mut self, scene: &Scene<'_>, workers: &Workers) {
        let ground = scene.ground;
        self.tiles.clear();
        let mut end = 0;
        for tile in ground.tiles() {
            let [columns, rows] = tile.posts();
            self.tiles.push((end, columns + 2));
            end += (columns + 2) * (rows + 2);
        }
        self.tiles.push((end, 0));
        if self.posts.len() < end {
            self.posts.resize(end, NOWHERE);
        }
        let (tiles, posts) = (&self.tiles, &mut self.posts[..end]);
        workers.split(ground.tile_count(), posts, &|tile| tiles[tile].0, &|range, mut posts| {
            for tile in range {
                let (own, rest) = posts.split_at_mut(tiles[tile + 1].0 - tiles[tile].0);
                posts = rest;
                project(scene, &ground.tiles()[tile], &scene.placed[tile], own);
            }
        });
    }

    /// The posts of a tile.
    #[inline(always)]
    pub(crate) fn of(&self, tile: u32) -> Posts<'_> {
        let ((start, stride), end) = match self.tiles.get(tile as usize..tile as usize + 2) {
            Some(&[first, next]) => (first, next.0),
            _ => ((0, 1), 0),
        };
        Posts { posts: &self.posts[start..end], stride }
    }
}

/// Projects the posts of a tile.
fn project(scene: &Scene<'_>, tile: &Tile, placed: &Placed, out: &mut [[f32; 4]]) {
    let [columns, _] = tile.posts();
    let stride = columns + 2;
    // Not for cells that reach beyond the border.
    let extent = scene.ground.shape().surface.extent();
    let inside = [0, 1].map(|axis| (extent[axis].saturating_sub(tile.origin[axis]) >> tile.log_spacing) as usize + 1);
    let [column, row, depth] = scene.view.inverse();
    let of = |axis: usize| Vec4::new(column[axis], row[axis], depth[axis], 0.0);
    let (east, north, up) = (of(0) * tile.spacing_m, of(1) * tile.spacing_m, of(2));
    let corner = of(0) * placed.corner.x + of(1) * placed.corner.y - up * scene.eye_height + Vec4::W;
    let heights = scene.ground.heights(tile).chunks_exact(columns);
    let (first, rest) = out.split_at_mut(stride);
    first.fill(NOWHERE);
    let mut rows = rest.chunks_exact_mut(stride);
    for ((j, heights), out) in heights.enumerate().take(inside[1]).zip(&mut rows) {
        let west = corner + north * j as f32;
        out.fill(NOWHERE);
        for ((i, height), out) in heights.iter().enumerate().take(inside[0]).zip(&mut out[1..]) {
            let at = west + east * i as f32 + up * *height;
            let depth = if at.z > NEAREST_M { at.z } else { f32::NAN };
            let at = at / depth;
            *out = [at.x, at.y, at.w, *height];
        }
    }
    rows.for_each(|out| out.fill(NOWHERE));
}
