//! What went wrong while the database was read, as the prefetcher tells it: messages by cause, each
//! for one place.

use std::collections::{BTreeMap, BTreeSet};

/// Causes, and messages of each, that are kept.
const MOST_FAILURES: usize = 64;

/// Failures while the database was read, and which of them the user knows.
#[derive(Debug, Default)]
pub struct Failures {
    by_cause: BTreeMap<String, Vec<String>>,
    told_causes: BTreeSet<String>,
    told_before: Vec<String>,
}

impl Failures {
    /// Takes a message, which begins with the name of its cause; `None` when it does not, or when
    /// there are too many.
    pub(super) fn take(&mut self, text: &str) -> Option<()> {
        let (cause, message) = text.split_once(' ').filter(|_| self.by_cause.len() < MOST_FAILURES)?;
        let messages = self.by_cause.entry(cause.to_owned()).or_default();
        if messages.len() < MOST_FAILURES && !messages.iter().any(|before| before == message) {
            messages.push(message.to_owned());
        }
        Some(())
    }

    /// The messages of a cause.
    #[must_use]
    pub fn of(&self, cause: &str) -> &[String] {
        self.by_cause.get(cause).map_or(&[], Vec::as_slice)
    }

    /// The first message of each cause that the user has not been told of, with the cause's name.
    pub fn take_untold(&mut self) -> Vec<(String, String)> {
        let untold = self.by_cause.iter().filter(|(cause, _)| !self.told_causes.contains(*cause));
        let untold: Vec<_> =
            untold.filter_map(|(cause, messages)| Some((cause.clone(), messages.first()?.clone()))).collect();
        self.told_causes.extend(untold.iter().map(|(cause, _)| cause.clone()));
        let is_news = |message: &str| !self.told_before.iter().any(|told| told.ends_with(message));
        untold.into_iter().filter(|(_, message)| is_news(message)).collect()
    }

    /// These were reported before the flight, so they are not reported again.
    pub fn note_told(&mut self, messages: &[String]) {
        self.told_before.extend_from_slice(messages);
    }

    /// Whether the user was told of a cause while the flight went on.
    #[must_use]
    pub fn is_told(&self, cause: &str) -> bool {
        self.told_causes.contains(cause)
    }
}
