//! A database read back, and read when it is damaged: an error or the same content, never a panic,
//! never other content.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod support;

use pmtiles::{Compression, PmTilesWriter, TileId, TileType};
use proptest::prelude::*;
use std::fs::{self, File};
use std::path::Path;
use support::{FILES, content, good, heights, nodes, temporary, write_database};
use terravision_common::database::{
    Archive, ArchiveRecord, Database, DatabaseError, ELEVATION_FILE, FEATURES_VERSION, Manifest, ManifestError,
    ManifestFields, TileError, TileScratch, TileSource, color_tile_bytes, index_crc32,
};
use terravision_common::node::NodeId;

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

/// Bytes that databases have on disk: what is read is written again as it was.
#[test]
fn a_manifest_has_the_bytes_that_it_always_had() {
    let golden = include_str!("golden/manifest.json");
    let manifest = Manifest::parse(golden).unwrap();
    assert_eq!(manifest.fields().to_text().unwrap(), golden);
    assert!(manifest.is_sparse() && manifest.world().has_holes());
    assert_eq!((manifest.world().complete_level(), manifest.world().extent()), (1, [13, 9]));
    // Format, version and checksum are those of the text, whatever the fields say.
    let fields = ManifestFields {
        format: String::new(),
        format_version: 0,
        checksum: String::new(),
        ..manifest.fields().clone()
    };
    assert_eq!(fields.to_text().unwrap(), golden);
}

#[test]
fn fields_that_make_no_manifest_are_refused_although_the_checksum_is_right() {
    let good = Manifest::parse(include_str!("golden/manifest.json")).unwrap();
    let refused = |change: &dyn Fn(&mut ManifestFields)| {
        let mut fields = good.fields().clone();
        change(&mut fields);
        let read = Manifest::parse(&fields.to_text().unwrap()).unwrap_err().to_string();
        assert_eq!(Manifest::new(fields).unwrap_err().to_string(), read);
        read
    };
    assert!(refused(&|fields| fields.world.levels = 99).starts_with("its world is wrong: levels is 99, expected "));
    assert!(refused(&|fields| fields.features.push("curvature".into())).contains("\"curvature\""));
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
