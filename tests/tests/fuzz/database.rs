//! A database in a folder: its manifest, height ranges, directories, tiles; and the projections
//! that a manifest names.

use crate::{databases, within};
use pmtiles::TileId;
use std::fs;
use terravision_common::database::{
    ArchiveLayout, COLOR_FILE, Database, ELEVATION_FILE, Layer, MANIFEST_FILE, Manifest, ManifestError, NODES_FILE,
    NodeRanges, NodesRecord, Place, TileScratch, check_tile, color_tile_bytes, decode_color, decode_elevation,
    max_payload_bytes, seal_color_tile,
};
use terravision_common::lonlat::{Projection, lonlat_of_body};
use terravision_common::node::NodeId;
use terravision_common::world::World;
use terravision_tests::folder::TestFolder;
use terravision_tests::fuzz::Target;

/// Reading a small input takes no more memory than this, whatever it says.
const MOST_BYTES: u64 = 64 << 20;

fn files(name: &str) -> Vec<Vec<u8>> {
    databases().iter().map(|database| fs::read(database.join(name)).unwrap()).collect()
}

fn worlds() -> Vec<World> {
    databases().iter().map(|path| *Database::open(path).unwrap().world()).collect()
}

/// Reads a manifest; the checksum of what was changed is made right, so that more than the checksum
/// is tried.
fn read_manifest(text: &str) -> Option<Manifest> {
    match Manifest::parse(text) {
        Ok(manifest) => Some(manifest),
        Err(ManifestError::Checksum { expected, found }) => {
            let mended = text.replacen(&format!("{expected:08x}"), &format!("{found:08x}"), 1);
            Manifest::parse(&mended).ok()
        }
        Err(error) => {
            assert!(!error.to_string().is_empty());
            None
        }
    }
}

#[test]
fn manifests() {
    let target = Target {
        name: "manifest",
        inputs: files(MANIFEST_FILE),
        words: &[
            b"null",
            b"[]",
            b"{}",
            b"\"features\": [\"sparse-levels\"],",
            b"true",
            b"1e308",
            b"\\u0000",
            b"[[[[[[[[",
        ],
        short_round: 3000,
    };
    target.run(|bytes| {
        within(MOST_BYTES, || {
            let Ok(text) = std::str::from_utf8(bytes) else { return };
            let Some(manifest) = read_manifest(text) else { return };
            manifest.fields().to_text().unwrap();
            let world = *manifest.world();
            let root = world.root();
            assert!(world.contains(root) && world.levels() > root.q());
            for layer in [Layer::Elevation, Layer::Color] {
                assert!(max_payload_bytes(&world, layer) > 0);
            }
            assert!(NodeRanges::file_bytes(&world, manifest.is_sparse()).end() > &0);
        });
    });
}

#[test]
fn height_ranges() {
    let folder = TestFolder::new("fuzz-ranges");
    let path = folder.join(NODES_FILE);
    let worlds = worlds();
    let target =
        Target { name: "nodes", inputs: files(NODES_FILE), words: &[b"TVnodes1", b"TVnodes2"], short_round: 1000 };
    target.run(|bytes| {
        fs::write(&path, bytes).unwrap();
        let record = NodesRecord { bytes: bytes.len() as u64, crc32: crc32fast::hash(bytes) };
        within(MOST_BYTES, || {
            for (world, is_sparse) in worlds.iter().zip([false, true]) {
                let Ok(ranges) = NodeRanges::read(&path, world, &record, is_sparse) else { continue };
                let root = world.root();
                let [low, high] = ranges.range(root).unwrap();
                assert!(low <= high && low.is_finite() && high.is_finite());
                for q in 0..world.levels() {
                    assert!(ranges.nodes(q).all(|node| ranges.range(node).is_some()));
                }
            }
        });
    });
}

#[test]
fn directories() {
    let inputs = [files(ELEVATION_FILE), files(COLOR_FILE)].concat();
    // Headers and directories stand in front; all tiles together would be most of the bytes.
    let inputs = inputs.into_iter().map(|file| file[..file.len().min(4096)].to_vec()).collect();
    let target = Target { name: "directories", inputs, words: &[b"PMTiles\x03", &[0x1f, 0x8b]], short_round: 4000 };
    let part = |bytes: &[u8], range: &std::ops::Range<u64>| -> Vec<u8> {
        let at = |v: u64| usize::try_from(v).unwrap_or(usize::MAX).min(bytes.len());
        bytes[at(range.start)..at(range.end).max(at(range.start))].to_vec()
    };
    target.run(|bytes| {
        within(MOST_BYTES, || {
            // As long as it says, and as long as it is.
            for length in [bytes.len() as u64, 1 << 40] {
                let Ok(layout) = ArchiveLayout::parse(bytes, length) else { continue };
                assert!(layout.tiles().end <= length && layout.leaves().end <= length);
                let Ok(root) = layout.directory(&part(bytes, &layout.root())) else { continue };
                for tile in [0, 1, 5, 21, 85, 1 << 20, u64::MAX >> 2].into_iter().filter_map(|id| TileId::new(id).ok())
                {
                    let Ok(Some(place)) = layout.place(&root, tile) else { continue };
                    let range = match place {
                        Place::Tile(range) => range,
                        Place::Leaf { range, .. } => {
                            let Ok(leaf) = layout.directory(&part(bytes, &range)) else { continue };
                            let Ok(Some(range)) = layout.place_in_leaf(&leaf, tile) else { continue };
                            range
                        }
                    };
                    assert!(range.start <= range.end && range.end <= length);
                }
            }
        });
    });
}

/// Some tiles of a layer, as they are stored.
fn tiles(layer: Layer) -> Vec<Vec<u8>> {
    let mut all = Vec::new();
    for path in databases() {
        let database = Database::open(path).unwrap();
        let nodes = (0..database.world().levels()).flat_map(|q| database.ranges().nodes(q).take(3));
        for node in nodes {
            let mut payload = Vec::new();
            if database.read_payload(layer, node, &mut payload).is_ok() {
                all.push(payload);
            }
        }
    }
    all
}

#[test]
fn elevation_tiles() {
    let worlds = worlds();
    let target = Target {
        name: "elevation-tile",
        inputs: tiles(Layer::Elevation),
        words: &[b"TVe1", b"TVe2"],
        short_round: 4000,
    };
    let mut scratch = TileScratch::default();
    target.run(|bytes| {
        let mut mended = bytes.to_vec();
        if mended.len() > 8 {
            let checksum = crc32fast::hash(&mended[8..]);
            mended[4..8].copy_from_slice(&checksum.to_le_bytes());
        }
        for world in &worlds {
            let mut values = vec![0.0; world.elevation_values()];
            for tile in [bytes, &mended] {
                within(MOST_BYTES, || {
                    drop(check_tile(Layer::Elevation, tile));
                    let node = NodeId::new(0, 0, 0).unwrap();
                    if decode_elevation(world, node, tile, &mut values, &mut scratch).is_ok() {
                        let posts = (world.elevation_posts() as usize).pow(2);
                        assert!(values[..posts].iter().all(|height| height.is_finite()));
                    }
                });
            }
        }
    });
}

#[test]
fn color_tiles() {
    let world = worlds()[0];
    let target = Target {
        name: "color-tile",
        inputs: tiles(Layer::Color),
        words: &[&[0xff, 0xd8], &[0xff, 0xc4], &[0xff, 0xda]],
        short_round: 300,
    };
    let mut out = vec![0; color_tile_bytes(&world)];
    target.run(|bytes| {
        let mut mended = bytes[..bytes.len().saturating_sub(8)].to_vec();
        seal_color_tile(&mut mended);
        for tile in [bytes, &mended] {
            within(MOST_BYTES, || {
                drop(check_tile(Layer::Color, tile));
                drop(decode_color(&world, NodeId::new(0, 0, 0).unwrap(), tile, &mut out));
            });
        }
    });
}

#[test]
fn projections() {
    let inputs = [
        "+proj=utm +zone=33 +datum=WGS84 +units=m +no_defs",
        "+proj=tmerc +lat_0=49 +lon_0=-2 +k=0.9996012717 +x_0=400000 +y_0=-100000 +ellps=airy +towgs84=446.4,-125,542,0.15,0.247,0.842,-20.49 +units=m",
        "+proj=laea +lat_0=45 +lon_0=10 +a=3396190 +b=3376200 +units=m",
        "+proj=lcc +lat_1=33 +lat_2=45 +lat_0=23 +lon_0=-96 +datum=NAD83",
        "+proj=stere +lat_0=-90 +lat_ts=-70 +lon_0=0 +ellps=GRS80",
        // A letter of several bytes in an angle, at which `proj4rs` panics.
        "+proj=lcc +lat_1=1東2' +lat_2=45°30'9\" +lon_0=-96 +datum=NAD83",
    ];
    let inputs: Vec<Vec<u8>> = inputs.iter().map(|text| text.as_bytes().to_vec()).collect();
    let target = Target {
        name: "projection",
        inputs,
        words: &[
            b"+proj=longlat",
            b"+proj=merc",
            b"+zone=",
            b"+a=",
            b"+rf=0",
            b"+b=0",
            b"+nadgrids=x",
            b"+lat_ts=90",
            b"+k=0",
        ],
        short_round: 3000,
    };
    target.run(|bytes| {
        let text = String::from_utf8_lossy(bytes);
        within(MOST_BYTES, || {
            let lon_lat = lonlat_of_body(&text);
            let (Ok(plane), Ok(lon_lat)) = (Projection::parse(&text), Projection::parse(&lon_lat)) else { return };
            for place in [[10.0, 45.0], [-180.0, 90.0], [0.0, 0.0], [1e6, f64::NAN]] {
                drop(lon_lat.to(&plane, place));
                drop(plane.to(&lon_lat, [place[0] * 1e5, place[1] * 1e5]));
            }
        });
    });
}
