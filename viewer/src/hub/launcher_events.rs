//! What the launcher says goes to the hub.

use super::Hub;
use crate::launcher_link::LauncherEvents;
use std::io;
use std::sync::Arc;
use std::thread::JoinHandle;
use terravision_common::viewer::ToViewer;

/// Listens until the launcher goes; then the hub ends.
pub(crate) fn listen(mut events: LauncherEvents, hub: Arc<Hub>) -> io::Result<JoinHandle<()>> {
    std::thread::Builder::new().name("launcher".into()).spawn(move || {
        while let Some(message) = events.next() {
            match message {
                Ok(ToViewer::Flight(flight)) => hub.note_flight(flight),
                Ok(ToViewer::GoesOn { size, settings }) => hub.forget_order(size, settings),
                Ok(ToViewer::Notice { is_warning, text }) => hub.note(is_warning, text),
                Ok(ToViewer::Setup(_)) => {}
                Err(error) => tracing::warn!(%error, "the launcher's message cannot be read"),
            }
        }
        hub.end();
    })
}
