//! The text of a path file: read, unpacked and decoded, never more of it than a path may have.

use super::{MAX_JSON_BYTES, MAX_XML_BYTES, PathError, text, zip};
use flate2::read::MultiGzDecoder;
use std::fs::{File, FileType, OpenOptions};
use std::io::{Read, Seek, SeekFrom};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

/// A path file's text.
#[derive(Debug)]
pub(super) struct Source {
    /// The file for messages: of an archive also the file in it.
    pub(super) path: PathBuf,
    pub(super) text: String,
    /// What to say about an archive with several path files.
    pub(super) note: Option<String>,
}

/// Reads a path file, a KMZ or a gzip file too.
pub(super) fn read(path: &Path) -> Result<Source, PathError> {
    let fail = |source| PathError::Read { path: path.to_owned(), source };
    // Opening a pipe without a writer would block for ever.
    let nonblocking = rustix::fs::OFlags::NONBLOCK.bits() as i32;
    let mut file = OpenOptions::new().read(true).custom_flags(nonblocking).open(path).map_err(fail)?;
    let found = file.metadata().map_err(fail)?;
    if !found.is_file() {
        return Err(PathError::NotAFile { path: path.to_owned(), kind: kind(found.file_type()) });
    }
    let mut first = Vec::new();
    Read::by_ref(&mut file).take(4).read_to_end(&mut first).map_err(fail)?;
    file.seek(SeekFrom::Start(0)).map_err(fail)?;
    let mut note = None;
    let (path, bytes) = match first.as_slice() {
        b"PK\x03\x04" | b"PK\x05\x06" | b"PK\x07\x08" => unpack(path, &mut file, found.len(), &mut note)?,
        [0x1f, 0x8b, ..] => (path.to_owned(), limited(path, MultiGzDecoder::new(file), MAX_XML_BYTES)?),
        _ => {
            // A size that is known needs no reading.
            if found.len() > MAX_JSON_BYTES {
                return Err(PathError::TooLarge { path: path.to_owned(), limit: MAX_JSON_BYTES });
            }
            (path.to_owned(), limited(path, file, MAX_JSON_BYTES)?)
        }
    };
    let unknown = |found| PathError::UnknownFormat { path: path.clone(), found };
    if bytes.get(8..12) == Some(b".FIT") {
        return Err(unknown(
            "a FIT recording; gpsbabel -i garmin_fit -f FILE -o gpx -F FILE.gpx makes a GPX of it".into(),
        ));
    }
    let text = text::decode(bytes).map_err(unknown)?;
    Ok(Source { path, text, note })
}

fn kind(found: FileType) -> &'static str {
    if found.is_dir() {
        "a folder"
    } else if found.is_fifo() {
        "a pipe"
    } else if found.is_socket() {
        "a socket"
    } else {
        "a device"
    }
}

fn limited(path: &Path, from: impl Read, limit: u64) -> Result<Vec<u8>, PathError> {
    let mut bytes = Vec::new();
    let read = from.take(limit + 1).read_to_end(&mut bytes);
    read.map_err(|source| PathError::Read { path: path.to_owned(), source })?;
    if bytes.len() as u64 > limit {
        return Err(PathError::TooLarge { path: path.to_owned(), limit });
    }
    Ok(bytes)
}

/// The file of an archive that is flown: doc.kml, as Google Earth has it, else the first .kml, else
/// the first .gpx.
fn unpack(path: &Path, file: &mut File, len: u64, note: &mut Option<String>) -> Result<(PathBuf, Vec<u8>), PathError> {
    let fail = |path: &Path, error| match error {
        zip::ZipError::TooLarge => PathError::TooLarge { path: path.to_owned(), limit: MAX_XML_BYTES },
        zip::ZipError::Unusable { why } => PathError::Archive { path: path.to_owned(), reason: why },
    };
    let has_end = |name: &str, end: &str| name.to_ascii_lowercase().ends_with(end);
    // What macOS adds to every archive.
    let is_wanted = |name: &str| (has_end(name, ".kml") || has_end(name, ".gpx")) && !name.starts_with("__MACOSX/");
    let entries = zip::entries(file, len, is_wanted).map_err(|error| fail(path, error))?;
    let main = entries
        .iter()
        .find(|entry| entry.name.eq_ignore_ascii_case("doc.kml"))
        .or_else(|| entries.iter().find(|entry| has_end(&entry.name, ".kml")))
        .or_else(|| entries.first());
    let Some(main) = main else {
        let reason = "it has no .kml file (nor a .gpx) in it: expected a KMZ as Google Earth saves it";
        return Err(PathError::Archive { path: path.to_owned(), reason: reason.into() });
    };
    // The name comes from outside and goes to a terminal.
    let name: String = main.name.chars().map(|c| if c.is_control() { '?' } else { c }).take(80).collect();
    let name = name.trim_start_matches('/');
    let shown = path.join(name);
    if entries.len() > 1 {
        *note = Some(format!("the archive has {} files of paths in it: {name} is read, no other", entries.len()));
    }
    let bytes = zip::read_entry(file, main, MAX_XML_BYTES).map_err(|error| fail(&shown, error))?;
    Ok((shown, bytes))
}

#[cfg(test)]
mod tests {
    use super::super::zip::tests::archive;
    use super::*;
    use flate2::Compression;
    use flate2::write::GzEncoder;
    use std::io::Write;

    fn scratch(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("tv-path-file-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        folder
    }

    #[test]
    fn what_is_no_file_is_named_and_never_waited_for() {
        let folder = scratch("kinds");
        let pipe = folder.join("pipe");
        rustix::fs::mknodat(
            rustix::fs::CWD,
            &pipe,
            rustix::fs::FileType::Fifo,
            rustix::fs::Mode::from_raw_mode(0o600),
            0,
        )
        .unwrap();
        for (path, expected) in [
            (folder.clone(), "is a folder"),
            (pipe, "is a pipe"),
            ("/dev/zero".into(), "is a device"),
            ("/dev/null".into(), "is a device"),
            (folder.join("none"), "No such file"),
        ] {
            let message = read(&path).unwrap_err().to_string();
            assert!(message.contains(expected) && !message.contains('\n'), "{message}");
        }
        let large = folder.join("large");
        File::create(&large).unwrap().set_len(MAX_JSON_BYTES + 1).unwrap();
        assert!(read(&large).unwrap_err().to_string().contains("more than 256 MiB"));
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn the_main_file_of_an_archive_is_read() {
        let folder = scratch("kmz");
        let path = folder.join("a.kmz");
        for (files, name) in [
            (&[("x.kml", "no"), ("files/y.png", "no"), ("DOC.KML", "yes")][..], "DOC.KML"),
            (&[("__MACOSX/._a.kml", "no"), ("t.gpx", "no"), ("sub/a.kml", "yes"), ("b.kml", "no")], "sub/a.kml"),
            (&[("t.gpx", "yes")], "t.gpx"),
        ] {
            let files: Vec<(&str, &[u8])> = files.iter().map(|(name, text)| (*name, text.as_bytes())).collect();
            std::fs::write(&path, archive(&files)).unwrap();
            let source = read(&path).unwrap();
            assert_eq!((source.text.as_str(), source.path), ("yes", path.join(name)));
            let others = name != "t.gpx";
            assert_eq!(source.note.is_some_and(|note| note.contains(&format!("{name} is read"))), others);
        }
        std::fs::write(&path, archive(&[("a.txt", b"")])).unwrap();
        assert!(read(&path).unwrap_err().to_string().contains("has no .kml file"));
        std::fs::write(&path, &archive(&[("a.kml", b"x")])[..30]).unwrap();
        assert!(read(&path).unwrap_err().to_string().contains("damaged or cut short"));
        let mut gzip = GzEncoder::new(Vec::new(), Compression::default());
        gzip.write_all(b"<gpx/>").unwrap();
        std::fs::write(&path, gzip.finish().unwrap()).unwrap();
        assert_eq!(read(&path).unwrap().text, "<gpx/>");
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn bombs_are_refused_in_a_sentence() {
        let folder = scratch("bomb");
        let path = folder.join("a.kml.gz");
        let mut gzip = GzEncoder::new(File::create(&path).unwrap(), Compression::fast());
        let block = vec![b' '; 1 << 20];
        for _ in 0..=(MAX_XML_BYTES >> 20) {
            gzip.write_all(&block).unwrap();
        }
        gzip.finish().unwrap();
        assert!(read(&path).unwrap_err().to_string().contains("more than 128 MiB"));
        std::fs::remove_dir_all(folder).unwrap();
    }
}
