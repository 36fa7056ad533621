//! The parts of a report that are about where tiles came from: the prefetcher, and a database on a
//! server.

use crate::measure::stats::{PrefetchStats, RunStats};
use terravision_common::report::{CacheReport, FailureReport, NetworkReport, Percentiles, PrefetchReport};
use terravision_common::run::RunConfig;
use terravision_store::{Cause, Location};

/// The prefetcher's part of a run.
#[must_use]
pub fn prefetch_part(config: &RunConfig, stats: &RunStats) -> PrefetchReport {
    let PrefetchStats { requested, received, cancelled, bytes, window, .. } = stats.prefetch;
    let round_trips: Vec<f64> = stats.collector.round_trips_ms.iter().copied().map(f64::from).collect();
    PrefetchReport {
        prediction: config.prefetch.prediction.name().to_owned(),
        requested,
        received,
        cancelled,
        bytes,
        window: window.report(),
        round_trip_ms: Percentiles::of(&round_trips),
    }
}

/// The network's part of a run; `None` when the database is on this machine.
#[must_use]
pub fn part(config: &RunConfig, stats: &RunStats) -> Option<NetworkReport> {
    let location = Location::parse(&config.database.location).ok()?;
    if location.as_path().is_some() {
        return None;
    }
    let PrefetchStats { network_requests, network_bytes, cache_pieces, cache_bytes, .. } = stats.prefetch;
    Some(NetworkReport {
        requests: network_requests[0],
        repeated: network_requests[1],
        bytes: network_bytes,
        cache: CacheReport { hits: cache_pieces[0], misses: cache_pieces[1], bytes: cache_bytes },
        failures: failures(stats),
    })
}

fn failures(stats: &RunStats) -> Vec<FailureReport> {
    let counted = Cause::ALL.into_iter().zip(stats.prefetch.failures).filter(|(_, count)| *count > 0);
    counted
        .map(|(cause, count)| FailureReport {
            cause: cause.name().to_owned(),
            count,
            told: stats.collector.failures.of(cause.name()).to_vec(),
        })
        .collect()
}

/// The most frequent failure while the database was read: why, and where.
#[must_use]
pub fn main_failure(stats: &RunStats) -> Option<String> {
    let told = failures(stats).into_iter().filter(|failure| !failure.told.is_empty());
    told.max_by_key(|failure| failure.count).and_then(|failure| failure.told.into_iter().next())
}

/// What went wrong while the database was read, a message for each cause: how often, why, and
/// where.
#[must_use]
pub fn failure_messages(stats: &RunStats) -> Vec<String> {
    let is_told = |failure: &FailureReport| stats.collector.failures.is_told(&failure.cause);
    let message = |failure: FailureReport| {
        let in_all = if is_told(&failure) { " in all" } else { "" };
        let times = if failure.count == 1 { String::new() } else { format!("{} times{in_all}: ", failure.count) };
        match failure.told.as_slice() {
            [] => format!("{times}{} (the event that says more was lost)", failure.cause),
            [told] => format!("{times}{told}"),
            [told, _] => format!("{times}{told}, and at 1 other place"),
            [told, more @ ..] => format!("{times}{told}, and at {} other places", more.len()),
        }
    };
    // One that was told when it happened, and was the only one of its kind, is not told again.
    let is_news = |failure: &FailureReport| failure.count > 1 || !is_told(failure);
    failures(stats).into_iter().filter(is_news).map(message).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::report::report;
    use crate::measure::report::summary::network_summary;
    use crate::measure::report::tests::{config, stats};
    use terravision_common::event::{Event, TextKind};
    use terravision_common::run::DatabaseConfig;
    use terravision_common::shm::Stage;

    #[test]
    fn failures_are_told_once_for_each_cause_with_why_and_where() {
        let mut stats = stats();
        assert_eq!(part(&config(), &stats), None, "a folder");
        stats.prefetch.failures[Cause::Timeout.number()] = 7;
        stats.prefetch.failures[Cause::Damaged.number()] = 1;
        stats.prefetch.failures[Cause::Name.number()] = 2;
        stats.prefetch.network_bytes = 2_500_000;
        let told = [
            "timeout no answer: http://h/a",
            "timeout no answer: http://h/b",
            "damaged what came is wrong: http://h/a",
        ];
        for sentence in told {
            for event in Event::text(TextKind::Failure, sentence) {
                stats.collector.take(Stage::Prefetcher, event);
            }
        }
        assert_eq!(
            failure_messages(&stats),
            [
                "7 times: no answer: http://h/a, and at 1 other place",
                "2 times: name (the event that says more was lost)",
                "what came is wrong: http://h/a",
            ]
        );
        assert_eq!(main_failure(&stats).as_deref(), Some("no answer: http://h/a"));
        // Told when they happened: at the end there are sums alone.
        let mut live = stats.collector.failures.take_untold();
        live.sort();
        assert_eq!(live.iter().map(|(cause, _)| cause.as_str()).collect::<Vec<_>>(), ["damaged", "timeout"]);
        assert_eq!((stats.collector.failures.take_untold().len(), failure_messages(&stats).len()), (0, 2));
        // Failures reported before the flight are not repeated either.
        stats.collector.failures.note_told(&["2 times: the cache is broken: /c".to_owned()]);
        for event in Event::text(TextKind::Failure, "cache the cache is broken: /c") {
            stats.collector.take(Stage::Prefetcher, event);
        }
        assert!(stats.collector.failures.take_untold().is_empty());
        let database =
            DatabaseConfig { location: "http://h/w.tv?key=1".to_owned(), ..DatabaseConfig::folder("x".as_ref()) };
        let report = report(&RunConfig { database, ..config() }, &stats);
        let summary = network_summary(&report).unwrap();
        assert!(summary.contains("2.5 MB from there"), "{summary}");
        let json = serde_json::to_value(&report).unwrap()["network"].clone();
        assert_eq!(json["failures"][0]["told"][1], "no answer: http://h/b");
        assert_eq!((&json["failures"][0]["cause"], &json["failures"][0]["count"]), (&"timeout".into(), &7.into()));
    }
}
