//! Messages of clients: read, checked, done.

use crate::hub::{Hello, Hub, PROTOCOL, Refusal, View, lock};
use crate::picture::now_ms;
use crate::socket::pick::{SentPictures, pick};
use serde::{Deserialize, Deserializer};
use serde_json::{Value, json};
use std::sync::Mutex;
use terravision_common::viewer::{StreamSettings, ViewerPose};

/// A message of a client.
#[derive(Debug, Deserialize)]
#[serde(tag = "type", rename_all = "kebab-case")]
pub(crate) enum ClientMessage {
    Hello {
        protocol: u32,
        #[serde(default)]
        token: Option<String>,
        #[serde(default)]
        name: String,
        size: [f64; 2],
        #[serde(default = "one")]
        dpr: f64,
        #[serde(default)]
        watch: bool,
        #[serde(default)]
        h264: bool,
    },
    Pose {
        id: u32,
        #[serde(flatten)]
        pose: ViewerPose,
    },
    Size {
        size: [f64; 2],
        #[serde(default = "one")]
        dpr: f64,
    },
    Settings(SettingsChange),
    Ack(Acknowledgement),
    Pick {
        id: u32,
        u: f64,
        v: f64,
        #[serde(default)]
        n: Option<u32>,
    },
    Map {
        wanted: bool,
    },
    TakeOver,
    Release,
    Ping {
        id: u32,
    },
    Probed {
        time_ms: f64,
    },
}

/// A picture has come.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
pub(crate) struct Acknowledgement {
    /// Its number.
    pub(crate) n: u32,
    /// How long it took to decode and show it, milliseconds.
    #[serde(default)]
    pub(crate) ms: f64,
    /// It could not be decoded.
    #[serde(default)]
    pub(crate) failed: bool,
}

fn one() -> f64 {
    1.0
}

/// Settings that change: what is not named stays, `null` goes back to what the server was started
/// with.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(crate) struct SettingsChange {
    #[serde(deserialize_with = "named")]
    facet_px: Option<Option<f64>>,
    #[serde(deserialize_with = "named")]
    texel_px: Option<Option<f64>>,
    #[serde(deserialize_with = "named")]
    fps: Option<Option<f64>>,
    #[serde(deserialize_with = "named")]
    technique: Option<Option<String>>,
    #[serde(deserialize_with = "named")]
    exaggeration: Option<Option<f64>>,
    #[serde(deserialize_with = "named")]
    overlay: Option<Option<String>>,
    #[serde(deserialize_with = "named")]
    sun: Option<Option<String>>,
    #[serde(deserialize_with = "named")]
    shadows: Option<Option<bool>>,
    #[serde(deserialize_with = "named")]
    haze: Option<Option<f64>>,
    #[serde(deserialize_with = "named")]
    stereo: Option<Option<String>>,
    #[serde(deserialize_with = "named")]
    eye_separation: Option<Option<f64>>,
    #[serde(deserialize_with = "named")]
    convergence: Option<Option<f64>>,
}

/// Tells `null` from a key that is missing.
fn named<'de, T: Deserialize<'de>, D: Deserializer<'de>>(from: D) -> Result<Option<Option<T>>, D::Error> {
    Option::deserialize(from).map(Some)
}

impl SettingsChange {
    /// The settings, changed.
    fn apply(self, settings: &mut StreamSettings, defaults: &StreamSettings) {
        fn set<T: Clone>(place: &mut Option<T>, change: Option<Option<T>>, default: &Option<T>) {
            if let Some(value) = change {
                *place = value.or_else(|| default.clone());
            }
        }
        set(&mut settings.facet_px, self.facet_px, &defaults.facet_px);
        set(&mut settings.texel_px, self.texel_px, &defaults.texel_px);
        set(&mut settings.fps, self.fps, &defaults.fps);
        set(&mut settings.technique, self.technique, &defaults.technique);
        set(&mut settings.exaggeration, self.exaggeration, &defaults.exaggeration);
        set(&mut settings.overlay, self.overlay, &defaults.overlay);
        set(&mut settings.sun, self.sun, &defaults.sun);
        set(&mut settings.shadows, self.shadows, &defaults.shadows);
        set(&mut settings.haze, self.haze, &defaults.haze);
        set(&mut settings.stereo, self.stereo, &defaults.stereo);
        set(&mut settings.eye_separation, self.eye_separation, &defaults.eye_separation);
        set(&mut settings.convergence, self.convergence, &defaults.convergence);
    }
}

impl ClientMessage {
    /// Reads a message; else says what is wrong with it.
    pub(crate) fn read(text: &str) -> Result<Self, Refusal> {
        serde_json::from_str(text).map_err(|error| ("malformed", error.to_string()))
    }

    /// Its `type`.
    fn name(&self) -> &'static str {
        match self {
            Self::Hello { .. } => "hello",
            Self::Pose { .. } => "pose",
            Self::Size { .. } => "size",
            Self::Settings(_) => "settings",
            Self::Ack(_) => "ack",
            Self::Pick { .. } => "pick",
            Self::Map { .. } => "map",
            Self::TakeOver => "take-over",
            Self::Release => "release",
            Self::Ping { .. } => "ping",
            Self::Probed { .. } => "probed",
        }
    }
}

/// How a client introduces itself, or why it may not stay. `is_known`: it has shown the token
/// already.
pub(crate) fn introduce(message: ClientMessage, hub: &Hub, is_known: bool) -> Result<Hello, Refusal> {
    let ClientMessage::Hello { protocol, token, name, size, dpr, watch, h264 } = message else {
        return Err(("no-hello", format!("expected hello as the first message, found {}", message.name())));
    };
    if !is_known && !crate::socket::is_token(hub, token.as_deref()) {
        return Err(("wrong-token", "the token is not that of this server".into()));
    }
    if protocol != PROTOCOL {
        let text = format!("the server speaks protocol {PROTOCOL}, and the client {protocol}: load the page again");
        return Err(("wrong-protocol", text));
    }
    Ok(Hello { name, view: View::new(size, dpr)?, only_watches: watch, has_video: h264 })
}

/// Does what a message says. What is to be answered, if anything is; acknowledgements are the
/// session's own business.
pub(super) fn act(message: ClientMessage, hub: &Hub, client: u32, sent: &Mutex<SentPictures>) -> Option<Value> {
    let name = message.name();
    let done = match message {
        ClientMessage::Hello { .. } => Err(("malformed", "hello comes once, as the first message".to_owned())),
        ClientMessage::Pose { id, pose } => hub.fly_to(client, id, pose).map(|()| None),
        ClientMessage::Size { size, dpr } => View::new(size, dpr).map(|view| {
            hub.resize(client, view);
            None
        }),
        ClientMessage::Settings(change) => {
            let defaults = &hub.setup().defaults;
            hub.set_settings(client, |settings| change.apply(settings, defaults)).map(|()| None)
        }
        ClientMessage::Ack(_) | ClientMessage::Probed { .. } => Ok(None),
        ClientMessage::Pick { id, u, v, n } => pick(hub, &lock(sent), [u, v], n).map(|(seen, is_meant)| {
            let (point, distance_m) = (seen.map(|seen| seen.place.to_array()), seen.map(|seen| seen.distance_m));
            let n = n.filter(|_| is_meant);
            Some(json!({"type": "picked", "id": id, "n": n, "point": point, "distance_m": distance_m}))
        }),
        ClientMessage::Map { wanted } => {
            hub.want_map(client, wanted);
            Ok(None)
        }
        ClientMessage::TakeOver => hub.take_over(client).map(|()| None),
        ClientMessage::Release => {
            hub.release(client);
            Ok(None)
        }
        ClientMessage::Ping { id } => Ok(Some(json!({"type": "pong", "id": id, "time_ms": now_ms()}))),
    };
    match done {
        Ok(answer) => answer,
        Err((code, text)) => Some(json!({"type": "error", "code": code, "text": text, "about": name})),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_read_and_others_refused() {
        for good in [
            r#"{"type":"hello","protocol":1,"size":[800,600]}"#,
            r#"{"type":"pose","id":1,"x":1,"y":2,"z":3,"heading":0,"pitch":-20,"more":true}"#,
            r#"{"type":"settings","facet_px":null,"fps":20}"#,
            r#"{"type":"take-over"}"#,
            r#"{"type":"pick","id":3,"u":0.5,"v":0.5}"#,
        ] {
            assert!(ClientMessage::read(good).is_ok(), "{good}: {:?}", ClientMessage::read(good));
        }
        for bad in [
            "",
            "[]",
            "{}",
            r#"{"type":"fly"}"#,
            r#"{"type":"pose","id":-1,"x":1,"y":2,"z":3,"heading":0,"pitch":0}"#,
            r#"{"type":"pose","id":1,"x":null,"y":2,"z":3,"heading":0,"pitch":0}"#,
            r#"{"type":"pose","id":1,"x":NaN,"y":2,"z":3,"heading":0,"pitch":0}"#,
            r#"{"type":"pose","id":1,"y":2,"z":3,"heading":0,"pitch":0}"#,
        ] {
            assert_eq!(ClientMessage::read(bad).unwrap_err().0, "malformed", "{bad}");
        }
    }

    #[test]
    fn a_setting_that_is_null_goes_back_and_one_that_is_missing_stays() {
        let defaults = StreamSettings { facet_px: Some(7.0), ..Default::default() };
        let mut settings = StreamSettings { facet_px: Some(2.0), fps: Some(10.0), ..Default::default() };
        let change = |text| serde_json::from_str::<SettingsChange>(text).unwrap();
        change(r#"{"texel_px": 2}"#).apply(&mut settings, &defaults);
        assert_eq!((settings.facet_px, settings.texel_px, settings.fps), (Some(2.0), Some(2.0), Some(10.0)));
        change(r#"{"facet_px": null, "fps": null}"#).apply(&mut settings, &defaults);
        assert_eq!((settings.facet_px, settings.fps), (Some(7.0), None));
    }
}
