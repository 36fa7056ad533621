//! Writes levels as tiles to PMTiles v3 archives, in the order that the format prefers: by zoom,
//! then along the Hilbert curve.

use crate::IngestError;
use crate::nested::Nodes;
use crate::pyramid::validity::Shares;
use crate::store::{Level, Rect, Rgb};
use crate::work::Work;
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use pmtiles::{CallerKey, Compression, PmTilesStreamWriter, PmTilesWriter, TileCoord, TileId, TileType};
use std::collections::BTreeSet;
use std::fs::File;
use std::io;
use std::path::Path;
use terravision_common::database::{
    ArchiveRecord, encode_elevation_tile, encode_elevation_tile_with_validity, index_crc32, seal_color_tile, tile_coord,
};
use terravision_common::node::NodeId;
use terravision_common::world::{COLOR_BORDER, World};

/// Side, in tiles, of the blocks that are read at a time: an aligned square, so that it is a
/// contiguous run of the Hilbert curve.
const RUN: u32 = 8;

/// Metadata of an archive for other programs.
#[derive(Debug, Clone)]
pub struct ArchiveInfo {
    /// Longitude and latitude of the bounds: west, south, east, north, degrees; zeros when unknown.
    pub bounds_deg: [f64; 4],
    /// JSON object.
    pub metadata: String,
}

/// A tile: its coordinates, its bytes, and a key for identical tiles, if there are many.
pub(crate) type Tile = (TileCoord, Vec<u8>, Option<u64>);

/// A tile to be made: its id, its coordinates in the archive, and its column and row from the south
/// west.
pub(crate) type TilePlace = (u64, TileCoord, [u32; 2]);

type Writer = PmTilesStreamWriter<File, CallerKey<u64>>;

fn output(path: &Path) -> impl Fn(io::Error) -> IngestError + Copy + '_ {
    |source| IngestError::Output { source, path: path.to_owned() }
}

fn pmtiles_error(path: &Path) -> impl Fn(pmtiles::PmtError) -> IngestError + Copy + '_ {
    move |e| output(path)(io::Error::other(e))
}

/// Runs of tiles of a level, in order along the curve: for each its first column and row (from the
/// south).
fn runs(world: &World, q: u8, nodes: Option<&Nodes>) -> Vec<[u32; 2]> {
    let [columns, rows] = world.nodes_at(q);
    let firsts: BTreeSet<[u32; 2]> = match nodes {
        Some(nodes) => nodes.of_level(q).into_iter().map(|node| [node.m(), node.n()].map(|v| v / RUN * RUN)).collect(),
        None => {
            let firsts = (0..rows).step_by(RUN as usize);
            firsts.flat_map(|n| (0..columns).step_by(RUN as usize).map(move |m| [m, n])).collect()
        }
    };
    let mut runs = Vec::new();
    for [m, n] in firsts {
        let id = |m, n| tile_id(world, m, n, q).map_or(u64::MAX, |(_, id)| id);
        // The curve enters and leaves an aligned square at corners.
        let last = RUN - 1;
        let least = [id(m, n), id(m + last, n), id(m, n + last), id(m + last, n + last)].into_iter().min();
        runs.push((least, [m, n]));
    }
    runs.sort_unstable();
    runs.into_iter().map(|(_, at)| at).collect()
}

fn tile_id(world: &World, m: u32, n: u32, q: u8) -> Option<(TileCoord, u64)> {
    let coord = tile_coord(world, NodeId::new(m, n, q)?)?;
    Some((coord, TileId::from(coord).value()))
}

/// Tiles of a run that exist: column and row within the level, in order along the curve.
fn tiles_of_run(world: &World, q: u8, [m0, n0]: [u32; 2], nodes: Option<&Nodes>) -> Vec<TilePlace> {
    let [columns, rows] = world.nodes_at(q);
    let mut tiles = Vec::new();
    for n in n0..(n0 + RUN).min(rows) {
        for m in m0..(m0 + RUN).min(columns) {
            let exists = nodes.is_none_or(|nodes| NodeId::new(m, n, q).is_some_and(|node| nodes.has(node)));
            tiles.extend(tile_id(world, m, n, q).filter(|_| exists).map(|(coord, id)| (id, coord, [m, n])));
        }
    }
    tiles.sort_unstable_by_key(|(id, ..)| *id);
    tiles
}

/// Writes one archive: all levels from the root down to `finest`, each run of tiles made by `make`.
#[expect(clippy::too_many_arguments, reason = "the two pyramids share the loop, and nothing groups these")]
pub(crate) fn write(
    path: &Path,
    what: &'static str,
    tile_type: TileType,
    world: &World,
    finest: u8,
    nodes: Option<&Nodes>,
    info: &ArchiveInfo,
    work: &Work,
    make: impl Fn(u8, [u32; 2], Vec<TilePlace>) -> io::Result<Vec<Tile>> + Sync,
) -> Result<ArchiveRecord, IngestError> {
    let fail = pmtiles_error(path);
    let file = File::create(path).map_err(output(path))?;
    let [west, south, east, north] = info.bounds_deg;
    let top = world.levels() - 1;
    let mut writer: Writer = PmTilesWriter::new(tile_type)
        .tile_compression(Compression::None)
        .internal_compression(Compression::Gzip)
        .min_zoom(0)
        .max_zoom(top - finest)
        .bounds(west, south, east, north)
        .center(0.5 * (west + east), 0.5 * (south + north))
        .center_zoom((top - finest) / 2)
        .metadata(info.metadata.clone())
        .dedup_by_key::<u64>()
        .create(file.try_clone().map_err(output(path))?)
        .map_err(fail)?;
    let mut count = 0;
    for q in (finest..=top).rev() {
        let runs = runs(world, q, nodes);
        work.in_order(
            what,
            runs.len(),
            || Ok(()),
            |(), index| make(q, runs[index], tiles_of_run(world, q, runs[index], nodes)).map_err(output(path)),
            |tiles| {
                for (coord, bytes, key) in tiles {
                    writer.add_tile(coord, &bytes, key).map_err(fail)?;
                    count += 1;
                }
                Ok(())
            },
        )?;
    }
    writer.finalize().map_err(fail)?;
    file.sync_all().map_err(output(path))?;
    let index_crc32 = index_crc32(path).map_err(|e| output(path)(io::Error::other(e)))?;
    let bytes = file.metadata().map_err(output(path))?.len();
    Ok(ArchiveRecord { bytes, index_crc32, tiles: count })
}

/// Writes the elevation archive. `levels[k]` is level `finest_elevation_level + k`, without voids;
/// `validity[k]` has the shares of its posts, if there are voids. Only `nodes` are written, or all
/// if `None`.
///
/// # Errors
/// [`IngestError::Output`], interruption.
pub(crate) fn write_elevation(
    path: &Path,
    world: &World,
    levels: &[Level<f32>],
    nodes: Option<&Nodes>,
    validity: &[Level<Shares>],
    info: &ArchiveInfo,
    work: &Work,
) -> Result<ArchiveRecord, IngestError> {
    let finest = world.finest_elevation_level();
    let (side, posts) = (world.elevation_tile() as usize, world.elevation_posts() as usize);
    write(path, "elevation tiles", TileType::Unknown, world, finest, nodes, info, work, |q, run, tiles| {
        let origin = run.map(|v| i64::from(v) * side as i64);
        let rect = Rect::new(origin, tiles_size(&tiles, run).map(|n| n * side + 1));
        let heights = levels[usize::from(q - finest)].read(rect)?;
        let shares = validity.get(usize::from(q - finest)).map(|level| level.read(rect)).transpose()?;
        Ok(tiles
            .into_iter()
            .map(|(_, coord, [m, n])| {
                let at = [(m - run[0]) as usize * side, (n - run[1]) as usize * side];
                let heights = cut(&heights, rect.size[0], at, posts);
                match &shares {
                    Some(shares) => elevation_tile(coord, &heights, &cut(shares, rect.size[0], at, posts), posts),
                    None => elevation_tile(coord, &heights, &[], posts),
                }
            })
            .collect())
    })
}

/// A square of `posts`² values of those in rows of `width`.
fn cut<T: Copy>(values: &[T], width: usize, at: [usize; 2], posts: usize) -> Vec<T> {
    (0..posts).flat_map(|j| &values[(at[1] + j) * width + at[0]..][..posts]).copied().collect()
}

/// A tile of heights and shares; without shares everything was measured.
fn elevation_tile(coord: TileCoord, heights: &[f32], shares: &[Shares], posts: usize) -> Tile {
    let (first, share) = (heights[0], shares.first().copied().unwrap_or([255; 2]));
    let is_level = heights.iter().all(|h| *h == first) && shares.iter().all(|s| *s == share);
    // Level tiles of measured ground have the key of their height alone.
    let [hole, made_up] = share.map(|share| u64::from(255 - share));
    let key = is_level.then(|| u64::from(first.to_bits()) | hole << 32 | made_up << 40);
    let bytes = match shares {
        [] => encode_elevation_tile(heights, posts as u32),
        shares => encode_elevation_tile_with_validity(heights, shares, posts as u32),
    };
    (coord, bytes, key)
}

/// Columns and rows of tiles that a run needs.
fn tiles_size(tiles: &[TilePlace], run: [u32; 2]) -> [usize; 2] {
    [0, 1].map(|a| tiles.iter().map(|(_, _, at)| (at[a] - run[a]) as usize + 1).max().unwrap_or(0))
}

/// Writes the colour archive. `levels[k]` is level `finest_color_level + k`. Only `nodes` are
/// written, or all if `None`.
///
/// # Errors
/// [`IngestError::Output`], interruption.
pub(crate) fn write_color(
    path: &Path,
    world: &World,
    levels: &[Level<Rgb>],
    nodes: Option<&Nodes>,
    quality: u8,
    info: &ArchiveInfo,
    work: &Work,
) -> Result<ArchiveRecord, IngestError> {
    let finest = world.finest_color_level();
    let (side, stored, border) = (world.color_tile() as usize, world.color_stored() as usize, COLOR_BORDER as usize);
    write(path, "colour tiles", TileType::Jpeg, world, finest, nodes, info, work, |q, run, tiles| {
        let origin = run.map(|v| i64::from(v) * side as i64 - border as i64);
        let rect = Rect::new(origin, tiles_size(&tiles, run).map(|n| n * side + 2 * border));
        let texels = levels[usize::from(q - finest)].read(rect)?;
        tiles
            .into_iter()
            .map(|(_, coord, at)| {
                let at = [0, 1].map(|a| (at[a] - run[a]) as usize * side);
                // Pictures have their first row in the north.
                let rows = (0..stored).rev().map(|j| &texels[(at[1] + j) * rect.size[0] + at[0]..][..stored]);
                let picture: Vec<Rgb> = rows.flatten().copied().collect();
                let first = picture[0];
                let key = picture
                    .iter()
                    .all(|t| *t == first)
                    .then(|| u64::from_le_bytes([first[0], first[1], first[2], 0, 0, 0, 0, 0]));
                Ok((coord, encode_color_tile(&picture, stored as u16, quality)?, key))
            })
            .collect()
    })
}

/// A colour tile of `side`² texels, row 0 in the north.
///
/// # Errors
/// When the encoder fails: a picture of a wrong size.
pub fn encode_color_tile(picture: &[Rgb], side: u16, quality: u8) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::with_capacity(usize::from(side) * usize::from(side) / 4);
    let mut encoder = Encoder::new(&mut bytes, quality);
    encoder.set_sampling_factor(SAMPLING);
    // Without optimised Huffman tables: with them and subsampled colour, zune-jpeg 0.5.15 decodes
    // stripes (ffmpeg and libjpeg decode the same bytes correctly), and they save only a few per
    // cent.
    encoder.set_optimized_huffman_tables(false);
    encoder.encode(bytemuck::cast_slice(picture), side, side, ColorType::Rgb).map_err(io::Error::other)?;
    seal_color_tile(&mut bytes);
    Ok(bytes)
}

/// Colour differences at full resolution: at equal size that is 0.2 dB better than half the
/// resolution at a higher quality (25 tiles of a synthetic orthophoto: 4:4:4 at 90 has 36.6 dB in
/// 29.1 kB, 4:2:0 at 93 has 36.4 dB in 29.9 kB). Optimised Huffman tables would save 2.5 %, but
/// make this encoder write a scan per component, which zune-jpeg 0.5.15 decodes wrongly when the
/// resolutions differ.
const SAMPLING: SamplingFactor = SamplingFactor::R_4_4_4;

#[cfg(test)]
mod tests {
    use super::*;
    use terravision_common::database::{color_tile_bytes, decode_color_tile};
    use terravision_common::world::WorldFields;
    use terravision_testkit::worlds::fields;

    fn world(extent: [u32; 2], levels: u8) -> World {
        World::new(WorldFields { levels, ..fields(extent, 1.0, [4, 16]) }).unwrap()
    }

    #[test]
    fn a_colour_tile_decodes_to_what_was_encoded() {
        const SIDE: usize = 264;
        let picture: Vec<Rgb> = (0..SIDE * SIDE)
            .map(|k| [(k % SIDE / 2) as u8, (k / SIDE / 2) as u8, ((k % SIDE + k / SIDE) / 3) as u8])
            .collect();
        let tile = encode_color_tile(&picture, SIDE as u16, 90).unwrap();
        let mut out = vec![0; SIDE * SIDE * 4 * 2];
        terravision_common::database::decode_color_tile(&tile, SIDE as u32, &mut out).unwrap();
        let texels = out.chunks_exact(4).zip(&picture);
        let error: u64 = texels.map(|(a, b)| (0..3).map(|c| u64::from(a[c].abs_diff(b[c]))).sum::<u64>()).sum();
        assert!(error < 3 * 2 * (SIDE * SIDE) as u64, "the mean error is {}", error as f64 / (3 * SIDE * SIDE) as f64);
    }

    #[test]
    fn a_colour_tile_decodes_to_about_what_was_encoded() {
        let world = world([4 * 64, 4 * 64], 7);
        let side = world.color_stored() as usize;
        let picture: Vec<Rgb> = (0..side * side)
            .map(|k| [(k % side * 9) as u8, (k / side * 8) as u8, 255 - (k % side * 5) as u8])
            .collect();
        let tile = encode_color_tile(&picture, side as u16, 95).unwrap();
        let mut out = vec![0; color_tile_bytes(&world)];
        decode_color_tile(&tile, side as u32, &mut out).unwrap();
        let differences =
            picture.iter().zip(out.chunks_exact(4)).flat_map(|(a, b)| (0..3).map(|c| a[c].abs_diff(b[c])));
        let (count, sum) = differences.fold((0u32, 0u32), |(n, sum), d| (n + 1, sum + u32::from(d)));
        assert!(f64::from(sum) / f64::from(count) < 2.0, "mean difference {}", f64::from(sum) / f64::from(count));
        assert!(out.chunks_exact(4).all(|texel| texel[3] == 255));
    }

    #[test]
    fn runs_visit_every_tile_once_in_ascending_order() {
        for extent in [[4 * 40, 4 * 23], [4, 4 * 31], [4 * 64, 4 * 64]] {
            let world = world(extent, 7);
            for q in 0..7 {
                let tiles: Vec<_> =
                    runs(&world, q, None).into_iter().flat_map(|run| tiles_of_run(&world, q, run, None)).collect();
                let [columns, rows] = world.nodes_at(q);
                assert_eq!(tiles.len() as u32, columns * rows);
                assert!(tiles.windows(2).all(|pair| pair[0].0 < pair[1].0));
            }
        }
    }
}
