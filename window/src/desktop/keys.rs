//! What keys mean. Letters by their place on the keyboard, so that W A S D are where hands expect
//! them on every layout.

use crate::hands::{HeldKey, Input};
use winit::event::{ElementState, KeyEvent};
use winit::keyboard::{Key, KeyCode, PhysicalKey};

/// What hands can do, in lines that a title bar of a small window has room for.
pub(super) const HELP: [&str; 5] = [
    "drag: hold the ground · right drag or Ctrl+drag: turn and tilt",
    "wheel, + and -: zoom · double click: fly there",
    "arrows, W A S D, Q E: fly · with Shift faster, or turn",
    "N: north · R: start · Space: play the path · T: tree",
    "F11: full screen · Esc: stop · Ctrl+Q: close",
];

/// What a key event means.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Meaning {
    /// For the hands.
    Hands(Input),
    /// For the hands, both: which of the two was down depends on Shift and the layout.
    LetGoZoom,
    /// Whether the tree is drawn.
    Overlay,
    FullScreen,
    Help,
    /// Stop, and leave the full screen.
    Escape,
    Close,
    Nothing,
}

/// The key that is held, by its place.
fn held(code: KeyCode) -> Option<HeldKey> {
    Some(match code {
        KeyCode::ArrowUp => HeldKey::Up,
        KeyCode::ArrowDown => HeldKey::Down,
        KeyCode::ArrowLeft => HeldKey::Left,
        KeyCode::ArrowRight => HeldKey::Right,
        KeyCode::KeyW => HeldKey::Forward,
        KeyCode::KeyS => HeldKey::Backward,
        KeyCode::KeyA => HeldKey::LeftWing,
        KeyCode::KeyD => HeldKey::RightWing,
        KeyCode::KeyE | KeyCode::PageUp => HeldKey::Rise,
        KeyCode::KeyQ | KeyCode::PageDown => HeldKey::Sink,
        _ => return None,
    })
}

/// What an event means, with Ctrl down or not.
pub(super) fn meaning(event: &KeyEvent, is_ctrl: bool) -> Meaning {
    let text = if let Key::Character(text) = &event.logical_key { text.as_str() } else { "" };
    let PhysicalKey::Code(code) = event.physical_key else { return Meaning::Nothing };
    of_key(code, text, event.state == ElementState::Pressed, event.repeat, is_ctrl)
}

fn of_key(code: KeyCode, text: &str, is_down: bool, is_repeat: bool, is_ctrl: bool) -> Meaning {
    if is_repeat {
        return Meaning::Nothing;
    }
    if !is_down {
        let is_zoom = matches!(text, "+" | "=" | "-" | "_" | "*");
        return match held(code) {
            Some(key) => Meaning::Hands(Input::LetGo(key)),
            None if is_zoom => Meaning::LetGoZoom,
            None => Meaning::Nothing,
        };
    }
    match (code, text) {
        (KeyCode::KeyQ | KeyCode::KeyW, _) if is_ctrl => Meaning::Close,
        _ if is_ctrl => Meaning::Nothing,
        (_, "?") => Meaning::Help,
        (_, "+" | "=") => Meaning::Hands(Input::Hold(HeldKey::ZoomIn)),
        (_, "-") => Meaning::Hands(Input::Hold(HeldKey::ZoomOut)),
        (KeyCode::KeyN, _) => Meaning::Hands(Input::NorthUp),
        (KeyCode::KeyR, _) => Meaning::Hands(Input::Reset),
        (KeyCode::Space, _) => Meaning::Hands(Input::Play),
        (KeyCode::KeyT, _) => Meaning::Overlay,
        (KeyCode::F1, _) => Meaning::Help,
        (KeyCode::F11, _) => Meaning::FullScreen,
        (KeyCode::Escape, _) => Meaning::Escape,
        (code, _) => held(code).map_or(Meaning::Nothing, |key| Meaning::Hands(Input::Hold(key))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_held_once_and_let_go() {
        let down = |code, text| of_key(code, text, true, false, false);
        assert_eq!(down(KeyCode::KeyW, "z"), Meaning::Hands(Input::Hold(HeldKey::Forward)), "by its place");
        assert_eq!(of_key(KeyCode::KeyW, "w", true, true, false), Meaning::Nothing, "a repetition");
        assert_eq!(of_key(KeyCode::KeyW, "w", false, false, false), Meaning::Hands(Input::LetGo(HeldKey::Forward)));
        assert_eq!(down(KeyCode::Equal, "+"), Meaning::Hands(Input::Hold(HeldKey::ZoomIn)));
        assert_eq!(of_key(KeyCode::Equal, "=", false, false, false), Meaning::LetGoZoom);
        assert_eq!(down(KeyCode::Slash, "?"), Meaning::Help);
        assert_eq!(down(KeyCode::Space, " "), Meaning::Hands(Input::Play));
        assert_eq!(down(KeyCode::KeyT, "t"), Meaning::Overlay);
        assert_eq!(down(KeyCode::KeyZ, "z"), Meaning::Nothing);
        assert_eq!(of_key(KeyCode::KeyQ, "q", true, false, true), Meaning::Close);
        assert_eq!(of_key(KeyCode::KeyN, "n", true, false, true), Meaning::Nothing, "with Ctrl");
    }
}
