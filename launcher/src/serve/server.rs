//! What becomes of flight and viewer: each is started again when it dies, the flight also when it
//! is to be flown in another way.

use super::Event;
use super::child::{BackOff, Watched};
use super::flight;
use super::viewer::Viewer;
use crate::cli::serve::ServeArgs;
use crate::failure::{ExitStatus, Failure};
use crate::process::interrupt;
use anyhow::anyhow;
use rustix::process::Signal;
use std::net::TcpListener;
use std::process::ExitStatus as ProcessStatus;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, Instant};
use terravision_common::terminal::complain;
use terravision_common::viewer::{FlightState, FlightStatus, FromViewer, StreamSettings, ToViewer, ViewerSetup};

/// Between two looks at the children.
const TICK: Duration = Duration::from_millis(20);
/// Events that wait.
const MOST_EVENTS: usize = 256;
/// The largest pictures of the first flight, until a pilot's window needs more.
const FIRST_SIZE: [u32; 2] = [1600, 960];
/// A flight or a viewer that is told to end has this long.
const ENDS_WITHIN: Duration = Duration::from_secs(5);
/// Deaths without a picture in between after which a flight counts as failed; it is tried on.
const MOST_FAILURES: u32 = 4;
/// A viewer that has lived for this long has worked.
const GOOD_LIFE: Duration = Duration::from_secs(5);

/// Flight and viewer, and how they are.
pub(super) struct Server<'a> {
    args: &'a ServeArgs,
    setup: ViewerSetup,
    listener: &'a TcpListener,
    events: (SyncSender<Event>, Receiver<Event>),
    flight: Option<Watched>,
    status: FlightStatus,
    /// What a flight said last that has drawn nothing yet: if it ends there, this is the reason,
    /// which is told in a sentence anyway.
    said_last: Option<String>,
    /// How it is to be flown.
    wanted: ([u32; 2], StreamSettings),
    /// How it was flown when there was a picture last.
    proven: Option<([u32; 2], StreamSettings)>,
    /// When it was told to end, so that it can be flown in another way.
    told_to_end: Option<Instant>,
    /// Since when nobody looks; `None` while somebody does.
    unseen_since: Option<Instant>,
    flight_due: Instant,
    flight_back_off: BackOff,
    viewer: Option<Viewer>,
    viewer_since: Instant,
    viewer_due: Instant,
    viewer_back_off: BackOff,
}

impl<'a> Server<'a> {
    pub(super) fn new(args: &'a ServeArgs, setup: ViewerSetup, listener: &'a TcpListener) -> Self {
        let size = args.shared.draw.picture.size.map_or(FIRST_SIZE, |size| [size.width, size.height]);
        let (settings, now) = (setup.defaults.clone(), Instant::now());
        let status = FlightStatus {
            number: 0,
            pid: 0,
            state: FlightState::Starting,
            reason: None,
            size,
            settings: settings.clone(),
            metrics: None,
        };
        Self {
            args,
            setup,
            listener,
            events: sync_channel(MOST_EVENTS),
            flight: None,
            status,
            said_last: None,
            wanted: (size, settings),
            proven: None,
            told_to_end: None,
            unseen_since: Some(now),
            flight_due: now,
            flight_back_off: BackOff::default(),
            viewer: None,
            viewer_since: now,
            viewer_due: now,
            viewer_back_off: BackOff::default(),
        }
    }

    /// Serves until Ctrl-C, or until it cannot.
    pub(super) fn run(mut self) -> Result<(), Failure> {
        let served = self.watch();
        if let Some(flight) = &mut self.flight {
            flight.signal(Signal::INT);
        }
        if let Some(viewer) = &mut self.viewer {
            viewer.end(ENDS_WITHIN);
        }
        if let Some(flight) = &mut self.flight {
            flight.wait(ENDS_WITHIN);
        }
        served
    }

    fn watch(&mut self) -> Result<(), Failure> {
        while !interrupt::is_interrupted() {
            self.look_at_flight()?;
            self.look_at_viewer()?;
            if let Ok(event) = self.events.1.recv_timeout(TICK) {
                self.take(event);
            }
        }
        Ok(())
    }

    fn look_at_flight(&mut self) -> Result<(), Failure> {
        let rests =
            self.proven.is_some() && self.unseen_since.is_some_and(|since| since.elapsed() >= self.args.rest_after);
        let Some(flight) = &mut self.flight else {
            if Instant::now() >= self.flight_due && !rests {
                self.start_flight()?;
            }
            return Ok(());
        };
        if let Some(status) = flight.ended() {
            let reason = flight.reason(status);
            self.flight = None;
            return self.flight_ended(status, &reason);
        }
        match self.told_to_end {
            Some(since) if since.elapsed() > ENDS_WITHIN => flight.signal(Signal::KILL),
            None if rests || self.wanted != (self.status.size, self.status.settings.clone()) => {
                flight.signal(Signal::INT);
                self.told_to_end = Some(Instant::now());
                self.tell(if rests { FlightState::Resting } else { FlightState::Restarting }, None);
            }
            _ => {}
        }
        Ok(())
    }

    fn start_flight(&mut self) -> Result<(), Failure> {
        (self.status.size, self.status.settings) = self.wanted.clone();
        self.status.number += 1;
        self.status.metrics = None;
        self.said_last = None;
        let (number, size, events) = (self.status.number, self.status.size, self.events.0.clone());
        let (programs, share) = (&self.setup.programs, &self.setup.share);
        let started = flight::start(self.args, programs, share, number, size, &self.status.settings, events);
        let flight = started.map_err(|error| Failure::failed(anyhow!("cannot start the flight: {error}")))?;
        self.status.pid = flight.pid();
        self.flight = Some(flight);
        self.told_to_end = None;
        let state = if number == 1 { FlightState::Starting } else { FlightState::Restarting };
        let reason = self.status.reason.clone();
        self.tell(state, reason);
        Ok(())
    }

    fn flight_ended(&mut self, status: ProcessStatus, reason: &str) -> Result<(), Failure> {
        self.status.pid = 0;
        if self.told_to_end.is_some() {
            self.flight_due = Instant::now();
            return Ok(());
        }
        // A signal, or memory that was short, says nothing about how it was to be flown.
        let has_given_up = status.code().is_some();
        let Some(proven) = self.proven.clone() else {
            if has_given_up {
                let is_refused = status.code() == Some(ExitStatus::BadInput as i32);
                let error = anyhow!("the flight {reason}");
                return Err(if is_refused { Failure::bad_input(error) } else { Failure::failed(error) });
            }
            return self.start_flight_later(reason);
        };
        if has_given_up && proven != self.wanted && self.flight_back_off.failures() == 0 {
            let text = format!("the flight cannot be flown like this, and goes on as before: it {reason}");
            self.say_to_all(true, text);
            let (size, settings) = proven.clone();
            self.tell_viewer(&ToViewer::GoesOn { size, settings });
            (self.wanted, self.flight_due) = (proven, Instant::now());
            return Ok(());
        }
        self.start_flight_later(reason)
    }

    /// A flight that died is started again in a moment.
    fn start_flight_later(&mut self, reason: &str) -> Result<(), Failure> {
        let wait = self.flight_back_off.note_failure();
        self.flight_due = Instant::now() + wait;
        let sentence = format!("the flight {reason}");
        self.say_to_all(true, format!("{sentence}; it is started again"));
        let is_out = self.flight_back_off.failures() > MOST_FAILURES;
        self.tell(if is_out { FlightState::Failed } else { FlightState::Restarting }, Some(sentence));
        Ok(())
    }

    fn look_at_viewer(&mut self) -> Result<(), Failure> {
        let Some(viewer) = &mut self.viewer else {
            if Instant::now() >= self.viewer_due {
                self.start_viewer()?;
            }
            return Ok(());
        };
        let Some(status) = viewer.process.ended() else { return Ok(()) };
        let reason = viewer.process.reason(status);
        self.viewer = None;
        if self.viewer_since.elapsed() > GOOD_LIFE {
            self.viewer_back_off.reset();
        }
        if status.code().is_some() && self.viewer_back_off.failures() > MOST_FAILURES {
            return Err(Failure::failed(anyhow!("the viewer {reason}")));
        }
        self.viewer_due = Instant::now() + self.viewer_back_off.note_failure();
        complain(&format!("terravision: warning: the viewer {reason}; it is started again"));
        Ok(())
    }

    fn start_viewer(&mut self) -> Result<(), Failure> {
        let setup = ToViewer::Setup(Box::new(self.setup.clone()));
        let started = Viewer::start(&self.setup.programs, self.listener, &setup, self.events.0.clone());
        let mut viewer = started.map_err(|error| {
            let program = self.setup.programs.join("terravision-viewer");
            Failure::failed(anyhow!("cannot start {}: {error}", program.display()))
        })?;
        viewer.tell(&ToViewer::Flight(self.status.clone()));
        self.viewer = Some(viewer);
        self.viewer_since = Instant::now();
        // It tells when somebody comes.
        self.unseen_since = Some(Instant::now());
        Ok(())
    }

    fn take(&mut self, event: Event) {
        match event {
            Event::Viewer(FromViewer::Audience { looks }) => {
                self.unseen_since = (!looks).then(Instant::now);
            }
            Event::Viewer(FromViewer::Fly { size, settings }) => self.wanted = (size, *settings),
            Event::Viewer(FromViewer::Flying { number }) if number == self.status.number => {
                self.proven = Some((self.status.size, self.status.settings.clone()));
                self.flight_back_off.reset();
                self.status.reason = None;
                self.status.state = FlightState::Flying;
                self.said_last.take().iter().for_each(|line| complain(line));
            }
            Event::Viewer(FromViewer::Flying { .. }) => {}
            Event::ViewerSaid { line } => complain(&line),
            Event::FlightSaid { number, line } => self.flight_said(number, &line),
        }
    }

    fn flight_said(&mut self, number: u32, line: &str) {
        let Some(text) = line.strip_prefix("terravision: ") else { return complain(line) };
        if let Some(url) = text.strip_prefix("metrics of the run: http://") {
            if number == self.status.number {
                self.status.metrics = url.trim_end_matches("/metrics").parse().ok();
                self.tell(self.status.state, self.status.reason.clone());
            }
            return;
        }
        // What a flight that is started again sums up is of no interest.
        if self.told_to_end.is_some() {
            return;
        }
        if let Some(warning) = text.strip_prefix("warning: ") {
            self.say_to_all(true, warning.to_owned());
        } else if let Some(note) = text.strip_prefix("note: ") {
            self.flight_noted(note, line);
        } else if !text.starts_with("waiting for poses") && !self.args.shared.draw.resources.quiet {
            let is_flying = self.status.state == FlightState::Flying;
            let line = if is_flying { Some(line.to_owned()) } else { self.said_last.replace(line.to_owned()) };
            line.iter().for_each(|line| complain(line));
        }
    }

    /// A flight notes what is special about its settings as it starts: those who have just changed them
    /// are to know.
    fn flight_noted(&mut self, note: &str, line: &str) {
        if !self.args.shared.draw.resources.quiet {
            complain(line);
        }
        let is_changed = self.proven.as_ref().is_some_and(|(_, settings)| *settings != self.status.settings);
        if is_changed {
            self.tell_viewer(&ToViewer::Notice { is_warning: false, text: note.to_owned() });
        }
    }

    fn say_to_all(&mut self, is_warning: bool, text: String) {
        complain(&format!("terravision: {}{text}", if is_warning { "warning: " } else { "" }));
        self.tell_viewer(&ToViewer::Notice { is_warning, text });
    }

    fn tell(&mut self, state: FlightState, reason: Option<String>) {
        (self.status.state, self.status.reason) = (state, reason);
        self.tell_viewer(&ToViewer::Flight(self.status.clone()));
    }

    fn tell_viewer(&mut self, message: &ToViewer) {
        if let Some(viewer) = &mut self.viewer {
            viewer.tell(message);
        }
    }
}
