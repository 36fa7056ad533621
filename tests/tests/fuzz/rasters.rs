//! Rasters, as ingest opens them: GeoTIFF with all that its tags say, and VRT. In a process of its
//! own: most of what reads them is GDAL.

use std::fs;
use std::path::Path;
use std::time::Duration;
use terravision_tests::folder::TestFolder;
use terravision_tests::fuzz::Target;
use terravision_tests::geotiff::write_heights;
use terravision_tests::process::Terravision;

fn raster(folder: &TestFolder, name: &str) -> Vec<u8> {
    let posts: Vec<f32> = (0..20 * 20).map(|k| 100.0 + (k % 20) as f32).collect();
    write_heights(&folder.join(name), 20, 20, [500_000.0, 5_000_000.0], 10.0, &posts);
    fs::read(folder.join(name)).unwrap()
}

/// Ingests a file: it becomes a world, or one sentence says why not.
fn ingest(folder: &TestFolder, file: &Path) {
    let finished = Terravision::verb("ingest")
        .arg("--elevation")
        .arg(file)
        .arg("-o")
        .arg(folder.join("w.tv"))
        .args(["--overwrite", "--memory", "256MiB", "--threads", "1"])
        .deadline(Duration::from_secs(60))
        .run();
    let code = finished.status.code();
    assert!(matches!(code, Some(0..=2)), "{code:?}: {}", finished.stderr);
    assert!(!finished.stderr.contains("panicked") && !finished.stderr.contains("internal"), "{}", finished.stderr);
}

#[test]
fn geotiffs() {
    let folder = TestFolder::new("fuzz-tiff");
    let inputs = vec![raster(&folder, "dem.tif")];
    let words: [&[u8]; 4] = [b"GDAL_NODATA", b"<GDALMetadata>", b"nan\0", &[0xaf, 0x87, 0x03, 0]];
    let target = Target { name: "geotiff", inputs, words: &words, short_round: 25 };
    let file = folder.join("changed.tif");
    target.run(|bytes| {
        // Tags, not samples: samples may be anything.
        fs::write(&file, bytes).unwrap();
        ingest(&folder, &file);
    });
}

#[test]
fn lists_of_files() {
    let folder = TestFolder::new("fuzz-vrt");
    raster(&folder, "dem.tif");
    fs::write(folder.path().parent().unwrap().join("secret.bin"), vec![7u8; 4000]).unwrap();
    let words: [&[u8]; 8] = [
        b"<SourceFilename relativeToVRT=\"1\">dem.tif</SourceFilename>",
        b"<SourceFilename>/etc/passwd</SourceFilename>",
        b"../",
        b"/vsicurl/http://127.0.0.1:1/",
        b"<!--",
        b"<![CDATA[",
        b"&#46;",
        b"subClass=\"VRTDerivedRasterBand\"",
    ];
    let target = Target { name: "vrt", inputs: Vec::new(), words: &words, short_round: 25 };
    let file = folder.join("changed.vrt");
    target.run(|bytes| {
        fs::write(&file, bytes).unwrap();
        ingest(&folder, &file);
    });
}
