//! Vehicles over pictures: the same by every technique, hidden by the ground before them, in depth
//! too, and wrong ones told in a sentence.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::path::Path;
use terravision_tests::flight::{Pose, read_png, write_path};
use terravision_tests::folder::TestFolder;
use terravision_tests::geotiff::{write_colors, write_heights};
use terravision_tests::process::Terravision;
use terravision_tests::shot::{Shot, Taken};
use terravision_tests::worlds::{TestWorld, ingest};

const ORIGIN: [f64; 2] = [500_000.0, 5_000_000.0];
const POSTS: usize = 257;
const SPACING_M: f64 = 10.0;
const PLAIN_M: f32 = 1000.0;

/// A plain with a ridge of 60 m across, 1200 m north of its southern edge.
fn ridge_world(folder: &TestFolder) -> TestWorld {
    // Rows from the north.
    let height = |k: usize| {
        let north = (POSTS - 1 - k / POSTS) as f64 * SPACING_M;
        PLAIN_M + (60.0 - 0.6 * (north - 1200.0).abs()).max(0.0) as f32
    };
    let heights: Vec<f32> = (0..POSTS * POSTS).map(height).collect();
    let side = POSTS - 1;
    let greys: Vec<[u8; 3]> = (0..side * side).map(|k| [90 + ((k * 7 + k / side * 13) % 60) as u8; 3]).collect();
    write_heights(&folder.join("dem.tif"), POSTS, POSTS, ORIGIN, SPACING_M, &heights);
    write_colors(&folder.join("ortho.tif"), side, side, ORIGIN, SPACING_M, &greys);
    ingest(folder.path(), &[]);
    TestWorld::at(folder.path())
}

/// A feature of a truck that drives north from a place of the world, and its file.
fn fleet(folder: &TestFolder, name: &str, trucks: &[([f64; 2], f64)]) -> std::path::PathBuf {
    let model = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().join("examples/vehicles/truck.gltf");
    std::fs::copy(model, folder.join("truck.gltf")).unwrap();
    let feature = |([east, north], scale): &([f64; 2], f64)| {
        let [x, y] = [ORIGIN[0] + east, ORIGIN[1] + north];
        format!(
            r#"{{"type": "Feature", "properties": {{"model": "truck.gltf", "scale": {scale}, "times": [0, 100]}},
            "geometry": {{"type": "LineString", "coordinates": [[{x}, {y}], [{x}, {}]]}}}}"#,
            y + 500.0
        )
    };
    let features: Vec<String> = trucks.iter().map(feature).collect();
    let text = format!(
        r#"{{"type": "FeatureCollection", "crs": {{"properties": {{"name": "EPSG:32632"}}}}, "features": [{}]}}"#,
        features.join(",")
    );
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path
}

fn differing(a: &Taken, b: &Taken) -> Vec<usize> {
    (0..a.rgb.len()).filter(|pixel| a.rgb[*pixel] != b.rgb[*pixel]).collect()
}

#[test]
fn a_vehicle_before_the_ridge_is_seen_by_all_techniques_and_one_behind_it_is_not() {
    let folder = TestFolder::new("vehicles");
    let world = ridge_world(&folder);
    let before = fleet(&folder, "before.geojson", &[([1280.0, 700.0], 2.0), ([1330.0, 900.0], 4.0)]);
    let behind = fleet(&folder, "behind.geojson", &[([1280.0, 1400.0], 4.0)]);
    let eye = [ORIGIN[0] + 1280.0, ORIGIN[1] + 600.0, f64::from(PLAIN_M) + 12.0];
    let shot = Shot { size: [640, 360], ..Shot::new(&world, Pose::new(eye, 3.0, -2.0)) };
    let mut seen = Vec::new();
    for way in ["--technique mesh", "--rays sweep", "--rays mipmap"] {
        let technique: Vec<&str> = way.split(' ').collect();
        let take = |more: &[&str]| shot.take(&[&technique, more].concat(), true);
        let plain = take(&[]);
        let [before, behind] = [&before, &behind].map(|file| take(&["--vehicles", file.to_str().unwrap()]));
        assert!(differing(&plain, &behind).is_empty(), "{way}: the ridge hides it");
        let pixels = differing(&plain, &before);
        assert!(pixels.len() > 300, "{way}: {} pixels", pixels.len());
        for pixel in &pixels {
            // Depth is the vehicle's: 96 to 100 m, or 290 to 310 m away, nearer than what is behind
            // it.
            let [with, without] = [before.depth[*pixel], plain.depth[*pixel]];
            assert!((80.0..120.0).contains(&with) || (270.0..320.0).contains(&with), "{way}: {with}");
            assert!(without.is_nan() || with < without, "{way}: {with} {without}");
            let [_, north, height] = before.ground[*pixel];
            assert!((600.0..930.0).contains(&(north - ORIGIN[1])) && height > 999.9, "{way}: {north} {height}");
        }
        seen.push((pixels, before));
    }
    let (pixels, mesh) = &seen[0];
    for (others, other) in &seen[1..] {
        let both: Vec<usize> = pixels.iter().copied().filter(|pixel| others.binary_search(pixel).is_ok()).collect();
        assert!(both.len() as f64 > 0.98 * pixels.len().max(others.len()) as f64);
        assert!(both.iter().all(|pixel| mesh.rgb[*pixel] == other.rgb[*pixel]), "the same pixels on vehicles");
    }
}

#[test]
fn a_flight_and_its_pieces_have_the_same_bytes_and_vehicles_move() {
    let folder = TestFolder::new("vehicles-flight");
    let world = ridge_world(&folder);
    let file = fleet(&folder, "fleet.geojson", &[([1280.0, 700.0], 2.0)]);
    let eye = [ORIGIN[0] + 1280.0, ORIGIN[1] + 600.0, f64::from(PLAIN_M) + 12.0];
    write_path(&folder.join("path.json"), &vec![Pose::new(eye, 0.0, -2.0); 70], [160, 90], 60.0);
    let fly = |frames: &str, out: &str| {
        let command = Terravision::verb("fly").arg(world.database()).arg("--path").arg(folder.join("path.json"));
        let command = command.args(["--frames", frames, "--rays", "sweep", "--vehicles-start", "10", "--vehicles"]);
        command.arg(&file).arg("-o").arg(folder.join(out)).succeed();
    };
    fly("0..70", "whole/");
    fly("0..70", "again/");
    fly("60..70", "piece/");
    let bytes = |out: &str, frame: u32| std::fs::read(folder.join(format!("{out}/frame-{frame:06}.png"))).unwrap();
    for frame in 0..70 {
        assert_eq!(bytes("whole", frame), bytes("again", frame), "{frame}");
    }
    for frame in 60..70 {
        assert_eq!(bytes("whole", frame), bytes("piece", frame), "{frame}");
    }
    let picture = |frame: u32| read_png(&folder.join(format!("whole/frame-{frame:06}.png"))).2;
    assert!(picture(0) != picture(69), "it drives 5 metres a second");
}

#[test]
fn against_the_clock_vehicles_are_drawn_too() {
    let folder = TestFolder::new("vehicles-realtime");
    let world = ridge_world(&folder);
    let file = fleet(&folder, "fleet.geojson", &[([1280.0, 700.0], 2.0)]);
    let eye = [ORIGIN[0] + 1280.0, ORIGIN[1] + 600.0, f64::from(PLAIN_M) + 12.0];
    write_path(&folder.join("path.json"), &vec![Pose::new(eye, 0.0, -2.0); 30], [160, 90], 60.0);
    let fly = |vehicles: &[&str], out: &str| {
        let command = Terravision::verb("fly").arg(world.database()).arg("--path").arg(folder.join("path.json"));
        let command = command.args(["--mode", "realtime", "--rays", "sweep"]).args(vehicles);
        let finished = command.arg("-o").arg(folder.join(out)).run();
        finished.assert_code(0);
        read_png(&folder.join(format!("{out}/frame-000029.png"))).2
    };
    let with = fly(&["--vehicles", file.to_str().unwrap()], "with/");
    assert!(fly(&[], "without/") != with);
}

#[test]
fn bad_vehicles_are_told_before_anything_is_drawn() {
    let folder = TestFolder::new("vehicles-bad");
    let world = ridge_world(&folder);
    let eye = [ORIGIN[0] + 1280.0, ORIGIN[1] + 600.0, f64::from(PLAIN_M) + 12.0];
    let shot = Shot { size: [64, 36], ..Shot::new(&world, Pose::new(eye, 0.0, -2.0)) };
    let good = std::fs::read_to_string(fleet(&folder, "good.geojson", &[([1280.0, 700.0], 2.0)])).unwrap();
    let refused = |text: &str, more: &[&str], told: &str| {
        std::fs::write(folder.join("bad.geojson"), text).unwrap();
        let finished = shot.command(&folder).arg("--vehicles").arg(folder.join("bad.geojson")).args(more).run();
        finished.assert_told(2);
        assert!(finished.stderr.contains(told), "{told}: {}", finished.stderr);
        assert!(!folder.join("a.png").exists());
    };
    refused(&good.replace("truck.gltf", "lost.gltf"), &[], "lost.gltf");
    refused(&good.replace("[0, 100]", "[\"a\", \"b\"]"), &[], "times that grow from point to point");
    refused(&good.replace("\"scale\": 2", "\"scale\": 0"), &[], "\"scale\": expected a number");
    refused(&good[..200], &[], "has no vehicles that can be drawn");
    refused("{}", &[], "expected CZML");
    refused(&good, &["--vehicles-start", "noon"], "--vehicles-start noon: expected a date and time");
    std::fs::write(folder.join("bad.gltf"), "{\"asset\": 1}").unwrap();
    refused(&good.replace("truck.gltf", "bad.gltf"), &[], "expected glTF 2.0");
    let finished = shot.command(&folder).args(["--vehicles", "/nothing/here.czml"]).run();
    finished.assert_told(2);
    assert!(finished.stderr.contains("--vehicles /nothing/here.czml: it cannot be read"), "{}", finished.stderr);
    // An aircraft in the ground is told of, and drawn where it is.
    let low = good.replace("\"scale\": 2", "\"scale\": 2, \"heightReference\": \"NONE\"");
    std::fs::write(folder.join("low.geojson"), low).unwrap();
    let finished = shot.command(&folder).arg("--vehicles").arg(folder.join("low.geojson")).run();
    finished.assert_code(0);
    assert!(finished.stderr.contains("below the ground at 2 of 2 moments"), "{}", finished.stderr);
}
