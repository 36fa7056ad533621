//! How the flight is to be flown: told to the launcher when it has not changed for a moment, since
//! the flight starts again for it.

use super::Hub;
use std::sync::Arc;
use std::time::Duration;
use terravision_common::viewer::{FromViewer, StreamSettings};

/// A window that is being resized has a new size many times a second.
const SETTLES_AFTER: Duration = Duration::from_millis(300);
/// Most pixels of the stream's pictures: 1920x1088. A larger window's are stretched by the client.
pub(crate) const MOST_PIXELS: u32 = 1920 * 1088;

/// How the flight is to be flown.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FlightOrder {
    /// Size of its pictures, pixels.
    pub(crate) size: [u32; 2],
    /// How it draws.
    pub(crate) settings: StreamSettings,
}

/// Tells the launcher of orders until the process ends.
pub(crate) async fn tell_launcher(hub: Arc<Hub>) {
    let mut orders = hub.order.subscribe();
    while orders.changed().await.is_ok() {
        while let Ok(Ok(())) = tokio::time::timeout(SETTLES_AFTER, orders.changed()).await {}
        let order = orders.borrow_and_update().clone();
        // The launcher knows whether that is how it flies, or is about to.
        if let Some(FlightOrder { size, settings }) = order {
            hub.link.tell(&FromViewer::Fly { size, settings: Box::new(settings) });
        }
    }
}
