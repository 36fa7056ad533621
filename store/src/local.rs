//! A database in a local folder.

use crate::error::{Cause, Fault, FetchError};
use crate::error_log::ErrorLog;
use bytes::Bytes;
use std::sync::Arc;
use terravision_common::database::{
    Database, MANIFEST_FILE, MOST_MANIFEST_BYTES, Manifest, Tile, TileError, check_tile,
};
use terravision_common::files::read_bounded;

/// A stored tile of a local database, its checksum verified. Blocks on the disk.
pub(crate) fn local_payload(database: &Database, tile: Tile, log: &ErrorLog) -> Result<Bytes, FetchError> {
    let read = read_local(database, tile);
    match read {
        Err(FetchError::Damaged { .. } | FetchError::Failed { .. }) if has_changed(database) => {
            let why =
                "the database was replaced while it was open (its manifest has changed); open it again".to_owned();
            let fault = Fault { cause: Cause::Changed, why, place: database.path().display().to_string() };
            log.note(&fault);
            Err(FetchError::failed_as(Arc::new(fault)))
        }
        read => read,
    }
}

/// Whether the folder now contains another database.
fn has_changed(database: &Database) -> bool {
    let text = read_bounded(&database.path().join(MANIFEST_FILE), MOST_MANIFEST_BYTES).ok();
    let manifest = text.and_then(|text| Manifest::parse(std::str::from_utf8(&text).ok()?).ok());
    manifest.is_some_and(|manifest| manifest != *database.manifest())
}

fn read_local(database: &Database, tile: Tile) -> Result<Bytes, FetchError> {
    let Tile { layer, node } = tile;
    let mut bytes = Vec::new();
    match database.read_payload(layer, node, &mut bytes) {
        Ok(()) => {}
        Err(TileError::Missing { .. }) => return Err(FetchError::Absent),
        Err(TileError::Corrupt { reason, .. }) => return Err(FetchError::Damaged { reason: Arc::new(reason) }),
        Err(error) => {
            return Err(FetchError::failed(Cause::Disk, error.to_string(), database.path().display().to_string()));
        }
    }
    check_tile(layer, &bytes).map_err(|reason| FetchError::Damaged { reason: Arc::new(reason) })?;
    Ok(bytes.into())
}
