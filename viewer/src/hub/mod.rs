//! What all sessions share: the newest picture, who is the pilot, how the flight is. Nothing here
//! waits for a client.

pub(crate) mod conversion;
pub(crate) mod films;
pub(crate) mod flight_metrics;
pub(crate) mod launcher_events;
pub(crate) mod orders;
mod pace;
mod people;
mod poses;
mod recent;
pub(crate) mod tile_map;

pub(crate) use pace::Pace;
pub(crate) use people::{Hello, View};
pub(crate) use poses::Room;

use crate::encoder::{Encoder, median};
use crate::launcher_link::LauncherLink;
use crate::picture::{Picture, Scene, SentPose};
use crate::stills::{StillOrder, Stills};
use crate::terrain::Terrain;
use crate::video::MOST_ENCODERS;
use bytes::Bytes;
use conversion::Conversions;
use films::Films;
use orders::{FlightOrder, MOST_PIXELS};
use people::{MOST_CLIENTS, People};
use poses::Poses;
use recent::Recent;
use serde_json::{Value, json};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use terravision_common::viewer::{
    FlightState, FlightStatus, FromViewer, SIDES_PX, StreamSettings, ViewerPose, ViewerSetup,
};
use tokio::sync::{Semaphore, broadcast, watch};

/// Number of the protocol.
pub(crate) const PROTOCOL: u32 = 1;
/// Longest message of a client, bytes.
pub(crate) const MESSAGE_BYTES: usize = 16 << 10;
/// Most messages of a client in a second.
pub(crate) const MESSAGES_PER_S: u32 = 240;
/// Most places in one question for heights.
pub(crate) const MOST_HEIGHTS: usize = 4096;
/// Most questions for heights that are answered at a time; others wait.
const MOST_READING: usize = 2;
/// Notices that wait for a client that is slow; it misses older ones.
const KEPT_NOTICES: usize = 32;
/// Times that the median is of.
const KEPT_TIMES: usize = 64;

/// An exact picture of a scene.
#[derive(Debug)]
pub(crate) struct ExactPicture {
    /// The picture whose pose it has.
    pub(crate) picture: Arc<Picture>,
    /// The PNG file.
    pub(crate) file: Bytes,
}

/// What was done so far.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    /// Frames that were taken from the ring.
    pub(crate) frames: AtomicU64,
    /// Pictures that were sent, and their bytes.
    pub(crate) pictures: AtomicU64,
    pub(crate) bytes: AtomicU64,
    /// Poses that were accepted.
    pub(crate) poses: AtomicU64,
    /// Messages and requests that were refused.
    pub(crate) refused: AtomicU64,
    /// From pose to encoded picture, milliseconds.
    latencies_ms: Mutex<VecDeque<f64>>,
}

impl Tally {
    /// One more.
    pub(crate) fn count(counter: &AtomicU64, more: u64) {
        // Relaxed: a figure for people.
        counter.fetch_add(more, Ordering::Relaxed);
    }

    /// A moving picture was sent so long after its pose came in.
    pub(crate) fn note_latency(&self, milliseconds: f64) {
        let mut kept = lock(&self.latencies_ms);
        kept.push_back(milliseconds);
        if kept.len() > KEPT_TIMES {
            kept.pop_front();
        }
    }

    /// The median of the last ones.
    pub(crate) fn latency_ms(&self) -> Option<f64> {
        median(&lock(&self.latencies_ms))
    }
}

/// What all sessions share.
#[derive(Debug)]
pub(crate) struct Hub {
    pub(crate) terrain: Terrain,
    pub(crate) encoder: Encoder,
    pub(crate) stills: Stills,
    pub(crate) films: Films,
    pub(crate) conversions: Conversions,
    pub(crate) poses: Poses,
    pub(crate) tally: Tally,
    /// Questions for heights that are answered at a time.
    pub(crate) reading: Semaphore,
    /// Encoders of video that may be started.
    pub(crate) encoders: Arc<Semaphore>,
    pub(crate) recent: Recent,
    pub(crate) pictures: watch::Sender<Option<Arc<Picture>>>,
    pub(crate) exact: watch::Sender<Option<Arc<ExactPicture>>>,
    pub(crate) notices: broadcast::Sender<Arc<str>>,
    /// `state` of the protocol, as text.
    pub(crate) state: watch::Sender<Arc<str>>,
    /// `map` of the protocol, as text.
    pub(crate) map: watch::Sender<Arc<str>>,
    pub(crate) flight: watch::Sender<FlightStatus>,
    pub(crate) order: watch::Sender<Option<FlightOrder>>,
    /// Metrics of the flight by name, or null.
    pub(crate) flight_metrics: watch::Sender<Value>,
    pub(crate) ending: watch::Sender<bool>,
    /// Whether somebody looks, as the launcher was told.
    audience: watch::Sender<bool>,
    link: LauncherLink,
    people: Mutex<People>,
}

/// The largest pictures of a flight that is to draw some of this size. Of two eyes it draws one
/// size alone; else it has room for what it had room for before.
fn room_for(size: [u32; 2], order: &FlightOrder) -> [u32; 2] {
    let both = [0, 1].map(|axis| size[axis].max(order.size[axis]));
    if order.settings.stereo().is_some() || both[0] * both[1] > MOST_PIXELS { size } else { both }
}

/// Why a client may not do what it asks for: a code and a sentence.
pub(crate) type Refusal = (&'static str, String);

pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Hub {
    pub(crate) fn new(link: LauncherLink, terrain: Terrain) -> Self {
        let flight = link.first_flight.clone();
        let hub = Self {
            terrain,
            encoder: Encoder::default(),
            stills: Stills::new(&link.setup),
            films: Films::new(&link.setup),
            conversions: Conversions::default(),
            poses: Poses::new(link.setup.start),
            tally: Tally::default(),
            reading: Semaphore::new(MOST_READING),
            encoders: Arc::new(Semaphore::new(MOST_ENCODERS)),
            recent: Recent::default(),
            pictures: watch::Sender::new(None),
            exact: watch::Sender::new(None),
            notices: broadcast::Sender::new(KEPT_NOTICES),
            state: watch::Sender::new(Arc::from("{}")),
            map: watch::Sender::new(Arc::from("{}")),
            flight: watch::Sender::new(flight),
            order: watch::Sender::new(None),
            flight_metrics: watch::Sender::new(Value::Null),
            ending: watch::Sender::new(false),
            audience: watch::Sender::new(false),
            link,
            people: Mutex::default(),
        };
        hub.publish_state();
        hub
    }

    /// What this viewer is to serve.
    pub(crate) fn setup(&self) -> &ViewerSetup {
        &self.link.setup
    }

    /// Everything ends.
    pub(crate) fn end(&self) {
        self.ending.send_replace(true);
    }

    /// The flight has changed.
    pub(crate) fn note_flight(&self, flight: FlightStatus) {
        self.flight.send_replace(flight);
        self.publish_state();
    }

    /// The first picture of a flight has come.
    pub(crate) fn note_flying(&self, number: u32) {
        let is_new = |flight: &mut FlightStatus| {
            let is_new = flight.number == number && flight.state != FlightState::Flying;
            if is_new {
                (flight.state, flight.reason) = (FlightState::Flying, None);
            }
            is_new
        };
        if self.flight.send_if_modified(is_new) {
            self.link.tell(&FromViewer::Flying { number });
        }
        // Its room for pictures is known now.
        self.publish_state();
    }

    /// Tells all clients.
    pub(crate) fn note(&self, is_warning: bool, text: String) {
        let level = if is_warning { "warning" } else { "info" };
        let text = json!({"type": "notice", "level": level, "text": text}).to_string();
        // Nobody may be there.
        self.notices.send(text.into()).ok();
    }

    fn publish_state(&self) {
        let mut state = self.state_value();
        state["type"] = json!("state");
        self.state.send_replace(state.to_string().into());
    }

    fn state_value(&self) -> Value {
        let flight = self.flight.borrow().clone();
        let people = lock(&self.people);
        json!({
            "flight": flight.state, "reason": flight.reason, "size": self.size(), "settings": flight.settings,
            "pilot": people.pilot(), "people": people.names(),
        })
    }

    /// What is the same for all clients.
    pub(crate) fn info(&self) -> Value {
        let mut world = self.terrain.facts();
        world["start"] = json!(self.setup().start);
        let (low, high) = ([SIDES_PX[0]; 2], [SIDES_PX[1]; 2]);
        json!({
            "protocol": PROTOCOL,
            "version": env!("CARGO_PKG_VERSION"),
            "is_read_only": self.setup().is_read_only,
            "world": world,
            "limits": {
                "size": [low, high], "pixels": MOST_PIXELS, "message_bytes": MESSAGE_BYTES, "messages_per_s": MESSAGES_PER_S,
                "clients": MOST_CLIENTS, "heights": MOST_HEIGHTS,
            },
        })
    }

    /// `welcome` of the protocol.
    pub(crate) fn welcome(&self, you: u32) -> Value {
        let mut welcome = self.info();
        let state = self.state_value();
        if let (Some(welcome), Value::Object(state)) = (welcome.as_object_mut(), state) {
            welcome.extend(state);
        }
        welcome["type"] = json!("welcome");
        welcome["you"] = json!(you);
        welcome
    }

    /// A client comes: its id, or why it may not.
    pub(crate) fn enter(&self, hello: Hello) -> Result<u32, Refusal> {
        let id = lock(&self.people).enter(hello, self.setup().is_read_only)?;
        self.people_changed();
        Ok(id)
    }

    /// A client has gone.
    pub(crate) fn leave(&self, client: u32) {
        lock(&self.people).leave(client);
        self.people_changed();
    }

    /// A client looks at a map, or no longer.
    pub(crate) fn want_map(&self, client: u32, wanted: bool) {
        lock(&self.people).want_map(client, wanted);
        // It is told what there is, changed or not.
        self.map.send_replace(Arc::from("{}"));
    }

    /// Whether a client looks at a map.
    pub(crate) fn wants_map(&self, client: u32) -> bool {
        lock(&self.people).wants_map(client)
    }

    /// Whether anybody does.
    pub(crate) fn is_map_wanted(&self) -> bool {
        lock(&self.people).is_map_wanted()
    }

    /// How many clients there are.
    pub(crate) fn clients(&self) -> usize {
        lock(&self.people).count()
    }

    /// A client becomes the pilot.
    pub(crate) fn take_over(&self, client: u32) -> Result<(), Refusal> {
        self.check_writable()?;
        lock(&self.people).take_over(client);
        self.people_changed();
        Ok(())
    }

    /// A client no longer is the pilot.
    pub(crate) fn release(&self, client: u32) {
        lock(&self.people).release(client);
        self.people_changed();
    }

    /// The window of a client has changed.
    pub(crate) fn resize(&self, client: u32, view: View) {
        lock(&self.people).resize(client, view);
        self.order_size();
        self.publish_state();
    }

    fn people_changed(&self) {
        self.order_size();
        self.publish_state();
        let looks = self.clients() > 0;
        let is_new = |before: &mut bool| std::mem::replace(before, looks) != looks;
        if self.audience.send_if_modified(is_new) {
            self.link.tell(&FromViewer::Audience { looks });
        }
    }

    /// Pictures are to have the size of the pilot's window; a flight that has no room for them is
    /// started again with more.
    fn order_size(&self) {
        let Some(size) = lock(&self.people).pilots_view().map(|view| view.size_px()) else { return };
        self.poses.set_size(size);
        self.change_order(|order| order.size = room_for(size, order));
    }

    /// Size of the stream's pictures; while the camera moves they may be smaller.
    pub(crate) fn size(&self) -> [u32; 2] {
        self.poses.size()
    }

    fn change_order(&self, change: impl FnOnce(&mut FlightOrder)) {
        let flight = self.flight.borrow().clone();
        self.order.send_if_modified(|order| {
            let mut new = order.clone().unwrap_or(FlightOrder { size: flight.size, settings: flight.settings });
            change(&mut new);
            let is_new = order.as_ref() != Some(&new);
            *order = Some(new);
            is_new
        });
    }

    /// What was ordered cannot be flown; the order is to be what is flown, so that the next one
    /// does not repeat it.
    pub(crate) fn forget_order(&self, size: [u32; 2], settings: StreamSettings) {
        self.order.send_if_modified(|order| {
            *order = Some(FlightOrder { size, settings });
            // The launcher knows.
            false
        });
    }

    pub(crate) fn check_writable(&self) -> Result<(), Refusal> {
        if self.setup().is_read_only {
            return Err(("read-only", "this server is read-only: nobody moves the camera or changes settings".into()));
        }
        Ok(())
    }

    fn check_pilot(&self, client: u32) -> Result<(), Refusal> {
        self.check_writable()?;
        if lock(&self.people).pilot() != Some(client) {
            return Err(("not-pilot", "another client is the pilot: take over first".into()));
        }
        Ok(())
    }

    /// The pilot changes how the flight draws.
    pub(crate) fn set_settings(&self, client: u32, change: impl FnOnce(&mut StreamSettings)) -> Result<(), Refusal> {
        self.check_pilot(client)?;
        let flight = self.flight.borrow().settings.clone();
        let mut settings = self.order.borrow().as_ref().map_or(flight, |order| order.settings.clone());
        change(&mut settings);
        if let Some(fault) = settings.fault() {
            return Err(("bad-settings", fault));
        }
        let size = lock(&self.people).pilots_view().map(|view| view.size_px());
        self.change_order(|order| {
            order.settings = settings;
            order.size = size.map_or(order.size, |size| room_for(size, order));
        });
        Ok(())
    }

    /// The pilot moves the camera.
    pub(crate) fn fly_to(&self, client: u32, id: u32, pose: ViewerPose) -> Result<(), Refusal> {
        self.check_pilot(client)?;
        if let Some(fault) = pose.fault() {
            return Err(("bad-pose", fault));
        }
        if self.terrain.is_far(pose.x, pose.y) {
            return Err(("bad-pose", format!("x, y: expected a place near the world, found {}, {}", pose.x, pose.y)));
        }
        self.poses.send(client, id, pose);
        Tally::count(&self.tally.poses, 1);
        Ok(())
    }

    /// Whether a picture shows where the camera is now.
    pub(crate) fn is_newest(&self, picture: &Picture) -> bool {
        picture.sent.time_s == self.poses.newest().time_s && picture.flight == self.flight.borrow().number
    }

    /// The exact picture of a scene, if there is one.
    pub(crate) fn exact_of(&self, scene: Scene) -> Option<Arc<ExactPicture>> {
        self.exact.borrow().clone().filter(|exact| exact.picture.scene() == scene)
    }

    /// The exact picture at a pose, in the settings of the flight, at its size where none is given.
    /// `has_stereo`: with both eyes, where the flight shows two.
    pub(crate) fn still_order(&self, pose: ViewerPose, size: Option<[u32; 2]>, has_stereo: bool) -> StillOrder {
        let flight = self.flight.borrow();
        let mut settings = flight.settings.clone();
        settings.stereo = settings.stereo.filter(|_| has_stereo);
        StillOrder { pose, size: settings.eye_size(size.unwrap_or(self.size())), settings }
    }

    /// A pose by its time, or the pose of a frame that nobody here has sent.
    pub(crate) fn sent_pose(&self, time_s: f64) -> Option<SentPose> {
        self.poses.of_time(time_s)
    }
}
