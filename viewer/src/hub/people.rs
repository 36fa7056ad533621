//! Who is there, and who is the pilot.

use super::Refusal;
use super::orders::MOST_PIXELS;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use terravision_common::viewer::SIDES_PX;

/// Most clients at a time.
pub(crate) const MOST_CLIENTS: usize = 64;
/// Longest name, characters.
const NAME_CHARS: usize = 40;

/// The window of a client.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct View {
    size: [f64; 2],
    dpr: f64,
}

impl View {
    /// A window of this many CSS pixels, each `dpr` pixels of the device.
    pub(crate) fn new(size: [f64; 2], dpr: f64) -> Result<Self, Refusal> {
        let is_side = |side: f64| (1.0..=65_536.0).contains(&side);
        if !size.into_iter().all(is_side) || !(0.1..=16.0).contains(&dpr) {
            let found = format!("{size:?} and {dpr}");
            let text = format!("size: expected two numbers from 1 to 65536, and dpr from 0.1 to 16, found {found}");
            return Err(("bad-size", text));
        }
        Ok(Self { size, dpr })
    }

    /// The size of its pictures: even, and within the limits of the stream.
    pub(crate) fn size_px(self) -> [u32; 2] {
        let [width, height] = self.size.map(|side| side * self.dpr);
        let shrink = (f64::from(MOST_PIXELS) / (width * height)).sqrt().min(1.0);
        let even = |side: f64| ((side * shrink / 2.0).floor() as u32 * 2).clamp(SIDES_PX[0], SIDES_PX[1]);
        [width, height].map(even)
    }
}

/// How a client introduces itself.
#[derive(Debug, Clone)]
pub(crate) struct Hello {
    /// Its name, empty if it has none.
    pub(crate) name: String,
    /// Its window.
    pub(crate) view: View,
    /// It never becomes the pilot unasked.
    pub(crate) only_watches: bool,
    /// It decodes H.264.
    pub(crate) has_video: bool,
}

/// Who is there.
#[derive(Debug, Default)]
pub(crate) struct People {
    clients: BTreeMap<u32, Hello>,
    pilot: Option<u32>,
    last: u32,
    /// Those who look at a map.
    with_map: BTreeSet<u32>,
}

impl People {
    pub(crate) fn enter(&mut self, mut hello: Hello, is_read_only: bool) -> Result<u32, Refusal> {
        if self.clients.len() >= MOST_CLIENTS {
            return Err(("too-many-clients", format!("{MOST_CLIENTS} clients are connected; try again later")));
        }
        self.last += 1;
        hello.name = hello.name.chars().filter(|c| !c.is_control()).take(NAME_CHARS).collect();
        hello.only_watches |= is_read_only;
        self.clients.insert(self.last, hello);
        self.fill_seat();
        Ok(self.last)
    }

    pub(crate) fn leave(&mut self, client: u32) {
        self.clients.remove(&client);
        self.with_map.remove(&client);
        self.release(client);
    }

    pub(crate) fn want_map(&mut self, client: u32, wanted: bool) {
        if wanted {
            self.with_map.insert(client);
        } else {
            self.with_map.remove(&client);
        }
    }

    pub(crate) fn wants_map(&self, client: u32) -> bool {
        self.with_map.contains(&client)
    }

    pub(crate) fn is_map_wanted(&self) -> bool {
        !self.with_map.is_empty()
    }

    pub(crate) fn take_over(&mut self, client: u32) {
        if let Some(hello) = self.clients.get_mut(&client) {
            hello.only_watches = false;
            self.pilot = Some(client);
        }
    }

    /// A client that gives the seat up does not get it back unasked.
    pub(crate) fn release(&mut self, client: u32) {
        if let Some(hello) = self.clients.get_mut(&client) {
            hello.only_watches = true;
        }
        if self.pilot == Some(client) {
            self.pilot = None;
            self.fill_seat();
        }
    }

    pub(crate) fn resize(&mut self, client: u32, view: View) {
        if let Some(hello) = self.clients.get_mut(&client) {
            hello.view = view;
        }
    }

    /// Without a pilot, the client that has been there for longest becomes it.
    fn fill_seat(&mut self) {
        let first = || self.clients.iter().find(|(_, hello)| !hello.only_watches).map(|(id, _)| *id);
        self.pilot = self.pilot.or_else(first);
    }

    pub(crate) fn pilot(&self) -> Option<u32> {
        self.pilot
    }

    pub(crate) fn pilots_view(&self) -> Option<View> {
        self.clients.get(&self.pilot?).map(|hello| hello.view)
    }

    pub(crate) fn count(&self) -> usize {
        self.clients.len()
    }

    pub(crate) fn names(&self) -> Vec<Value> {
        self.clients.iter().map(|(id, hello)| json!({"id": id, "name": hello.name})).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hello(only_watches: bool) -> Hello {
        Hello { name: "A\nb".into(), view: View::new([800.0, 600.0], 1.0).unwrap(), only_watches, has_video: false }
    }

    #[test]
    fn there_is_one_pilot_and_the_seat_is_filled_by_seniority() {
        let mut people = People::default();
        let ids: Vec<u32> = [true, false, false].map(|watches| people.enter(hello(watches), false).unwrap()).into();
        assert_eq!(people.pilot(), Some(ids[1]));
        people.take_over(ids[0]);
        assert_eq!(people.pilot(), Some(ids[0]));
        people.release(ids[0]);
        assert_eq!(people.pilot(), Some(ids[1]));
        people.leave(ids[1]);
        assert_eq!(people.pilot(), Some(ids[2]));
        people.leave(ids[2]);
        assert_eq!((people.pilot(), people.count()), (None, 1));
        assert_eq!(people.names()[0]["name"], "Ab");
    }

    #[test]
    fn a_crowd_has_a_limit_and_readers_do_not_fly() {
        let mut people = People::default();
        assert!((0..MOST_CLIENTS).all(|_| people.enter(hello(false), true).is_ok()));
        assert_eq!(people.pilot(), None);
        assert_eq!(people.enter(hello(false), true).unwrap_err().0, "too-many-clients");
    }

    #[test]
    fn sizes_are_even_and_within_limits() {
        let size = |size, dpr| View::new(size, dpr).map(View::size_px);
        assert_eq!(size([961.0, 541.0], 1.0), Ok([960, 540]));
        assert_eq!(size([10.0, 20.0], 1.0), Ok([64, 64]));
        let [width, height] = size([3840.0, 2160.0], 2.0).unwrap();
        assert!(width * height <= MOST_PIXELS && width > 1900, "{width}x{height}");
        for (wrong, dpr) in [([f64::NAN, 5.0], 1.0), ([0.0, 5.0], 1.0), ([1e9, 5.0], 1.0), ([5.0, 5.0], 0.0)] {
            assert_eq!(size(wrong, dpr).unwrap_err().0, "bad-size");
        }
    }
}
