//! Colour tiles are lit when they are loaded: each texel gets the light that falls on the ground
//! there. Whatever draws them then draws lit ground, at no cost a frame.
//!
//! * [`elevations`] has the elevation tiles, [`window`] the heights of a rectangle of posts out of
//!   them, [`shadows`] the posts that the sun shines on.
//! * A texel's light is that of the elevation level whose posts are as far apart as the tile's
//!   texels, or of the finest one: levels of colour are lit as their ground is, so that light is as
//!   fine as colour, and neither flickers nor jumps between levels (docs/light.md has how much).

pub mod elevations;
pub mod shadows;
#[cfg(test)]
mod tests;
pub mod window;

use elevations::Elevations;
use shadows::{Rays, ShadowScratch, find_shadows};
use terravision_common::light::{Brightness, LightConfig};
use terravision_common::node::NodeId;
use terravision_common::tint::HeightColors;
use terravision_common::world::{COLOR_BORDER, World};
use window::{Rect, Window};

/// How colour tiles of a world are lit.
#[derive(Debug, Clone, Copy)]
pub struct Lighting {
    world: World,
    brightness: Brightness,
    /// Direction to the sun: east, north, up.
    sun: [f32; 3],
    rays: Option<Rays>,
    /// On all heights.
    factor: f32,
    /// Colours in place of those of tiles.
    tint: Option<HeightColors>,
}

/// Buffers of a thread that lights tiles.
#[derive(Debug, Default)]
pub struct LightScratch {
    heights: Window,
    seen: Window,
    shadows: ShadowScratch,
    row: RowOfPosts,
    columns: Vec<Place>,
}

/// What the ground is along a row of texels, at each column of posts.
#[derive(Debug, Default)]
struct RowOfPosts {
    /// Slopes; where a texel is a cell of posts, those of the cell behind each post.
    east: Vec<f32>,
    north: Vec<f32>,
    is_by_cell: bool,
    /// Share of the sun that is seen.
    sun: Vec<f32>,
    /// Heights.
    up: Vec<f32>,
}

/// Where texels lie between two posts along an axis.
#[derive(Debug, Clone, Copy)]
struct Place {
    /// The post before.
    post: i64,
    /// How far behind it, posts.
    share: f32,
}

impl Place {
    /// Between two of a row of numbers of posts, the first one's of the post `first`.
    fn of(self, row: &[f32], first: i64) -> f32 {
        let at = (self.post - first) as usize;
        row[at] + self.share * (row[at + 1] - row[at])
    }
}

impl Lighting {
    /// Light as `config` has it, on heights that are drawn `exaggeration` times as high.
    #[must_use]
    pub fn new(world: &World, config: &LightConfig, exaggeration: f64) -> Self {
        let brightness = config.sun.brightness();
        let sun = config.sun.direction();
        let is_sunny = brightness.direct.iter().any(|direct| *direct > 0.0);
        Self {
            world: *world,
            brightness,
            sun: sun.map(|v| v as f32),
            rays: Rays::towards(sun).filter(|_| config.has_shadows && is_sunny),
            // Without heights there is nothing to color by.
            tint: config.tint.filter(|_| exaggeration * config.relief > 0.0),
            factor: (exaggeration * config.relief) as f32,
        }
    }

    /// The elevation level that lights colour tiles of level `q`.
    #[must_use]
    pub fn level(&self, q: u8) -> u8 {
        let wanted = i32::from(q) - self.world.elevation_over_color_levels();
        wanted.clamp(i32::from(self.world.finest_elevation_level()), i32::from(self.world.root().q())) as u8
    }

    /// Lights the texels of a node, RGBA8 with their border, row 0 in the north.
    pub fn light(&self, node: NodeId, texels: &mut [u8], tiles: &dyn Elevations, scratch: &mut LightScratch) {
        let (world, level) = (&self.world, self.level(node.q()));
        let stored = i64::from(world.color_stored());
        let per_texel = world.color_spacing_m(node.q()) / world.elevation_spacing_m(level);
        let place = |axis: usize, texel: i64| {
            let origin = world.node_origin(node)[axis] as f64 / f64::from(1u32 << level);
            let at = origin + (texel as f64 + 0.5 - f64::from(COLOR_BORDER)) * per_texel;
            Place { post: at.floor() as i64, share: (at - at.floor()) as f32 }
        };
        // The posts around all texels, and one more for their slopes.
        let first = [0, 1].map(|axis| place(axis, 0).post);
        let last = [0, 1].map(|axis| place(axis, stored - 1).post + 1);
        let lit = Rect::between(first, last);
        let LightScratch { heights, seen, shadows, row: posts, columns } = scratch;
        heights.read(world, tiles, level, Rect::between(first.map(|at| at - 1), last.map(|at| at + 1)), self.factor);
        if let Some(rays) = &self.rays {
            find_shadows(rays, (world, tiles), level, (heights, self.factor), lit, shadows, seen);
        }
        columns.clear();
        columns.extend((0..stored).map(|texel| place(0, texel)));
        // A texel as large as a cell has the cell's own slope; smaller ones lie between those of posts.
        posts.is_by_cell = per_texel >= 1.0;
        let per_m = (0.5 / world.elevation_spacing_m(level)) as f32;
        for (row, out) in texels.chunks_exact_mut(4 * stored as usize).take(stored as usize).enumerate() {
            let at = place(1, stored - 1 - row as i64);
            self.find_slopes(heights, seen, lit, at, per_m, posts);
            if let Some(tint) = &self.tint {
                self.tint_row(tint, columns, &posts.up, out);
            }
            self.light_row(columns, posts, out);
        }
    }

    /// What the ground is between two rows of posts.
    fn find_slopes(
        &self,
        heights: &Window,
        seen: &Window,
        lit: Rect,
        Place { post, share }: Place,
        per_m: f32,
        out: &mut RowOfPosts,
    ) {
        let RowOfPosts { east, north, sun, up, is_by_cell } = out;
        let (column, count) = (lit.first[0], lit.size[0]);
        let [below, here, next, above] = [-1, 0, 1, 2].map(|by| &heights.row(column - 1, post + by)[..count + 2]);
        let between = |a: f32, b: f32| a + share * (b - a);
        for row in [&mut *east, north, sun, up] {
            row.clear();
        }
        if *is_by_cell {
            east.extend((1..=count).map(|k| per_m * (here[k + 1] - here[k] + (next[k + 1] - next[k]))));
            north.extend((1..=count).map(|k| per_m * (next[k] - here[k] + (next[k + 1] - here[k + 1]))));
        } else {
            east.extend((0..count).map(|k| per_m * between(here[k + 2] - here[k], next[k + 2] - next[k])));
            north.extend((1..=count).map(|k| per_m * between(next[k] - below[k], above[k] - here[k])));
        }
        up.extend((1..=count).map(|k| between(here[k], next[k])));
        if self.rays.is_some() {
            let [south, north] = [0, 1].map(|by| seen.row(column, post + by));
            sun.extend(south.iter().zip(north).map(|(a, b)| between(*a, *b)));
        } else {
            sun.resize(count, 1.0);
        }
    }

    fn light_row(&self, columns: &[Place], posts: &RowOfPosts, texels: &mut [u8]) {
        let Some(first) = columns.first().map(|place| place.post) else { return };
        let RowOfPosts { east, north, sun, is_by_cell, .. } = posts;
        for (texel, place) in texels.chunks_exact_mut(4).zip(columns) {
            let slopes = Place { share: if *is_by_cell { 0.0 } else { place.share }, ..*place };
            let falls = self.facing(slopes.of(east, first), slopes.of(north, first)) * place.of(sun, first);
            for (channel, value) in texel[..3].iter_mut().enumerate() {
                let factor = self.brightness.ambient[channel] + self.brightness.direct[channel] * falls;
                *value = (f32::from(*value) * factor + 0.5) as u8;
            }
        }
    }

    /// Colours a row of texels by height.
    fn tint_row(&self, tint: &HeightColors, columns: &[Place], heights: &[f32], texels: &mut [u8]) {
        let Some(first) = columns.first().map(|place| place.post) else { return };
        for (texel, place) in texels.chunks_exact_mut(4).zip(columns) {
            let color = tint.color(place.of(heights, first) / self.factor);
            texel.iter_mut().zip(color).for_each(|(to, value)| *to = (value + 0.5) as u8);
        }
    }

    /// How squarely the sun's light falls on ground with these slopes: the cosine of its angle to
    /// the normal, 0 from behind.
    fn facing(&self, east: f32, north: f32) -> f32 {
        let [x, y, z] = self.sun;
        let along = z - east * x - north * y;
        if along > 0.0 { along / (1.0 + east * east + north * north).sqrt() } else { 0.0 }
    }
}
