//! How much memory the processes of a run use, by what `/proc` says of them.

use std::collections::BTreeMap;
use std::fs;
use std::time::{Duration, Instant};

/// Between two looks at the resident sets.
const RSS_EVERY: Duration = Duration::from_millis(50);
/// Between two looks at the proportional sets at least.
const PSS_EVERY: Duration = Duration::from_millis(500);
/// And this many times what the last look took: the kernel walks all pages for them, which is some
/// milliseconds where pools are large.
const PSS_SHARE: u32 = 100;
const KIB: f64 = 1024.0;

/// Peaks of memory by process; MB are 2^20 bytes.
#[derive(Debug, Clone, Default)]
pub struct MemoryPeaks {
    /// Largest resident set of each process, MB.
    pub rss_mb: BTreeMap<String, f64>,
    /// Largest proportional set of each process, MB; shared pages are split among those that map
    /// them.
    pub pss_mb: BTreeMap<String, f64>,
    /// Largest sum of proportional sets at one moment, MB.
    pub pss_total_mb: f64,
    rss_seen: Option<Instant>,
    pss_due: Option<Instant>,
}

impl MemoryPeaks {
    /// Looks at this process and at others (by name and process id), if it is time again.
    pub fn sample<'a>(&mut self, others: impl Iterator<Item = (&'a str, u32)>) {
        let now = Instant::now();
        let is_rss_due = self.rss_seen.is_none_or(|seen| now.duration_since(seen) >= RSS_EVERY);
        let is_pss_due = self.pss_due.is_none_or(|due| now >= due);
        if !is_rss_due && !is_pss_due {
            return;
        }
        let processes: Vec<(&str, u32)> = std::iter::once(("launcher", std::process::id())).chain(others).collect();
        if is_rss_due {
            self.rss_seen = Some(now);
            for (name, pid) in &processes {
                raise(&mut self.rss_mb, name, kib_of(&format!("/proc/{pid}/status"), "VmHWM:"));
            }
        }
        if is_pss_due {
            let mut total = 0.0;
            for (name, pid) in &processes {
                let kib = kib_of(&format!("/proc/{pid}/smaps_rollup"), "Pss:");
                total += kib.unwrap_or(0.0) / KIB;
                raise(&mut self.pss_mb, name, kib);
            }
            self.pss_total_mb = self.pss_total_mb.max(total);
            self.pss_due = Some(now + PSS_EVERY.max(now.elapsed() * PSS_SHARE));
        }
    }
}

fn raise(peaks: &mut BTreeMap<String, f64>, name: &str, kib: Option<f64>) {
    // A process that has just ended has no memory any more: keep what was seen.
    if let Some(kib) = kib {
        let peak = peaks.entry(name.to_owned()).or_insert(0.0);
        *peak = peak.max(kib / KIB);
    }
}

/// The number of kB after a key of a `/proc` file.
fn kib_of(path: &str, key: &str) -> Option<f64> {
    let text = fs::read_to_string(path).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(key))?;
    line.split_whitespace().next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_process_has_memory() {
        let mut peaks = MemoryPeaks::default();
        peaks.sample(std::iter::empty());
        assert!(peaks.rss_mb["launcher"] > 0.5 && peaks.pss_total_mb > 0.1, "{peaks:?}");
        assert!(peaks.pss_mb["launcher"] <= peaks.rss_mb["launcher"] + 1.0);
    }
}
