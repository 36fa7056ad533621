//! Times as programs and people write them.

/// Seconds since 1970 of a time like `2024-05-01T10:00:00.5Z` or `…+02:00` (the profile of ISO 8601
/// that XML Schema's dateTime is), also as some programs write it: a space for the T, `+0200`,
/// `+02`, a comma before fractions, no seconds.
pub(crate) fn seconds_from_iso8601(text: &str) -> Option<f64> {
    let (date, time) = text.trim().split_once(['T', 't', ' '])?;
    let digits = |text: &str, most: usize| -> Option<i64> {
        let is_number = (1..=most).contains(&text.len()) && text.bytes().all(|b| b.is_ascii_digit());
        is_number.then(|| text.parse().ok()).flatten()
    };
    let mut parts = date.split('-');
    let year = parts.next().filter(|year| year.len() == 4)?;
    let (year, month, day) = (digits(year, 4)?, digits(parts.next()?, 2)?, digits(parts.next()?, 2)?);
    if parts.next().is_some() {
        return None;
    }
    let zone_at = time.find(['Z', 'z', '+', '-']).unwrap_or(time.len());
    let (clock, zone) = time.split_at(zone_at);
    let mut parts = clock.trim().split(':');
    let (hour, minute) = (digits(parts.next()?, 2)?, digits(parts.next()?, 2)?);
    let second = parts.next().unwrap_or("0").replace(',', ".");
    let is_plain = second.len() <= 20 && second.bytes().all(|b| b.is_ascii_digit() || b == b'.');
    let second: f64 = is_plain.then(|| second.parse().ok()).flatten()?;
    let offset_minutes = match zone.as_bytes().first() {
        None => 0,
        Some(b'Z' | b'z') => (zone.len() == 1).then_some(0)?,
        Some(sign) => {
            let zone = zone.get(1..)?.trim_end();
            let (hours, minutes) = match zone.split_once(':') {
                Some(parts) => parts,
                None if zone.len() == 4 && zone.is_ascii() => zone.split_at(2),
                None => (zone, "0"),
            };
            let minutes = digits(hours, 2)? * 60 + digits(minutes, 2)?;
            if *sign == b'-' { -minutes } else { minutes }
        }
    };
    let is_leap = year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
    let days = match month {
        2 => 28 + i64::from(is_leap),
        4 | 6 | 9 | 11 => 30,
        _ => 31,
    };
    let is_valid = (1..=12).contains(&month) && (1..=days).contains(&day) && hour < 25 && minute < 60 && second < 61.0;
    if !is_valid || parts.next().is_some() {
        return None;
    }
    // Days from the civil calendar; H. Hinnant, "chrono-compatible low-level date algorithms",
    // days_from_civil.
    let shifted = if month <= 2 { year - 1 } else { year };
    let era = shifted.div_euclid(400);
    let year_of_era = shifted.rem_euclid(400);
    let day_of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    let day_of_era = year_of_era * 365 + year_of_era / 4 - year_of_era / 100 + day_of_year;
    let days = era * 146_097 + day_of_era - 719_468;
    Some((days * 86_400 + hour * 3600 + (minute - offset_minutes) * 60) as f64 + second)
}

/// A length of time for people.
pub(super) fn for_people(seconds: f64) -> String {
    let minutes = (seconds / 60.0).round();
    match seconds {
        s if s < 99.5 => format!("{s:.0} s"),
        s if s < 5970.0 => format!("{minutes:.0} min"),
        s if s < 3.6e5 => format!("{:.0} h {:02.0} min", (minutes / 60.0).floor(), minutes % 60.0),
        s => format!("{:.0} days", s / 86_400.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn times_are_read() {
        for (text, seconds) in [
            ("1970-01-01T00:00:00Z", 0.0),
            ("2000-03-01T12:00:00.25Z", 951_912_000.25),
            ("2000-03-01T12:00:00,25Z", 951_912_000.25),
            ("2000-03-01T14:00:00+02:00", 951_912_000.0),
            ("2000-03-01T14:00:00+0200", 951_912_000.0),
            ("2000-03-01T14:00:00+02", 951_912_000.0),
            ("2000-03-01T06:30:00-0530", 951_912_000.0),
            (" 2000-03-01 12:00:00 ", 951_912_000.0),
            ("2000-3-1T12:00Z", 951_912_000.0),
        ] {
            assert_eq!(seconds_from_iso8601(text), Some(seconds), "{text}");
        }
        for text in [
            "",
            "T",
            "2000-13-01T00:00:00Z",
            "2000-01-01",
            "2026-02-29T00:00:00Z",
            "2026-04-31T00:00:00Z",
            "00-01-01T1:00:00Z",
            "2000-01-01T00:00:00+é:00",
            "2000-01-01T1:2:3:4Z",
        ] {
            assert_eq!(seconds_from_iso8601(text), None, "{text}");
        }
        assert_eq!([50.0, 600.0, 7260.0, 1e6].map(for_people), ["50 s", "10 min", "2 h 01 min", "12 days"]);
    }

    proptest! {
        #[test]
        fn any_text_is_a_finite_time_or_none(
            text in "([0-9]{1,4}-[0-9]{1,2}-[0-9]{1,2}[T ][0-9:.,]{0,12}(Z|[+-][0-9:]{0,6})?|\\PC{0,30})",
        ) {
            prop_assert!(seconds_from_iso8601(&text).is_none_or(f64::is_finite));
        }
    }
}
