//! The WebSocket of a client: what it says is read at once, whatever it is being sent; it is sent
//! one picture at a time.

mod message;
mod pick;
mod present;
mod video;
mod writer;

use crate::hub::{Hello, Hub, MESSAGES_PER_S, Refusal, Tally};
use crate::picture::now_ms;
use axum::extract::ws::{Message, WebSocket};
use futures_util::StreamExt;
use futures_util::stream::SplitStream;
use message::{Acknowledgement, ClientMessage};
use pick::SentPictures;
use serde_json::json;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use subtle::ConstantTimeEq;
use tokio::sync::{mpsc, watch};

/// Longest time to the first message.
const HELLO_AFTER: Duration = Duration::from_secs(10);
/// A client that sends nothing, not even answers to pings, has gone.
const SILENT_AFTER: Duration = Duration::from_secs(60);
/// Answers that wait to be sent; a client that asks and does not read is left.
const MOST_ANSWERS: usize = 64;
/// Most refused messages of a client.
const MOST_ERRORS: u32 = 20;

/// Whether a text is the token, where there is one.
pub(crate) fn is_token(hub: &Hub, text: Option<&str>) -> bool {
    let Some(token) = &hub.setup().token else { return true };
    text.is_some_and(|text| bool::from(token.as_bytes().ct_eq(text.as_bytes())))
}

/// Serves a client until it goes. `is_known`: it has shown the token already.
pub(crate) async fn run(socket: WebSocket, hub: Arc<Hub>, is_known: bool) {
    let (sink, mut stream) = socket.split();
    let mut writer = writer::Writer::new(sink, Arc::clone(&hub));
    let entered = match first(&mut stream, &hub, is_known).await {
        Ok(hello) => {
            writer.has_video(hello.has_video);
            hub.enter(hello)
        }
        Err(refusal) => Err(refusal),
    };
    let client = match entered {
        Ok(client) => client,
        Err(refusal) => {
            Tally::count(&hub.tally.refused, 1);
            return writer.bye(&refusal).await;
        }
    };
    // Given up when all is said.
    let _seat = Seat { hub: Arc::clone(&hub), client };
    let (answers, waiting) = mpsc::channel(MOST_ANSWERS);
    let (acknowledge, acknowledged) = watch::channel(Acknowledgement::default());
    let (round_trip, round_trips) = watch::channel(f64::NAN);
    let (sent, window) = (writer.sent_pictures(), (Instant::now(), 0));
    let mut reader = Reader { hub, client, answers, acknowledge, round_trip, sent, errors: 0, window };
    let refusal = tokio::select! {
        refusal = reader.run(&mut stream) => refusal,
        refusal = writer.run(client, waiting, acknowledged, round_trips) => refusal,
    };
    if let Some(refusal) = refusal {
        writer.bye(&refusal).await;
    }
}

/// A client is there as long as this lives.
struct Seat {
    hub: Arc<Hub>,
    client: u32,
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.hub.leave(self.client);
    }
}

/// Waits for the first message.
async fn first(stream: &mut SplitStream<WebSocket>, hub: &Hub, is_known: bool) -> Result<Hello, Refusal> {
    let late = || ("no-hello", format!("expected hello within {} s", HELLO_AFTER.as_secs()));
    let received = tokio::time::timeout(HELLO_AFTER, stream.next()).await.map_err(|_late| late())?;
    match received {
        Some(Ok(Message::Text(text))) => message::introduce(ClientMessage::read(&text)?, hub, is_known),
        Some(Ok(_)) => Err(("no-hello", "expected hello, a text message".into())),
        Some(Err(error)) => Err(too_large(&error)),
        None => Err(late()),
    }
}

fn too_large(error: &axum::Error) -> Refusal {
    ("too-large", format!("a message cannot be read: {error}"))
}

/// Reads what a client says.
struct Reader {
    hub: Arc<Hub>,
    client: u32,
    answers: mpsc::Sender<String>,
    acknowledge: watch::Sender<Acknowledgement>,
    /// How long a message without content took, there and back, milliseconds.
    round_trip: watch::Sender<f64>,
    /// Which pictures the client was sent.
    sent: Arc<Mutex<SentPictures>>,
    errors: u32,
    /// Since when messages are counted, and how many.
    window: (Instant, u32),
}

impl Reader {
    /// Until the client goes (`None`) or has to go.
    async fn run(&mut self, stream: &mut SplitStream<WebSocket>) -> Option<Refusal> {
        loop {
            let Ok(received) = tokio::time::timeout(SILENT_AFTER, stream.next()).await else { return None };
            let text = match received? {
                Ok(Message::Text(text)) => text,
                Ok(Message::Binary(_)) => {
                    return Some(("too-many-errors", "expected text messages, found a binary one".into()));
                }
                Ok(Message::Ping(_) | Message::Pong(_)) => continue,
                Ok(Message::Close(_)) => return None,
                Err(error) => return Some(too_large(&error)),
            };
            if let Some(refusal) = self.count().or_else(|| self.take(&text)) {
                Tally::count(&self.hub.tally.refused, 1);
                return Some(refusal);
            }
        }
    }

    /// Counts messages.
    fn count(&mut self) -> Option<Refusal> {
        let (since, count) = &mut self.window;
        if since.elapsed() > Duration::from_secs(1) {
            (*since, *count) = (Instant::now(), 0);
        }
        *count += 1;
        (*count > MESSAGES_PER_S).then(|| ("too-fast", format!("expected at most {MESSAGES_PER_S} messages a second")))
    }

    /// Does what a message says, and answers. Why the client has to go, if it has to.
    fn take(&mut self, text: &str) -> Option<Refusal> {
        let answer = match ClientMessage::read(text) {
            Ok(ClientMessage::Ack(acknowledgement)) => {
                self.acknowledge.send_replace(acknowledgement);
                None
            }
            Ok(ClientMessage::Probed { time_ms }) => {
                // Any number may come back.
                let took_ms = now_ms() - time_ms;
                if (0.0..1e5).contains(&took_ms) {
                    self.round_trip.send_replace(took_ms);
                }
                None
            }
            Ok(message) => message::act(message, &self.hub, self.client, &self.sent),
            Err((code, text)) => Some(json!({"type": "error", "code": code, "text": text, "about": null})),
        }?;
        if answer["type"] == "error" {
            Tally::count(&self.hub.tally.refused, 1);
            self.errors += 1;
        }
        let is_stuck = self.answers.try_send(answer.to_string()).is_err();
        if self.errors >= MOST_ERRORS {
            return Some(("too-many-errors", format!("{MOST_ERRORS} messages were refused")));
        }
        is_stuck.then(|| ("too-fast", format!("{MOST_ANSWERS} answers wait to be read")))
    }
}
