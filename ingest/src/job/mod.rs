//! A complete ingest, from files to a database.

mod body;
mod elevation;
mod output;
mod record;
mod summary;

pub use summary::summary;

use crate::archive;
use crate::body::BodyChoice;
use crate::crests::Crests;
use crate::error::IngestError;
use crate::nested::{Nodes, Sources};
use crate::plan::{Plan, PlanOptions};
use crate::pyramid;
use crate::pyramid::validity::Shares;
use crate::sample;
use crate::source::values::{ColorValues, ElevationValues, NodataChoice};
use crate::source::{Access, Note, Raster, Region, TargetCrs, area, region};
use crate::store::{Level, Rgb};
use crate::tint::{Place, Tint};
use crate::work::Work;
use elevation::{Elevation, told_source_range};
use output::Output;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use terravision_common::database::{
    ArchiveRecord, COLOR_FILE, ELEVATION_FILE, Manifest, NODES_FILE, NodesRecord, Voids, VoidsRecord,
};
use terravision_common::tint::HeightColors;
use terravision_common::world::World;

/// A checked job.
#[derive(Debug, Clone)]
pub struct Job {
    /// Elevation sources, the topmost first.
    pub elevation: Vec<PathBuf>,
    /// Colour sources, the topmost first.
    pub color: Vec<PathBuf>,
    /// Folder of the database.
    pub output: PathBuf,
    /// CRS of the database, when the user chose one.
    pub crs: Option<String>,
    /// CRS of sources that have none.
    pub source_crs: Option<String>,
    /// The part of the data that becomes a world; all of it if `None`.
    pub region: Option<Region>,
    /// Which other files and addresses files may refer to.
    pub access: Access,
    /// Memory limit, bytes.
    pub memory_bytes: u64,
    /// Whether a finished database may be replaced.
    pub may_overwrite: bool,
    /// Which values mean "no data" in elevation.
    pub nodata: NodataChoice,
    /// Metres per unit of elevation, if the user set the unit.
    pub elevation_unit_m: Option<f64>,
    /// Bands for red, green and blue.
    pub bands: Option<[usize; 3]>,
    /// Quality of colour tiles, 1 to 100.
    pub color_quality: u8,
    /// Threads that work.
    pub threads: usize,
    /// Tile sizes, spacing.
    pub plan: PlanOptions,
    /// How ground without data is handled.
    pub voids: Voids,
    /// Whether the crests of coarser levels are raised.
    pub raises_crests: bool,
    /// Whether the data become a whole body.
    pub body: BodyChoice,
}

/// How true colours are kept (`--quality`).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum ColorQuality {
    /// Small tiles.
    #[default]
    Default,
    /// Half as many bytes again, for pictures that are 1 dB truer (docs/quality.md).
    Best,
}

impl ColorQuality {
    /// The quality of JPEG, 1 to 100.
    #[must_use]
    pub fn jpeg(self) -> u8 {
        match self {
            Self::Default => 90,
            Self::Best => 95,
        }
    }
}

/// Upper bound of the memory of a working thread (a window of a source in samples and pixels),
/// bytes.
const THREAD_BYTES: u64 = 64 << 20;
/// The smallest possible memory limit: program, libraries, one thread, a small cache.
pub const LEAST_MEMORY_BYTES: u64 = 256 << 20;
/// Memory per node of the tree for height ranges and the archives' directories, bytes.
const NODE_BYTES: u64 = 100;

impl Job {
    /// A job with defaults.
    #[must_use]
    pub fn new(elevation: Vec<PathBuf>, color: Vec<PathBuf>, output: PathBuf) -> Self {
        Self {
            elevation,
            color,
            output,
            crs: None,
            source_crs: None,
            region: None,
            access: Access::default(),
            memory_bytes: 2 << 30,
            may_overwrite: false,
            nodata: NodataChoice::FromFiles,
            elevation_unit_m: None,
            bands: None,
            color_quality: ColorQuality::Default.jpeg(),
            threads: std::thread::available_parallelism().map_or(1, usize::from),
            plan: PlanOptions::default(),
            voids: Voids::default(),
            raises_crests: true,
            body: BodyChoice::Auto,
        }
    }

    /// Elevation and colour sources and the CRS of the world that they make.
    fn sources(
        &self,
        elevation: Vec<Raster>,
        note: &mut dyn FnMut(Note),
    ) -> Result<(Vec<Raster>, Vec<Raster>, TargetCrs), IngestError> {
        let color = self.describe(&self.color, None, note)?;
        area::check(&elevation.iter().chain(&color).collect::<Vec<_>>(), note)?;
        let (elevation, color, target) = match &self.region {
            None => {
                let target = TargetCrs::choose(&elevation, self.crs.as_deref(), note)?;
                (elevation, color, target)
            }
            Some(region) => {
                let target = TargetCrs::choose(&region.parts(&elevation)?, self.crs.as_deref(), note)?;
                let rect = region.rect_in(&target)?;
                let elevation = region::parts_in(elevation, rect, &target)?;
                if elevation.is_empty() {
                    return Err(IngestError::usage("--bounds lies outside the elevation"));
                }
                let has_color = !color.is_empty();
                let color = region::parts_in(color, rect, &target)?;
                if has_color && color.is_empty() {
                    return Err(IngestError::usage(
                        "--bounds lies outside the colour files: leave --color out, or others",
                    ));
                }
                (elevation, color, target)
            }
        };
        if self.crs.is_some() {
            area::check_target(&target, &elevation.iter().collect::<Vec<_>>(), note);
        }
        Ok((elevation, color, target))
    }

    /// Runs the job. `stop` ends it early; `note` gets messages for the user.
    ///
    /// # Errors
    /// [`IngestError`]. Then nothing is left in the output, except an earlier finished database.
    pub fn run(
        &self,
        stop: Arc<AtomicBool>,
        shows_progress: bool,
        note: &mut dyn FnMut(Note),
    ) -> Result<Manifest, IngestError> {
        if self.memory_bytes < LEAST_MEMORY_BYTES {
            let [asked, least] = [self.memory_bytes >> 20, LEAST_MEMORY_BYTES >> 20];
            return Err(IngestError::usage(format!("--memory is {asked} MiB, expected at least {least} MiB")));
        }
        quieten_gdal(self.memory_bytes);
        let affordable = (self.memory_bytes / 2 / THREAD_BYTES).max(1) as usize;
        let work = Work::new(self.threads.min(affordable), stop, shows_progress, self.output.clone());
        // First everything that needs no output: most mistakes are found here.
        let elevation = self.describe(&self.elevation, self.body.assumed_crs().as_deref(), note)?;
        if let Some(kind) = self.chosen_body(&elevation, note)? {
            return self.run_body(kind, elevation, &work, note);
        }
        let (elevation, color, target) = self.sources(elevation, note)?;
        let plan = Plan::new(&target, &elevation, &color, self.plan, note)?;
        self.check_memory(&plan)?;
        let output = Output::begin(&self.output, self.may_overwrite)?;
        output.check_space(plan.disk_bytes())?;
        let values = |raster: Raster, note: &mut dyn FnMut(Note)| {
            let values = ElevationValues::of(&raster, self.nodata, self.elevation_unit_m, &work, note)?;
            Ok((raster, values))
        };
        let elevation = elevation.into_iter().map(|r| values(r, note)).collect::<Result<Vec<_>, IngestError>>()?;
        let color_values = ColorValues::of_all(&color, self.bands, self.nodata, note)?;
        let color: Vec<_> = color.into_iter().zip(color_values).collect();
        let manifest = self.build(&plan, &target, &elevation, &color, &output, &work, note)?;
        output.finish(&manifest, &work)?;
        Ok(manifest)
    }

    fn check_memory(&self, plan: &Plan) -> Result<(), IngestError> {
        let world = &plan.world;
        self.check_node_memory(match plan.is_nested {
            true => plan.nested_nodes(),
            false => (0..world.levels()).map(|q| world.node_count(q)).sum(),
        })
    }

    fn check_node_memory(&self, nodes: u64) -> Result<(), IngestError> {
        // A quarter of the memory is GDAL's cache, at least another what the threads work in.
        let needed = LEAST_MEMORY_BYTES.max(2 * nodes * NODE_BYTES);
        if needed > self.memory_bytes {
            return Err(IngestError::usage(format!(
                "a world of {nodes} tiles needs --memory {}MiB or more, {} MiB are allowed",
                needed.div_ceil(1 << 20),
                self.memory_bytes >> 20
            )));
        }
        Ok(())
    }

    #[expect(clippy::too_many_arguments, reason = "the steps of an ingest share all of these")]
    fn build(
        &self,
        plan: &Plan,
        target: &TargetCrs,
        elevation: &[(Raster, ElevationValues)],
        color: &[(Raster, ColorValues)],
        output: &Output,
        work: &Work,
        note: &mut dyn FnMut(Note),
    ) -> Result<Manifest, IngestError> {
        let (world, folder) = (&plan.world, output.folder());
        if plan.is_nested {
            let place = place_of(plan, target);
            let sources = Sources { plan, target, elevation, color, place, folder, work };
            return self.build_nested(&sources, output, note);
        }
        let Elevation { levels, summary, validity, holes } =
            elevation::levels(plan, target, elevation, self.voids, folder, work)?;
        let post_area = plan.elevation.step.powi(2);
        let void_area_m2 = summary.voids as f64 * post_area;
        if summary.voids > 0 {
            let all = plan.elevation_size(world.finest_elevation_level()).iter().product::<u64>();
            let areas = [summary.voids, holes].map(|posts| posts as f64 * post_area / 1e6);
            note(Note::Info(record::about_voids(self.voids, areas, summary.voids as f64 / all as f64)));
        }
        let source_range = told_source_range(&summary, plan, note);
        let voids_record =
            (summary.voids > 0).then_some(VoidsRecord { mode: self.voids, hole_area_m2: holes as f64 * post_area });
        let info = record::archive_info(plan, target, &self.name(), voids_record.is_some());
        let (colors, voids, tint) = self.color_levels(plan, target, color, &levels, folder, work)?;
        let texels = plan.color_size(world.finest_color_level()).iter().product::<u64>();
        if !color.is_empty() && voids == texels {
            return Err(IngestError::source(color[0].0.path(), "(colour) has no data where the elevation is"));
        }
        if !color.is_empty() && voids > 0 {
            note(Note::Info(tint_note(voids as f64 / texels as f64)));
        }

        // After the colours: tints are made from the ground as it is.
        let levels = self.raised(levels, (world, None), validity.first(), folder, work)?;
        let path = output.part(ELEVATION_FILE);
        let elevation_record = archive::write_elevation(&path, world, &levels, None, &validity, &info.0, work)?;
        drop(validity);
        let ranges = crate::ranges::compute(world, &levels, folder, work)?;
        let nodes_path = output.part(NODES_FILE);
        let nodes_fail = |source| IngestError::Output { source, path: nodes_path.clone() };
        let nodes = ranges.write(&nodes_path).map_err(nodes_fail)?;
        drop((levels, ranges));

        let path = output.part(COLOR_FILE);
        let color_record = archive::write_color(&path, world, &colors, None, self.color_quality, &info.1, work)?;
        Ok(record::manifest(record::Parts {
            name: self.name(),
            plan,
            target,
            elevation,
            color,
            range: summary.range,
            source_range,
            void_areas_m2: [void_area_m2, voids as f64 * plan.color.step.powi(2)],
            voids: voids_record,
            quality: self.color_quality,
            archives: [elevation_record, color_record],
            tint: Some(tint),
            nodes,
            lonlat: record::lonlat_table(plan, target, note),
            complete_level: None,
        }))
    }

    /// The same for worlds whose finest levels exist only where there are data.
    fn build_nested(
        &self,
        sources: &Sources<'_>,
        output: &Output,
        note: &mut dyn FnMut(Note),
    ) -> Result<Manifest, IngestError> {
        let Sources { plan, target, elevation, color, folder, work, .. } = *sources;
        let world = &plan.world;
        let nested = sources.levels(note)?;
        let [void_m2, tint_m2] = nested.void_areas_m2;
        let area_m2 = world.extent_m().iter().product::<f64>();
        if void_m2 > 0.0 {
            note(Note::Info(record::about_voids(Voids::Fill, [void_m2 / 1e6, 0.0], void_m2 / area_m2)));
            if self.voids != Voids::Fill {
                note(Note::Warning(
                    "a world of sources of several spacings has no holes, and does not tell filled ground from measured: \
                     --voids keep and clip want sources of one spacing (--spacing makes it so)"
                        .to_owned(),
                ));
            }
        }
        if !color.is_empty() && tint_m2 >= area_m2 {
            return Err(IngestError::source(color[0].0.path(), "(colour) has no data where the elevation is"));
        }
        if !color.is_empty() && tint_m2 > 0.0 {
            note(Note::Info(tint_note(tint_m2 / area_m2)));
        }
        let source_range = told_source_range(&nested.summary, plan, note);
        let info = record::archive_info(plan, target, &self.name(), false);
        let exist = Some(&nested.elevation_nodes);
        let elevation_levels = self.raised(nested.elevation, (world, exist), None, folder, work)?;
        let is_whole = nested.elevation_nodes.is_whole() && nested.color_nodes.is_whole();
        let ranges = match is_whole {
            true => crate::ranges::compute(world, &elevation_levels, folder, work)?,
            false => {
                let nodes = [&nested.elevation_nodes, &nested.color_nodes];
                crate::ranges::compute_nested(world, &elevation_levels, nodes, folder, work)?
            }
        };
        let nodes_path = output.part(NODES_FILE);
        let nodes = ranges.write(&nodes_path).map_err(|source| IngestError::Output { source, path: nodes_path })?;
        let path = output.part(ELEVATION_FILE);
        let elevation_record = archive::write_elevation(&path, world, &elevation_levels, exist, &[], &info.0, work)?;
        let (path, exist) = (output.part(COLOR_FILE), Some(&nested.color_nodes));
        let color_record = archive::write_color(&path, world, &nested.color, exist, self.color_quality, &info.1, work)?;
        Ok(record::manifest(record::Parts {
            name: self.name(),
            plan,
            target,
            elevation,
            color,
            range: nested.summary.range,
            source_range,
            void_areas_m2: nested.void_areas_m2,
            voids: None,
            quality: self.color_quality,
            archives: [elevation_record, color_record],
            tint: Some(nested.tint),
            nodes,
            lonlat: record::lonlat_table(plan, target, note),
            complete_level: (!is_whole).then(|| ranges.world().complete_level()),
        }))
    }

    /// Elevation levels without voids, with their crests raised if they are to be.
    fn raised(
        &self,
        levels: Vec<Level<f32>>,
        (world, nodes): (&World, Option<&Nodes>),
        shares: Option<&Level<Shares>>,
        folder: &Path,
        work: &Work,
    ) -> Result<Vec<Level<f32>>, IngestError> {
        if !self.raises_crests {
            return Ok(levels);
        }
        Crests { world, nodes, shares, folder, work }.raise(levels)
    }

    fn color_levels(
        &self,
        plan: &Plan,
        target: &TargetCrs,
        color: &[(Raster, ColorValues)],
        elevation: &[Level<f32>],
        folder: &Path,
        work: &Work,
    ) -> Result<(Vec<Level<Rgb>>, u64, HeightColors), IngestError> {
        let world = &plan.world;
        // The terrain's range is taken from the finest level with at most a million posts.
        let is_small = |level: &Level<f32>| level.size().iter().product::<u64>() <= 1 << 20;
        let overview = elevation.iter().position(is_small).unwrap_or(elevation.len() - 1);
        let overview_m = plan.elevation.step * f64::from(1u32 << overview);
        let overview = (&elevation[overview], overview_m);
        let place = place_of(plan, target);
        let tint = Tint::new(&elevation[0], plan.elevation.step, plan.color.step, overview, place)
            .map_err(|source| IngestError::Output { source, path: folder.to_owned() })?;
        let (finest, voids) = sample::color::sample(plan, target, color, &tint, folder, work)?;
        let mut levels = vec![finest];
        for q in world.finest_color_level() + 1..world.levels() {
            let coarser = pyramid::color::coarser(&levels[levels.len() - 1], plan.color_size(q), folder, work)?;
            levels.push(coarser);
        }
        Ok((levels, voids, tint.colors()))
    }

    /// The database's name: its folder's.
    fn name(&self) -> String {
        let name = self.output.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
        name.strip_suffix(".tv").unwrap_or(&name).to_owned()
    }
}

/// Properties of the place that a tint depends on.
fn place_of<'a>(plan: &Plan, target: &'a TargetCrs) -> Place<'a> {
    let world = &plan.world;
    let middle = world.crs_middle().to_array();
    Place { body: &target.body().name, latitude_deg: target.latitude_deg(middle) }
}

fn tint_note(share: f64) -> String {
    let percent = 100.0 * share;
    format!("colour has no data for {percent:.1} % of the world: a tint of the elevation is shown there")
}

/// Limits GDAL's block cache, and puts its messages into our errors instead of on the terminal.
pub(crate) fn quieten_gdal(memory_bytes: u64) {
    gdal::config::set_error_handler(|_, _, _| {});
    let cache_mb = (memory_bytes / 4) >> 20;
    for (key, value) in [("GDAL_CACHEMAX", cache_mb.to_string()), ("GDAL_PAM_ENABLED", "NO".to_owned())] {
        // If an option cannot be set, it costs memory or a file beside the source, but not
        // correctness.
        gdal::config::set_config_option(key, &value).ok();
    }
    // A server that does not answer ends the work instead of blocking it for ever; the user's own
    // settings take precedence.
    for (key, value) in [
        ("GDAL_HTTP_CONNECTTIMEOUT", "20"),
        ("GDAL_HTTP_LOW_SPEED_TIME", "30"),
        ("GDAL_HTTP_LOW_SPEED_LIMIT", "1"),
        ("GDAL_HTTP_TIMEOUT", "300"),
    ] {
        if gdal::config::get_config_option(key, "").is_ok_and(|set| set.is_empty()) {
            gdal::config::set_config_option(key, value).ok();
        }
    }
}

/// Creates a database whose three files (elevation, colour, ranges) `make` writes to the given
/// paths.
pub(crate) fn finish_database(
    folder: &Path,
    may_overwrite: bool,
    work: &Work,
    make: impl FnOnce([PathBuf; 3]) -> Result<Manifest, IngestError>,
) -> Result<Manifest, IngestError> {
    let output = Output::begin(folder, may_overwrite)?;
    let manifest = make([ELEVATION_FILE, COLOR_FILE, NODES_FILE].map(|name| output.part(name)))?;
    output.finish(&manifest, work)?;
    Ok(manifest)
}

/// The manifest of a database without sources.
pub(crate) fn record_of(
    name: &str,
    plan: &Plan,
    target: &TargetCrs,
    range: [f32; 2],
    archives: [ArchiveRecord; 2],
    nodes: NodesRecord,
) -> Manifest {
    record::manifest(record::Parts {
        name: name.to_owned(),
        plan,
        target,
        elevation: &[],
        color: &[],
        range,
        source_range: None,
        void_areas_m2: [0.0; 2],
        voids: None,
        quality: ColorQuality::Default.jpeg(),
        archives,
        tint: None,
        nodes,
        lonlat: crate::lonlat::table(target, &plan.world),
        complete_level: None,
    })
}
