//! What a client's link carries, from how long its pictures take to be acknowledged.

use crate::encoder::median;
use std::collections::VecDeque;

/// Pictures that decide.
const DECIDING: usize = 6;
/// Smaller files say nothing about the link, bytes.
const LEAST_BYTES: usize = 6 << 10;
/// Round trips that the median is of.
const KEPT_ROUND_TRIPS: usize = 9;
/// Over a faster link pictures stay JPEG, bytes a second: H.264 would have as many.
const FAST: f64 = 750e3;
/// A link that carries this many times what JPEG needs goes back to JPEG.
const AMPLE: f64 = 2.0;
/// The new share of an average.
const NEW_SHARE: f64 = 0.2;

/// What a link carries.
#[derive(Debug, Default)]
pub(crate) struct LinkRate {
    round_trips_ms: VecDeque<f64>,
    /// Bytes a second of the last pictures.
    rates: VecDeque<f64>,
    /// Bytes of a moving JPEG, on the average.
    jpeg_bytes: Option<f64>,
}

impl LinkRate {
    /// A message without content took this long, there and back.
    pub(crate) fn note_round_trip(&mut self, ms: f64) {
        push(&mut self.round_trips_ms, ms, KEPT_ROUND_TRIPS);
    }

    /// A moving JPEG has this many bytes.
    pub(crate) fn note_jpeg(&mut self, bytes: usize) {
        let before = self.jpeg_bytes.unwrap_or(bytes as f64);
        self.jpeg_bytes = Some(before + NEW_SHARE * (bytes as f64 - before));
    }

    /// A picture was acknowledged after some time, of which the client took some to show it.
    pub(crate) fn note_picture(&mut self, bytes: usize, took_ms: f64, shown_ms: f64) {
        // Of a link whose round trip is not known all time would seem to be due to its rate.
        let Some(round_trip) = median(&self.round_trips_ms) else { return };
        if bytes >= LEAST_BYTES {
            let way_ms = (took_ms - round_trip - shown_ms.max(0.0)).max(1.0);
            push(&mut self.rates, bytes as f64 / way_ms * 1e3, DECIDING);
        }
    }

    /// Bytes a second.
    pub(crate) fn bytes_per_s(&self) -> Option<f64> {
        median(&self.rates)
    }

    /// Whether pictures are to be video, when they were `is_video` before: several in a row say so.
    pub(crate) fn wants_video(&self, is_video: bool, fps: f64) -> bool {
        let Some(jpeg_bytes) = self.jpeg_bytes.filter(|_| self.rates.len() == DECIDING) else { return is_video };
        let needed = (jpeg_bytes * fps).min(FAST);
        if is_video {
            !self.rates.iter().all(|rate| *rate > AMPLE * needed)
        } else {
            self.rates.iter().all(|rate| *rate < needed)
        }
    }
}

fn push(kept: &mut VecDeque<f64>, value: f64, most: usize) {
    if kept.len() >= most {
        kept.pop_front();
    }
    kept.push_back(value);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A link with a round trip of 100 ms that carries this many bytes a second, after some JPEGs of 30 kB.
    fn link(bytes_per_s: f64) -> LinkRate {
        let mut link = LinkRate::default();
        link.note_round_trip(100.0);
        for _ in 0..DECIDING {
            link.note_jpeg(30_000);
            link.note_picture(30_000, 100.0 + 12.0 + 30_000.0 / bytes_per_s * 1e3, 12.0);
        }
        link
    }

    #[test]
    fn a_slow_link_wants_video_and_a_far_one_does_not() {
        // 30 a second are 900 kB/s.
        for (bytes_per_s, wants) in [(100e3, true), (500e3, true), (850e3, false), (50e6, false)] {
            let link = link(bytes_per_s);
            assert_eq!(link.wants_video(false, 30.0), wants, "{bytes_per_s}");
            assert!((link.bytes_per_s().unwrap() / bytes_per_s).ln().abs() < 0.7, "{link:?}");
        }
        // 5 a second are 150 kB/s.
        assert!(!link(200e3).wants_video(false, 5.0));
    }

    #[test]
    fn video_ends_when_the_link_is_ample_and_begins_after_several_pictures() {
        assert!(link(1e6).wants_video(true, 30.0) && !link(2e6).wants_video(true, 30.0));
        let mut new = LinkRate::default();
        new.note_jpeg(30_000);
        new.note_picture(30_000, 500.0, 0.0);
        new.note_round_trip(1.0);
        new.note_picture(30_000, 500.0, 0.0);
        new.note_picture(100, 500.0, 0.0);
        assert!(!new.wants_video(false, 30.0) && new.bytes_per_s() == Some(30_000.0 / 499.0 * 1e3));
    }
}
