//! Table of picture quality of ray casting: the source of docs/techniques.md.
//!
//! `cargo run --release -p terravision-tests --example rays -- FOLDER OUT [ROWS]` where FOLDER
//! holds `dem.tif`, `ortho.tif` and `world.tv`; pictures go to OUT. ROWS: those of the table whose
//! names begin so.

#![allow(clippy::print_stdout, reason = "its output is the table")]

use std::path::{Path, PathBuf};
use terravision_raycast::model::Filter;
use terravision_testkit::metrics::{compare, median_absolute_error};
use terravision_tests::flight::write_png;
use terravision_tests::rays::{RaySettings, cast};
use terravision_tests::shot::{Shot, oblique_poses};
use terravision_tests::worlds::TestWorld;

fn main() {
    let mut arguments = std::env::args().skip(1);
    let (Some(folder), Some(out)) = (arguments.next(), arguments.next()) else {
        println!("usage: rays FOLDER OUT [ROWS]");
        return;
    };
    let start = arguments.next().unwrap_or_default();
    let out = PathBuf::from(out);
    std::fs::create_dir_all(&out).expect("the output folder can be made");
    let world = TestWorld::at(Path::new(&folder));
    let accurate = RaySettings::accurate();
    let table = [
        ("accurate", accurate),
        ("accurate-2px", RaySettings { cell_px: 2.0, ..accurate }),
        ("accurate-gaussian", RaySettings { filter: Filter::Gaussian, ..accurate }),
        ("accurate-3km", RaySettings { accurate_m: 3000.0, ..accurate }),
        ("approximate", RaySettings::approximate()),
        ("mipmap", RaySettings::mipmap()),
        ("mipmap-2px", RaySettings { cell_px: 2.0, ..RaySettings::mipmap() }),
        // What the mesh draws by default: facets of 10 pixels.
        ("mipmap-mesh", RaySettings { cell_px: 14.14, texel_px: 0.7, ..RaySettings::mipmap() }),
        ("mipmap-half", RaySettings { cell_px: 0.5, texel_px: 0.35, ..RaySettings::mipmap() }),
    ];
    println!("| view | rays | PSNR dB | SSIM | depth m | ms | models ms | tiles | MiB | samples of a ray |");
    println!("|---|---|--:|--:|--:|--:|--:|--:|--:|--:|");
    for (view, pose) in oblique_poses(&world) {
        let shot = Shot::new(&world, pose);
        let reference = shot.reference(3);
        write_png(&out.join(format!("{view}-reference.png")), reference.width, &reference.rgb);
        for (name, settings) in table.iter().filter(|(name, _)| name.starts_with(&start)) {
            let cast = cast(&world, &shot.camera(), shot.sky_rgb, settings);
            let found = compare(reference.width, &cast.rgb, &reference.rgb, &reference.is_land);
            let pairs = cast.depth.iter().zip(&reference.depth).map(|(a, b)| (f64::from(*a), f64::from(*b)));
            println!(
                "| {view} | {name} | {:.2} | {:.4} | {:.3} | {:.0} | {:.0} | {} | {} | {:.2} |",
                found.psnr_db,
                found.ssim,
                median_absolute_error(pairs),
                1e3 * cast.elapsed.as_secs_f64(),
                1e3 * cast.models.as_secs_f64(),
                cast.tiles.0,
                cast.tiles.1 >> 20,
                cast.counts.samples as f64 / cast.counts.rays as f64,
            );
            write_png(&out.join(format!("{view}-{name}.png")), reference.width, &cast.rgb);
        }
    }
}
