//! What all sessions share: the newest picture, who is the pilot, how the flight is. Nothing here
//! waits for a client.

pub(crate) mod flight_metrics;
pub(crate) mod news;
mod people;
mod poses;
pub(crate) mod wishes;

pub(crate) use people::{Hello, View};

use crate::encoder::{Encoder, median};
use crate::launcher_link::LauncherLink;
use crate::picture::{Picture, Scene, SentPose};
use crate::stills::{StillOrder, Stills};
use crate::terrain::Terrain;
use bytes::Bytes;
use people::{MOST_CLIENTS, People};
use poses::Poses;
use serde_json::{Value, json};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use terravision_common::viewer::{
    FlightNews, FlightState, FromViewer, SIDES_PX, StreamSettings, ViewerPose, ViewerSetup,
};
use tokio::sync::{Semaphore, broadcast, watch};
use wishes::{FlightOrder, MOST_PIXELS};

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
    pub(crate) poses: Poses,
    pub(crate) tally: Tally,
    /// Questions for heights that are answered at a time.
    pub(crate) reading: Semaphore,
    pub(crate) pictures: watch::Sender<Option<Arc<Picture>>>,
    pub(crate) exact: watch::Sender<Option<Arc<ExactPicture>>>,
    pub(crate) notices: broadcast::Sender<Arc<str>>,
    /// `state` of the protocol, as text.
    pub(crate) state: watch::Sender<Arc<str>>,
    pub(crate) flight: watch::Sender<FlightNews>,
    pub(crate) wish: watch::Sender<Option<FlightOrder>>,
    /// Metrics of the flight by name, or null.
    pub(crate) flight_metrics: watch::Sender<Value>,
    pub(crate) ending: watch::Sender<bool>,
    link: LauncherLink,
    people: Mutex<People>,
}

/// Why a client may not do what it asks for: a code and a sentence.
pub(crate) type Refusal = (&'static str, String);

pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Hub {
    pub(crate) fn new(link: LauncherLink, terrain: Terrain) -> Self {
        let flight = FlightNews {
            number: 0,
            pid: 0,
            state: FlightState::Starting,
            reason: None,
            size: [SIDES_PX[0]; 2],
            settings: StreamSettings::default(),
            metrics: None,
        };
        let hub = Self {
            terrain,
            encoder: Encoder::default(),
            stills: Stills::new(&link.setup),
            poses: Poses::new(link.setup.start),
            tally: Tally::default(),
            reading: Semaphore::new(MOST_READING),
            pictures: watch::Sender::new(None),
            exact: watch::Sender::new(None),
            notices: broadcast::Sender::new(KEPT_NOTICES),
            state: watch::Sender::new(Arc::from("{}")),
            flight: watch::Sender::new(flight),
            wish: watch::Sender::new(None),
            flight_metrics: watch::Sender::new(Value::Null),
            ending: watch::Sender::new(false),
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
    pub(crate) fn note_flight(&self, news: FlightNews) {
        self.flight.send_replace(news);
        self.publish_state();
    }

    /// The first picture of a flight has come.
    pub(crate) fn note_flying(&self, number: u32) {
        let is_new = |news: &mut FlightNews| {
            let is_new = news.number == number && news.state != FlightState::Flying;
            if is_new {
                (news.state, news.reason) = (FlightState::Flying, None);
            }
            is_new
        };
        if self.flight.send_if_modified(is_new) {
            self.link.tell(&FromViewer::Flying { number });
            self.publish_state();
        }
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
            "flight": flight.state, "reason": flight.reason, "size": flight.size, "settings": flight.settings,
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
        self.wish_size();
    }

    fn people_changed(&self) {
        self.publish_state();
        self.wish_size();
    }

    /// The flight is to have the size of the pilot's window.
    fn wish_size(&self) {
        let Some(size) = lock(&self.people).pilots_view().map(|view| view.size_px()) else { return };
        self.change_wish(|wish| wish.size = size);
    }

    fn change_wish(&self, change: impl FnOnce(&mut FlightOrder)) {
        let flight = self.flight.borrow().clone();
        self.wish.send_if_modified(|wish| {
            let mut new = wish.clone().unwrap_or(FlightOrder { size: flight.size, settings: flight.settings });
            change(&mut new);
            let is_new = wish.as_ref() != Some(&new);
            *wish = Some(new);
            is_new
        });
    }

    /// What was wished for cannot be flown; the wish is to be what is flown, so that the next one
    /// does not repeat it.
    pub(crate) fn forget_wish(&self, size: [u32; 2], settings: StreamSettings) {
        self.wish.send_if_modified(|wish| {
            *wish = Some(FlightOrder { size, settings });
            // The launcher knows.
            false
        });
    }

    fn check_writable(&self) -> Result<(), Refusal> {
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
        let mut settings = self.wish.borrow().as_ref().map_or(flight, |wish| wish.settings.clone());
        change(&mut settings);
        if let Some(fault) = settings.fault() {
            return Err(("bad-settings", fault));
        }
        self.change_wish(|wish| wish.settings = settings);
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

    /// The exact picture at a pose, at the size and in the settings of the flight where these are
    /// not given.
    pub(crate) fn still_order(&self, pose: ViewerPose, size: Option<[u32; 2]>) -> StillOrder {
        let flight = self.flight.borrow();
        StillOrder { pose, size: size.unwrap_or(flight.size), settings: flight.settings.clone() }
    }

    /// A pose by its time, or the pose of a frame that nobody here has sent.
    pub(crate) fn sent_pose(&self, time_s: f64) -> Option<SentPose> {
        self.poses.of_time(time_s)
    }
}
