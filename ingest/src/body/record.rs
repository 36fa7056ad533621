//! What the manifest and the archives of a body say.

use super::Kind;
use super::grid::Grid;
use crate::archive::ArchiveInfo;
use crate::source::Raster;
use serde_json::json;
use terravision_common::database::{
    ArchiveRecord, ColorLayer, Crs, ElevationLayer, FEATURE_BODY, FORMAT_VERSION, Manifest, ManifestError,
    ManifestFields, NodesRecord, Source,
};
use terravision_common::tint::HeightColors;

/// Inputs of a manifest.
pub(super) struct Parts<'a> {
    pub(super) name: String,
    pub(super) grid: &'a Grid,
    pub(super) kind: &'a Kind,
    pub(super) elevation: Vec<&'a Raster>,
    pub(super) color: Vec<&'a Raster>,
    pub(super) range: [f32; 2],
    pub(super) quality: u8,
    pub(super) archives: [ArchiveRecord; 2],
    pub(super) nodes: NodesRecord,
    pub(super) tint: Option<HeightColors>,
}

pub(super) fn manifest(parts: Parts<'_>) -> Result<Manifest, ManifestError> {
    let source = |raster: &&Raster, is_exact: bool| Source {
        file: raster.file_name(),
        size: raster.size(),
        crs: raster.crs_name().to_owned(),
        data_type: raster.data_type().to_owned(),
        nodata: raster.bands()[0].nodata.map(|v| v.to_string()),
        is_exact,
    };
    let world = &parts.grid.world;
    let rows_level = parts.grid.lattice().rows_level();
    Manifest::new(ManifestFields {
        format: String::new(),
        format_version: FORMAT_VERSION,
        features: vec![FEATURE_BODY.to_owned()],
        complete_level: None,
        written_by: concat!("terravision-ingest ", env!("CARGO_PKG_VERSION")).to_owned(),
        name: parts.name,
        crs: parts.kind.crs.clone(),
        lonlat: None,
        body: parts.kind.body.clone(),
        world: *world.fields(),
        vertical_unit: "metre".to_owned(),
        elevation: ElevationLayer {
            sources: parts.elevation.iter().map(|raster| source(raster, true)).collect(),
            spacing_m: world.elevation_spacing_m(rows_level),
            range_m: parts.range.map(f64::from),
            source_range_m: None,
            void_area_m2: 0.0,
            voids: None,
            encoding: "terravision-elevation-1".to_owned(),
            archive: parts.archives[0],
        },
        color: ColorLayer {
            tint: parts.tint,
            sources: parts.color.iter().map(|raster| source(raster, false)).collect(),
            spacing_m: world.color_spacing_m(world.finest_color_level()),
            void_area_m2: 0.0,
            encoding: "jpeg".to_owned(),
            quality: parts.quality,
            archive: parts.archives[1],
        },
        nodes: parts.nodes,
        checksum: String::new(),
    })
}

/// What the elevation and the colour archive say to other programs.
pub(super) fn archive_infos(name: &str, grid: &Grid, crs: &Crs) -> [ArchiveInfo; 2] {
    let payloads = [
        (
            "elevation",
            "terravision-elevation-1",
            "\"TVe1\", crc32, u16 posts a side, u8 byte planes, u8 0, zstd frame of planes of zigzagged errors of planar \
             prediction of heights in 1/128 m; little endian, row 0 in the south, borders shared",
        ),
        ("colour", "jpg", "JPEG with a border of 4 texels on each side, then \"TVc1\" and the crc32 of all before it"),
    ];
    payloads.map(|(layer, format, payload)| ArchiveInfo {
        bounds_deg: [-180.0, -90.0, 180.0, 90.0],
        metadata: json!({
            "name": format!("{name} {layer}"),
            "description": format!("{layer} tiles of a TerraVision terrain database of a whole body"),
            "type": "overlay",
            "version": "1",
            "format": format,
            "generator": concat!("terravision-ingest ", env!("CARGO_PKG_VERSION")),
            // Tiles are those of the body's lattice, not of a web map.
            "terravision": { "layer": layer, "crs": crs, "world": grid.world, "payload": payload },
        })
        .to_string(),
    })
}
