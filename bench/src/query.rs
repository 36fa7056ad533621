//! Questions to the ground: how many are answered in a second, on one core, of tiles in memory; and
//! by `terravision query` through a pipe.

use crate::findings::Findings;
use crate::measurement::{Measurement, Target, median};
use crate::session::sibling;
use anyhow::{Context, ensure};
use glam::{DVec2, DVec3};
use std::fmt::Write as _;
use std::hint::black_box;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Instant;
use terravision_common::database::Database;
use terravision_common::ground::{GroundScratch, GroundTiles, Interpolation};

/// Places that are asked for, all over the world.
const PLACES: usize = 1 << 20;
/// Places that are asked together.
const BATCH: usize = 4096;
/// Lines of sight, and spheres.
const LINES: usize = 20_000;
/// How long such lines are, metres, and how high above the ground their ends.
const LINE_M: f64 = 2000.0;
const ABOVE_M: f64 = 20.0;
/// Radius of spheres, metres.
const RADIUS_M: f64 = 2.0;
/// Rounds of which the median counts.
const ROUNDS: usize = 5;
/// Memory for tiles: all of the world has to fit.
const KEPT_BYTES: usize = 2 << 30;

/// Numbers without a pattern, from 0 to 1.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Measures over a database.
///
/// # Errors
/// When it cannot be read, or the command fails.
pub fn run(world: &Path, findings: &mut Findings) -> anyhow::Result<()> {
    let database = Database::open(world)?;
    let tiles = GroundTiles::new(&database, database.world(), KEPT_BYTES).bounded(database.ranges());
    let (surface, frame) = (database.world().plane(), database.world().crs_frame());
    let mut random = Random(1);
    let end = surface.end();
    let feet: Vec<DVec2> = (0..PLACES).map(|_| end * DVec2::new(random.next(), random.next())).collect();
    let mut scratch = GroundScratch::default();
    let mut add = |name: &str, value: f64, unit: &'static str, samples: usize, target: Option<Target>| {
        let measured = Measurement::new("query", name, value, unit, samples as u64);
        findings.measurements.push(match target {
            Some(target) => measured.with_target(target),
            None => measured,
        });
    };
    let mut answers = Vec::with_capacity(BATCH);
    let mut all = |interpolation, scratch: &mut GroundScratch| {
        for batch in feet.chunks(BATCH) {
            answers.clear();
            tiles.sample_all(batch, interpolation, scratch, &mut answers);
            black_box(&answers);
        }
        answers.iter().all(Result::is_ok)
    };
    // All tiles are in memory then.
    ensure!(all(Interpolation::Facet, &mut scratch), "the world has places without ground");
    let at_least = Some(Target::AtLeast(1e6));
    let facet = per_second(PLACES, || all(Interpolation::Facet, &mut scratch));
    add("heights and normals of places all over, on facets, in batches", facet, "places/s", PLACES, at_least);
    let bilinear = per_second(PLACES, || all(Interpolation::Bilinear, &mut scratch));
    add("heights and normals of places all over, bilinear, in batches", bilinear, "places/s", PLACES, at_least);
    let single = per_second(PLACES, || {
        feet.iter().all(|foot| black_box(tiles.sample(*foot, Interpolation::Facet, &mut scratch)).is_ok())
    });
    add("heights and normals of places all over, one by one", single, "places/s", PLACES, at_least);

    let mut above = |foot: DVec2| -> anyhow::Result<DVec3> {
        let sample = tiles.sample(foot, Interpolation::Facet, &mut scratch)?;
        Ok(surface.position(foot, sample.found.ground.height_m + ABOVE_M))
    };
    let mut lines = Vec::with_capacity(LINES);
    for from in &feet[..LINES] {
        let angle = random.next() * std::f64::consts::TAU;
        let to = (*from + DVec2::from_angle(angle) * LINE_M).clamp(DVec2::ZERO, end);
        lines.push((above(*from)?, above(to)?));
    }
    let sights = per_second(LINES, || {
        lines.iter().all(|(from, to)| black_box(tiles.line_of_sight(*from, *to, &mut scratch)).is_ok())
    });
    add("lines of sight of 2 km, 20 m above the ground", sights, "lines/s", LINES, None);
    let spheres = per_second(LINES, || {
        lines.iter().all(|(from, to)| black_box(tiles.sweep_sphere(*from, *to, RADIUS_M, &mut scratch)).is_ok())
    });
    add("spheres of 2 m on these lines", spheres, "spheres/s", LINES, None);

    let mut text = String::new();
    for foot in &feet {
        let place = frame.place_of_foot(*foot);
        writeln!(text, "{:.2} {:.2}", place.x, place.y).context("text grows in memory")?;
    }
    let piped = per_second(PLACES, || ask(world, text.as_bytes()).is_ok());
    add("terravision query through a pipe, its start included", piped, "places/s", PLACES, None);
    Ok(())
}

/// The median of some rounds.
fn per_second(count: usize, mut round: impl FnMut() -> bool) -> f64 {
    let seconds: Vec<f64> = (0..ROUNDS)
        .map(|_| {
            let start = Instant::now();
            // What fails is not fast.
            if round() { start.elapsed().as_secs_f64() } else { f64::INFINITY }
        })
        .collect();
    count as f64 / median(&seconds)
}

/// Asks the command; its answers go nowhere.
fn ask(world: &Path, lines: &[u8]) -> anyhow::Result<()> {
    let mut command = Command::new(sibling("terravision")?);
    let command = command.arg("query").arg(world).stdin(Stdio::piped()).stdout(Stdio::null());
    let mut child = command.spawn().context("terravision does not start")?;
    let mut stdin = child.stdin.take().context("a pipe was asked for")?;
    stdin.write_all(lines).context("terravision query takes no lines")?;
    drop(stdin);
    let status = child.wait().context("terravision query")?;
    ensure!(status.success(), "terravision query: {status}");
    Ok(())
}
