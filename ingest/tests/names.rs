//! What a name may stand for, and what a file may not lead to.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod support;

use gdal::{Dataset, DriverManager};
use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use support::{TestFolder, Tiff, error_line, job, program, run};
use terravision_ingest::source::{Note, Region};

fn hills(i: usize, j: usize) -> f32 {
    800.0 + 300.0 * ((i as f32) / 17.0).sin() * ((j as f32) / 23.0).cos()
}

fn tile(folder: &TestFolder, name: &str, east: f64) -> PathBuf {
    fs::create_dir_all(folder.path(name).parent().unwrap()).unwrap();
    let transform = Some([500_000.0 + east, 10.0, 0.0, 5_200_000.0, 0.0, -10.0]);
    Tiff { transform, ..Tiff::utm([60, 50], hills) }.write(&folder.path(name))
}

/// An ingest of one name by the program; what it says in the end (or its error), and whether it
/// made a world.
fn ingest(folder: &TestFolder, elevation: &str, more: &[&str]) -> (String, bool) {
    let world = folder.path("out.tv");
    let all = [&["ingest", "--elevation", elevation, "-o", world.to_str().unwrap(), "--overwrite"], more].concat();
    let output = program(&all);
    let is_made = output.status.success();
    if !is_made {
        assert_eq!(output.status.code(), Some(2), "{}", String::from_utf8_lossy(&output.stderr));
        assert!(!world.exists());
        return (error_line(&output), false);
    }
    fs::remove_dir_all(&world).unwrap();
    (String::from_utf8_lossy(&output.stderr).into_owned(), true)
}

fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 })
    })
}

/// A zip archive of files as they are, not compressed.
fn zip(path: &Path, members: &[(&str, Vec<u8>)]) {
    let (mut out, mut directory) = (Vec::new(), Vec::new());
    let word = |v: usize| (v as u32).to_le_bytes();
    for (name, bytes) in members {
        let offset = out.len();
        let sums = [&crc32(bytes).to_le_bytes()[..], &word(bytes.len()), &word(bytes.len())].concat();
        let length = (name.len() as u16).to_le_bytes();
        out.extend(
            [&b"PK\x03\x04\x14\0\0\0\0\0\0\0\0\0"[..], &sums, &length, &[0, 0], name.as_bytes(), bytes].concat(),
        );
        directory
            .extend([&b"PK\x01\x02\x14\0\x14\0\0\0\0\0\0\0\0\0"[..], &sums, &length, &[0; 12], &word(offset)].concat());
        directory.extend(name.as_bytes());
    }
    let count = (members.len() as u16).to_le_bytes();
    let end = [&b"PK\x05\x06\0\0\0\0"[..], &count, &count, &word(directory.len()), &word(out.len()), &[0, 0]].concat();
    fs::write(path, [out, directory, end].concat()).unwrap();
}

#[test]
fn archives_and_folders_of_tiles_are_layers() {
    let folder = TestFolder::new();
    let [a, b] = [("a.tif", 0.0), ("b.tif", 600.0)].map(|(name, east)| fs::read(tile(&folder, name, east)).unwrap());
    let readme = ("readme.txt", b"about".to_vec());
    let (two, one, none, twice) =
        (folder.path("two.zip"), folder.path("one.zip"), folder.path("none.zip"), folder.path("twice.zip"));
    zip(&two, &[("L32/a.tif", a.clone()), ("L32/b.tif", b.clone()), readme.clone()]);
    zip(&one, &[("a.tif", a.clone()), readme.clone()]);
    zip(&none, std::slice::from_ref(&readme));
    zip(&twice, &[("a.tif", a.clone()), ("mask.tif", a.clone())]);
    let (database, notes) = run(&job(std::slice::from_ref(&two), &[], folder.path("two.tv"))).unwrap();
    assert!(matches!(&notes[0], Note::Info(t) if t.contains("a.tif, b.tif")), "{notes:?}");
    assert_eq!(database.world().extent(), [119, 49]);
    let named: Vec<_> = database.manifest().fields().elevation.sources.iter().map(|s| s.file.as_str()).collect();
    assert_eq!(named, ["a.tif", "b.tif"]);
    let (database, _) = run(&job(&[one], &[], folder.path("one.tv"))).unwrap();
    assert_eq!(database.world().extent(), [59, 49]);
    let message = |path: &Path| run(&job(&[path.to_owned()], &[], folder.path("x.tv"))).unwrap_err().to_string();
    assert!(message(&none).contains("raster"), "{}", message(&none));
    let several = message(&twice);
    assert!(
        several.contains("same place") && several.contains("/vsizip/") && several.contains("twice.zip/mask.tif"),
        "{several}"
    );
    // A member by the name that the message gives.
    let member = PathBuf::from(format!("/vsizip/{}/mask.tif", twice.display()));
    run(&job(&[member], &[], folder.path("member.tv"))).unwrap();

    let tiles = folder.path("tiles");
    fs::create_dir(&tiles).unwrap();
    fs::write(tiles.join("a.tif"), &a).unwrap();
    fs::write(tiles.join("b.tif"), &b).unwrap();
    fs::write(tiles.join("notes.txt"), "mine").unwrap();
    let (database, _) = run(&job(std::slice::from_ref(&tiles), &[], folder.path("tiles.tv"))).unwrap();
    assert_eq!(database.world().extent(), [119, 49]);
    let other = Tiff { crs: Some("EPSG:32633"), ..Tiff::utm([20, 20], hills) };
    other.write(&tiles.join("c.tif"));
    assert!(message(&tiles).contains("several coordinate reference systems"), "{}", message(&tiles));
    fs::create_dir(folder.path("empty")).unwrap();
    assert!(message(&folder.path("empty")).contains("no raster"));
}

#[test]
fn data_sets_within_files_are_named_and_opened() {
    let folder = TestFolder::new();
    let pages = tile(&folder, "pages.tif", 0.0);
    Tiff { options: &["APPEND_SUBDATASET=YES"], ..Tiff::utm([30, 20], hills) }.write(&pages);
    let page = PathBuf::from(format!("GTIFF_DIR:1:{}", pages.display()));
    let (database, _) = run(&job(&[page], &[], folder.path("page.tv"))).unwrap();
    assert_eq!(database.world().extent(), [59, 49]);

    let many = folder.path("many.nc");
    let driver = DriverManager::get_driver_by_name("netCDF").unwrap();
    let source = Dataset::open(
        Tiff { bands: vec![vec![5.0f32; 900]; 2], ..Tiff::utm([30, 30], hills) }.write(&folder.path("2.tif")),
    );
    source.unwrap().create_copy(&driver, &many, &gdal::raster::RasterCreationOptions::new()).unwrap().close().unwrap();
    let text = run(&job(std::slice::from_ref(&many), &[], folder.path("x.tv"))).unwrap_err().to_string();
    let name = format!("NETCDF:\"{}\":Band2", many.display());
    assert!(text.contains("2 data sets") && text.contains(&name), "{text}");
    run(&job(&[PathBuf::from(name)], &[], folder.path("band.tv"))).unwrap();
    let (text, is_made) = ingest(&folder, &format!("NETCDF:\"{}\":Band9", many.display()), &[]);
    assert!(!is_made && text.contains("not a raster"), "{text}");
}

/// A web server that knows ranges, and how many requests it got.
fn server(file: Vec<u8>) -> (u16, Arc<AtomicUsize>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let (port, count) = (listener.local_addr().unwrap().port(), Arc::new(AtomicUsize::new(0)));
    let counter = Arc::clone(&count);
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            counter.fetch_add(1, Ordering::SeqCst);
            // A client that has disconnected does not matter.
            answer(stream, &file).ok();
        }
    });
    (port, count)
}

fn answer(mut stream: TcpStream, file: &[u8]) -> std::io::Result<()> {
    let mut lines = BufReader::new(stream.try_clone()?).lines();
    let request = lines.next().transpose()?.unwrap_or_default();
    let mut range = None;
    for line in lines {
        let line = line?.to_ascii_lowercase();
        if let Some(bytes) = line.strip_prefix("range: bytes=") {
            let (first, last) = bytes.split_once('-').unwrap_or(("0", ""));
            let last = last.parse().unwrap_or(file.len() - 1).min(file.len() - 1);
            range = Some((first.parse::<usize>().unwrap_or(0), last));
        }
        if line.is_empty() {
            break;
        }
    }
    if !request.contains("/dem.tif") {
        return stream.write_all(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\nConnection: close\r\n\r\n");
    }
    let (status, body) = match range {
        Some((first, last)) if first <= last => {
            (format!("206 Partial Content\r\nContent-Range: bytes {first}-{last}/{}", file.len()), &file[first..=last])
        }
        _ => ("200 OK".to_owned(), file),
    };
    let head = format!(
        "HTTP/1.1 {status}\r\nAccept-Ranges: bytes\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes())?;
    if request.starts_with("HEAD") { Ok(()) } else { stream.write_all(body) }
}

#[test]
fn addresses_are_read_from_their_server() {
    let folder = TestFolder::new();
    let (port, _) = server(fs::read(tile(&folder, "dem.tif", 0.0)).unwrap());
    let (text, is_made) = ingest(&folder, &format!("http://127.0.0.1:{port}/a/dem.tif"), &[]);
    assert!(is_made, "{text}");
    let (text, is_made) = ingest(&folder, &format!("http://me:secret@127.0.0.1:{port}/other.tif?token=secret"), &[]);
    assert!(!is_made && text.contains("/other.tif") && !text.contains("secret"), "{text}");
}

fn raw_vrt(source: &str, is_relative: bool) -> String {
    format!(
        "<VRTDataset rasterXSize=\"20\" rasterYSize=\"20\"><SRS>EPSG:32632</SRS>\
         <GeoTransform>500000,10,0,5200000,0,-10</GeoTransform>\
         <VRTRasterBand dataType=\"Byte\" band=\"1\" subClass=\"VRTRawRasterBand\">\
         <SourceFilename relativeToVRT=\"{}\">{source}</SourceFilename><ImageOffset>0</ImageOffset>\
         <PixelOffset>1</PixelOffset><LineOffset>20</LineOffset></VRTRasterBand></VRTDataset>",
        u8::from(is_relative)
    )
}

fn simple_vrt(source: &str) -> String {
    format!(
        "<VRTDataset rasterXSize=\"60\" rasterYSize=\"50\"><SRS>EPSG:32632</SRS>\
         <GeoTransform>500000,10,0,5200000,0,-10</GeoTransform><VRTRasterBand dataType=\"Float32\" band=\"1\">\
         <SimpleSource><SourceFilename relativeToVRT=\"1\">{source}</SourceFilename><SourceBand>1</SourceBand>\
         <SourceProperties RasterXSize=\"60\" RasterYSize=\"50\" DataType=\"Float32\" BlockXSize=\"60\" BlockYSize=\"34\"/>\
         <SrcRect xOff=\"0\" yOff=\"0\" xSize=\"60\" ySize=\"50\"/><DstRect xOff=\"0\" yOff=\"0\" xSize=\"60\" ySize=\"50\"/>\
         </SimpleSource></VRTRasterBand></VRTDataset>"
    )
}

/// A secret file outside of the folder that files are in.
fn secret(folder: &TestFolder) -> String {
    let path = folder.path("secret.bin");
    fs::write(&path, vec![7u8; 4000]).unwrap();
    path.display().to_string()
}

#[test]
fn a_file_that_is_a_list_of_others_is_opened_only_by_that_name() {
    let folder = TestFolder::new();
    let inner = folder.path("inner");
    fs::create_dir(&inner).unwrap();
    let secret = secret(&folder);
    let write = |name: &str, text: &str| {
        let path = inner.join(name);
        fs::write(&path, text).unwrap();
        path.display().to_string()
    };
    let refused = |name: &str| {
        let (text, is_made) = ingest(&folder, name, &[]);
        assert!(!is_made && text.contains("--trust-vrt"), "{name}: {text}");
    };
    refused(&write("dem.tif", &raw_vrt(&secret, false)));
    refused(&write("absolute.vrt", &raw_vrt(&secret, false)));
    refused(&write("up.vrt", &raw_vrt("../secret.bin", true)));
    refused(&write("vsi.vrt", &raw_vrt(&format!("/vsisubfile/0_4000,{secret}"), false)));
    refused(&write("escaped.vrt", &raw_vrt("&#46;&#46;/secret.bin", true)));
    write("in.vrt", &raw_vrt(&secret, false));
    refused(&write("nested.vrt", &simple_vrt("in.vrt")));
    // A source that is a VRT under another name.
    write("tile.tif", &raw_vrt(&secret, false));
    refused(&write("hidden.vrt", &simple_vrt("tile.tif")));
    std::os::unix::fs::symlink(&secret, inner.join("link.bin")).unwrap();
    refused(&write("link.vrt", &raw_vrt("link.bin", true)));
    refused(&write("inline.vrt", &simple_vrt("&lt;VRTDataset rasterXSize=&quot;1&quot;/&gt;")));
    refused(&raw_vrt(&secret, false));
    // Names that readers of XML could read differently, and text that is not XML.
    refused(&write("comment.vrt", &raw_vrt("tiles<!-- -->/../link.bin", true)));
    refused(&write("cdata.vrt", &raw_vrt(&format!("<![CDATA[{secret}]]>"), false)));
    let entity = format!("<!DOCTYPE a [<!ENTITY s \"{secret}\">]>{}", raw_vrt("&s;", false));
    refused(&write("entity.vrt", &entity));
    refused(&write("unknown.vrt", &raw_vrt("&s;", false)));
    refused(&write("twice.vrt", &raw_vrt("tile.bin", true).replace("subClass", "band=\"1\" subClass")));
    refused(&write("cut.vrt", raw_vrt("tile.bin", true).trim_end_matches("</VRTDataset>")));
    // With the user's word it is opened.
    let (text, is_made) = ingest(&folder, inner.join("absolute.vrt").to_str().unwrap(), &["--trust-vrt"]);
    assert!(is_made, "{text}");
    let (text, is_made) = ingest(&folder, inner.join("dem.tif").to_str().unwrap(), &["--trust-vrt"]);
    assert!(is_made, "{text}");
    // What lies under its folder needs no word.
    tile(&folder, "inner/tiles/a.tif", 0.0);
    write("deep.vrt", &simple_vrt("tiles/a.tif"));
    let (text, is_made) = ingest(&folder, &write("good.vrt", &simple_vrt("deep.vrt")), &[]);
    assert!(is_made, "{text}");
    // In an archive it is not opened.
    let bytes = fs::read(inner.join("absolute.vrt")).unwrap();
    zip(&folder.path("vrt.zip"), &[("dem.tif", bytes.clone()), ("dem.vrt", bytes)]);
    for name in ["vrt.zip/dem.tif", "vrt.zip/dem.vrt"] {
        let (text, is_made) = ingest(&folder, &format!("/vsizip/{}", folder.path(name).display()), &[]);
        assert!(!is_made, "{text}");
    }
    let (text, is_made) = ingest(&folder, folder.path("vrt.zip").to_str().unwrap(), &[]);
    assert!(!is_made, "{text}");
}

#[test]
fn what_lies_beside_a_raster_leads_nowhere_either() {
    let folder = TestFolder::new();
    let dem = tile(&folder, "dem.tif", 0.0);
    let good = simple_vrt("dem.tif");
    fs::write(folder.path("good.vrt"), &good).unwrap();
    fs::write(folder.path("dem.tif.ovr"), raw_vrt(&secret(&folder), false)).unwrap();
    for name in [&dem, &folder.path("good.vrt")] {
        let (text, is_made) = ingest(&folder, name.to_str().unwrap(), &[]);
        assert!(!is_made && text.contains("dem.tif.ovr"), "{text}");
    }
    fs::remove_file(folder.path("dem.tif.ovr")).unwrap();
    // A tag can name a file of overviews.
    let options = gdal::DatasetOptions { open_flags: gdal::GdalOpenFlags::GDAL_OF_UPDATE, ..Default::default() };
    let mut dataset = Dataset::open_ex(&dem, options).unwrap();
    gdal::Metadata::set_metadata_item(&mut dataset, "OVERVIEW_FILE", "/etc/passwd", "OVERVIEWS").unwrap();
    dataset.close().unwrap();
    let (text, is_made) = ingest(&folder, dem.to_str().unwrap(), &[]);
    assert!(!is_made && text.contains("/etc/passwd"), "{text}");
}

#[test]
fn a_file_sends_no_requests() {
    let folder = TestFolder::new();
    let (port, count) = server(vec![0; 100]);
    let url = format!("http://127.0.0.1:{port}/dem.tif");
    let wms = format!(
        "<GDAL_WMS><Service name=\"TMS\"><ServerUrl>{url}/${{z}}/${{x}}/${{y}}.png</ServerUrl></Service><DataWindow>\
         <UpperLeftX>-20037508.34</UpperLeftX><UpperLeftY>20037508.34</UpperLeftY><LowerRightX>20037508.34</LowerRightX>\
         <LowerRightY>-20037508.34</LowerRightY><TileLevel>1</TileLevel><TileCountX>1</TileCountX><TileCountY>1</TileCountY>\
         </DataWindow><Projection>EPSG:3857</Projection><BlockSizeX>256</BlockSizeX><BlockSizeY>256</BlockSizeY>\
         <BandsCount>3</BandsCount></GDAL_WMS>"
    );
    let index = format!("<GDALTileIndexDataset><IndexDataset>{url}</IndexDataset></GDALTileIndexDataset>");
    let stac = format!("{{\"type\": \"FeatureCollection\", \"stac_version\": \"1.0.0\", \"features\": [\"{url}\"]}}");
    let mrf = format!(
        "<MRF_META><CachedSource><Source>/vsicurl/{url}</Source></CachedSource><Raster><Size x=\"512\" y=\"512\" c=\"1\"/>\
         </Raster></MRF_META>"
    );
    let vrt = simple_vrt(&format!("/vsicurl/{url}"));
    for (name, text) in [
        ("wms.tif", &wms),
        ("index.tif", &index),
        ("stac.tif", &stac),
        ("mrf.tif", &mrf),
        ("vrt.tif", &vrt),
        ("vrt.vrt", &vrt),
    ] {
        let path = folder.path(name);
        fs::write(&path, text).unwrap();
        let (said, is_made) = ingest(&folder, path.to_str().unwrap(), &[]);
        assert!(!is_made && said.contains("--trust-vrt"), "{name}: {said}");
    }
    assert_eq!(count.load(Ordering::SeqCst), 0);
}

#[test]
fn pipes_and_devices_are_refused() {
    let folder = TestFolder::new();
    let (text, is_made) = ingest(&folder, "/dev/zero", &[]);
    assert!(!is_made && text.contains("device or a pipe"), "{text}");
    let pipe = folder.path("pipe.tif");
    rustix::fs::mknodat(rustix::fs::CWD, &pipe, rustix::fs::FileType::Fifo, rustix::fs::Mode::RUSR, 0).unwrap();
    let (text, is_made) = ingest(&folder, pipe.to_str().unwrap(), &[]);
    assert!(!is_made && text.contains("device or a pipe"), "{text}");
}

/// A globe of half degrees whose height is longitude and latitude.
fn globe(folder: &TestFolder) -> PathBuf {
    let ground = |i: usize, j: usize| ((i as f32 + 0.5) * 0.5 - 180.0) * 10.0 + (90.0 - (j as f32 + 0.5) * 0.5);
    let transform = Some([-180.0, 0.5, 0.0, 90.0, 0.0, -0.5]);
    Tiff { transform, crs: Some("EPSG:4326"), ..Tiff::utm([720, 360], ground) }.write(&folder.path("globe.tif"))
}

#[test]
fn bounds_make_a_world_of_a_country() {
    let folder = TestFolder::new();
    let globe = globe(&folder);
    let world = |name: &str, bounds: [f64; 4]| {
        let mut job = job(std::slice::from_ref(&globe), &[], folder.path(name));
        job.region = Some(Region::new(bounds, None).unwrap());
        run(&job).unwrap()
    };
    let (italy, notes) = world("italy.tv", [6.6, 35.5, 18.6, 47.1]);
    assert!(matches!(&notes[0], Note::Info(text) if text.contains("around the data")), "{notes:?}");
    // Longitudes 6.6 to 18.6: heights of 66 to 186, and latitudes on top.
    let [low, high] = italy.manifest().fields().elevation.range_m;
    assert!((60.0..110.0).contains(&low) && (220.0..260.0).contains(&high), "{low} to {high}");
    let [width, height] = italy.world().extent_m();
    assert!((9.5e5..1.25e6).contains(&width) && (1.2e6..1.45e6).contains(&height), "{width} x {height}");
    assert_eq!(italy.manifest().fields().elevation.void_area_m2, 0.0);

    // Across the date line: both sides of it, and nothing of the rest.
    let (fiji, _) = world("fiji.tv", [175.0, -20.0, -175.0, -15.0]);
    let [width, _] = fiji.world().extent_m();
    // Ten degrees at 15 to 20 degrees of latitude, and a post of 54 km at either end at most.
    assert!((1.05e6..1.18e6).contains(&width), "{width}");
    assert_eq!(fiji.manifest().fields().elevation.void_area_m2, 0.0);

    let mut beside = job(&[tile(&folder, "tile.tif", 0.0)], &[], folder.path("beside.tv"));
    beside.region = Some(Region::new([20.0, 10.0, 21.0, 11.0], None).unwrap());
    let text = run(&beside).unwrap_err().to_string();
    assert!(text.contains("outside the elevation, which covers 9.0000,46.9"), "{text}");
}

#[test]
fn bounds_in_the_files_own_plane_keep_its_samples() {
    let folder = TestFolder::new();
    let dem = tile(&folder, "dem.tif", 0.0);
    let mut part = job(std::slice::from_ref(&dem), &[], folder.path("part.tv"));
    part.region = Some(Region::new([500_100.0, 5_199_700.0, 500_300.0, 5_199_850.0], Some("EPSG:32632")).unwrap());
    let (database, notes) = run(&part).unwrap();
    assert_eq!(notes, []);
    let fields = database.world().fields();
    assert_eq!((fields.origin, fields.extent), ([500_095.0, 5_199_695.0], [21, 16]));
    assert!(database.manifest().fields().elevation.sources[0].is_exact);
    let (posts, width) = support::heights(&database, 0);
    for (i, j) in (0..22).flat_map(|i| (0..17).map(move |j| (i, j))) {
        // Row 0 of the world is row 30 from the top of the file.
        assert!((posts[j * width + i] - hills(9 + i, 30 - j)).abs() <= 1.0 / 256.0 + 1e-4, "post {i}, {j}");
    }
}

#[test]
fn the_result_comes_as_json() {
    let folder = TestFolder::new();
    let (dem, world) = (tile(&folder, "dem.tif", 0.0), folder.path("w.tv"));
    let bounds = "9.001,46.950,9.004,46.953";
    let output = program(&[
        "ingest",
        "--elevation",
        dem.to_str().unwrap(),
        "-o",
        world.to_str().unwrap(),
        "--json",
        "--bounds",
        bounds,
    ]);
    let value: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(value["schema"], "terravision-ingest-1");
    assert_eq!(value["path"], world.to_str().unwrap());
    assert_eq!(value["crs"]["epsg"], 32632);
    let [w, s, e, n] = [0, 1, 2, 3].map(|k| value["bounds_lon_lat"][k].as_f64().unwrap());
    assert!(
        (w - 9.001).abs() < 3e-4 && (s - 46.950).abs() < 3e-4 && (e - 9.004).abs() < 3e-4 && (n - 46.953).abs() < 3e-4,
        "{value}"
    );
    let files = ["elevation.pmtiles", "color.pmtiles", "nodes.tvn"].map(|f| fs::metadata(world.join(f)).unwrap().len());
    assert_eq!(value["bytes"], files.iter().sum::<u64>());
    assert!(value["warnings"].as_array().unwrap().is_empty());
    let output = program(&[
        "ingest",
        "--elevation",
        dem.to_str().unwrap(),
        "-o",
        world.to_str().unwrap(),
        "--bounds",
        "9.1,47,9,46",
    ]);
    assert_eq!(output.status.code(), Some(2));
}
