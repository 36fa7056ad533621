//! Access to the file of a segment that other programs map: by system calls instead of a mapping.
//!
//! Any program with write access can truncate the file, and an access to a mapped page behind its
//! end kills the process (SIGBUS). With system calls, a read behind the end of a file is an error
//! instead, and a write extends the file; its length shows that it happened. Other programs see the
//! same pages.

use super::error::ShmError;
use rustix::fd::OwnedFd;
use rustix::io::Errno;

/// A file below `/dev/shm` of a fixed length, unless another program truncates it.
#[derive(Debug)]
pub(crate) struct PublicFile {
    file: OwnedFd,
    name: String,
    len: u64,
}

impl PublicFile {
    pub(crate) fn new(file: OwnedFd, name: &str, len: u64) -> Self {
        Self { file, name: name.to_owned(), len }
    }

    pub(crate) fn file(&self) -> &OwnedFd {
        &self.file
    }

    /// Its name below `/dev/shm`.
    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    pub(crate) fn len(&self) -> u64 {
        self.len
    }

    fn os(&self, action: &'static str) -> impl Fn(Errno) -> ShmError + '_ {
        move |source| ShmError::Os { action, name: self.name.clone(), source }
    }

    /// Whether it still has its length.
    ///
    /// # Errors
    /// [`ShmError::CutShort`].
    pub(crate) fn check_len(&self) -> Result<(), ShmError> {
        let found = rustix::fs::fstat(&self.file).map_err(self.os("examine"))?.st_size.unsigned_abs();
        if found == self.len {
            return Ok(());
        }
        Err(ShmError::CutShort { name: self.name.clone(), found, expected: self.len })
    }

    /// Fills `out` from the bytes at `offset`.
    ///
    /// # Errors
    /// [`ShmError::CutShort`] when the file ends before.
    pub(crate) fn read_at(&self, offset: u64, out: &mut [u8]) -> Result<(), ShmError> {
        let mut at = 0;
        while at < out.len() {
            match rustix::io::pread(&self.file, &mut out[at..], offset + at as u64) {
                Ok(0) => {
                    self.check_len()?;
                    let found = offset + at as u64;
                    return Err(ShmError::CutShort { name: self.name.clone(), found, expected: self.len });
                }
                Ok(count) => at += count,
                Err(Errno::INTR) => {}
                Err(source) => return Err(self.os("read")(source)),
            }
        }
        Ok(())
    }

    /// Reads words from `offset` on.
    ///
    /// # Errors
    /// As [`PublicFile::read_at`].
    pub(crate) fn read_words<const N: usize>(&self, offset: u64) -> Result<[u64; N], ShmError> {
        let mut words = [0u64; N];
        self.read_at(offset, bytemuck::cast_slice_mut(&mut words))?;
        Ok(words)
    }

    /// Writes bytes at `offset`.
    ///
    /// # Errors
    /// [`ShmError::Os`]: the file was truncated, and there is no room to extend it again.
    pub(crate) fn write_at(&self, offset: u64, bytes: &[u8]) -> Result<(), ShmError> {
        let mut at = 0;
        while at < bytes.len() {
            match rustix::io::pwrite(&self.file, &bytes[at..], offset + at as u64) {
                Ok(0) => return Err(self.os("write")(Errno::NOSPC)),
                Ok(count) => at += count,
                Err(Errno::INTR) => {}
                Err(source) => return Err(self.os("write")(source)),
            }
        }
        Ok(())
    }

    /// Writes words from `offset` on.
    ///
    /// # Errors
    /// As [`PublicFile::write_at`].
    pub(crate) fn write_words(&self, offset: u64, words: &[u64]) -> Result<(), ShmError> {
        self.write_at(offset, bytemuck::cast_slice(words))
    }
}
