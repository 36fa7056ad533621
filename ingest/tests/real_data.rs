//! Real rasters, good and bad. `TERRAVISION_DATA` names their folder; without it these tests say so
//! and pass.

#![allow(
    clippy::unwrap_used,
    clippy::print_stderr,
    reason = "a test fails by panicking, and says when it tests nothing"
)]

mod support;

use std::fs;
use std::path::PathBuf;
use support::{TestFolder, Tiff, error_line, program};
use terravision_common::database::{Database, ManifestFields};

fn data(name: &str) -> Option<PathBuf> {
    let Some(folder) = std::env::var_os("TERRAVISION_DATA") else {
        eprintln!("TERRAVISION_DATA is not set: real data is not tested");
        return None;
    };
    let path = PathBuf::from(folder).join(name);
    assert!(path.exists(), "{} does not exist", path.display());
    Some(path)
}

/// Ingests with the program: elevation, colour, more arguments. The manifest, and what was said.
fn ingest(elevation: &str, color: Option<&str>, more: &[&str]) -> Option<(ManifestFields, String)> {
    let folder = TestFolder::new();
    let world = folder.path("w.tv");
    let elevation = data(elevation)?;
    let color = color.and_then(data);
    let mut arguments = vec!["ingest", "--elevation", elevation.to_str().unwrap(), "-o", world.to_str().unwrap()];
    if let Some(color) = &color {
        arguments.extend(["--color", color.to_str().unwrap()]);
    }
    arguments.extend(more);
    let output = program(&arguments);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{said}");
    Some((Database::open(&world).unwrap().manifest().fields().clone(), said))
}

fn assert_range(manifest: &ManifestFields, low: f64, high: f64, by: f64) {
    let [found_low, found_high] = manifest.elevation.range_m;
    assert!((found_low - low).abs() <= by && (found_high - high).abs() <= by, "{found_low} to {found_high}");
}

#[test]
fn mars_gale_is_on_mars_and_copied() {
    let Some((manifest, _)) =
        ingest("mars-gale/gale_missionDEM_1m.tif", Some("mars-gale/gale_hirise_ortho_mercator.tif"), &[])
    else {
        return;
    };
    assert_eq!((manifest.body.name.as_str(), manifest.body.radius_m), ("Mars", 3_396_190.0));
    assert!(manifest.elevation.sources[0].is_exact);
    assert_range(&manifest, -4472.67, -4437.88, 0.01);
    assert_eq!(manifest.elevation.spacing_m, 1.0);
}

#[test]
fn crater_lake_warns_of_its_undeclared_fill() {
    let images = Some("earth-craterlake/craterlake-imagery-30m.tif");
    let Some((manifest, said)) = ingest("earth-craterlake/craterlake-elev-16bit-30m.tif", images, &[]) else { return };
    assert!(said.contains("--nodata -32767"), "{said}");
    assert_range(&manifest, 1289.0, 1880.0, 2.0);
    assert_eq!(manifest.crs.epsg, Some(32610));
    assert!(manifest.elevation.void_area_m2 > 2e7);
}

#[test]
fn olinda_is_not_mistaken_for_another_crs() {
    let Some((manifest, _)) =
        ingest("earth-olinda/olinda_dem_utm25s.tif", Some("earth-olinda/L7_ETMs.tif"), &["--bands", "3,2,1"])
    else {
        return;
    };
    assert_range(&manifest, -1.0, 88.0, 0.01);
    assert!(manifest.elevation.sources[0].is_exact);
    assert_ne!(manifest.crs.epsg, Some(32000));
}

#[test]
fn rocky_mountain_and_st_helens() {
    let Some((manifest, _)) = ingest("earth-rockymtn/rmnp-dem.tif", Some("earth-rockymtn/rmnp-rgb.tif"), &[]) else {
        return;
    };
    assert_range(&manifest, 2281.0, 4261.0, 60.0);
    let Some((manifest, _)) = ingest("earth-sthelens/SainteHelens.dem", None, &[]) else { return };
    assert_range(&manifest, 682.0, 2543.0, 0.01);
    assert!(manifest.elevation.sources[0].is_exact);
    let area = 4151.0 * 900.0;
    assert_eq!(manifest.elevation.void_area_m2, area);
}

#[test]
fn srtm_tiles_with_voids_raw_and_zipped() {
    let files = [
        ("mt_rainier_90m.tif", [263.0, 4371.0]),
        ("mt_fuji_90m.tif", [-16.0, 3742.0]),
        ("mt_everest_90m.tif", [192.0, 8642.0]),
        ("n07_w006_3arc_v2.tif", [145.0, 546.0]),
        ("N27E086.hgt", [192.0, 8642.0]),
        ("N10W110.hgt.zip", [0.0, 9.0]),
    ];
    for (file, [low, high]) in files {
        let Some((manifest, _)) = ingest(&format!("earth-srtm3/{file}"), None, &[]) else { return };
        assert_range(&manifest, low, high, 25.0);
        assert!(manifest.crs.name.contains("UTM"), "{}", manifest.crs.name);
    }
}

#[test]
fn a_crop_of_the_globe_gets_a_plane_of_its_own() {
    let Some(path) = data("earth-global/etopo5_global_5min_int16.tif") else { return };
    // Italy and the Alps: 6 to 19 degrees east, 36 to 48 north; too wide for a UTM zone.
    let (first, size) = ([2232isize, 504], [157usize, 145]);
    let whole = gdal::Dataset::open(&path).unwrap();
    let t = whole.geo_transform().unwrap();
    let band = whole.rasterband(1).unwrap();
    let samples = band.read_as::<i16>((first[0], first[1]), (size[0], size[1]), (size[0], size[1]), None).unwrap();
    let samples = samples.data().to_vec();
    let (lowest, highest) = (*samples.iter().min().unwrap(), *samples.iter().max().unwrap());
    let corner = [t[0] + first[0] as f64 * t[1], t[3] + first[1] as f64 * t[5]];
    let folder = TestFolder::new();
    let crop = Tiff {
        transform: Some([corner[0], t[1], 0.0, corner[1], 0.0, t[5]]),
        crs: Some("EPSG:4326"),
        ..Tiff::utm(size, |i, j| samples[j * size[0] + i])
    };
    let crop = crop.write(&folder.path("crop.tif"));
    let world = folder.path("w.tv");
    let output = program(&["ingest", "--elevation", crop.to_str().unwrap(), "-o", world.to_str().unwrap()]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{said}");
    assert!(said.contains("Transverse Mercator"), "{said}");
    let manifest = Database::open(&world).unwrap().manifest().fields().clone();
    // A peak of one sample is lower on a lattice of another phase (gdalwarp -r cubic: 260 m lower).
    assert_range(&manifest, f64::from(lowest), f64::from(highest), 450.0);
    assert_eq!(manifest.body.name, "Earth");
}

#[test]
fn three_encodings_of_one_raster_give_one_database() {
    let files = ["bigtiff_bigendian_lzw_pred2_int16", "cog_deflate_pred3_float32_nan", "zstd_float32_nan"];
    let mut made = Vec::new();
    for file in files {
        let Some((manifest, _)) = ingest(&format!("ingest-geotiff/derived_rainier512_{file}.tif"), None, &[]) else {
            return;
        };
        made.push((manifest.elevation.archive, manifest.color.archive, manifest.nodes));
    }
    assert!(made.iter().all(|m| *m == made[0]), "{made:?}");
}

#[test]
fn all_of_ingest_geotiff_is_ingested_or_refused_in_one_sentence() {
    let Some(folder) = data("ingest-geotiff") else { return };
    let refused = [
        "rasterio_all-nodata.tif",
        "rasterio_float32.tif",
        "rasterio_float_nan.tif",
        "wwj_sba_gray16bit_nogeo_512x512.tif",
    ];
    let place = TestFolder::new();
    let mut count = 0;
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if !name.ends_with(".tif") {
            continue;
        }
        count += 1;
        let world = place.path(&name);
        let output = program(&["ingest", "--elevation", path.to_str().unwrap(), "-o", world.to_str().unwrap()]);
        if refused.contains(&name.as_str()) {
            assert_eq!(output.status.code(), Some(2), "{name}");
            let sentence = error_line(&output);
            assert!(name.contains("nodata") || sentence.contains("--source-crs"), "{sentence}");
            assert!(!world.exists());
        } else {
            assert_eq!(output.status.code(), Some(0), "{name}: {}", String::from_utf8_lossy(&output.stderr));
            Database::open(&world).unwrap();
        }
    }
    assert!(count > 20, "{count} files");
}

#[test]
fn all_of_bad_input_is_refused_in_one_sentence() {
    let Some(folder) = data("bad-input") else { return };
    let place = TestFolder::new();
    let mut count = 0;
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|e| e != "tif") {
            continue;
        }
        count += 1;
        let world = place.path("w.tv");
        // Also with a CRS given: then it is the content that has to be refused.
        for more in [&[][..], &["--source-crs", "EPSG:32632"]] {
            let arguments =
                [&["ingest", "--elevation", path.to_str().unwrap(), "-o", world.to_str().unwrap()][..], more].concat();
            let output = program(&arguments);
            assert_eq!(
                output.status.code(),
                Some(2),
                "{}: {}",
                path.display(),
                String::from_utf8_lossy(&output.stderr)
            );
            error_line(&output);
            assert!(!world.exists(), "{}", path.display());
        }
    }
    assert!(count > 10, "{count} files");
}
