//! What was measured, against what was wanted; as a table, as JSON.

use serde::Serialize;
use std::fmt;

/// A wish that a value is compared with. Missing it is told; a bench fails for it only when that is
/// asked for (`--strict`), because the machine may just be busy.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Target {
    /// The value is to be at most this.
    AtMost(f64),
    /// The value is to be at least this.
    AtLeast(f64),
}

impl Target {
    /// Whether a value is as wanted.
    #[must_use]
    pub fn is_met_by(self, value: f64) -> bool {
        match self {
            Self::AtMost(limit) => value <= limit,
            Self::AtLeast(limit) => value >= limit,
        }
    }
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::AtMost(limit) => write!(f, "<= {}", short(*limit)),
            Self::AtLeast(limit) => write!(f, ">= {}", short(*limit)),
        }
    }
}

/// One number.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Measurement {
    /// The verb that measured it.
    pub bench: &'static str,
    /// What it is.
    pub name: String,
    /// Its value.
    pub value: f64,
    /// Its unit.
    pub unit: &'static str,
    /// What it is to be, if that was said.
    pub target: Option<Target>,
    /// How many samples it is the median or the sum of.
    pub samples: u64,
}

impl Measurement {
    /// A number without a target.
    #[must_use]
    pub fn new(bench: &'static str, name: impl Into<String>, value: f64, unit: &'static str, samples: u64) -> Self {
        Self { bench, name: name.into(), value, unit, target: None, samples }
    }

    /// The same with a target.
    #[must_use]
    pub fn with_target(self, target: Target) -> Self {
        Self { target: Some(target), ..self }
    }

    /// "ok", "missed" or "".
    #[must_use]
    pub fn verdict(&self) -> &'static str {
        match self.target {
            None => "",
            Some(target) if target.is_met_by(self.value) => "ok",
            Some(_) => "missed",
        }
    }
}

/// How many of the targets are met, and which are not, in a line; `None` without targets.
#[must_use]
pub fn summary(measurements: &[Measurement]) -> Option<(String, bool)> {
    let of: Vec<&Measurement> = measurements.iter().filter(|m| m.target.is_some()).collect();
    let missed: Vec<String> =
        of.iter().filter(|m| m.verdict() == "missed").map(|m| format!("{} ({})", m.name, short(m.value))).collect();
    let (all, met) = (of.len(), of.len() - missed.len());
    let rest = if missed.is_empty() { String::new() } else { format!("; missed: {}", missed.join(", ")) };
    (all > 0).then(|| (format!("{met} of {all} targets met{rest}"), missed.is_empty()))
}

/// A number with four digits that matter.
#[must_use]
pub fn short(value: f64) -> String {
    let magnitude = value.abs();
    match magnitude {
        _ if !value.is_finite() => "-".to_owned(),
        m if m >= 1e9 => format!("{:.2} G", value / 1e9),
        m if m >= 1e6 => format!("{:.2} M", value / 1e6),
        m if m >= 1e4 => format!("{:.1} k", value / 1e3),
        m if m >= 100.0 => format!("{value:.0}"),
        m if m >= 10.0 => format!("{value:.1}"),
        m if m >= 0.001 || m == 0.0 => format!("{value:.3}"),
        _ => format!("{value:.2e}"),
    }
}

/// The table that people read.
#[must_use]
pub fn table(measurements: &[Measurement]) -> String {
    let mut rows = vec![["bench", "what", "measured", "unit", "target", "verdict", "samples"].map(str::to_owned)];
    for m in measurements {
        let target = m.target.map(|t| t.to_string()).unwrap_or_default();
        rows.push([
            m.bench.to_owned(),
            m.name.clone(),
            short(m.value),
            m.unit.to_owned(),
            target,
            m.verdict().to_owned(),
            m.samples.to_string(),
        ]);
    }
    let widths: [usize; 7] =
        std::array::from_fn(|c| rows.iter().map(|row| row[c].chars().count()).max().unwrap_or_default());
    let mut text = String::new();
    for row in rows {
        let line: Vec<String> = row
            .iter()
            .zip(widths)
            .enumerate()
            .map(|(column, (cell, width))| match column {
                // Numbers to the right.
                2 | 6 => format!("{cell:>width$}"),
                _ => format!("{cell:<width$}"),
            })
            .collect();
        text.push_str(line.join("  ").trim_end());
        text.push('\n');
    }
    text
}

/// Median of some values; NaN of none.
#[must_use]
pub fn median(values: &[f64]) -> f64 {
    quantile(values, 0.5)
}

/// The value that a share `q` of them does not exceed; NaN of none.
#[must_use]
pub fn quantile(values: &[f64], q: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = ((sorted.len() as f64 - 1.0) * q).round().max(0.0) as usize;
    sorted.get(at).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn verdicts_follow_targets() {
        let m = Measurement::new("queues", "hand-over", 12.0, "us", 3);
        assert_eq!(m.verdict(), "");
        assert_eq!(m.clone().with_target(Target::AtMost(20.0)).verdict(), "ok");
        assert_eq!(m.clone().with_target(Target::AtLeast(20.0)).verdict(), "missed");
        let text = table(&[m.with_target(Target::AtMost(20.0))]);
        assert!(text.contains("12.0") && text.contains("<= 20.0") && text.lines().count() == 2, "{text}");
    }

    #[test]
    fn quantiles_of_few_and_none() {
        assert!(median(&[]).is_nan());
        assert_eq!(median(&[3.0, 1.0, 2.0]), 2.0);
        assert_eq!(quantile(&[5.0, 1.0], 1.0), 5.0);
    }
}
