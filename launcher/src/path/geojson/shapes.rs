//! What a file of GeoJSON has, and what of it is flown.

use super::super::recording::{Recorded, Segment};

/// The shapes of a file.
#[derive(Default)]
pub(super) struct Shapes {
    /// All points that were read.
    pub(super) count: usize,
    pub(super) has_heights: bool,
    pub(super) lines: Vec<Segment>,
    /// Points without a time.
    pub(super) timeless: usize,
    /// Areas and what else there is.
    pub(super) others: usize,
    /// Points with times, a segment for each track.
    tracks: Vec<Segment>,
    /// What tells the last track from others.
    track: Option<[String; 2]>,
}

impl Shapes {
    pub(super) fn add_point(&mut self, point: Recorded, track: Option<[String; 2]>) {
        if self.tracks.is_empty() || track != self.track {
            self.tracks.push(Segment::default());
            self.track = track;
        }
        if let Some(segment) = self.tracks.last_mut() {
            segment.points.push(point);
        }
    }

    /// The lines, and the points with times, a segment for each track.
    pub(super) fn moving(self) -> [Vec<Segment>; 2] {
        [self.lines, self.tracks]
    }

    /// What is flown; what is not is told.
    ///
    /// # Errors
    /// What there is in place of anything to fly.
    pub(super) fn choose(self, notes: &mut Vec<String>) -> Result<Vec<Segment>, String> {
        let count = |segments: &[Segment]| segments.iter().map(|segment| segment.points.len()).sum::<usize>();
        let (of_lines, of_points) = (count(&self.lines), count(&self.tracks));
        let (flown, kind, timed) =
            if of_lines > 0 { (self.lines, "lines", of_points) } else { (self.tracks, "points with times", 0) };
        let said = list(&[
            (timed, ["point with a time", "points with a time"]),
            (self.timeless, ["point without a time", "points without a time"]),
            (self.others, ["other shape", "other shapes"]),
        ]);
        if of_lines + of_points == 0 {
            return Err(match said {
                Some(said) if self.timeless > 0 => {
                    format!("{said}; points without times have no order: draw a line through them")
                }
                Some(said) => said,
                None => "no shapes".into(),
            });
        }
        notes.extend(said.map(|said| format!("beside the {kind} the file has {said}, not flown")));
        Ok(flown)
    }
}

/// "2 points and 1 other shape", of what there is; each with what one and what several are called.
pub(crate) fn list(counted: &[(usize, [&str; 2])]) -> Option<String> {
    let said = |(count, names): &(usize, [&str; 2])| format!("{count} {}", names[usize::from(*count != 1)]);
    let mut parts: Vec<String> = counted.iter().filter(|(count, _)| *count > 0).map(said).collect();
    let last = parts.pop()?;
    Some(if parts.is_empty() { last } else { format!("{} and {last}", parts.join(", ")) })
}
