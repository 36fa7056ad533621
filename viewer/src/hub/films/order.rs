//! What a client asks to be made a film of.

use crate::hub::Refusal;
use serde::Deserialize;
use serde_json::Value;
use terravision_common::viewer::SIDES_PX;

/// Longest name, characters.
const NAME_CHARS: usize = 60;
/// Frames a second that a film may have.
const RATES: [f64; 2] = [1.0, 120.0];

/// A film that is wanted.
#[derive(Debug, Clone, Deserialize)]
pub(crate) struct FilmOrder {
    /// What people call it.
    #[serde(default)]
    pub(crate) name: String,
    /// Width and height, pixels.
    pub(crate) size: [u32; 2],
    /// Frames a second.
    #[serde(default = "usual_rate")]
    pub(crate) fps: f64,
    /// `--quality`.
    #[serde(default)]
    pub(crate) quality: Quality,
    /// A camera path, as `terravision fly --path` reads it.
    pub(crate) path: Value,
}

/// How fine it is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Quality {
    #[default]
    Default,
    Best,
    Finest,
}

impl Quality {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Default => "default",
            Self::Best => "best",
            Self::Finest => "finest",
        }
    }
}

fn usual_rate() -> f64 {
    30.0
}

impl FilmOrder {
    /// Reads and checks an order.
    pub(crate) fn read(body: &[u8]) -> Result<Self, Refusal> {
        let order: Self = serde_json::from_slice(body)
            .map_err(|error| ("bad-request", format!("expected a JSON object with size and path: {error}")))?;
        let [low, high] = SIDES_PX;
        if let Some(side) = order.size.into_iter().find(|side| !(low..=high).contains(side)) {
            return Err(("bad-size", format!("size: expected two numbers from {low} to {high}, found {side}")));
        }
        let [slowest, fastest] = RATES;
        if !(slowest..=fastest).contains(&order.fps) {
            let text = format!("fps: expected a number from {slowest} to {fastest}, found {}", order.fps);
            return Err(("bad-request", text));
        }
        if !order.path.is_object() {
            return Err(("bad-path", "path: expected an object with \"keyframes\" or \"frames\"".into()));
        }
        let name = order.name.chars().filter(|c| !c.is_control()).take(NAME_CHARS).collect();
        Ok(Self { name, ..order })
    }

    /// The arguments of `terravision fly`, without the world, the path and the film.
    pub(crate) fn flags(&self) -> Vec<String> {
        let [width, height] = self.size;
        let flags = [
            ("--size", format!("{width}x{height}")),
            ("--fps", self.fps.to_string()),
            ("--quality", self.quality.name().to_owned()),
        ];
        flags.into_iter().flat_map(|(flag, value)| [flag.to_owned(), value]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_are_read_and_checked() {
        let order =
            FilmOrder::read(br#"{"name":"a\nb","size":[640,360],"quality":"best","path":{"frames":[]}}"#).unwrap();
        assert_eq!((order.name.as_str(), order.fps), ("ab", 30.0));
        assert_eq!(order.flags(), ["--size", "640x360", "--fps", "30", "--quality", "best"]);
        for (wrong, code) in [
            ("", "bad-request"),
            (r#"{"size":[640,360]}"#, "bad-request"),
            (r#"{"size":[640,360],"path":[]}"#, "bad-path"),
            (r#"{"size":[640,9999],"path":{}}"#, "bad-size"),
            (r#"{"size":[640,360],"fps":0,"path":{}}"#, "bad-request"),
            (r#"{"size":[640,360],"quality":"--output","path":{}}"#, "bad-request"),
        ] {
            assert_eq!(FilmOrder::read(wrong.as_bytes()).unwrap_err().0, code, "{wrong}");
        }
    }
}
