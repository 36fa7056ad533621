//! Finds the rasters for the names on the command line: files, folders, archives, addresses, and
//! all other names of GDAL.

use super::access::{Access, leads_elsewhere, names_a_list};
use super::raster::Assumed;
use super::{Note, Raster};
use crate::error::{IngestError, gdal_message};
use gdal::{Dataset, Metadata};
use std::path::{Path, PathBuf};

/// Endings of files in archives and folders that are not rasters of the ground, although GDAL could
/// open some of them.
const BESIDE: [&str; 22] = [
    "txt", "csv", "md", "htm", "html", "pdf", "xml", "json", "kml", "kmz", "prj", "tfw", "tfwx", "wld", "jgw", "pgw",
    "hdr", "ovr", "msk", "aux", "shp", "vrt",
];
/// Endings of archives and how GDAL reads them; the longest first.
const ARCHIVES: [(&str, &str); 7] = [
    (".tar.gz", "/vsitar/"),
    (".tgz", "/vsitar/"),
    (".tar", "/vsitar/"),
    (".zip", "/vsizip/"),
    (".gz", "/vsigzip/"),
    (".7z", "/vsi7z/"),
    (".rar", "/vsirar/"),
];
/// Addresses and how GDAL reads them.
const SCHEMES: [(&str, &str); 7] = [
    ("https://", "/vsicurl/https://"),
    ("http://", "/vsicurl/http://"),
    ("ftp://", "/vsicurl/ftp://"),
    ("s3://", "/vsis3/"),
    ("gs://", "/vsigs/"),
    ("az://", "/vsiaz/"),
    ("file://", ""),
];
/// Maximum number of members of archives and folders.
const MAX_MEMBERS: usize = 20_000;
/// Names that a message lists.
const LISTED: usize = 12;

/// A dataset that was found under a name.
pub(super) struct Found {
    /// For messages and the manifest: no passwords, no tokens.
    pub(super) shown: PathBuf,
    /// As GDAL opens it.
    pub(super) name: String,
    pub(super) dataset: Dataset,
}

/// Opens the rasters of all names.
///
/// # Errors
/// [`IngestError::Source`] for the first that cannot be used.
pub fn describe_all(
    paths: &[PathBuf],
    assumed: Assumed<'_>,
    access: Access,
    note: &mut dyn FnMut(Note),
) -> Result<Vec<Raster>, IngestError> {
    let mut all = Vec::new();
    for path in paths {
        all.extend(Inputs { assumed, access }.of(path, note)?);
    }
    if let Some(raster) = all.iter().find(|raster| raster.is_assumed_whole()) {
        note(Note::Info(format!(
            "{} says nothing of its place, and is twice as wide as high: it is taken to cover longitudes -180 to 180 and \
             latitudes -90 to 90",
            raster.path().display()
        )));
    }
    Ok(all)
}

struct Inputs<'a> {
    assumed: Assumed<'a>,
    access: Access,
}

impl Inputs<'_> {
    fn of(&self, path: &Path, note: &mut dyn FnMut(Note)) -> Result<Vec<Raster>, IngestError> {
        let typed = path.to_string_lossy().into_owned();
        let (name, shown) = (address(&typed), PathBuf::from(without_secrets(&typed)));
        let local = Path::new(&name);
        let is_local = local.exists();
        if let Some(reason) = is_local.then(|| not_readable(local)).flatten() {
            return Err(IngestError::source(shown, reason));
        }
        // GDAL decides what is a valid name; whether the file exists only matters for the message.
        let failed = match self.open(&name, &shown) {
            Ok(found) => return self.single(found, note).map(|raster| vec![raster]),
            Err(error) => error,
        };
        if is_local && local.is_dir() {
            return self.members(path, &folder_members(local, &shown)?, note);
        }
        if let Some((_, prefix)) = ARCHIVES.iter().find(|(ending, _)| name.to_ascii_lowercase().ends_with(ending)) {
            return self.archive(&name, prefix, &shown, note);
        }
        let failed = failed.without(&name, &shown).without(&typed, &shown);
        let is_a_name = name.contains(':') || name.starts_with("/vsi") || name.trim_start().starts_with('<');
        match failed {
            Failed::Refused { why } => Err(IngestError::source(shown, why)),
            Failed::Unknown { .. } if names_a_list(&name) => {
                Err(IngestError::source(shown, "is a list of other files; --trust-vrt opens it"))
            }
            Failed::Unknown { .. } if !is_local && !is_a_name => Err(IngestError::source(shown, "does not exist")),
            Failed::Unknown { why: reason } if name.starts_with("/vsicurl/") => Err(IngestError::source(
                shown,
                format!("cannot be read from its server as a raster: {reason} (downloading it first may help)"),
            )),
            Failed::Unknown { why: reason } => match leads_elsewhere(local).filter(|_| is_local) {
                Some(what) => Err(IngestError::source(
                    shown,
                    format!("is {what}, though its name does not say so; --trust-vrt opens it nevertheless"),
                )),
                None => Err(IngestError::source(shown, format!("is not a raster that GDAL can read: {reason}"))),
            },
        }
    }

    fn open(&self, name: &str, shown: &Path) -> Result<Found, Failed> {
        self.access.check_before(name).map_err(|why| Failed::Refused { why })?;
        let dataset = self.access.open(name, None).map_err(|e| Failed::Unknown { why: gdal_message(&e) })?;
        self.access.check_after(name, &dataset).map_err(|why| Failed::Refused { why })?;
        Ok(Found { shown: shown.to_owned(), name: name.to_owned(), dataset })
    }

    /// A raster, or the only raster of a file of several data sets.
    fn single(&self, found: Found, note: &mut dyn FnMut(Note)) -> Result<Raster, IngestError> {
        if found.dataset.raster_count() > 0 {
            return Raster::of(&found, self.assumed);
        }
        let names = subdatasets(&found.dataset);
        match names.as_slice() {
            [] => Err(IngestError::source(found.shown, "has no raster bands")),
            [one] => {
                let only = self.open(one, Path::new(one));
                let only = only.map_err(|failed| IngestError::source(one, failed.reason()))?;
                note(Note::Info(format!("{}: its only data set, {one}, is taken", found.shown.display())));
                Raster::of(&only, self.assumed)
            }
            _ => Err(IngestError::source(
                found.shown,
                format!("holds {} data sets: name one of them, {}", names.len(), list(&names)),
            )),
        }
    }

    fn archive(
        &self,
        name: &str,
        prefix: &str,
        shown: &Path,
        note: &mut dyn FnMut(Note),
    ) -> Result<Vec<Raster>, IngestError> {
        let place = match name.starts_with("/vsi") {
            true => name.to_owned(),
            false => std::path::absolute(name).unwrap_or_else(|_| name.into()).display().to_string(),
        };
        let inside = format!("{prefix}{place}");
        // GDAL opens an archive of one file by the archive's name.
        if let Ok(found) = self.open(&inside, shown) {
            return self.single(found, note).map(|raster| vec![raster]);
        }
        let unreadable = |reason: String| {
            IngestError::source(
                shown,
                format!("is neither a raster that GDAL can read nor an archive of rasters: {reason}"),
            )
        };
        let members = gdal::vsi::read_dir(&inside, true).map_err(|e| unreadable(gdal_message(&e)))?;
        let named = |member: &Path| (format!("{inside}/{}", member.display()), in_archive(prefix, shown, member));
        let members: Vec<_> = members.iter().filter(|m| is_plain(m)).map(|m| named(m)).collect();
        self.members(shown, &members, note)
    }

    /// The rasters among the members of a folder or an archive, which have to be parts of one
    /// layer.
    fn members(
        &self,
        whole: &Path,
        members: &[(String, PathBuf)],
        note: &mut dyn FnMut(Note),
    ) -> Result<Vec<Raster>, IngestError> {
        if members.len() > MAX_MEMBERS {
            let reason = format!("has {} files in it, expected at most {MAX_MEMBERS}", members.len());
            return Err(IngestError::source(whole, reason));
        }
        let (mut rasters, mut first_error, mut left_out) = (Vec::new(), None, 0);
        for (name, shown) in members.iter().filter(|(name, _)| !is_beside(name)) {
            let raster = match self.open(name, shown) {
                Ok(found) if found.dataset.raster_count() > 0 => Raster::of(&found, self.assumed),
                Ok(_) => Err(IngestError::source(shown, "holds several data sets or none")),
                Err(failed) => Err(IngestError::source(shown, failed.reason())),
            };
            match raster {
                Ok(raster) => rasters.push(raster),
                Err(error) => {
                    left_out += 1;
                    first_error.get_or_insert(error);
                }
            }
        }
        match (rasters.is_empty(), first_error) {
            (true, Some(error)) => return Err(error),
            (true, None) => return Err(IngestError::source(whole, "has no raster in it that GDAL can read")),
            _ => {}
        }
        check_one_layer(whole, &rasters)?;
        let others = match left_out {
            0 => String::new(),
            count => format!("; {count} other files are left out"),
        };
        let names: Vec<String> = rasters.iter().map(Raster::file_name).collect();
        note(Note::Info(format!("{}: {} is taken{others}", whole.display(), list(&names))));
        Ok(rasters)
    }
}

enum Failed {
    /// It was refused before GDAL opened it, or for what it leads to.
    Refused {
        /// What, in words.
        why: String,
    },
    /// GDAL cannot open it.
    Unknown {
        /// What GDAL says.
        why: String,
    },
}

impl Failed {
    /// Removes what a message must not show: the name as typed may contain a password.
    fn without(self, name: &str, shown: &Path) -> Self {
        let cleaned = |reason: String| reason.replace(name, &shown.to_string_lossy());
        match self {
            Self::Refused { why } => Self::Refused { why: cleaned(why) },
            Self::Unknown { why } => Self::Unknown { why: cleaned(why) },
        }
    }

    fn reason(self) -> String {
        match self {
            Self::Refused { why } => why,
            Self::Unknown { why } => format!("is not a raster that GDAL can read: {why}"),
        }
    }
}

/// Rasters of one folder or archive are tiles of one layer: one CRS, and no two at the same place
/// (which would be a picture beside its elevation, or a mask).
fn check_one_layer(whole: &Path, rasters: &[Raster]) -> Result<(), IngestError> {
    let names = || list(&rasters.iter().map(|r| r.path().display().to_string()).collect::<Vec<_>>());
    if rasters.iter().any(|r| r.wkt() != rasters[0].wkt()) {
        let reason =
            format!("has rasters of several coordinate reference systems in it: name those to use, {}", names());
        return Err(IngestError::source(whole, reason));
    }
    let mut places: Vec<[i64; 4]> = rasters.iter().map(place).collect();
    places.sort_unstable();
    if places.windows(2).any(|pair| pair[0] == pair[1]) {
        let reason = format!("has several rasters of the same place in it: name the one to use, {}", names());
        return Err(IngestError::source(whole, reason));
    }
    Ok(())
}

/// Two opposite corners, to about a thousandth of the raster's size.
fn place(raster: &Raster) -> [i64; 4] {
    let [w, h] = raster.size().map(|v| v as f64);
    let (a, b) = (raster.affine().apply(0.0, 0.0), raster.affine().apply(w, h));
    let unit = [(b[0] - a[0]).abs(), (b[1] - a[1]).abs()].map(|v| (v / 100.0).max(f64::MIN_POSITIVE));
    let low = [a[0].min(b[0]), a[1].min(b[1])];
    [low[0] / unit[0], low[1] / unit[1], unit[0].log2() * 20.0, unit[1].log2() * 20.0].map(|v| v.round() as i64)
}

/// What GDAL calls an address.
fn address(typed: &str) -> String {
    let lower = typed.to_ascii_lowercase();
    match SCHEMES.iter().find(|(scheme, _)| lower.starts_with(scheme)) {
        Some((scheme, prefix)) => format!("{prefix}{}", &typed[scheme.len()..]),
        None => typed.to_owned(),
    }
}

/// An address without user, password and query (which may have a token).
fn without_secrets(typed: &str) -> String {
    let Some((scheme, rest)) = typed.split_once("://") else { return typed.to_owned() };
    let rest = rest.split(['?', '#']).next().unwrap_or_default();
    let (host, path) = rest.split_once('/').map_or((rest, None), |(host, path)| (host, Some(path)));
    let host = host.rsplit('@').next().unwrap_or_default();
    format!("{scheme}://{host}{}", path.map_or(String::new(), |path| format!("/{path}")))
}

/// Why a local file is not passed to GDAL.
fn not_readable(path: &Path) -> Option<String> {
    let metadata = match path.metadata() {
        Ok(metadata) => metadata,
        Err(error) => return Some(format!("cannot be read: {error}")),
    };
    if metadata.is_file() && metadata.len() == 0 {
        return Some("is empty (0 bytes)".to_owned());
    }
    // Opening a pipe would wait for ever.
    (!metadata.is_file() && !metadata.is_dir()).then(|| "is a device or a pipe, expected a file or a folder".to_owned())
}

fn folder_members(folder: &Path, shown: &Path) -> Result<Vec<(String, PathBuf)>, IngestError> {
    let fail = |e: std::io::Error| IngestError::source(shown, format!("is a folder that cannot be read: {e}"));
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(fail)? {
        let entry = entry.map_err(fail)?;
        let path = entry.path();
        if path.metadata().is_ok_and(|m| m.is_file() && m.len() > 0) && is_plain(Path::new(&entry.file_name())) {
            names.push((path.to_string_lossy().into_owned(), shown.join(entry.file_name())));
        }
    }
    names.sort();
    Ok(names)
}

/// What an archive's member is called on the command line: as GDAL names it, against the folder of
/// the process.
fn in_archive(prefix: &str, shown: &Path, member: &Path) -> PathBuf {
    let outer = shown.to_string_lossy();
    let inner = if outer.contains("://") { address(&outer) } else { outer.into_owned() };
    PathBuf::from(format!("{prefix}{inner}/{}", member.display()))
}

/// Whether it is not hidden, and does not leave its archive.
fn is_plain(member: &Path) -> bool {
    let text = member.to_string_lossy();
    !text.ends_with('/') && text.split('/').all(|part| !part.starts_with('.') && part != "__MACOSX")
}

fn is_beside(name: &str) -> bool {
    let ending = Path::new(name).extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    ending.is_none_or(|e| BESIDE.contains(&e.as_str()) || ARCHIVES.iter().any(|(a, _)| a[1..] == *e))
}

/// The names of a file's data sets, in the form that GDAL (and so this program) takes.
fn subdatasets(dataset: &Dataset) -> Vec<String> {
    let items = dataset.metadata_domain("SUBDATASETS").unwrap_or_default();
    let name = |item: &String| {
        let (key, value) = item.split_once('=')?;
        key.ends_with("_NAME").then(|| value.to_owned())
    };
    items.iter().filter_map(name).collect()
}

/// Names for display, quoted for a shell.
fn list(names: &[String]) -> String {
    let quoted = |name: &String| match name.contains(['"', ' ', '(', '&', ';', '$']) && !name.contains('\'') {
        true => format!("'{name}'"),
        false => name.clone(),
    };
    let mut shown: Vec<String> = names.iter().take(LISTED).map(quoted).collect();
    if names.len() > LISTED {
        shown.push(format!("… ({} in all)", names.len()));
    }
    shown.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_through_gdal_and_shown_without_secrets() {
        assert_eq!(address("https://example.org/dem.tif"), "/vsicurl/https://example.org/dem.tif");
        assert_eq!(address("s3://bucket/dem.tif"), "/vsis3/bucket/dem.tif");
        assert_eq!(address("C:/dem.tif"), "C:/dem.tif");
        assert_eq!(without_secrets("https://me:word@example.org/a/dem.tif?sig=x"), "https://example.org/a/dem.tif");
        assert_eq!(without_secrets("NETCDF:\"a.nc\":b"), "NETCDF:\"a.nc\":b");
    }

    #[test]
    fn hidden_members_and_those_that_leave_are_not_looked_at() {
        assert!(is_plain(Path::new("L32/N46E006.hgt")));
        assert!(!is_plain(Path::new("../../etc/passwd")) && !is_plain(Path::new("__MACOSX/._a.tif")));
        assert!(is_beside("readme.TXT") && is_beside("README") && !is_beside("a.tif"));
    }
}
