//! The few things of a ZIP archive that a KMZ needs: its directory, and one file out of it (PKWARE
//! APPNOTE 6.3.10).
//!
//! Nothing is believed: sizes and offsets are checked against the archive, what is unpacked is cut
//! at a limit and has to have its checksum.

use flate2::Crc;
use flate2::read::DeflateDecoder;
use std::io::{self, Read, Seek, SeekFrom};

/// Largest directory that is read: a hundred thousand files and more.
const MAX_DIRECTORY_BYTES: u64 = 16 << 20;
/// The end record, and the longest comment behind it.
const END_BYTES: u64 = 22;
const TAIL_BYTES: u64 = END_BYTES + 65_535;
const BROKEN: &str = "the archive is damaged or cut short: load or save it again";

/// A file in the archive.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ZipEntry {
    /// Its name, as far as it is text.
    pub(super) name: String,
    flags: u16,
    method: u16,
    crc: u32,
    packed: u64,
    size: u64,
    header_at: u64,
}

/// Why an archive or a file in it cannot be read.
#[derive(Debug)]
pub(super) enum ZipError {
    /// It is broken, or packed in a way that is not read.
    Unusable {
        /// What is wrong with it, in words.
        why: String,
    },
    /// The file is larger than the limit when it is unpacked.
    TooLarge,
}

impl From<io::Error> for ZipError {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::UnexpectedEof | io::ErrorKind::InvalidInput | io::ErrorKind::InvalidData => broken(),
            _ => Self::Unusable { why: error.to_string() },
        }
    }
}

fn broken() -> ZipError {
    ZipError::Unusable { why: BROKEN.into() }
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u64> {
    Some(u64::from(u16::from_le_bytes(bytes.get(at..at + 2)?.try_into().ok()?)))
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u64> {
    Some(u64::from(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?)))
}

fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    Some(u64::from_le_bytes(bytes.get(at..at + 8)?.try_into().ok()?))
}

fn read_at(file: &mut (impl Read + Seek), at: u64, count: u64) -> Result<Vec<u8>, ZipError> {
    file.seek(SeekFrom::Start(at))?;
    let mut bytes = vec![0; usize::try_from(count).map_err(|_too_large| broken())?];
    file.read_exact(&mut bytes)?;
    Ok(bytes)
}

/// The files in an archive of `len` bytes whose name `wanted` accepts, in the order of its
/// directory.
pub(super) fn entries(
    file: &mut (impl Read + Seek),
    len: u64,
    wanted: impl Fn(&str) -> bool,
) -> Result<Vec<ZipEntry>, ZipError> {
    let tail_at = len.saturating_sub(TAIL_BYTES);
    let tail = read_at(file, tail_at, len - tail_at)?;
    let end = (0..tail.len().saturating_sub(END_BYTES as usize - 1)).rev().find(|&at| {
        tail[at..].starts_with(b"PK\x05\x06")
            && u16_at(&tail, at + 20).is_some_and(|comment| at as u64 + END_BYTES + comment <= tail.len() as u64)
    });
    let end = end.ok_or_else(broken)?;
    let end_at = tail_at + end as u64;
    let word = |at| u32_at(&tail, end + at).ok_or_else(broken);
    let (mut size, mut at) = (word(12)?, word(16)?);
    let mut directory_end = end_at;
    let is_large = size == u64::from(u32::MAX) || at == u64::from(u32::MAX);
    if is_large && let Some(locator_at) = end.checked_sub(20).filter(|&at| tail[at..].starts_with(b"PK\x06\x07")) {
        let record_at = u64_at(&tail, locator_at + 8).ok_or_else(broken)?;
        let record = read_at(file, record_at, 56)?;
        (size, at) = u64_at(&record, 40)
            .zip(u64_at(&record, 48))
            .filter(|_| record.starts_with(b"PK\x06\x06"))
            .ok_or_else(broken)?;
        directory_end = record_at;
    }
    // What stands before the archive (a program that unpacks itself) moves everything by its
    // length.
    let shift = directory_end.checked_sub(size).and_then(|real| real.checked_sub(at)).ok_or_else(broken)?;
    if size > MAX_DIRECTORY_BYTES {
        return Err(ZipError::Unusable { why: "its directory has more than 16 MiB".into() });
    }
    let directory = read_at(file, at + shift, size)?;
    let mut found = Vec::new();
    let mut rest = directory.as_slice();
    while rest.starts_with(b"PK\x01\x02") {
        let (entry, length) = entry(rest, shift).ok_or_else(broken)?;
        if wanted(&entry.name) {
            found.push(entry);
        }
        rest = rest.get(length..).ok_or_else(broken)?;
    }
    Ok(found)
}

/// The first entry of a directory, and its length there.
fn entry(bytes: &[u8], shift: u64) -> Option<(ZipEntry, usize)> {
    let lengths = [u16_at(bytes, 28)?, u16_at(bytes, 30)?, u16_at(bytes, 32)?];
    let [name, extra, comment] = lengths.map(|length| length as usize);
    let (mut packed, mut size, mut header_at) = (u32_at(bytes, 20)?, u32_at(bytes, 24)?, u32_at(bytes, 42)?);
    // Sizes beyond 32 bits stand in an extra field, each only where its own place is full of ones.
    let mut fields = bytes.get(46 + name..46 + name + extra)?;
    while let (Some(kind), Some(length)) = (u16_at(fields, 0), u16_at(fields, 2)) {
        let field = fields.get(4..4 + length as usize)?;
        if kind == 1 {
            let large = [&mut size, &mut packed, &mut header_at].into_iter().filter(|v| **v == u64::from(u32::MAX));
            for (i, value) in large.enumerate() {
                *value = u64_at(field, 8 * i)?;
            }
        }
        fields = &fields[4 + length as usize..];
    }
    let entry = ZipEntry {
        name: String::from_utf8_lossy(bytes.get(46..46 + name)?).into_owned(),
        flags: u16_at(bytes, 8)? as u16,
        method: u16_at(bytes, 10)? as u16,
        crc: u32_at(bytes, 16)? as u32,
        packed,
        size,
        header_at: header_at.checked_add(shift)?,
    };
    Some((entry, 46 + name + extra + comment))
}

/// Unpacks a file of an archive, `limit` bytes at most.
pub(super) fn read_entry(file: &mut (impl Read + Seek), entry: &ZipEntry, limit: u64) -> Result<Vec<u8>, ZipError> {
    if entry.flags & 1 != 0 {
        return Err(ZipError::Unusable { why: "it is encrypted: save it without a password".into() });
    }
    if entry.size > limit {
        return Err(ZipError::TooLarge);
    }
    let header = read_at(file, entry.header_at, 30)?;
    let (name, extra) = u16_at(&header, 26).zip(u16_at(&header, 28)).ok_or_else(broken)?;
    if !header.starts_with(b"PK\x03\x04") {
        return Err(broken());
    }
    file.seek(SeekFrom::Start(entry.header_at + 30 + name + extra))?;
    let packed = file.take(entry.packed);
    let mut bytes = Vec::new();
    // One byte more than said, so that a file that is longer than it says is noticed and not only
    // cut.
    match entry.method {
        0 => packed.take(entry.size + 1).read_to_end(&mut bytes)?,
        8 => DeflateDecoder::new(packed).take(entry.size + 1).read_to_end(&mut bytes)?,
        other => {
            return Err(ZipError::Unusable {
                why: format!(
                    "it is packed by method {other}: expected deflate (8) or stored (0); unpack it and fly its .kml"
                ),
            });
        }
    };
    let mut crc = Crc::new();
    crc.update(&bytes);
    if bytes.len() as u64 != entry.size || crc.sum() != entry.crc {
        return Err(broken());
    }
    Ok(bytes)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use flate2::Compression;
    use flate2::write::DeflateEncoder;
    use proptest::prelude::*;
    use std::io::{Cursor, Write};

    /// An archive of these files, deflated as KMZ are.
    pub(in super::super) fn archive(files: &[(&str, &[u8])]) -> Vec<u8> {
        let (mut bytes, mut directory) = (Vec::new(), Vec::new());
        for (name, content) in files {
            let mut encoder = DeflateEncoder::new(Vec::new(), Compression::default());
            encoder.write_all(content).unwrap();
            let packed = encoder.finish().unwrap();
            let mut crc = Crc::new();
            crc.update(content);
            let mut fields = Vec::new();
            for value in [20u16, 0, 8, 0, 0x21] {
                fields.extend(value.to_le_bytes());
            }
            for value in [crc.sum(), packed.len() as u32, content.len() as u32] {
                fields.extend(value.to_le_bytes());
            }
            fields.extend((name.len() as u16).to_le_bytes());
            fields.extend(0u16.to_le_bytes());
            let at = bytes.len() as u32;
            bytes.extend(b"PK\x03\x04");
            bytes.extend(&fields);
            bytes.extend(name.as_bytes());
            bytes.extend(&packed);
            directory.extend(b"PK\x01\x02\x14\x00");
            directory.extend(&fields);
            directory.extend([0; 10]);
            directory.extend(at.to_le_bytes());
            directory.extend(name.as_bytes());
        }
        let at = bytes.len() as u32;
        bytes.extend(&directory);
        bytes.extend(b"PK\x05\x06\0\0\0\0");
        bytes.extend([(files.len() as u16).to_le_bytes(); 2].concat());
        bytes.extend((directory.len() as u32).to_le_bytes());
        bytes.extend(at.to_le_bytes());
        bytes.extend([0, 0]);
        bytes
    }

    fn read(bytes: &[u8], name: &str, limit: u64) -> Result<Vec<u8>, ZipError> {
        let mut file = Cursor::new(bytes);
        let found = entries(&mut file, bytes.len() as u64, |other| other == name)?;
        read_entry(&mut file, found.first().ok_or_else(broken)?, limit)
    }

    #[test]
    fn files_are_unpacked_whatever_stands_before_and_behind() {
        let bytes = archive(&[("a.png", &[7; 9]), ("files/doc.kml", b"<kml/>"), ("b.kml", b"")]);
        assert_eq!(read(&bytes, "files/doc.kml", 100).unwrap(), b"<kml/>");
        assert_eq!(read(&bytes, "b.kml", 100).unwrap(), b"");
        let mut commented = [b"#!/bin/sh".to_vec(), bytes.clone()].concat();
        let length = commented.len();
        commented[length - 2] = 5;
        commented.extend(b"hello");
        assert_eq!(read(&commented, "a.png", 100).unwrap(), [7; 9]);
    }

    #[test]
    fn bombs_stop_at_the_limit_and_lies_are_noticed() {
        let bytes = archive(&[("doc.kml", &vec![b' '; 3_000_000])]);
        assert!(bytes.len() < 10_000);
        assert!(matches!(read(&bytes, "doc.kml", 1_000_000), Err(ZipError::TooLarge)));
        // It says that it is small.
        let mut liar = bytes.clone();
        let at = liar.windows(4).position(|w| w == b"PK\x01\x02").unwrap();
        liar[at + 24..at + 28].copy_from_slice(&100u32.to_le_bytes());
        assert!(matches!(read(&liar, "doc.kml", 1_000_000), Err(ZipError::Unusable { .. })));
        for cut in [0, 1, 21, bytes.len() / 2, bytes.len() - 1] {
            assert!(read(&bytes[..cut], "doc.kml", 1 << 30).is_err(), "{cut}");
        }
    }

    proptest! {
        #[test]
        fn damaged_archives_never_panic_or_give_other_bytes(at in 0usize..160, to: u8) {
            let mut bytes = archive(&[("doc.kml", b"<kml><Document/></kml>")]);
            let at = at % bytes.len();
            bytes[at] = to;
            if let Ok(content) = read(&bytes, "doc.kml", 1000) {
                prop_assert_eq!(content, b"<kml><Document/></kml>".to_vec());
            }
        }
    }
}
