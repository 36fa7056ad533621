//! A database read back, and read when it is damaged: an error or the same content, never a panic, never other content.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use pmtiles::{Compression, PmTilesWriter, TileCoord, TileId, TileType};
use proptest::prelude::*;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};
use terravision_common::database::{
    Archive, ArchiveRecord, Body, COLOR_FILE, ColorLayer, Crs, Database, DatabaseError, ELEVATION_FILE, ElevationLayer,
    FEATURES_VERSION, FORMAT_VERSION, MANIFEST_FILE, MOST_DIRECTORY_BYTES, MOST_LEAF_BYTES, Manifest, ManifestError,
    NODES_FILE, NodeRanges, TileError, TileScratch, TileSource, color_tile_bytes, encode_elevation_tile, index_crc32,
    seal_color_tile, tile_coord,
};
use terravision_common::node::NodeId;
use terravision_common::world::{World, WorldFields};

const FILES: [&str; 4] = [MANIFEST_FILE, ELEVATION_FILE, COLOR_FILE, NODES_FILE];

fn fields() -> WorldFields {
    WorldFields {
        origin: [500_000.5, 5_000_000.25],
        lattice_unit_m: 10.0,
        extent: [13, 9],
        elevation_tile: 4,
        color_tile: 16,
        levels: 3,
        finest_elevation_level: 0,
        finest_color_level: 1,
    }
}

fn nodes(world: &World) -> Vec<NodeId> {
    let level = |q: u8| {
        let [columns, rows] = world.nodes_at(q);
        (0..rows).flat_map(move |n| (0..columns).map(move |m| NodeId::new(m, n, q).unwrap()))
    };
    (0..world.levels()).rev().flat_map(level).collect()
}

fn heights(node: NodeId) -> Vec<f32> {
    let seed = node.m() * 31 + node.n() * 17 + u32::from(node.q()) * 7;
    (0..25).map(|k: u32| 100.0 + ((k * k + seed) % 97) as f32 / 8.0).collect()
}

fn temporary(name: &str) -> PathBuf {
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

fn write_database(folder: &Path) {
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
    let manifest = Manifest {
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
fn content(database: &Database) -> Vec<Result<Vec<u8>, TileError>> {
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
fn good() -> &'static (Vec<Vec<u8>>, Vec<Option<Vec<u8>>>) {
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

#[test]
fn a_database_reads_back() {
    let folder = temporary("back");
    write_database(&folder);
    let database = Database::open(&folder).unwrap();
    let mut scratch = TileScratch::default();
    for node in nodes(database.world()) {
        let mut out = vec![0.0; 25];
        database.read_elevation(node, &mut out, &mut scratch).unwrap();
        assert_eq!(out, heights(node));
        let mut out = vec![0; color_tile_bytes(database.world())];
        let color = database.read_color(node, &mut out, &mut scratch);
        match node.q() {
            0 => assert!(matches!(color, Err(TileError::Missing { .. }))),
            _ => assert!(color.is_ok() && out.chunks_exact(4).all(|texel| texel[3] == 255)),
        }
        assert_eq!(database.ranges().range(node), Some([90.0, 120.0]));
    }
    let outside = NodeId::new(4, 0, 0).unwrap();
    let found = database.read_elevation(outside, &mut [0.0; 25], &mut scratch);
    assert!(matches!(found, Err(TileError::Missing { .. })));
    assert_eq!(database.ranges().range(outside), None);
    fs::remove_dir_all(&folder).unwrap();
}

/// Opens a database made of these files; whatever can be read of it has to be what was written.
fn check(files: &[Vec<u8>]) {
    let folder = temporary("damaged");
    FILES.iter().zip(files).for_each(|(name, bytes)| fs::write(folder.join(name), bytes).unwrap());
    match Database::open(&folder) {
        Err(error) => assert!(error.to_string().len() > 20, "{error}"),
        Ok(database) => {
            for (found, expected) in content(&database).into_iter().zip(&good().1) {
                match found {
                    Ok(bytes) => assert_eq!(Some(&bytes), expected.as_ref()),
                    Err(error) => assert!(error.to_string().contains("tile of node"), "{error}"),
                }
            }
        }
    }
    fs::remove_dir_all(&folder).unwrap();
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn flipped_bytes_anywhere_are_noticed(file in 0usize..4, at: prop::sample::Index, change in 1u8..=255) {
        let mut files = good().0.clone();
        let at = at.index(files[file].len());
        files[file][at] ^= change;
        check(&files);
    }

    #[test]
    fn files_cut_short_or_with_a_tail_are_noticed(file in 0usize..4, at: prop::sample::Index, tail in 0usize..9) {
        let mut files = good().0.clone();
        let length = at.index(files[file].len());
        files[file].truncate(length);
        files[file].extend(vec![0; tail]);
        check(&files);
    }

    #[test]
    fn any_bytes_for_a_directory_are_an_archive_or_an_error(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        // A directory whose checksum is right, as if written by someone who means harm.
        let mut file = good().0[1].clone();
        let end = (127 + bytes.len()).min(file.len());
        file[127..end].copy_from_slice(&bytes[..end - 127]);
        file[16..24].copy_from_slice(&(bytes.len() as u64).to_le_bytes());
        file[97] = 1;
        let folder = temporary("directory");
        let path = folder.join(ELEVATION_FILE);
        fs::write(&path, &file).unwrap();
        let record = ArchiveRecord { bytes: file.len() as u64, index_crc32: index_crc32(&path).unwrap(), tiles: 1 };
        if let Ok(archive) = Archive::open(&path, &record) {
            for id in 0..30 {
                archive.read(TileId::new(id).unwrap(), 1000, &mut Vec::new()).ok();
            }
        }
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn any_header_is_an_archive_or_an_error(bytes in prop::collection::vec(any::<u8>(), 119)) {
        let mut file = good().0[1].clone();
        file[8..127].copy_from_slice(&bytes);
        let folder = temporary("header");
        let path = folder.join(ELEVATION_FILE);
        fs::write(&path, &file).unwrap();
        let checksum = index_crc32(&path).unwrap_or(0);
        let record = ArchiveRecord { bytes: file.len() as u64, index_crc32: checksum, tiles: 1 };
        if let Ok(archive) = Archive::open(&path, &record) {
            archive.read(TileId::new(0).unwrap(), 1000, &mut Vec::new()).ok();
        }
        fs::remove_dir_all(&folder).unwrap();
    }
}

#[test]
fn a_folder_without_manifest_is_an_unfinished_database() {
    let folder = temporary("none");
    let error = Database::open(&folder).unwrap_err();
    assert!(matches!(error, DatabaseError::NotADatabase { .. }));
    assert!(error.to_string().contains("run again"), "{error}");
    assert!(matches!(Database::open(Path::new("/nowhere")).unwrap_err(), DatabaseError::NotADatabase { .. }));
    assert!(matches!(Database::open(Path::new("/etc/passwd")).unwrap_err(), DatabaseError::NotADatabase { .. }));
    fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn a_newer_version_is_told_from_damage() {
    let text = String::from_utf8(good().0[0].clone()).unwrap();
    let newer = text.replace("\"format_version\": 1", "\"format_version\": 7, \"curvature\": true");
    let error = Manifest::parse(&newer).unwrap_err();
    assert!(matches!(error, ManifestError::Version { expected: FEATURES_VERSION, found: 7 }));
    assert!(error.to_string().contains("version 7") && error.to_string().contains("up to 2"));
    let strange = text.replace(
        "\"format_version\": 1",
        "\"format_version\": 2, \"features\": [\"validity\", \"sparse-levels\", \"curvature\"]",
    );
    let error = Manifest::parse(&strange).unwrap_err();
    assert!(matches!(&error, ManifestError::Feature { found } if found == "curvature"));
    assert!(error.to_string().contains("\"curvature\""), "{error}");
    let unknown = text.replace("\"vertical_unit\"", "\"horizontal_unit\"");
    assert!(matches!(Manifest::parse(&unknown).unwrap_err(), ManifestError::Content { .. }));
    assert!(matches!(Manifest::parse("{}").unwrap_err(), ManifestError::NotAManifest));
    let edited = text.replace("\"name\": \"test\"", "\"name\": \"best\"");
    assert!(matches!(Manifest::parse(&edited).unwrap_err(), ManifestError::Checksum { .. }));
    assert!(Manifest::parse(&text).is_ok());
}

#[test]
fn an_archive_with_leaf_directories_gives_every_tile() {
    let folder = temporary("leaves");
    let path = folder.join(ELEVATION_FILE);
    let writer = PmTilesWriter::new(TileType::Unknown).tile_compression(Compression::None);
    let mut writer = writer.create(File::create(&path).unwrap()).unwrap();
    let tile = |id: u64| id.wrapping_mul(0x9e37_79b9_7f4a_7c15).to_le_bytes();
    // Gaps, so that no two entries join.
    let ids = || (0..40_000u64).filter(|id| id % 3 != 1);
    ids().for_each(|id| writer.add_tile(TileId::new(id).unwrap().into(), &tile(id)).unwrap());
    writer.finalize().unwrap();
    let record =
        ArchiveRecord { bytes: fs::metadata(&path).unwrap().len(), index_crc32: index_crc32(&path).unwrap(), tiles: 0 };
    let archive = Archive::open(&path, &record).unwrap();
    let mut out = Vec::new();
    for id in 0..40_100 {
        let is_there = archive.read(TileId::new(id).unwrap(), 8, &mut out).unwrap();
        assert_eq!(is_there, id < 40_000 && id % 3 != 1, "tile {id}");
        assert!(!is_there || out == tile(id));
    }
    assert!(archive.read(TileId::new(0).unwrap(), 7, &mut out).is_err(), "a tile longer than the limit is not read");
    fs::remove_dir_all(&folder).unwrap();
}

/// Bytes of a directory: so many tiles of one byte, one behind the other, from this tile on.
fn directory(first_id: u64, count: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut put = |mut value: u64| {
        while value >= 0x80 {
            bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        bytes.push(value as u8);
    };
    put(count as u64);
    put(first_id);
    (1..count).for_each(|_| put(1));
    // Run lengths, lengths, and offsets: the first is 0, the others follow it.
    (0..2 * count).for_each(|_| put(1));
    put(1);
    (1..count).for_each(|_| put(0));
    bytes
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    std::io::Write::write_all(&mut encoder, bytes).unwrap();
    encoder.finish().unwrap()
}

/// An archive with these leaf directories, as they are stored, each from its first tile on.
fn archive_of_leaves(path: &Path, leaves: &[(u64, Vec<u8>)]) -> ArchiveRecord {
    let mut root = vec![];
    let mut put = |mut value: u64| {
        while value >= 0x80 {
            root.push(value as u8 | 0x80);
            value >>= 7;
        }
        root.push(value as u8);
    };
    put(leaves.len() as u64);
    leaves.iter().scan(0, |last, (id, _)| Some(id - std::mem::replace(last, *id))).for_each(&mut put);
    leaves.iter().for_each(|_| put(0));
    leaves.iter().for_each(|(_, leaf)| put(leaf.len() as u64));
    leaves.iter().enumerate().for_each(|(at, _)| put(u64::from(at == 0)));
    let root = gzip(&root);
    let leaf_bytes: Vec<u8> = leaves.iter().flat_map(|(_, leaf)| leaf.iter().copied()).collect();
    let mut file = vec![0; 127];
    file[..8].copy_from_slice(b"PMTiles\x03");
    let mut section = |at: usize, offset: usize, length: usize| {
        file[at..at + 8].copy_from_slice(&(offset as u64).to_le_bytes());
        file[at + 8..at + 16].copy_from_slice(&(length as u64).to_le_bytes());
    };
    section(8, 127, root.len());
    let data_at = 127 + root.len();
    section(56, data_at, 1 << 20);
    section(40, data_at + (1 << 20), leaf_bytes.len());
    file[97] = 2;
    file.extend(root);
    file.extend(vec![7; 1 << 20]);
    file.extend(leaf_bytes);
    fs::write(path, file).unwrap();
    ArchiveRecord { bytes: fs::metadata(path).unwrap().len(), index_crc32: index_crc32(path).unwrap(), tiles: 0 }
}

#[test]
fn leaf_directories_take_no_more_memory_than_they_may_however_small_they_are_on_disk() {
    const TILES: usize = 400_000;
    const LEAVES: u64 = 40;
    let folder = temporary("bombs");
    let path = folder.join(ELEVATION_FILE);
    let leaf = |at: u64| (at * TILES as u64, gzip(&directory(at * TILES as u64, TILES)));
    let record = archive_of_leaves(&path, &(0..LEAVES).map(leaf).collect::<Vec<_>>());
    assert!(record.bytes < 2 << 20, "{} bytes on disk", record.bytes);
    let memory = allocation_counter::measure(|| {
        let archive = Archive::open(&path, &record).unwrap();
        let mut out = Vec::new();
        for round in 0..2 {
            for at in 0..LEAVES {
                let id = at * TILES as u64 + 17 + round;
                assert!(archive.read(TileId::new(id).unwrap(), 8, &mut out).unwrap() && out == [7]);
            }
        }
    });
    // Three directories of 9.6 MB stay, one is being made of its 1.6 MB. All of them would take 384 MB.
    let most = MOST_LEAF_BYTES as u64 + 24 * (TILES as u64 + 1000) + 4 * MOST_DIRECTORY_BYTES;
    assert!(memory.bytes_max < most, "{} bytes of memory, at most {most}", memory.bytes_max);
    fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn a_directory_that_decompresses_to_too_much_is_refused_on_the_way() {
    let folder = temporary("bomb");
    let path = folder.join(ELEVATION_FILE);
    let record = archive_of_leaves(&path, &[(0, gzip(&vec![0; 64 << 20])), (9, b"no gzip at all".to_vec())]);
    let memory = allocation_counter::measure(|| {
        let archive = Archive::open(&path, &record).unwrap();
        let told = |id| archive.read(TileId::new(id).unwrap(), 8, &mut Vec::new()).unwrap_err().to_string();
        assert!(told(0).contains("impossibly large"), "{}", told(0));
        assert!(told(9).contains("does not decompress"), "{}", told(9));
    });
    assert!(memory.bytes_max < 16 << 20, "{} bytes of memory", memory.bytes_max);
    fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn height_ranges_of_a_world_too_large_are_refused_before_room_is_made() {
    let folder = temporary("ranges");
    write_database(&folder);
    let text = fs::read_to_string(folder.join(MANIFEST_FILE)).unwrap();
    let mut manifest = Manifest::parse(&text).unwrap();
    manifest.world = WorldFields { extent: [1 << 28; 2], levels: 25, elevation_tile: 16, ..manifest.world };
    manifest.nodes.bytes = *NodeRanges::file_bytes(&World::new(manifest.world).unwrap(), false).end();
    assert!(manifest.nodes.bytes > 3_000_000_000_000_000);
    fs::write(folder.join(MANIFEST_FILE), manifest.to_text().unwrap()).unwrap();
    // The file is as long as it is said to be; not all file systems have files of petabytes.
    let nodes = File::options().write(true).open(folder.join(NODES_FILE)).unwrap();
    nodes.set_len(manifest.nodes.bytes.min(1 << 40)).unwrap();
    let memory = allocation_counter::measure(|| {
        let error = Database::open(&folder).unwrap_err().to_string();
        assert!(error.contains("height ranges") && error.contains("at most 1073741824"), "{error}");
    });
    assert!(memory.bytes_max < 1 << 20, "{} bytes of memory", memory.bytes_max);
    fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn a_manifest_full_of_values_takes_little_more_memory_than_its_text() {
    let values = format!("[{}0]", "[],{},0,".repeat(500_000));
    let flat = format!(
        "{{\"format\": \"terravision-database\", \"format_version\": 1, \"x\": [{}0]}}",
        "{},0,".repeat(1 << 20)
    );
    for text in [values, flat] {
        let memory = allocation_counter::measure(|| {
            Manifest::parse(&text).unwrap_err();
        });
        assert!(memory.bytes_max < 1 << 20, "{} bytes of memory for {} of text", memory.bytes_max, text.len());
    }
}

#[test]
fn pipes_devices_and_folders_in_place_of_files_are_refused_and_nothing_waits() {
    let folder = temporary("pipes");
    write_database(&folder);
    for name in FILES {
        let path = folder.join(name);
        let good = fs::read(&path).unwrap();
        let replace = |make: &dyn Fn(&Path)| {
            fs::remove_file(&path).unwrap();
            make(&path);
            let error = Database::open(&folder).unwrap_err().to_string();
            fs::remove_file(&path).or_else(|_| fs::remove_dir(&path)).unwrap();
            fs::write(&path, &good).unwrap();
            error
        };
        let mode = rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR;
        let fifo = replace(&|path| {
            rustix::fs::mknodat(rustix::fs::CWD, path, rustix::fs::FileType::Fifo, mode, 0).unwrap();
        });
        assert!(fifo.contains("a named pipe, expected a regular file") && fifo.contains(name), "{fifo}");
        let device = replace(&|path| std::os::unix::fs::symlink("/dev/zero", path).unwrap());
        assert!(device.contains("a device, expected a regular file") && device.contains(name), "{device}");
        let directory = replace(&|path| fs::create_dir(path).unwrap());
        assert!(directory.contains("a folder, expected a regular file") && directory.contains(name), "{directory}");
    }
    Database::open(&folder).unwrap();
    fs::remove_dir_all(&folder).unwrap();
}

/// A good database, changed by someone who means harm: all checksums are right.
fn forge(folder: &Path, file: usize, at: prop::sample::Index, bytes: &[u8], number: usize) {
    let mut files = good().0.clone();
    let mut manifest = Manifest::parse(std::str::from_utf8(&files[0]).unwrap()).unwrap();
    let overwrite = |file: &mut [u8], at: usize| {
        let end = (at + bytes.len()).min(file.len());
        file[at..end].copy_from_slice(&bytes[..end - at]);
    };
    let path = |file: usize| folder.join(FILES[file]);
    match file {
        0 => {
            // Some number of the manifest becomes another one.
            let numbers: [u64; 12] = [0, 1, 2, 3, 24, 25, 255, 256, 1 << 28, u32::MAX.into(), 1 << 40, u64::MAX >> 1];
            let value = numbers[number % numbers.len()];
            match at.index(14) {
                0 => manifest.world.extent[0] = value as u32,
                1 => manifest.world.extent[1] = value as u32,
                2 => manifest.world.levels = value as u8,
                3 => manifest.world.elevation_tile = value as u32,
                4 => manifest.world.color_tile = value as u32,
                5 => manifest.world.finest_elevation_level = value as u8,
                6 => manifest.world.finest_color_level = value as u8,
                7 => manifest.world.lattice_unit_m = value as f64,
                8 => manifest.world.origin = [value as f64; 2],
                9 => manifest.nodes.bytes = value,
                10 => manifest.elevation.archive.bytes = value,
                11 => manifest.color.archive.tiles = value,
                12 => manifest.elevation.range_m = [value as f64, -(value as f64)],
                _ => manifest.name = "\u{1b}[2J\u{202e}".repeat(number),
            }
            if let Ok(world) = World::new(manifest.world) {
                // Told as the world needs it, where it is not the claim itself that is wrong.
                if at.index(14) < 9 {
                    manifest.nodes.bytes = *NodeRanges::file_bytes(&world, false).end();
                }
            }
        }
        3 => {
            let at = at.index(files[3].len());
            overwrite(&mut files[3], at);
            manifest.nodes.crc32 = crc32fast::hash(&files[3]);
        }
        file => {
            // In the directory mostly, else in a tile, whose own checksum is then put right when it is one of elevation.
            let end = if number.is_multiple_of(4) { files[file].len() } else { 127 + 300 };
            let at = at.index(end);
            overwrite(&mut files[file], at);
            let starts: Vec<usize> =
                files[file].windows(4).enumerate().filter(|(_, w)| *w == b"TVe1").map(|(at, _)| at).collect();
            for (index, start) in starts.iter().enumerate() {
                let end = starts.get(index + 1).copied().unwrap_or(files[file].len());
                if (*start..end).contains(&at) && end > start + 8 {
                    let checksum = crc32fast::hash(&files[file][start + 8..end]);
                    files[file][start + 4..start + 8].copy_from_slice(&checksum.to_le_bytes());
                }
            }
        }
    }
    for (index, bytes) in files.iter().enumerate().skip(1) {
        fs::write(path(index), bytes).unwrap();
    }
    for (index, record) in [(1, &mut manifest.elevation.archive), (2, &mut manifest.color.archive)] {
        if let Ok(checksum) = index_crc32(&path(index)) {
            record.index_crc32 = checksum;
        }
    }
    if let Ok(text) = manifest.to_text() {
        fs::write(path(0), text).unwrap();
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    #[test]
    fn forged_databases_open_or_are_refused_within_their_memory(
        file in 0usize..4,
        at: prop::sample::Index,
        bytes in prop::collection::vec(prop_oneof![Just(0u8), Just(0xff), any::<u8>()], 1..12),
        number in 0usize..100,
    ) {
        let folder = temporary("forged");
        good();
        forge(&folder, file, at, &bytes, number);
        let memory = allocation_counter::measure(|| match Database::open(&folder) {
            Err(error) => assert!(error.to_string().len() > 20, "{error}"),
            Ok(database) => {
                let world = *database.world();
                let mut scratch = TileScratch::default();
                let posts = world.elevation_posts() as usize;
                let mut heights = vec![0f32; posts * posts];
                let mut texels = vec![0; color_tile_bytes(&world)];
                for node in nodes_at_most(&world, 60) {
                    database.read_elevation(node, &mut heights, &mut scratch).ok();
                    database.read_color(node, &mut texels, &mut scratch).ok();
                    assert!(database.ranges().range(node).is_none_or(|[low, high]| low <= high));
                }
            }
        });
        prop_assert!(memory.bytes_max < 64 << 20, "{} bytes of memory", memory.bytes_max);
        fs::remove_dir_all(&folder).unwrap();
    }
}

/// Some nodes of a world that may be large: from the root on.
fn nodes_at_most(world: &World, most: usize) -> Vec<NodeId> {
    let of_level = |q: u8| {
        let [columns, rows] = world.nodes_at(q).map(|count| count.min(4));
        (0..rows).flat_map(move |n| (0..columns).filter_map(move |m| NodeId::new(m, n, q)))
    };
    (0..world.levels()).rev().flat_map(of_level).take(most).collect()
}
