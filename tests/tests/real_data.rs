//! Real rasters, from `TERRAVISION_DATA`: they ingest, and what is seen of them looks as they do.
//! Without that folder there is nothing to test, and the tests say so.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;
use terravision_tests::flight::read_png;
use terravision_tests::folder::{TestFolder, target_tmp};
use terravision_tests::process::Terravision;

fn data() -> Option<PathBuf> {
    let folder = std::env::var_os("TERRAVISION_DATA").map(PathBuf::from);
    if folder.is_none() {
        println!("TERRAVISION_DATA is not set: real data was not tested");
    }
    // Tests run in their package's folder, the variable is given for the workspace's.
    folder.map(|folder| if folder.is_absolute() { folder } else { Path::new("..").join(folder) })
}

struct Place<'a> {
    name: &'a str,
    elevation: PathBuf,
    color: Option<PathBuf>,
    more: &'a [&'a str],
}

/// Mean and standard deviation of the luma of a picture's land, and its share of the picture.
fn land_statistics(rgb: &[[u8; 3]], sky: [u8; 3]) -> (f64, f64, f64) {
    let luma: Vec<f64> = rgb
        .iter()
        .filter(|p| **p != sky)
        .map(|p| 0.299 * f64::from(p[0]) + 0.587 * f64::from(p[1]) + 0.114 * f64::from(p[2]))
        .collect();
    let count = luma.len().max(1) as f64;
    let mean = luma.iter().sum::<f64>() / count;
    let deviation = (luma.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / count).sqrt();
    (mean, deviation, luma.len() as f64 / rgb.len() as f64)
}

/// Ingests, flies three frames of the orbit, looks at the pictures' statistics, keeps one picture
/// for people.
fn visit(place: &Place<'_>) {
    const SKY: [u8; 3] = [255, 0, 255];
    let folder = TestFolder::new(place.name);
    let mut ingest = Terravision::verb("ingest").arg("--elevation").arg(&place.elevation);
    if let Some(color) = &place.color {
        ingest = ingest.arg("--color").arg(color);
    }
    // What the camera passes is to be ground, also where the data have gaps at their border.
    let ingest = ingest.args(["--voids", "fill"]);
    let ingested = ingest.arg("-o").arg(folder.join("w.tv")).args(place.more).deadline(Duration::from_secs(300)).run();
    ingested.assert_code(0);
    Terravision::verb("info").arg(folder.join("w.tv")).arg("--json").succeed();
    for frame in [0u32, 60, 150] {
        let out = folder.join(format!("{frame}/"));
        let flight = Terravision::verb("fly")
            .arg(folder.join("w.tv"))
            .args(["--path", "orbit", "--size", "640x360", "--sky", "255,0,255"])
            .args(["--frames", &format!("{frame}..{}", frame + 1)])
            .arg("-o")
            .arg(&out)
            .run();
        flight.assert_code(0);
        let (_, _, rgb) = read_png(&out.join(format!("frame-{frame:06}.png")));
        let (mean, deviation, land) = land_statistics(&rgb, SKY);
        println!("{} frame {frame}: land {:.0} %, luma {mean:.0} +- {deviation:.0}", place.name, 100.0 * land);
        assert!(land > 0.3, "{} frame {frame} shows {land} of land", place.name);
        assert!((15.0..245.0).contains(&mean), "{} frame {frame}: mean luma {mean}", place.name);
        assert!(deviation > 4.0, "{} frame {frame} is blank: deviation {deviation}", place.name);
        // Sky is above: at most a few pixels of its colour in the lowest rows, and more where the
        // camera swings beside the border.
        let most = if flight.stderr.contains("swings to and fro") { 640 * 6 } else { 640 };
        let below = rgb[640 * 340..].iter().filter(|p| **p == SKY).count();
        assert!(below < most, "{} frame {frame}: {below} pixels of background at the bottom", place.name);
        if frame == 60 {
            std::fs::create_dir_all(target_tmp().join("places")).unwrap();
            let kept = target_tmp().join(format!("places/{}.png", place.name));
            std::fs::copy(out.join("frame-000060.png"), kept).unwrap();
        }
    }
}

#[test]
fn pairs_of_elevation_and_colour() {
    let Some(data) = data() else { return };
    let pairs: [(&str, &str, &str, &[&str]); 4] = [
        ("earth-craterlake", "craterlake-elev-16bit-30m.tif", "craterlake-imagery-30m.tif", &[]),
        ("earth-rockymtn", "rmnp-dem.tif", "rmnp-rgb.tif", &[]),
        ("earth-olinda", "olinda_dem_utm25s.tif", "L7_ETMs.tif", &[]),
        ("mars-gale", "gale_missionDEM_1m.tif", "gale_hirise_ortho_mercator.tif", &[]),
    ];
    for (name, elevation, color, more) in pairs {
        let folder = data.join(name);
        visit(&Place { name, elevation: folder.join(elevation), color: Some(folder.join(color)), more });
    }
}

#[test]
fn elevation_alone_is_tinted() {
    let Some(data) = data() else { return };
    for (name, file) in [
        ("sthelens", "earth-sthelens/SainteHelens.dem"),
        ("rainier", "earth-srtm3/mt_rainier_90m.tif"),
        ("fuji", "earth-srtm3/mt_fuji_90m.tif"),
        ("everest", "earth-srtm3/mt_everest_90m.tif"),
        ("everest-hgt", "earth-srtm3/N27E086.hgt"),
        ("kossou", "earth-srtm3/n07_w006_3arc_v2.tif"),
    ] {
        visit(&Place { name, elevation: data.join(file), color: None, more: &[] });
    }
}

/// The Alps out of the whole globe.
#[test]
fn a_crop_of_the_globe() {
    let Some(data) = data() else { return };
    let folder = TestFolder::new("globe");
    let crop = |from: &str, to: &str, georeference: &[&str]| {
        let first = folder.join(format!("whole-{to}"));
        let whole = data.join("earth-global").join(from);
        let run = |arguments: &[&str], input: &Path, output: &Path| {
            let done = Command::new("gdal_translate").arg("-q").args(arguments).arg(input).arg(output).output();
            let done = done.expect("gdal_translate, of the package gdal-bin, can be started");
            assert!(done.status.success(), "gdal_translate {from}: {}", String::from_utf8_lossy(&done.stderr));
        };
        if georeference.is_empty() {
            run(&["-projwin", "4", "49", "17", "43"], &whole, &folder.join(to));
        } else {
            run(georeference, &whole, &first);
            run(&["-projwin", "4", "49", "17", "43"], &first, &folder.join(to));
        }
    };
    crop("etopo5_global_5min_int16.tif", "dem.tif", &[]);
    crop("bluemarble_5400x2700.jpg", "color.tif", &["-a_srs", "EPSG:4326", "-a_ullr", "-180", "90", "180", "-90"]);
    visit(&Place { name: "alps", elevation: folder.join("dem.tif"), color: Some(folder.join("color.tif")), more: &[] });
}

/// All of `ingest-geotiff` and `bad-input`: a database or a sentence.
#[test]
fn every_raster_is_ingested_or_refused_with_a_sentence() {
    let Some(data) = data() else { return };
    let folder = TestFolder::new("readers");
    let mut outcomes = [0usize; 2];
    for group in ["ingest-geotiff", "bad-input"] {
        let mut files: Vec<_> = std::fs::read_dir(data.join(group))
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .filter(|path| path.extension().is_some_and(|e| e == "tif"))
            .collect();
        files.sort();
        for file in files {
            let out = folder.join("w.tv");
            let finished = Terravision::verb("ingest")
                .arg("--elevation")
                .arg(&file)
                .arg("-o")
                .arg(&out)
                .arg("--overwrite")
                .deadline(Duration::from_secs(120))
                .run();
            let name = file.file_name().unwrap().to_string_lossy().into_owned();
            println!("{name}: {:?} {}", finished.code(), finished.stderr.lines().last().unwrap_or_default());
            match finished.code() {
                Some(0) => {
                    outcomes[0] += 1;
                    Terravision::verb("info").arg(&out).arg("--json").run().assert_code(0);
                    std::fs::remove_dir_all(&out).unwrap();
                }
                code => {
                    outcomes[1] += 1;
                    finished.assert_told(2);
                    assert!(!out.exists(), "{name}: refused with {code:?}, and something was left");
                }
            }
        }
    }
    println!("{} were ingested, {} were refused", outcomes[0], outcomes[1]);
    assert!(outcomes[0] > 15 && outcomes[1] > 8);
}

/// Crater Lake, whose tiles of few posts leave gaps where there are no data, from beside the world: a
/// sweep once drew walls below the squares without tiles.
#[test]
fn gaps_between_tiles_look_the_same_swept_and_cast() {
    let Some(data) = data() else { return };
    let folder = TestFolder::new("gaps");
    let elevation = data.join("earth-craterlake/craterlake-elev-16bit-30m.tif");
    let world = folder.join("w.tv");
    let ingest = Terravision::verb("ingest").arg("--elevation").arg(elevation).args(["--elevation-tile", "16"]);
    // It warns of samples that are taken as voids.
    ingest.arg("-o").arg(&world).deadline(Duration::from_secs(300)).run().assert_code(0);
    let picture = |rays: &str| {
        let file = folder.join(format!("{rays}.png"));
        let still = Terravision::verb("still").arg(&world).args(["--look-at", "572801,4754744"]);
        still.args(["--from=75,-40,7607", "--size=480x270", "--rays", rays]).arg("-o").arg(&file).succeed();
        read_png(&file).2
    };
    let (swept, cast) = (picture("sweep"), picture("mipmap"));
    let differ = |(a, b): &(&[u8; 3], &[u8; 3])| a.iter().zip(*b).any(|(a, b)| a.abs_diff(*b) > 30);
    let count = swept.iter().zip(&cast).filter(differ).count();
    // Edges of facets and skylines; the walls were 55,000.
    assert!(count < 1_000, "{count} of {} pixels differ", swept.len());
}
