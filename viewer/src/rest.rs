//! When the camera rests, its exact picture is drawn; when it moves on meanwhile, the drawing ends.

use crate::hub::{ExactPicture, Hub};
use crate::picture::Scene;
use std::sync::Arc;
use std::time::Duration;

/// A camera that has rested for this long is worth an exact picture, which costs some seconds of
/// processor time.
const EXACT_AFTER: Duration = Duration::from_millis(500);

/// Draws exact pictures as long as the process lives.
pub(crate) async fn draw_exact_pictures(hub: Arc<Hub>) {
    let (mut pictures, mut poses) = (hub.pictures.subscribe(), hub.poses.changed.subscribe());
    let mut flights = hub.flight.subscribe();
    let mut done: Option<Scene> = None;
    // Pictures come as long as the flight flies, at rest too.
    while pictures.changed().await.is_ok() {
        let Some(picture) = pictures.borrow_and_update().clone() else { continue };
        let scene = picture.scene();
        if done == Some(scene) || picture.since.elapsed() < EXACT_AFTER || hub.clients() == 0 {
            continue;
        }
        poses.mark_unchanged();
        flights.mark_unchanged();
        if !hub.is_newest(&picture) {
            continue;
        }
        let order = hub.still_order(picture.pose, Some(picture.size), true);
        tokio::select! {
            drawn = hub.stills.draw(&order) => {
                done = Some(scene);
                match drawn {
                    Ok(file) => drop(hub.exact.send_replace(Some(Arc::new(ExactPicture { picture, file })))),
                    Err(error) => hub.note(true, format!("there is no exact picture: {error}")),
                }
            }
            _ = poses.changed() => {}
            _ = flights.changed() => {}
        }
    }
}
