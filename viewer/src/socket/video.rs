//! Whether a client that decodes video is sent it, and its encoder while it is.

use super::message::Acknowledgement;
use crate::hub::Hub;
use crate::picture::{Picture, now_ms};
use crate::video::{LinkRate, Unit, VideoEncoder, VideoError};
use std::sync::Arc;
use tokio::sync::OwnedSemaphorePermit;

/// Frames a second that JPEG is to reach, of a flight that is not told another rate.
const USUAL_FPS: f64 = 30.0;

/// A client that decodes video.
#[derive(Debug, Default)]
pub(super) struct Video {
    /// What its link carries.
    pub(super) link: LinkRate,
    /// While it is sent video: its encoder, and the place among those there may be.
    encoder: Option<(VideoEncoder, OwnedSemaphorePermit)>,
    /// It has none, and is not to be tried again.
    is_given_up: bool,
    /// The picture that is under way: bytes, and when it was sent.
    under_way: Option<(usize, f64)>,
}

impl Video {
    /// A message with a picture is sent.
    pub(super) fn sent(&mut self, bytes: usize) {
        self.under_way = Some((bytes, now_ms()));
    }

    /// The picture that was under way has come.
    pub(super) fn acknowledged(&mut self, acknowledgement: &Acknowledgement) {
        let Some((bytes, sent_ms)) = self.under_way.take() else { return };
        self.link.note_picture(bytes, now_ms() - sent_ms, acknowledgement.ms);
        if acknowledgement.failed && self.encoder.take().is_some() {
            self.is_given_up = true;
        }
    }

    /// The next moving picture as video, where the client is to have that; and what it is to be
    /// told, where that changes.
    pub(super) async fn unit(&mut self, hub: &Hub, picture: &Picture) -> (Option<Unit>, Option<String>) {
        let fps = hub.flight.borrow().settings.fps.unwrap_or(USUAL_FPS);
        if self.is_given_up || !self.link.wants_video(self.encoder.is_some(), fps) {
            self.encoder = None;
            return (None, None);
        }
        match self.encode(hub, picture, fps).await {
            Ok(unit) => (unit, None),
            Err(error) => {
                self.encoder = None;
                self.is_given_up = true;
                (None, Some(format!("the link is slow, and pictures stay JPEG: {error}")))
            }
        }
    }

    async fn encode(&mut self, hub: &Hub, picture: &Picture, fps: f64) -> Result<Option<Unit>, VideoError> {
        // An encoder has one size and one rate.
        let rate = self.link.bytes_per_s();
        let fits = |(encoder, _): &(VideoEncoder, _)| encoder.size() == picture.size && encoder.fits_link(rate);
        if !self.encoder.as_ref().is_some_and(fits) {
            let place = match self.encoder.take() {
                Some((_, place)) => Some(place),
                None => Arc::clone(&hub.encoders).try_acquire_owned().ok(),
            };
            let (Some(place), Some(rate)) = (place, rate) else { return Ok(None) };
            self.encoder = Some((VideoEncoder::start(picture.size, fps, rate)?, place));
        }
        let Some((encoder, _)) = &mut self.encoder else { return Ok(None) };
        encoder.encode(&picture.frame.rgba).await.map(Some)
    }
}
