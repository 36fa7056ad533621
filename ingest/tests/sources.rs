//! Files as people have them: undeclared fill and units, alpha, distances from the centre,
//! impossible places, pictures of more than eight bits.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod support;

use gdal::spatial_ref::SpatialRef;
use std::path::Path;
use support::{TestFolder, Tiff, colors, heights, is_near, job, run};
use terravision_common::database::Database;
use terravision_ingest::body::BodyChoice;
use terravision_ingest::job::Job;
use terravision_ingest::source::Note;
use terravision_ingest::source::values::NodataChoice;

fn hills(i: usize, j: usize) -> f32 {
    800.0 + 300.0 * ((i as f32) / 17.0).sin() * ((j as f32) / 23.0).cos()
}

fn warned(notes: &[Note], words: &[&str]) -> bool {
    notes.iter().any(|n| matches!(n, Note::Warning(text) if words.iter().all(|w| text.contains(w))))
}

fn noted(notes: &[Note], words: &[&str]) -> bool {
    notes.iter().any(|n| matches!(n, Note::Info(text) if words.iter().all(|w| text.contains(w))))
}

fn assert_range(database: &Database, low: f64, high: f64, by: f64) {
    let [l, h] = database.manifest().fields().elevation.range_m;
    assert!((l - low).abs() <= by && (h - high).abs() <= by, "{l} to {h}, expected {low} to {high}");
}

#[test]
fn the_stretch_of_a_plane_is_judged_where_it_is_worst() {
    let folder = TestFolder::new();
    // Web Mercator around the equator: true in the middle, and 1 / cos(29.32°) long at the centres
    // of the outermost pixels.
    let side_m = 3_503_549.0 / 20.0;
    let transform = Some([0.0, side_m, 0.0, 20.0 * side_m, 0.0, -side_m]);
    let wide = Tiff { transform, crs: Some("EPSG:3857"), ..Tiff::utm([40, 40], hills) }.write(&folder.path("wide.tif"));
    let notes = run(&job(&[wide], &[], folder.path("w.tv"))).unwrap().1;
    assert!(warned(&notes, &["Mercator", "1.15 times", "wide.tif"]), "{notes:?}");
    assert!(warned(&notes, &["latitude 29.3"]) || warned(&notes, &["latitude -29.3"]), "{notes:?}");
    // The same pixels within five degrees of it: no more than 0.4 %.
    let near = Some([0.0, side_m / 6.0, 0.0, 20.0 * side_m / 6.0, 0.0, -side_m / 6.0]);
    let near = Tiff { transform: near, crs: Some("EPSG:3857"), ..Tiff::utm([40, 40], hills) };
    let notes = run(&job(&[near.write(&folder.path("near.tif"))], &[], folder.path("n.tv"))).unwrap().1;
    assert!(!warned(&notes, &["times those on the ground"]), "{notes:?}");
}

#[test]
fn a_globe_from_0_to_360_degrees_has_the_posts_of_one_from_180_west() {
    let folder = TestFolder::new();
    let globe = |west: f64, south: f64, step: f64, name: &str| {
        let (width, height) = ((360.0 / step).round() as usize, ((90.0 - south) / step).round() as usize);
        let north = if south == -90.0 { 90.0 } else { -south };
        let height = if south == -90.0 { height } else { (2.0 * north / step).round() as usize };
        let ground = |i: usize, j: usize| {
            let (lon, lat) = (west + (i as f64 + 0.5) * step, north - (j as f64 + 0.5) * step);
            (1000.0 * lon.to_radians().sin() * lat.to_radians().cos()) as f32
        };
        let transform = Some([west, step, 0.0, north, 0.0, -step]);
        let tiff = Tiff { transform, crs: Some("EPSG:4326"), ..Tiff::utm([width, height], ground) };
        let path = tiff.write(&folder.path(name));
        let job = job(&[path], &[], folder.path(&format!("{name}.tv")));
        run(&Job { body: BodyChoice::Plane, ..job }).unwrap().0
    };
    let west = globe(-180.0, -90.0, 1.0, "west.tif");
    let east = globe(0.0, -90.0, 1.0, "east.tif");
    assert_eq!(west.world().fields(), east.world().fields());
    assert_eq!(west.manifest().fields().elevation.spacing_m, 111_000.0);
    let band = globe(0.0, -60.0, 1.0, "band.tif");
    assert_eq!(band.manifest().fields().elevation.spacing_m, 111_000.0);
    // The same ground, too; where the file of longitudes 0 to 360 ends, its last samples are
    // repeated.
    let [a, b] = [&west, &east].map(|d| heights(d, 0).0);
    assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 10.0));
}

#[test]
fn a_second_value_for_no_data_is_found_beside_the_declared_one() {
    let folder = TestFolder::new();
    for (name, declared, used) in [
        ("a", -32768.0, 32767.0),
        ("b", -9999.0, -32768.0),
        ("c", -3.402_823_466_385_288_6e38, -9999.0),
        ("d", 0.0, -9999.0),
    ] {
        let f = |i: usize, j: usize| match (i, j) {
            (50..54, 40..44) => used as f32,
            (110.., 90..) => declared as f32,
            _ => hills(i, j),
        };
        let dem =
            Tiff { nodata: Some(declared), ..Tiff::utm([120, 100], f) }.write(&folder.path(&format!("{name}.tif")));
        let (database, notes) = run(&job(std::slice::from_ref(&dem), &[], folder.path(&format!("{name}.tv")))).unwrap();
        assert!(warned(&notes, &["16 samples", &format!("--nodata {used}")]), "{notes:?}");
        assert_range(&database, 500.0, 1100.0, 2.0);
        // Both areas are told as one.
        assert_eq!(database.manifest().fields().elevation.void_area_m2, (16.0 + 100.0) * 100.0);
        let mut kept = job(&[dem], &[], folder.path(&format!("{name}-kept.tv")));
        kept.nodata = NodataChoice::OnlyDeclared;
        let (database, _) = run(&kept).unwrap();
        let [low, high] = database.manifest().fields().elevation.range_m;
        assert!(low == used || high == used, "{low} to {high}");
    }
}

#[test]
fn alpha_says_where_elevation_is() {
    let folder = TestFolder::new();
    let size = [120, 100];
    let band = |f: &dyn Fn(usize, usize) -> f32| (0..size[0] * size[1]).map(|k| f(k % size[0], k / size[0])).collect();
    let ground: Vec<f32> = band(&|i, j| if i < 40 { -9999.0 } else { hills(i, j) });
    let alpha: Vec<f32> = band(&|i, _| if i < 40 { 0.0 } else { 255.0 });
    let dem = Tiff { bands: vec![ground, alpha], has_alpha: true, ..Tiff::utm(size, |_, _| 0.0) };
    let dem = dem.write(&folder.path("dem.tif"));
    let (database, notes) = run(&job(&[dem], &[], folder.path("w.tv"))).unwrap();
    assert!(noted(&notes, &["33.3 %"]) && !notes.iter().any(|n| matches!(n, Note::Warning(_))), "{notes:?}");
    assert_range(&database, 500.0, 1100.0, 2.0);
    assert_eq!(database.manifest().fields().elevation.void_area_m2, 40.0 * 100.0 * 100.0);
}

#[test]
fn heights_over_a_plane_in_feet_are_feet() {
    let folder = TestFolder::new();
    // State Plane in US survey feet; nothing vertical.
    let transform = Some([1_200_000.0, 30.0, 0.0, 600_000.0, 0.0, -30.0]);
    let feet = |i: usize, j: usize| hills(i, j) / 0.304_800_6;
    let dem = Tiff { transform, crs: Some("EPSG:2927"), ..Tiff::utm([60, 50], feet) }.write(&folder.path("feet.tif"));
    let (database, notes) = run(&job(std::slice::from_ref(&dem), &[], folder.path("w.tv"))).unwrap();
    assert!(noted(&notes, &["US survey foot", "--elevation-unit"]), "{notes:?}");
    let expected: Vec<f32> = (0..60 * 50).map(|k| hills(k % 60, k / 60)).collect();
    let (low, high) = expected.iter().fold((f32::MAX, f32::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
    assert_range(&database, f64::from(low), f64::from(high), 3.0);
    let mut metres = job(&[dem], &[], folder.path("m.tv"));
    metres.elevation_unit_m = Some(1.0);
    let (database, _) = run(&metres).unwrap();
    assert_range(&database, f64::from(low) / 0.3048, f64::from(high) / 0.3048, 10.0);
}

#[test]
fn heights_that_no_ground_has_are_told() {
    let folder = TestFolder::new();
    let cm = Tiff::utm([60, 50], |i, j| (hills(i, j) * 20.0 + 20_000.0) as u16).write(&folder.path("cm.tif"));
    let (_, notes) = run(&job(std::slice::from_ref(&cm), &[], folder.path("cm.tv"))).unwrap();
    assert!(
        warned(&notes, &["36,000", "Earth", "--elevation-unit cm"]) || warned(&notes, &["Earth", "-11,100", "9,000"]),
        "{notes:?}"
    );
    let mut told = job(&[cm], &[], folder.path("told.tv"));
    told.elevation_unit_m = Some(0.01);
    let (_, notes) = run(&told).unwrap();
    assert_eq!(notes, []);

    let mm = Tiff::utm([60, 50], |i, j| if i < 60 { 590_000 + 1000 * (i + j) as i32 } else { 0 });
    let mm = mm.write(&folder.path("mm.tif"));
    let error = run(&job(std::slice::from_ref(&mm), &[], folder.path("mm.tv"))).unwrap_err();
    let text = error.to_string();
    assert_eq!(error.exit_code(), 2);
    assert!(text.contains("590,000") && text.contains("698,000") && text.contains("--elevation-unit"), "{text}");
    let mut told = job(&[mm], &[], folder.path("mm.tv"));
    told.elevation_unit_m = Some(0.001);
    assert_range(&run(&told).unwrap().0, 590.0, 698.0, 0.01);

    // Some beyond: they are voids, and told.
    let some = Tiff::utm([60, 50], |i, _| if i == 7 { 150_000.0f32 } else { 100.0 }).write(&folder.path("some.tif"));
    let (_, notes) = run(&job(&[some], &[], folder.path("some.tv"))).unwrap();
    assert!(warned(&notes, &["50 samples of 150,000", "±100 km"]), "{notes:?}");
}

#[test]
fn distances_from_the_centre_become_heights() {
    let folder = TestFolder::new();
    let moon = "GEOGCS[\"Moon\",DATUM[\"D_Moon\",SPHEROID[\"Moon\",1737400,0]],PRIMEM[\"Reference Meridian\",0],UNIT[\"degree\",0.0174532925199433]]";
    let wave = |i: usize, j: usize| 2000.0 * ((i as f32) / 9.0).sin() * ((j as f32) / 7.0).cos();
    let transform = Some([-180.0, 5.0, 0.0, 90.0, 0.0, -5.0]);
    let tiff = |f: &dyn Fn(usize, usize) -> f32| Tiff { transform, crs: Some(moon), ..Tiff::utm([72, 36], f) };
    let heights_path = tiff(&wave).write(&folder.path("heights.tif"));
    let radii_path = tiff(&|i, j| 1_737_400.0 + wave(i, j)).write(&folder.path("radii.tif"));
    let (heights_world, notes) = run(&job(&[heights_path], &[], folder.path("heights.tv"))).unwrap();
    assert!(!noted(&notes, &["centre"]), "{notes:?}");
    let (radii_world, notes) = run(&job(&[radii_path], &[], folder.path("radii.tv"))).unwrap();
    assert!(noted(&notes, &["distances from the centre", "1,737,400 m are taken off"]), "{notes:?}");
    let [low, high] = heights_world.manifest().fields().elevation.range_m;
    // Distances are stored to an eighth of a metre.
    assert_range(&radii_world, low, high, 0.2);

    // A flattened body: no number can be taken off everywhere.
    let earth = Tiff { transform, crs: Some("EPSG:4326"), ..Tiff::utm([72, 36], |i, j| 6_371_000.0 + wave(i, j)) };
    let error = run(&job(&[earth.write(&folder.path("earth.tif"))], &[], folder.path("earth.tv"))).unwrap_err();
    assert!(error.to_string().contains("distances from the centre"), "{error}");
}

/// The colours in the middle and at the right of a picture over flat ground.
fn shown<T: gdal::raster::GdalType + Copy + 'static>(
    folder: &TestFolder,
    name: &str,
    bands: Vec<Vec<T>>,
    has_alpha: bool,
) -> ([[u8; 3]; 2], f64, Vec<Note>) {
    let first = bands[0][0];
    let picture = Tiff {
        transform: Some([500_005.0, 5.0, 0.0, 4_999_995.0, 0.0, -5.0]),
        options: &["PHOTOMETRIC=RGB"],
        bands,
        has_alpha,
        ..Tiff::utm([80, 80], |_, _| first)
    };
    let picture = picture.write(&folder.path(&format!("{name}.tif")));
    let dem = Tiff::utm([41, 41], |_, _| 500.0f32).write(&folder.path("dem.tif"));
    let (database, notes) = run(&job(&[dem], &[picture], folder.path(&format!("{name}.tv")))).unwrap();
    let (texels, width) = colors(&database, database.world().finest_color_level());
    ([texels[40 * width + 40], texels[40 * width + 70]], database.manifest().fields().color.void_area_m2, notes)
}

fn two_colors(i: usize) -> [u8; 3] {
    if i < 60 { [120, 160, 80] } else { [200, 60, 60] }
}

fn bands<T>(f: impl Fn(usize, usize, u8) -> T) -> Vec<Vec<T>> {
    (0..3).map(|c| (0..80 * 80).map(|k| f(k % 80, k / 80, two_colors(k % 80)[c])).collect()).collect()
}

#[test]
fn a_glint_does_not_make_a_picture_of_fractions_black() {
    let folder = TestFolder::new();
    let reflectance = |v: u8| f32::from(v) / 255.0 * 0.5;
    let (plain, _, _) = shown(&folder, "plain", bands(|_, _, v| reflectance(v)), false);
    assert!(is_near(plain[0], [60, 80, 40], 3) && is_near(plain[1], [100, 30, 30], 3), "{plain:?}");
    let glint = |i: usize, j: usize, v: u8| if i < 2 && j < 2 { 1.3 } else { reflectance(v) };
    let (glinting, _, notes) = shown(&folder, "glint", bands(glint), false);
    assert!(noted(&notes, &["0 to 1 become 0 to 255"]), "{notes:?}");
    assert!(is_near(glinting[0], plain[0], 3) && is_near(glinting[1], plain[1], 3), "{glinting:?}");
    // Reflectance that often exceeds 1 is stretched, never taken for eight bits.
    let (bright, _, notes) = shown(&folder, "bright", bands(|_, _, v| reflectance(v) * 3.0), false);
    assert!(!noted(&notes, &["fit already"]), "{notes:?}");
    assert!(u32::from(bright[0][1]) > 100, "{bright:?}");
}

#[test]
fn only_what_is_shown_decides_the_stretch() {
    let folder = TestFolder::new();
    let mut masked = bands(|i, _, v| if i < 20 { 65_535u16 } else { u16::from(v) * 40 });
    masked.push((0..80 * 80).map(|k| if k % 80 < 20 { 0 } else { 65_535 }).collect());
    let (colors, void, notes) = shown(&folder, "alpha", masked, true);
    assert!(noted(&notes, &["2400 to 8000 become 0 to 255"]), "{notes:?}");
    assert_eq!(void, 20.0 * 80.0 * 25.0);
    assert!(is_near(colors[1], [255, 0, 0], 4), "{colors:?}");
    let filled = bands(|i, _, v| if i < 20 { -9999i16 } else { i16::from(v) * 40 });
    let (colors, void, notes) = shown(&folder, "fill", filled, false);
    assert!(noted(&notes, &["2400 to 8000 become 0 to 255"]) && warned(&notes, &["-9999"]), "{notes:?}");
    assert_eq!(void, 20.0 * 80.0 * 25.0);
    assert!(is_near(colors[1], [255, 0, 0], 4), "{colors:?}");
}

fn at(folder: &TestFolder, name: &str, crs: &str, x: f64, y: f64, step: f64) -> Job {
    let tiff = Tiff { transform: Some([x, step, 0.0, y, 0.0, -step]), crs: Some(crs), ..Tiff::utm([50, 50], hills) };
    let path = tiff.write(&folder.path(&format!("{name}.tif")));
    job(&[path], &[], folder.path(&format!("{name}.tv")))
}

#[test]
fn places_outside_the_area_of_use_are_told() {
    let folder = TestFolder::new();
    let (_, notes) = run(&at(&folder, "swapped", "EPSG:2056", 1_200_000.0, 2_600_000.0, 10.0)).unwrap();
    assert!(warned(&notes, &["area of use of EPSG:2056", "45.8 to 47.8 N", "is the CRS right?"]), "{notes:?}");
    let (_, notes) = run(&at(&folder, "prefix", "EPSG:25832", 32_500_000.0, 5_200_000.0, 10.0)).unwrap();
    assert!(warned(&notes, &["area of use of EPSG:25832 (6 to 12 E, 38.8 to 84.3 N)"]), "{notes:?}");
    let (_, notes) = run(&at(&folder, "right", "EPSG:25832", 500_000.0, 5_200_000.0, 10.0)).unwrap();
    assert_eq!(notes, []);
    // In the neighbouring zone, not a degree away.
    let (_, notes) = run(&at(&folder, "beside", "EPSG:32632", 760_000.0, 5_200_000.0, 10.0)).unwrap();
    assert_eq!(notes, []);
    let error = run(&at(&folder, "degrees", "EPSG:32632", 10.0, 47.0, 1.0 / 3600.0)).unwrap_err();
    assert!(error.to_string().contains("degrees") && error.to_string().contains("EPSG:32632"), "{error}");
    let error = run(&at(&folder, "latitude", "EPSG:4326", 47.0, 120.0, 0.01)).unwrap_err();
    assert!(error.to_string().contains("latitudes from 119.5 to 120.0"), "{error}");
    let mut chosen = at(&folder, "chosen", "EPSG:25832", 500_000.0, 5_200_000.0, 10.0);
    chosen.crs = Some("EPSG:32610".to_owned());
    let (_, notes) = run(&chosen).unwrap();
    assert!(warned(&notes, &["--crs EPSG:32610"]), "{notes:?}");
}

fn with_control_points(path: &Path, points: Vec<gdal::Gcp>) {
    Tiff { transform: None, crs: None, ..Tiff::utm([100, 100], |_, _| 500.0f32) }.write(path);
    let options = gdal::DatasetOptions { open_flags: gdal::GdalOpenFlags::GDAL_OF_UPDATE, ..Default::default() };
    let dataset = gdal::Dataset::open_ex(path, options).unwrap();
    dataset.set_gcps(points, &SpatialRef::from_epsg(4326).unwrap()).unwrap();
    dataset.close().unwrap();
}

#[test]
fn bent_rasters_are_refused_with_the_command_that_straightens_them() {
    let folder = TestFolder::new();
    let point = |row: f64, column: f64, bend: f64| gdal::Gcp {
        id: String::new(),
        info: String::new(),
        pixel: column,
        line: row,
        x: 10.0 + column * 1e-3 + bend * row * column,
        y: 47.0 - row * 1e-3 + 0.5 * bend * row * column,
        z: 0.0,
    };
    let points = |bend: f64| -> Vec<_> {
        (0..9).map(|k| point(f64::from(k / 3) * 50.0, f64::from(k % 3) * 50.0, bend)).collect()
    };
    let bent = folder.path("bent.tif");
    with_control_points(&bent, points(2e-6));
    let text = run(&job(&[bent], &[], folder.path("bent.tv"))).unwrap_err().to_string();
    assert!(
        text.contains("9 control points lie on no affine map") && text.contains("gdalwarp -t_srs EPSG:4326"),
        "{text}"
    );
    let straight = folder.path("straight.tif");
    with_control_points(&straight, points(0.0));
    run(&job(&[straight], &[], folder.path("straight.tv"))).unwrap();

    let rpc = folder.path("rpc.tif");
    Tiff { transform: None, crs: None, ..Tiff::utm([100, 100], |_, _| 500.0f32) }.write(&rpc);
    let options = gdal::DatasetOptions { open_flags: gdal::GdalOpenFlags::GDAL_OF_UPDATE, ..Default::default() };
    let mut dataset = gdal::Dataset::open_ex(&rpc, options).unwrap();
    let twenty = |first: &str| format!("{first}{}", " 0".repeat(19));
    for (key, value) in [
        ("LINE_OFF", "50".to_owned()),
        ("SAMP_OFF", "50".to_owned()),
        ("LAT_OFF", "47".to_owned()),
        ("LONG_OFF", "10".to_owned()),
        ("HEIGHT_OFF", "0".to_owned()),
        ("LINE_SCALE", "50".to_owned()),
        ("SAMP_SCALE", "50".to_owned()),
        ("LAT_SCALE", "1".to_owned()),
        ("LONG_SCALE", "1".to_owned()),
        ("HEIGHT_SCALE", "500".to_owned()),
        ("LINE_NUM_COEFF", twenty("0")),
        ("LINE_DEN_COEFF", twenty("1")),
        ("SAMP_NUM_COEFF", twenty("0")),
        ("SAMP_DEN_COEFF", twenty("1")),
    ] {
        gdal::Metadata::set_metadata_item(&mut dataset, key, &value, "RPC").unwrap();
    }
    dataset.close().unwrap();
    let text = run(&job(&[rpc], &[], folder.path("rpc.tv"))).unwrap_err().to_string();
    assert!(text.contains("RPC") && text.contains("gdalwarp -rpc"), "{text}");
}
