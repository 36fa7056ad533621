//! Colours of a database against the rasters that it was made of.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod support;

use gdal::raster::GdalType;
use std::path::PathBuf;
use support::{TestFolder, Tiff, colors, is_near, job, run};
use terravision_common::database::{Database, Layer, TileScratch, TileSource, color_tile_bytes};
use terravision_common::node::NodeId;
use terravision_ingest::source::Note;

fn dem(folder: &TestFolder) -> PathBuf {
    Tiff::utm([41, 41], |i, j| 100.0 + (i + j) as f32).write(&folder.path("dem.tif"))
}

/// A picture of 5 m pixels whose edges are the DEM's outer posts.
fn photo<T: GdalType + Copy + 'static>(bands: Vec<Vec<T>>) -> Tiff<'static, T> {
    let first = bands[0][0];
    Tiff { transform: Some([500_005.0, 5.0, 0.0, 4_999_995.0, 0.0, -5.0]), bands, ..Tiff::utm([80, 80], |_, _| first) }
}

/// A smooth colour per pixel: JPEG keeps it.
fn smooth(i: usize, j: usize) -> [u8; 3] {
    [40 + 2 * i as u8, 60 + j as u8, 200 - i as u8]
}

fn bands(f: impl Fn(usize, usize) -> [u8; 3]) -> Vec<Vec<u8>> {
    (0..3).map(|c| (0..80 * 80).map(|k| f(k % 80, k / 80)[c]).collect()).collect()
}

/// Compares the finest level, which has the photo's own pixels, with what is expected, `[column,
/// row]` from the north.
fn assert_finest(database: &Database, expected: impl Fn(usize, usize) -> [u8; 3], by: u8) {
    assert_eq!(database.manifest().fields().color.spacing_m, 5.0);
    let (texels, width) = colors(database, database.world().finest_color_level());
    for j in 0..80 {
        for i in 0..80 {
            let (found, expected) = (texels[j * width + i], expected(i, 79 - j));
            assert!(is_near(found, expected, by), "texel {i}, {j}: {found:?}, expected {expected:?}");
        }
    }
}

#[test]
fn a_photo_on_the_lattice_is_copied_and_has_its_north_in_the_north() {
    let folder = TestFolder::new();
    let photo = photo(bands(smooth)).write(&folder.path("photo.tif"));
    let (database, notes) = run(&job(&[dem(&folder)], &[photo], folder.path("w.tv"))).unwrap();
    assert_eq!(notes, []);
    assert_finest(&database, smooth, 6);
    assert!(database.manifest().fields().color.sources[0].is_exact);
}

#[test]
fn borders_of_tiles_are_the_neighbours_texels() {
    let folder = TestFolder::new();
    let photo = photo(bands(smooth)).write(&folder.path("photo.tif"));
    let (database, _) = run(&job(&[dem(&folder)], &[photo], folder.path("w.tv"))).unwrap();
    let (world, q) = (database.world(), database.world().finest_color_level());
    let (texels, width) = colors(&database, q);
    let stored = world.color_stored() as usize;
    let (mut tile, mut scratch) = (vec![0; color_tile_bytes(world)], TileScratch::default());
    database.read_color(NodeId::new(1, 1, q).unwrap(), &mut tile, &mut scratch).unwrap();
    for k in 0..stored * stored {
        let (x, y) = (32 + k % stored - 4, 32 + (stored - 1 - k / stored) - 4);
        if x < 80 && y < 80 {
            let found = [tile[4 * k], tile[4 * k + 1], tile[4 * k + 2]];
            assert!(is_near(found, texels[y * width + x], 8), "texel {x}, {y}: {found:?}");
        }
    }
    // The mip levels behind it are means.
    let second = &tile[stored * stored * 4..];
    let mean = |c: usize| (0..4).map(|k| u16::from(tile[((k / 2) * stored + k % 2) * 4 + c])).sum::<u16>();
    assert!((0..3).all(|c| (i32::from(second[c]) - i32::from((mean(c) + 2) / 4)).abs() <= 1));
}

#[test]
fn coarser_colours_are_filtered() {
    let folder = TestFolder::new();
    let board = |i: usize, j: usize| if (i + j).is_multiple_of(2) { [0; 3] } else { [255; 3] };
    let photo = photo(bands(board)).write(&folder.path("photo.tif"));
    let (database, _) = run(&job(&[dem(&folder)], &[photo], folder.path("w.tv"))).unwrap();
    let (texels, width) = colors(&database, database.world().finest_color_level() + 1);
    for (j, i) in (4..36).flat_map(|j| (4..36).map(move |i| (j, i))) {
        assert!(is_near(texels[j * width + i], [128; 3], 6), "{:?}", texels[j * width + i]);
    }
}

#[test]
fn alpha_masks_and_infrared_does_not() {
    let folder = TestFolder::new();
    let fourth: Vec<u8> = (0..80 * 80).map(|k| if k % 80 < 40 { 0 } else { 255 }).collect();
    let mut four = bands(|_, _| [200, 40, 40]);
    four.push(fourth);
    let infrared = Tiff { options: &["ALPHA=NO"], ..photo(four.clone()) }.write(&folder.path("infrared.tif"));
    let (database, _) = run(&job(&[dem(&folder)], &[infrared], folder.path("i.tv"))).unwrap();
    assert_finest(&database, |_, _| [200, 40, 40], 4);
    let alpha = Tiff { has_alpha: true, ..photo(four) }.write(&folder.path("alpha.tif"));
    let (database, notes) = run(&job(&[dem(&folder)], &[alpha], folder.path("a.tv"))).unwrap();
    assert!(notes.iter().any(|n| matches!(n, Note::Info(t) if t.contains("50.0 %"))), "{notes:?}");
    let (texels, width) = colors(&database, database.world().finest_color_level());
    assert!(is_near(texels[40 * width + 60], [200, 40, 40], 4));
    assert!(!is_near(texels[40 * width + 20], [200, 40, 40], 60), "{:?}", texels[40 * width + 20]);
}

#[test]
fn a_mask_band_masks() {
    let folder = TestFolder::new();
    let path = photo(bands(|_, _| [30, 60, 200])).write(&folder.path("photo.tif"));
    let options = gdal::DatasetOptions { open_flags: gdal::GdalOpenFlags::GDAL_OF_UPDATE, ..Default::default() };
    let mut dataset = gdal::Dataset::open_ex(&path, options).unwrap();
    dataset.rasterband(1).unwrap().create_mask_band(true).unwrap();
    let mask: Vec<u8> = (0..80 * 80).map(|k| if k / 80 < 20 { 0 } else { 255 }).collect();
    let band = dataset.rasterband(1).unwrap();
    band.open_mask_band().unwrap().write((0, 0), (80, 80), &mut gdal::raster::Buffer::new((80, 80), mask)).unwrap();
    dataset.flush_cache().unwrap();
    dataset.close().unwrap();
    let (database, _) = run(&job(&[dem(&folder)], &[path], folder.path("w.tv"))).unwrap();
    assert_eq!(database.manifest().fields().color.void_area_m2, 80.0 * 20.0 * 25.0);
}

#[test]
fn nodata_is_a_void_only_when_all_bands_say_so() {
    let folder = TestFolder::new();
    let f = |i: usize, _: usize| if i < 40 { [255; 3] } else { [255, 255, 60] };
    let photo = Tiff { nodata: Some(255.0), ..photo(bands(f)) }.write(&folder.path("photo.tif"));
    let (database, _) = run(&job(&[dem(&folder)], &[photo], folder.path("w.tv"))).unwrap();
    let texels = 80.0 * 40.0 * 25.0;
    assert_eq!(database.manifest().fields().color.void_area_m2, texels);
}

#[test]
fn grey_sixteen_bits_and_chosen_bands() {
    let folder = TestFolder::new();
    let grey: Vec<u16> = (0..80 * 80).map(|k| 1000 + (k % 80) as u16 * 100).collect();
    let grey = photo(vec![grey]).write(&folder.path("grey.tif"));
    let (database, notes) = run(&job(&[dem(&folder)], &[grey], folder.path("g.tv"))).unwrap();
    assert!(notes.iter().any(|n| matches!(n, Note::Info(t) if t.contains("become 0 to 255"))), "{notes:?}");
    let expected = |i: usize, _: usize| [((i as f32 * 100.0 - 100.0) * 255.0 / 7700.0).clamp(0.0, 255.0) as u8; 3];
    assert_finest(&database, expected, 6);

    let swapped = photo(bands(smooth)).write(&folder.path("bgr.tif"));
    let mut job = job(&[dem(&folder)], &[swapped], folder.path("b.tv"));
    job.bands = Some([3, 2, 1]);
    let (database, _) = run(&job).unwrap();
    assert_finest(
        &database,
        |i, j| {
            let [r, g, b] = smooth(i, j);
            [b, g, r]
        },
        6,
    );
    job.bands = Some([3, 2, 4]);
    job.may_overwrite = true;
    assert!(run(&job).unwrap_err().to_string().contains("band 4"));
}

#[test]
fn without_colour_there_is_a_tint_with_relief() {
    let folder = TestFolder::new();
    let cone = |i: usize, j: usize| 900.0 - 30.0 * ((i as f32 - 32.0).powi(2) + (j as f32 - 32.0).powi(2)).sqrt();
    let dem = Tiff::utm([65, 65], cone).write(&folder.path("dem.tif"));
    let (database, _) = run(&job(&[dem], &[], folder.path("w.tv"))).unwrap();
    assert!(database.manifest().fields().color.sources.is_empty());
    assert_eq!(database.manifest().fields().color.spacing_m, 10.0);
    let (texels, width) = colors(&database, database.world().finest_color_level());
    let brightness = |i: usize, j: usize| texels[j * width + i].iter().map(|v| u32::from(*v)).sum::<u32>();
    // Light from the north west: that side of the cone is brighter than the other, at the same
    // height.
    assert!(brightness(24, 40) > brightness(40, 24) + 60, "{} {}", brightness(24, 40), brightness(40, 24));
}

#[test]
fn colour_beside_the_elevation_is_refused() {
    let folder = TestFolder::new();
    let far = Tiff { transform: Some([700_005.0, 5.0, 0.0, 4_999_995.0, 0.0, -5.0]), ..photo(bands(smooth)) };
    let far = far.write(&folder.path("far.tif"));
    let error = run(&job(&[dem(&folder)], &[far], folder.path("w.tv"))).unwrap_err();
    assert_eq!(error.exit_code(), 2);
    assert!(error.to_string().contains("does not overlap"), "{error}");
}

#[test]
fn colour_much_finer_than_elevation_keeps_its_resolution() {
    let folder = TestFolder::new();
    let coarse = Tiff {
        transform: Some([499_900.0, 200.0, 0.0, 5_000_500.0, 0.0, -200.0]),
        ..Tiff::utm([9, 9], |i, _| i as f32)
    };
    let coarse = coarse.write(&folder.path("coarse.tif"));
    let photo = photo(bands(smooth)).write(&folder.path("photo.tif"));
    let (database, _) = run(&job(&[coarse], &[photo], folder.path("w.tv"))).unwrap();
    let world = database.world();
    assert!(world.finest_elevation_level() > 0 && world.finest_color_level() == 0);
    assert!(database.manifest().fields().color.spacing_m <= 5.4, "{}", database.manifest().fields().color.spacing_m);
    let node_at = |easting: f64, northing: f64| {
        let origin = world.fields().origin;
        let index = [easting - origin[0], northing - origin[1]].map(|v| (v / world.node_side_m(0)) as u32);
        NodeId::new(index[0], index[1], 0).unwrap()
    };
    // The picture is small: only there the finest level is made.
    assert!(database.ranges().has_tile(Layer::Color, node_at(500_200.0, 4_999_800.0)));
    assert!(database.ranges().range(node_at(501_500.0, 4_998_900.0)).is_none());
}
