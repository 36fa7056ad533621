//! A database that means harm takes no more memory than it may, and is refused with a sentence.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod support;

use pmtiles::TileId;
use proptest::prelude::*;
use std::fs::{self, File};
use std::path::Path;
use support::{FILES, good, temporary, write_database};
use terravision_common::database::{
    Archive, ArchiveRecord, Database, ELEVATION_FILE, MANIFEST_FILE, MOST_DIRECTORY_BYTES, MOST_LEAF_BYTES, Manifest,
    NODES_FILE, NodeRanges, TileScratch, TileSource, color_tile_bytes, index_crc32,
};
use terravision_common::node::NodeId;
use terravision_common::world::{World, WorldFields};

/// Bytes of a directory: this many tiles of one byte, one behind the other, from this tile on.
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
    // Three directories of 9.6 MB stay, one is being made of its 1.6 MB. All of them would take 384
    // MB.
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
    let mut manifest = Manifest::parse(&text).unwrap().fields().clone();
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

/// A good database, changed by someone who means harm: all checksums are right.
fn forge(folder: &Path, file: usize, at: prop::sample::Index, bytes: &[u8], number: usize) {
    let mut files = good().0.clone();
    let mut manifest = Manifest::parse(std::str::from_utf8(&files[0]).unwrap()).unwrap().fields().clone();
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
            // In the directory mostly, else in a tile, whose own checksum is then put right when it
            // is one of elevation.
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
