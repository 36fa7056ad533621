//! Times and intervals as CZML has them.

use super::super::times::seconds_from_iso8601;

/// Seconds since 1970 of a time, also without separators as czml-writer writes it: 20120402T12Z.
pub(super) fn seconds(text: &str) -> Option<f64> {
    let text = text.trim();
    let Some((date, rest)) = text.split_once('T').filter(|(date, _)| date.len() == 8 && date.is_ascii()) else {
        return seconds_from_iso8601(text);
    };
    let (clock, zone) = rest.split_at(rest.find(['Z', '+', '-']).unwrap_or(rest.len()));
    let digits = clock.find(['.', ',']).unwrap_or(clock.len());
    if clock.contains(':') || !clock.is_ascii() || !matches!(digits, 2 | 4 | 6) {
        return seconds_from_iso8601(&format!("{}-{}-{}T{rest}", &date[..4], &date[4..6], &date[6..]));
    }
    let part = |from: usize| clock.get(from..(from + 2).min(digits)).filter(|part| !part.is_empty()).unwrap_or("00");
    let fraction = if digits == 6 { &clock[digits..] } else { "" };
    let (year, month, day) = (&date[..4], &date[4..6], &date[6..]);
    let (hour, minute, second) = (part(0), part(2), part(4));
    seconds_from_iso8601(&format!("{year}-{month}-{day}T{hour}:{minute}:{second}{fraction}{zone}"))
}

/// The two ends of an interval, seconds since 1970; the first and the last day of the calendar stand
/// for no end. The second time may lack the date.
pub(super) fn interval(text: &str) -> Option<[f64; 2]> {
    let (from, to) = text.split_once('/')?;
    let (from, to) = (from.trim(), to.trim());
    let start = if from.starts_with("0000") { f64::NEG_INFINITY } else { seconds(from)? };
    let end = if to.starts_with("9999") {
        f64::INFINITY
    } else {
        seconds(to).or_else(|| seconds(&format!("{}T{to}", from.split('T').next()?)))?
    };
    (start <= end).then_some([start, end])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn times_with_and_without_separators_are_read() {
        for text in
            ["2012-04-02T12:30:00Z", "20120402T123000Z", "20120402T1230Z", "20120402T12:30Z", "2012-04-02T12:30Z"]
        {
            assert_eq!(seconds(text), Some(1_333_369_800.0), "{text}");
        }
        assert_eq!(seconds("20120402T123000.25Z"), Some(1_333_369_800.25));
        assert_eq!(seconds("20120402T14+02"), seconds("2012-04-02T12:00:00Z"));
        for text in ["", "20120402", "2012040T12Z", "20121302T12Z", "20120402T1Z", "noon"] {
            assert_eq!(seconds(text), None, "{text}");
        }
    }

    #[test]
    fn an_interval_may_be_open_and_leave_the_date_out() {
        let noon = 1_333_368_000.0;
        assert_eq!(interval("2012-04-02T12:00:00Z/13:00:00Z"), Some([noon, noon + 3600.0]));
        assert_eq!(interval("20120402T12Z/20120403T12Z"), Some([noon, noon + 86_400.0]));
        let all = "0000-00-00T00:00:00Z/9999-12-31T24:00:00Z";
        assert_eq!(interval(all), Some([f64::NEG_INFINITY, f64::INFINITY]));
        assert_eq!(interval("2012-04-02T12:00:00Z"), None);
        assert_eq!(interval("2012-04-02T12:00:00Z/2012-04-02T11:00:00Z"), None);
    }

    proptest! {
        #[test]
        fn any_text_is_a_time_or_none(text in "([0-9]{8}T[0-9:.é]{0,9}(Z|[+-][0-9]{0,4})?(/\\PC{0,12})?|\\PC{0,30})") {
            prop_assert!(seconds(&text).is_none_or(f64::is_finite));
            prop_assert!(interval(&text).is_none_or(|[from, to]| from <= to));
        }
    }
}
