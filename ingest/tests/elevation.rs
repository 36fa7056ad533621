//! Heights of a database against the rasters that it was made of.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod support;

use support::{TestFolder, Tiff, UTM, heights, job, run};
use terravision_common::database::{TileScratch, TileSource, Voids, VoidsRecord};
use terravision_common::ground::{ground_at, ground_height};
use terravision_common::node::NodeId;
use terravision_common::validity::Validity;
use terravision_ingest::source::Note;
use terravision_ingest::source::values::NodataChoice;

fn rough(i: usize, j: usize) -> f32 {
    let noise = (i * 7919 + j * 104_729) % 997;
    100.0 + i as f32 * 1.37 + j as f32 * 0.73 + noise as f32 * 0.11
}

#[test]
fn a_raster_on_its_own_lattice_is_copied_to_a_128th_of_a_metre() {
    let folder = TestFolder::new();
    let dem = Tiff::utm([53, 37], rough).write(&folder.path("dem.tif"));
    let (database, notes) = run(&job(&[dem], &[], folder.path("w.tv"))).unwrap();
    assert_eq!(notes, []);
    let fields = database.world().fields();
    assert_eq!(fields.origin, [500_005.0, 5_000_000.0 - 365.0]);
    assert_eq!((fields.extent, fields.lattice_unit_m), ([52, 36], 10.0));
    let (posts, width) = heights(&database, 0);
    for j in 0..37 {
        for i in 0..53 {
            let height = posts[j * width + i];
            assert!((height - rough(i, 36 - j)).abs() <= 1.0 / 256.0 + 1e-4, "post {i}, {j}");
            assert_eq!(height * 128.0, (height * 128.0).round());
        }
    }
    // Beyond the extent the border is repeated.
    assert_eq!(posts[5 * width + 55], posts[5 * width + 52]);
    assert!(database.manifest().fields().elevation.sources[0].is_exact);
}

#[test]
fn coarser_levels_are_filtered_and_share_their_borders() {
    let folder = TestFolder::new();
    let dem = Tiff::utm([70, 90], |i, j| if (i + j) % 2 == 0 { 50.0f32 } else { 150.0 }).write(&folder.path("dem.tif"));
    let (database, _) = run(&job(&[dem], &[], folder.path("w.tv"))).unwrap();
    // Level by level, inside: the finest pattern is gone at once. (`heights` checks the borders.)
    for q in 1..database.world().levels() {
        let (posts, width) = heights(&database, q);
        let side = 1usize << q;
        let inside = |v: usize, count: usize| v * side >= 16 && v * side + 16 < count;
        for (k, height) in posts.iter().enumerate().filter(|(k, _)| inside(k % width, 70) && inside(k / width, 90)) {
            assert!((height - 100.0).abs() < 0.5, "level {q}, post {k}: {height}");
        }
    }
}

#[test]
fn ranges_bound_the_ground_of_every_level_under_a_node() {
    let folder = TestFolder::new();
    let dem = Tiff::utm([61, 45], rough).write(&folder.path("dem.tif"));
    let (database, _) = run(&job(&[dem], &[], folder.path("w.tv"))).unwrap();
    let world = database.world();
    let levels: Vec<_> = (0..world.levels()).map(|q| heights(&database, q)).collect();
    let ground = |q: u8, x: f64, y: f64| {
        let (posts, width) = &levels[usize::from(q)];
        let spacing = f64::from(1u32 << q);
        let (i, j) = ((x / spacing) as usize, (y / spacing) as usize);
        let (u, v) = (x / spacing - i as f64, y / spacing - j as f64);
        let z = |di: usize, dj: usize| {
            f64::from(posts[(j + dj).min(posts.len() / width - 1) * width + (i + di).min(width - 1)])
        };
        if u >= v {
            z(0, 0) + u * (z(1, 0) - z(0, 0)) + v * (z(1, 1) - z(1, 0))
        } else {
            z(0, 0) + v * (z(0, 1) - z(0, 0)) + u * (z(1, 1) - z(0, 1))
        }
    };
    for q in 0..world.levels() {
        let [columns, rows] = world.nodes_at(q);
        for (m, n) in (0..rows).flat_map(|n| (0..columns).map(move |m| (m, n))) {
            let node = NodeId::new(m, n, q).unwrap();
            let [low, high] = database.ranges().range(node).unwrap().map(f64::from);
            let side = world.node_side(q) as f64;
            for k in 0..17 * 17 {
                let x = (f64::from(m) + f64::from(k % 17) / 16.0) * side;
                let y = (f64::from(n) + f64::from(k / 17) / 16.0) * side;
                if x > 60.0 || y > 44.0 {
                    continue;
                }
                for level in 0..world.levels() {
                    let z = ground(level, x, y);
                    assert!(low <= z && z <= high, "level {level} at {x}, {y} is {z}, beyond {low}..{high} of {node}");
                }
            }
        }
    }
    assert_eq!(database.ranges().range(NodeId::new(9, 0, 0).unwrap()), None);
}

#[test]
fn pixel_is_point_and_pixel_is_area_are_half_a_pixel_apart() {
    let folder = TestFolder::new();
    let area = Tiff::utm([20, 20], rough).write(&folder.path("area.tif"));
    // What the user sees as the tie point differs by half a pixel; GDAL's geotransform is corner
    // based in both.
    let point = Tiff { is_point: true, ..Tiff::utm([20, 20], rough) }.write(&folder.path("point.tif"));
    let worlds =
        [("a.tv", area), ("p.tv", point)].map(|(name, dem)| run(&job(&[dem], &[], folder.path(name))).unwrap().0);
    assert_eq!(worlds[0].world().fields(), worlds[1].world().fields());
}

#[test]
fn voids_are_filled_and_their_area_is_told() {
    let folder = TestFolder::new();
    let hole = |i: usize, j: usize| (20..30).contains(&i) && (15..25).contains(&j);
    let plane = |i: usize, j: usize| 300.0 + i as f32 - 2.0 * j as f32;
    let dem =
        Tiff { nodata: Some(-9999.0), ..Tiff::utm([60, 50], |i, j| if hole(i, j) { -9999.0 } else { plane(i, j) }) };
    let dem = dem.write(&folder.path("dem.tif"));
    let (database, notes) = run(&job(&[dem], &[], folder.path("w.tv"))).unwrap();
    assert!(matches!(&notes[..], [Note::Info(text)] if text.contains("0.010 km²")), "{notes:?}");
    assert_eq!(database.manifest().fields().elevation.void_area_m2, 100.0 * 100.0);
    let (posts, width) = heights(&database, 0);
    for j in 0..50 {
        for i in 0..60 {
            let (found, expected) = (posts[j * width + i], plane(i, 49 - j));
            let tolerance = if hole(i, 49 - j) { 3.0 } else { 0.004 };
            assert!((found - expected).abs() <= tolerance, "post {i}, {j}: {found}, expected {expected}");
        }
    }
}

#[test]
fn voids_are_holes_or_filled_as_asked_and_their_heights_are_the_same() {
    let folder = TestFolder::new();
    // A lake, and a wedge that reaches the border.
    let lake = |i: usize, j: usize| (60..80).contains(&i) && (40..55).contains(&j);
    let wedge = |i: usize, j: usize| i + j < 50;
    let height = |i: usize, j: usize| 300.0 + 0.5 * i as f32 + 0.25 * j as f32;
    let f = |i: usize, j: usize| if lake(i, j) || wedge(i, j) { -9999.0 } else { height(i, j) };
    let dem = Tiff { nodata: Some(-9999.0), ..Tiff::utm([120, 100], f) }.write(&folder.path("dem.tif"));
    let worlds = [Voids::Fill, Voids::Keep, Voids::Clip].map(|voids| {
        let mut job = job(std::slice::from_ref(&dem), &[], folder.path(&format!("{}.tv", voids.name())));
        job.voids = voids;
        (voids, run(&job).unwrap().0)
    });
    let wedge_m2 = 100.0 * (50.0 * 51.0 / 2.0);
    let void_m2 = wedge_m2 + 100.0 * 20.0 * 15.0;
    let levels = worlds[0].1.world().levels();
    for (voids, database) in &worlds {
        let manifest = database.manifest().fields();
        assert_eq!((manifest.format_version, manifest.elevation.void_area_m2), (2, void_m2));
        let expected = match voids {
            Voids::Fill => 0.0,
            Voids::Keep => void_m2,
            Voids::Clip => wedge_m2,
        };
        assert_eq!(manifest.elevation.voids, Some(VoidsRecord { mode: *voids, hole_area_m2: expected }));
        assert_eq!((database.world().has_validity(), database.world().has_holes()), (true, expected > 0.0));
        for q in 0..levels {
            assert!(heights(database, q) == heights(&worlds[0].1, q), "{voids:?}, level {q}");
        }
        // Columns from the west, rows from the north.
        for (i, j) in [(5, 5), (48, 0), (51, 0), (25, 24), (26, 26), (62, 45), (59, 45), (81, 45), (119, 99)] {
            let (x, y) = (10.0 * i as f64, 10.0 * (99 - j) as f64);
            let ground = ground_at(database, database.world(), x, y, &mut TileScratch::default()).unwrap().unwrap();
            let of_hole = |is_hole: bool| if is_hole { Validity::Hole } else { Validity::MadeUp };
            let expected = match (lake(i, j), wedge(i, j)) {
                (true, _) => of_hole(*voids == Voids::Keep),
                (_, true) => of_hole(*voids != Voids::Fill),
                _ => Validity::Measured,
            };
            assert_eq!(ground.validity, expected, "{voids:?} at {i}, {j}");
        }
    }
}

#[test]
fn a_world_without_voids_says_nothing_of_them() {
    let folder = TestFolder::new();
    let dem = Tiff::utm([40, 40], rough).write(&folder.path("dem.tif"));
    let mut plain = job(std::slice::from_ref(&dem), &[], folder.path("a.tv"));
    run(&plain).unwrap();
    let text = std::fs::read_to_string(folder.path("a.tv").join("manifest.json")).unwrap();
    assert!(
        text.contains("\"format_version\": 1,") && !text.contains("features") && !text.contains("voids\""),
        "{text}"
    );
    let tile = std::fs::read(folder.path("a.tv").join("elevation.pmtiles")).unwrap();
    assert!(!tile.windows(4).any(|bytes| bytes == b"TVe2"));
    (plain.voids, plain.output) = (Voids::Keep, folder.path("b.tv"));
    run(&plain).unwrap();
    let again = std::fs::read(folder.path("b.tv").join("elevation.pmtiles")).unwrap();
    // The archives' metadata have the worlds' names, which are as long.
    assert_eq!(again.len(), tile.len());
}

#[test]
fn undeclared_sentinels_are_voids_with_a_warning_unless_the_user_says_otherwise() {
    let folder = TestFolder::new();
    let f = |i: usize, j: usize| if i < 5 && j < 5 { -32768i16 } else { 400 + (i + j) as i16 };
    let dem = Tiff::utm([40, 40], f).write(&folder.path("dem.tif"));
    let (database, notes) = run(&job(std::slice::from_ref(&dem), &[], folder.path("a.tv"))).unwrap();
    assert!(notes.iter().any(|n| matches!(n, Note::Warning(t) if t.contains("--nodata -32768"))), "{notes:?}");
    assert_eq!(database.manifest().fields().elevation.range_m[0], 404.0 + 1.0);
    let mut said = job(std::slice::from_ref(&dem), &[], folder.path("b.tv"));
    said.nodata = NodataChoice::Value(-32768.0);
    let (_, notes) = run(&said).unwrap();
    assert!(!notes.iter().any(|n| matches!(n, Note::Warning(_))), "{notes:?}");
    said.nodata = NodataChoice::OnlyDeclared;
    said.output = folder.path("c.tv");
    let (database, _) = run(&said).unwrap();
    assert_eq!(database.manifest().fields().elevation.range_m[0], -32768.0);
}

#[test]
fn a_value_among_its_like_is_no_sentinel() {
    let folder = TestFolder::new();
    let dem = Tiff::utm([64, 64], |i, j| -10_100.0 + (i * 64 + j) as f32 / 16.0).write(&folder.path("dem.tif"));
    let (database, notes) = run(&job(&[dem], &[], folder.path("w.tv"))).unwrap();
    assert_eq!(notes, []);
    assert_eq!(database.manifest().fields().elevation.void_area_m2, 0.0);
}

#[test]
fn feet_become_metres() {
    let folder = TestFolder::new();
    let dem = Tiff::utm([20, 20], |i, _| 1000.0 + i as f32).write(&folder.path("dem.tif"));
    let mut feet = job(&[dem], &[], folder.path("w.tv"));
    feet.elevation_unit_m = Some(0.3048);
    let (database, _) = run(&feet).unwrap();
    assert!((database.manifest().fields().elevation.range_m[0] - 304.8).abs() < 0.005);
    // A compound CRS says so by itself: NAD83 / UTM 11N with NAVD88 heights in US survey feet.
    let compound = Tiff { crs: Some("EPSG:26911+6360"), ..Tiff::utm([20, 20], |i, _| 1000.0 + i as f32) };
    let dem = compound.write(&folder.path("compound.tif"));
    let (database, notes) = run(&job(&[dem], &[], folder.path("c.tv"))).unwrap();
    assert!((database.manifest().fields().elevation.range_m[0] - 304.8006).abs() < 0.005, "{notes:?}");
}

#[test]
fn south_up_and_rotated_rasters_lie_where_they_say() {
    let folder = TestFolder::new();
    let plane = |x: f64, y: f64| (0.01 * (x - 500_000.0) + 0.02 * (y - 5_000_000.0)) as f32 + 500.0;
    let at = |t: [f64; 6]| {
        move |i: usize, j: usize| {
            let (c, r) = (i as f64 + 0.5, j as f64 + 0.5);
            plane(t[0] + t[1] * c + t[2] * r, t[3] + t[4] * c + t[5] * r)
        }
    };
    let south_up = [500_000.0, 10.0, 0.0, 5_000_000.0, 0.0, 10.0];
    let rotated = [500_000.0, 8.0, 6.0, 5_000_000.0, 6.0, -8.0];
    for (name, transform) in [("south.tif", south_up), ("rotated.tif", rotated)] {
        let dem = Tiff { transform: Some(transform), ..Tiff::utm([80, 80], at(transform)) }.write(&folder.path(name));
        let (database, _) = run(&job(&[dem], &[], folder.path(&format!("{name}.tv")))).unwrap();
        let [ox, oy] = database.world().fields().origin;
        let middle =
            [transform[0] + 40.0 * (transform[1] + transform[2]), transform[3] + 40.0 * (transform[4] + transform[5])];
        let (x, y) = (middle[0] - ox, middle[1] - oy);
        let found = ground_height(&database, database.world(), x, y, &mut TileScratch::default()).unwrap().unwrap();
        assert!((found - f64::from(plane(middle[0], middle[1]))).abs() < 0.02, "{name}: {found}");
        let outside = ground_height(&database, database.world(), -1.0, 0.0, &mut TileScratch::default()).unwrap();
        assert_eq!(outside, None);
    }
}

#[test]
fn neighbouring_files_make_one_world_and_the_first_is_on_top() {
    let folder = TestFolder::new();
    let shifted = |east: f64| Some([500_000.0 + east, 10.0, 0.0, 5_000_000.0, 0.0, -10.0]);
    let west = Tiff::utm([30, 30], |_, _| 100.0f32).write(&folder.path("west.tif"));
    let east =
        Tiff { transform: shifted(200.0), ..Tiff::utm([30, 30], |_, _| 200.0f32) }.write(&folder.path("east.tif"));
    let (database, _) = run(&job(&[west, east], &[], folder.path("w.tv"))).unwrap();
    assert_eq!(database.world().extent(), [49, 29]);
    let (posts, width) = heights(&database, 0);
    assert_eq!((posts[10 * width + 29], posts[10 * width + 30], posts[10 * width + 49]), (100.0, 200.0, 200.0));
}

#[test]
fn there_may_be_more_files_than_a_process_may_have_open() {
    let folder = TestFolder::new();
    let plane = |i: usize, j: usize| 1.0 + i as f32 * 0.25 + j as f32 * 0.5;
    let file = |k: usize| {
        let (x, y) = (k % 36 * 8, k / 36 * 8);
        let transform = Some([500_000.0 + 10.0 * x as f64, 10.0, 0.0, 5_000_000.0 - 10.0 * y as f64, 0.0, -10.0]);
        let tiff = Tiff { transform, ..Tiff::utm([8, 8], |i, j| plane(x + i, y + j)) };
        tiff.write(&folder.path(&format!("{k}.tif")))
    };
    let files: Vec<_> = (0..36 * 36).map(file).collect();
    let (database, _) = run(&job(&files, &[], folder.path("w.tv"))).unwrap();
    let (posts, width) = heights(&database, 0);
    assert!((0..288 * 288).all(|k| posts[k / 288 * width + k % 288] == plane(k % 288, 287 - k / 288)));
}

#[test]
fn degrees_are_resampled_into_the_utm_zone() {
    let folder = TestFolder::new();
    let step = 1.0 / 3600.0;
    let transform = Some([9.0 - 0.5 * step, step, 0.0, 47.0 + 0.5 * step, 0.0, -step]);
    // Heights are a plane in degrees: resampling must give it back anywhere.
    let dem =
        Tiff { transform, crs: Some("EPSG:4326"), ..Tiff::utm([200, 150], |i, j| 1000.0 + i as f32 * 2.0 + j as f32) };
    let dem = dem.write(&folder.path("dem.tif"));
    let (database, notes) = run(&job(&[dem], &[], folder.path("w.tv"))).unwrap();
    assert!(matches!(&notes[0], Note::Info(text) if text.contains("UTM zone 32N")), "{notes:?}");
    assert_eq!(database.manifest().fields().crs.epsg, Some(32632));
    // By gdaltransform: where the sample in column 3, row 100 lies in UTM.
    let [ox, oy] = database.world().fields().origin;
    let (x, y) = (500_063.387_474 - ox, 5_202_077.274_313 - oy);
    let found = ground_height(&database, database.world(), x, y, &mut TileScratch::default()).unwrap().unwrap();
    assert!((found - (1000.0 + 100.0 + 6.0)).abs() < 0.02, "{found}");
}

#[test]
fn a_coarser_spacing_averages() {
    let folder = TestFolder::new();
    let dem = Tiff::utm([160, 160], |i, j| if (i / 2 + j / 2) % 2 == 0 { 0.0f32 } else { 100.0 })
        .write(&folder.path("dem.tif"));
    let mut coarse = job(&[dem], &[], folder.path("w.tv"));
    coarse.plan.spacing_m = Some(80.0);
    let (database, _) = run(&coarse).unwrap();
    let (posts, width) = heights(&database, 0);
    for (j, i) in (2..17).flat_map(|j| (2..17).map(move |i| (j, i))) {
        assert!((posts[j * width + i] - 50.0).abs() < 5.0, "{}", posts[j * width + i]);
    }
}

#[test]
fn nothing_but_voids_is_an_error() {
    let folder = TestFolder::new();
    let dem = Tiff { nodata: Some(0.0), ..Tiff::utm([30, 30], |_, _| 0.0f32) }.write(&folder.path("dem.tif"));
    let error = run(&job(&[dem], &[], folder.path("w.tv"))).unwrap_err();
    assert_eq!(error.exit_code(), 2);
    assert!(error.to_string().contains("no elevation data"), "{error}");
    assert!(!folder.path("w.tv").exists());
}

#[test]
fn a_database_needs_a_plane_in_metres() {
    let folder = TestFolder::new();
    let dem = Tiff { crs: None, ..Tiff::utm([30, 30], rough) }.write(&folder.path("dem.tif"));
    let mut wrong = job(&[dem], &[], folder.path("w.tv"));
    let error = run(&wrong).unwrap_err();
    assert!(error.to_string().contains("--source-crs"), "{error}");
    wrong.source_crs = Some(UTM.to_owned());
    wrong.crs = Some("EPSG:4326".to_owned());
    assert!(run(&wrong).unwrap_err().to_string().contains("metres"));
    wrong.crs = Some("EPSG:999999".to_owned());
    assert_eq!(run(&wrong).unwrap_err().exit_code(), 2);
    wrong.crs = None;
    let (database, _) = run(&wrong).unwrap();
    let mut heights = vec![0.0; 81];
    database.read_elevation(NodeId::new(0, 0, 0).unwrap(), &mut heights, &mut TileScratch::default()).unwrap();
}
