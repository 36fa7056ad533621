//! The sampler, the walk along columns and the models of tiles: `cargo bench -p
//! terravision-raycast`.
//!
//! Without a framework: it reports rays and samples per second, and bytes against the machine's
//! memory bandwidth. All times are processor times, because other load disturbs these least. Each
//! line is the minimum of several rounds. Without `--bench` (in `cargo test --benches`) it does one
//! round.

#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "its output is the table")]

use std::hint::black_box;
use terravision_raycast::model::Filter;
use terravision_raycast::{CastOptions, CastTask, Caster, Picture};
use terravision_testkit::rays::{AnyMethod, Field, UNIT_M, camera};

const SIZE: [u32; 2] = [640, 360];
const CELLS: usize = 512;
/// Cells along a side of a tile, as the preparer makes them.
const TILE: usize = 16;

/// Processor time of this thread, seconds.
fn processor_seconds() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|nanos| nanos.parse::<f64>().ok()).map_or(0.0, |nanos| 1e-9 * nanos)
}

/// The minimum processor time of several rounds, seconds.
fn least(rounds: u32, mut work: impl FnMut()) -> f64 {
    work();
    let round = |_| {
        let start = processor_seconds();
        work();
        processor_seconds() - start
    };
    (0..rounds).map(round).fold(f64::INFINITY, f64::min).max(1e-9)
}

fn main() {
    let rounds = if std::env::args().any(|argument| argument == "--bench") { 15 } else { 1 };
    // Reading once through more than caches hold.
    let memory: Vec<u64> = (0..(64 << 20) / 8).collect();
    let seconds = least(rounds.min(5), || {
        black_box(black_box(&memory).iter().fold(0u64, |sum, word| sum.wrapping_add(*word)));
    });
    let memory_rate = size_of_val(&memory[..]) as f64 / seconds;
    println!("memory, read by one core: {:.1} GB/s", 1e-9 * memory_rate);
    let field = Field::hills(CELLS, 900.0, 3);
    let colors = field.colors();
    for (name, filter) in [("voxels", Some(Filter::OrientedBox)), ("heights alone", None)] {
        let mut ground = field.ground(TILE, filter);
        let seconds = least(rounds, || field.fill(&mut ground, TILE));
        let tiles = ground.tile_count() as f64;
        println!(
            "model of a tile, {name}: {:.1} us, {:.0} bytes, {:.2} GB/s",
            1e6 * seconds / tiles,
            ground.bytes() as f64 / tiles,
            1e-9 * ground.bytes() as f64 / seconds
        );
    }
    println!(
        "| rays | view | Mrays/s | ns a ray | samples of a ray | ns a sample | least bytes of a ray | of the memory rate |"
    );
    println!("|---|---|--:|--:|--:|--:|--:|--:|");
    for (name, filter, method) in [
        ("sampler: voxels from the beginning", Some(Filter::OrientedBox), AnyMethod::Plain),
        ("column walk: voxels", Some(Filter::OrientedBox), AnyMethod::Coherent),
        ("sampler: exact from the beginning", None, AnyMethod::PlainMipmap),
        ("column walk: exact", None, AnyMethod::Mipmap),
    ] {
        let ground = field.ground(TILE, filter);
        for (view, roll) in [("level", 0.0), ("rolled by 20 degrees", 20.0)] {
            let eye = [0.5 * CELLS as f64 * UNIT_M, 300.0, 1400.0];
            let camera = camera(eye, [0.0, -30.0, roll], 50.0, SIZE);
            let options = CastOptions::default();
            let picture = Picture::new(SIZE);
            let mut caster = Caster::new(1).unwrap();
            let mut draw = || {
                method.draw(
                    &mut caster,
                    &CastTask {
                        ground: &ground,
                        colors: &[&colors[..]],
                        heights: &[],
                        camera: &camera,
                        options: &options,
                        picture: &picture,
                    },
                )
            };
            let counts = draw();
            let seconds = least(rounds, || {
                draw();
            });
            let rays = counts.rays as f64;
            // A pixel's colour and depth are written, and models and colours read, once at least.
            let bytes = 8.0 + (ground.bytes() + colors.len()) as f64 / rays;
            println!(
                "| {name} | {view} | {:.2} | {:.0} | {:.2} | {:.1} | {bytes:.1} | {:.1} % |",
                1e-6 * rays / seconds,
                1e9 * seconds / rays,
                counts.samples as f64 / rays,
                1e9 * seconds / counts.samples as f64,
                100.0 * bytes * rays / seconds / memory_rate
            );
        }
    }
}
