//! Fuzzing of whatever reads foreign bytes: valid inputs, changed by a seeded generator, again and
//! again.
//!
//! A mutator of our own, since it has to run on stable Rust in every suite, without coverage:
//! there, known fuzzers make inputs from nothing (bolero) or do not run at all (cargo-fuzz), and
//! bytes from nothing do not get past a magic number or a checksum. Here each target brings inputs
//! that are right, and may mend what it has to (a checksum) after they were changed.
//!
//! A short round in the suite is the same each time. `scripts/fuzz.sh SECONDS` runs longer, from
//! another seed each time. An input at which a reader panics, or takes too much memory or time, is
//! kept as a file that the message names; put it into the target's folder below `tests/corpus` when
//! it is mended.

#![expect(clippy::print_stdout, clippy::print_stderr, reason = "a test says what it did, and where its input is kept")]

use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Seconds that each target is run; without it a short round.
pub const SECONDS_VARIABLE: &str = "TERRAVISION_FUZZ_SECONDS";
/// Where the long form begins; told in the message of a failure.
pub const SEED_VARIABLE: &str = "TERRAVISION_FUZZ_SEED";
/// Most changes of one input.
const MOST_CHANGES: u64 = 6;
/// Inputs do not grow beyond this.
const MOST_BYTES: usize = 1 << 20;
/// No reader of a small input works so long, whatever else this machine does.
const LONGEST: Duration = Duration::from_secs(60);

/// Numbers (SplitMix64; Steele, Lea, Flood: Fast splittable pseudorandom number generators, 2014).
#[derive(Debug, Clone)]
pub struct Numbers(u64);

impl Numbers {
    /// The same numbers for the same seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// Any number.
    pub fn any(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A number below `count`; 0 when that is 0.
    pub fn below(&mut self, count: usize) -> usize {
        (self.any() % (count.max(1) as u64)) as usize
    }

    /// One of several.
    pub fn one_of<'a, T>(&mut self, all: &'a [T]) -> Option<&'a T> {
        all.get(self.below(all.len()))
    }
}

/// Words that stand in texts where a number does.
const TEXT_NUMBERS: [&str; 12] =
    ["-1", "0", "1e300", "-1e-300", "NaN", "inf", "99999999999999999999", "-0", "1e5000", "", "180", "0x10"];

/// Changes inputs.
#[derive(Debug)]
pub struct Mutator<'a> {
    numbers: Numbers,
    inputs: &'a [Vec<u8>],
    words: &'a [&'a [u8]],
}

impl<'a> Mutator<'a> {
    /// A mutator of these inputs, which knows these words of their format.
    #[must_use]
    pub fn new(seed: u64, inputs: &'a [Vec<u8>], words: &'a [&'a [u8]]) -> Self {
        Self { numbers: Numbers::new(seed), inputs, words }
    }

    /// One of the inputs, changed in a few places.
    pub fn next_input(&mut self) -> Vec<u8> {
        let mut bytes = self.numbers.one_of(self.inputs).cloned().unwrap_or_default();
        for _ in 0..=self.numbers.any() % MOST_CHANGES {
            self.change(&mut bytes);
        }
        bytes.truncate(MOST_BYTES);
        bytes
    }

    fn change(&mut self, bytes: &mut Vec<u8>) {
        let at = self.numbers.below(bytes.len());
        match self.numbers.below(10) {
            0 if !bytes.is_empty() => bytes[at] ^= 1 << self.numbers.below(8),
            1 if !bytes.is_empty() => {
                bytes[at] = *self.numbers.one_of(&[0, 1, 0x7f, 0x80, 0xff, b'<', b'"', b'\n']).unwrap_or(&0)
            }
            2 | 3 => self.change_number(bytes, at),
            4 => bytes.truncate(at),
            5 => {
                let end = at + self.numbers.below((bytes.len() - at).min(64) + 1);
                bytes.drain(at..end);
            }
            6 => {
                let end = at + self.numbers.below((bytes.len() - at).min(256) + 1);
                let part = bytes[at..end].to_vec();
                let times = 1 + self.numbers.below(if part.len() < 32 { 200 } else { 3 });
                let to = self.numbers.below(bytes.len() + 1);
                bytes.splice(to..to, part.repeat(times));
            }
            7 => {
                let word = self.numbers.one_of(self.words).copied().unwrap_or_default();
                let over = if self.numbers.below(2) == 0 { word.len() } else { 0 };
                let end = (at + over).min(bytes.len());
                bytes.splice(at..end, word.iter().copied());
            }
            8 => {
                let other = self.numbers.one_of(self.inputs).map_or(&[][..], Vec::as_slice);
                let from = self.numbers.below(other.len());
                let end = from + self.numbers.below(other.len() - from + 1);
                bytes.splice(at.., other[from..end].iter().copied());
            }
            _ => self.change_text_number(bytes, at),
        }
    }

    /// A binary number of 2, 4 or 8 bytes, of either byte order.
    fn change_number(&mut self, bytes: &mut [u8], at: usize) {
        let width = *self.numbers.one_of(&[2usize, 4, 8]).unwrap_or(&4);
        let Some(place) = bytes.get_mut(at..at + width) else { return };
        let mut word = [0; 8];
        word[..width].copy_from_slice(place);
        let old = u64::from_le_bytes(word);
        let any = self.numbers.any();
        let candidates =
            [0, 1, u64::MAX, u64::MAX >> 1, 1 << 31, 1 << 40, old.wrapping_add(1), old.wrapping_sub(1), old << 8, any];
        let new = *self.numbers.one_of(&candidates).unwrap_or(&0);
        let is_big_endian = self.numbers.below(4) == 0;
        let new = if is_big_endian { new.to_be_bytes() } else { new.to_le_bytes() };
        let from = if is_big_endian { 8 - width } else { 0 };
        place.copy_from_slice(&new[from..from + width]);
    }

    /// The next number in a text.
    fn change_text_number(&mut self, bytes: &mut Vec<u8>, at: usize) {
        let is_digit = |byte: &u8| byte.is_ascii_digit() || b"+-.eE".contains(byte);
        let Some(start) = bytes[at..].iter().position(u8::is_ascii_digit).map(|found| at + found) else { return };
        let end = bytes[start..].iter().position(|byte| !is_digit(byte)).map_or(bytes.len(), |found| start + found);
        let word = self.numbers.one_of(&TEXT_NUMBERS).copied().unwrap_or_default();
        bytes.splice(start..end, word.bytes());
    }
}

/// A reader that is fuzzed.
#[derive(Debug)]
pub struct Target<'a> {
    /// Its name, and that of its folder below `tests/corpus`.
    pub name: &'a str,
    /// Inputs that are right; those of the folder are added.
    pub inputs: Vec<Vec<u8>>,
    /// Words of the format.
    pub words: &'a [&'a [u8]],
    /// Inputs of a short round.
    pub short_round: u64,
}

impl Target<'_> {
    /// Gives `read` the inputs as they are, and then changed ones, until the round is over.
    ///
    /// # Panics
    /// When `read` does, or takes longer than any input is worth.
    pub fn run(&self, mut read: impl FnMut(&[u8])) {
        let mut inputs = self.inputs.clone();
        inputs.extend(corpus(self.name));
        assert!(!inputs.is_empty(), "{}: there is nothing to change", self.name);
        let seconds = std::env::var(SECONDS_VARIABLE).ok().and_then(|text| text.parse::<f64>().ok());
        let seed = std::env::var(SEED_VARIABLE).ok().and_then(|text| text.parse().ok()).unwrap_or(1);
        let watched = Watched::new(self.name);
        let begin = Instant::now();
        let mut mutator = Mutator::new(seed, &inputs, self.words);
        let is_over = |count: u64| match seconds {
            Some(seconds) => begin.elapsed().as_secs_f64() >= seconds,
            None => count >= self.short_round,
        };
        let mut count = 0;
        for input in &inputs {
            watched.look(input, seed, &mut read);
        }
        while !is_over(count) {
            watched.look(&mutator.next_input(), seed, &mut read);
            count += 1;
        }
        if seconds.is_some() {
            println!("{}: {count} inputs from seed {seed}, {} of them the corpus", self.name, inputs.len());
        }
    }
}

/// The files of a target's corpus.
///
/// # Panics
/// When a file cannot be read.
#[must_use]
pub fn corpus(name: &str) -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(name);
    let Ok(entries) = fs::read_dir(&folder) else { return Vec::new() };
    let mut paths: Vec<PathBuf> = entries.filter_map(|entry| entry.ok().map(|entry| entry.path())).collect();
    // The same order everywhere: inputs follow from it.
    paths.sort();
    paths.iter().map(|path| fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))).collect()
}

/// Keeps inputs that break something.
struct Watched {
    file: PathBuf,
}

impl Watched {
    fn new(name: &str) -> Self {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        // Relaxed: the number only has to differ.
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        Self { file: crate::folder::target_tmp().join(format!("fuzz-{name}-{}-{number}", std::process::id())) }
    }

    fn look(&self, input: &[u8], seed: u64, read: &mut impl FnMut(&[u8])) {
        let begin = Instant::now();
        let outcome = catch_unwind(AssertUnwindSafe(|| read(input)));
        let is_slow = begin.elapsed() > LONGEST;
        if outcome.is_err() || is_slow {
            fs::write(&self.file, input).unwrap_or_else(|error| panic!("{}: {error}", self.file.display()));
            eprintln!("this input of {} bytes (seed {seed}) is kept: {}", input.len(), self.file.display());
        }
        if let Err(panic) = outcome {
            resume_unwind(panic);
        }
        assert!(!is_slow, "reading took {:.1} s", begin.elapsed().as_secs_f64());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inputs_differ_and_are_the_same_for_the_same_seed() {
        let inputs = [b"<a n=\"12\">text 3.5</a>".to_vec(), vec![0, 1, 2, 3, 4, 5, 6, 7, 8]];
        let words: [&[u8]; 1] = [b"<!--"];
        let take = |seed| {
            let mut mutator = Mutator::new(seed, &inputs, &words);
            (0..500).map(|_| mutator.next_input()).collect::<Vec<_>>()
        };
        let first = take(7);
        assert_eq!(first, take(7));
        assert_ne!(first, take(8));
        let distinct: std::collections::BTreeSet<_> = first.iter().collect();
        assert!(distinct.len() > 400, "{}", distinct.len());
        assert!(first.iter().any(|input| input.windows(4).any(|at| at == b"<!--")));
        assert!(first.iter().any(|input| input.windows(5).any(|at| at == b"1e300")));
    }

    #[test]
    fn an_input_that_breaks_a_reader_is_kept() {
        let target = Target { name: "self-test", inputs: vec![b"abcdefgh".to_vec()], words: &[], short_round: 2000 };
        let kept = Watched::new("self-test-kept");
        let broken = catch_unwind(AssertUnwindSafe(|| kept.look(b"boom", 1, &mut |_: &[u8]| panic!("broken"))));
        assert!(broken.is_err());
        assert_eq!(fs::read(&kept.file).unwrap_or_default(), b"boom");
        fs::remove_file(&kept.file).unwrap_or_default();
        let mut shortest = usize::MAX;
        target.run(|input| shortest = shortest.min(input.len()));
        assert!(shortest < 3);
    }
}
