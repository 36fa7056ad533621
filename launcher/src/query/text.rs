//! Questions and answers as lines of text.

use super::question::{Asker, Found, Given, Refusal, Reply, Terms};
use terravision_common::ground::Answer;
use terravision_common::terminal::printable;

/// Letters of a line that are repeated in the answer to one that cannot be understood.
const SHOWN: usize = 40;

/// The numbers of a line: separated by blanks, tabs, commas or semicolons; what follows them is
/// passed over.
pub(super) fn parse(line: &[u8], terms: &Terms) -> Given {
    let is_pair = terms.question.expected().starts_with("x1");
    let (least, most) = if is_pair { (6, 6) } else { (2, 3) };
    let mut numbers = [0.0; 6];
    let mut count = 0;
    let is_separator = |byte: &u8| matches!(byte, b' ' | b'\t' | b',' | b';' | b'\r');
    for word in line.split(is_separator).filter(|word| !word.is_empty()) {
        if count == most {
            break;
        }
        match std::str::from_utf8(word).ok().and_then(|word| word.parse::<f64>().ok()) {
            Some(number) if number.is_finite() => numbers[count] = number,
            // Behind the two of a place there may be anything.
            None if count >= least => break,
            _ => return Err(wrong(terms, &format!("{:?} is not a finite number", shown(word)))),
        }
        count += 1;
    }
    if count < least {
        return Err(wrong(terms, &format!("found {count} {}", if count == 1 { "number" } else { "numbers" })));
    }
    Ok((numbers, count))
}

fn wrong(terms: &Terms, found: &str) -> String {
    format!("expected {}: {found}", terms.question.expected())
}

fn shown(word: &[u8]) -> String {
    let text: String = String::from_utf8_lossy(&word[..word.len().min(4 * SHOWN)]).chars().take(SHOWN).collect();
    printable(&text).into_owned()
}

/// Answers lines of text, an answer for each.
pub(super) fn answer(asker: &mut Asker<'_>, terms: &Terms, given: Vec<Given>, out: &mut Vec<u8>) {
    let mut replies = Vec::with_capacity(given.len());
    asker.answer_all(terms, given, &mut replies);
    replies.iter().for_each(|reply| put_reply(out, reply, terms));
}

fn put_reply(out: &mut Vec<u8>, reply: &Reply, terms: &Terms) {
    match reply {
        Err(refusal) => {
            out.extend(refusal.status().as_bytes());
            if let Refusal::Bad(sentence) = refusal {
                out.push(b' ');
                out.extend(sentence.replace(['\n', '\r'], " ").as_bytes());
            }
        }
        Ok(Answer { found, is_finest }) => put_found(out, found, *is_finest, terms),
    }
    out.push(b'\n');
}

fn put_found(out: &mut Vec<u8>, found: &Found, is_finest: bool, terms: &Terms) {
    let place = |out: &mut Vec<u8>, [x, y, z]: [f64; 3]| {
        let decimals = if terms.is_lonlat { 8 } else { 3 };
        put(out, &[x, y], decimals);
        put(out, &[z], 3);
    };
    match found {
        Found::Ground { height_m, normal, above_m, is_measured } => {
            out.extend(if *is_measured { &b"ok"[..] } else { b"made-up" });
            put(out, &[*height_m], 3);
            put(out, &normal.to_array(), 6);
            above_m.iter().for_each(|above_m| put(out, &[*above_m], 3));
        }
        Found::Visible { distance_m } => {
            out.extend(b"visible");
            put(out, &[*distance_m], 3);
        }
        Found::Hidden { distance_m, at } => {
            out.extend(b"hidden");
            put(out, &[*distance_m], 3);
            place(out, *at);
        }
        Found::Free => out.extend(b"free"),
        Found::Touch { distance_m, center, contact, normal } => {
            out.extend(b"touch");
            put(out, &[*distance_m], 3);
            place(out, *center);
            place(out, *contact);
            put(out, &normal.to_array(), 6);
        }
    }
    if !is_finest {
        out.extend(b" coarser");
    }
}

/// Numbers with this many decimals, each behind a blank. By whole numbers, where they are small
/// enough: the library's way takes four times as long.
fn put(out: &mut Vec<u8>, numbers: &[f64], decimals: u32) {
    let factor = 10u64.pow(decimals);
    for number in numbers {
        out.push(b' ');
        let scaled = (number.abs() * factor as f64).round();
        if scaled.is_nan() || scaled >= 1e15 {
            out.extend(format!("{number:.*}", decimals as usize).as_bytes());
            continue;
        }
        let scaled = scaled as u64;
        if *number < 0.0 && scaled > 0 {
            out.push(b'-');
        }
        put_whole(out, scaled / factor, 1);
        out.push(b'.');
        put_whole(out, scaled % factor, decimals as usize);
    }
}

/// A whole number with at least this many digits.
fn put_whole(out: &mut Vec<u8>, mut number: u64, least: usize) {
    let mut digits = [b'0'; 20];
    let mut at = digits.len();
    while number > 0 || digits.len() - at < least {
        at -= 1;
        digits[at] = b'0' + (number % 10) as u8;
        number /= 10;
    }
    out.extend(&digits[at..]);
}

#[cfg(test)]
mod tests {
    use super::super::question::Question;
    use super::*;
    use proptest::prelude::*;
    use terravision_common::ground::Interpolation;

    fn terms(question: Question) -> Terms {
        Terms { question, interpolation: Interpolation::Facet, is_lonlat: false, is_agl: false }
    }

    #[test]
    fn lines_are_numbers_with_whatever_behind_them() {
        let height = |line: &str| parse(line.as_bytes(), &terms(Question::Height));
        let two = Ok(([1.5, -2.0, 0.0, 0.0, 0.0, 0.0], 2));
        for line in ["1.5 -2", "1.5,-2", " 1.5\t-2\r", "1.5;-2;summit", "15e-1 -2.0 summit 7"] {
            assert_eq!(height(line), two, "{line}");
        }
        assert_eq!(height("1 2 3 4 5"), Ok(([1.0, 2.0, 3.0, 0.0, 0.0, 0.0], 3)));
        for (line, words) in [
            ("", "found 0 numbers"),
            ("7", "found 1 number"),
            ("a b", "\"a\" is not a finite number"),
            ("1 nan", "\"nan\" is not"),
            ("1 2 inf", "\"inf\" is not"),
            ("1 \u{1b}[31m", "expected x y or x y z"),
        ] {
            let error = height(line).unwrap_err();
            assert!(error.contains(words) && !error.contains('\u{1b}'), "{line}: {error}");
        }
        let pair = |line: &str| parse(line.as_bytes(), &terms(Question::Sight));
        assert_eq!(pair("1 2 3 4 5 6 seven"), Ok(([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], 6)));
        assert!(pair("1 2 3 4 5").unwrap_err().contains("expected x1 y1 z1 x2 y2 z2: found 5 numbers"));
    }

    proptest! {
        #[test]
        fn any_bytes_are_a_line(line in prop::collection::vec(any::<u8>(), 0..80), pair: bool) {
            let question = if pair { Question::Sight } else { Question::Height };
            if let Err(sentence) = parse(&line, &terms(question)) {
                prop_assert!(sentence.starts_with("expected ") && sentence.len() < 400);
            }
        }

        #[test]
        fn numbers_are_as_the_library_writes_them(number in -1e7f64..1e7, decimals in 1u32..9) {
            let mut out = Vec::new();
            put(&mut out, &[number], decimals);
            let text = String::from_utf8(out).unwrap();
            let read: f64 = text.trim().parse().unwrap();
            prop_assert!((read - number).abs() <= 0.5001 * 0.1f64.powi(decimals as i32) + 1e-9 * number.abs());
            prop_assert_eq!(text.split('.').nth(1).map(str::len), Some(decimals as usize));
        }
    }

    #[test]
    fn numbers_that_are_large_or_none_are_written_too() {
        let mut out = Vec::new();
        put(&mut out, &[f64::NAN, 1e18, -0.0001, 0.9996], 3);
        assert_eq!(String::from_utf8(out).unwrap(), " NaN 1000000000000000000.000 0.000 1.000");
    }
}
