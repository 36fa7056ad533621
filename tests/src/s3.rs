//! A real S3 server on loopback: moto, which `scripts/setup.sh --tests` installs.

use crate::folder::target_tmp;
use std::fs;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// It is a large Python program, and others may keep the machine busy.
const START_DEADLINE: Duration = Duration::from_secs(120);

/// An S3 server. Dropped, it is killed.
#[derive(Debug)]
pub struct S3Server {
    child: Child,
    port: u16,
}

impl S3Server {
    /// Starts one on a free port; `None` when none is installed.
    ///
    /// # Panics
    /// When it does not start.
    #[must_use]
    pub fn start() -> Option<Self> {
        let program = program()?;
        // The port is still free a moment later, unless another process is very quick.
        let port = TcpListener::bind("127.0.0.1:0").and_then(|l| l.local_addr()).expect("a free port").port();
        let child = Command::new(&program)
            .args(["-H", "127.0.0.1", "-p", &port.to_string()])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap_or_else(|error| panic!("{}: {error}", program.display()));
        let mut server = Self { child, port };
        let end = Instant::now() + START_DEADLINE;
        while TcpStream::connect(("127.0.0.1", port)).is_err() {
            let ended = server.child.try_wait().ok().flatten();
            assert!(ended.is_none() && Instant::now() < end, "moto does not start: {ended:?}");
            std::thread::sleep(Duration::from_millis(50));
        }
        Some(server)
    }

    /// What `AWS_ENDPOINT_URL` is to be.
    #[must_use]
    pub fn endpoint(&self) -> String {
        format!("http://127.0.0.1:{}", self.port)
    }

    /// Makes a bucket with the files of a folder below a prefix.
    ///
    /// # Panics
    /// When the server does not take them.
    pub fn upload(&self, bucket: &str, prefix: &str, folder: &Path) {
        self.put(bucket, &[]);
        for entry in fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display())).flatten() {
            let content = fs::read(entry.path()).unwrap_or_else(|error| panic!("{error}"));
            self.put(&format!("{bucket}/{prefix}/{}", entry.file_name().to_string_lossy()), &content);
        }
    }

    /// Makes one object, or a bucket of nothing.
    ///
    /// # Panics
    /// When the server does not take it.
    pub fn put(&self, path: &str, content: &[u8]) {
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).expect("the server listens");
        let head = format!(
            "PUT /{path} HTTP/1.1\r\nHost: 127.0.0.1:{}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
            self.port,
            content.len()
        );
        stream.write_all(head.as_bytes()).and_then(|()| stream.write_all(content)).expect("the server takes it");
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).expect("the server answers");
        let answer = String::from_utf8_lossy(&answer).into_owned();
        assert!(answer.lines().next().is_some_and(|line| line.contains(" 200 ")), "{path}: {answer}");
    }
}

impl Drop for S3Server {
    fn drop(&mut self) {
        drop(self.child.kill());
        drop(self.child.wait());
    }
}

fn program() -> Option<PathBuf> {
    let beside = target_tmp().ancestors().nth(1)?.join("s3-server/bin/moto_server");
    let path = std::env::var_os("PATH").unwrap_or_default();
    let on_path = std::env::split_paths(&path).map(|folder| folder.join("moto_server"));
    std::iter::once(beside).chain(on_path).find(|program| program.exists())
}
