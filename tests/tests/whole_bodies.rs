//! Flights over whole bodies: no sky through the ground from anywhere, the ground where the depth says
//! it is, the same bytes each time, and sentences for what is not there.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use glam::{DVec2, DVec3};
use std::f64::consts::PI;
use std::path::{Path, PathBuf};
use terravision_common::database::Index;
use terravision_common::ground::{GroundScratch, GroundTiles, Interpolation};
use terravision_common::surface::globe::{Ellipsoid, Geodetic};
use terravision_testkit::floats::read_floats;
use terravision_tests::flight::{Pose, write_path};
use terravision_tests::folder::TestFolder;
use terravision_tests::process::Terravision;

const SIZE: [u32; 2] = [160, 100];
const VFOV_DEG: f64 = 60.0;
/// Size of facets of the default quality, pixels.
const FACET_PX: f64 = 10.0;
/// Poses of the flight over everything.
const POSES: usize = 240;

/// A synthetic body.
fn body(folder: &TestFolder, body: &str) -> PathBuf {
    let (source, world) = (folder.join("source"), folder.join("body.tv"));
    Terravision::verb("synth").args(["--body", body, "-o"]).arg(&source).succeed();
    let ingest = Terravision::verb("ingest").arg("--elevation").arg(source.join("dem.tif"));
    ingest.arg("--color").arg(source.join("ortho.tif")).arg("-o").arg(&world).succeed();
    world
}

/// Numbers without a pattern, from 0 to 1.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Poses from 2 m above the ground to three radii, most of all at the date line and the poles.
fn poses(ellipsoid: &Ellipsoid, ground_m: impl Fn(f64, f64) -> f64) -> Vec<Pose> {
    let mut random = Random(20);
    let pose = |k: usize| {
        let (u, v) = (random.next(), random.next());
        let [longitude, latitude] = match k % 4 {
            0 => [360.0 * u - 180.0, (2.0 * v - 1.0).asin().to_degrees()],
            1 => [180.0 - 1e-3 * u * u, 170.0 * v - 85.0],
            2 => [360.0 * u - 180.0, 90.0 - 2.0 * v * v],
            _ => [360.0 * u - 180.0, 2.0 * v * v - 90.0],
        };
        let above = 2.0 * (1.5 * ellipsoid.semi_major_m()).powf(random.next());
        let height = ground_m(longitude, latitude) + above;
        let pose = Pose::new([longitude, latitude, height], 360.0 * random.next(), -80.0 * random.next());
        Pose { roll: 30.0 * random.next() - 15.0, ..pose }
    };
    (0..POSES).map(pose).collect()
}

/// Heights of a world's ground as it is drawn close by.
fn heights<T>(world: &Path, with: impl FnOnce(&Ellipsoid, f64, &dyn Fn(f64, f64) -> f64) -> T) -> T {
    let index = Index::open(world).unwrap();
    let database = terravision_common::database::Database::open(world).unwrap();
    let tiles = GroundTiles::new(&database, index.world(), 256 << 20);
    let scratch = std::cell::RefCell::new(GroundScratch::default());
    let height = |longitude: f64, latitude: f64| {
        let foot = DVec2::new(longitude, latitude);
        tiles.sample(foot, Interpolation::Facet, &mut scratch.borrow_mut()).unwrap().found.ground.height_m
    };
    let globe = index.world().globe().expect("a body");
    let lowest = index.world().roots().filter_map(|root| index.ranges().range(root)).map(|range| range[0]);
    with(globe.body(), lowest.fold(f32::INFINITY, f32::min).into(), &height)
}

/// The body-fixed position of an eye and the direction of each pixel's ray.
fn rays(pose: &Pose) -> (DVec3, Vec<DVec3>) {
    let place = Geodetic::of_degrees(DVec3::from_array(pose.eye));
    let (camera, axes) = (pose.camera(SIZE, VFOV_DEG), Ellipsoid::east_north_up(place));
    let pixels = (0..SIZE[1]).flat_map(|y| (0..SIZE[0]).map(move |x| [f64::from(x) + 0.5, f64::from(y) + 0.5]));
    (DVec3::from_array(pose.eye), pixels.map(|[x, y]| axes * camera.ray_in_world(x, y)).collect())
}

#[test]
fn ground_has_no_gaps_and_is_where_depth_says_from_two_metres_to_three_radii() {
    let folder = TestFolder::new("whole_bodies_ground");
    let world = body(&folder, "moon:720");
    heights(&world, |ellipsoid, lowest_m, height_m| {
        let poses = poses(ellipsoid, height_m);
        let path = folder.join("path.json");
        write_path(&path, &poses, SIZE, VFOV_DEG);
        let fly = |pictures: &str| {
            Terravision::verb("fly").arg(&world).arg("--path").arg(&path).arg("-o").arg(folder.join(pictures))
        };
        let first = fly("png/").arg("--depth").arg(folder.join("depth/")).arg("--ground").arg(folder.join("ground/"));
        first.arg("--validation").succeed().assert_no_warning();
        let radius = ellipsoid.semi_minor_m() + lowest_m;
        let row_m = PI / 360.0 * ellipsoid.semi_major_m();
        let sagitta_m = row_m * row_m / (8.0 * ellipsoid.semi_major_m());
        let focal_px = poses[0].camera(SIZE, VFOV_DEG).focal_px();
        let mut errors = Vec::new();
        for (frame, pose) in poses.iter().enumerate() {
            let name = format!("frame-{frame:06}.tif");
            let (_, _, depths) = read_floats(&folder.join("depth").join(&name)).unwrap();
            let (_, _, places) = read_floats(&folder.join("ground").join(&name)).unwrap();
            let (eye, rays) = rays(pose);
            let position = ellipsoid.position(Geodetic::of_degrees(eye));
            let mut of_frame = Vec::new();
            for (pixel, (depth, ray)) in depths.iter().zip(&rays).enumerate() {
                // A ray that comes nearer to the middle than any ground is from it has met ground. Near
                // the limb a pixel's rays see past it.
                let nearest = position - *ray * (position.dot(*ray) / ray.length_squared());
                let is_inside = position.dot(*ray) < 0.0 && nearest.length() < 0.998 * radius;
                assert!(!is_inside || depth.is_finite(), "frame {frame}, pixel {pixel}: sky through {pose:?}");
                if !depth.is_finite() {
                    continue;
                }
                let [longitude, latitude, height] = [0, 1, 2].map(|k| places[3 * pixel + k]);
                // What is far away is drawn from coarser posts: compared by the width of a cell there. And
                // facets are flat: between posts they lie below ground that follows the body.
                let distance = depth * ray.length();
                if distance < 20.0 * (eye.z - height_m(eye.x, eye.y)) {
                    let cell_m = 4.0 * sagitta_m + 2f64.sqrt() * FACET_PX / focal_px * distance;
                    of_frame.push((height - height_m(longitude, latitude)).abs() / cell_m);
                }
            }
            of_frame.sort_by(f64::total_cmp);
            let median = of_frame.get(of_frame.len() / 2).copied().unwrap_or_default();
            assert!(median < 0.5, "frame {frame}: heights are off by {median} cells at {pose:?}");
            errors.append(&mut of_frame);
        }
        errors.sort_by(f64::total_cmp);
        let [median, most] = [errors[errors.len() / 2], errors[errors.len() * 99 / 100]];
        println!("{} pixels: heights differ by {median:.3} cells, 99 % by {most:.3}", errors.len());
        assert!(errors.len() > 1_000_000 && median < 0.05 && most < 1.5, "{median} {most}");
        // And again, byte for byte.
        fly("again/").succeed();
        let bytes =
            |pictures: &str, frame| std::fs::read(folder.join(pictures).join(format!("frame-{frame:06}.png"))).unwrap();
        assert!((0..POSES).all(|frame| bytes("png", frame) == bytes("again", frame)), "other bytes");
    });
}

#[test]
fn a_round_passes_the_date_line_and_what_is_not_there_is_told() {
    let folder = TestFolder::new("whole_bodies_round");
    let world = body(&folder, "mars:360");
    let still = |flags: &[&str]| {
        let still = Terravision::verb("still").arg(&world).arg("-o").arg(folder.join("a.png"));
        still
            .args(["--eye=179.99,0,20000", "--look-at=-179.8,0.1", "--size", "160x100"])
            .args(flags.iter().copied())
            .run()
    };
    still(&[]).assert_code(0);
    for (flags, sentence) in [
        (&["--technique", "rays"][..], "rays do not draw whole bodies yet"),
        (&["--stereo", "side-by-side"], "--stereo"),
        (&["--sun", "100,30"], "--sun"),
    ] {
        let told = still(flags);
        told.assert_told(2);
        assert!(told.stderr.contains(sentence), "{flags:?}: {}", told.stderr);
    }
    let path = folder.join("round.json");
    let round = Terravision::verb("fly").arg(&world).args(["--size", "160x100", "--frames", "0..12", "-o"]);
    round.arg(folder.join("round/")).succeed().assert_no_warning();
    // Around a place at the date line, on its own path.
    let eye = |k: usize| {
        let (sin, cos) = (2.0 * PI * k as f64 / 8.0).sin_cos();
        let longitude = 180.0 + cos;
        [if longitude > 180.0 { longitude - 360.0 } else { longitude }, 20.0 + sin, 60_000.0]
    };
    let poses: Vec<Pose> = (0..8).map(|k| Pose::new(eye(k), 45.0 * k as f64, -40.0)).collect();
    write_path(&path, &poses, SIZE, VFOV_DEG);
    let fly = Terravision::verb("fly").arg(&world).arg("--path").arg(&path).arg("-o").arg(folder.join("line/"));
    fly.succeed().assert_no_warning();
    let told = Terravision::verb("serve").arg(&world).run();
    told.assert_told(2);
    assert!(told.stderr.contains("hands do not move cameras around whole bodies yet"), "{}", told.stderr);
}
