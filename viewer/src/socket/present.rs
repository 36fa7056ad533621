//! Which picture a client is to have next.

use crate::hub::{ExactPicture, Hub};
use crate::picture::{Level, Picture, REST_AFTER, Scene};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// While tiles still arrive, a picture at rest is sent again, but not more often than this.
const AGAIN_AFTER: Duration = Duration::from_millis(500);

/// What a client was sent last.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shown {
    pub(crate) scene: Scene,
    pub(crate) level: Level,
    pub(crate) number: u64,
    pub(crate) is_settled: bool,
    pub(crate) at: Instant,
}

/// What it is to be sent.
#[derive(Debug, Clone)]
pub(crate) enum Next {
    /// The newest picture.
    Frame(Arc<Picture>, Level),
    /// The exact picture of its scene.
    Exact(Arc<ExactPicture>),
    /// Nothing, before this moment or before something changes.
    Nothing(Option<Instant>),
}

/// Chooses.
pub(crate) fn next(hub: &Hub, shown: Option<&Shown>) -> Next {
    let Some(picture) = hub.pictures.borrow().clone() else { return Next::Nothing(None) };
    let exact = hub.exact_of(picture.scene());
    let level = match exact {
        Some(_) => Level::Exact,
        None if hub.is_newest(&picture) && picture.since.elapsed() >= REST_AFTER => Level::Rest,
        None => Level::Moving,
    };
    let is_better = shown.is_none_or(|shown| is_better(&picture, level, shown));
    match exact {
        Some(exact) if is_better => Next::Exact(exact),
        None if is_better => Next::Frame(picture, level),
        // A moment that has passed is not worth waking for: the camera is elsewhere already.
        _ => Next::Nothing(Some(picture.since + REST_AFTER).filter(|rest| *rest > Instant::now())),
    }
}

/// Whether a picture shows more than the client has.
fn is_better(picture: &Picture, level: Level, shown: &Shown) -> bool {
    if picture.scene() != shown.scene || level > shown.level {
        return true;
    }
    let is_refined = picture.number != shown.number && !shown.is_settled;
    level == Level::Rest && is_refined && (picture.is_settled || shown.at.elapsed() >= AGAIN_AFTER)
}
