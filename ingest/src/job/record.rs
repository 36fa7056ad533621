//! The manifest of a database, and the metadata of its archives.

use crate::archive::ArchiveInfo;
use crate::plan::Plan;
use crate::source::raster::traditional;
use crate::source::values::{ColorValues, ElevationValues};
use crate::source::{Note, Raster, TargetCrs};
use gdal::spatial_ref::{CoordTransform, SpatialRef};
use serde_json::json;
use terravision_common::database::{
    ArchiveRecord, ColorLayer, ElevationLayer, FEATURE_SPARSE_LEVELS, FEATURE_VALIDITY, FORMAT_VERSION, Manifest,
    ManifestFields, NodesRecord, Source, Voids, VoidsRecord,
};
use terravision_common::lonlat::LonLatTable;
use terravision_common::tint::HeightColors;
use terravision_common::world::World;

/// Inputs of a manifest.
pub(super) struct Parts<'a> {
    pub(super) name: String,
    pub(super) plan: &'a Plan,
    pub(super) target: &'a TargetCrs,
    pub(super) elevation: &'a [(Raster, ElevationValues)],
    pub(super) color: &'a [(Raster, ColorValues)],
    pub(super) range: [f32; 2],
    pub(super) source_range: Option<[f32; 2]>,
    pub(super) void_areas_m2: [f64; 2],
    /// How the elevation's voids were handled; `None` without voids.
    pub(super) voids: Option<VoidsRecord>,
    pub(super) quality: u8,
    pub(super) archives: [ArchiveRecord; 2],
    pub(super) nodes: NodesRecord,
    /// How a tint was made, of all colour or of parts of it.
    pub(super) tint: Option<HeightColors>,
    /// With sparse levels: from which level on all nodes exist.
    pub(super) complete_level: Option<u8>,
    pub(super) lonlat: Option<LonLatTable>,
}

/// The message about ground without data: its area and that of holes, km², and its share of the
/// world.
pub(super) fn about_voids(mode: Voids, [void_km2, hole_km2]: [f64; 2], share: f64) -> String {
    let became = match mode {
        Voids::Fill => "filled from around it".to_owned(),
        Voids::Keep => "left without ground".to_owned(),
        Voids::Clip if hole_km2 == 0.0 => "filled from around it (--voids keep leaves holes)".to_owned(),
        Voids::Clip if hole_km2 == void_km2 => {
            "it lies beyond the files or at their corners and has no ground (--voids fill makes some up)".to_owned()
        }
        Voids::Clip => format!(
            "{hole_km2:.3} km² lie beyond the files or at their corners and have no ground, the rest is filled from around it \
             (--voids fill fills all of it, keep none)"
        ),
    };
    format!("elevation has no data for {void_km2:.3} km² ({:.1} %): {became}", 100.0 * share)
}

/// The features that a program has to know to read the database.
fn features(has_validity: bool, is_sparse: bool) -> Vec<String> {
    let all = [(FEATURE_VALIDITY, has_validity), (FEATURE_SPARSE_LEVELS, is_sparse)];
    all.into_iter().filter(|(_, has)| *has).map(|(name, _)| name.to_owned()).collect()
}

pub(super) fn manifest(parts: Parts<'_>) -> Manifest {
    let Parts { plan, target, .. } = parts;
    let source = |raster: &Raster, is_exact: bool| Source {
        file: raster.file_name(),
        size: raster.size(),
        crs: raster.crs_name().to_owned(),
        data_type: raster.data_type().to_owned(),
        nodata: raster.bands()[0].nodata.map(|v| v.to_string()),
        is_exact,
    };
    let elevation = parts.elevation.iter().map(|(r, _)| source(r, Plan::is_exact(&plan.elevation, target, r)));
    let color = parts.color.iter().map(|(r, _)| source(r, Plan::is_exact(&plan.color, target, r)));
    let fields = ManifestFields {
        format: String::new(),
        format_version: FORMAT_VERSION,
        features: features(parts.voids.is_some(), parts.complete_level.is_some()),
        complete_level: parts.complete_level,
        written_by: concat!("terravision-ingest ", env!("CARGO_PKG_VERSION")).to_owned(),
        name: parts.name,
        crs: target.crs().clone(),
        lonlat: parts.lonlat,
        body: target.body().clone(),
        world: *plan.world.fields(),
        vertical_unit: "metre".to_owned(),
        elevation: ElevationLayer {
            sources: elevation.collect(),
            spacing_m: plan.elevation.step,
            range_m: parts.range.map(f64::from),
            source_range_m: parts.source_range.map(|range| range.map(f64::from)),
            void_area_m2: parts.void_areas_m2[0],
            voids: parts.voids,
            encoding: elevation_encoding(parts.voids.is_some()).to_owned(),
            archive: parts.archives[0],
        },
        color: ColorLayer {
            // Of the tint that fills parts of pictures nothing is told: they cannot be lit apart.
            tint: parts.tint.filter(|_| parts.color.is_empty()),
            sources: color.collect(),
            spacing_m: plan.color.step,
            void_area_m2: parts.void_areas_m2[1],
            encoding: "jpeg".to_owned(),
            quality: parts.quality,
            archive: parts.archives[1],
        },
        nodes: parts.nodes,
        checksum: String::new(),
    };
    Manifest::new(fields).expect("the world of a plan is valid, and these are features that we read")
}

fn elevation_encoding(has_validity: bool) -> &'static str {
    if has_validity { "terravision-elevation-2" } else { "terravision-elevation-1" }
}

/// West, south, east, north of a world in degrees; `None` when PROJ cannot tell. A world across the
/// date line goes around the body unless `crosses`: then its west is the greater one.
pub(super) fn bounds_deg(world: &World, srs: &SpatialRef, crosses: bool) -> Option<[f64; 4]> {
    let geographic = traditional(srs.geog_cs().ok()?);
    let transform = CoordTransform::new(srs, &geographic).ok()?;
    let ([x0, y0], [w, h]) = (world.fields().origin, world.extent_m());
    let side = 21usize;
    let along = |k: usize| k as f64 / (side - 1) as f64;
    let (mut x, mut y): (Vec<f64>, Vec<f64>) =
        (0..side * side).map(|k| (x0 + w * along(k % side), y0 + h * along(k / side))).unzip();
    // Points that have no longitude and latitude come back infinite and are left out.
    transform.transform_coords(&mut x, &mut y, &mut []).ok();
    // If there are far longitudes on both sides and none in between, the world crosses the date
    // line.
    let is_split = x.iter().any(|x| *x > 90.0) && x.iter().any(|x| *x < -90.0) && !x.iter().any(|x| x.abs() <= 90.0);
    if crosses && is_split {
        x.iter_mut().filter(|x| **x < 0.0).for_each(|x| *x += 360.0);
    }
    let mut bounds = [f64::MAX, f64::MAX, f64::MIN, f64::MIN];
    for (x, y) in x.iter().zip(&y).filter(|(x, y)| x.is_finite() && y.is_finite()) {
        bounds = [bounds[0].min(*x), bounds[1].min(*y), bounds[2].max(*x), bounds[3].max(*y)];
    }
    if crosses && bounds[2] > 180.0 {
        bounds[2] -= 360.0;
        return Some(bounds);
    }
    let limits = [180.0, 90.0, 180.0, 90.0];
    (bounds[0] <= bounds[2]).then(|| [0, 1, 2, 3].map(|i| bounds[i].clamp(-limits[i], limits[i])))
}

/// What the elevation and the colour archive say to other programs.
pub(super) fn archive_info(
    plan: &Plan,
    target: &TargetCrs,
    name: &str,
    has_validity: bool,
) -> (ArchiveInfo, ArchiveInfo) {
    let bounds_deg = target.srs().ok().and_then(|srs| bounds_deg(&plan.world, &srs, false)).unwrap_or([0.0; 4]);
    let info = |layer: &str, format: &str, payload: &str| ArchiveInfo {
        bounds_deg,
        metadata: json!({
            "name": format!("{name} {layer}"),
            "description": format!("{layer} tiles of a TerraVision terrain database"),
            "type": "overlay",
            // Of this object.
            "version": "1",
            "format": format,
            "generator": concat!("terravision-ingest ", env!("CARGO_PKG_VERSION")),
            // Zooms and rows count as in web maps, but the root is a square of this CRS, not the
            // globe.
            "terravision": { "layer": layer, "crs": target.crs(), "world": plan.world, "payload": payload },
        })
        .to_string(),
    };
    let elevation = "\"TVe1\", crc32, u16 posts a side, u8 byte planes, u8 0, zstd frame of planes of zigzagged errors of \
                     planar prediction of heights in 1/128 m; little endian, row 0 in the south, borders shared";
    let validity = "; or \"TVe2\": the same with u32 bytes of the frame before it, and behind it a zstd frame of u8 shares of \
                    ground and u8 shares that were measured, 255ths";
    let elevation = format!("{elevation}{}", if has_validity { validity } else { "" });
    let color = "JPEG with a border of 4 texels on each side, then \"TVc1\" and the crc32 of all before it";
    (info("elevation", elevation_encoding(has_validity), &elevation), info("colour", "jpg", color))
}

/// The table for converting longitudes and latitudes to the world; reports if there is one.
pub(super) fn lonlat_table(plan: &Plan, target: &TargetCrs, note: &mut dyn FnMut(Note)) -> Option<LonLatTable> {
    let table = crate::lonlat::table(target, &plan.world)?;
    let name = &target.crs().name;
    let without = match table.shift_m {
        shift if shift >= 10.0 => {
            format!("without it, paths in KML, GPX or other coordinates would be off by {shift:.0} m")
        }
        shift if shift > 0.0 => {
            format!("without it, paths in KML, GPX or other coordinates would be off by {shift:.1} m")
        }
        _ => "its projection is known to PROJ alone".to_owned(),
    };
    note(Note::Info(format!(
        "PROJ's way from longitude and latitude to {name} is kept in the database, good to {:.2} m ({without})",
        table.error_m.max(0.01)
    )));
    Some(table)
}
