//! A client of the WebSocket.

use crate::server::{DEADLINE, Server};
use serde_json::{Value, json};
use std::io::ErrorKind;
use std::net::TcpStream;
use std::time::{Duration, Instant};
use tungstenite::client::IntoClientRequest;
use tungstenite::{Error, HandshakeError, Message, WebSocket};

/// What a client hears.
#[derive(Debug)]
pub(crate) enum Heard {
    Text(Value),
    Picture(Picture),
    Closed,
}

/// A picture, its header read.
#[derive(Debug, Clone)]
pub(crate) struct Picture {
    pub(crate) n: u32,
    pub(crate) is_png: bool,
    pub(crate) is_video: bool,
    pub(crate) flags: u8,
    pub(crate) quality: u16,
    pub(crate) size: [u32; 2],
    pub(crate) id: u32,
    pub(crate) client: u32,
    /// x, y, z, heading, pitch, roll, vfov.
    pub(crate) pose: [f64; 7],
    /// Pose came in, frame drawn, file encoded.
    pub(crate) times_ms: [f64; 3],
    pub(crate) flight: u32,
    pub(crate) file: Vec<u8>,
}

pub(crate) const IS_EXACT: u8 = 8;
pub(crate) const IS_KEY: u8 = 16;

impl Picture {
    fn read(bytes: &[u8]) -> Self {
        let u16_at = |at: usize| u16::from_le_bytes(bytes[at..at + 2].try_into().unwrap());
        let u32_at = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        let f64_at = |at: usize| f64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
        assert_eq!((&bytes[..4], u16_at(4), u32_at(124)), (&b"TVPF"[..], 1, 0));
        Self {
            n: u32_at(8),
            is_png: bytes[12] == 1,
            is_video: bytes[12] == 2,
            flags: bytes[13],
            quality: u16_at(14),
            size: [24, 28].map(u32_at),
            id: u32_at(32),
            client: u32_at(36),
            pose: std::array::from_fn(|i| f64_at(40 + 8 * i)),
            times_ms: [96, 104, 112].map(f64_at),
            flight: u32_at(120),
            file: bytes[usize::from(u16_at(6))..].to_vec(),
        }
    }

    pub(crate) fn is_exact(&self) -> bool {
        self.flags & IS_EXACT != 0
    }
}

pub(crate) struct Client {
    socket: WebSocket<TcpStream>,
    pub(crate) id: u64,
    pub(crate) start: Value,
    /// The newest `state`, or `welcome`.
    pub(crate) state: Value,
    /// What it was told in notices.
    pub(crate) notices: Vec<String>,
    acknowledges: bool,
}

/// Connects; the status of a server that refuses.
pub(crate) fn connect(server: &Server, head: &[(&'static str, &str)]) -> Result<WebSocket<TcpStream>, u16> {
    let stream = TcpStream::connect(("127.0.0.1", server.port)).unwrap();
    stream.set_read_timeout(Some(DEADLINE)).unwrap();
    let mut request = format!("ws://127.0.0.1:{}/api/socket", server.port).into_client_request().unwrap();
    for (name, value) in head {
        request.headers_mut().insert(*name, value.parse().unwrap());
    }
    match tungstenite::client(request, stream) {
        Ok((socket, _)) => Ok(socket),
        Err(HandshakeError::Failure(Error::Http(response))) => Err(response.status().as_u16()),
        Err(error) => panic!("{error}"),
    }
}

pub(crate) fn hello(size: [u32; 2]) -> Value {
    json!({"type": "hello", "protocol": 1, "name": "test", "size": size, "dpr": 1})
}

/// The text with which a server says good-bye to a client that begins like this.
pub(crate) fn bye_after(server: &Server, first: Message) -> Value {
    let mut socket = connect(server, &[]).unwrap();
    socket.send(first).unwrap();
    loop {
        match socket.read() {
            Ok(Message::Text(text)) => {
                let value: Value = serde_json::from_str(&text).unwrap();
                if value["type"] == "bye" {
                    return value;
                }
            }
            Ok(_) => {}
            Err(error) => panic!("no bye: {error}"),
        }
    }
}

impl Client {
    /// Connects and says hello.
    pub(crate) fn enter(server: &Server, size: [u32; 2]) -> Self {
        Self::enter_with(server, hello(size))
    }

    pub(crate) fn enter_with(server: &Server, hello: Value) -> Self {
        let socket = connect(server, &[]).unwrap();
        let mut client =
            Self { socket, id: 0, start: Value::Null, state: Value::Null, notices: Vec::new(), acknowledges: true };
        client.say(&hello);
        let welcome = client.text("welcome");
        client.id = welcome["you"].as_u64().unwrap();
        client.start = welcome["world"]["start"].clone();
        client
    }

    pub(crate) fn say(&mut self, message: &Value) {
        self.say_text(&message.to_string());
    }

    pub(crate) fn say_text(&mut self, text: &str) {
        self.socket.send(Message::text(text)).unwrap();
    }

    /// From now on pictures are acknowledged, or not.
    pub(crate) fn acknowledge(&mut self, does: bool) {
        self.acknowledges = does;
    }

    pub(crate) fn acknowledge_picture(&mut self, n: u32) {
        self.say(&json!({"type": "ack", "n": n}));
    }

    /// The next thing heard, or nothing within this time.
    pub(crate) fn hear(&mut self, within: Duration) -> Option<Heard> {
        self.socket.get_mut().set_read_timeout(Some(within.max(Duration::from_millis(1)))).unwrap();
        match self.socket.read() {
            Ok(Message::Text(text)) => {
                let value: Value = serde_json::from_str(&text).unwrap();
                if value["type"] == "state" || value["type"] == "welcome" {
                    self.state = value.clone();
                }
                if value["type"] == "notice" {
                    self.notices.push(value["text"].as_str().unwrap().to_owned());
                }
                if value["type"] == "probe" {
                    self.say(&json!({"type": "probed", "time_ms": value["time_ms"]}));
                }
                Some(Heard::Text(value))
            }
            Ok(Message::Binary(bytes)) => {
                let picture = Picture::read(&bytes);
                if self.acknowledges {
                    self.acknowledge_picture(picture.n);
                }
                Some(Heard::Picture(picture))
            }
            Ok(Message::Close(_)) | Err(Error::ConnectionClosed | Error::AlreadyClosed | Error::Protocol(_)) => {
                Some(Heard::Closed)
            }
            Ok(_) => None,
            Err(Error::Io(error)) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => None,
            Err(Error::Io(_)) => Some(Heard::Closed),
            Err(error) => panic!("{error}"),
        }
    }

    /// Hears until `pick` takes something.
    pub(crate) fn until<T>(&mut self, what: &str, mut pick: impl FnMut(&Self, Heard) -> Option<T>) -> T {
        let end = Instant::now() + DEADLINE;
        while Instant::now() < end {
            let Some(heard) = self.hear(Duration::from_millis(200)) else { continue };
            assert!(!matches!(heard, Heard::Closed) || what == "the end", "closed before {what}");
            if let Some(found) = pick(self, heard) {
                return found;
            }
        }
        panic!("no sign of {what}; the state is {}", self.state);
    }

    /// The next text of this type.
    pub(crate) fn text(&mut self, kind: &str) -> Value {
        self.until(kind, |_, heard| match heard {
            Heard::Text(value) if value["type"] == kind => Some(value),
            _ => None,
        })
    }

    /// The next picture that `is_it`.
    pub(crate) fn picture(&mut self, what: &str, is_it: impl Fn(&Picture) -> bool) -> Picture {
        self.until(what, |_, heard| match heard {
            Heard::Picture(picture) if is_it(&picture) => Some(picture),
            _ => None,
        })
    }

    /// Waits for a flight of this size that flies.
    pub(crate) fn flying(&mut self, size: [u32; 2]) -> Value {
        let is_so = |state: &Value| state["flight"] == "flying" && state["size"] == json!(size);
        if !is_so(&self.state) {
            self.until("the flight", |client, _| is_so(&client.state).then_some(()));
        }
        self.state.clone()
    }

    /// The code of the error that answers a message.
    pub(crate) fn refused(&mut self, text: &str) -> String {
        self.say_text(text);
        let error = self.text("error");
        assert!(error["text"].as_str().is_some_and(|text| text.len() > 10), "{error}");
        error["code"].as_str().unwrap().to_owned()
    }

    /// Moves the camera: the start, changed.
    pub(crate) fn fly(&mut self, id: u32, east_m: f64) {
        let mut pose = self.start.clone();
        pose["x"] = json!(pose["x"].as_f64().unwrap() + east_m);
        (pose["type"], pose["id"]) = (json!("pose"), json!(id));
        self.say(&pose);
    }
}
