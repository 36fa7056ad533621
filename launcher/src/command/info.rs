//! `terravision info`: what a terrain database holds.

use crate::cli::InfoArgs;
use crate::command::places::{Extreme, Places};
use crate::failure::Failure;
use crate::machine::bytes_for_people;
use crate::world::open_world;
use anyhow::Context;
use serde_json::{Value, json};
use std::io::{self, Write};
use terravision_common::database::{Layer, Manifest, ManifestFields, Source, VoidsRecord};
use terravision_common::node::NodeId;
use terravision_common::terminal::{printable, printable_json};
use terravision_store::Store;

/// Prints it.
///
/// # Errors
/// Bad input: no database. Or standard output cannot be written to.
pub fn info(args: &InfoArgs) -> Result<(), Failure> {
    let database = open_world(&args.world, &args.database)?;
    let text = if args.json { printable_json(&as_json(&database)).into_owned() } else { as_text(&database) };
    let mut out = io::stdout().lock();
    out.write_all(text.as_bytes())
        .and_then(|()| out.flush())
        .context("cannot write to standard output")
        .map_err(Failure::failed)
}

/// A manifest with its texts, which are foreign, as a terminal may show them.
fn printable_manifest(manifest: &Manifest) -> ManifestFields {
    let mut manifest = manifest.fields().clone();
    let sources = manifest.elevation.sources.iter_mut().chain(&mut manifest.color.sources);
    let texts = sources.flat_map(|source| [&mut source.file, &mut source.crs, &mut source.data_type]);
    for text in texts.chain([&mut manifest.name, &mut manifest.crs.name, &mut manifest.body.name]) {
        *text = printable(text).into_owned();
    }
    manifest
}

fn as_json(database: &Store) -> String {
    let (manifest, world) = (database.manifest(), database.world());
    let mut value = json!({"schema": "terravision-info-1", "path": database.location().to_string()});
    value["manifest"] = serde_json::to_value(manifest.fields()).unwrap_or_default();
    let [width, height] = world.extent_m();
    let [x, y] = world.fields().origin;
    value["bounds"] = json!([x, y, x + width, y + height]);
    value["levels"] = json!(world.levels());
    value["elevation_spacing_m"] = json!(world.elevation_spacing_m(world.finest_elevation_level()));
    value["color_spacing_m"] = json!(world.color_spacing_m(world.finest_color_level()));
    let places = Places::of(database);
    value["bounds_lon_lat"] = json!(places.lon_lat);
    let extreme = |found: &Option<Extreme>| match found {
        Some(at) => json!({"height_m": at.height_m, "place": at.place, "lon_lat": at.lon_lat}),
        None => Value::Null,
    };
    if database.manifest().is_sparse() {
        let of = |layer| -> Vec<Value> {
            let each = spacings(database, layer).into_iter();
            each.map(|part| json!({"spacing_m": part.spacing_m, "share": part.share})).collect()
        };
        value["spacings"] = json!({"elevation": of(Layer::Elevation), "color": of(Layer::Color)});
    }
    value["highest"] = extreme(&places.extremes[0]);
    value["lowest"] = extreme(&places.extremes[1]);
    format!("{value:#}\n")
}

/// The part of a world whose finest posts or texels have one spacing.
#[derive(Debug, PartialEq)]
struct Spacing {
    spacing_m: f64,
    /// Of the world's area, 0 to 1.
    share: f64,
}

/// How much of a world has which spacing of a layer, the finest first. One part where no level is
/// sparse.
fn spacings(database: &Store, layer: Layer) -> Vec<Spacing> {
    let (world, ranges) = (database.world(), database.ranges());
    let (finest, spacing_m): (u8, &dyn Fn(u8) -> f64) = match layer {
        Layer::Elevation => (world.finest_elevation_level(), &|q| world.elevation_spacing_m(q)),
        Layer::Color => (world.finest_color_level(), &|q| world.color_spacing_m(q)),
    };
    let extent = world.extent().map(u64::from);
    // Of nodes that reach beyond the world what lies within.
    let area = |node: NodeId| -> f64 {
        let origin = world.node_origin(node);
        (0..2).map(|k| (extent[k] - origin[k].min(extent[k])).min(world.node_side(node.q())) as f64).product()
    };
    let whole: f64 = extent.iter().map(|side| *side as f64).product();
    let (mut parts, mut covered) = (Vec::new(), 0.0);
    for q in finest..world.levels() {
        let with_tiles = match q >= world.complete_level() {
            true => whole,
            false => ranges.nodes(q).filter(|node| ranges.has_tile(layer, *node)).map(area).sum(),
        };
        if with_tiles > covered {
            parts.push(Spacing { spacing_m: spacing_m(q), share: (with_tiles - covered) / whole });
            covered = with_tiles;
        }
        if covered >= whole {
            break;
        }
    }
    parts
}

/// The spacings of a layer in words, where there are several: "1 m over 0.2 % of the world, 32 m
/// over 99.8 %".
fn spacings_as_text(parts: &[Spacing]) -> String {
    if parts.len() < 2 {
        return String::new();
    }
    let percent = |share: f64| match 100.0 * share {
        p if p < 0.1 => format!("{} %", rounded(p)),
        p => format!("{p:.1} %"),
    };
    let each = parts.iter().map(|part| format!("{} m over {}", rounded(part.spacing_m), percent(part.share)));
    format!("\n              spacing: {} of the world", each.collect::<Vec<_>>().join(", "))
}

/// A length with as many digits as people read: 22200, 25.7, 0.0123.
fn rounded(metres: f64) -> f64 {
    let digits = (4 - metres.abs().max(f64::MIN_POSITIVE).log10().ceil() as i32).clamp(0, 12);
    // Through text: 25.7 rather than 25.700000000000003.
    format!("{metres:.*}", digits as usize).parse().unwrap_or(metres)
}

fn degrees([lon, lat]: [f64; 2]) -> String {
    let side = |v: f64, letters: [char; 2]| format!("{:.4} {}", v.abs(), letters[usize::from(v < 0.0)]);
    format!("{} {}", side(lon, ['E', 'W']), side(lat, ['N', 'S']))
}

/// The lines that say where a world lies on its body, and where it is highest and lowest.
fn places_as_text(places: &Places) -> String {
    let mut text = String::new();
    if let Some([w, s, e, n]) = places.lon_lat {
        text += &format!("on the body   from {} to {}\n", degrees([w, s]), degrees([e, n]));
    }
    for (name, found) in ["highest", "lowest"].into_iter().zip(&places.extremes) {
        let Some(at) = found else { continue };
        let [x, y] = at.place;
        let lon_lat = at.lon_lat.map_or(String::new(), |at| format!(" ({})", degrees(at)));
        text += &format!("{name:<13} {:.1} m, at {x:.1}, {y:.1}{lon_lat}\n", at.height_m);
    }
    text
}

/// How large a world is, and where it lies in its CRS.
fn extent_as_text(database: &Store) -> String {
    let world = database.world();
    let ([width, height], [x, y]) = (world.extent_m(), world.fields().origin);
    let [columns, rows] = world.extent();
    let size = match width.max(height) < 1e3 {
        true => format!("{width:.1} x {height:.1} m"),
        false => format!("{:.2} x {:.2} km", width / 1e3, height / 1e3),
    };
    match world.globe() {
        Some(_) => format!("the whole body, {size}: {columns} columns around it, {rows} rows from pole to pole"),
        None => format!("{size}, from {x:.1}, {y:.1} to {:.1}, {:.1}", x + width, y + height),
    }
}

fn as_text(database: &Store) -> String {
    let (manifest, world) = (printable_manifest(database.manifest()), database.world());
    let [width, height] = world.extent_m();
    let [low, high] = manifest.elevation.range_m;
    let epsg = manifest.crs.epsg.map_or(String::new(), |epsg| format!(" (EPSG:{epsg})"));
    let void = |area_m2: f64| match area_m2 {
        a if a <= 0.0 => String::new(),
        a => format!(", {:.3} km² without data filled", a / 1e6),
    };
    // Areas count posts, and there is one more along a side than the world has intervals.
    let post_m = world.elevation_spacing_m(world.finest_elevation_level().max(world.surface().rows_level()));
    // What became of voids stands on a line of its own, where there were some.
    let void_z = match &manifest.elevation.voids {
        Some(voids) => about_voids(voids, manifest.elevation.void_area_m2, (width + post_m) * (height + post_m)),
        None => void(manifest.elevation.void_area_m2),
    };
    let sources = |list: &[Source]| {
        let each = list
            .iter()
            .map(|s| format!("\n              {} ({} x {}, {}, {})", s.file, s.size[0], s.size[1], s.data_type, s.crs));
        each.collect::<String>()
    };
    format!(
        "{name}: a terrain database of format {version}, on {body}\n\
         CRS           {crs}{epsg}\n\
         extent        {extent}\n\
         heights       {low:.1} to {high:.1} m{source_range}\n\
         {places}\
         quad tree     {levels} levels, tiles of {nz} x {nz} intervals and {nc} x {nc} texels\n\
         elevation     {dz} m posts, {tiles_z} tiles, {bytes_z}{spacings_z}{void_z}{sources_z}\n\
         colour        {dc} m texels, {tiles_c} tiles, {bytes_c}{spacings_c}{void_c}{sources_c}\n",
        source_range = manifest
            .elevation
            .source_range_m
            .map_or(String::new(), |[low, high]| { format!(" (samples of the files: {low:.1} to {high:.1} m)") }),
        spacings_z = spacings_as_text(&spacings(database, Layer::Elevation)),
        spacings_c = spacings_as_text(&spacings(database, Layer::Color)),
        name = manifest.name,
        version = manifest.format_version,
        body = manifest.body.name,
        crs = manifest.crs.name,
        extent = extent_as_text(database),
        places = places_as_text(&Places::of(database)),
        levels = world.levels(),
        nz = world.elevation_tile(),
        nc = world.color_tile(),
        dz = rounded(post_m),
        tiles_z = manifest.elevation.archive.tiles,
        bytes_z = bytes_for_people(manifest.elevation.archive.bytes),
        sources_z = sources(&manifest.elevation.sources),
        dc = rounded(world.color_spacing_m(world.finest_color_level())),
        tiles_c = manifest.color.archive.tiles,
        bytes_c = bytes_for_people(manifest.color.archive.bytes),
        void_c = void(manifest.color.void_area_m2),
        sources_c = if manifest.color.sources.is_empty() {
            "\n              a tint by height, shaded (no colour was given)".to_owned()
        } else {
            sources(&manifest.color.sources)
        },
    )
}

/// What became of an area without data, in a world of an area, square metres.
fn about_voids(voids: &VoidsRecord, void_m2: f64, world_m2: f64) -> String {
    let part = |area_m2: f64| format!("{:.3} km² ({:.1} %)", area_m2 / 1e6, 100.0 * area_m2 / world_m2);
    format!(
        "\n              {} without data: {} have no ground, {} were made up (--voids {})",
        part(void_m2),
        part(voids.hole_area_m2),
        part((void_m2 - voids.hole_area_m2).max(0.0)),
        voids.mode.name()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn several_spacings_are_told_with_their_shares() {
        let part = |spacing_m, share| Spacing { spacing_m, share };
        assert_eq!(spacings_as_text(&[part(30.0, 1.0)]), "");
        let text = spacings_as_text(&[part(1.0, 0.000_512), part(2.0, 0.0023), part(32.0, 0.9972)]);
        assert!(text.ends_with("spacing: 1 m over 0.0512 %, 2 m over 0.2 %, 32 m over 99.7 % of the world"), "{text}");
    }

    #[test]
    fn numbers_are_rounded_for_people() {
        assert_eq!([22_200.000_000_1, 25.700_000_000_000_003, 0.012_345_6].map(rounded), [22_200.0, 25.7, 0.012_35]);
        assert_eq!(degrees([-122.000_04, 46.2]), "122.0000 W 46.2000 N");
    }
}
