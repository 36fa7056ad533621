//! Rays are near to the truth: the limits that were set for each method before it was there, and on
//! real data no further off than the mesh.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use std::path::{Path, PathBuf};
use std::time::Duration;
use terravision_testkit::metrics::{Quality, compare, median_absolute_error};
use terravision_tests::flight::read_png;
use terravision_tests::folder::TestFolder;
use terravision_tests::process::Terravision;
use terravision_tests::rays::{RaySettings, cast};
use terravision_tests::shot::{Shot, oblique_poses};
use terravision_tests::worlds::synth_world;

/// Name, settings, and PSNR in dB and SSIM to be reached.
type Limit = (&'static str, RaySettings, (f64, f64));

#[test]
fn rays_reach_the_limits_of_their_methods() {
    let world = synth_world(4096);
    let mixed = RaySettings { accurate_m: 1000.0, ..RaySettings::accurate() };
    let table: [Limit; 4] = [
        ("accurate", RaySettings::accurate(), (30.0, 0.92)),
        ("accurate, then approximate", mixed, (30.0, 0.92)),
        ("approximate", RaySettings::approximate(), (30.0, 0.92)),
        ("mipmap", RaySettings::mipmap(), (35.0, 0.96)),
    ];
    let half_a_voxel_m = 0.5 * world.heights().spacing_m();
    // One view: the reference of each takes as long as all of its pictures.
    let (view, pose) = oblique_poses(&world)[1];
    let shot = Shot::new(&world, pose);
    let reference = shot.reference(2);
    for (name, settings, (psnr_db, ssim)) in table {
        let cast = cast(&world, &shot.camera(), shot.sky_rgb, &settings);
        let found = compare(reference.width, &cast.rgb, &reference.rgb, &reference.is_land);
        let pairs = || cast.depth.iter().zip(&reference.depth).map(|(a, b)| (f64::from(*a), f64::from(*b)));
        let error_m = median_absolute_error(pairs());
        let torn = pairs().filter(|(a, b)| a.is_nan() != b.is_nan()).count();
        println!("{view}, {name}: {:.2} dB, {:.4}, depth {error_m:.3} m, torn {torn}", found.psnr_db, found.ssim);
        assert!(found.psnr_db >= psnr_db && found.ssim >= ssim, "{view}, {name}: {found:?}");
        assert!(error_m < half_a_voxel_m, "{view}, {name}: median error of depth is {error_m} m");
        assert!(torn * 200 < cast.depth.len(), "{view}, {name}: {torn} pixels are sky in one picture alone");
    }
}

/// A view of real data.
struct Place {
    name: &'static str,
    elevation: &'static str,
    color: Option<&'static str>,
    view: [&'static str; 6],
}

const PLACES: [Place; 2] = [
    Place {
        name: "sthelens",
        elevation: "earth-sthelens/SainteHelens.dem",
        color: None,
        view: ["--eye", "563500,5112500,2900", "--heading", "355", "--pitch", "-18"],
    },
    Place {
        name: "craterlake",
        elevation: "earth-craterlake/craterlake-elev-16bit-30m.tif",
        color: Some("earth-craterlake/craterlake-imagery-30m.tif"),
        view: ["--eye", "570500,4752500,2900", "--heading", "40", "--pitch", "-22"],
    },
];

#[test]
fn on_real_data_voxels_are_no_further_from_the_truth_than_the_mesh() {
    let Some(data) = std::env::var_os("TERRAVISION_DATA").map(PathBuf::from) else {
        println!("TERRAVISION_DATA is not set: real data was not tested");
        return;
    };
    // Tests run in their package's folder, the variable is given for the workspace's.
    let data = if data.is_absolute() { data } else { Path::new("..").join(data) };
    for place in PLACES {
        let folder = TestFolder::new(place.name);
        let mut ingest = Terravision::verb("ingest").arg("--elevation").arg(data.join(place.elevation));
        if let Some(color) = place.color {
            ingest = ingest.arg("--color").arg(data.join(color));
        }
        ingest.arg("-o").arg(folder.join("w.tv")).deadline(Duration::from_secs(300)).run().assert_code(0);
        let take = |arguments: &[&str]| {
            let png = folder.join("a.png");
            let still = Terravision::verb("still")
                .arg("--quality=default")
                .arg(folder.join("w.tv"))
                .args(place.view)
                .args(["--size", "640x360"]);
            still.args(arguments).arg("-o").arg(&png).run().assert_code(0);
            read_png(&png)
        };
        let (width, _, truth) = take(&["--technique", "mesh", "--facet-px", "1", "--samples", "4"]);
        let everything = vec![true; truth.len()];
        let quality = |arguments: &[&str]| {
            let found: Quality = compare(width, &take(arguments).2, &truth, &everything);
            println!("{}, {arguments:?}: {:.2} dB, {:.4}", place.name, found.psnr_db, found.ssim);
            found
        };
        let mesh = quality(&["--technique", "mesh"]);
        let voxels = quality(&["--technique", "rays", "--rays", "coherent"]);
        assert!(voxels.psnr_db >= mesh.psnr_db && voxels.ssim >= mesh.ssim, "{}: {voxels:?}, {mesh:?}", place.name);
    }
}
