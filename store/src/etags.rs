//! The ETags that a server gives the content of one file.

use terravision_common::terminal::cut;

/// Upper bound of the ETags of one content; the ETags of a server that uses more do not identify
/// content.
pub(crate) const MOST_ETAGS: usize = 16;
/// ETags are stored up to this many bytes.
pub(crate) const MOST_ETAG_BYTES: usize = 256;

/// The ETags seen with one content.
#[derive(Debug, Default)]
pub(crate) struct Etags {
    known: Vec<String>,
    /// There were too many, so that they mean nothing. Checksums of tiles and the manifest still
    /// detect a change.
    is_meaningless: bool,
}

impl Etags {
    /// Whether an ETag belongs to this content. The very first one does.
    pub(crate) fn is_known(&mut self, etag: &str) -> bool {
        if self.known.is_empty() {
            self.learn(etag);
        }
        self.is_meaningless || self.known.iter().any(|known| known == cut(etag, MOST_ETAG_BYTES))
    }

    /// Adds another ETag of this content.
    pub(crate) fn learn(&mut self, etag: &str) {
        if self.known.len() < MOST_ETAGS {
            self.known.push(cut(etag, MOST_ETAG_BYTES).to_owned());
        } else {
            self.is_meaningless = true;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_without_end_are_not_kept() {
        let mut etags = Etags::default();
        assert!(etags.is_known("0") && etags.is_known("0") && !etags.is_known("1"));
        etags.learn("1");
        assert!(etags.is_known("0") && etags.is_known("1"));
        for number in 2..1000 {
            let etag = format!("{number}{}", "ä".repeat(10_000));
            if !etags.is_known(&etag) {
                etags.learn(&etag);
            }
            assert!(etags.is_known(&etag));
        }
        assert_eq!(etags.known.len(), MOST_ETAGS);
        assert!(etags.known.iter().map(String::len).sum::<usize>() <= MOST_ETAGS * MOST_ETAG_BYTES);
    }
}
