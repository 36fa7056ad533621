//! The marks (ETags) that a server gives the content of one file.

use terravision_common::terminal::cut;

/// Marks of one content that are remembered; a server that changes them more often than that does
/// not mean the content by them.
pub(crate) const MOST_ETAGS: usize = 16;
/// A mark is remembered up to so many bytes.
pub(crate) const MOST_ETAG_BYTES: usize = 256;

/// The marks that one content was seen with.
#[derive(Debug, Default)]
pub(crate) struct Etags {
    known: Vec<String>,
    /// There were too many: they tell nothing. Checksums of tiles, and the manifest, still do.
    is_meaningless: bool,
}

impl Etags {
    /// Whether a mark is one of this content: the first of all is.
    pub(crate) fn is_known(&mut self, etag: &str) -> bool {
        if self.known.is_empty() {
            self.learn(etag);
        }
        self.is_meaningless || self.known.iter().any(|known| known == cut(etag, MOST_ETAG_BYTES))
    }

    /// Notes that this content has this mark, too.
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
