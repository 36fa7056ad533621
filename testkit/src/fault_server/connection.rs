//! One connection: requests are read and answered until either side has enough.

use super::{Asked, Fault, Shared, TICK, lock};
use std::fs::File;
use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::os::unix::fs::FileExt;
use std::time::{Duration, Instant};

const MOST_HEAD_BYTES: usize = 16 << 10;
const PART_BYTES: usize = 8 << 10;
const PAGE: &str = "<!DOCTYPE html><html><body>Please log in.</body></html>\n";

struct Request {
    path: String,
    range: Option<[u64; 2]>,
}

pub(crate) fn talk(mut stream: TcpStream, shared: &Shared) -> io::Result<()> {
    stream.set_nonblocking(false)?;
    stream.set_read_timeout(Some(TICK))?;
    stream.set_nodelay(true)?;
    let mut waiting = Vec::new();
    while let Some(request) = next_request(&mut stream, &mut waiting, shared)? {
        let fault = shared.fault(&request.path);
        let asked = Asked { path: request.path.clone(), range: request.range, fault: fault.clone() };
        lock(&shared.asked).push(asked);
        let latency = lock(&shared.link).0.latency;
        std::thread::sleep(latency);
        if !answer(&mut stream, &request, fault.as_ref(), shared)? {
            break;
        }
    }
    Ok(())
}

/// The next request; `None` at the end of the connection.
fn next_request(stream: &mut TcpStream, waiting: &mut Vec<u8>, shared: &Shared) -> io::Result<Option<Request>> {
    let mut part = [0; 4096];
    loop {
        if let Some(end) = waiting.windows(4).position(|four| four == b"\r\n\r\n") {
            let head = String::from_utf8_lossy(&waiting[..end]).into_owned();
            waiting.drain(..end + 4);
            return Ok(parse(&head));
        }
        if shared.ends() || shared.is_down() || waiting.len() > MOST_HEAD_BYTES {
            return Ok(None);
        }
        match stream.read(&mut part) {
            Ok(0) => return Ok(None),
            Ok(count) => waiting.extend_from_slice(&part[..count]),
            Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => {}
            Err(error) => return Err(error),
        }
    }
}

fn parse(head: &str) -> Option<Request> {
    let mut lines = head.lines();
    let path = lines.next()?.strip_prefix("GET ")?.split(' ').next()?;
    let path = path.split('?').next()?.trim_start_matches('/').to_owned();
    let range = lines.filter_map(|line| line.split_once(':')).find_map(|(name, value)| {
        let range = name.eq_ignore_ascii_case("range").then(|| value.trim().strip_prefix("bytes="))??;
        let (first, last) = range.split_once('-')?;
        Some([first.parse().ok()?, last.parse::<u64>().ok()? + 1])
    });
    Some(Request { path, range })
}

/// Answers; whether the connection goes on.
fn answer(stream: &mut TcpStream, request: &Request, fault: Option<&Fault>, shared: &Shared) -> io::Result<bool> {
    let page = |status: &str, more: &str, text: &str| {
        format!("HTTP/1.1 {status}\r\n{more}Content-Length: {}\r\n\r\n{text}", text.len())
    };
    let whole = |stream: &mut TcpStream, text: String| stream.write_all(text.as_bytes()).map(|()| true);
    match fault {
        Some(Fault::Drop) => return Ok(false),
        Some(Fault::Hang) => {
            while !shared.ends() && !shared.is_down() && !is_closed(stream) {
                std::thread::sleep(TICK);
            }
            return Ok(false);
        }
        Some(Fault::Status(status, after)) => {
            let after = after.map_or(String::new(), |seconds| format!("Retry-After: {seconds}\r\n"));
            return whole(stream, page(&format!("{status} No"), &after, "no\n"));
        }
        Some(Fault::WebPage) => return whole(stream, page("200 OK", "Content-Type: text/html\r\n", PAGE)),
        Some(Fault::RedirectLoop) => {
            return whole(stream, page("302 Found", &format!("Location: /{}\r\n", request.path), ""));
        }
        Some(Fault::Late(millis)) => wait(Duration::from_millis(*millis), shared),
        _ => {}
    }
    let path = shared.root.join(&request.path);
    let is_inside = !request.path.split('/').any(|part| part == "..");
    let file = File::open(path).ok().filter(|_| is_inside);
    let length = file.as_ref().and_then(|file| file.metadata().ok()).filter(|about| about.is_file());
    let (Some(file), Some(length)) = (file, length.map(|about| about.len())) else {
        return whole(stream, page("404 Not Found", "", "no such file\n"));
    };
    let mut range = request.range.filter(|_| fault != Some(&Fault::IgnoreRange));
    if let Some([first, end]) = &mut range {
        *end = (*end).min(length);
        if first >= end {
            return whole(stream, page("416 Range Not Satisfiable", "", ""));
        }
        if fault == Some(&Fault::Shifted) && *end < length {
            *first += 1;
            *end += 1;
        }
    }
    let [first, end] = range.unwrap_or([0, length]);
    let mut content = vec![0; (end - first) as usize];
    file.read_exact_at(&mut content, first)?;
    match fault {
        Some(Fault::Garbage) => content.iter_mut().step_by(7).for_each(|byte| *byte ^= 0x5a),
        Some(Fault::TooLong) => content.extend([0x5a; 100]),
        _ => {}
    }
    let etag = lock(&shared.etag).clone();
    let status = match range {
        Some(_) => format!("206 Partial Content\r\nContent-Range: bytes {first}-{}/{length}", end - 1),
        None => "200 OK".to_owned(),
    };
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Length: {}\r\nETag: \"{length:x}-{etag}\"\r\nAccept-Ranges: bytes\r\n\r\n",
        content.len()
    );
    stream.write_all(head.as_bytes())?;
    let is_cut = fault == Some(&Fault::Truncate);
    let sent = if is_cut { content.len() / 2 } else { content.len() };
    for part in content[..sent].chunks(PART_BYTES) {
        if shared.is_down() {
            return Ok(false);
        }
        shared.carry(part.len());
        stream.write_all(part)?;
    }
    Ok(!is_cut)
}

fn wait(duration: Duration, shared: &Shared) {
    let end = Instant::now() + duration;
    while Instant::now() < end && !shared.ends() {
        std::thread::sleep(TICK.min(duration));
    }
}

/// Whether the client has gone.
fn is_closed(stream: &TcpStream) -> bool {
    matches!(stream.peek(&mut [0]), Ok(0))
}
