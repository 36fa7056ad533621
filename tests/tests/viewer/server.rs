//! A server under test.

use rustix::process::{Pid, Signal, kill_process};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};
use terravision_tests::process::{binary, children_of};

/// How long anything may take.
pub(crate) const DEADLINE: Duration = Duration::from_secs(90);

/// Polls until `look` finds something.
pub(crate) fn until<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let end = Instant::now() + DEADLINE;
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(Instant::now() < end, "no sign of {what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// `terravision serve`, ended when it is dropped.
pub(crate) struct Server {
    child: Child,
    pub(crate) port: u16,
    pub(crate) page: String,
}

/// An answer: status, head in lower case, body.
pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) head: String,
    pub(crate) body: Vec<u8>,
}

impl Answer {
    pub(crate) fn json(&self) -> serde_json::Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|_| panic!("{}", String::from_utf8_lossy(&self.body)))
    }

    /// The code of an error.
    pub(crate) fn code(&self) -> String {
        let json = self.json();
        assert!(json["error"]["text"].as_str().is_some_and(|text| text.len() > 10), "{json}");
        json["error"]["code"].as_str().unwrap().to_owned()
    }
}

impl Server {
    /// Serves a world at a free port; the first line tells where.
    pub(crate) fn start(world: &Path, arguments: &[&str]) -> Self {
        Self::run(Command::new(binary("terravision")).arg("serve").arg(world).args(arguments))
    }

    /// The same, where other programs are looked for in these folders.
    pub(crate) fn start_with_path(world: &Path, arguments: &[&str], path: &str) -> Self {
        let mut command = Command::new(binary("terravision"));
        Self::run(command.arg("serve").arg(world).args(arguments).env("PATH", path))
    }

    fn run(command: &mut Command) -> Self {
        command.args(["--addr", "127.0.0.1:0"]);
        let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).spawn().unwrap();
        let mut page = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut page).unwrap();
        let page = page.trim_end().to_owned();
        let port = page.strip_prefix("http://127.0.0.1:").and_then(|rest| rest.split('/').next()?.parse().ok());
        Self { child, port: port.unwrap_or_else(|| panic!("not an address: {page:?}")), page }
    }

    /// A viewer whose launcher is the test.
    pub(crate) fn played(child: Child, port: u16) -> Self {
        Self { child, port, page: String::new() }
    }

    pub(crate) fn pid(&self) -> u32 {
        self.child.id()
    }

    /// The child of this name: `terravision` is the flight.
    pub(crate) fn child_named(&self, name: &str) -> u32 {
        until(name, || children_of(self.pid()).into_iter().find(|(_, child)| child == name).map(|(pid, _)| pid))
    }

    pub(crate) fn kill(pid: u32) {
        kill_process(Pid::from_raw(pid.cast_signed()).unwrap(), Signal::KILL).unwrap();
    }

    /// Asks; `head` are lines of the request's head.
    pub(crate) fn ask(&self, method: &str, path: &str, head: &[(&str, &str)], body: &[u8]) -> Answer {
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).unwrap();
        stream.set_read_timeout(Some(DEADLINE)).unwrap();
        let mut request =
            format!("{method} {path} HTTP/1.1\r\nConnection: close\r\nContent-Length: {}\r\n", body.len());
        if !head.iter().any(|(name, _)| *name == "Host") {
            request += &format!("Host: 127.0.0.1:{}\r\n", self.port);
        }
        head.iter().for_each(|(name, value)| request += &format!("{name}: {value}\r\n"));
        stream.write_all(format!("{request}\r\n").as_bytes()).unwrap();
        // A server that refuses a body need not read it.
        stream.write_all(body).ok();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).ok();
        let end = answer.windows(4).position(|bytes| bytes == b"\r\n\r\n").expect("an answer has a head");
        let head = String::from_utf8(answer[..end].to_vec()).unwrap().to_lowercase();
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        let body = answer[end + 4..].to_vec();
        assert!(!head.contains("transfer-encoding"), "{head}");
        Answer { status, head, body }
    }

    pub(crate) fn get(&self, path: &str) -> Answer {
        self.ask("GET", path, &[], b"")
    }

    /// Ends it as Ctrl-C does.
    pub(crate) fn end(mut self) -> ExitStatus {
        kill_process(Pid::from_child(&self.child), Signal::INT).unwrap();
        until("the end of the server", || self.child.try_wait().unwrap())
    }

    /// What it would leave if it did not clean up.
    pub(crate) fn traces(pid: u32) -> Vec<PathBuf> {
        let starts = [format!("terravision-serve-{pid}")];
        let in_folder = |folder: &Path| -> Vec<PathBuf> {
            let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
            let is_ours = |path: &PathBuf| {
                let name = path.file_name().unwrap().to_string_lossy().into_owned();
                starts.iter().any(|start| name == *start || name.starts_with(&format!("{start}-")))
            };
            entries.filter(is_ours).collect()
        };
        [Path::new("/dev/shm").to_owned(), std::env::temp_dir()].iter().flat_map(|folder| in_folder(folder)).collect()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if let Ok(None) = self.child.try_wait() {
            kill_process(Pid::from_child(&self.child), Signal::INT).ok();
            std::thread::sleep(Duration::from_millis(500));
            self.child.kill().ok();
            self.child.wait().ok();
        }
    }
}
