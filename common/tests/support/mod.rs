//! A small database, written and read back.

#![allow(
    dead_code,
    unreachable_pub,
    clippy::unwrap_used,
    reason = "each test program uses its own part; helpers of tests fail by panicking"
)]

use pmtiles::{Compression, PmTilesWriter, TileCoord, TileId, TileType};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};
use terravision_common::database::{
    ArchiveRecord, Body, COLOR_FILE, ColorLayer, Crs, Database, ELEVATION_FILE, ElevationLayer, FORMAT_VERSION,
    MANIFEST_FILE, ManifestFields, NODES_FILE, NodeRanges, TileError, TileScratch, TileSource, color_tile_bytes,
    encode_elevation_tile, index_crc32, seal_color_tile, tile_coord,
};
use terravision_common::node::NodeId;
use terravision_common::world::{World, WorldFields};

pub const FILES: [&str; 4] = [MANIFEST_FILE, ELEVATION_FILE, COLOR_FILE, NODES_FILE];

pub fn fields() -> WorldFields {
    WorldFields {
        origin: [500_000.5, 5_000_000.25],
        lattice_unit_m: 10.0,
        extent: [13, 9],
        elevation_tile: 4,
        color_tile: 16,
        levels: 3,
        finest_elevation_level: 0,
        finest_color_level: 1,
        body: None,
    }
}

pub fn nodes(world: &World) -> Vec<NodeId> {
    let level = |q: u8| {
        let [columns, rows] = world.nodes_at(q);
        (0..rows).flat_map(move |n| (0..columns).map(move |m| NodeId::new(m, n, q).unwrap()))
    };
    (0..world.levels()).rev().flat_map(level).collect()
}

pub fn heights(node: NodeId) -> Vec<f32> {
    let seed = node.m() * 31 + node.n() * 17 + u32::from(node.q()) * 7;
    (0..25).map(|k: u32| 100.0 + ((k * k + seed) % 97) as f32 / 8.0).collect()
}

pub fn temporary(name: &str) -> PathBuf {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    let number = COUNT.fetch_add(1, Ordering::Relaxed);
    let path = std::env::temp_dir().join(format!("tv-database-{name}-{}-{number}", std::process::id()));
    fs::create_dir_all(&path).unwrap();
    path
}

fn archive(path: &Path, world: &World, kind: TileType, tile: impl Fn(NodeId) -> Option<Vec<u8>>) -> ArchiveRecord {
    let writer = PmTilesWriter::new(kind).tile_compression(Compression::None).metadata("{\"name\":\"test\"}");
    let mut writer = writer.create(File::create(path).unwrap()).unwrap();
    let mut tiles: Vec<(TileCoord, Vec<u8>)> =
        nodes(world).into_iter().filter_map(|node| Some((tile_coord(world, node)?, tile(node)?))).collect();
    tiles.sort_by_key(|(coord, _)| TileId::from(*coord).value());
    let count = tiles.len() as u64;
    tiles.into_iter().for_each(|(coord, bytes)| writer.add_tile(coord, &bytes).unwrap());
    writer.finalize().unwrap();
    ArchiveRecord { bytes: fs::metadata(path).unwrap().len(), index_crc32: index_crc32(path).unwrap(), tiles: count }
}

pub fn write_database(folder: &Path) {
    let world = World::new(fields()).unwrap();
    let elevation = archive(&folder.join(ELEVATION_FILE), &world, TileType::Unknown, |node| {
        Some(encode_elevation_tile(&heights(node), 5))
    });
    let color = archive(&folder.join(COLOR_FILE), &world, TileType::Jpeg, |node| {
        let pixels: Vec<u8> = (0..24 * 24 * 3).map(|k| (k * 3 + node.m() * 50) as u8).collect();
        let mut bytes = Vec::new();
        jpeg_encoder::Encoder::new(&mut bytes, 90).encode(&pixels, 24, 24, jpeg_encoder::ColorType::Rgb).unwrap();
        seal_color_tile(&mut bytes);
        world.has_color(node).then_some(bytes)
    });
    let ranges = (0..3).map(|q| vec![[90.0, 120.0]; world.nodes_at(q).map(|n| n as usize).iter().product()]).collect();
    let nodes = NodeRanges::from_parts(&world, ranges).unwrap().write(&folder.join(NODES_FILE)).unwrap();
    let manifest = ManifestFields {
        format: String::new(),
        format_version: FORMAT_VERSION,
        features: Vec::new(),
        complete_level: None,
        written_by: "a test".to_owned(),
        name: "test".to_owned(),
        crs: Crs { name: "plane".to_owned(), epsg: None, wkt: "LOCAL_CS[\"plane\"]".to_owned(), proj4: None },
        lonlat: None,
        body: Body { name: "Earth".to_owned(), radius_m: 6_378_137.0 },
        world: fields(),
        vertical_unit: "metre".to_owned(),
        elevation: ElevationLayer {
            sources: Vec::new(),
            spacing_m: 10.0,
            range_m: [90.0, 120.0],
            source_range_m: None,
            void_area_m2: 0.0,
            voids: None,
            encoding: "terravision-elevation-1".to_owned(),
            archive: elevation,
        },
        color: ColorLayer {
            tint: None,
            sources: Vec::new(),
            spacing_m: 5.0,
            void_area_m2: 0.0,
            encoding: "jpeg".to_owned(),
            quality: 90,
            archive: color,
        },
        nodes,
        checksum: String::new(),
    };
    fs::write(folder.join(MANIFEST_FILE), manifest.to_text().unwrap()).unwrap();
}

/// Bytes of all tiles; an error where there is one.
pub fn content(database: &Database) -> Vec<Result<Vec<u8>, TileError>> {
    let (world, mut scratch) = (*database.world(), TileScratch::default());
    let mut all = Vec::new();
    for node in nodes(&world) {
        let mut out = vec![0f32; 25];
        let read = database.read_elevation(node, &mut out, &mut scratch);
        all.push(read.map(|()| out.iter().flat_map(|h| h.to_le_bytes()).collect()));
        let mut out = vec![0; color_tile_bytes(&world)];
        all.push(database.read_color(node, &mut out, &mut scratch).map(|()| out));
    }
    all
}

/// The files of a good database, and its content.
pub fn good() -> &'static (Vec<Vec<u8>>, Vec<Option<Vec<u8>>>) {
    /// Files, and the content of each tile that there is.
    type Good = (Vec<Vec<u8>>, Vec<Option<Vec<u8>>>);
    static GOOD: OnceLock<Good> = OnceLock::new();
    GOOD.get_or_init(|| {
        let folder = temporary("good");
        write_database(&folder);
        let database = Database::open(&folder).unwrap();
        let content = content(&database).into_iter().map(Result::ok).collect();
        let files = FILES.map(|name| fs::read(folder.join(name)).unwrap()).to_vec();
        fs::remove_dir_all(&folder).unwrap();
        (files, content)
    })
}
