//! Databases in archives and on servers, and what asks for metrics: headers of tar, heads and
//! bodies of HTTP.

use crate::{databases, within};
use std::fs;
use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use terravision_common::database::{COLOR_FILE, ELEVATION_FILE, MANIFEST_FILE, NODES_FILE};
use terravision_store::{Location, RetryOptions, Store, StoreOptions};
use terravision_tests::folder::TestFolder;
use terravision_tests::fuzz::Target;
use terravision_tests::live::{end, sender, shared_name};
use terravision_tests::process::{Terravision, loopback_port};

const BLOCK: usize = 512;

/// A header of ustar for a member.
fn header(name: &str, bytes: usize, kind: u8) -> [u8; BLOCK] {
    let mut block = [0; BLOCK];
    block[..name.len()].copy_from_slice(name.as_bytes());
    block[100..107].copy_from_slice(b"0000644");
    block[124..135].copy_from_slice(format!("{bytes:011o}").as_bytes());
    block[156] = kind;
    block[257..263].copy_from_slice(b"ustar\0");
    seal(&mut block);
    block
}

/// Makes a header's checksum right.
fn seal(block: &mut [u8]) {
    block[148..156].fill(b' ');
    let sum: u32 = block.iter().map(|byte| u32::from(*byte)).sum();
    block[148..155].copy_from_slice(format!("{sum:06o}\0").as_bytes());
}

fn tar(database: &Path) -> Vec<u8> {
    let mut archive = Vec::new();
    let mut add = |name: &str, content: &[u8], kind| {
        archive.extend(header(name, content.len(), kind));
        archive.extend(content);
        archive.resize(archive.len().next_multiple_of(BLOCK), 0);
    };
    add("pax", b"27 path=world.tv/manifest.jso\n", b'x');
    for name in [MANIFEST_FILE, NODES_FILE, ELEVATION_FILE, COLOR_FILE] {
        add(&format!("world.tv/{name}"), &fs::read(database.join(name)).unwrap(), b'0');
    }
    archive.resize(archive.len() + 2 * BLOCK, 0);
    archive
}

fn options(cache: &Path) -> StoreOptions {
    StoreOptions {
        cache_dir: Some(cache.to_owned()),
        request_timeout: Duration::from_secs(2),
        deadline: Duration::from_secs(2),
        retries: RetryOptions { most: 0, ..RetryOptions::default() },
        ..StoreOptions::default()
    }
}

#[test]
fn archives() {
    let folder = TestFolder::new("fuzz-tar");
    let (path, options) = (folder.join("world.tar"), options(&folder.join("cache")));
    let inputs = databases().iter().map(|database| tar(database)).collect();
    let words: [&[u8]; 5] =
        [b"ustar\0", b"77777777777", b"99 path=world.tv/manifest.json\n", b"11 size=-1\n", &[0x80, 0, 0, 0]];
    let target = Target { name: "tar", inputs, words: &words, short_round: 150 };
    target.run(|bytes| {
        // As it came, and with headers whose checksums are right.
        let mut mended = bytes.to_vec();
        let mut at = 0;
        while let Some(block) = mended.get_mut(at..at + BLOCK).filter(|block| block[257..262] == *b"ustar") {
            seal(block);
            let size =
                std::str::from_utf8(&block[124..135]).ok().and_then(|text| usize::from_str_radix(text.trim(), 8).ok());
            at = at.saturating_add(BLOCK + size.unwrap_or(0).next_multiple_of(BLOCK)).min(mended.len());
        }
        for archive in [bytes, &mended] {
            fs::write(&path, archive).unwrap();
            within(64 << 20, || {
                let Err(error) = Store::open(&Location::parse(path.to_str().unwrap()).unwrap(), &options) else {
                    return;
                };
                assert!(!error.to_string().is_empty());
            });
        }
    });
}

/// A server that answers every request with the same bytes and closes the connection.
fn server(answer: Arc<Mutex<Vec<u8>>>) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let serve = move |mut stream: TcpStream| -> std::io::Result<()> {
        stream.set_read_timeout(Some(Duration::from_secs(2)))?;
        let mut head = Vec::<u8>::new();
        let mut part = [0; 1024];
        while !head.windows(4).any(|end: &[u8]| end == b"\r\n\r\n") {
            match stream.read(&mut part)? {
                0 => return Ok(()),
                count => head.extend(&part[..count]),
            }
        }
        let answer = answer.lock().unwrap().clone();
        stream.write_all(&answer)
    };
    // Ends with the test's process. A client that has enough closes the connection.
    std::thread::spawn(move || listener.incoming().flatten().for_each(|stream| drop(serve(stream))));
    address.to_string()
}

#[test]
fn answers_of_servers() {
    let folder = TestFolder::new("fuzz-http");
    let manifest = fs::read(databases()[0].join(MANIFEST_FILE)).unwrap();
    let head = |status: &str, more: &str| -> Vec<u8> {
        let head =
            format!("HTTP/1.1 {status}\r\nContent-Length: {}\r\nConnection: close\r\n{more}\r\n", manifest.len());
        [head.as_bytes(), &manifest].concat()
    };
    let last = manifest.len() - 1;
    let inputs = vec![
        head("200 OK", "ETag: \"abc\"\r\nLast-Modified: Sun, 06 Nov 1994 08:49:37 GMT\r\n"),
        head("206 Partial Content", &format!("Content-Range: bytes 0-{last}/{}\r\n", manifest.len())),
        head("301 Moved Permanently", "Location: /elsewhere/manifest.json\r\n"),
        head("503 Service Unavailable", "Retry-After: 1\r\n"),
        head("416 Range Not Satisfiable", "Content-Range: bytes */10\r\n"),
        b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n5\r\nhello\r\n0\r\n\r\n".to_vec(),
    ];
    let words: [&[u8]; 8] = [
        b"Location: http://127.0.0.1:1/\r\n",
        b"Content-Range: bytes 5-3/2\r\n",
        b"Retry-After: 99999999999999\r\n",
        b"Transfer-Encoding: chunked\r\n",
        b"Content-Length: 18446744073709551615\r\n",
        b"\r\n\r\n",
        b"ETag: W/\"\xff\"\r\n",
        b"HTTP/1.1 304 Not Modified\r\n",
    ];
    let answer = Arc::new(Mutex::new(Vec::new()));
    let url = format!("http://{}/world.tv", server(Arc::clone(&answer)));
    let target = Target { name: "http-head", inputs, words: &words, short_round: 40 };
    target.run(|bytes| {
        *answer.lock().unwrap() = bytes.to_vec();
        within(64 << 20, || {
            let opened = Store::open(&Location::parse(&url).unwrap(), &options(&folder.join("cache")));
            if let Err(error) = opened {
                assert!(!error.to_string().is_empty());
            }
        });
    });
}

/// What a server of metrics answers to these bytes; nothing when it closes the connection.
fn ask(port: u16, request: &[u8]) -> Vec<u8> {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    // It may have had enough before all is sent.
    drop(stream.write_all(request));
    drop(stream.shutdown(Shutdown::Write));
    let mut answer = Vec::new();
    drop(stream.read_to_end(&mut answer));
    answer
}

#[test]
fn requests_for_metrics() {
    let name = shared_name("fuzz-metrics");
    let mut flight = Terravision::verb("fly")
        .arg(&databases()[0])
        .args(["--camera", &format!("shm:{name}"), "--size", "64x48", "-o", &format!("shared:{name}")])
        .args(["--metrics", "0"])
        .spawn();
    let poses = sender(&mut flight, &name);
    let port = flight.until("the port", |flight| loopback_port(flight.pid(), "tcp"));
    let right = b"GET /metrics HTTP/1.1\r\nHost: localhost\r\nAccept: text/plain\r\n\r\n".to_vec();
    let words: [&[u8]; 6] = [b"\r\n\r\n", b"POST ", b"HTTP/9.9", b"Content-Length: 99\r\n", &[0xff; 4], b"\r\r\r\r"];
    let target = Target { name: "metrics-head", inputs: vec![right.clone()], words: &words, short_round: 100 };
    target.run(|bytes| {
        ask(port, bytes);
        let answer = ask(port, &right);
        assert!(answer.starts_with(b"HTTP/1.1 200 OK\r\n"), "{}", String::from_utf8_lossy(&answer));
    });
    // No pose was sent, and it says so.
    end(&poses);
    flight.wait().assert_code(1);
}
