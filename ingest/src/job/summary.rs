//! What was made, for programs: the result of `ingest --json`.

use super::record::bounds_deg;
use crate::source::Note;
use crate::source::crs::parse;
use serde_json::{Value, json};
use std::path::Path;
use terravision_common::database::{Manifest, Source};
use terravision_common::world::World;

/// One object: where the database is, what it covers, its layers with their sizes, and what was
/// said on the way.
#[must_use]
pub fn summary(path: &Path, manifest: &Manifest, notes: &[Note]) -> Value {
    let world = World::new(manifest.world).ok();
    let bounds = world.map(|world| {
        let [low, high] = world.crs_bounds();
        [low.x, low.y, high.x, high.y]
    });
    let srs = parse("the CRS of the database", &manifest.crs.wkt).ok();
    let lon_lat = world.zip(srs).and_then(|(world, srs)| bounds_deg(&world, &srs, true));
    let said = |is_warning: bool| -> Vec<&str> {
        let texts = notes.iter().filter_map(|note| match note {
            Note::Warning(text) if is_warning => Some(text.as_str()),
            Note::Info(text) if !is_warning => Some(text.as_str()),
            _ => None,
        });
        texts.collect()
    };
    let files = |sources: &[Source]| -> Vec<Value> {
        sources.iter().map(|s| json!({"file": s.file, "size": s.size, "crs": s.crs, "is_exact": s.is_exact})).collect()
    };
    let (elevation, color) = (&manifest.elevation, &manifest.color);
    json!({
        "schema": "terravision-ingest-1",
        "path": std::path::absolute(path).unwrap_or_else(|_| path.to_owned()).display().to_string(),
        "name": manifest.name,
        "crs": {"name": manifest.crs.name, "epsg": manifest.crs.epsg},
        "body": manifest.body.name,
        "bounds": bounds,
        "bounds_lon_lat": lon_lat,
        "levels": manifest.world.levels,
        "bytes": elevation.archive.bytes + color.archive.bytes + manifest.nodes.bytes,
        "elevation": {
            "spacing_m": elevation.spacing_m,
            "range_m": elevation.range_m,
            "void_area_m2": elevation.void_area_m2,
            "tiles": elevation.archive.tiles,
            "bytes": elevation.archive.bytes,
            "sources": files(&elevation.sources),
        },
        "color": {
            "spacing_m": color.spacing_m,
            "void_area_m2": color.void_area_m2,
            "tiles": color.archive.tiles,
            "bytes": color.archive.bytes,
            "sources": files(&color.sources),
        },
        "notes": said(false),
        "warnings": said(true),
    })
}
