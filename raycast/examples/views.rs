//! Times to draw views of a world, read directly from a database: `cargo run -p terravision-raycast
//! --example views -- WORLD.tv [CELL_PX [ROUNDS [exact]]]`. With `exact` only exact rays and
//! the sweep are timed.
//!
//! The views are those of docs/quality.md. Results are medians of the processor time of one worker,
//! because other load disturbs this least.

#![allow(clippy::print_stdout, reason = "its output is the table")]

use std::path::Path;
use std::time::Instant;
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::database::Database;
use terravision_common::level::{LevelFunction, Measure};
use terravision_raycast::Sampling;
use terravision_raycast::model::world::{WorldTiles, ground_shape};
use terravision_raycast::model::{Filter, Ground};
use terravision_raycast::{CastOptions, CastTask, Caster, Counts, Method, Picture};

/// Methods, and up to which distance tiles have voxels, metres.
const WAYS: [(Method, f64); 4] =
    [(Method::Coherent, f64::INFINITY), (Method::Coherent, -1.0), (Method::Mipmap, -1.0), (Method::Sweep, -1.0)];
const SIZE: [u32; 2] = [1280, 720];
/// Name, place as shares of the extent, metres above the ground, heading, pitch.
const VIEWS: [(&str, [f64; 2], f64, f64, f64); 3] = [
    ("medium", [0.45, 0.30], 900.0, 20.0, -28.0),
    ("near", [0.55, 0.50], 250.0, 110.0, -20.0),
    ("far", [0.20, 0.15], 2500.0, 45.0, -25.0),
];

/// Processor time of this thread.
fn processor_millis() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|nanos| nanos.parse::<f64>().ok()).map_or(0.0, |nanos| 1e-6 * nanos)
}

fn main() {
    let mut arguments = std::env::args().skip(1);
    let Some(folder) = arguments.next() else {
        println!("usage: views WORLD.tv [CELL_PX [ROUNDS [exact]]]");
        return;
    };
    let mut number = |default: f64| arguments.next().and_then(|text| text.parse().ok()).unwrap_or(default);
    let (cell_px, rounds) = (number(1.0), number(3.0) as usize);
    let is_exact_alone = arguments.next().is_some();
    let database = Database::open(Path::new(&folder)).expect("the database opens");
    let world = *database.world();
    println!(
        "| view | rays | ms | least ms | models ms | tiles | without witness | partly proven | samples of a ray | densities | hash |"
    );
    println!("|---|---|--:|--:|--:|--:|--:|--:|--:|--:|---|");
    for (name, share, above_m, heading, pitch) in VIEWS {
        let mut tiles = WorldTiles::new(&world, &database, database.ranges());
        let [width, height] = world.extent_m();
        let at = [share[0] * width, share[1] * height];
        let camera = |z: f64| {
            Camera::new(CameraFields {
                eye_in_world: [at[0], at[1], z],
                heading_rad: heading.to_radians(),
                pitch_rad: pitch.to_radians(),
                roll_rad: 0.0,
                vfov_rad: 60f64.to_radians(),
                width: SIZE[0],
                height: SIZE[1],
                timestamp_nanos: 0,
            })
            .expect("valid")
        };
        let level = |camera: &Camera| {
            LevelFunction::new(camera, &world, 1.0, Measure::Max, cell_px / std::f64::consts::SQRT_2, 0.7)
        };
        let mut ground = Ground::new(ground_shape(&world, Some(Filter::OrientedBox)));
        let above = Camera::new(CameraFields { pitch_rad: -1.57, ..*camera(5000.0).fields() }).expect("valid");
        tiles.fill(&mut ground, &above, &level(&above), -1.0).expect("tiles are there");
        let unit = world.lattice_unit_m();
        let below =
            f64::from(ground.height_at(at.map(|v| v / unit)).expect("there is ground below")) + ground.datum_m();
        let camera = camera(below + above_m);
        let ways = WAYS.into_iter().filter(|(method, _)| !is_exact_alone || *method != Method::Coherent);
        for (method, accurate_m) in ways {
            let mut fill = || tiles.fill(&mut ground, &camera, &level(&camera), accurate_m).expect("tiles are there");
            fill();
            let start = Instant::now();
            fill();
            let models = start.elapsed();
            let mut caster = Caster::new(1).expect("this thread is there");
            let sampling = Sampling { interval_voxels: 0.6, voxel_px: 1.0f32.min(cell_px as f32) };
            let options = &CastOptions { method, sampling, ..CastOptions::default() };
            let picture = &Picture::new(SIZE);
            let layers = tiles.layers();
            let mut millis = Vec::new();
            let mut counts = Counts::default();
            let task = CastTask { ground: &ground, colors: &layers, heights: &[], camera: &camera, options, picture };
            for _ in 0..rounds {
                let start = processor_millis();
                counts = caster.draw(&task);
                millis.push(processor_millis() - start);
            }
            millis.sort_by(f64::total_cmp);
            let per_ray = |n: u64| n as f64 / counts.rays as f64;
            let hash = picture.rgba().fold(0u64, |hash, v| (hash ^ u64::from(v)).wrapping_mul(0x100_0000_01b3));
            println!(
                "| {name} | {method:?}{} | {:.0} | {:.1} | {:.0} | {} | {:.3} | {:.3} | {:.2} | {:.2} | {hash:016x} |",
                if method != Method::Coherent || accurate_m > 0.0 { "" } else { " approximate" },
                millis[millis.len() / 2],
                millis[0],
                1e3 * models.as_secs_f64(),
                ground.tile_count(),
                per_ray(counts.without_witness),
                per_ray(counts.partly_proven),
                per_ray(counts.samples),
                per_ray(counts.densities),
            );
        }
    }
}
