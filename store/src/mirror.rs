//! The index of a remote database, mirrored into a folder: the generator needs it whole, on this machine.

use crate::error::{Cause, FetchError, StoreError};
use crate::location::Location;
use crate::network::{Network, Request};
use bytes::Bytes;
use futures_util::{StreamExt, stream};
use ring::digest::{SHA256, digest};
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use terravision_common::database::{Index, MANIFEST_FILE, Manifest, ManifestError, NODES_FILE, NodeRanges};
use terravision_common::world::World;

/// No manifest is larger.
pub(crate) const MOST_MANIFEST_BYTES: u64 = 16 << 20;
/// The file of height ranges is read in pieces of this size, a few at a time.
const PART_BYTES: u64 = 1 << 20;
const PARTS_AT_ONCE: usize = 4;
/// How often the file is read anew when its checksum is wrong.
const TRIES: u32 = 4;
/// Requests after the first while a database is opened: somebody waits for the answer.
pub(crate) const OPEN_RETRIES: u32 = 3;

/// Called with the bytes of the index that have come, and with all that will.
pub type OnProgress<'a> = &'a mut dyn FnMut(u64, u64);

/// A manifest, as text and read.
pub(crate) struct OpenManifest {
    pub(crate) text: Bytes,
    pub(crate) manifest: Manifest,
    pub(crate) world: World,
}

/// A folder that goes away with this value.
#[derive(Debug)]
pub(crate) struct TemporaryFolder(PathBuf);

impl Drop for TemporaryFolder {
    fn drop(&mut self) {
        // What cannot be removed is left to the system, like all in the folder of temporary files.
        drop(fs::remove_dir_all(&self.0));
    }
}

/// A name for something in the cache.
fn name_of(parts: &[&[u8]]) -> String {
    let digest = digest(&SHA256, &parts.join(&0));
    digest.as_ref()[..16].iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The name of a database in the cache: where it is, and what its manifest says (which has the checksums of the rest).
pub(crate) fn database_name(location: &Location, manifest: &[u8]) -> String {
    name_of(&[location.to_string().as_bytes(), manifest])
}

fn location_file(cache: &Path, location: &Location) -> PathBuf {
    cache.join("locations").join(name_of(&[location.to_string().as_bytes()]))
}

fn index_folder(cache: &Path, database: &str) -> PathBuf {
    cache.join("index").join(database)
}

/// Reads a manifest's text.
pub(crate) fn parse(text: Bytes, location: &Location) -> Result<OpenManifest, StoreError> {
    if text.trim_ascii_start().starts_with(b"<") {
        return Err(StoreError::WebPage { location: location.to_string() });
    }
    // What is no Unicode is no JSON either: the parser says so.
    let manifest = Manifest::parse(&String::from_utf8_lossy(&text))
        .map_err(|source| StoreError::Manifest { source, location: location.to_string() })?;
    let world = manifest.geometry().map_err(|source| StoreError::World { source, location: location.to_string() })?;
    Ok(OpenManifest { text, manifest, world })
}

/// The manifest on the server.
pub(crate) async fn read_manifest(network: &Network, location: &Location) -> Result<OpenManifest, StoreError> {
    let request = Request {
        file: MANIFEST_FILE,
        range: None,
        most_bytes: MOST_MANIFEST_BYTES,
        retries: OPEN_RETRIES,
        is_vital: true,
    };
    let mut tried = 0;
    loop {
        tried += 1;
        let parsed = match network.read(&request, |answer| async move { Ok(answer.bytes) }).await {
            Ok(text) => parse(text, location),
            Err(FetchError::Failed(fault)) if fault.cause == Cause::NotFound => {
                return Err(StoreError::NotADatabase { why: fault.why.clone(), location: location.to_string() });
            }
            Err(error) => return Err(error.into()),
        };
        // A manifest that was damaged on its way is whole the next time.
        let is_damaged =
            |source: &ManifestError| matches!(source, ManifestError::Checksum { .. } | ManifestError::Content { .. });
        let is_repeated = match &parsed {
            Err(StoreError::Manifest { source, .. }) if is_damaged(source) && tried < TRIES => {
                network.again(tried - 1).await
            }
            _ => false,
        };
        if !is_repeated {
            return parsed;
        }
    }
}

/// The manifest that this location had last, from the cache.
pub(crate) fn cached_manifest(cache: &Path, location: &Location) -> Result<OpenManifest, StoreError> {
    let name = fs::read_to_string(location_file(cache, location)).unwrap_or_default();
    let text = fs::read(index_folder(cache, name.trim()).join(MANIFEST_FILE));
    match text {
        Ok(text) if !name.is_empty() => parse(text.into(), location),
        _ => {
            let why = "the disk cache has nothing of it, and offline nobody is asked";
            Err(FetchError::failed(Cause::Offline, why, location.to_string()).into())
        }
    }
}

/// A folder with the index: the one in the cache, filled if need be.
pub(crate) struct Mirror {
    pub(crate) index: Index,
    /// When the cache takes nothing, the index is here.
    pub(crate) temporary: Option<TemporaryFolder>,
    /// Bytes that were added to the cache.
    pub(crate) added: Vec<u64>,
}

/// Finds the index in the cache, or reads it from the server into the cache; where that cannot be written to, into a
/// folder that goes away again. `note` is told why.
pub(crate) async fn mirror(
    open: &OpenManifest,
    location: &Location,
    cache: &Path,
    network: Option<&Network>,
    on_progress: OnProgress<'_>,
    note: impl Fn(&io::Error),
) -> Result<Mirror, StoreError> {
    let folder = index_folder(cache, &database_name(location, &open.text));
    if let Some(index) = whole_index(&folder, &open.text) {
        touch(&folder);
        remember_location(cache, location, &open.text).unwrap_or_else(|error| note(&error));
        return Ok(Mirror { index, temporary: None, added: Vec::new() });
    }
    let Some(network) = network else {
        let why = "the disk cache has no whole index of it, and offline nobody is asked";
        return Err(FetchError::failed(Cause::Offline, why, location.to_string()).into());
    };
    let nodes = read_nodes(network, open, on_progress).await?;
    let written = write_index(&folder, &open.text, &nodes);
    match written.and_then(|()| remember_location(cache, location, &open.text)) {
        Ok(()) => {
            let index = Index::open(&folder)?;
            return Ok(Mirror { index, temporary: None, added: vec![open.text.len() as u64, nodes.len() as u64] });
        }
        Err(error) => note(&error),
    }
    let path = temporary_path();
    let temporary = TemporaryFolder(path.clone());
    write_index(&path, &open.text, &nodes).map_err(|source| StoreError::Mirror { source, path: path.clone() })?;
    Ok(Mirror { index: Index::open(&path)?, temporary: Some(temporary), added: Vec::new() })
}

/// The index in a folder, if it is all there, undamaged and of this manifest.
fn whole_index(folder: &Path, manifest: &[u8]) -> Option<Index> {
    let text = fs::read(folder.join(MANIFEST_FILE)).ok()?;
    (text == manifest).then(|| Index::open(folder).ok()).flatten()
}

/// Marks an index as used now, so that it is not the next to make room.
fn touch(folder: &Path) {
    for name in [MANIFEST_FILE, NODES_FILE] {
        let times = fs::FileTimes::new().set_modified(std::time::SystemTime::now());
        // A cache that is read only needs no marks.
        File::open(folder.join(name)).and_then(|file| file.set_times(times)).unwrap_or_default();
    }
}

fn remember_location(cache: &Path, location: &Location, manifest: &[u8]) -> io::Result<()> {
    let path = location_file(cache, location);
    let name = database_name(location, manifest);
    if fs::read_to_string(&path).is_ok_and(|found| found == name) {
        return Ok(());
    }
    fs::create_dir_all(path.parent().unwrap_or(cache))?;
    write_whole(&path, name.as_bytes())
}

async fn read_nodes(
    network: &Network,
    open: &OpenManifest,
    on_progress: OnProgress<'_>,
) -> Result<Vec<u8>, FetchError> {
    let place = network.transport().place(NODES_FILE);
    let record = open.manifest.nodes;
    let expected = NodeRanges::file_bytes(&open.world);
    if record.bytes != expected {
        let why = format!("the manifest says that it has {} bytes, and its world needs {expected}", record.bytes);
        return Err(FetchError::failed(Cause::Changed, why, place));
    }
    let mut tried = 0;
    loop {
        tried += 1;
        let mut nodes = Vec::new();
        let starts = (0..expected).step_by(PART_BYTES as usize);
        let parts = starts.map(|start| {
            let range = start..(start + PART_BYTES).min(expected);
            let most_bytes = range.end - range.start;
            let request = Request {
                file: NODES_FILE,
                range: Some(range),
                most_bytes,
                retries: network.most_retries(),
                is_vital: true,
            };
            async move { network.read(&request, |answer| async move { Ok(answer) }).await }
        });
        let mut parts = stream::iter(parts).buffered(PARTS_AT_ONCE);
        on_progress(0, expected);
        while let Some(part) = parts.next().await {
            let part = part?;
            if part.file_bytes != expected {
                let why = format!("it has {} bytes, expected {expected}", part.file_bytes);
                return Err(FetchError::failed(Cause::Changed, why, place));
            }
            nodes.extend_from_slice(&part.bytes);
            on_progress(nodes.len() as u64, expected);
        }
        let found = crc32fast::hash(&nodes);
        if found == record.crc32 {
            return Ok(nodes);
        }
        if tried == TRIES || !network.again(tried - 1).await {
            let why = format!("its checksum is {found:08x}, expected {:08x}", record.crc32);
            return Err(FetchError::failed(Cause::Damaged, why, place));
        }
    }
}

/// Writes both files, the manifest last: a folder that has one is whole.
fn write_index(folder: &Path, manifest: &[u8], nodes: &[u8]) -> io::Result<()> {
    fs::create_dir_all(folder)?;
    write_whole(&folder.join(NODES_FILE), nodes)?;
    write_whole(&folder.join(MANIFEST_FILE), manifest)
}

fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let temporary = path.with_extension(unique());
    let written = File::create_new(&temporary).and_then(|mut file| {
        file.write_all(bytes)?;
        // A sweep takes its room by age; a power failure must not leave a whole name with half a content.
        file.sync_all()
    });
    let renamed = written.and_then(|()| fs::rename(&temporary, path));
    if renamed.is_err() {
        drop(fs::remove_file(&temporary));
    }
    renamed
}

fn temporary_path() -> PathBuf {
    std::env::temp_dir().join(format!("terravision-{}", unique()))
}

fn unique() -> String {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    // Relaxed: the count orders nothing, it only has to differ.
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
