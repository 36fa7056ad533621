//! Which other files and addresses an input file may refer to.
//!
//! GDAL chooses a driver by the *content* of a file. Some contents are not a raster but a list of
//! other files or addresses: a `dem.tif` that is a VRT can read any file of this machine, and one
//! that describes a map service sends requests. Such a driver is used only when the **name** asks
//! for it (`.vrt`, `WMS:…`, `https://…`, `/vsi…/`), or with `--trust-vrt`. Three layers, so that
//! nothing nested slips through:
//!
//! 1. every dataset is opened with a list of drivers that has none of these ([`Access::drivers`]);
//! 2. what lies beside a file and is opened with it (overviews, masks), what its tags name as
//!    overviews, and labels of data in other files are looked at before and after
//!    ([`Access::check_before`], [`Access::check_after`]); a `.vrt` is read and its sources are
//!    kept under its folder (`vrt.rs`);
//! 3. the program takes the drivers that no name asks for out of GDAL altogether
//!    ([`Access::restrict_process`]).

use super::vrt;
use gdal::{Dataset, DatasetOptions, DriverManager, GdalOpenFlags, Metadata};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// How a name on the command line asks for a driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum AskedBy {
    /// By its ending.
    Ending,
    /// It has the address itself in it: `WMTS:…`.
    Address,
    /// Not by name: lists of files need `--trust-vrt`.
    Trust,
}

/// Drivers whose files name other files or addresses (GDAL 3.12 and before). Label formats whose
/// data lie in a file beside them are not among them: [`LABELS`].
const LEADING: [(&str, AskedBy); 26] = [
    ("VRT", AskedBy::Ending),
    ("DERIVED", AskedBy::Trust),
    ("GTI", AskedBy::Trust),
    ("GDALG", AskedBy::Trust),
    ("WMS", AskedBy::Address),
    ("WMTS", AskedBy::Address),
    ("WCS", AskedBy::Address),
    ("HTTP", AskedBy::Trust),
    ("OGCAPI", AskedBy::Address),
    ("STACTA", AskedBy::Trust),
    ("STACIT", AskedBy::Trust),
    ("MRF", AskedBy::Trust),
    ("KMLSUPEROVERLAY", AskedBy::Trust),
    ("RPFTOC", AskedBy::Trust),
    ("ECRGTOC", AskedBy::Trust),
    ("PLMOSAIC", AskedBy::Address),
    ("PLScenes", AskedBy::Address),
    ("DAAS", AskedBy::Address),
    ("EEDA", AskedBy::Address),
    ("EEDAI", AskedBy::Address),
    ("NGW", AskedBy::Address),
    ("PostGISRaster", AskedBy::Address),
    ("GeoRaster", AskedBy::Address),
    ("RASDAMAN", AskedBy::Address),
    ("JPIPKAK", AskedBy::Address),
    ("DODS", AskedBy::Trust),
];

/// Whether a driver is one of [`LEADING`].
fn is_leading(driver: &str) -> bool {
    LEADING.iter().any(|(name, _)| name.eq_ignore_ascii_case(driver))
}

/// Drivers whose label names the files with the samples, usually beside it.
const LABELS: [&str; 21] = [
    "PDS",
    "PDS4",
    "ISIS3",
    "ISIS2",
    "VICAR",
    "ERS",
    "ILWIS",
    "MAP",
    "OZI",
    "DIMAP",
    "TIL",
    "FAST",
    "SNODAS",
    "RS2",
    "SAFE",
    "SENTINEL2",
    "TSX",
    "COSAR",
    "Zarr",
    "AirSAR",
    "GenBin",
];

/// Text at the beginning of files that refer to other files, and descriptions of these files.
const MARKERS: [(&str, &str); 14] = [
    ("<VRTDataset", "a VRT (a list of other files)"),
    ("<GDALTileIndexDataset", "a tile index (a list of other files)"),
    ("<MRF_META", "an MRF (it names other files)"),
    ("<GDAL_WMS", "the description of a map service"),
    ("<WMS_Capabilities", "the description of a map service"),
    ("<WMT_MS_Capabilities", "the description of a map service"),
    ("<TileMapService", "the description of a map service"),
    ("<GDAL_WMTS", "the description of a tile service"),
    ("<Capabilities", "the description of a tile service"),
    ("<WCS_GDAL", "the description of a coverage service"),
    ("<kml", "a KML overlay (it names other files)"),
    ("\"stac_version\"", "a STAC catalogue (it names other files)"),
    ("gdal_streamed_alg", "a GDALG pipeline (it names other files)"),
    ("\"refs\"", "a list of references to other files"),
];
/// Bytes at a file's beginning by which drivers are chosen.
const HEAD_BYTES: u64 = 4 << 10;
/// Bytes of a label that are checked.
const LABEL_BYTES: u64 = 1 << 20;

/// What the user allows files to do.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Access {
    /// `--trust-vrt`: files may refer to any file or address.
    pub trusts_links: bool,
}

/// The drivers that a name asks for by itself.
fn asked_for(name: &str) -> Option<&'static str> {
    let lower = name.to_ascii_lowercase();
    if lower.ends_with(".vrt") || lower.starts_with("vrt://") {
        return Some("VRT");
    }
    let prefix = match lower.split_once(':') {
        Some(("pg", _)) => "postgisraster",
        Some(("geor" | "georaster", _)) => "georaster",
        Some((prefix, _)) => prefix,
        None => ["wms", "wmts", "wcs"]
            .into_iter()
            .find(|service| lower.trim_start().strip_prefix("<gdal_").is_some_and(|rest| rest.starts_with(service)))?,
    };
    let services = LEADING.into_iter().filter(|(_, asked_by)| *asked_by == AskedBy::Address);
    services.map(|(driver, _)| driver).find(|driver| driver.eq_ignore_ascii_case(prefix))
}

/// Whether a name asks for a driver that reads lists of other files, which the user has to allow.
pub(super) fn names_a_list(name: &str) -> bool {
    let prefix = name.split(':').next().unwrap_or_default();
    let prefix = if prefix.eq_ignore_ascii_case("derived_subdataset") { "DERIVED" } else { prefix };
    name.contains(':') && asked_for(name).is_none() && is_leading(prefix)
}

/// The beginning of a file; empty where it cannot be read.
fn head(path: &Path, bytes: u64) -> Vec<u8> {
    let mut head = Vec::new();
    // GDAL, which reads it next, reports errors.
    File::open(path).and_then(|file| file.take(bytes).read_to_end(&mut head)).ok();
    head
}

fn has(bytes: &[u8], word: &str) -> bool {
    bytes.windows(word.len()).any(|window| window.eq_ignore_ascii_case(word.as_bytes()))
}

/// A description of a file that refers to other files; `None` for an ordinary one.
pub(super) fn leads_elsewhere(path: &Path) -> Option<&'static str> {
    let head = head(path, HEAD_BYTES);
    MARKERS.iter().find(|(word, _)| has(&head, word)).map(|(_, what)| *what)
}

/// Checks files beside a local file that GDAL opens together with it.
pub(super) fn check_neighbors(path: &Path) -> Result<(), String> {
    let beside = |ending: &str| PathBuf::from(format!("{}{ending}", path.display()));
    let all = [beside(".ovr"), beside(".OVR"), beside(".msk"), beside(".MSK"), path.with_extension("ovr")];
    for neighbor in all {
        if let Some(what) = leads_elsewhere(&neighbor) {
            return Err(format!(
                "would be read with {}, which is {what}, though its name does not say so; --trust-vrt allows it",
                neighbor.display()
            ));
        }
    }
    Ok(())
}

impl Access {
    /// The drivers that may open a name: all except those that read other files, plus the one that
    /// the name asks for.
    fn drivers(self, name: &str) -> Option<Vec<String>> {
        if self.trusts_links {
            return None;
        }
        let asked = asked_for(name);
        // A Zarr store is a folder; a file that is one would be a list of references.
        let is_file = Path::new(name).is_file();
        let leads = |driver: &str| is_leading(driver) || is_file && driver.eq_ignore_ascii_case("Zarr");
        let all = DriverManager::all().map(|driver| driver.short_name());
        Some(all.filter(|d| !leads(d) || asked.is_some_and(|a| a.eq_ignore_ascii_case(d))).collect())
    }

    /// Opens what GDAL calls `name`; only with `driver` when it is known.
    pub(super) fn open(self, name: &str, driver: Option<&str>) -> Result<Dataset, gdal::errors::GdalError> {
        let open_flags = GdalOpenFlags::GDAL_OF_RASTER | GdalOpenFlags::GDAL_OF_VERBOSE_ERROR;
        let drivers = match driver {
            Some(driver) => Some(vec![driver.to_owned()]),
            None => self.drivers(name),
        };
        let drivers: Option<Vec<&str>> = drivers.as_ref().map(|list| list.iter().map(String::as_str).collect());
        let options = DatasetOptions { open_flags, allowed_drivers: drivers.as_deref(), ..DatasetOptions::default() };
        Dataset::open_ex(name, options)
    }

    /// Checks a name before GDAL opens it. A message continues the sentence that begins with the
    /// name.
    pub(super) fn check_before(self, name: &str) -> Result<(), String> {
        if self.trusts_links {
            return Ok(());
        }
        let is_vrt = asked_for(name) == Some("VRT") || name.trim_start().starts_with("<VRTDataset");
        let path = Path::new(name);
        if is_vrt && !path.is_file() {
            return Err(
                "is a VRT whose sources cannot be looked at from here (it is in an archive, on a server, or no \
                        file): unpack or download it, or allow it with --trust-vrt"
                    .to_owned(),
            );
        }
        if is_vrt && leads_elsewhere(path).is_some() {
            return vrt::check(path);
        }
        if path.is_file() { check_neighbors(path) } else { Ok(()) }
    }

    /// Checks whether an opened dataset names other files.
    pub(super) fn check_after(self, name: &str, dataset: &Dataset) -> Result<(), String> {
        if self.trusts_links {
            return Ok(());
        }
        if let Some(file) = dataset.metadata_item("OVERVIEW_FILE", "OVERVIEWS") {
            return Err(format!("names another file for its overviews ({file}); --trust-vrt allows it"));
        }
        let (path, driver) = (Path::new(name), dataset.driver().short_name());
        if path.is_file() && LABELS.contains(&driver.as_str()) {
            let mut label = head(path, LABEL_BYTES);
            // There may be samples after the label's text.
            let is_text = |byte: &u8| *byte >= b' ' || byte.is_ascii_whitespace();
            label.truncate(label.iter().position(|byte| !is_text(byte)).unwrap_or(label.len()));
            let leaving = ["../", "..\\", "/vsi", "\"/", "'/", "=/", "= /", ">/"];
            if leaving.iter().any(|sign| has(&label, sign)) {
                return Err(format!(
                    "is a label ({driver}) that names files beyond its folder: move them into it, or allow it with \
                     --trust-vrt"
                ));
            }
        }
        Ok(())
    }

    /// For a program that makes a single world: removes all drivers from GDAL that none of its
    /// names asks for, so that nested files (an overview, a source of a source) cannot refer to
    /// others.
    pub fn restrict_process<'a>(self, names: impl IntoIterator<Item = &'a PathBuf>) {
        if self.trusts_links {
            return;
        }
        let asked: Vec<&str> = names.into_iter().filter_map(|name| asked_for(&name.to_string_lossy())).collect();
        for (driver, _) in LEADING.iter().filter(|(driver, _)| !asked.contains(driver)) {
            // A driver that this GDAL does not have need not be removed.
            if let Ok(driver) = DriverManager::get_driver_by_name(driver) {
                DriverManager::deregister_driver(&driver);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_ask_for_drivers() {
        assert_eq!(asked_for("a/b.VRT"), Some("VRT"));
        assert_eq!(asked_for("WMTS:https://example.org/x,layer=y"), Some("WMTS"));
        assert_eq!(asked_for("<GDAL_WMS><Service/></GDAL_WMS>"), Some("WMS"));
        assert_eq!(asked_for("PG:dbname=x"), Some("PostGISRaster"));
        assert_eq!(asked_for("GTI:tiles.gpkg"), None);
        assert!(names_a_list("GTI:tiles.gpkg") && names_a_list("DERIVED_SUBDATASET:LOGAMPLITUDE:a.tif"));
        assert!(!names_a_list("WMTS:https://example.org") && !names_a_list("GTIFF_DIR:1:a.tif"));
        assert_eq!(asked_for("NETCDF:\"a.nc\":Band1"), None);
        assert_eq!(asked_for("dem.tif"), None);
    }

    #[test]
    fn every_driver_that_leads_elsewhere_is_left_out() {
        let drivers = Access::default().drivers("dem.tif").unwrap();
        assert!(drivers.iter().any(|d| d == "GTiff"));
        assert!(!drivers.iter().any(|d| is_leading(d)));
        assert!(Access::default().drivers("dem.vrt").unwrap().iter().any(|d| d == "VRT"));
        assert_eq!(Access { trusts_links: true }.drivers("dem.tif"), None);
    }
}
