//! Lines of a stream, in batches: all whole lines that have come.

use std::io::{self, ErrorKind, Read};

/// Longest line, bytes: a request of 100 000 places has 5 MB.
pub(super) const MOST_LINE_BYTES: usize = 8 << 20;
/// Bytes that are read at a time. Pipes give at most 64 KiB.
const CHUNK_BYTES: usize = 256 << 10;

/// A line, without its end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Line<'a> {
    Whole(&'a [u8]),
    /// One that is longer than any may be.
    TooLong,
}

/// What is told of such a line.
pub(super) fn too_long() -> String {
    format!("the line is longer than {} MiB", MOST_LINE_BYTES >> 20)
}

/// The lines of a stream.
#[derive(Debug)]
pub(super) struct Lines<R> {
    input: R,
    buffer: Vec<u8>,
    /// Bytes of the buffer that have come.
    filled: usize,
    /// Whether the line that is read is too long, and its beginning gone.
    is_too_long: bool,
}

impl<R: Read> Lines<R> {
    pub(super) fn new(input: R) -> Self {
        Self { input, buffer: vec![0; CHUNK_BYTES], filled: 0, is_too_long: false }
    }

    /// The stream.
    pub(super) fn input(&self) -> &R {
        &self.input
    }

    /// Whether a line is under way that is too long already.
    pub(super) fn is_too_long(&self) -> bool {
        self.is_too_long
    }

    /// Reads once and hands over the whole lines that have come, if any; at the end of the stream
    /// also one without an end. `false` at the end.
    ///
    /// # Errors
    /// Of the stream, those of a time limit too: what has come is kept.
    pub(super) fn next_batch(&mut self, mut take: impl FnMut(&[Line<'_>])) -> io::Result<bool> {
        if self.filled == self.buffer.len() {
            if self.buffer.len() >= MOST_LINE_BYTES {
                (self.filled, self.is_too_long) = (0, true);
            } else {
                self.buffer.resize(2 * self.buffer.len(), 0);
            }
        }
        let before = self.filled;
        let read = match self.input.read(&mut self.buffer[before..]) {
            Err(error) if error.kind() == ErrorKind::Interrupted => return Ok(true),
            read => read?,
        };
        self.filled += read;
        let is_end = read == 0;
        let new = &self.buffer[before..self.filled];
        let end = match new.iter().rposition(|byte| *byte == b'\n') {
            Some(at) => before + at + 1,
            None if is_end => self.filled,
            None => return Ok(true),
        };
        let whole = &self.buffer[..end];
        let whole = whole.strip_suffix(b"\n").unwrap_or(whole);
        let is_cut = std::mem::take(&mut self.is_too_long);
        if end > 0 || is_cut {
            let line = |(k, text)| if k == 0 && is_cut { Line::TooLong } else { Line::Whole(text) };
            let lines: Vec<Line<'_>> = whole.split(|byte| *byte == b'\n').enumerate().map(line).collect();
            take(&lines);
        }
        self.buffer.copy_within(end..self.filled, 0);
        self.filled -= end;
        Ok(!is_end)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A stream that gives a few bytes at a time.
    struct Drops<'a>(&'a [u8], usize);

    impl Read for Drops<'_> {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            let length = self.1.min(self.0.len()).min(buffer.len());
            buffer[..length].copy_from_slice(&self.0[..length]);
            self.0 = &self.0[length..];
            Ok(length)
        }
    }

    fn all(input: &[u8], step: usize) -> Vec<Option<Vec<u8>>> {
        let mut lines = Lines::new(Drops(input, step));
        let mut found = Vec::new();
        let mut take = |batch: &[Line<'_>]| {
            found.extend(batch.iter().map(|line| match line {
                Line::Whole(text) => Some(text.to_vec()),
                Line::TooLong => None,
            }));
        };
        while lines.next_batch(&mut take).unwrap() {}
        found
    }

    proptest! {
        #[test]
        fn lines_come_whole_however_they_are_cut(lines in prop::collection::vec("[a-z ]{0,12}", 0..30), step in 1usize..50, ended: bool) {
            let mut input = lines.join("\n");
            if ended && !lines.is_empty() {
                input.push('\n');
            }
            let expected: Vec<Option<Vec<u8>>> = input.lines().map(|line| Some(line.as_bytes().to_vec())).collect();
            // A last line needs no end, unless it is empty.
            prop_assert_eq!(all(input.as_bytes(), step), expected);
        }
    }

    #[test]
    fn a_line_that_is_too_long_is_told_and_the_next_one_is_read() {
        let input = [b"1 2\n".to_vec(), vec![b'7'; 3 * MOST_LINE_BYTES], b"\n3 4\n".to_vec()].concat();
        assert_eq!(all(&input, 1 << 20), [Some(b"1 2".to_vec()), None, Some(b"3 4".to_vec())]);
        assert_eq!(all(&input[..input.len() - 5], 1 << 20), [Some(b"1 2".to_vec()), None]);
    }
}
