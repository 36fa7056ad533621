//! The result of `ingest --json`.

use super::record::bounds_deg;
use crate::source::Note;
use crate::source::crs::parse;
use serde_json::{Value, json};
use std::path::Path;
use terravision_common::database::{Manifest, ManifestFields, Source};

/// One object: the path of the database, its bounds, its layers with their sizes, and all notes and
/// warnings.
#[must_use]
pub fn summary(path: &Path, manifest: &Manifest, notes: &[Note]) -> Value {
    let world = manifest.world();
    let [low, high] = world.crs_bounds();
    let srs = parse("the CRS of the database", &manifest.fields().crs.wkt).ok();
    let lon_lat = srs.and_then(|srs| bounds_deg(world, &srs, true));
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
    let ManifestFields { name, crs, body, elevation, color, nodes, .. } = manifest.fields();
    json!({
        "schema": "terravision-ingest-1",
        "path": std::path::absolute(path).unwrap_or_else(|_| path.to_owned()).display().to_string(),
        "name": name,
        "crs": {"name": crs.name, "epsg": crs.epsg},
        "body": body.name,
        "bounds": [low.x, low.y, high.x, high.y],
        "bounds_lon_lat": lon_lat,
        "levels": world.levels(),
        "bytes": elevation.archive.bytes + color.archive.bytes + nodes.bytes,
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
