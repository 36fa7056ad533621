//! Mirrors the index of a remote database into a local folder, because the generator needs all of
//! it.

use crate::error::{Cause, FetchError, StoreError};
use crate::location::Location;
use crate::network::{Network, Request};
use crate::retry::{Allowance, INDEX_READS, OPEN_RETRIES};
use bytes::Bytes;
use futures_util::{StreamExt, stream};
use ring::digest::{SHA256, digest};
use std::fs::{self, File};
use std::io::{self, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use terravision_common::database::{
    Index, MANIFEST_FILE, MOST_MANIFEST_BYTES, Manifest, ManifestError, NODES_FILE, NodeRanges, RangesError,
};
use terravision_common::files::{private_folder, read_bounded, temporary_folder};

/// The file of height ranges is read in pieces of this size, a few at a time.
const PART_BYTES: u64 = 1 << 20;
const PARTS_AT_ONCE: usize = 4;

/// Called with the number of bytes of the index that have been read, and with their total.
pub type OnProgress<'a> = &'a mut dyn FnMut(u64, u64);

/// A manifest, as text and parsed.
pub(crate) struct OpenManifest {
    pub(crate) text: Bytes,
    pub(crate) manifest: Manifest,
}

/// A folder that is removed when this value is dropped.
#[derive(Debug)]
pub(crate) struct TemporaryFolder(PathBuf);

impl Drop for TemporaryFolder {
    fn drop(&mut self) {
        // If it cannot be removed, the system will clean it up with its other temporary files.
        drop(fs::remove_dir_all(&self.0));
    }
}

/// Length of a name in the cache.
const NAME_BYTES: u64 = 32;

/// Whether a text has the form of a name made by [`name_of`].
pub(crate) fn is_name(text: &str) -> bool {
    text.len() as u64 == NAME_BYTES && text.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'))
}

/// A name for something in the cache.
fn name_of(parts: &[&[u8]]) -> String {
    let digest = digest(&SHA256, &parts.join(&0));
    digest.as_ref()[..16].iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The name of a database in the cache: a hash of its location and its manifest (which contains the
/// checksums of the rest).
pub(crate) fn database_name(location: &Location, manifest: &[u8]) -> String {
    name_of(&[location.to_string().as_bytes(), manifest])
}

fn location_file(cache: &Path, location: &Location) -> PathBuf {
    cache.join("locations").join(name_of(&[location.to_string().as_bytes()]))
}

fn index_folder(cache: &Path, database: &str) -> PathBuf {
    cache.join("index").join(database)
}

/// Parses the text of a manifest.
pub(crate) fn parse(text: Bytes, location: &Location) -> Result<OpenManifest, StoreError> {
    if text.trim_ascii_start().starts_with(b"<") {
        return Err(StoreError::WebPage { location: location.to_string() });
    }
    // Invalid Unicode is invalid JSON too: the parser reports it.
    let manifest = Manifest::parse(&String::from_utf8_lossy(&text))
        .map_err(|source| StoreError::Manifest { source, location: location.to_string() })?;
    Ok(OpenManifest { text, manifest })
}

/// Reads the manifest from the server.
pub(crate) async fn read_manifest(network: &Network, location: &Location) -> Result<OpenManifest, StoreError> {
    let request = Request {
        file: MANIFEST_FILE,
        range: None,
        most_bytes: MOST_MANIFEST_BYTES,
        allowance: Allowance { retries: OPEN_RETRIES, is_vital: true, may_be_hasty: false },
    };
    let mut damages = 0;
    loop {
        let parsed = match network.read(&request, |answer| async move { Ok(answer.bytes) }).await {
            Ok(text) => parse(text, location),
            Err(FetchError::Failed { fault }) if fault.cause == Cause::NotFound => {
                return Err(StoreError::NotADatabase { why: fault.why.clone(), location: location.to_string() });
            }
            Err(error) => return Err(error.into()),
        };
        // A manifest that was damaged in transit may arrive undamaged the next time.
        let is_damaged =
            |source: &ManifestError| matches!(source, ManifestError::Checksum { .. } | ManifestError::Content { .. });
        let is_repeated = match &parsed {
            Err(StoreError::Manifest { source, .. }) if is_damaged(source) => {
                network.policy().again_after_damage(damages, INDEX_READS - 1).await
            }
            _ => false,
        };
        if !is_repeated {
            return parsed;
        }
        damages += 1;
    }
}

/// Reads the last known manifest of this location from the cache.
pub(crate) fn cached_manifest(cache: &Path, location: &Location) -> Result<OpenManifest, StoreError> {
    let name = cached_name(cache, location);
    let text = name.map(|name| read_bounded(&index_folder(cache, &name).join(MANIFEST_FILE), MOST_MANIFEST_BYTES));
    match text {
        Some(Ok(text)) => parse(text.into(), location),
        _ => {
            let why = "nothing of it is in the disk cache, and --offline asks no server";
            Err(FetchError::failed(Cause::Offline, why, location.to_string()).into())
        }
    }
}

/// Name of the database that was last at a location, from a file in the cache. Anything but a valid
/// name is ignored.
fn cached_name(cache: &Path, location: &Location) -> Option<String> {
    let name = read_bounded(&location_file(cache, location), 2 * NAME_BYTES).ok()?;
    String::from_utf8(name).ok().map(|name| name.trim().to_owned()).filter(|name| is_name(name))
}

/// A folder with the index: the one in the cache, filled if necessary.
pub(crate) struct Mirror {
    pub(crate) index: Index,
    /// The folder of the index, when the cache cannot be written.
    pub(crate) temporary: Option<TemporaryFolder>,
    /// Bytes that were added to the cache.
    pub(crate) added: Vec<u64>,
}

/// Finds the index in the cache, or reads it from the server into the cache. Without a cache, or if
/// it cannot be written, uses a temporary folder; `note` then gets the reason.
pub(crate) async fn mirror(
    open: &OpenManifest,
    location: &Location,
    cache: Option<&Path>,
    network: Option<&Network>,
    on_progress: OnProgress<'_>,
    note: impl Fn(&io::Error),
) -> Result<Mirror, StoreError> {
    let cached = cache.map(|cache| (cache, index_folder(cache, &database_name(location, &open.text))));
    if let Some((cache, folder)) = &cached
        && let Some(index) = whole_index(folder, &open.text)
    {
        touch(folder);
        remember_location(cache, location, &open.text).unwrap_or_else(|error| note(&error));
        return Ok(Mirror { index, temporary: None, added: Vec::new() });
    }
    let Some(network) = network else {
        let why = "its index is not in the disk cache, and --offline asks no server";
        return Err(FetchError::failed(Cause::Offline, why, location.to_string()).into());
    };
    let bytes = checked_nodes(network, open)?;
    if let Some((cache, folder)) = &cached {
        let filled = fill(network, open, bytes, folder, &mut *on_progress).await;
        match filled.and_then(|()| Ok(remember_location(cache, location, &open.text)?)) {
            Ok(()) => {
                let index = Index::open(folder)?;
                return Ok(Mirror { index, temporary: None, added: vec![open.text.len() as u64, bytes] });
            }
            Err(Unfilled::Disk(error)) => note(&error),
            Err(Unfilled::Network(error)) => return Err(error.into()),
        }
    }
    let failed = |path: PathBuf| move |source| StoreError::Mirror { source, path };
    let path = temporary_folder("terravision-index").map_err(failed(std::env::temp_dir()))?;
    let temporary = TemporaryFolder(path.clone());
    match fill(network, open, bytes, &path, on_progress).await {
        Ok(()) => Ok(Mirror { index: Index::open(&path)?, temporary: Some(temporary), added: Vec::new() }),
        Err(Unfilled::Disk(source)) => Err(failed(path)(source)),
        Err(Unfilled::Network(error)) => Err(error.into()),
    }
}

/// Why an index could not be written to a folder.
enum Unfilled {
    Disk(io::Error),
    Network(FetchError),
}

impl From<io::Error> for Unfilled {
    fn from(error: io::Error) -> Self {
        Self::Disk(error)
    }
}

/// Reads the index into a folder, the manifest last: a folder with a manifest is complete.
async fn fill(
    network: &Network,
    open: &OpenManifest,
    bytes: u64,
    folder: &Path,
    on_progress: OnProgress<'_>,
) -> Result<(), Unfilled> {
    private_folder(folder)?;
    let mut nodes = NewFile::create(&folder.join(NODES_FILE))?;
    read_nodes(network, open, bytes, &mut nodes, on_progress).await?;
    nodes.finish()?;
    Ok(write_whole(&folder.join(MANIFEST_FILE), &open.text)?)
}

/// The index in a folder, if it is complete, undamaged, and belongs to this manifest.
fn whole_index(folder: &Path, manifest: &[u8]) -> Option<Index> {
    let text = read_bounded(&folder.join(MANIFEST_FILE), MOST_MANIFEST_BYTES).ok()?;
    (text == manifest).then(|| Index::open(folder).ok()).flatten()
}

/// Marks an index as used now, so that a sweep does not remove it next.
fn touch(folder: &Path) {
    for name in [MANIFEST_FILE, NODES_FILE] {
        let times = fs::FileTimes::new().set_modified(std::time::SystemTime::now());
        // In a read-only cache nothing has to be marked.
        File::open(folder.join(name)).and_then(|file| file.set_times(times)).unwrap_or_default();
    }
}

fn remember_location(cache: &Path, location: &Location, manifest: &[u8]) -> io::Result<()> {
    let path = location_file(cache, location);
    let name = database_name(location, manifest);
    if cached_name(cache, location).is_some_and(|found| found == name) {
        return Ok(());
    }
    private_folder(path.parent().unwrap_or(cache))?;
    write_whole(&path, name.as_bytes())
}

/// Size of the file of height ranges, if the manifest's number is what the world needs, and within
/// the bound. Checked before anything is read or allocated.
fn checked_nodes(network: &Network, open: &OpenManifest) -> Result<u64, FetchError> {
    NodeRanges::checked_bytes(open.manifest.world(), &open.manifest.fields().nodes, open.manifest.is_sparse()).map_err(
        |error| {
            let why = match error {
                RangesError::Length { expected, found } => {
                    format!("the manifest says that it has {found} bytes, and its world needs {expected}")
                }
                error => error.to_string(),
            };
            FetchError::failed(Cause::Changed, why, network.transport().place(NODES_FILE))
        },
    )
}

/// Reads the height ranges into a file, a few pieces at a time: memory use does not depend on their
/// length.
async fn read_nodes(
    network: &Network,
    open: &OpenManifest,
    expected: u64,
    file: &mut NewFile,
    on_progress: OnProgress<'_>,
) -> Result<(), Unfilled> {
    let failed =
        |cause, why: String| Unfilled::Network(FetchError::failed(cause, why, network.transport().place(NODES_FILE)));
    let crc32 = open.manifest.fields().nodes.crc32;
    let mut damages = 0;
    loop {
        file.restart()?;
        let (mut hasher, mut done) = (crc32fast::Hasher::new(), 0);
        let starts = (0..expected).step_by(PART_BYTES as usize);
        let parts = starts.map(|start| {
            let range = start..(start + PART_BYTES).min(expected);
            let most_bytes = range.end - range.start;
            let retries = network.policy().most_retries();
            let allowance = Allowance { retries, is_vital: true, may_be_hasty: false };
            let request = Request { file: NODES_FILE, range: Some(range), most_bytes, allowance };
            async move { network.read(&request, |answer| async move { Ok(answer) }).await }
        });
        let mut parts = stream::iter(parts).buffered(PARTS_AT_ONCE);
        on_progress(0, expected);
        while let Some(part) = parts.next().await {
            let part = part.map_err(Unfilled::Network)?;
            if part.file_bytes != expected {
                return Err(failed(Cause::Changed, format!("it has {} bytes, expected {expected}", part.file_bytes)));
            }
            hasher.update(&part.bytes);
            file.write(&part.bytes)?;
            done += part.bytes.len() as u64;
            on_progress(done, expected);
        }
        let found = hasher.finalize();
        if found == crc32 {
            return Ok(());
        }
        if !network.policy().again_after_damage(damages, INDEX_READS - 1).await {
            return Err(failed(Cause::Damaged, format!("its checksum is {found:08x}, expected {crc32:08x}")));
        }
        damages += 1;
    }
}

/// A file that appears complete, or not at all.
struct NewFile {
    file: File,
    temporary: PathBuf,
    path: PathBuf,
}

impl NewFile {
    fn create(path: &Path) -> io::Result<Self> {
        let temporary = path.with_extension(unique());
        // An existing name, including a link, is never reused.
        Ok(Self { file: File::create_new(&temporary)?, temporary, path: path.to_owned() })
    }

    /// Discards what was written.
    fn restart(&mut self) -> io::Result<()> {
        self.file.set_len(0)?;
        self.file.rewind()
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.file.write_all(bytes)
    }

    fn finish(self) -> io::Result<()> {
        // Synced: after a power failure there must not be a final name with half of the content.
        self.file.sync_all()?;
        fs::rename(&self.temporary, &self.path)
    }
}

impl Drop for NewFile {
    fn drop(&mut self) {
        // After the rename no file has the temporary name.
        drop(fs::remove_file(&self.temporary));
    }
}

fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = NewFile::create(path)?;
    file.write(bytes)?;
    file.finish()
}

fn unique() -> String {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    // Relaxed: numbers only have to differ.
    format!("new-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_in_the_cache_differ_with_place_and_content_but_not_with_secrets() {
        let at = |text: &str| Location::parse(text).expect("a location");
        let name = |text: &str, manifest: &[u8]| database_name(&at(text), manifest);
        assert_eq!(name("http://h/w?key=1", b"x"), name("http://h/w?key=2", b"x"));
        assert_ne!(name("http://h/w", b"x"), name("http://h/w", b"y"));
        assert_ne!(name("http://h/w", b"x"), name("http://g/w", b"x"));
        assert_ne!(name("http://h/w", b"x"), name("http://h/wx", b""));
        assert_eq!(name("s3://b/w", b"x").len(), 32);
    }

    #[test]
    fn a_web_page_is_told_from_a_damaged_manifest() {
        let at = Location::parse("http://h/w").expect("a location");
        let said = |text: &'static str| parse(Bytes::from(text), &at).err().expect("no manifest").to_string();
        assert!(said("\n <!DOCTYPE html>").contains("web page"));
        assert!(said("{\"format\": 1}").contains("not the manifest"));
        assert!(said("\u{fffd}").contains("right content"));
    }
}
