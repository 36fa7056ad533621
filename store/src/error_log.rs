//! The log of failures, folded: each cause is reported once, with a count.

use crate::error::{Cause, Fault};
use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use terravision_common::terminal::cut;

/// Failures of one kind at one place.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Folded {
    /// The last failure.
    pub fault: Fault,
    /// How many there were.
    pub count: u64,
    is_told: bool,
}

/// Failures, folded by cause and place. May be read and written by any thread.
#[derive(Debug, Default)]
pub struct ErrorLog {
    entries: Mutex<BTreeMap<(Cause, String), Folded>>,
}

/// At most this many places are distinguished: a server that words each failure differently must
/// not fill the memory.
pub(crate) const MOST_ENTRIES: usize = 256;
/// The reason of a failure is cut to this many bytes, because it may contain text from a server.
pub(crate) const MOST_WORDS_BYTES: usize = 1024;

fn told(text: &str) -> String {
    cut(text, MOST_WORDS_BYTES).to_owned()
}

impl ErrorLog {
    fn lock(&self) -> MutexGuard<'_, BTreeMap<(Cause, String), Folded>> {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a failure.
    pub fn note(&self, fault: &Fault) {
        tracing::debug!(cause = fault.cause.name(), "{fault}");
        let mut entries = self.lock();
        let is_full = entries.len() >= MOST_ENTRIES;
        let key = (fault.cause, told(&fault.place));
        let key = if is_full && !entries.contains_key(&key) { (fault.cause, String::new()) } else { key };
        let first = || Fault { cause: fault.cause, why: String::new(), place: told(&fault.place) };
        let entry = entries.entry(key).or_insert_with(|| Folded { fault: first(), count: 0, is_told: false });
        entry.count += 1;
        entry.fault.why = told(&fault.why);
    }

    /// Number of failures by cause.
    #[must_use]
    pub fn counts(&self) -> BTreeMap<Cause, u64> {
        let mut counts = BTreeMap::new();
        for ((cause, _), folded) in self.lock().iter() {
            *counts.entry(*cause).or_default() += folded.count;
        }
        counts
    }

    /// All failures.
    #[must_use]
    pub fn folded(&self) -> Vec<Folded> {
        self.lock().values().cloned().collect()
    }

    /// Failures that have not been taken before, one sentence for each cause and place.
    #[must_use]
    pub fn take_news(&self) -> Vec<String> {
        self.take_untold().iter().map(Folded::to_string).collect()
    }

    /// Failures that have not been taken before, one for each cause and place.
    #[must_use]
    pub fn take_untold(&self) -> Vec<Folded> {
        let mut entries = self.lock();
        let news = entries.values_mut().filter(|folded| !folded.is_told);
        news.map(|folded| {
            folded.is_told = true;
            folded.clone()
        })
        .collect()
    }
}

impl std::fmt::Display for Folded {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.count {
            0 | 1 => write!(f, "{}", self.fault),
            count => write!(f, "{count} times: {}", self.fault),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(cause: Cause, why: &str, place: &str) -> Fault {
        Fault { cause, why: why.to_owned(), place: place.to_owned() }
    }

    #[test]
    fn failures_are_folded_by_cause_and_place_and_told_once() {
        let log = ErrorLog::default();
        for _ in 0..3 {
            log.note(&fault(Cause::Server, "500", "color.pmtiles"));
        }
        log.note(&fault(Cause::Timeout, "no answer", "color.pmtiles"));
        log.note(&fault(Cause::Server, "502", "elevation.pmtiles"));
        let news = log.take_news();
        assert_eq!(news, ["3 times: 500: color.pmtiles", "502: elevation.pmtiles", "no answer: color.pmtiles"]);
        assert!(log.take_news().is_empty());
        log.note(&fault(Cause::Server, "503", "color.pmtiles"));
        assert!(log.take_news().is_empty(), "told once");
        assert_eq!(log.counts(), BTreeMap::from([(Cause::Server, 5), (Cause::Timeout, 1)]));
    }

    #[test]
    fn a_flood_of_places_is_bounded() {
        let log = ErrorLog::default();
        for k in 0..10_000 {
            log.note(&fault(Cause::Refused, "no", &k.to_string()));
        }
        log.note(&fault(Cause::Server, &"ä".repeat(1 << 20), &"x".repeat(1 << 20)));
        assert!(log.folded().len() <= MOST_ENTRIES + 2);
        assert!(log.folded().iter().all(|entry| entry.to_string().len() < 3 * MOST_WORDS_BYTES));
        assert_eq!(log.counts()[&Cause::Refused], 10_000);
    }
}
