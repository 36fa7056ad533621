//! Labels burnt in: a text, a scale bar, a north arrow, the time. They are drawn where pictures
//! leave for files, streams and windows. What other programs read of a frame is the ground alone.

mod stamp;

use super::{FrameSink, Picture, SinkError, SizedRgba};
use crate::pixels::PixelPlaces;
use crate::technique::NEAR_M;
use ab_glyph::FontRef;
use stamp::{Stamp, ViewPixels};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use terravision_common::ids::FrameNumber;
use terravision_common::rig::View;
use terravision_common::run::LabelsConfig;

/// Letters are this share of a view's height, and no smaller than that, pixels.
const LETTER_SHARE: f32 = 1.0 / 32.0;
const SMALLEST_PX: f32 = 11.0;
/// A scale bar is at most this share of a view's width.
const BAR_SHARE: f64 = 0.22;

/// Hands pictures on with labels.
pub struct LabelSink {
    sink: Box<dyn FrameSink>,
    labels: LabelsConfig,
    fps: f64,
    font: FontRef<'static>,
    /// The text for letters of this height.
    text: Option<(f32, Stamp)>,
    rgba: Vec<u8>,
}

impl std::fmt::Debug for LabelSink {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LabelSink").field("labels", &self.labels).finish_non_exhaustive()
    }
}

impl LabelSink {
    /// Pictures with `labels` into this sink; `fps` frames are a second.
    ///
    /// # Errors
    /// The font that is part of this program cannot be read.
    pub fn new(sink: Box<dyn FrameSink>, labels: &LabelsConfig, fps: f64) -> Result<Self, SinkError> {
        let font = FontRef::try_from_slice(dejavu::sans::bold());
        let font = font.map_err(|error| SinkError::Encode { reason: error.to_string(), path: "labels".into() })?;
        Ok(Self { sink, labels: labels.clone(), fps, font, text: None, rgba: Vec::new() })
    }

    fn draw(&mut self, picture: &Picture<'_>, view: &View) {
        let [width, height] = view.size();
        let px = (height as f32 * LETTER_SHARE).max(SMALLEST_PX);
        let margin = px.round() as i32;
        let (right, bottom) = (width.cast_signed() - margin, height.cast_signed() - margin);
        let mut pixels = ViewPixels {
            rgba: &mut self.rgba,
            stride: picture.size[0] as usize,
            at: view.at.map(|at| at as usize),
            size: [width, height].map(|side| side as usize),
        };
        if let Some(text) = &self.labels.text {
            let (of_px, _) = self.text.get_or_insert_with(|| (px, Stamp::text(&self.font, px, text)));
            if *of_px != px {
                self.text = Some((px, Stamp::text(&self.font, px, text)));
            }
            if let Some((_, stamp)) = &self.text {
                stamp.draw(&mut pixels, [margin, bottom - stamp.size[1] as i32]);
            }
        }
        if self.labels.has_clock {
            Stamp::text(&self.font, px, &clock(picture.frame, self.fps)).draw(&mut pixels, [margin, margin]);
        }
        if self.labels.has_north_arrow {
            let turn = -view.camera.heading_rad() - view.camera.roll_rad();
            let side = (3.0 * px).round();
            let arrow = Stamp::shape([side as usize; 2], px, |x, y| is_in_arrow(x, y, side, turn as f32));
            arrow.draw(&mut pixels, [right - arrow.size[0] as i32, margin]);
            let letter = Stamp::text(&self.font, px, "N");
            let below = margin + arrow.size[1] as i32;
            letter.draw(&mut pixels, [right - (arrow.size[0] + letter.size[0]) as i32 / 2, below]);
        }
        if let Some((metres, length)) = self.labels.has_scale_bar.then(|| scale(picture, view)).flatten() {
            let (words, thick) = (Stamp::text(&self.font, px, &distance(metres)), (px / 6.0).max(2.0));
            let size = [length.ceil(), (0.6 * px).ceil()].map(|side| side as usize);
            let bar = Stamp::shape(size, px, |x, y| {
                let is_end = x < thick || x > size[0] as f32 - thick;
                is_end || y > size[1] as f32 - thick
            });
            let top = bottom - bar.size[1] as i32;
            bar.draw(&mut pixels, [right - bar.size[0] as i32, top]);
            words.draw(&mut pixels, [right - (bar.size[0] + words.size[0]) as i32 / 2, top - words.size[1] as i32]);
        }
    }
}

impl FrameSink for LabelSink {
    fn needs(&self) -> PixelPlaces {
        if self.sink.needs() == PixelPlaces::NOWHERE { PixelPlaces::NOWHERE } else { PixelPlaces::HOST }
    }

    fn tree_overlay(&self) -> Option<Arc<AtomicBool>> {
        self.sink.tree_overlay()
    }

    fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
        if picture.rgba.is_empty() {
            return self.sink.write(picture);
        }
        self.rgba.clear();
        self.rgba.extend_from_slice(picture.rgba);
        for view in picture.views.iter() {
            self.draw(picture, view);
        }
        self.sink.write(&Picture { rgba: &self.rgba, on_device: None, ..*picture })
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        self.sink.finish()
    }

    fn read_back(&mut self, frame: FrameNumber) -> Result<Option<SizedRgba>, SinkError> {
        self.sink.read_back(frame)
    }
}

/// The time of a frame in its flight.
fn clock(frame: FrameNumber, fps: f64) -> String {
    let tenths = (frame.get() as f64 / fps * 10.0 + 1e-6).floor() as u64;
    let [hours, minutes, seconds] = [tenths / 36_000, tenths / 600 % 60, tenths / 10 % 60];
    format!("{hours}:{minutes:02}:{seconds:02}.{}", tenths % 10)
}

/// Whether a place is in an arrow of a square of this side that points up, turned clockwise.
fn is_in_arrow(x: f32, y: f32, side: f32, turn: f32) -> bool {
    let (sin, cos) = turn.sin_cos();
    let (x, y) = (2.0 * x / side - 1.0, 1.0 - 2.0 * y / side);
    let (across, along) = (x * cos - y * sin, x * sin + y * cos);
    let wide = 0.62 * (0.95 - along) / 1.75;
    let notch = -0.8 + 0.55 * (1.0 - across.abs() / 0.62);
    along < 0.95 && across.abs() < wide && along > notch
}

/// A round length and its pixels, at the distance of the ground in the middle of a view, or of the
/// nearest below in its middle column.
fn scale(picture: &Picture<'_>, view: &View) -> Option<(f64, f32)> {
    let depth = picture.reversed_depth?;
    let [width, height] = view.size().map(|side| side as usize);
    let column = view.at[0] as usize + width / 2;
    let mut below = (height / 2..height).map(|y| (view.at[1] as usize + y) * picture.size[0] as usize + column);
    let nearness = below.find_map(|at| depth.get(at).copied().filter(|nearness| *nearness > 0.0))?;
    let plane = view.camera.picture_plane();
    let metres_per_px = NEAR_M / f64::from(nearness) * 2.0 * plane.half()[0] / width as f64;
    let metres = round_length(metres_per_px * BAR_SHARE * width as f64)?;
    Some((metres, (metres / metres_per_px) as f32))
}

/// The longest of 1, 2, 5, 10, … metres (and their parts) that is no longer.
fn round_length(most_m: f64) -> Option<f64> {
    let power = 10f64.powf(most_m.log10().floor());
    let factor = [5.0, 2.0, 1.0].into_iter().find(|factor| factor * power <= most_m)?;
    Some(factor * power).filter(|metres| metres.is_finite() && *metres > 0.0)
}

fn distance(metres: f64) -> String {
    match metres {
        metres if metres >= 1000.0 => format!("{} km", metres / 1000.0),
        metres if metres >= 1.0 => format!("{metres} m"),
        metres => format!("{} cm", (metres * 100.0 * 1000.0).round() / 1000.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clocks_and_lengths_are_for_people() {
        assert_eq!(clock(FrameNumber::new(0), 30.0), "0:00:00.0");
        assert_eq!(clock(FrameNumber::new(45), 30.0), "0:00:01.5");
        assert_eq!(clock(FrameNumber::new(3 * 3_725), 3.0), "1:02:05.0");
        for (most, metres, words) in
            [(1234.0, 1000.0, "1 km"), (999.0, 500.0, "500 m"), (49.0, 20.0, "20 m"), (0.3, 0.2, "20 cm")]
        {
            let found = round_length(most).expect("a length");
            assert!((found - metres).abs() < 1e-9 * metres && distance(found) == words, "{found}, {}", distance(found));
        }
        assert_eq!(distance(round_length(70_000.0).expect("a length")), "50 km");
        assert_eq!(round_length(0.0), None);
    }

    #[test]
    fn arrows_turn_with_the_camera() {
        let tip = |turn: f32, x: f32, y: f32| is_in_arrow(x, y, 100.0, turn);
        assert!(tip(0.0, 50.0, 8.0) && !tip(0.0, 50.0, 95.0) && !tip(0.0, 8.0, 50.0));
        // A camera that looks east has north at its left.
        let east = -std::f32::consts::FRAC_PI_2;
        assert!(tip(east, 8.0, 50.0) && !tip(east, 50.0, 8.0) && !tip(east, 95.0, 50.0));
    }

    #[test]
    fn text_leaves_ink_and_a_halo_and_stays_in_its_view() {
        let font = FontRef::try_from_slice(dejavu::sans::bold()).expect("a font");
        let stamp = Stamp::text(&font, 20.0, "Öl");
        let mut rgba = vec![100u8; 4 * 60 * 40];
        let mut view = ViewPixels { rgba: &mut rgba, stride: 60, at: [10, 5], size: [40, 30] };
        stamp.draw(&mut view, [-4, 2]);
        stamp.draw(&mut view, [35, 25]);
        let of = |x: usize, y: usize| rgba[4 * (y * 60 + x)];
        let inside = |x: usize, y: usize| (10..50).contains(&x) && (5..35).contains(&y);
        let all = || (0..60 * 40).map(|k| (k % 60, k / 60));
        assert!(all().filter(|(x, y)| !inside(*x, *y)).all(|(x, y)| of(x, y) == 100));
        assert!(all().filter(|(x, y)| of(*x, *y) == 255).count() > 20);
        assert!(all().filter(|(x, y)| of(*x, *y) < 60).count() > 20);
    }
}
