//! As much of HTTP as a scrape needs (RFC 9112): one request, one answer, and the connection is
//! closed. One thread serves all clients and waits for none of them: an idle client keeps a place
//! for a moment and delays no other.

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::io::{self, ErrorKind, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::time::{Duration, Instant};

/// Longest time that a client may take for its request and to take the answer.
const PATIENCE: Duration = Duration::from_secs(5);
const MOST_HEAD_BYTES: usize = 8 << 10;
/// Clients at a time; one more takes the place of the one that has been here longest.
const MOST_CLIENTS: usize = 32;

/// What can be asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Page {
    /// The metrics.
    Metrics,
    /// The nodes whose tiles are there, and those that are wanted.
    Tiles,
}

/// Those who are being answered.
#[derive(Debug, Default)]
pub(super) struct Clients {
    /// In the order in which they came.
    clients: Vec<Client>,
}

#[derive(Debug)]
struct Client {
    stream: TcpStream,
    since: Instant,
    head: Vec<u8>,
    /// The answer, and how much of it is sent.
    answer: Option<(Vec<u8>, usize)>,
}

impl Clients {
    /// Waits until there is something to do, `bound` at most, and does it. `page` is asked for with
    /// every request.
    pub(super) fn serve(&mut self, listener: &TcpListener, bound: Duration, page: &mut dyn FnMut(Page) -> String) {
        let ready = self.wait(listener, bound);
        let [is_called, is_ready @ ..] = ready.as_slice() else { return };
        let now = Instant::now();
        let mut is_ready = is_ready.iter();
        // A client that disconnects, or sends no valid request, gets no answer.
        self.clients.retain_mut(|client| {
            let is_ready = is_ready.next().is_some_and(|is_ready| *is_ready);
            let is_done = is_ready && client.go_on(page).unwrap_or(true);
            !is_done && now.duration_since(client.since) < PATIENCE
        });
        if *is_called {
            self.accept(listener, now);
        }
    }

    /// Whether a client connects, and which clients can be read from or written to.
    fn wait(&self, listener: &TcpListener, bound: Duration) -> Vec<bool> {
        let mut fds = vec![PollFd::new(listener, PollFlags::IN)];
        fds.extend(self.clients.iter().map(|client| {
            let wanted = if client.answer.is_some() { PollFlags::OUT } else { PollFlags::IN };
            PollFd::new(&client.stream, wanted)
        }));
        let bound = Timespec { tv_sec: bound.as_secs().cast_signed(), tv_nsec: bound.subsec_nanos().into() };
        match poll(&mut fds, Some(&bound)) {
            Ok(_) => fds.iter().map(|fd| !fd.revents().is_empty()).collect(),
            Err(_disturbed) => vec![false; fds.len()],
        }
    }

    fn accept(&mut self, listener: &TcpListener, now: Instant) {
        match listener.accept() {
            Ok((stream, _)) if stream.set_nonblocking(true).is_ok() => {
                if self.clients.len() >= MOST_CLIENTS {
                    self.clients.remove(0);
                }
                self.clients.push(Client { stream, since: now, head: Vec::new(), answer: None });
            }
            Ok(_) => {}
            // Out of file descriptors: close the clients, and do not spin.
            Err(error) if error.kind() != ErrorKind::WouldBlock => {
                self.clients.clear();
                std::thread::sleep(Duration::from_millis(50));
            }
            Err(_nobody) => {}
        }
    }
}

impl Client {
    /// Reads or writes what can be without waiting. Whether all is said.
    fn go_on(&mut self, page: &mut dyn FnMut(Page) -> String) -> io::Result<bool> {
        if self.answer.is_none() && self.read_head()? {
            self.answer = Some((answer(&String::from_utf8_lossy(&self.head), page), 0));
        }
        let Some((answer, sent)) = &mut self.answer else { return Ok(false) };
        while *sent < answer.len() {
            match self.stream.write(&answer[*sent..]) {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(count) => *sent += count,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(false),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        self.stream.shutdown(Shutdown::Write)?;
        Ok(true)
    }

    /// Reads until the empty line that ends a request's head; whether it has come. Its body, if it
    /// has one, is not read.
    fn read_head(&mut self) -> io::Result<bool> {
        let mut part = [0; 1024];
        loop {
            match self.stream.read(&mut part) {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(count) => self.head.extend_from_slice(&part[..count]),
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(false),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
            if self.head.windows(4).any(|four| four == b"\r\n\r\n") {
                return Ok(true);
            }
            if self.head.len() > MOST_HEAD_BYTES {
                return Err(ErrorKind::InvalidData.into());
            }
        }
    }
}

fn answer(head: &str, page: &mut dyn FnMut(Page) -> String) -> Vec<u8> {
    let mut words = head.split([' ', '\r']);
    let (method, target) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
    let path = target.split('?').next().unwrap_or_default();
    let kind = if path == "/tiles" { "application/json" } else { "text/plain; version=0.0.4; charset=utf-8" };
    let (status, body) = match (method, path) {
        ("GET" | "HEAD", "/metrics" | "/") => ("200 OK", page(Page::Metrics)),
        ("GET" | "HEAD", "/tiles") => ("200 OK", page(Page::Tiles)),
        ("GET" | "HEAD", _) => ("404 Not Found", "metrics are at /metrics\n".to_owned()),
        _ => ("405 Method Not Allowed", "metrics are read with GET\n".to_owned()),
    };
    let allow = if status.starts_with("405") { "Allow: GET, HEAD\r\n" } else { "" };
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\n{allow}\
         Connection: close\r\n\r\n",
        body.len()
    );
    let body = if method == "HEAD" { "" } else { &body };
    [head.as_bytes(), body.as_bytes()].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Serves until this many pages were asked for, or time is up.
    fn serve(clients: &mut Clients, listener: &TcpListener, pages: u32) {
        let (mut asked, end) = (0, Instant::now() + Duration::from_secs(60));
        while asked < pages && Instant::now() < end {
            clients.serve(listener, Duration::from_millis(10), &mut |_| {
                asked += 1;
                "a 1\n".to_owned()
            });
        }
    }

    fn listen() -> TcpListener {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        listener.set_nonblocking(true).unwrap();
        listener
    }

    fn read(mut client: TcpStream) -> String {
        let mut text = String::new();
        // What is left unread breaks the connection.
        client.read_to_string(&mut text).unwrap_or_default();
        text
    }

    fn asked(request: &[u8]) -> String {
        let (listener, mut clients) = (listen(), Clients::default());
        let mut client = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        client.write_all(request).unwrap();
        client.shutdown(Shutdown::Write).unwrap();
        let end = Instant::now() + Duration::from_secs(60);
        let mut has_come = false;
        while (!has_come || !clients.clients.is_empty()) && Instant::now() < end {
            clients.serve(&listener, Duration::from_millis(10), &mut |page| {
                format!("{} 1\n", if page == Page::Metrics { "a" } else { "t" })
            });
            has_come |= !clients.clients.is_empty();
        }
        read(client)
    }

    #[test]
    fn a_scrape_is_answered_and_nonsense_is_not() {
        let page = asked(b"GET /metrics?x=1 HTTP/1.1\r\nHost: a\r\n\r\n");
        assert!(page.starts_with("HTTP/1.1 200 OK\r\n") && page.ends_with("\r\n\r\na 1\n"), "{page}");
        assert!(page.contains("Content-Length: 4\r\n") && page.contains("version=0.0.4"));
        let tiles = asked(b"GET /tiles HTTP/1.1\r\n\r\n");
        assert!(tiles.contains("application/json") && tiles.ends_with("t 1\n"), "{tiles}");
        assert!(asked(b"HEAD / HTTP/1.0\r\n\r\n").ends_with("\r\n\r\n"));
        assert!(asked(b"GET /else HTTP/1.1\r\n\r\n").starts_with("HTTP/1.1 404"));
        assert!(asked(b"POST /metrics HTTP/1.1\r\n\r\n").contains("405"));
        for nonsense in [&b""[..], b"GET /metrics", &[0xff; 10_000]] {
            assert_eq!(asked(nonsense), "");
        }
    }

    #[test]
    fn clients_that_say_nothing_keep_nobody_waiting() {
        let (listener, mut clients) = (listen(), Clients::default());
        let address = listener.local_addr().unwrap();
        let idle: Vec<TcpStream> = (0..100).map(|_| TcpStream::connect(address).unwrap()).collect();
        let mut scrape = TcpStream::connect(address).unwrap();
        scrape.write_all(b"GET /metrics HTTP/1.1\r\n\r\n").unwrap();
        serve(&mut clients, &listener, 1);
        assert!(read(scrape).ends_with("a 1\n"));
        assert!(clients.clients.len() <= MOST_CLIENTS);
        drop(idle);
    }
}
