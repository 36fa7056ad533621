//! The table of voxel-flythrough-1999 §7 in its own set-up: a volume of 512 x 512 x 64 voxels, 512
//! x 512 colours, pictures of 500 x 400, 30 degrees down, samples 0.6 voxels apart.
//!
//! The paper's times are of one R10000 processor of 194 MHz; what can be compared are its ratios.
//! Those of one worker are taken of the thread's processor time, which other load on the machine
//! disturbs least; those of two workers of elapsed time.

use crate::findings::Findings;
use crate::measurement::{Measurement, Target, median};
use anyhow::Context;
use glam::DVec2;
use std::time::Instant;
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::surface::Plane;
use terravision_common::synthetic::{Relief, SyntheticTerrain};

use terravision_raycast::Sampling;
use terravision_raycast::model::color::{ColorLayout, ColorPlace};
use terravision_raycast::model::{Filter, Ground, GroundShape, TileSpec};
use terravision_raycast::{CastOptions, CastTask, Caster, Counts, Picture, SweepDetail};
use terravision_testkit::rays::AnyMethod;
use terravision_testkit::worlds;

/// Posts of the volume along a side, and its layers.
const SIDE: usize = 512;
const LAYERS: f32 = 64.0;
const SIZE: [u32; 2] = [500, 400];
/// Roll angles from 0 to 45 degrees.
const ROLLS: u32 = 10;
const BENCH: &str = "rays";

/// What the paper measured, seconds: accurate and approximate on one processor, without coherence,
/// rolled by 45 degrees, and accurate on four processors.
mod paper {
    pub(super) const ACCURATE_S: f64 = 0.92;
    pub(super) const PLAIN_S: f64 = 6.71;
    pub(super) const APPROXIMATE_S: f64 = 0.65;
    pub(super) const ROLLED_S: f64 = 1.04;
    /// Accurate on one processor against four, per doubling: 1.81. Its approximate mode reaches
    /// 1.76, its text speaks of more; wanted is 1.86.
    pub(super) const PER_DOUBLING: f64 = 1.86;
}

/// The scene: one tile of voxels a metre wide.
struct Scene {
    ground: Ground,
    colors: Vec<u8>,
}

impl Scene {
    fn new() -> anyhow::Result<Self> {
        let world = worlds::world([SIDE as u32; 2], 1.0, [64, 64]);
        let terrain = SyntheticTerrain::new(&world, Relief::Mountains { height_m: 1.0 }, 7);
        let raw: Vec<f32> = (0..SIDE * SIDE)
            .map(|k| {
                // Octaves shorter than four voxels are left out, as in data that is sampled well.
                let (x, y) = ((k % SIDE) as u64, (k / SIDE) as u64);
                let corner = |i, j| terrain.post(2, x / 4 + i, y / 4 + j);
                let (u, v) = ((x % 4) as f32 / 4.0, (y % 4) as f32 / 4.0);
                let south = corner(0, 0) + (corner(1, 0) - corner(0, 0)) * u;
                let north = corner(0, 1) + (corner(1, 1) - corner(0, 1)) * u;
                south + (north - south) * v
            })
            .collect();
        let (low, high) = raw.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), z| (l.min(*z), h.max(*z)));
        // Room for the filter above and below, within the volume's layers.
        let heights: Vec<f32> = raw.iter().map(|z| 4.0 + (z - low) / (high - low) * (LAYERS - 9.0)).collect();
        let at = |x: usize, y: usize| heights[y.min(SIDE - 1) * SIDE + x.min(SIDE - 1)];
        let mut texels = Vec::with_capacity(SIDE * SIDE * 4);
        for row in 0..SIDE {
            // Row 0 of colours is the northern one.
            let y = SIDE - 1 - row;
            for x in 0..SIDE {
                let light = 0.75 + 0.2 * (at(x + 1, y) - at(x, y)) - 0.1 * (at(x, y + 1) - at(x, y));
                let share = at(x, y) / LAYERS;
                let color = [90.0 + 120.0 * share, 120.0 + 60.0 * share, 60.0 + 110.0 * share];
                texels.extend(color.map(|c| (c * light).clamp(0.0, 255.0) as u8));
                texels.push(255);
            }
        }
        let shape = GroundShape {
            surface: Plane::new(1.0, [u32::MAX; 2], SIDE as u32),
            levels: 1,
            color: ColorLayout { side: SIDE as u32, mips: 1 },
            filter: Some(Filter::OrientedBox),
        };
        let mut ground = Ground::new(shape);
        ground.add(&TileSpec {
            origin: [0, 0],
            level: 0,
            log_spacing: 0,
            cells: [SIDE as u32 - 1; 2],
            heights: &heights,
            shares: None,
            stride: SIDE,
            datum_m: 0.0,
            // One colour per column: texels' centres are the columns.
            color: ColorPlace::new(0, DVec2::new(-0.5, SIDE as f64 - 0.5), 1.0),
            is_accurate: true,
        })?;
        ground.finish();
        Ok(Self { ground, colors: texels })
    }
}

/// Heights of the eye above the volume's bottom, voxels. The paper does not tell its own. Its plain
/// rays took 7.3 times as long as its accurate ones, 6500 cycles of its processor in place of 890:
/// with the 25 or 30 that a sample in the air costs, some 200 samples more, or 120 voxels: an eye
/// some 60 above the ground, 30 degrees down. So the middle one is taken for the table, the others
/// show what the height does.
const EYES: [f64; 3] = [70.0, 100.0, 130.0];
const EYE: f64 = EYES[1];

/// The view: 30 degrees down and eastwards, from over the western edge. The paper does not tell its
/// field of view either; here the uppermost ray meets the ground near the far edge, so that the
/// picture is all ground.
fn camera(eye: f64, roll_deg: f64) -> Camera {
    let to_far_edge = ((eye - 20.0) / (0.7 * SIDE as f64)).atan();
    Camera::new(CameraFields {
        eye_in_world: [4.0, 0.5 * SIDE as f64, eye],
        heading_rad: 90f64.to_radians(),
        pitch_rad: -30f64.to_radians(),
        roll_rad: roll_deg.to_radians(),
        vfov_rad: 2.0 * (30f64.to_radians() - to_far_edge),
        width: SIZE[0],
        height: SIZE[1],
        timestamp_nanos: 0,
    })
    .expect("valid")
}

/// One way of drawing.
struct Way {
    name: &'static str,
    method: AnyMethod,
    options: CastOptions,
    workers: usize,
    roll_deg: f64,
    eye: f64,
    /// Elapsed, and on the processor of the calling thread.
    millis: Vec<f64>,
    cpu_millis: Vec<f64>,
    counts: Counts,
}

impl Way {
    fn new(name: &'static str, method: AnyMethod, is_approximate: bool, workers: usize) -> Self {
        // A volume of one level: the interval does not grow with distance.
        let sampling = Sampling { interval_voxels: 0.6, voxel_px: 0.0 };
        // Samples alone, as the paper's.
        let options = CastOptions { is_approximate, sampling, looks_between: false, ..CastOptions::default() };
        Self {
            name,
            method,
            options,
            workers,
            roll_deg: 0.0,
            eye: EYE,
            millis: Vec::new(),
            cpu_millis: Vec::new(),
            counts: Counts::default(),
        }
    }

    fn rolled(self, roll_deg: f64) -> Self {
        Self { roll_deg, ..self }
    }

    fn looking_between(mut self) -> Self {
        self.options.looks_between = true;
        self
    }

    /// By a sweep: a plane to a pixel and steps of half a voxel, or its default.
    fn swept(name: &'static str, is_approximate: bool, workers: usize) -> Self {
        let mut way = Self::new(name, AnyMethod::Sweep, is_approximate, workers);
        let accurate = SweepDetail { step_px: 0.0, of_spacing: 0.5, lines_per_px: 1.0, ..SweepDetail::DEFAULT };
        way.options.sweep = if is_approximate { SweepDetail::DEFAULT } else { accurate };
        way
    }

    fn seen_from(self, eye: f64) -> Self {
        Self { eye, ..self }
    }

    fn milliseconds(&self) -> f64 {
        median(&self.millis)
    }

    fn cpu_milliseconds(&self) -> f64 {
        median(&self.cpu_millis)
    }
}

/// Processor time of this thread.
fn thread_cpu_millis() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    1e3 * time.tv_sec as f64 + 1e-6 * time.tv_nsec as f64
}

/// Ways of the sweep without roll.
const SWEEPS: usize = 4;
/// What is compared from several heights.
const WAYS_OF_HEIGHT: [(&str, AnyMethod, bool); 4] = [
    ("accurate", AnyMethod::Coherent, false),
    ("approximate", AnyMethod::Coherent, true),
    ("plain from the eye", AnyMethod::FromEye, false),
    ("plain from the volume's top", AnyMethod::Plain, false),
];

/// Measures the table: every way in turn, round after round, so that a slower minute of the machine
/// is one for all.
///
/// # Errors
/// The machine gives no threads.
pub fn run(rounds: u32, findings: &mut Findings) -> anyhow::Result<()> {
    let scene = Scene::new().context("the volume")?;
    let mut ways = vec![
        Way::new("accurate, 1 worker", AnyMethod::Coherent, false, 1),
        Way::new("accurate, 2 workers", AnyMethod::Coherent, false, 2),
        Way::new("approximate, 1 worker", AnyMethod::Coherent, true, 1),
        Way::new("approximate, 2 workers", AnyMethod::Coherent, true, 2),
        Way::new("plain, 1 worker", AnyMethod::FromEye, false, 1),
        Way::new("mipmap, 1 worker", AnyMethod::Mipmap, false, 1),
        Way::new("mipmap, 2 workers", AnyMethod::Mipmap, false, 2),
        Way::new("accurate, looking between samples, 1 worker", AnyMethod::Coherent, false, 1).looking_between(),
    ];
    let roll_deg = |n: u32| 45.0 * f64::from(n) / f64::from(ROLLS - 1);
    let first_roll = ways.len();
    ways.extend((0..ROLLS).map(|n| Way::new("accurate, rolled", AnyMethod::Coherent, false, 1).rolled(roll_deg(n))));
    let first_sweep = ways.len();
    ways.extend([
        Way::swept("sweep, 1 worker", false, 1),
        Way::swept("sweep, 2 workers", false, 2),
        Way::swept("sweep by default, 1 worker", true, 1),
        Way::swept("sweep by default, 2 workers", true, 2),
    ]);
    ways.extend((0..ROLLS).map(|n| Way::swept("sweep, rolled", false, 1).rolled(roll_deg(n))));
    let first_height = ways.len();
    for eye in EYES {
        ways.extend(
            WAYS_OF_HEIGHT
                .map(|(name, method, is_approximate)| Way::new(name, method, is_approximate, 1).seen_from(eye)),
        );
    }
    let mut casters = [Caster::new(1)?, Caster::new(2)?];
    let picture = Picture::new(SIZE);
    for _ in 0..rounds {
        for way in &mut ways {
            let caster = &mut casters[way.workers - 1];
            let task = CastTask {
                ground: &scene.ground,
                colors: &[&scene.colors[..]],
                heights: &[],
                camera: &camera(way.eye, way.roll_deg),
                options: &way.options,
                picture: &picture,
            };
            // As in a flight, the frame before was drawn in the same way: threads are awake, and what
            // each of them reads is in its caches.
            way.method.draw(caster, &task);
            let (start, cpu_start) = (Instant::now(), thread_cpu_millis());
            way.counts = way.method.draw(caster, &task);
            way.cpu_millis.push(thread_cpu_millis() - cpu_start);
            way.millis.push(1e3 * start.elapsed().as_secs_f64());
        }
    }
    tell(&ways, [first_roll, first_sweep, first_height], rounds, findings);
    findings
        .facts
        .push(("volume", format!("{SIDE} x {SIDE} x {LAYERS} voxels, {} MB of models", scene.ground.bytes() >> 20)));
    findings.facts.push(("picture", format!("{} x {}, 30 degrees down, interval 0.6", SIZE[0], SIZE[1])));
    Ok(())
}

fn tell(ways: &[Way], [first_roll, first_sweep, first_height]: [usize; 3], rounds: u32, findings: &mut Findings) {
    let samples = u64::from(rounds);
    let mut put = |name: String, value: f64, unit, target: Option<Target>| {
        let m = Measurement::new(BENCH, name, value, unit, samples);
        findings.measurements.push(match target {
            Some(target) => m.with_target(target),
            None => m,
        });
    };
    let sweeps = &ways[first_sweep..first_height];
    tell_ratios(ways, &ways[first_roll..first_sweep], sweeps, &mut put);
    let [mipmap, mipmap_2, between] = [5, 6, 7].map(|n| ways[n].milliseconds());
    put("mipmap, 1 worker / 2 workers".to_owned(), mipmap / mipmap_2, "x", None);
    for (way, paper_s) in
        ways.iter().zip([Some(paper::ACCURATE_S), None, Some(paper::APPROXIMATE_S), None, Some(paper::PLAIN_S)])
    {
        let paper = paper_s.map_or_else(String::new, |s| format!(" (paper {:.0} ms)", 1e3 * s));
        put(format!("{}{paper}", way.name), way.milliseconds(), "ms", None);
    }
    put("mipmap, 1 worker".to_owned(), mipmap, "ms", None);
    put(ways[7].name.to_owned(), between, "ms", None);
    for way in &ways[first_roll..first_sweep] {
        put(format!("accurate, roll {:.0} degrees", way.roll_deg), way.milliseconds(), "ms", None);
    }
    for way in &sweeps[..SWEEPS] {
        put(way.name.to_owned(), way.milliseconds(), "ms", None);
    }
    for way in &sweeps[SWEEPS..] {
        put(format!("sweep, roll {:.0} degrees", way.roll_deg), way.milliseconds(), "ms", None);
    }
    for way in [&ways[0], &ways[2], &ways[4], &ways[5], &sweeps[0], &sweeps[2]] {
        let Counts { rays, samples, densities, without_witness, .. } = way.counts;
        let per_ray = |n: u64| n as f64 / rays as f64;
        put(format!("{}: rays of a core", way.name), rays as f64 / way.cpu_milliseconds() * 1e3, "rays/s", None);
        put(format!("{}: samples of a ray", way.name), per_ray(samples), "", None);
        if densities > 0 {
            put(format!("{}: densities of a ray", way.name), per_ray(densities), "", None);
        }
        put(format!("{}: rays from the beginning", way.name), per_ray(without_witness), "", None);
    }
    for of_height in ways[first_height..].chunks_exact(WAYS_OF_HEIGHT.len()) {
        let [accurate, approximate, from_eye, below_top] = std::array::from_fn(|n| of_height[n].cpu_milliseconds());
        let eye = of_height[0].eye;
        for (name, plain) in [("plain from the eye", from_eye), ("plain from the volume's top", below_top)] {
            put(format!("eye at {eye:.0}: {name} / accurate"), plain / accurate, "x", None);
            put(format!("eye at {eye:.0}: {name} / approximate"), plain / approximate, "x", None);
        }
    }
}

/// The paper's ratios. Its coherent rays are the sweep's planes on today's processors: targets are
/// for those.
fn tell_ratios(
    ways: &[Way],
    rolled: &[Way],
    sweeps: &[Way],
    put: &mut impl FnMut(String, f64, &'static str, Option<Target>),
) {
    let plain = ways[4].cpu_milliseconds();
    let (coherence, approximation) = (paper::PLAIN_S / paper::ACCURATE_S, paper::PLAIN_S / paper::APPROXIMATE_S);
    for (way, ratio) in [(&sweeps[0], coherence), (&sweeps[2], approximation)] {
        let name = format!("plain / {} (paper {ratio:.1})", way.name);
        put(name, plain / way.cpu_milliseconds(), "x", Some(Target::AtLeast(ratio)));
    }
    for (way, name) in [(&ways[0], "accurate (paper 7.3)"), (&ways[2], "approximate (paper 10)")] {
        put(format!("plain / {name}"), plain / way.cpu_milliseconds(), "x", None);
    }
    let worst = |rolled: &[Way]| {
        let millis = rolled.iter().map(Way::cpu_milliseconds);
        millis.fold(0.0, f64::max) / rolled[0].cpu_milliseconds()
    };
    let limit = Target::AtMost(paper::ROLLED_S / paper::ACCURATE_S);
    put("sweep: worst roll / no roll (paper 1.13)".to_owned(), worst(&sweeps[SWEEPS..]), "x", Some(limit));
    put("worst roll / no roll (paper 1.13)".to_owned(), worst(rolled), "x", None);
    for (of, name, target) in [
        (&sweeps[..2], "sweep", Some(Target::AtLeast(paper::PER_DOUBLING))),
        (&sweeps[2..4], "sweep by default", Some(Target::AtLeast(paper::PER_DOUBLING))),
        (&ways[..2], "accurate", None),
        (&ways[2..4], "approximate", None),
    ] {
        let ratio = of[0].milliseconds() / of[1].milliseconds();
        put(format!("{name}, 1 worker / 2 workers (paper 1.86)"), ratio, "x", target);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_table_has_all_its_rows_and_the_picture_is_all_land() {
        let mut findings = Findings::default();
        run(1, &mut findings).unwrap();
        let value = |start: &str| {
            let row = findings.measurements.iter().find(|m| m.name.starts_with(start));
            row.map(|m| m.value).unwrap_or_else(|| panic!("no row {start}"))
        };
        assert_eq!(findings.measurements.iter().filter(|m| m.name.starts_with("accurate, roll ")).count(), 10);
        assert_eq!(findings.measurements.iter().filter(|m| m.target.is_some()).count(), 5);
        assert_eq!(findings.measurements.iter().filter(|m| m.name.starts_with("sweep, roll ")).count(), 10);
        // Work, not time: plain rays look at many more samples.
        let [coherent, plain] = ["accurate, 1 worker: samples", "plain, 1 worker: samples"].map(value);
        assert!(plain > 10.0 * coherent && coherent < 8.0, "{plain} {coherent}");
        let scene = Scene::new().unwrap();
        let picture = Picture::new(SIZE);
        let way = Way::new("", AnyMethod::Mipmap, false, 1);
        let mut caster = Caster::new(1).unwrap();
        for eye in EYES {
            let camera = camera(eye, 0.0);
            let counts = way.method.draw(
                &mut caster,
                &CastTask {
                    ground: &scene.ground,
                    colors: &[&scene.colors[..]],
                    heights: &[],
                    camera: &camera,
                    options: &way.options,
                    picture: &picture,
                },
            );
            assert_eq!(counts.hits, counts.rays, "{eye}");
        }
    }
}
