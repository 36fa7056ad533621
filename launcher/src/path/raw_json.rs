//! JSON read value by value: an object by the keys that are wanted, a list entry by entry. What is
//! not wanted costs no memory.

use serde::de::{DeserializeSeed, Deserializer, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde_json::Error;
use serde_json::value::RawValue;
use std::fmt;

/// Of an object the values of these keys, as they are written; of a repeated key the last.
///
/// # Errors
/// When the text is not one object of JSON.
pub(super) fn fields<'a, const N: usize>(text: &'a str, names: &[&str; N]) -> Result<[Option<&'a RawValue>; N], Error> {
    let mut json = serde_json::Deserializer::from_str(text);
    let values = json.deserialize_map(Fields { names })?;
    json.end()?;
    Ok(values)
}

/// Hands on the entries of a list, however long it is, with their numbers from 0. Ends at the first
/// error of `each`, which is the inner one.
///
/// # Errors
/// When the text is not one list of JSON.
pub(super) fn each<'a, E>(
    text: &'a str,
    each: impl FnMut(usize, &'a RawValue) -> Result<(), E>,
) -> Result<Result<(), E>, Error> {
    let mut json = serde_json::Deserializer::from_str(text);
    let mut error = None;
    let outcome = json.deserialize_seq(Entries { each, error: &mut error });
    match error {
        Some(error) => Ok(Err(error)),
        None => outcome.and_then(|()| json.end()).map(Ok),
    }
}

/// A number that is finite.
pub(super) fn number(raw: &RawValue) -> Option<f64> {
    serde_json::from_str::<f64>(raw.get()).ok().filter(|v| v.is_finite())
}

/// A text.
pub(super) fn text(raw: &RawValue) -> Option<String> {
    serde_json::from_str(raw.get()).ok()
}

/// Whether a value is a list.
pub(super) fn is_list(raw: &RawValue) -> bool {
    raw.get().starts_with('[')
}

struct Fields<'n, const N: usize> {
    names: &'n [&'n str; N],
}

impl<'de, const N: usize> Visitor<'de> for Fields<'_, N> {
    type Value = [Option<&'de RawValue>; N];

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let mut values = [None; N];
        while let Some(key) = map.next_key_seed(Key { names: self.names })? {
            match key {
                Some(key) => values[key] = Some(map.next_value()?),
                None => drop(map.next_value::<IgnoredAny>()?),
            }
        }
        Ok(values)
    }
}

/// Reads a key as its place among those that are wanted.
struct Key<'n> {
    names: &'n [&'n str],
}

impl<'de> DeserializeSeed<'de> for Key<'_> {
    type Value = Option<usize>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Option<usize>, D::Error> {
        deserializer.deserialize_str(self)
    }
}

impl Visitor<'_> for Key<'_> {
    type Value = Option<usize>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a key")
    }

    fn visit_str<E>(self, name: &str) -> Result<Option<usize>, E> {
        Ok(self.names.iter().position(|known| *known == name))
    }
}

struct Entries<'e, F, E> {
    each: F,
    error: &'e mut Option<E>,
}

impl<'de, E, F: FnMut(usize, &'de RawValue) -> Result<(), E>> Visitor<'de> for Entries<'_, F, E> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list")
    }

    fn visit_seq<A: SeqAccess<'de>>(mut self, mut list: A) -> Result<(), A::Error> {
        let mut count = 0;
        while let Some(entry) = list.next_element::<&RawValue>()? {
            if let Err(error) = (self.each)(count, entry) {
                *self.error = Some(error);
                return Err(serde::de::Error::custom("an entry cannot be used"));
            }
            count += 1;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wanted_keys_and_all_entries_are_handed_on() {
        let [a, b, c] =
            fields(r#"{"b": [1, {"a": 2}], "x": {"a": 3}, "a": 1, "\u0061": 4}"#, &["a", "b", "c"]).unwrap();
        assert_eq!([a, b, c].map(|value| value.map(RawValue::get)), [Some("4"), Some(r#"[1, {"a": 2}]"#), None]);
        assert!(fields("[1]", &["a"]).is_err() && fields("{} x", &["a"]).is_err());
        let mut entries = Vec::new();
        let keep = |at: usize, entry: &RawValue| {
            if at < 2 {
                entries.push(entry.get().to_owned());
                Ok(())
            } else {
                Err(at)
            }
        };
        assert_eq!(each("[7, \"x\", [], 9]", keep).unwrap(), Err(2));
        assert_eq!(entries, ["7", "\"x\""]);
        assert!(each("{}", |_, _| Ok::<(), ()>(())).is_err() && each("[1] 2", |_, _| Ok::<(), ()>(())).is_err());
    }
}
