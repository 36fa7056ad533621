//! Detects whether the server still has the database that was opened.

use super::Remote;
use super::archive::RemoteArchive;
use crate::error::{Cause, Fault, FetchError};
use crate::lock;
use crate::network::{Network, Request};
use crate::retry::Allowance;
use crate::transport::Answer;
use bytes::Bytes;
use std::ops::Range;
use std::sync::Arc;
use std::time::{Duration, Instant};
use terravision_common::database::{MANIFEST_FILE, MOST_MANIFEST_BYTES, Manifest};

/// After failed reads, the manifest is requested at most this often.
const LOOK_EVERY: Duration = Duration::from_secs(10);

impl Remote {
    /// Finds out whether a read failed because the database was replaced: a smaller archive refuses
    /// ranges (416), or returns other bytes, and its ETag may not show it. So the manifest is
    /// requested from time to time.
    pub(super) async fn look_for_change(&self, archive: &RemoteArchive, error: FetchError) -> FetchError {
        let may_tell = matches!(
            error.cause(),
            Some(Cause::Refused | Cause::NotFound | Cause::BadAnswer | Cause::Interrupted | Cause::Damaged)
        );
        let Some(network) = self.network.as_ref().filter(|_| may_tell) else { return error };
        let mut looked = self.verifying.lock().await;
        if let Some(changed) = self.changed.get() {
            return FetchError::failed_as(Arc::clone(changed));
        }
        if looked.is_some_and(|at| at.elapsed() < LOOK_EVERY) {
            return error;
        }
        *looked = Some(Instant::now());
        let allowance = Allowance { retries: 0, is_vital: false, may_be_hasty: false };
        let request = Request { file: MANIFEST_FILE, range: None, most_bytes: MOST_MANIFEST_BYTES, allowance };
        let Ok(text) = network.read(&request, |answer| async move { Ok(answer.bytes) }).await else { return error };
        // A manifest that was damaged in transit says nothing.
        if text == self.manifest_text || Manifest::parse(&String::from_utf8_lossy(&text)).is_err() {
            return error;
        }
        let changed = self.has_changed(archive, "its manifest has changed");
        if let FetchError::Failed { fault } = &changed {
            self.log.note(fault);
        }
        changed
    }

    /// The bytes of an answer, if they belong to the file that the manifest describes.
    pub(super) async fn same_file(
        &self,
        network: &Network,
        archive: &RemoteArchive,
        answer: Answer,
    ) -> Result<Bytes, FetchError> {
        let expected = archive.record.bytes;
        if answer.file_bytes != expected {
            let why = format!("it has {} bytes, expected {expected}", answer.file_bytes);
            return Err(self.has_changed(archive, &why));
        }
        let Some(etag) = answer.etag else { return Ok(answer.bytes) };
        let is_known = |etag: &String| lock(&archive.etags).is_known(etag);
        if is_known(&etag) {
            return Ok(answer.bytes);
        }
        // Another ETag: another database, or an equal one. The manifest and the directory show
        // which.
        let _alone = self.verifying.lock().await;
        if is_known(&etag) {
            return Ok(answer.bytes);
        }
        if let Some(changed) = self.changed.get() {
            // An earlier check has found out.
            return Err(FetchError::failed_as(Arc::clone(changed)));
        }
        let ask = |file, range: Option<Range<u64>>, most_bytes| {
            let retries = network.policy().most_retries();
            let allowance = Allowance { retries, is_vital: true, may_be_hasty: false };
            let request = Request { file, range, most_bytes, allowance };
            async move { network.read(&request, |answer| async move { Ok(answer.bytes) }).await }
        };
        let manifest = ask(MANIFEST_FILE, None, MOST_MANIFEST_BYTES).await;
        let is_same = match (manifest, archive.head.get()) {
            (Ok(manifest), _) if manifest != self.manifest_text => false,
            (Ok(_), Some(head)) => {
                let range = 0..head.first.len() as u64;
                ask(archive.file, Some(range.clone()), range.end).await? == head.first
            }
            // No part of the old content is known.
            (Ok(_), None) => true,
            (Err(error), _) if error.cause() == Some(Cause::BadAnswer) => false,
            (Err(error), _) => return Err(error),
        };
        if !is_same {
            return Err(self.has_changed(archive, "its manifest or its directory has changed"));
        }
        lock(&archive.etags).learn(&etag);
        let why = "it was replaced on the server by an equal one while it was read".to_owned();
        self.log.note(&Fault { cause: Cause::Touched, why, place: network.transport().place(archive.file) });
        Ok(answer.bytes)
    }

    /// Marks the database as changed: no more is read from the server.
    fn has_changed(&self, archive: &RemoteArchive, how: &str) -> FetchError {
        let fault = self.changed.get_or_init(|| {
            let why = format!("the database on the server was replaced while it was open ({how}); open it again");
            Arc::new(Fault { cause: Cause::Changed, why, place: format!("{}/{}", self.place, archive.file) })
        });
        FetchError::failed_as(Arc::clone(fault))
    }
}
