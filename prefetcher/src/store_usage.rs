//! Reports the use of the database to the launcher: statistics of reads, and failures.
//!
//! Counts in the control block are increased by what was added since the last report, so that a
//! restarted prefetcher continues the counts of the one before.

use crate::source::PayloadSource;
use std::collections::BTreeMap;
use terravision_common::event::{Event, TextKind};
use terravision_common::shm::{Control, Counter};
use terravision_common::stage::Events;
use terravision_store::{Cause, StoreStats};

/// What has been reported so far.
#[derive(Debug, Default)]
pub struct StoreUsage {
    told: StoreStats,
    failures: BTreeMap<Cause, u64>,
}

impl StoreUsage {
    /// Reports what is new since the last call.
    pub fn publish(&mut self, source: &impl PayloadSource, control: &Control, events: &mut Events) {
        let (now, told) = (source.stats(), std::mem::take(&mut self.told));
        for (counter, now, told) in [
            (Counter::NetworkRequests, now.requests, told.requests),
            (Counter::NetworkRepeated, now.repeated, told.repeated),
            (Counter::NetworkBytes, now.bytes, told.bytes),
            (Counter::CacheHits, now.cache.hits, told.cache.hits),
            (Counter::CacheMisses, now.cache.misses, told.cache.misses),
            (Counter::CacheBytes, now.cache.bytes, told.cache.bytes),
        ] {
            control.count(counter, now.saturating_sub(told));
        }
        // A request was made, or a part of an answer came: a slow database is not a hang.
        if (now.requests, now.bytes) != (told.requests, told.bytes) {
            control.progress();
        }
        self.told = now;
        let Some(errors) = source.errors() else { return };
        let counts = errors.counts();
        for (cause, count) in &counts {
            let told = self.failures.get(cause).copied().unwrap_or(0);
            control.count_failures(cause.number(), count.saturating_sub(told));
        }
        self.failures = counts;
        for folded in errors.take_untold() {
            let sentence = format!("{} {}", folded.fault.cause.name(), folded.fault);
            for event in Event::text(TextKind::Failure, &sentence) {
                events.tell(control, event);
            }
        }
    }
}
