//! Databases in tar archives: finds where each member lies. Members are read by byte ranges like
//! separate files, so the archive must not be compressed.
//!
//! Formats: POSIX ustar and pax (IEEE Std 1003.1-2017, pax), and GNU's long names and sizes.

use std::collections::BTreeMap;
use std::ops::Range;
use terravision_common::database::{COLOR_FILE, ELEVATION_FILE, MANIFEST_FILE, NODES_FILE};

/// Headers and members begin at multiples of this.
pub(crate) const BLOCK: u64 = 512;
/// An archive with more members is not a database.
pub(crate) const MOST_MEMBERS: usize = 256;
/// Longest extended header that is read.
pub(crate) const MOST_EXTENDED: u64 = 64 << 10;

/// The bytes are not those of an archive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("it is not a tar archive that can be read, or it was cut short")]
pub(crate) struct NoArchive;

/// What the reader needs next.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Next {
    /// A header, at this byte.
    Header(u64),
    /// The content of an extended header.
    Extended(Range<u64>),
    /// Nothing: the archive ends here.
    End,
}

/// Names of the members of a database; other names are not stored.
const FILES: [&str; 4] = [MANIFEST_FILE, NODES_FILE, ELEVATION_FILE, COLOR_FILE];

/// Finds members, header by header.
#[derive(Debug)]
pub(crate) struct Headers {
    next: Next,
    /// The type of the extended header that is read next.
    kind: u8,
    /// Name and size that extended headers give to the next member.
    name: Option<String>,
    bytes: Option<u64>,
    seen: usize,
    /// Members by the last part of their names.
    pub(crate) members: BTreeMap<String, Range<u64>>,
}

impl Default for Headers {
    fn default() -> Self {
        Self { next: Next::Header(0), kind: 0, name: None, bytes: None, seen: 0, members: BTreeMap::new() }
    }
}

impl Headers {
    pub(crate) fn next(&self) -> &Next {
        &self.next
    }

    /// Takes the bytes that [`Headers::next`] asked for.
    ///
    /// # Errors
    /// [`NoArchive`].
    pub(crate) fn take(&mut self, bytes: &[u8]) -> Result<(), NoArchive> {
        match self.next {
            Next::Header(at) => self.header(at, bytes),
            Next::Extended(ref range) => {
                let end = range.end;
                self.extended(bytes)?;
                self.next = header_at(end)?;
                Ok(())
            }
            Next::End => Ok(()),
        }
    }

    fn header(&mut self, at: u64, block: &[u8]) -> Result<(), NoArchive> {
        let block: &[u8; BLOCK as usize] = block.try_into().map_err(|_short| NoArchive)?;
        if block.iter().all(|byte| *byte == 0) {
            self.next = Next::End;
            return Ok(());
        }
        self.seen += 1;
        // The sum of the header's bytes, with its own field as blanks.
        let sum: u64 =
            block.iter().enumerate().map(|(k, b)| u64::from(if (148..156).contains(&k) { b' ' } else { *b })).sum();
        if number(&block[148..156]) != Some(sum) || self.seen > MOST_MEMBERS {
            return Err(NoArchive);
        }
        let own_bytes = number(&block[124..136]).ok_or(NoArchive)?;
        let kind = block[156];
        let begin = at.checked_add(BLOCK).ok_or(NoArchive)?;
        if matches!(kind, b'x' | b'L') {
            self.kind = kind;
            if own_bytes > MOST_EXTENDED {
                return Err(NoArchive);
            }
            self.next = Next::Extended(begin..begin.checked_add(own_bytes).ok_or(NoArchive)?);
            return Ok(());
        }
        let bytes = if matches!(kind, b'g') { own_bytes } else { self.bytes.take().unwrap_or(own_bytes) };
        let end = begin.checked_add(bytes).ok_or(NoArchive)?;
        if matches!(kind, b'0' | 0 | b'7') {
            let name = self.name.take().unwrap_or_else(|| text(&block[..100]));
            let name = name.rsplit('/').next().unwrap_or_default();
            if FILES.contains(&name) {
                self.members.entry(name.to_owned()).or_insert(begin..end);
            }
        }
        self.next = header_at(end)?;
        Ok(())
    }

    fn extended(&mut self, content: &[u8]) -> Result<(), NoArchive> {
        if self.kind == b'L' {
            self.name = Some(text(content));
            return Ok(());
        }
        // Records: length of the record, a blank, key=value, a line feed.
        let mut rest = content;
        while let Some(blank) = rest.iter().position(|byte| *byte == b' ') {
            let length: usize =
                std::str::from_utf8(&rest[..blank]).ok().and_then(|n| n.parse().ok()).ok_or(NoArchive)?;
            let record = rest.get(blank + 1..length).ok_or(NoArchive)?;
            let record = String::from_utf8_lossy(record);
            match record.trim_end_matches('\n').split_once('=') {
                Some(("path", path)) => self.name = Some(path.to_owned()),
                Some(("size", size)) => self.bytes = Some(size.parse().map_err(|_no_number| NoArchive)?),
                _ => {}
            }
            rest = &rest[length..];
        }
        Ok(())
    }
}

/// The header after a member that ends at `end`. The header must fit below the largest number.
fn header_at(end: u64) -> Result<Next, NoArchive> {
    let at = end.checked_next_multiple_of(BLOCK).ok_or(NoArchive)?;
    at.checked_add(BLOCK).map(|_| Next::Header(at)).ok_or(NoArchive)
}

fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).into_owned()
}

/// A number: octal digits, or (GNU) binary if the first bit is set.
fn number(field: &[u8]) -> Option<u64> {
    if field[0] & 0x80 != 0 {
        let (first, rest) = field.split_first()?;
        let bytes = std::iter::once(first & 0x7F).chain(rest.iter().copied());
        return bytes.into_iter().try_fold(0u64, |sum, byte| sum.checked_mul(256)?.checked_add(byte.into()));
    }
    let digits =
        field.iter().map(|byte| *byte as char).skip_while(|c| *c == ' ').take_while(|c| !matches!(c, ' ' | '\0'));
    digits.map(|c| c.to_digit(8)).try_fold(0u64, |sum, digit| sum.checked_mul(8)?.checked_add(digit?.into()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn header(name: &str, kind: u8, size: &[u8]) -> Vec<u8> {
        let mut block = vec![0; BLOCK as usize];
        block[..name.len()].copy_from_slice(name.as_bytes());
        block[124..124 + size.len()].copy_from_slice(size);
        block[156] = kind;
        block[148..156].fill(b' ');
        let sum: u64 = block.iter().map(|byte| u64::from(*byte)).sum();
        block[148..155].copy_from_slice(format!("{sum:06o}\0").as_bytes());
        block
    }

    fn read(archive: &[u8]) -> Result<BTreeMap<String, Range<u64>>, NoArchive> {
        let mut headers = Headers::default();
        loop {
            let range = match headers.next() {
                Next::End => return Ok(headers.members),
                Next::Header(at) => *at..*at + BLOCK,
                Next::Extended(range) => range.clone(),
            };
            let range = range.start as usize..(range.end as usize).min(archive.len());
            headers.take(archive.get(range).unwrap_or_default())?;
        }
    }

    fn padded(content: &[u8]) -> Vec<u8> {
        let mut padded = content.to_vec();
        padded.resize(content.len().next_multiple_of(BLOCK as usize), 0);
        padded
    }

    #[test]
    fn members_are_found_behind_folders_and_extended_headers() {
        let long = format!("{}/color.pmtiles", "deep/".repeat(60));
        let pax = format!("30 mtime=1700000000.123456789\n{} size=1000\n", 13);
        let pax = pax.replacen("30", &format!("{}", "30 mtime=1700000000.123456789\n".len()), 1);
        let archive = [
            header("world.tv/", b'5', b"00000000000\0"),
            header("world.tv/manifest.json", b'0', b"00000000003\0"),
            padded(b"{}\n"),
            header("././@LongLink", b'L', format!("{:011o}\0", long.len() + 1).as_bytes()),
            padded(format!("{long}\0").as_bytes()),
            header("deep/deep", b'0', &[0x80, 0, 0, 0, 0, 0, 0, 0, 0, 0, 2, 1]),
            vec![7; 1024],
            header("pax", b'x', format!("{:011o}\0", pax.len()).as_bytes()),
            padded(pax.as_bytes()),
            header("nodes.tvn", 0, b"0000\0"),
            vec![8; 1024],
            vec![0; 1024],
        ]
        .concat();
        let members = read(&archive).expect("an archive");
        let found: Vec<(&str, u64)> =
            members.iter().map(|(name, range)| (name.as_str(), range.end - range.start)).collect();
        assert_eq!(found, [("color.pmtiles", 513), ("manifest.json", 3), ("nodes.tvn", 1000)]);
        assert_eq!(archive[members["nodes.tvn"].start as usize], 8);
        assert_eq!(archive[members["manifest.json"].start as usize], b'{');
        assert_eq!(read(&archive[..1000]), Err(NoArchive), "cut short");
        let mut damaged = archive.clone();
        damaged[3] ^= 1;
        assert_eq!(read(&damaged), Err(NoArchive));
    }

    proptest! {
        #[test]
        fn any_bytes_are_an_archive_or_none(bytes in prop::collection::vec(any::<u8>(), 0..2048), size in "[0-7]{11}") {
            let archive = [header("a", b'x', size.as_bytes()), bytes.clone()].concat();
            read(&archive).ok();
            read(&bytes).ok();
        }
    }
}
