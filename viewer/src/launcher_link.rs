//! The socket pair between launcher and viewer: a JSON object a line, both ways.

use crate::error::ViewerError;
use rustix::fd::AsFd;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::os::unix::net::UnixStream;
use std::sync::{Mutex, PoisonError};
use terravision_common::viewer::{FlightStatus, FromViewer, MOST_LINE_BYTES, ToViewer, ViewerSetup};

/// The way to the launcher, and what it said first.
#[derive(Debug)]
pub(crate) struct LauncherLink {
    /// What this viewer is to serve.
    pub(crate) setup: ViewerSetup,
    /// The flight that there is when this viewer starts: who comes at once must not order another
    /// by settings that are not its own.
    pub(crate) first_flight: FlightStatus,
    stream: Mutex<UnixStream>,
}

/// What the launcher says from now on.
pub(crate) struct LauncherEvents(BufReader<UnixStream>);

impl LauncherLink {
    /// Waits for the first two lines of the launcher.
    pub(crate) fn open() -> Result<(Self, LauncherEvents), ViewerError> {
        let stream = io::stdout().as_fd().try_clone_to_owned().map(UnixStream::from);
        let stream = stream.map_err(ViewerError::NotServed)?;
        stream.local_addr().map_err(ViewerError::NotServed)?;
        let mut events = LauncherEvents(BufReader::new(stream.try_clone().map_err(ViewerError::Os)?));
        let ToViewer::Setup(setup) = events.expect()? else {
            return Err(ViewerError::Setup("expected the setup".into()));
        };
        let ToViewer::Flight(first_flight) = events.expect()? else {
            return Err(ViewerError::Setup("expected the flight".into()));
        };
        Ok((Self { setup: *setup, first_flight, stream: Mutex::new(stream) }, events))
    }

    /// Tells the launcher something; when it has gone, this process is about to end.
    pub(crate) fn tell(&self, message: &FromViewer) {
        let Ok(mut line) = serde_json::to_vec(message) else { return };
        line.push(b'\n');
        self.stream.lock().unwrap_or_else(PoisonError::into_inner).write_all(&line).ok();
    }
}

impl LauncherEvents {
    /// The next message; `None` when the launcher has gone.
    pub(crate) fn next(&mut self) -> Option<Result<ToViewer, serde_json::Error>> {
        let mut line = Vec::new();
        let read = self.0.by_ref().take(MOST_LINE_BYTES).read_until(b'\n', &mut line);
        read.ok().filter(|count| *count > 0).map(|_| serde_json::from_slice(&line))
    }

    /// The next message, which has to come.
    fn expect(&mut self) -> Result<ToViewer, ViewerError> {
        match self.next() {
            Some(Ok(message)) => Ok(message),
            Some(Err(error)) => Err(ViewerError::Setup(error.to_string())),
            None => Err(ViewerError::Setup("the launcher has gone".into())),
        }
    }
}
