//! A screen of X11 that nobody sees (Xvfb), with hands that type and eyes that look.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use x11rb::connection::Connection;
use x11rb::protocol::Event;
use x11rb::protocol::xproto::{
    AtomEnum, ChangeWindowAttributesAux, ClientMessageEvent, ConfigureWindowAux, ConnectionExt, EventMask, ImageFormat,
    InputFocus, MapState, PropMode, Window,
};
use x11rb::protocol::xtest::ConnectionExt as _;
use x11rb::rust_connection::RustConnection;
use x11rb::wrapper::ConnectionExt as _;

/// Longest time for anything to appear.
const DEADLINE: Duration = Duration::from_secs(60);
/// Events of the protocol.
const KEY_PRESS: u8 = 2;
const KEY_RELEASE: u8 = 3;
const BUTTON_PRESS: u8 = 4;
const BUTTON_RELEASE: u8 = 5;
const MOTION: u8 = 6;

/// The screen. The server ends when this is dropped.
pub(crate) struct Screen {
    server: Child,
    pub(crate) name: String,
    connection: RustConnection,
    root: Window,
}

/// What a window shows.
#[derive(Clone, PartialEq)]
pub(crate) struct Look {
    pub(crate) size: [u32; 2],
    pub(crate) rgb: Vec<[u8; 3]>,
}

impl Drop for Screen {
    fn drop(&mut self) {
        self.server.kill().ok();
        self.server.wait().ok();
    }
}

/// Whether there is a server of X11.
pub(crate) fn has_server() -> bool {
    has_program("Xvfb", "-help")
}

/// Whether there is this program, which ends at once with that flag; without it the tests say so and
/// are left out, unless TERRAVISION_NEEDS_BROWSER asks for all that is to be seen.
pub(crate) fn has_program(name: &str, flag: &str) -> bool {
    let has = Command::new(name).arg(flag).stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok();
    let is_needed = std::env::var("TERRAVISION_NEEDS_BROWSER").is_ok_and(|value| !value.is_empty());
    assert!(has || !is_needed, "{name} is missing: scripts/setup.sh --tests installs it");
    if !has {
        println!("left out: {name} is missing (scripts/setup.sh --tests installs it)");
    }
    has
}

impl Screen {
    /// A screen of its own, of this size.
    pub(crate) fn start([width, height]: [u32; 2]) -> Self {
        let mut server = Command::new("Xvfb");
        server.args(["-displayfd", "1", "-nolisten", "tcp", "-noreset", "-screen", "0"]);
        server.arg(format!("{width}x{height}x24")).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut server = server.spawn().unwrap();
        let mut number = String::new();
        BufReader::new(server.stdout.take().unwrap()).read_line(&mut number).unwrap();
        let name = format!(":{}", number.trim());
        let (connection, screen) = x11rb::connect(Some(&name)).unwrap();
        let root = connection.setup().roots[screen].root;
        Self { server, name, connection, root }
    }

    pub(crate) fn kill(&mut self) {
        self.server.kill().unwrap();
        self.server.wait().unwrap();
    }

    /// Looks until something is found.
    pub(crate) fn until<T>(&self, what: &str, mut look: impl FnMut() -> Option<T>) -> T {
        let end = Instant::now() + DEADLINE;
        loop {
            if let Some(found) = look() {
                return found;
            }
            assert!(Instant::now() < end, "no sign of {what}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// The window that is shown, of a name that contains this; it gets the keyboard, as a window
    /// manager would give it.
    pub(crate) fn window(&self, name: &str) -> Window {
        let window = self.until("a window", || self.find(name));
        // It may have gone meanwhile.
        let focused = self.connection.set_input_focus(InputFocus::PARENT, window, x11rb::CURRENT_TIME).unwrap();
        focused.check().ok();
        window
    }

    fn find(&self, name: &str) -> Option<Window> {
        let tree = self.connection.query_tree(self.root).unwrap().reply().unwrap();
        tree.children.into_iter().find(|window| {
            let is_shown = self.connection.get_window_attributes(*window).unwrap().reply();
            is_shown.is_ok_and(|found| found.map_state == MapState::VIEWABLE) && self.title(*window).contains(name)
        })
    }

    pub(crate) fn title(&self, window: Window) -> String {
        let atom = self.atom("_NET_WM_NAME");
        let property = self.connection.get_property(false, window, atom, AtomEnum::ANY, 0, 1024).unwrap().reply();
        property.map_or_else(|_gone| String::new(), |found| String::from_utf8_lossy(&found.value).into_owned())
    }

    fn atom(&self, name: &str) -> u32 {
        self.connection.intern_atom(false, name.as_bytes()).unwrap().reply().unwrap().atom
    }

    pub(crate) fn is_there(&self, window: Window) -> bool {
        self.connection.get_geometry(window).unwrap().reply().is_ok()
    }

    /// What a window shows; `None` while it changes.
    pub(crate) fn look(&self, window: Window) -> Option<Look> {
        let place = self.connection.get_geometry(window).ok()?.reply().ok()?;
        let (width, height) = (place.width, place.height);
        let image = self.connection.get_image(ImageFormat::Z_PIXMAP, window, 0, 0, width, height, u32::MAX).ok()?;
        let image = image.reply().ok()?;
        let rgb = image.data.chunks_exact(4).map(|bgrx| [bgrx[2], bgrx[1], bgrx[0]]).collect();
        Some(Look { size: [width, height].map(u32::from), rgb })
    }

    fn fake(&self, kind: u8, detail: u8, [x, y]: [i16; 2]) {
        self.connection
            .xtest_fake_input(kind, detail, x11rb::CURRENT_TIME, self.root, x, y, 0)
            .unwrap()
            .check()
            .unwrap();
    }

    /// The key that types this character, with Shift or without.
    fn key(&self, keysym: u32) -> u8 {
        let setup = self.connection.setup();
        let (first, count) = (setup.min_keycode, setup.max_keycode - setup.min_keycode + 1);
        let mapping = self.connection.get_keyboard_mapping(first, count).unwrap().reply().unwrap();
        let mut keys = mapping.keysyms.chunks(mapping.keysyms_per_keycode.into());
        first + keys.position(|syms| syms.contains(&keysym)).unwrap() as u8
    }

    pub(crate) fn press(&self, keysym: u32) {
        self.fake(KEY_PRESS, self.key(keysym), [0; 2]);
    }

    pub(crate) fn release(&self, keysym: u32) {
        self.fake(KEY_RELEASE, self.key(keysym), [0; 2]);
    }

    /// Holds a key for a while.
    pub(crate) fn hold(&self, keysym: u32, time: Duration) {
        self.press(keysym);
        std::thread::sleep(time);
        self.release(keysym);
    }

    pub(crate) fn tap(&self, keysym: u32) {
        self.hold(keysym, Duration::from_millis(30));
    }

    pub(crate) fn point(&self, at: [i16; 2]) {
        self.fake(MOTION, 0, at);
    }

    pub(crate) fn click(&self, button: u8) {
        self.button(button, true);
        self.button(button, false);
    }

    pub(crate) fn button(&self, button: u8, is_down: bool) {
        self.fake(if is_down { BUTTON_PRESS } else { BUTTON_RELEASE }, button, [0; 2]);
    }

    pub(crate) fn resize(&self, window: Window, [width, height]: [u32; 2]) {
        let size = ConfigureWindowAux::new().width(width).height(height);
        self.connection.configure_window(window, &size).unwrap().check().unwrap();
    }

    /// What a desktop says of its pixels: `dpi` of them on an inch, where 96 are usual. Windows
    /// look again when their own property of this name changes.
    pub(crate) fn set_density(&self, dpi: u32, windows: &[Window]) {
        let text = format!("Xft.dpi:\t{dpi}\n");
        for window in [self.root].iter().chain(windows) {
            let (property, kind) = (AtomEnum::RESOURCE_MANAGER, AtomEnum::STRING);
            let set = self.connection.change_property8(PropMode::REPLACE, *window, property, kind, text.as_bytes());
            set.unwrap().check().unwrap();
        }
    }

    /// From now on requests to window managers come here.
    pub(crate) fn manage_windows(&self) {
        let events = ChangeWindowAttributesAux::new()
            .event_mask(EventMask::SUBSTRUCTURE_NOTIFY | EventMask::SUBSTRUCTURE_REDIRECT);
        self.connection.change_window_attributes(self.root, &events).unwrap().check().unwrap();
    }

    /// Fills the screen with a window that asks for it, and gives it back its place when it asks for
    /// that, as a window manager does; whether it fills the screen now.
    pub(crate) fn answer_full_screen(&self, window: Window, small: [u32; 2]) -> bool {
        let (state, full) = (self.atom("_NET_WM_STATE"), self.atom("_NET_WM_STATE_FULLSCREEN"));
        let asked =
            self.until("a wish to fill the screen, or not to", || match self.connection.poll_for_event().unwrap() {
                Some(Event::ClientMessage(message)) if message.type_ == state && message.window == window => {
                    let words = message.data.as_data32();
                    words[1..].contains(&full).then_some(words[0] == 1)
                }
                _ => None,
            });
        let screen = &self.connection.setup().roots[0];
        let whole = [screen.width_in_pixels, screen.height_in_pixels].map(u32::from);
        let states: &[u32] = if asked { &[full] } else { &[] };
        self.connection
            .change_property32(PropMode::REPLACE, window, state, AtomEnum::ATOM, states)
            .unwrap()
            .check()
            .unwrap();
        self.resize(window, if asked { whole } else { small });
        asked
    }

    /// As a click on the cross of the title bar does.
    pub(crate) fn close(&self, window: Window) {
        let (kind, delete) = (self.atom("WM_PROTOCOLS"), self.atom("WM_DELETE_WINDOW"));
        let event = ClientMessageEvent::new(32, window, kind, [delete, x11rb::CURRENT_TIME, 0, 0, 0]);
        self.connection.send_event(false, window, EventMask::NO_EVENT, event).unwrap().check().unwrap();
    }
}

impl Look {
    /// Mean difference of two pictures of one size, levels.
    pub(crate) fn difference(&self, rgb: &[[u8; 3]]) -> f64 {
        assert_eq!(self.rgb.len(), rgb.len());
        let of = |(a, b): (&[u8; 3], &[u8; 3])| (0..3).map(|c| f64::from(a[c].abs_diff(b[c]))).sum::<f64>() / 3.0;
        self.rgb.iter().zip(rgb).map(of).sum::<f64>() / rgb.len() as f64
    }

    /// Whether a picture fills it, up to the last corner: nothing is black.
    pub(crate) fn is_filled(&self) -> bool {
        let [width, height] = self.size.map(|side| side as usize);
        let corners = [0, width - 1, width * (height - 1), width * height - 1];
        corners.iter().all(|at| self.rgb[*at] != [0; 3])
    }

    /// Saves it where TERRAVISION_SCREENSHOTS says, to be looked at.
    pub(crate) fn save(&self, name: &str) {
        let Some(folder) = std::env::var_os("TERRAVISION_SCREENSHOTS") else { return };
        let path = std::path::Path::new(&folder).join(name);
        image::RgbImage::from_raw(self.size[0], self.size[1], self.rgb.concat()).unwrap().save(path).unwrap();
    }
}
