//! What a client is sent: one picture that it has not acknowledged, and texts in between.

use super::message::Acknowledgement;
use super::pick::SentPictures;
use super::present::{Next, Shown, next};
use super::video::Video;
use crate::hub::{ExactPicture, Hub, Refusal, Tally, lock};
use crate::picture::{FileKind, HEADER_BYTES, Level, Picture, header, now_ms};
use axum::extract::ws::{Message, WebSocket};
use bytes::Bytes;
use futures_util::SinkExt;
use futures_util::stream::SplitSink;
use serde_json::{Value, json};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::{mpsc, watch};
use tokio::time::MissedTickBehavior;

/// Longest time that a message is on its way to the client's machine.
const SEND_WITHIN: Duration = Duration::from_secs(30);
/// Between two pings.
const PING_EVERY: Duration = Duration::from_secs(20);
/// Between two messages without content to a client that may be sent video: they tell how far away
/// it is, and how busy.
const PROBE_EVERY: Duration = Duration::from_secs(2);
/// Between two messages with figures.
const FIGURES_EVERY: Duration = Duration::from_secs(1);
/// Longest time for the last message.
const BYE_WITHIN: Duration = Duration::from_secs(2);

/// The way to a client.
pub(super) struct Writer {
    sink: SplitSink<WebSocket, Message>,
    hub: Arc<Hub>,
    shown: Option<Shown>,
    /// Number of the picture that was sent last.
    n: u32,
    sent: Arc<Mutex<SentPictures>>,
    /// For a client that decodes video.
    video: Option<Video>,
    /// When it is to be asked next how far away it is.
    probe_at: Instant,
    since_figures: Since,
}

/// What was sent since the last figures.
struct Since {
    at: Instant,
    pictures: u64,
    bytes: u64,
    /// Frames of the flight by then.
    frames: u64,
}

/// When to look for the next picture, at the latest.
#[derive(Default)]
struct Wake {
    is_now: bool,
    at: Option<Instant>,
}

/// The client is gone, or as good as gone.
struct Gone;

impl Writer {
    pub(super) fn new(sink: SplitSink<WebSocket, Message>, hub: Arc<Hub>) -> Self {
        let since_figures = Since { at: Instant::now(), pictures: 0, bytes: 0, frames: 0 };
        let probe_at = Instant::now();
        Self { sink, hub, shown: None, n: 0, sent: Arc::default(), video: None, probe_at, since_figures }
    }

    /// Whether the client decodes video.
    pub(super) fn has_video(&mut self, has_video: bool) {
        self.video = has_video.then(Video::default);
    }

    /// Which pictures the client was sent, from now on.
    pub(super) fn sent_pictures(&self) -> Arc<Mutex<SentPictures>> {
        Arc::clone(&self.sent)
    }

    /// Says why the client has to go.
    pub(super) async fn bye(&mut self, (code, text): &Refusal) {
        let bye = json!({"type": "bye", "code": code, "text": text}).to_string();
        let end = async {
            if self.sink.send(Message::Text(bye.into())).await.is_ok() {
                self.sink.close().await.ok();
            }
        };
        tokio::time::timeout(BYE_WITHIN, end).await.ok();
    }

    /// Until the client goes (`None`) or has to go.
    pub(super) async fn run(
        &mut self,
        client: u32,
        mut answers: mpsc::Receiver<String>,
        mut acknowledged: watch::Receiver<Acknowledgement>,
        mut round_trips: watch::Receiver<f64>,
    ) -> Option<Refusal> {
        let hub = Arc::clone(&self.hub);
        let (mut pictures, mut exact, mut state) =
            (hub.pictures.subscribe(), hub.exact.subscribe(), hub.state.subscribe());
        let (mut notices, mut ending) = (hub.notices.subscribe(), hub.ending.subscribe());
        let mut pings = tokio::time::interval_at(tokio::time::Instant::now() + PING_EVERY, PING_EVERY);
        let mut figures = tokio::time::interval_at(tokio::time::Instant::now() + FIGURES_EVERY, FIGURES_EVERY);
        figures.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let (mut films, mut map) = (hub.films.changed.subscribe(), hub.map.subscribe());
        self.text(hub.welcome(client).to_string()).await.ok()?;
        films.mark_changed();
        loop {
            if *ending.borrow_and_update() {
                return Some(("ending", "the server ends".into()));
            }
            let acknowledgement = *acknowledged.borrow_and_update();
            let is_free = acknowledgement.n == self.n;
            pictures.mark_unchanged();
            exact.mark_unchanged();
            let wake = if is_free { self.advance(&acknowledgement).await.ok()? } else { Wake::default() };
            if wake.is_now {
                continue;
            }
            tokio::select! {
                answer = answers.recv() => self.text(answer?).await.ok()?,
                _ = acknowledged.changed() => {}
                _ = pictures.changed(), if is_free => {}
                _ = exact.changed(), if is_free => {}
                _ = state.changed() => {
                    let text = state.borrow_and_update().to_string();
                    self.text(text).await.ok()?;
                }
                _ = films.changed() => {
                    let text = films.borrow_and_update().to_string();
                    self.text(text).await.ok()?;
                }
                _ = map.changed() => {
                    let text = Arc::clone(&map.borrow_and_update());
                    if &*text != "{}" && hub.wants_map(client) {
                        self.text(text.to_string()).await.ok()?;
                    }
                }
                notice = notices.recv() => match notice {
                    Ok(text) => self.text(text.to_string()).await.ok()?,
                    Err(RecvError::Lagged(_)) => {}
                    Err(RecvError::Closed) => return None,
                },
                _ = ending.changed() => {}
                _ = pings.tick() => self.send(Message::Ping(Bytes::new())).await.ok()?,
                _ = round_trips.changed() => {
                    let ms = *round_trips.borrow_and_update();
                    self.video.iter_mut().for_each(|video| video.link.note_round_trip(ms));
                }
                _ = figures.tick() => {
                    let text = self.figures().to_string();
                    self.text(text).await.ok()?;
                }
                () = sleep_until(wake.at) => {}
            }
        }
    }

    /// Sends the next picture to a client that has acknowledged the last one, if there is a better
    /// one.
    async fn advance(&mut self, acknowledgement: &Acknowledgement) -> Result<Wake, Gone> {
        if let Some(video) = &mut self.video {
            video.acknowledged(acknowledgement);
            // Before a picture: behind it a probe would tell how long that takes.
            if self.probe_at <= Instant::now() {
                self.probe_at = Instant::now() + PROBE_EVERY;
                self.text(json!({"type": "probe", "time_ms": now_ms()}).to_string()).await?;
            }
        }
        match next(&self.hub, self.shown.as_ref()) {
            Next::Frame(picture, level) => self.frame(picture, level).await?,
            Next::Exact(picture) => self.exact(&picture).await?,
            Next::Nothing(at) => {
                let probe_at = self.video.is_some().then_some(self.probe_at);
                return Ok(Wake { is_now: false, at: at.into_iter().chain(probe_at).min() });
            }
        }
        Ok(Wake { is_now: true, at: None })
    }

    async fn send(&mut self, message: Message) -> Result<(), Gone> {
        let sent = tokio::time::timeout(SEND_WITHIN, self.sink.send(message)).await;
        sent.map_err(|_late| Gone)?.map_err(|_closed| Gone)
    }

    async fn text(&mut self, text: String) -> Result<(), Gone> {
        self.send(Message::Text(text.into())).await
    }

    async fn frame(&mut self, picture: Arc<Picture>, level: Level) -> Result<(), Gone> {
        if let Some(video) = self.video.as_mut().filter(|_| level == Level::Moving) {
            let (unit, notice) = video.unit(&self.hub, &picture).await;
            if let Some(text) = notice {
                self.text(json!({"type": "notice", "level": "info", "text": text}).to_string()).await?;
            }
            if let Some(unit) = unit {
                self.note_latency(&picture, level);
                return self.picture(&picture, level, FileKind::Video { is_key: unit.is_key }, &unit.file).await;
            }
        }
        let file = self.hub.encoder.jpeg(&picture, level).await.map_err(|error| {
            tracing::warn!(%error, "no picture");
            Gone
        })?;
        if let Some(video) = self.video.as_mut().filter(|_| level == Level::Moving) {
            video.link.note_jpeg(file.len());
        }
        self.note_latency(&picture, level);
        self.picture(&picture, level, FileKind::Still, &file).await
    }

    fn note_latency(&self, picture: &Picture, level: Level) {
        if level == Level::Moving && picture.sent.client != 0 && picture.since.elapsed() < FIGURES_EVERY {
            self.hub.tally.note_latency(now_ms() - picture.sent.received_ms);
        }
    }

    async fn exact(&mut self, exact: &ExactPicture) -> Result<(), Gone> {
        self.picture(&exact.picture, Level::Exact, FileKind::Still, &exact.file).await
    }

    async fn picture(&mut self, picture: &Picture, level: Level, kind: FileKind, file: &Bytes) -> Result<(), Gone> {
        self.n = self.n.wrapping_add(1);
        let mut message = Vec::with_capacity(HEADER_BYTES + file.len());
        message.extend_from_slice(&header(picture, level, kind, self.n));
        message.extend_from_slice(file);
        let bytes = message.len() as u64;
        self.video.iter_mut().for_each(|video| video.sent(message.len()));
        self.send(Message::Binary(message.into())).await?;
        let (scene, number, is_settled) = (picture.scene(), picture.number, picture.is_settled);
        lock(&self.sent).note(self.n, scene, number);
        self.shown = Some(Shown { scene, level, number, is_settled, at: Instant::now() });
        Tally::count(&self.hub.tally.pictures, 1);
        Tally::count(&self.hub.tally.bytes, bytes);
        self.since_figures.pictures += 1;
        self.since_figures.bytes += bytes;
        Ok(())
    }

    /// `figures` of the protocol.
    fn figures(&mut self) -> Value {
        let hub = &self.hub;
        let frames = hub.tally.frames.load(std::sync::atomic::Ordering::Relaxed);
        let now = Since { at: Instant::now(), pictures: 0, bytes: 0, frames };
        let since = std::mem::replace(&mut self.since_figures, now);
        let seconds = since.at.elapsed().as_secs_f64().max(1e-3);
        let rate = |count: u64| (count as f64 / seconds * 10.0).round() / 10.0;
        json!({
            "type": "figures",
            "fps": rate(frames.saturating_sub(if since.frames == 0 { frames } else { since.frames })),
            "sent_fps": rate(since.pictures),
            "bytes_per_s": rate(since.bytes),
            "encode_ms": hub.encoder.median_ms(),
            "pose_to_picture_ms": hub.tally.latency_ms(),
            "clients": hub.clients(),
            "flight": *hub.flight_metrics.borrow(),
        })
    }
}

async fn sleep_until(moment: Option<Instant>) {
    match moment {
        Some(moment) => tokio::time::sleep_until(moment.into()).await,
        None => std::future::pending().await,
    }
}
