//! Values of a property over time: pieces with an interval each, of samples with a time, or of one
//! value all the time.

use super::super::gpx::MAX_POINTS;
use super::super::raw_json::{self, fields, number};
use super::super::{PathError, printable};
use super::time;
use serde_json::value::RawValue;
use std::path::Path;

/// Most seconds from the epoch.
const MAX_SECONDS: f64 = 1e10;
/// All the time.
const ALWAYS: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];

/// Makes a value of the numbers of a form; what it expects is its error.
type Read<'r, T> = dyn Fn(&str, &[f64]) -> Result<T, &'static str> + 'r;

/// A property whose values vary with time.
pub(super) struct Property {
    /// Its name.
    pub(super) name: &'static str,
    /// Names of its values, in the form that is looked for first, and how many numbers each has.
    pub(super) forms: &'static [(&'static str, usize)],
}

/// What a property is in one interval: times that grow with their values, of the same length; of a
/// constant no time and one value.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Piece<T> {
    pub(super) interval: [f64; 2],
    pub(super) times: Vec<f64>,
    pub(super) values: Vec<T>,
    /// How it is interpolated, if not on straight lines.
    pub(super) polynomial: Option<String>,
}

/// Where a property stands, for messages, and how much may be read of it.
pub(super) struct PropertyReader<'a> {
    pub(super) path: &'a Path,
    /// The packet.
    pub(super) place: String,
    pub(super) property: &'a Property,
    /// Samples until now.
    pub(super) count: usize,
}

/// How many values a property has: none, a constant, or some over time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Extent {
    None,
    Constant,
    Varying,
}

/// Looks at a property without reading its values.
pub(super) fn extent(raw: &RawValue, property: &Property) -> Extent {
    let mut extent = Extent::None;
    let mut pieces = 0;
    let mut look = |piece: &RawValue| {
        for &(name, width) in property.forms {
            let Some(list) = fields(piece.get(), &[name]).ok().and_then(|found| found[0]) else { continue };
            let mut count = 0;
            let each = |_, _: &RawValue| {
                count += 1;
                if count > width { Err(()) } else { Ok(()) }
            };
            let is_long = matches!(raw_json::each(list.get(), each), Ok(Err(())));
            pieces += 1;
            extent = extent.max(if is_long || pieces > 1 { Extent::Varying } else { Extent::Constant });
        }
    };
    if raw_json::is_list(raw) {
        let each = |_, piece: &RawValue| {
            look(piece);
            Ok::<(), ()>(())
        };
        // What is wrong with it is told when it is read.
        drop(raw_json::each(raw.get(), each));
    } else {
        look(raw);
    }
    extent
}

impl PropertyReader<'_> {
    pub(super) fn bad(&self, key: &str, expected: &'static str, found: String) -> PathError {
        let key = format!("{}: {key}", self.property.name);
        PathError::BadValue { path: self.path.to_owned(), place: self.place.clone(), key, expected, found }
    }

    fn json(&self, source: serde_json::Error) -> PathError {
        PathError::Json { path: self.path.to_owned(), source }
    }

    /// The pieces of a property, in the order of the file.
    pub(super) fn pieces<T>(&mut self, raw: &RawValue, read: &Read<'_, T>) -> Result<Vec<Piece<T>>, PathError> {
        let mut pieces = Vec::new();
        if !raw_json::is_list(raw) {
            pieces.extend(self.piece(raw, read)?);
            return Ok(pieces);
        }
        let outcome = raw_json::each(raw.get(), |_, piece| {
            pieces.extend(self.piece(piece, read)?);
            Ok(())
        });
        outcome.map_err(|source| self.json(source))??;
        Ok(pieces)
    }

    /// One piece; none where it has no value of a form that is known.
    fn piece<T>(&mut self, raw: &RawValue, read: &Read<'_, T>) -> Result<Option<Piece<T>>, PathError> {
        const KEYS: [&str; 4] = ["interval", "epoch", "interpolationAlgorithm", "interpolationDegree"];
        let expected = "an object, or a list of objects with an interval each";
        let Ok([interval, epoch, algorithm, degree]) = fields(raw.get(), &KEYS) else {
            return Err(self.bad("the value", expected, printable(raw.get())));
        };
        let form = self.property.forms.iter().find_map(|&(name, width)| {
            let list = fields(raw.get(), &[name]).ok()?[0]?;
            Some((name, width, list))
        });
        let Some((name, width, list)) = form else { return Ok(None) };
        let read_text = |raw: Option<&RawValue>| raw.map(|raw| raw_json::text(raw).unwrap_or_default());
        let interval = read_text(interval).map_or(Some(ALWAYS), |text| time::interval(&text));
        let Some(interval) = interval else {
            let expected = "an interval like 2024-05-01T10:00:00Z/2024-05-01T11:00:00Z";
            return Err(self.bad("interval", expected, found(raw, "interval")));
        };
        let Some(epoch) = read_text(epoch).map_or(Some(0.0), |text| time::seconds(&text)) else {
            return Err(self.bad("epoch", "a time like 2024-05-01T10:00:00Z", found(raw, "epoch")));
        };
        let polynomial = match read_text(algorithm).as_deref() {
            None | Some("LINEAR") => None,
            Some(name @ ("LAGRANGE" | "HERMITE")) => {
                let degree = degree.and_then(number).unwrap_or(1.0);
                (degree > 1.0).then(|| format!("a {name} polynomial of degree {degree}"))
            }
            Some(_) => {
                let key = "interpolationAlgorithm";
                return Err(self.bad(key, "LINEAR, LAGRANGE or HERMITE", found(raw, key)));
            }
        };
        let mut piece = Piece { interval, times: Vec::new(), values: Vec::new(), polynomial };
        let mut group = Group { reader: self, name, width, epoch, numbers: Vec::new(), t: None, count: 0 };
        let outcome = raw_json::each(list.get(), |_, token| group.take(token, read, &mut piece));
        let outcome = outcome.map_err(|_no_list| group.bad(printable(list.get())))?;
        outcome.and_then(|()| group.finish(read, &mut piece))?;
        Ok(Some(piece))
    }
}

/// The value of a key, for a message.
fn found(raw: &RawValue, key: &str) -> String {
    fields(raw.get(), &[key]).ok().and_then(|found| found[0]).map_or("nothing".into(), |raw| printable(raw.get()))
}

/// Reads a list of numbers: those of one value, or of samples with a time before each.
struct Group<'r, 'a> {
    reader: &'r mut PropertyReader<'a>,
    name: &'static str,
    width: usize,
    epoch: f64,
    /// Those that wait for the rest of their sample.
    numbers: Vec<f64>,
    /// The time before them, if the first was a time in words.
    t: Option<f64>,
    /// Of all values that were read.
    count: usize,
}

impl Group<'_, '_> {
    fn bad(&self, found: String) -> PathError {
        const THREE: &str = "a list of 3 numbers, or of a time and 3 numbers for each sample";
        const FOUR: &str = "a list of 4 numbers, or of a time and 4 numbers for each sample";
        const SIX: &str = "a list of 6 numbers, or of a time and 6 numbers for each sample";
        let expected = match self.width {
            3 => THREE,
            4 => FOUR,
            _ => SIX,
        };
        self.reader.bad(&format!("{:?}", self.name), expected, found)
    }

    fn sample_bad(&self, expected: &'static str, found: String) -> PathError {
        let sample = self.count / (self.width + 1);
        self.reader.bad(&format!("{:?}: sample {sample}", self.name), expected, found)
    }

    fn take<T>(&mut self, token: &RawValue, read: &Read<'_, T>, piece: &mut Piece<T>) -> Result<(), PathError> {
        let is_first = self.numbers.is_empty();
        if is_first && let Some(text) = raw_json::text(token) {
            let t = time::seconds(&text);
            let t = t.ok_or_else(|| self.sample_bad("a time like 2024-05-01T10:00:00Z", printable(token.get())))?;
            self.t = Some(t);
            self.numbers.push(0.0);
        } else {
            let number = number(token);
            let number = number.ok_or_else(|| self.sample_bad("a number", printable(token.get())))?;
            self.numbers.push(number);
        }
        self.count += 1;
        if self.numbers.len() <= self.width {
            return Ok(());
        }
        self.reader.count += 1;
        if self.reader.count > MAX_POINTS {
            return Err(self.reader.bad(
                &format!("{:?}", self.name),
                "at most 1000000 samples in a file",
                "more".into(),
            ));
        }
        self.count -= 1;
        let seconds = self.numbers[0];
        if self.t.is_none() && seconds.abs() > MAX_SECONDS {
            return Err(self.sample_bad("seconds from -10000000000 to 10000000000", seconds.to_string()));
        }
        let t = self.t.take().unwrap_or(self.epoch + seconds);
        if let Some(last) = piece.times.last().filter(|last| t < **last) {
            let found = format!("{} s before the sample before", last - t);
            return Err(self.sample_bad("a time after that of the sample before", found));
        }
        let value = read(self.name, &self.numbers[1..]);
        let value = value.map_err(|expected| self.sample_bad(expected, listed(&self.numbers[1..])))?;
        self.count += 1;
        self.numbers.clear();
        // Of samples of one time the first counts.
        if piece.times.last() != Some(&t) {
            piece.times.push(t);
            piece.values.push(value);
        }
        Ok(())
    }

    /// The end of the list.
    fn finish<T>(mut self, read: &Read<'_, T>, piece: &mut Piece<T>) -> Result<(), PathError> {
        match self.numbers.len() {
            0 if self.count > 0 => Ok(()),
            n if n == self.width && self.count == n && self.t.is_none() => {
                let value = read(self.name, &self.numbers);
                let expected = |expected| self.reader.bad(&format!("{:?}", self.name), expected, listed(&self.numbers));
                piece.values.push(value.map_err(expected)?);
                Ok(())
            }
            _ => {
                let count = std::mem::take(&mut self.count);
                Err(self.bad(if count == 0 { "an empty list".into() } else { format!("{count} values") }))
            }
        }
    }
}

fn listed(numbers: &[f64]) -> String {
    format!("{numbers:?}")
}

/// Pieces in the order of time: those of one interval together, with their samples in order; where
/// two overlap, the later one counts.
pub(super) fn in_order<T: Clone>(pieces: Vec<Piece<T>>) -> Vec<Piece<T>> {
    let mut merged: Vec<Piece<T>> = Vec::new();
    for piece in pieces {
        let known = merged.iter_mut().rev().take(2).find(|known| known.interval == piece.interval);
        match known {
            Some(known) if !known.times.is_empty() && !piece.times.is_empty() => known.join(piece),
            Some(known) => *known = piece,
            None => merged.push(piece),
        }
    }
    merged.iter_mut().for_each(Piece::sort);
    merged.sort_by(|a, b| a.interval[0].total_cmp(&b.interval[0]));
    for i in 1..merged.len() {
        let start = merged[i].interval[0];
        let before = &mut merged[i - 1].interval;
        before[1] = before[1].min(start);
    }
    merged
}

impl<T: Clone> Piece<T> {
    fn join(&mut self, other: Self) {
        self.times.extend(other.times);
        self.values.extend(other.values);
        self.polynomial = self.polynomial.take().or(other.polynomial);
    }

    /// Brings samples of several packets in order.
    fn sort(&mut self) {
        if self.times.windows(2).all(|pair| pair[0] < pair[1]) {
            return;
        }
        let mut order: Vec<usize> = (0..self.times.len()).collect();
        order.sort_by(|a, b| self.times[*a].total_cmp(&self.times[*b]));
        order.dedup_by(|next, first| self.times[*next] == self.times[*first]);
        self.values = order.iter().map(|i| self.values[*i].clone()).collect();
        self.times = order.iter().map(|i| self.times[*i]).collect();
    }

    /// The value at a moment, by two neighbours; before the first and after the last these.
    pub(super) fn value(&self, t: f64, between: impl Fn(&T, &T, f64) -> T) -> Option<T> {
        let after = self.times.partition_point(|time| *time <= t);
        let (Some(before), Some(next)) = (after.checked_sub(1), self.times.get(after)) else {
            return self.values.get(after.saturating_sub(1)).cloned();
        };
        let from = self.times[before];
        Some(between(&self.values[before], &self.values[after], (t - from) / (next - from)))
    }

    /// The part of it within a span of time, with values at the span's ends where it goes on there;
    /// `None` where there is nothing of it.
    pub(super) fn within(&self, span: [f64; 2], between: impl Fn(&T, &T, f64) -> T) -> Option<Self> {
        let interval = [self.interval[0].max(span[0]), self.interval[1].min(span[1])];
        let [from, to] = interval;
        if from > to {
            return None;
        }
        let mut part = Self { interval, times: Vec::new(), values: Vec::new(), polynomial: self.polynomial.clone() };
        let (Some(first), Some(last)) = (self.times.first().copied(), self.times.last().copied()) else {
            part.values.clone_from(&self.values);
            return Some(part);
        };
        let mut push = |t: f64, value: Option<T>| {
            if let Some(value) = value.filter(|_| part.times.last() != Some(&t)) {
                part.times.push(t);
                part.values.push(value);
            }
        };
        if from > last || to < first {
            return None;
        }
        if from > first {
            push(from, self.value(from, &between));
        }
        let inner = self.times.iter().zip(&self.values).filter(|(t, _)| (from..=to).contains(*t));
        inner.for_each(|(t, value)| push(*t, Some(value.clone())));
        if to < last {
            push(to, self.value(to, &between));
        }
        Some(part)
    }
}
