//! The viewer's process: it gets the listening socket as its standard input, and a socket to this
//! program as its standard output.

use super::Event;
use super::child::Watched;
use crate::process::thread::in_thread;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Shutdown, TcpListener};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::Command;
use std::sync::mpsc::SyncSender;
use std::time::Duration;
use terravision_common::log;
use terravision_common::viewer::{MOST_LINE_BYTES, ToViewer, VIEWER_ENVIRONMENT};

/// A viewer that reads nothing for this long is not waited for.
const WRITE_WITHIN: Duration = Duration::from_millis(500);

/// A viewer that runs.
#[derive(Debug)]
pub(super) struct Viewer {
    pub(super) process: Watched,
    stream: UnixStream,
}

impl Viewer {
    /// Starts it, and tells it the first line.
    pub(super) fn start(
        programs: &Path,
        listener: &TcpListener,
        first: &ToViewer,
        events: SyncSender<Event>,
    ) -> anyhow::Result<Self> {
        let (stream, theirs) = UnixStream::pair()?;
        stream.set_write_timeout(Some(WRITE_WITHIN))?;
        let mut command = Command::new(programs.join("terravision-viewer"));
        command.stdin(OwnedFd::from(listener.try_clone()?)).stdout(OwnedFd::from(theirs));
        command.envs(log::environment()).envs(VIEWER_ENVIRONMENT);
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let said = events.clone();
        let process = Watched::start(&mut command, |line| Event::ViewerSaid { line }, said)?;
        // The other end is the child's alone, so that this one notices its death.
        drop(command);
        let reader = stream.try_clone()?;
        drop(in_thread("viewer", move || read(reader, &events))?);
        let mut viewer = Self { process, stream };
        viewer.tell(first);
        Ok(viewer)
    }

    /// Tells it something. One that is about to be replaced hears it then.
    pub(super) fn tell(&mut self, message: &ToViewer) {
        if let Ok(mut line) = serde_json::to_vec(message) {
            line.push(b'\n');
            self.stream.write_all(&line).ok();
        }
    }

    /// Asks it to end: it takes leave of its clients.
    pub(super) fn end(&mut self, longest: Duration) {
        self.stream.shutdown(Shutdown::Both).ok();
        self.process.wait(longest);
    }
}

fn read(stream: UnixStream, events: &SyncSender<Event>) {
    let mut reader = BufReader::new(stream);
    loop {
        let mut line = Vec::new();
        match reader.by_ref().take(MOST_LINE_BYTES).read_until(b'\n', &mut line) {
            Ok(0) | Err(_) => return,
            Ok(_) => {}
        }
        match serde_json::from_slice(&line) {
            Ok(message) => drop(events.send(Event::Viewer(message))),
            Err(error) => tracing::warn!(%error, "the viewer's message cannot be read"),
        }
    }
}
