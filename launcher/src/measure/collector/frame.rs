//! What is known of one frame.

use terravision_common::event::{Event, EventContent, SpanName};
use terravision_common::run::TechniqueChoice;

/// Spans of which each frame has a sum: all names.
pub const SPANS: usize = SpanName::ALL.len();

/// Techniques of which each frame has a sum.
pub const TECHNIQUES: [TechniqueChoice; 2] = [TechniqueChoice::Mesh, TechniqueChoice::Rays];

/// What the draws of one technique cost in a frame.
#[derive(Debug, Clone, Copy, Default)]
pub struct DrawStats {
    /// By the clock of what drew.
    pub nanos: u64,
    /// Tiles, in each view for itself.
    pub tiles: u64,
}

/// What is known of one frame. Times are nanoseconds of the monotonic clock, 0 for what has not
/// come.
#[derive(Debug, Clone, Copy, Default)]
pub struct FrameStats {
    /// Sum of durations by [`SpanName`] (its number less one).
    pub span_nanos: [u64; SPANS],
    /// When the renderer began with the frame.
    pub draw_started_nanos: u64,
    /// End of its read-back.
    pub done_nanos: u64,
    /// When it had left the sink.
    pub written_nanos: u64,
    /// By technique, as in [`TECHNIQUES`].
    pub draws: [DrawStats; TECHNIQUES.len()],
    /// Triangles drawn.
    pub triangles: u64,
    /// Tiles that it wanted.
    pub wanted: u32,
    /// Nodes of its tree.
    pub nodes: u32,
    /// Tiles that were copied to the device for it.
    pub uploaded: u64,
    /// Whether it was written with all the tiles that it wanted.
    pub is_settled: bool,
    /// When its camera was made (realtime).
    pub camera_nanos: u64,
    /// When its pose came, of a frame that was drawn for a pose of another program (exact mode).
    pub pose_nanos: u64,
    /// Screen resolutions of facets and texels, pixels (realtime).
    pub r_px: [f32; 2],
    /// Tiles that it wanted and that were not there (realtime).
    pub lacked: u32,
    /// Share of the ground's screen area that it draws as finely as wanted (realtime).
    pub sharp: f32,
}

impl FrameStats {
    /// Takes an event about this frame.
    pub(super) fn take(&mut self, content: EventContent, event: &Event) {
        match content {
            EventContent::Span { name, .. } => self.take_span(name, event),
            EventContent::FrameDone { triangles } => {
                self.done_nanos = event.start_nanos;
                self.triangles = triangles;
            }
            EventContent::FrameWritten { is_settled } => {
                self.written_nanos = event.start_nanos.saturating_add(event.duration_nanos);
                self.is_settled = is_settled;
            }
            EventContent::FrameWanted { tiles, nodes } => (self.wanted, self.nodes) = (tiles, nodes),
            EventContent::FrameUploaded { tiles } => self.uploaded = self.uploaded.saturating_add(tiles),
            EventContent::FrameCamera { r_z_px, r_c_px } => {
                self.camera_nanos = event.start_nanos;
                self.r_px = [r_z_px, r_c_px];
            }
            EventContent::FrameLacked { tiles, sharp_share } => (self.lacked, self.sharp) = (tiles, sharp_share),
            EventContent::FrameDraw { technique, tiles, .. } => {
                let own = TECHNIQUES.iter().position(|other| *other == technique);
                if let Some(draws) = own.and_then(|index| self.draws.get_mut(index)) {
                    draws.nanos = draws.nanos.saturating_add(event.duration_nanos);
                    draws.tiles += u64::from(tiles);
                }
            }
            // About the run, not about a frame.
            EventContent::Text { .. } | EventContent::TileUnavailable { .. } | EventContent::TileCame { .. } => {}
        }
    }

    fn take_span(&mut self, name: SpanName, event: &Event) {
        let sum = &mut self.span_nanos[name as usize - 1];
        *sum = sum.saturating_add(event.duration_nanos);
        let is_drawing = matches!(name, SpanName::Record | SpanName::Upload | SpanName::Draw);
        if is_drawing && (self.draw_started_nanos == 0 || event.start_nanos < self.draw_started_nanos) {
            self.draw_started_nanos = event.start_nanos;
        }
    }
}
