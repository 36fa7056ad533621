//! How true the pictures of a world are: what the pipeline draws, by default and at best, against
//! plain rays on the finest heights that the database has.
//!
//! ```text
//! database, finest level ─▶ truth ──▶ reference picture ┐
//!          views of the round ─▶ terravision still ─────┴▶ displacement · holes · dB · SSIM
//! ```

mod cost;
mod displacement;
mod legend;
mod map;
mod setting;
mod still;
mod table;
mod truth;

use crate::cli::{Options, QualityArgs};
use crate::findings::Findings;
use crate::flight::Flight;
use crate::measurement::{Measurement, Target, quantile};
use crate::session::Scratch;
use anyhow::{Context, ensure};
use displacement::Displacement;
use setting::{Setting, TECHNIQUES, USUAL};
use std::io::IsTerminal;
use std::path::Path;
use still::Still;
use table::table;
use terravision_common::camera::Camera;
use terravision_testkit::metrics::{count_holes, try_compare};
use terravision_testkit::reference::{Picture, RenderOptions, render};
use truth::Truth;

const BENCH: &str = "quality";
/// Views are taken evenly of a round of this many poses, whatever their number: their heights
/// above ground depend on their neighbours in the round.
const ROUND: u64 = 240;
/// Rays of the reference along a pixel's side.
const RAYS_PER_SIDE: u32 = 3;
const SKY_RGB: [u8; 3] = [150, 190, 235];
/// Facets move a silhouette: sky that is nearer to the truth's sky is no hole, pixels.
const TOLERANCE_PX: usize = 10;
/// Share of land pixels that the targets are about.
const NEARLY_ALL: f64 = 0.99;

/// What the pictures of a setting are like, all views together.
#[derive(Debug, Default)]
struct Found {
    displacements: Vec<Displacement>,
    holes: usize,
    sunken: usize,
    land_pixels: usize,
    squares: f64,
    similarities: f64,
    /// Processor time of a frame, if that was measured.
    millis: Option<f64>,
}

/// Draws views of a world and measures how true they are.
///
/// # Errors
/// When the world does not fit into memory, or a picture fails.
pub fn run(args: &QualityArgs, world: &Path, options: &Options, findings: &mut Findings) -> anyhow::Result<()> {
    let flight = Flight::open(world, ROUND, options.size)?;
    let truth = Truth::read(&flight.database, options.memory_mib << 20)?;
    let folder = Scratch::new(BENCH)?;
    let views: Vec<Camera> = views(&flight, args.views);
    let settings = if args.techniques { TECHNIQUES } else { USUAL };
    let mut found: Vec<Found> = settings.iter().map(|_| Found::default()).collect();
    for (number, camera) in (1..).zip(&views) {
        let sky = RenderOptions { rays_per_side: RAYS_PER_SIDE, sky_rgb: SKY_RGB, exaggeration: 1.0 };
        progress(format_args!("view {number} of {}: the truth", views.len()));
        let reference = truth.masked(render(truth.scene(), camera, &sky));
        let shot = Shot { world, truth: &truth, camera, reference: &reference, number, options };
        shot.keep(&format!("view-{number}-truth.png"), &reference.rgb)?;
        for (setting, found) in settings.iter().zip(&mut found) {
            progress(format_args!("view {number} of {}: {}", views.len(), setting.name));
            shot.measure(setting, &args.still, folder.path(), found)?;
        }
    }
    findings.facts.push(("database", world.display().to_string()));
    findings.facts.push(("views", format!("{} of {}x{}", views.len(), options.size[0], options.size[1])));
    if !args.still.is_empty() {
        findings.facts.push(("arguments of still", args.still.join(" ")));
    }
    for (setting, found) in settings.iter().zip(&mut found) {
        if args.techniques {
            progress(format_args!("{}: what a frame costs", setting.name));
            found.millis = Some(cost::millis_a_frame(world, options.size, setting, &args.still)?);
        }
        findings.measurements.extend(measurements(setting, found, views.len() as u64)?);
    }
    if args.techniques {
        findings.tables.push(table(settings, &findings.measurements));
    }
    Ok(())
}

/// This many poses of the round, evenly.
fn views(flight: &Flight, count: u32) -> Vec<Camera> {
    let count = count as usize;
    (0..count).map(|k| flight.round[k * flight.round.len() / count]).collect()
}

fn progress(what: std::fmt::Arguments<'_>) {
    if std::io::stderr().is_terminal() {
        terravision_common::terminal::complain(&format!("terravision bench: quality: {what}"));
    }
}

/// A view, and what it should show.
struct Shot<'a> {
    world: &'a Path,
    truth: &'a Truth,
    camera: &'a Camera,
    reference: &'a Picture,
    number: u32,
    options: &'a Options,
}

impl Shot<'_> {
    fn measure(&self, setting: &Setting, more: &[String], folder: &Path, found: &mut Found) -> anyhow::Result<()> {
        let what = || format!("view {}, {}", self.number, setting.name);
        let taken = Still { world: self.world, frame: self.truth.frame(), camera: self.camera, setting, more }
            .take(SKY_RGB, folder)
            .with_context(what)?;
        let land = &self.reference.is_land;
        let compared = try_compare(self.reference.width, &taken.rgb, &self.reference.rgb, land)
            .with_context(|| format!("{}: hardly any land is seen; fly over another world", what()))?;
        let pixels = compared.pixels as f64;
        found.land_pixels += compared.pixels;
        found.squares += pixels * 255.0 * 255.0 / 10f64.powf(compared.psnr_db / 10.0);
        found.similarities += pixels * compared.ssim;
        // Neither alone: ground may have the sky's colour, and ground that was made up has no depth.
        let is_sky: Vec<bool> =
            taken.depth.iter().zip(&taken.rgb).map(|(depth, rgb)| depth.is_nan() && *rgb == SKY_RGB).collect();
        found.sunken += is_sky.iter().zip(land).filter(|(is_sky, is_land)| **is_sky && **is_land).count();
        found.holes += count_holes(&is_sky, self.reference, TOLERANCE_PX).count;
        let displacements = self.truth.displacements(self.camera, &taken, land);
        let mut map = map::draw(&displacements, &is_sky, land);
        legend::draw(&mut map, self.reference.width);
        let name = format!("view-{}-{}", self.number, setting.file);
        self.keep(&format!("{name}.png"), &taken.rgb)?;
        self.keep(&format!("{name}-displacement.png"), &map)?;
        found.displacements.extend(displacements.into_iter().flatten());
        Ok(())
    }

    /// Writes a picture where pictures are wanted.
    fn keep(&self, name: &str, rgb: &[[u8; 3]]) -> anyhow::Result<()> {
        let Some(folder) = &self.options.output else { return Ok(()) };
        std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
        let path = folder.join(name);
        let [width, height] = self.options.size;
        image::save_buffer(&path, rgb.as_flattened(), width, height, image::ExtendedColorType::Rgb8)
            .with_context(|| format!("cannot write {}", path.display()))
    }
}

fn measurements(setting: &Setting, found: &Found, views: u64) -> anyhow::Result<Vec<Measurement>> {
    ensure!(!found.displacements.is_empty(), "no view shows land; fly over another world");
    let named =
        |name: &str, value, unit| Measurement::new(BENCH, format!("{}: {name}", setting.name), value, unit, views);
    let [px, m] = [|d: &Displacement| d.px, |d: &Displacement| d.m].map(|of| {
        let mut values: Vec<f64> = found.displacements.iter().map(of).collect();
        values.sort_unstable_by(f64::total_cmp);
        values
    });
    let mut all = Vec::new();
    for (share, name) in [(0.5, "50 %"), (0.9, "90 %"), (NEARLY_ALL, "99 %"), (0.999, "99.9 %")] {
        let off = named(&format!("{name} of land on screen within"), quantile(&px, share), "px");
        all.push(if share == NEARLY_ALL { off.with_target(Target::AtMost(setting.most_px)) } else { off });
        all.push(named(&format!("{name} of land within"), quantile(&m, share), "m"));
    }
    let pixels = found.land_pixels as f64;
    all.push(named("holes", found.holes as f64, "pixels").with_target(Target::AtMost(0.0)));
    all.push(named("sky in place of land, at skylines too", found.sunken as f64, "pixels"));
    all.push(named("PSNR of land", 10.0 * (255.0 * 255.0 * pixels / found.squares).log10(), "dB"));
    all.push(named("SSIM of land", found.similarities / pixels, ""));
    all.extend(found.millis.map(|millis| named("processor time of a frame", millis, "ms")));
    Ok(all)
}
