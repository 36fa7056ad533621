//! Tables of picture quality over the settings: the source of docs/quality.md.
//!
//! `cargo run --release -p terravision-tests --example quality -- FOLDER OUT [SETTINGS…]` where
//! FOLDER holds `dem.tif`, `ortho.tif` and `world.tv`, pictures go to OUT, and each of SETTINGS is
//! a list of arguments of `terravision still` in one word, like `"--facet-px 5 --texel-px 0.7"`.
//! Without any, a built-in list.

#![allow(clippy::print_stdout, reason = "its output is the table")]

use std::path::{Path, PathBuf};
use std::time::Instant;
use terravision_testkit::metrics::{compare, count_holes, median_absolute_error};
use terravision_tests::flight::write_png;
use terravision_tests::shot::{Shot, oblique_poses};
use terravision_tests::worlds::TestWorld;

const DEFAULT: [&str; 12] = [
    "",
    "--facet-px 20",
    "--facet-px 5",
    "--facet-px 3",
    "--measure min",
    "--measure max",
    "--texel-px 2",
    "--texel-px 0.7",
    "--texel-px 0.5",
    "--texel-px 0.5 --measure max",
    "--quality best",
    "--quality best --texel-px 0.5",
];

fn main() {
    let mut arguments = std::env::args().skip(1);
    let (Some(folder), Some(out)) = (arguments.next(), arguments.next()) else {
        println!("usage: quality FOLDER OUT [SETTINGS…]");
        return;
    };
    let out = PathBuf::from(out);
    std::fs::create_dir_all(&out).expect("the output folder can be made");
    let given: Vec<String> = arguments.collect();
    let settings = if given.is_empty() { DEFAULT.map(str::to_owned).to_vec() } else { given };
    let world = TestWorld::at(Path::new(&folder));
    println!("| view | settings | PSNR dB | SSIM | triangles | frame ms | depth m | ground z m | holes |");
    println!("|---|---|--:|--:|--:|--:|--:|--:|--:|");
    for (name, pose) in oblique_poses(&world) {
        let shot = Shot::new(&world, pose);
        let start = Instant::now();
        let reference = shot.reference(4);
        let seconds = start.elapsed().as_secs_f64();
        write_png(&out.join(format!("{name}-reference.png")), reference.width, &reference.rgb);
        let land = reference.is_land.iter().filter(|land| **land).count() as f64 / reference.is_land.len() as f64;
        println!("| {name} | reference, {:.0} % land | | | | {:.0} | | | |", 100.0 * land, 1e3 * seconds);
        for (number, settings) in settings.iter().enumerate() {
            let taken = shot.take(&settings.split_whitespace().collect::<Vec<_>>(), true);
            let quality = compare(reference.width, &taken.rgb, &reference.rgb, &reference.is_land);
            let depth =
                median_absolute_error(taken.depth.iter().copied().zip(reference.depth.iter().map(|d| f64::from(*d))));
            let height = median_absolute_error(taken.ground.iter().zip(&reference.ground).map(|(a, b)| (a[2], b[2])));
            let holes = count_holes(&taken.is_sky(shot.sky_rgb), &reference, 10);
            println!(
                "| {name} | {settings} | {:.2} | {:.4} | {} | {:.0} | {depth:.2} | {height:.2} | {} |",
                quality.psnr_db,
                quality.ssim,
                taken.report["triangles_median"],
                taken.report["frame_ms_median"].as_f64().unwrap_or(f64::NAN),
                holes.count
            );
            write_png(&out.join(format!("{name}-{number}.png")), reference.width, &taken.rgb);
            let difference: Vec<[u8; 3]> = taken
                .rgb
                .iter()
                .zip(&reference.rgb)
                .map(|(a, b)| std::array::from_fn(|c| a[c].abs_diff(b[c]).saturating_mul(4)))
                .collect();
            write_png(&out.join(format!("{name}-{number}-difference-x4.png")), reference.width, &difference);
        }
    }
}
