//! What a client is sent: one picture that it has not acknowledged, and texts in between.

use super::present::{Next, Shown, next};
use crate::hub::{ExactPicture, Hub, Refusal, Tally};
use crate::picture::{HEADER_BYTES, Level, Picture, header, now_ms};
use axum::extract::ws::{Message, WebSocket};
use bytes::Bytes;
use futures_util::SinkExt;
use futures_util::stream::SplitSink;
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::{mpsc, watch};
use tokio::time::MissedTickBehavior;

/// Longest time that a message is on its way to the client's machine.
const SEND_WITHIN: Duration = Duration::from_secs(30);
/// Between two pings.
const PING_EVERY: Duration = Duration::from_secs(20);
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

/// The client is gone, or as good as gone.
struct Gone;

impl Writer {
    pub(super) fn new(sink: SplitSink<WebSocket, Message>, hub: Arc<Hub>) -> Self {
        let since_figures = Since { at: Instant::now(), pictures: 0, bytes: 0, frames: 0 };
        Self { sink, hub, shown: None, n: 0, since_figures }
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
        mut acknowledged: watch::Receiver<u32>,
    ) -> Option<Refusal> {
        let hub = Arc::clone(&self.hub);
        let (mut pictures, mut exact, mut state) =
            (hub.pictures.subscribe(), hub.exact.subscribe(), hub.state.subscribe());
        let (mut notices, mut ending) = (hub.notices.subscribe(), hub.ending.subscribe());
        let mut pings = tokio::time::interval_at(tokio::time::Instant::now() + PING_EVERY, PING_EVERY);
        let mut figures = tokio::time::interval_at(tokio::time::Instant::now() + FIGURES_EVERY, FIGURES_EVERY);
        figures.set_missed_tick_behavior(MissedTickBehavior::Delay);
        self.text(hub.welcome(client).to_string()).await.ok()?;
        loop {
            if *ending.borrow_and_update() {
                return Some(("ending", "the server ends".into()));
            }
            let is_free = *acknowledged.borrow_and_update() == self.n;
            pictures.mark_unchanged();
            exact.mark_unchanged();
            let wake = match if is_free { next(&hub, self.shown.as_ref()) } else { Next::Nothing(None) } {
                Next::Frame(picture, level) => {
                    self.frame(picture, level).await.ok()?;
                    continue;
                }
                Next::Exact(picture) => {
                    self.exact(&picture).await.ok()?;
                    continue;
                }
                Next::Nothing(wake) => wake,
            };
            tokio::select! {
                answer = answers.recv() => self.text(answer?).await.ok()?,
                _ = acknowledged.changed() => {}
                _ = pictures.changed(), if is_free => {}
                _ = exact.changed(), if is_free => {}
                _ = state.changed() => {
                    let text = state.borrow_and_update().to_string();
                    self.text(text).await.ok()?;
                }
                notice = notices.recv() => match notice {
                    Ok(text) => self.text(text.to_string()).await.ok()?,
                    Err(RecvError::Lagged(_)) => {}
                    Err(RecvError::Closed) => return None,
                },
                _ = ending.changed() => {}
                _ = pings.tick() => self.send(Message::Ping(Bytes::new())).await.ok()?,
                _ = figures.tick() => {
                    let text = self.figures().to_string();
                    self.text(text).await.ok()?;
                }
                () = sleep_until(wake) => {}
            }
        }
    }

    async fn send(&mut self, message: Message) -> Result<(), Gone> {
        let sent = tokio::time::timeout(SEND_WITHIN, self.sink.send(message)).await;
        sent.map_err(|_late| Gone)?.map_err(|_closed| Gone)
    }

    async fn text(&mut self, text: String) -> Result<(), Gone> {
        self.send(Message::Text(text.into())).await
    }

    async fn frame(&mut self, picture: Arc<Picture>, level: Level) -> Result<(), Gone> {
        let file = self.hub.encoder.jpeg(&picture, level).await.map_err(|error| {
            tracing::warn!(%error, "no picture");
            Gone
        })?;
        if level == Level::Moving && picture.sent.client != 0 && picture.since.elapsed() < FIGURES_EVERY {
            self.hub.tally.note_latency(now_ms() - picture.sent.received_ms);
        }
        self.picture(&picture, level, &file).await
    }

    async fn exact(&mut self, exact: &ExactPicture) -> Result<(), Gone> {
        self.picture(&exact.picture, Level::Exact, &exact.file).await
    }

    async fn picture(&mut self, picture: &Picture, level: Level, file: &Bytes) -> Result<(), Gone> {
        self.n = self.n.wrapping_add(1);
        let mut message = Vec::with_capacity(HEADER_BYTES + file.len());
        message.extend_from_slice(&header(picture, level, self.n));
        message.extend_from_slice(file);
        let bytes = message.len() as u64;
        self.send(Message::Binary(message.into())).await?;
        let (scene, number, is_settled) = (picture.scene(), picture.number, picture.is_settled);
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
