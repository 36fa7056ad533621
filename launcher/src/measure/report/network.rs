//! The parts of a report that are about where tiles came from: the prefetcher, and a database that is elsewhere.

use crate::measure::report::RunFigures;
use crate::measure::report::realtime::Percentiles;
use serde::Serialize;
use terravision_common::run::RunConfig;
use terravision_common::shm::{Control, Counter, FAILURE_CAUSES, Gauge};
use terravision_store::{Cause, Location};

/// What the prefetcher did, as counted in the control block.
#[derive(Debug, Clone, Default)]
pub struct PrefetchFigures {
    /// Tiles asked of the database.
    pub requested: u64,
    /// Tiles that it gave.
    pub received: u64,
    /// Requests that were given up.
    pub cancelled: u64,
    /// Bytes of the tiles that it gave.
    pub bytes: u64,
    /// Requests to a server, and of these those asked again.
    pub network_requests: [u64; 2],
    /// Bytes that a server sent.
    pub network_bytes: u64,
    /// Pieces that were in the disk cache, and that were not.
    pub cache_pieces: [u64; 2],
    /// Bytes from the disk cache.
    pub cache_bytes: u64,
    /// Failures by the number of the cause.
    pub failures: [u64; FAILURE_CAUSES],
}

impl PrefetchFigures {
    /// What is counted now.
    #[must_use]
    pub fn of(control: &Control) -> Self {
        let counter = |counter| control.counter(counter);
        Self {
            requested: counter(Counter::TilesRequested),
            received: counter(Counter::TilesReceived),
            cancelled: counter(Counter::TilesCancelled),
            bytes: counter(Counter::BytesReceived),
            network_requests: [counter(Counter::NetworkRequests), counter(Counter::NetworkRepeated)],
            network_bytes: counter(Counter::NetworkBytes),
            cache_pieces: [counter(Counter::CacheHits), counter(Counter::CacheMisses)],
            cache_bytes: counter(Counter::CacheBytes),
            failures: control.failures(),
        }
    }
}

/// N over a run. Field names are the schema's.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct WindowSpan {
    least: u64,
    most: u64,
    last: u64,
}

impl WindowSpan {
    /// Looks at N of now.
    pub fn sample(&mut self, control: &Control) {
        let n = control.gauge(Gauge::PrefetchWindow);
        if n > 0 {
            self.least = if self.most == 0 { n } else { self.least.min(n) };
            self.most = self.most.max(n);
            self.last = n;
        }
    }
}

/// The prefetcher. Field names are the schema's.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PrefetchReport {
    prediction: &'static str,
    requested: u64,
    received: u64,
    cancelled: u64,
    bytes: u64,
    /// N: tiles asked for at a time.
    window: WindowSpan,
    round_trip_ms: Percentiles,
}

impl PrefetchReport {
    /// The part of a run.
    #[must_use]
    pub fn new(config: &RunConfig, figures: &RunFigures) -> Self {
        let PrefetchFigures { requested, received, cancelled, bytes, .. } = figures.prefetch;
        let round_trips: Vec<f64> = figures.collector.round_trips_ms.iter().copied().map(f64::from).collect();
        Self {
            prediction: config.prefetch.prediction.name(),
            requested,
            received,
            cancelled,
            bytes,
            window: figures.window,
            round_trip_ms: Percentiles::of(&round_trips),
        }
    }
}

/// A database that is elsewhere. Field names are the schema's.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NetworkReport {
    requests: u64,
    repeated: u64,
    bytes: u64,
    cache: CacheReport,
    failures: Vec<FailureReport>,
    #[serde(skip)]
    round_trip_ms: f64,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
struct CacheReport {
    hits: u64,
    misses: u64,
    bytes: u64,
}

/// Failures of one cause.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct FailureReport {
    cause: &'static str,
    count: u64,
    /// Why and where, a sentence for each place.
    told: Vec<String>,
}

impl NetworkReport {
    /// The part of a run; `None` when the database is in a folder of this machine.
    #[must_use]
    pub fn new(config: &RunConfig, figures: &RunFigures) -> Option<Self> {
        let location = Location::parse(&config.database.location).ok()?;
        if location.as_path().is_some() {
            return None;
        }
        let PrefetchFigures { network_requests, network_bytes, cache_pieces, cache_bytes, .. } = figures.prefetch;
        let failures = failures(figures);
        Some(Self {
            requests: network_requests[0],
            repeated: network_requests[1],
            bytes: network_bytes,
            cache: CacheReport { hits: cache_pieces[0], misses: cache_pieces[1], bytes: cache_bytes },
            failures,
            round_trip_ms: PrefetchReport::new(config, figures).round_trip_ms.p50,
        })
    }

    /// What came from where, in one line.
    #[must_use]
    pub fn summary(&self) -> String {
        let mb = |bytes: u64| bytes as f64 / 1e6;
        format!(
            "{} requests to the server, {} of them repeated; {:.1} MB from there, {:.1} MB from the disk cache; an \
             answer took {:.0} ms (median)",
            self.requests,
            self.repeated,
            mb(self.bytes),
            mb(self.cache.bytes),
            self.round_trip_ms
        )
    }
}

fn failures(figures: &RunFigures) -> Vec<FailureReport> {
    let counted = Cause::ALL.into_iter().zip(figures.prefetch.failures).filter(|(_, count)| *count > 0);
    counted
        .map(|(cause, count)| FailureReport {
            cause: cause.name(),
            count,
            told: figures.collector.failures.get(cause.name()).cloned().unwrap_or_default(),
        })
        .collect()
}

/// The most frequent failure while the database was read: why, and where.
#[must_use]
pub fn main_failure(figures: &RunFigures) -> Option<String> {
    let told = failures(figures).into_iter().filter(|failure| !failure.told.is_empty());
    told.max_by_key(|failure| failure.count).and_then(|failure| failure.told.into_iter().next())
}

/// What went wrong while the database was read, a sentence for each cause: how often, why, and where.
#[must_use]
pub fn failure_sentences(figures: &RunFigures) -> Vec<String> {
    let sentence = |failure: FailureReport| {
        let in_all = if figures.collector.is_failure_told(failure.cause) { " in all" } else { "" };
        let times = if failure.count == 1 { String::new() } else { format!("{} times{in_all}: ", failure.count) };
        match failure.told.as_slice() {
            [] => format!("{times}{} (the words were lost on the way)", failure.cause),
            [told] => format!("{times}{told}"),
            [told, _] => format!("{times}{told}, and at 1 other place"),
            [told, more @ ..] => format!("{times}{told}, and at {} other places", more.len()),
        }
    };
    // One that was told when it happened, and was the only one of its kind, is not told again.
    let is_news = |failure: &FailureReport| failure.count > 1 || !figures.collector.is_failure_told(failure.cause);
    failures(figures).into_iter().filter(is_news).map(sentence).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::report::tests::{config, figures};
    use terravision_common::event::{Event, EventKind};
    use terravision_common::run::DatabaseConfig;
    use terravision_common::shm::Stage;

    #[test]
    fn failures_are_told_once_for_each_cause_with_why_and_where() {
        let mut figures = figures();
        assert_eq!(NetworkReport::new(&config(), &figures), None, "a folder");
        figures.prefetch.failures[Cause::Timeout.number()] = 7;
        figures.prefetch.failures[Cause::Damaged.number()] = 1;
        figures.prefetch.failures[Cause::Name.number()] = 2;
        figures.prefetch.network_bytes = 2_500_000;
        let told = [
            "timeout no answer: http://h/a",
            "timeout no answer: http://h/b",
            "damaged what came is wrong: http://h/a",
        ];
        for sentence in told {
            for event in Event::text(EventKind::Failure, sentence) {
                figures.collector.take(Stage::Prefetcher, event);
            }
        }
        assert_eq!(
            failure_sentences(&figures),
            [
                "7 times: no answer: http://h/a, and at 1 other place",
                "2 times: name (the words were lost on the way)",
                "what came is wrong: http://h/a",
            ]
        );
        assert_eq!(main_failure(&figures).as_deref(), Some("no answer: http://h/a"));
        // Told when they happened: at the end there are sums alone.
        let mut live = figures.collector.take_untold_failures();
        live.sort();
        assert_eq!(live.iter().map(|(cause, _)| cause.as_str()).collect::<Vec<_>>(), ["damaged", "timeout"]);
        assert_eq!((figures.collector.take_untold_failures().len(), failure_sentences(&figures).len()), (0, 2));
        // What was told before the flight is no news either.
        figures.collector.note_told(&["2 times: the cache is broken: /c".to_owned()]);
        for event in Event::text(EventKind::Failure, "cache the cache is broken: /c") {
            figures.collector.take(Stage::Prefetcher, event);
        }
        assert!(figures.collector.take_untold_failures().is_empty());
        let database =
            DatabaseConfig { location: "http://h/w.tv?key=1".to_owned(), ..DatabaseConfig::folder("x".as_ref()) };
        let report = NetworkReport::new(&RunConfig { database, ..config() }, &figures).unwrap();
        assert!(report.summary().contains("2.5 MB from there"), "{}", report.summary());
        let json = serde_json::to_value(&report).unwrap();
        assert_eq!(json["failures"][0]["told"][1], "no answer: http://h/b");
        assert_eq!((&json["failures"][0]["cause"], &json["failures"][0]["count"]), (&"timeout".into(), &7.into()));
    }
}
