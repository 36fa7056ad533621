//! Output of foreign text to a terminal: messages of servers, names of files, content of manifests,
//! the last messages of ffmpeg or GDAL.
//!
//! A terminal interprets control sequences. So all programs print only through this module, and
//! characters that could control the terminal, or change the order of a line, are shown as escapes.

use std::borrow::Cow;
use std::io::Write;

/// Longest line that is printed, bytes; of a longer one, only the number of the remaining bytes is
/// printed.
pub const MOST_LINE_BYTES: usize = 8192;

/// Whether a character can be shown unescaped.
///
/// Escaped are: control characters (ESC and those of ISO 6429, section 8.3), characters that change
/// the direction of text (Unicode Standard Annex 9, table 4), line separators, and invisible
/// characters (zero-width spaces, tags).
fn is_plain(c: char) -> bool {
    !(c.is_control()
        || matches!(c,
            '\u{061c}' | '\u{200b}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}'
            | '\u{feff}' | '\u{fff9}'..='\u{fffb}' | '\u{e0000}'..='\u{e007f}'))
}

/// One line of text without control sequences: line feeds and tabs become blanks, all other
/// characters that are not plain become escapes (`\x1b`, `\u{202e}`), and text beyond
/// [`MOST_LINE_BYTES`] is cut.
#[must_use]
pub fn printable(text: &str) -> Cow<'_, str> {
    if text.len() <= MOST_LINE_BYTES && text.chars().all(is_plain) {
        return Cow::Borrowed(text);
    }
    let mut line = String::with_capacity(text.len().min(MOST_LINE_BYTES) + 32);
    for (at, c) in text.char_indices() {
        if line.len() >= MOST_LINE_BYTES {
            line.push_str(&format!("… ({} more bytes)", text.len() - at));
            break;
        }
        match c {
            '\n' | '\r' | '\t' => line.push(' '),
            c if is_plain(c) => line.push(c),
            c if u32::from(c) < 256 => line.push_str(&format!("\\x{:02x}", u32::from(c))),
            c => line.push_str(&format!("\\u{{{:x}}}", u32::from(c))),
        }
    }
    Cow::Owned(line)
}

/// Equivalent JSON without control characters: within strings they become escapes.
#[must_use]
pub fn printable_json(json: &str) -> Cow<'_, str> {
    if json.chars().all(|c| c == '\n' || is_plain(c)) {
        return Cow::Borrowed(json);
    }
    let mut text = String::with_capacity(json.len() + 64);
    for c in json.chars() {
        if c == '\n' || is_plain(c) {
            text.push(c);
        } else {
            c.encode_utf16(&mut [0; 2]).iter().for_each(|unit| text.push_str(&format!("\\u{unit:04x}")));
        }
    }
    Cow::Owned(text)
}

/// The beginning of a text, at most this many bytes, cut between two characters.
#[must_use]
pub fn cut(text: &str, most_bytes: usize) -> &str {
    let end = (0..=most_bytes.min(text.len())).rev().find(|at| text.is_char_boundary(*at));
    &text[..end.unwrap_or(0)]
}

/// Prints one line on standard error. Ignores errors: there is no other place to report them.
pub fn complain(line: &str) {
    // A single write for the whole line, so that lines of several processes do not mix.
    drop(std::io::stderr().write_all(format!("{}\n", printable(line)).as_bytes()));
}

/// What is wrong with a command line, as one sentence: the first paragraph of the parser's message.
/// Its usage lines are what `help`, a command, prints.
#[must_use]
pub fn usage_sentence(message: &str, help: &str) -> String {
    let first = message.split("\n\n").next().unwrap_or(message);
    let message = first.split_whitespace().collect::<Vec<_>>().join(" ");
    let message = message.strip_prefix("error: ").unwrap_or(&message);
    format!("{message} (see {help})")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn names_in_any_language_stay_as_they_are() {
        for text in ["", "a plain line", "Þingvellir, 東京, Ελλάδα, ‌نمی‌خواهم, 👩‍🚀, naïve", "tab-less"]
        {
            assert!(matches!(printable(text), Cow::Borrowed(same) if same == text), "{text}");
        }
    }

    #[test]
    fn what_steers_a_terminal_is_shown_as_an_escape() {
        assert_eq!(printable("a\x1b[2Jb\x07"), "a\\x1b[2Jb\\x07");
        assert_eq!(printable("title\u{9d}0;x\u{9c}"), "title\\x9d0;x\\x9c");
        assert_eq!(printable("one\nterravision: done\r\tx"), "one terravision: done  x");
        assert_eq!(printable("gnp.\u{202e}exe\u{2066}"), "gnp.\\u{202e}exe\\u{2066}");
        assert_eq!(printable("a\u{e0041}\u{feff}\u{7f}"), "a\\u{e0041}\\u{feff}\\x7f");
    }

    #[test]
    fn a_line_without_end_is_cut() {
        let text = "x".repeat(MOST_LINE_BYTES + 100);
        let line = printable(&text);
        assert!(line.ends_with("x… (100 more bytes)"), "{}", &line[line.len() - 40..]);
        assert!(printable(&"\u{1b}".repeat(1 << 20)).len() < MOST_LINE_BYTES + 64);
    }

    #[test]
    fn json_says_the_same_without_steering() {
        let value = serde_json::json!({"name": "a\u{9b}\u{202e}\u{e0041}\u{1b}ä", "more": [1, "東京"]});
        let text = format!("{value:#}\n");
        let safe = printable_json(&text);
        assert!(safe.chars().all(|c| c == '\n' || is_plain(c)) && safe.contains("東京"), "{safe}");
        assert_eq!(serde_json::from_str::<serde_json::Value>(&safe).unwrap(), value);
    }

    #[test]
    fn texts_are_cut_between_characters() {
        assert_eq!(
            [cut("aäb", 0), cut("aäb", 1), cut("aäb", 2), cut("aäb", 3), cut("aäb", 9)],
            ["", "a", "a", "aä", "aäb"]
        );
    }

    proptest! {
        #[test]
        fn any_text_becomes_one_line_of_plain_characters(text in "\\PC*|(?s).*") {
            prop_assert!(printable(&text).chars().all(is_plain));
        }
    }
}
