//! Sparse worlds for tests: a detailed square in the south west of a plain of any size, at almost
//! no cost on disk, because all tiles of the plain are identical.
//!
//! The detailed square is the same in worlds of every size, level by level: only its surroundings
//! grow.
//!
//! Or, for load tests, worlds without a plain and with many bytes ([`SparseOptions::is_bulk`]).

use crate::archive::{self, ArchiveInfo, Tile, TilePlace};
use crate::bulk::Bulk;
use crate::error::IngestError;
use crate::job::{finish_database, record_of};
use crate::plan::{Lattice, Plan};
use crate::sample::elevation::quantized;
use crate::source::TargetCrs;
use crate::source::crs;
use crate::store::Rgb;
use crate::synth::noise::{octaves, smoothstep};
use crate::work::Work;
use pmtiles::TileType;
use std::io;
use std::path::Path;
use terravision_common::database::{Manifest, NodeRanges, encode_elevation_tile};
use terravision_common::node::NodeId;
use terravision_common::synthetic::name_color;
use terravision_common::world::{COLOR_BORDER, World, WorldFields};

/// A sparse world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SparseOptions {
    /// Level 0 nodes along a side of the detailed square.
    pub detailed_nodes: u32,
    /// How often the side is doubled: 0 is the square alone, 2 is 16 times its area, 4 is 256
    /// times.
    pub doublings: u8,
    /// Every colour tile, also of the plain, has the one colour that names its node
    /// ([`name_color`]).
    pub is_named: bool,
    /// Instead of a square in a plain, terrain and colours everywhere that take many bytes and
    /// little time.
    pub is_bulk: bool,
    /// Texels of the finest colours along the distance of two posts, a power of two.
    pub texels_per_post: u32,
}

impl Default for SparseOptions {
    /// A square of 32 nodes, nothing around it.
    fn default() -> Self {
        Self { detailed_nodes: 32, doublings: 0, is_named: false, is_bulk: false, texels_per_post: 2 }
    }
}

/// Colour of the plain.
const PLAIN: Rgb = [112, 124, 84];
/// Heights of the plain and of the detailed square's relief, metres.
const PLAIN_M: f32 = 200.0;
const RELIEF_M: f32 = 900.0;
/// Octaves of noise in relief and colour.
const OCTAVES: u32 = 4;
/// Of JPEG.
const QUALITY: u8 = 90;
/// Many small tiles are harder to load and to keep than few large ones.
const ELEVATION_TILE: u32 = 16;
const COLOR_TILE: u32 = 256;
/// Distance of posts, metres.
const SPACING_M: f64 = 10.0;

/// The content: functions of position in lattice units.
#[derive(Debug, Clone)]
struct Content {
    /// Side of the detailed square, lattice units.
    side: f64,
    bulk: Option<Bulk>,
}

impl Content {
    /// 1 well inside the detailed square, 0 outside.
    fn detail(&self, x: f64, y: f64) -> f32 {
        let rim = |v: f64| {
            let v = (v / self.side) as f32;
            smoothstep(0.0, 0.2, v) * (1.0 - smoothstep(0.8, 1.0, v))
        };
        rim(x) * rim(y)
    }

    fn height(&self, x: f64, y: f64) -> f32 {
        if let Some(bulk) = &self.bulk {
            return bulk.height(x, y);
        }
        match self.detail(x, y) {
            detail if detail > 0.0 => {
                quantized(PLAIN_M + detail * RELIEF_M * (0.5 + 0.5 * octaves(x / 150.0, y / 150.0, 7, OCTAVES)))
            }
            _ => PLAIN_M,
        }
    }

    fn color(&self, x: f64, y: f64) -> Rgb {
        let detail = self.detail(x, y);
        if detail == 0.0 {
            return PLAIN;
        }
        let tone = octaves(x / 40.0, y / 40.0, 8, OCTAVES);
        [0, 1, 2].map(|c| (f32::from(PLAIN[c]) + detail * (60.0 * tone + 12.0 * c as f32)).clamp(0.0, 255.0) as u8)
    }

    /// Whether anything of the rectangle is in the detailed square.
    fn touches(&self, low: [f64; 2]) -> bool {
        low.iter().all(|v| *v < self.side)
    }
}

/// The geometry that the options ask for.
fn world_of(options: SparseOptions) -> Result<World, IngestError> {
    let nodes = u64::from(options.detailed_nodes) << options.doublings;
    let is_side = options.is_bulk || options.detailed_nodes.is_power_of_two();
    if !is_side || !(1..=1 << 14).contains(&nodes) {
        let expected = if options.is_bulk { "1" } else { "a power of two" };
        return Err(IngestError::usage(format!(
            "a sparse world of {nodes} nodes along a side cannot be made, expected {expected} up to {}",
            1 << 14
        )));
    }
    let top = nodes.next_power_of_two().ilog2() as u8;
    let most = COLOR_TILE / ELEVATION_TILE;
    if !options.texels_per_post.is_power_of_two() || options.texels_per_post > most {
        return Err(IngestError::usage(format!(
            "a sparse world cannot have {} texels per post, expected a power of two up to {most}",
            options.texels_per_post
        )));
    }
    let finest_color = (most / options.texels_per_post).ilog2() as u8;
    let fields = WorldFields {
        origin: [500_000.0, 5_000_000.0],
        lattice_unit_m: SPACING_M,
        extent: [nodes as u32 * ELEVATION_TILE; 2],
        elevation_tile: ELEVATION_TILE,
        color_tile: COLOR_TILE,
        levels: top + 1,
        finest_elevation_level: 0,
        finest_color_level: finest_color.min(top),
        body: None,
    };
    World::new(fields).map_err(|e| IngestError::usage(format!("a sparse world cannot be made: {e}")))
}

/// Writes a sparse world.
///
/// # Errors
/// [`IngestError`].
pub fn write(folder: &Path, options: SparseOptions, work: &Work) -> Result<Manifest, IngestError> {
    let world = world_of(options)?;
    let elevation_tile = world.elevation_tile();
    let lattice = Lattice { first: world.fields().origin, step: SPACING_M };
    let plan = Plan {
        world,
        elevation: lattice,
        color: lattice,
        elevation_bounds: Vec::new(),
        color_bounds: Vec::new(),
        elevation_levels: Vec::new(),
        color_levels: Vec::new(),
        is_nested: false,
    };
    let target = TargetCrs::new(&crs::parse("the CRS", "EPSG:32632")?, "EPSG:32632")?;
    let bulk = match options.is_bulk {
        true => Some(Bulk::new(world.color_stored(), QUALITY)),
        false => None,
    };
    let bulk = bulk.transpose().map_err(|source| IngestError::Output { source, path: folder.to_owned() })?;
    let detailed = if options.is_bulk { options.detailed_nodes << options.doublings } else { options.detailed_nodes };
    let content = Content { side: f64::from(detailed * elevation_tile), bulk };
    let info = ArchiveInfo { bounds_deg: [0.0; 4], metadata: r#"{"name":"sparse"}"#.to_owned() };
    finish_database(folder, true, work, |paths| {
        let elevation = archive::write(
            &paths[0],
            "elevation tiles",
            TileType::Unknown,
            &world,
            0,
            None,
            &info,
            work,
            |q, _, tiles| Ok(elevation_tiles(&world, &content, q, &tiles)),
        )?;
        let finest_color = world.finest_color_level();
        let color = archive::write(
            &paths[1],
            "colour tiles",
            TileType::Jpeg,
            &world,
            finest_color,
            None,
            &info,
            work,
            |q, _, tiles| match options.is_named {
                true => named_tiles(&world, q, &tiles),
                false => color_tiles(&world, &content, q, &tiles),
            },
        )?;
        let fail = |source| IngestError::Output { source, path: paths[2].clone() };
        let ranges = ranges(&world, &content, work)?;
        let ranges = NodeRanges::from_parts(&world, ranges).map_err(|e| fail(io::Error::other(e)))?;
        let nodes = ranges.write(&paths[2]).map_err(fail)?;
        let range = ranges.range(world.root()).unwrap_or([PLAIN_M; 2]);
        Ok(record_of("sparse", &plan, &target, range, [elevation, color], nodes))
    })
}

fn elevation_tiles(world: &World, content: &Content, q: u8, tiles: &[TilePlace]) -> Vec<Tile> {
    let (posts, spacing) = (world.elevation_posts(), f64::from(1u32 << q));
    let plain = encode_elevation_tile(&vec![PLAIN_M; (posts * posts) as usize], posts);
    let side = world.node_side(q) as f64;
    tiles
        .iter()
        .map(|(_, coord, at)| {
            let low = at.map(|v| f64::from(v) * side);
            if !content.touches(low) {
                return (*coord, plain.clone(), Some(1));
            }
            let heights: Vec<f32> = (0..posts * posts)
                .map(|k| {
                    content.height(low[0] + f64::from(k % posts) * spacing, low[1] + f64::from(k / posts) * spacing)
                })
                .collect();
            (*coord, encode_elevation_tile(&heights, posts), None)
        })
        .collect()
}

fn color_tiles(world: &World, content: &Content, q: u8, tiles: &[TilePlace]) -> io::Result<Vec<Tile>> {
    let stored = world.color_stored();
    let texel = world.node_side(q) as f64 / f64::from(world.color_tile());
    let side = world.node_side(q) as f64;
    let border = f64::from(COLOR_BORDER);
    if let Some(bulk) = &content.bulk {
        return Ok(tiles
            .iter()
            .map(|(_, coord, at)| (*coord, bulk.color_tile(*at, world.color_tile(), texel), None))
            .collect());
    }
    let plain = archive::encode_color_tile(&vec![PLAIN; (stored * stored) as usize], stored as u16, QUALITY)?;
    tiles
        .iter()
        .map(|(_, coord, at)| {
            let low = at.map(|v| f64::from(v) * side - border * texel);
            if !content.touches(low) {
                return Ok((*coord, plain.clone(), Some(1)));
            }
            let place = |origin: f64, index: u32| origin + (f64::from(index) + 0.5) * texel;
            let picture: Vec<Rgb> = (0..stored * stored)
                .map(|k| content.color(place(low[0], k % stored), place(low[1], stored - 1 - k / stored)))
                .collect();
            Ok((*coord, archive::encode_color_tile(&picture, stored as u16, QUALITY)?, None))
        })
        .collect()
}

fn named_tiles(world: &World, q: u8, tiles: &[TilePlace]) -> io::Result<Vec<Tile>> {
    let stored = world.color_stored();
    let named = tiles.iter().map(|(_, coord, [m, n])| {
        let node = NodeId::new(*m, *n, q).ok_or_else(|| io::Error::other("the tile is not a node"))?;
        let picture = vec![name_color(node); (stored * stored) as usize];
        Ok((*coord, archive::encode_color_tile(&picture, stored as u16, 95)?, None))
    });
    named.collect()
}

/// Ranges of all nodes: own posts, and those of coarser levels over the node's area; descendants'
/// from below.
///
/// Posts of a coarser level that lie within the node are posts of its own level too, with the same
/// heights, since those are a function of position; and own posts of all but the finest level are
/// posts of descendants, where the node does not stick out of the world.
fn ranges(world: &World, content: &Content, work: &Work) -> Result<Vec<Vec<[f32; 2]>>, IngestError> {
    let mut all: Vec<Vec<[f32; 2]>> = Vec::new();
    for q in 0..world.levels() {
        let [columns, rows] = world.nodes_at(q).map(u64::from);
        let side = world.node_side(q);
        let extent = world.fields().extent.map(u64::from);
        let range_of = |m: u64, n: u64| {
            let sticks_out = (m + 1) * side > extent[0] || (n + 1) * side > extent[1];
            let has_own = |level: u8| match level == q {
                true => q == 0 || sticks_out,
                false => !side.is_multiple_of(1 << level),
            };
            let mut range = if content.bulk.is_some() { [f32::MAX, f32::MIN] } else { [PLAIN_M; 2] };
            for level in (q..world.levels()).filter(|level| has_own(*level)) {
                let spacing = 1u64 << level;
                let [x, y] = [m, n].map(|v| (v * side / spacing, ((v + 1) * side).div_ceil(spacing)));
                if !content.touches([x.0, y.0].map(|v| (v * spacing) as f64)) {
                    continue;
                }
                for j in y.0..=y.1 {
                    for i in x.0..=x.1 {
                        let height = content.height((i * spacing) as f64, (j * spacing) as f64);
                        range = [range[0].min(height), range[1].max(height)];
                    }
                }
            }
            range
        };
        let mut ranges: Vec<[f32; 2]> = Vec::with_capacity((columns * rows) as usize);
        let row = |(): &mut (), n: usize| Ok((0..columns).map(|m| range_of(m, n as u64)).collect::<Vec<_>>());
        work.in_order(
            "ranges",
            rows as usize,
            || Ok(()),
            row,
            |row| {
                ranges.extend(row);
                Ok(())
            },
        )?;
        if let Some(below) = all.last() {
            let child_columns = world.nodes_at(q - 1)[0] as usize;
            for (k, child) in below.iter().enumerate() {
                let parent = &mut ranges[k / child_columns / 2 * columns as usize + k % child_columns / 2];
                *parent = [parent[0].min(child[0]), parent[1].max(child[1])];
            }
        }
        all.push(ranges);
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;
    use terravision_common::database::{Database, TileScratch, TileSource, color_tile_bytes};

    #[test]
    fn worlds_of_all_sizes_share_the_detailed_square() {
        let folder = std::env::temp_dir().join(format!("tv-sparse-{}", std::process::id()));
        let worlds = [0, 2].map(|doublings| {
            let path = folder.join(format!("{doublings}.tv"));
            write(&path, SparseOptions { detailed_nodes: 4, doublings, ..SparseOptions::default() }, &Work::quiet(2))
                .unwrap();
            Database::open(&path).unwrap()
        });
        let mut scratch = TileScratch::default();
        let node = NodeId::new(1, 2, 0).unwrap();
        let tiles = worlds.each_ref().map(|db| {
            let mut heights = vec![0.0; (db.world().elevation_posts() as usize).pow(2)];
            db.read_elevation(node, &mut heights, &mut scratch).unwrap();
            heights
        });
        assert_eq!(tiles[0], tiles[1]);
        assert!(tiles[0].iter().any(|h| *h != PLAIN_M));
        let far = NodeId::new(15, 15, 0).unwrap();
        let mut heights = vec![0.0; (worlds[1].world().elevation_posts() as usize).pow(2)];
        worlds[1].read_elevation(far, &mut heights, &mut scratch).unwrap();
        assert!(heights.iter().all(|h| *h == PLAIN_M));
        let sizes = worlds.each_ref().map(|db| db.manifest().fields().elevation.archive.bytes);
        assert!(sizes[1] < 2 * sizes[0], "{sizes:?}");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_bulk_world_has_as_many_different_tiles_as_nodes_and_its_ranges_hold_their_heights() {
        let folder = std::env::temp_dir().join(format!("tv-bulk-{}", std::process::id()));
        let options =
            SparseOptions { detailed_nodes: 11, is_bulk: true, texels_per_post: 8, ..SparseOptions::default() };
        write(&folder, options, &Work::quiet(2)).unwrap();
        let database = Database::open(&folder).unwrap();
        let world = *database.world();
        let mut scratch = TileScratch::default();
        let mut heights = vec![0.0; (world.elevation_posts() as usize).pow(2)];
        let mut texels = vec![0; color_tile_bytes(&world)];
        let (mut all, mut pictures) = (Vec::new(), Vec::new());
        for q in 0..world.levels() {
            let [columns, rows] = world.nodes_at(q);
            for node in (0..columns * rows).map(|k| NodeId::new(k % columns, k / columns, q).unwrap()) {
                database.read_elevation(node, &mut heights, &mut scratch).unwrap();
                let [low, high] = database.ranges().range(node).unwrap();
                assert!(heights.iter().all(|h| (low..=high).contains(h)), "{node}: {low} to {high}");
                all.push(heights.iter().map(|h| h.to_bits()).collect::<Vec<_>>());
                if q >= world.finest_color_level() {
                    database.read_color(node, &mut texels, &mut scratch).unwrap();
                    pictures.push(texels.clone());
                }
            }
        }
        let counts = [all.len(), pictures.len()];
        assert_eq!(counts, [121 + 36 + 9 + 4 + 1, 36 + 9 + 4 + 1]);
        all.sort_unstable();
        all.dedup();
        pictures.sort_unstable();
        pictures.dedup();
        assert_eq!([all.len(), pictures.len()], counts);
        let bytes = database.manifest().fields().color.archive.bytes / pictures.len() as u64;
        assert!((40_000..90_000).contains(&bytes), "{bytes} bytes a tile");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_named_world_has_a_tile_of_one_colour_for_each_node() {
        let folder = std::env::temp_dir().join(format!("tv-named-{}", std::process::id()));
        let options = SparseOptions { detailed_nodes: 16, doublings: 1, is_named: true, ..SparseOptions::default() };
        write(&folder, options, &Work::quiet(2)).unwrap();
        let database = Database::open(&folder).unwrap();
        let world = *database.world();
        let mut scratch = TileScratch::default();
        let mut texels = vec![0; color_tile_bytes(&world)];
        for (m, n, q) in [(0, 0, 5), (3, 2, 3), (2, 3, 3), (1, 0, 4)] {
            let node = NodeId::new(m, n, q).unwrap();
            database.read_color(node, &mut texels, &mut scratch).unwrap();
            let is_name = |texel: &[u8]| texel.iter().zip(name_color(node)).all(|(a, b)| a.abs_diff(b) <= 6);
            assert!(texels.chunks_exact(4).all(is_name), "{node}: {:?}, {:?}", &texels[..4], name_color(node));
        }
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
