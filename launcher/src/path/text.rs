//! From bytes to text: the encodings in which programs write XML and JSON.
//!
//! Names and descriptions are not looked at, only numbers, times and the names of elements, all of
//! them ASCII. So what cannot be decoded in a text that is ASCII otherwise becomes U+FFFD and does
//! no harm.

/// Characters of windows-1252 at 0x80 to 0x9F (WHATWG Encoding Standard, index windows-1252; five
/// have none). ISO-8859-1 is read with the same table, as the standard says: its own characters
/// there are control codes that no text has.
const WINDOWS_1252: [char; 32] = [
    '€', '\u{81}', '‚', 'ƒ', '„', '…', '†', '‡', 'ˆ', '‰', 'Š', '‹', 'Œ', '\u{8d}', 'Ž', '\u{8f}', '\u{90}', '‘', '’',
    '“', '”', '•', '–', '—', '˜', '™', 'š', '›', 'œ', '\u{9d}', 'ž', 'Ÿ',
];
/// An XML declaration is not longer than that.
const DECLARATION_BYTES: usize = 512;

/// The text without byte order mark, in the encoding that the mark, the first bytes or the XML
/// declaration tell.
///
/// # Errors
/// What was found, in words, when it is in an encoding that is not read here.
pub(super) fn decode(bytes: Vec<u8>) -> Result<String, String> {
    let text = match bytes.as_slice() {
        [0xFF, 0xFE, 0, 0, ..] | [0, 0, 0xFE, 0xFF, ..] | [0, 0, 0, b'<', ..] | [b'<', 0, 0, 0, ..] => {
            return Err("text in UTF-32; save it as UTF-8".into());
        }
        [0xFF, 0xFE, rest @ ..] => utf16(rest, u16::from_le_bytes),
        [0xFE, 0xFF, rest @ ..] => utf16(rest, u16::from_be_bytes),
        // Without a mark: the first character of every path is ASCII.
        [0, second, ..] if *second != 0 => utf16(&bytes, u16::from_be_bytes),
        [first, 0, ..] if *first != 0 => utf16(&bytes, u16::from_le_bytes),
        _ => match declared(&bytes).as_deref() {
            Some("iso-8859-1" | "iso8859-1" | "iso_8859-1" | "latin1" | "latin-1" | "windows-1252" | "cp1252") => {
                bytes.iter().map(|&byte| windows_1252(byte)).collect()
            }
            // UTF-16 is declared by texts that were saved as UTF-8 later: this one can be read as
            // ASCII, so it was.
            _ => {
                String::from_utf8(bytes).unwrap_or_else(|error| String::from_utf8_lossy(error.as_bytes()).into_owned())
            }
        },
    };
    // Files that were joined or saved twice begin with several marks.
    let marks = text.len() - text.trim_start_matches('\u{feff}').len();
    Ok(if marks == 0 { text } else { text[marks..].to_owned() })
}

fn windows_1252(byte: u8) -> char {
    match byte {
        0x80..=0x9F => WINDOWS_1252[usize::from(byte - 0x80)],
        other => char::from(other),
    }
}

fn utf16(bytes: &[u8], unit: fn([u8; 2]) -> u16) -> String {
    let units = bytes.chunks_exact(2).map(|pair| unit([pair[0], pair[1]]));
    char::decode_utf16(units).map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER)).collect()
}

/// The encoding that an XML declaration names, in lower case.
fn declared(bytes: &[u8]) -> Option<String> {
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes).trim_ascii_start();
    let head = bytes.get(..DECLARATION_BYTES).unwrap_or(bytes).strip_prefix(b"<?xml")?;
    let head = String::from_utf8_lossy(head);
    let (declaration, _) = head.split_once('>')?;
    let (_, value) = declaration.split_once("encoding")?;
    let value = value.trim_start().strip_prefix('=')?.trim_start();
    let quote = value.chars().next().filter(|c| matches!(c, '"' | '\''))?;
    let (name, _) = value[1..].split_once(quote)?;
    Some(name.trim().to_ascii_lowercase())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const WORDS: &str = "<a>Höhe €</a>";

    fn utf16_bytes(text: &str, bytes: fn(u16) -> [u8; 2]) -> Vec<u8> {
        text.encode_utf16().flat_map(bytes).collect()
    }

    #[test]
    fn what_is_declared_or_marked_is_honoured() {
        let declared = |name: &str| format!("<?xml version='1.0' encoding='{name}'?>").into_bytes();
        let latin = [declared("ISO-8859-1"), b"H\xf6he \x80".to_vec()].concat();
        assert!(decode(latin).unwrap().ends_with("Höhe €"));
        let windows = [b"\n".to_vec(), declared("windows-1252"), b"\x93x\x94".to_vec()].concat();
        assert!(decode(windows).unwrap().ends_with("“x”"));
        // A text in UTF-8 that still says UTF-16, as .NET writes it.
        assert!(decode([declared("utf-16"), WORDS.as_bytes().to_vec()].concat()).unwrap().ends_with(WORDS));
        // A code page that is not read here: the numbers are.
        assert!(decode([declared("shift_jis"), b"\x8eR 12.5".to_vec()].concat()).unwrap().ends_with(" 12.5"));
        for (mark, bytes) in
            [(&b"\xff\xfe"[..], u16::to_le_bytes as fn(u16) -> [u8; 2]), (b"\xfe\xff", u16::to_be_bytes)]
        {
            assert_eq!(decode([mark.to_vec(), utf16_bytes(WORDS, bytes)].concat()).unwrap(), WORDS);
            assert_eq!(decode(utf16_bytes(WORDS, bytes)).unwrap(), WORDS);
        }
        assert_eq!(decode(format!("\u{feff}\u{feff}{WORDS}").into_bytes()).unwrap(), WORDS);
        assert!(decode(b"\xff\xfe\0\0<\0\0\0".to_vec()).unwrap_err().contains("UTF-32"));
    }

    proptest! {
        #[test]
        fn any_bytes_become_text_of_bounded_size(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let count = bytes.len();
            if let Ok(text) = decode(bytes) {
                prop_assert!(text.len() <= 3 * count);
            }
        }
    }
}
