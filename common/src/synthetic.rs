//! A terrain that is computed instead of stored: for tests and benches, of any size, without files.
//!
//! Heights are a sum of octaves of value noise. A coarser level omits the octaves that its posts
//! cannot represent, like the low-pass filtered pyramid of a real database. Every height is a
//! multiple of 1/128 m.

use crate::database::{NodeRanges, RangesError, TileError, TileScratch, TileSource, color_tile_bytes};
use crate::node::NodeId;
use crate::traversal::HeightRanges;
use crate::world::World;

/// The kind of terrain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Relief {
    /// Ridges and valleys, the highest this many metres above the lowest.
    Mountains {
        /// Metres.
        height_m: f64,
    },
    /// Every post of every level is independent of all others: the worst case for interpolation.
    Static {
        /// Metres.
        height_m: f64,
    },
}

/// A terrain that is computed instead of stored.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SyntheticTerrain {
    world: World,
    relief: Relief,
    seed: u64,
}

/// Wavelength of the longest octave, log2 of lattice units: 10 km at 10 m.
const LONGEST: u32 = 10;
/// Each octave has this share of the amplitude of the one twice as long.
const ROUGHNESS: f64 = 0.48;

impl SyntheticTerrain {
    /// The terrain of a world; another seed gives another one.
    #[must_use]
    pub fn new(world: &World, relief: Relief, seed: u64) -> Self {
        Self { world: *world, relief, seed }
    }

    /// The world.
    #[must_use]
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Height of the post of level `q` in this column and row of the level's posts, metres.
    #[must_use]
    pub fn post(&self, q: u8, column: u64, row: u64) -> f32 {
        let height = match self.relief {
            Relief::Static { height_m } => height_m * unit_hash(self.seed, u64::from(q), column, row),
            Relief::Mountains { height_m } => {
                let (x, y) = (column << q, row << q);
                // Two posts per wavelength: the shortest octave that level q holds.
                let shortest = (u32::from(q) + 1).min(LONGEST);
                let octaves = shortest..=LONGEST;
                let amplitude = |octave: u32| ROUGHNESS.powi((LONGEST - octave).cast_signed());
                let sum: f64 = octaves.map(|octave| amplitude(octave) * ridge(self.noise(octave, x, y))).sum();
                height_m * sum * (1.0 - ROUGHNESS)
            }
        };
        ((height * 128.0).round() / 128.0) as f32
    }

    /// Smooth noise in [0, 1].
    fn noise(&self, octave: u32, x: u64, y: u64) -> f64 {
        let (m, n) = (x >> octave, y >> octave);
        let ease = |at: u64, from: u64| {
            let t = (at - (from << octave)) as f64 / (1u64 << octave) as f64;
            t * t * (3.0 - 2.0 * t)
        };
        let (u, v) = (ease(x, m), ease(y, n));
        let at = |m, n| unit_hash(self.seed, u64::from(octave) + 100, m, n);
        let south = at(m, n) + u * (at(m + 1, n) - at(m, n));
        let north = at(m, n + 1) + u * (at(m + 1, n + 1) - at(m, n + 1));
        south + v * (north - south)
    }

    /// Exact ranges of all nodes, as in a database. Computes every post, so use it for worlds of up
    /// to some thousand posts a side.
    ///
    /// # Errors
    /// None for a valid world.
    pub fn ranges(&self) -> Result<NodeRanges, RangesError> {
        let mut levels: Vec<Vec<[f32; 2]>> = Vec::new();
        for q in 0..self.world.levels() {
            let [columns, rows] = self.world.nodes_at(q);
            let mut ranges = Vec::new();
            for (n, m) in (0..rows).flat_map(|n| (0..columns).map(move |m| (n, m))) {
                let Some(node) = NodeId::new(m, n, q) else { continue };
                let mut range = [f32::INFINITY, f32::NEG_INFINITY];
                for level in q..self.world.levels() {
                    range = union(range, self.posts_over(node, level));
                }
                if let Some(finer) = levels.last() {
                    let finer_columns = self.world.nodes_at(q - 1)[0];
                    for child in (0..4).filter_map(|i| node.child(i)).filter(|c| self.world.contains(*c)) {
                        range = union(range, finer[child.n() as usize * finer_columns as usize + child.m() as usize]);
                    }
                }
                ranges.push(range);
            }
            levels.push(ranges);
        }
        // A child's range includes the ancestors' posts over its own area only, that of its parent
        // those over all of it: so ranges are nested.
        NodeRanges::from_parts(&self.world, levels)
    }

    /// Range of the posts of a level over the closed area of a node, whole cells.
    fn posts_over(&self, node: NodeId, level: u8) -> [f32; 2] {
        let origin = self.world.node_origin(node);
        let side = self.world.node_side(node.q());
        let range = |axis: usize| {
            let end = (origin[axis] + side).min(u64::from(self.world.extent()[axis]));
            origin[axis] >> level..=end.div_ceil(1 << level)
        };
        let mut found = [f32::INFINITY, f32::NEG_INFINITY];
        for row in range(1) {
            for column in range(0) {
                let z = self.post(level, column, row);
                found = union(found, [z, z]);
            }
        }
        found
    }
}

fn union(a: [f32; 2], b: [f32; 2]) -> [f32; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

/// Folds noise so that its middle becomes a sharp crest.
fn ridge(noise: f64) -> f64 {
    1.0 - (2.0 * noise - 1.0).abs()
}

/// A number in [0, 1) that is a function of its arguments: splitmix64's finalizer (Steele, Lea,
/// Flood 2014).
fn unit_hash(seed: u64, a: u64, b: u64, c: u64) -> f64 {
    let mut h = seed;
    for value in [a, b, c] {
        h = (h ^ value).wrapping_add(0x9e37_79b9_7f4a_7c15);
        h = (h ^ (h >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        h = (h ^ (h >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        h ^= h >> 31;
    }
    (h >> 11) as f64 / (1u64 << 53) as f64
}

/// A colour that identifies a node among its neighbours, of its own level and of the seven levels
/// above and below. Test worlds are painted with it, so that a picture shows the tile of each
/// texel. Colours differ by 24 or more in one channel, so that they survive compression.
#[must_use]
pub fn name_color(node: NodeId) -> [u8; 3] {
    let [q, m, n] = [u32::from(node.q()) % 8, node.m() % 4, node.n() % 4];
    [40 + 24 * q, 40 + 48 * m, 40 + 48 * n].map(|channel| channel as u8)
}

impl TileSource for SyntheticTerrain {
    fn read_elevation(&self, node: NodeId, out: &mut [f32], _scratch: &mut TileScratch) -> Result<(), TileError> {
        let (cells, posts) = (u64::from(self.world.elevation_tile()), self.world.elevation_posts() as usize);
        for (j, row) in (0u64..).zip(out.chunks_exact_mut(posts).take(posts)) {
            for (i, z) in (0u64..).zip(row) {
                *z = self.post(node.q(), u64::from(node.m()) * cells + i, u64::from(node.n()) * cells + j);
            }
        }
        Ok(())
    }

    fn read_color(&self, node: NodeId, out: &mut [u8], _scratch: &mut TileScratch) -> Result<(), TileError> {
        // One colour per node, which distinguishes nodes and levels.
        let hash = unit_hash(self.seed, 7, u64::from(node.q()), node.pack());
        let rgba = [(hash * 256.0) as u8, (hash * 65536.0) as u8, 20 * node.q() % 250, 255];
        for texel in out[..color_tile_bytes(&self.world)].chunks_exact_mut(4) {
            texel.copy_from_slice(&rgba);
        }
        Ok(())
    }
}

/// Ranges of a [`SyntheticTerrain`] of any size, without computing posts: the whole relief for
/// every node. The tree is then the same wherever the eye is, as comparisons between databases of
/// several sizes need.
impl HeightRanges for SyntheticTerrain {
    fn range(&self, node: NodeId) -> Option<[f32; 2]> {
        let (Relief::Mountains { height_m } | Relief::Static { height_m }) = self.relief;
        self.world.contains(node).then_some([0.0, height_m as f32])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::WorldFields;

    fn terrain(relief: Relief) -> SyntheticTerrain {
        let world = World::new(WorldFields {
            origin: [0.0; 2],
            lattice_unit_m: 10.0,
            extent: [100, 77],
            elevation_tile: 8,
            color_tile: 16,
            levels: 5,
            finest_elevation_level: 0,
            finest_color_level: 0,
            body: None,
        })
        .expect("valid");
        SyntheticTerrain::new(&world, relief, 3)
    }

    #[test]
    fn ranges_hold_the_posts_of_every_level_and_nest() {
        for relief in [Relief::Mountains { height_m: 900.0 }, Relief::Static { height_m: 900.0 }] {
            let terrain = terrain(relief);
            let ranges = terrain.ranges().expect("valid");
            for (m, n) in (0..13).flat_map(|m| (0..10).map(move |n| (m, n))) {
                let finest = NodeId::new(m, n, 0).expect("in range");
                let range = ranges.range(finest).expect("exists");
                for q in 0..5u8 {
                    let (x, y) = ((u64::from(m) * 8) >> q, (u64::from(n) * 8) >> q);
                    let z = terrain.post(q, x, y);
                    assert!(range[0] <= z && z <= range[1]);
                    assert!((z * 128.0).fract() == 0.0 && (0.0..=900.0).contains(&z));
                    let above = ranges.range(finest.ancestor(q)).expect("exists");
                    assert!(above[0] <= range[0] && range[1] <= above[1]);
                }
            }
        }
    }

    #[test]
    fn neighbouring_tiles_share_their_border() {
        let terrain = terrain(Relief::Mountains { height_m: 900.0 });
        let (mut a, mut b) = (vec![0.0; 81], vec![0.0; 81]);
        let mut scratch = TileScratch::default();
        let mut read = |m, out: &mut [f32]| {
            terrain.read_elevation(NodeId::new(m, 1, 1).expect("in range"), out, &mut scratch).expect("always")
        };
        read(0, &mut a);
        read(1, &mut b);
        for row in 0..9 {
            assert_eq!(a[row * 9 + 8], b[row * 9]);
        }
    }
}
