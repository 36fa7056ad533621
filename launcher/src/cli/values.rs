//! Single values of the command line: sizes, ranges, colours. Each says in one sentence what it
//! expected.

use std::str::FromStr;
use std::time::Duration;
use terravision_common::camera::MAX_SIDE_PX;

/// A text is not a value of this kind.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("expected {expected}")]
pub struct ValueError {
    /// What was expected, in words and with an example.
    pub expected: &'static str,
}

/// Width and height of a picture, pixels; both from 1 to [`MAX_SIDE_PX`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PictureSize {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
}

impl FromStr for PictureSize {
    type Err = ValueError;
    fn from_str(text: &str) -> Result<Self, ValueError> {
        let error = ValueError { expected: "WIDTHxHEIGHT, each from 1 to 65536 pixels, e.g. 1280x720" };
        let (width, height) = text.split_once(['x', 'X']).ok_or_else(|| error.clone())?;
        match (whole(width), whole(height)) {
            (Some(width @ 1..=MAX_SIDE_PX), Some(height @ 1..=MAX_SIDE_PX)) => Ok(Self { width, height }),
            _ => Err(error),
        }
    }
}

/// Digits only: `u32::from_str` would also take a plus sign.
fn whole(text: &str) -> Option<u32> {
    text.bytes().all(|b| b.is_ascii_digit()).then(|| text.parse().ok()).flatten()
}

/// Frames from `first` up to, not including, `end`; never empty.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameRange {
    /// First frame.
    pub first: u64,
    /// One past the last frame.
    pub end: u64,
}

impl FromStr for FrameRange {
    type Err = ValueError;
    fn from_str(text: &str) -> Result<Self, ValueError> {
        let error = ValueError { expected: "A..B with A less than B, both whole numbers below 1000000000, e.g. 0..60" };
        let (first, end) = text.split_once("..").ok_or_else(|| error.clone())?;
        match (whole(first), whole(end)) {
            (Some(first), Some(end)) if first < end && end < 1_000_000_000 => {
                Ok(Self { first: first.into(), end: end.into() })
            }
            _ => Err(error),
        }
    }
}

/// A colour, 8 bit per channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rgb(pub [u8; 3]);

impl FromStr for Rgb {
    type Err = ValueError;
    fn from_str(text: &str) -> Result<Self, ValueError> {
        let error = ValueError { expected: "R,G,B, three whole numbers from 0 to 255, e.g. 150,190,235, or #RRGGBB" };
        if let Some(digits) = text.strip_prefix('#') {
            let is_hex = digits.len() == 6 && digits.bytes().all(|digit| digit.is_ascii_hexdigit());
            let [_, r, g, b] = u32::from_str_radix(digits, 16).ok().filter(|_| is_hex).ok_or(error)?.to_be_bytes();
            return Ok(Self([r, g, b]));
        }
        let channels: Option<Vec<u8>> = text.split(',').map(|c| u8::try_from(whole(c.trim())?).ok()).collect();
        channels.and_then(|c| c.try_into().ok()).map(Self).ok_or(error)
    }
}

/// Three finite numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Triple(pub [f64; 3]);

impl FromStr for Triple {
    type Err = ValueError;
    fn from_str(text: &str) -> Result<Self, ValueError> {
        let error = ValueError { expected: "three numbers, e.g. 180,30,5000" };
        numbers(text).and_then(|n| n.try_into().ok()).map(Self).ok_or(error)
    }
}

/// Finite numbers with commas between them.
fn numbers(text: &str) -> Option<Vec<f64>> {
    text.split(',').map(|n| n.trim().parse().ok().filter(|n: &f64| n.is_finite())).collect()
}

/// Two finite numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair(pub [f64; 2]);

impl FromStr for Pair {
    type Err = ValueError;
    fn from_str(text: &str) -> Result<Self, ValueError> {
        let error = ValueError { expected: "X,Y, two numbers, e.g. 560000,4980000" };
        numbers(text).and_then(|n| n.try_into().ok()).map(Self).ok_or(error)
    }
}

/// A place: two coordinates, and a height if it has one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// Easting or longitude.
    pub x: f64,
    /// Northing or latitude.
    pub y: f64,
    /// Height, metres.
    pub z: Option<f64>,
}

impl FromStr for Place {
    type Err = ValueError;
    fn from_str(text: &str) -> Result<Self, ValueError> {
        let error = ValueError { expected: "X,Y or X,Y,Z, two or three numbers, e.g. 560000,4980000,3500" };
        match numbers(text).as_deref() {
            Some(&[x, y]) => Ok(Self { x, y, z: None }),
            Some(&[x, y, z]) => Ok(Self { x, y, z: Some(z) }),
            _ => Err(error),
        }
    }
}

/// Parses the number of `--agl`.
///
/// # Errors
/// [`ValueError`] when it is not a number.
pub fn parse_agl(text: &str) -> Result<f64, ValueError> {
    let error =
        ValueError { expected: "metres, e.g. --agl 150; without a number, --agl stands last or before another flag" };
    text.trim().parse().ok().filter(|m: &f64| m.is_finite()).ok_or(error)
}

/// An amount of memory, bytes; at least one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct MemorySize(pub u64);

impl FromStr for MemorySize {
    type Err = ValueError;
    fn from_str(text: &str) -> Result<Self, ValueError> {
        let error =
            ValueError { expected: "a number of bytes with a unit of KiB, MiB, GiB, KB, MB or GB, e.g. 512MiB" };
        let digits = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
        let factor = match text[digits..].trim().to_ascii_lowercase().as_str() {
            "" | "b" => 1.0,
            "k" | "kib" => 1024.0,
            "m" | "mib" => 1024.0 * 1024.0,
            "g" | "gib" => 1024.0 * 1024.0 * 1024.0,
            "t" | "tib" => 1024.0 * 1024.0 * 1024.0 * 1024.0,
            "kb" => 1e3,
            "mb" => 1e6,
            "gb" => 1e9,
            "tb" => 1e12,
            _ => return Err(error),
        };
        let number: f64 = text[..digits].parse().ok().ok_or_else(|| error.clone())?;
        let bytes = number * factor;
        if (1.0..1e16).contains(&bytes) { Ok(Self(bytes as u64)) } else { Err(error) }
    }
}

/// Parses `--cache-size`: a size, or 0.
///
/// # Errors
/// [`ValueError`] when it is neither.
pub fn parse_cache_size(text: &str) -> Result<MemorySize, ValueError> {
    if text.trim() == "0" { Ok(MemorySize(0)) } else { text.parse() }
}

/// Parses `--timeout`.
///
/// # Errors
/// [`ValueError`] when it is not a number of seconds from 0.1 to 3600.
pub fn parse_timeout(text: &str) -> Result<Duration, ValueError> {
    match text.trim().parse::<f64>() {
        Ok(seconds) if (0.1..=3600.0).contains(&seconds) => Ok(Duration::from_secs_f64(seconds)),
        _ => Err(ValueError { expected: "seconds from 0.1 to 3600" }),
    }
}

/// Parses `--samples`.
///
/// # Errors
/// [`ValueError`] when it is neither 1 nor 4.
pub fn parse_samples(text: &str) -> Result<u32, ValueError> {
    match text {
        "1" => Ok(1),
        "4" => Ok(4),
        _ => Err(ValueError { expected: "1 or 4" }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn sizes_are_two_positive_numbers() {
        assert_eq!("1280x720".parse(), Ok(PictureSize { width: 1280, height: 720 }));
        for text in
            ["0x0", "0x720", "1280x0", "x", "1280", "1280x720x3", "-1x5", "+1x5", "65537x1", "99999999999x1", ""]
        {
            assert!(text.parse::<PictureSize>().is_err(), "{text}");
        }
    }

    #[test]
    fn ranges_are_never_empty() {
        assert_eq!("3..60".parse(), Ok(FrameRange { first: 3, end: 60 }));
        for text in ["60..3", "3..3", "..", "3..", "..3", "3", "-1..4", "3...4", "0..99999999999"] {
            assert!(text.parse::<FrameRange>().is_err(), "{text}");
        }
    }

    #[test]
    fn colours_triples_and_memory() {
        assert_eq!("1, 2,255".parse(), Ok(Rgb([1, 2, 255])));
        assert_eq!("#0a10fF".parse(), Ok(Rgb([10, 16, 255])));
        for text in ["#", "#12345", "#1234567", "#+12345", "#12345g", "#ä1234"] {
            assert!(text.parse::<Rgb>().is_err(), "{text}");
        }
        assert!("1,2,256".parse::<Rgb>().is_err() && "1,2".parse::<Rgb>().is_err() && "".parse::<Rgb>().is_err());
        assert_eq!("-1,2.5,3e3".parse(), Ok(Triple([-1.0, 2.5, 3000.0])));
        assert_eq!("-122.5, 45".parse(), Ok(Place { x: -122.5, y: 45.0, z: None }));
        assert_eq!("1,2,-3".parse(), Ok(Place { x: 1.0, y: 2.0, z: Some(-3.0) }));
        assert!(
            "1".parse::<Place>().is_err() && "1,2,3,4".parse::<Place>().is_err() && "1,,2".parse::<Place>().is_err()
        );
        assert!("1,2".parse::<Pair>().is_ok() && "1,2,3".parse::<Pair>().is_err());
        assert!(parse_agl("80") == Ok(80.0) && parse_agl("w.tv").is_err() && parse_agl("inf").is_err());
        assert!("1,2,nan".parse::<Triple>().is_err() && "1,2,inf".parse::<Triple>().is_err());
        assert_eq!("512MiB".parse(), Ok(MemorySize(512 << 20)));
        assert_eq!("1.5GB".parse(), Ok(MemorySize(1_500_000_000)));
        assert_eq!("100".parse(), Ok(MemorySize(100)));
        assert_eq!(parse_cache_size("0"), Ok(MemorySize(0)));
        assert_eq!(parse_timeout("0.5"), Ok(Duration::from_millis(500)));
        for text in ["0", "-1", "nan", "1e9", "soon"] {
            assert!(parse_timeout(text).is_err(), "{text}");
        }
        for text in ["0", "MiB", "-5MiB", "5XB", "1e400", "...", "99999999999TiB"] {
            assert!(text.parse::<MemorySize>().is_err(), "{text}");
        }
    }

    proptest! {
        #[test]
        fn garbage_never_panics(text in "\\PC{0,20}") {
            drop(text.parse::<PictureSize>());
            drop(text.parse::<FrameRange>());
            drop(text.parse::<Rgb>());
            drop(text.parse::<Triple>());
            drop(text.parse::<Place>());
            drop(text.parse::<MemorySize>());
        }
    }
}
