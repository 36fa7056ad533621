//! What is there of a flight whose frames go into files: counted in the folders themselves, so that
//! it is true however the flight has ended.

use super::progress::Progress;
use crate::data_set::{DataSet, FRAMES_FILE, FlownFrame, TRANSFORMS_FILE};
use crate::failure::Failure;
use crate::machine::bytes_for_people;
use crate::measure::stats::RunStats;
use crate::output::FrameFolder;
use crate::plan::FlightPlan;
use std::collections::BTreeSet;
use terravision_common::camera::Camera;
use terravision_common::ids::FrameNumber;
use terravision_common::run::OPEN_END;

/// Frames of a flight that are whole in files.
#[derive(Debug, Default)]
pub struct Kept {
    /// Their numbers; `None` where frames do not go into files of their own.
    frames: Option<BTreeSet<u64>>,
}

impl Kept {
    /// Looks into the folders of a flight that has ended.
    #[must_use]
    pub fn of(plan: &FlightPlan) -> Self {
        let range = plan.config.frames;
        let pictures = plan.folders.iter().map(|folder| folder.whole_frames("png", range));
        let planes = plan.data_sets.iter().map(|set| set.whole_frames(range));
        let in_all = |a: BTreeSet<u64>, b: BTreeSet<u64>| a.intersection(&b).copied().collect();
        Self { frames: pictures.chain(planes).reduce(in_all) }
    }

    /// How many there are, where frames go into files.
    #[must_use]
    pub fn count(&self) -> Option<u64> {
        self.frames.as_ref().map(|frames| frames.len() as u64)
    }

    /// What a flight that was broken off leaves, and how to go on: a clause. Empty when it leaves
    /// nothing.
    #[must_use]
    pub fn clause(&self, plan: &FlightPlan) -> String {
        let Some(frames) = self.frames.as_ref().filter(|frames| !frames.is_empty()) else { return String::new() };
        let place = match (plan.folders.first(), plan.data_sets.first()) {
            (None, Some(set)) => set.planes().map(|(folder, _)| folder.path().display().to_string()).next(),
            _ => Some(plan.destination.clone()),
        };
        let what = if frames.len() == 1 {
            "1 whole frame is".to_owned()
        } else {
            format!("{} whole frames are", frames.len())
        };
        let mut text = format!("; {what} in {}", place.unwrap_or_default());
        let [first, end] = plan.config.frames;
        let missing = (first..end).find(|frame| !frames.contains(frame)).filter(|_| end != OPEN_END);
        // Of a film nothing is left: it has to be flown anew.
        if let Some(missing) = missing.filter(|_| plan.stream.is_none()) {
            text += &format!(", and --frames {missing}..{end} makes the rest");
        }
        text
    }

    /// Lists the frames of a data set, and says what it is. Of a flight that was broken off too:
    /// what is whole can be used.
    ///
    /// # Errors
    /// The listing cannot be written.
    pub fn list(&self, plan: &FlightPlan, stats: &RunStats, progress: &Progress) -> Result<(), Failure> {
        let Some(frames) = self.frames.as_ref().filter(|frames| !frames.is_empty()) else { return Ok(()) };
        let flown: Vec<FlownFrame> = flown(plan, stats).filter(|flown| frames.contains(&flown.frame.get())).collect();
        plan.data_sets.iter().try_for_each(|set| Self::list_in(set, frames, &flown, plan, stats, progress))
    }

    fn list_in(
        set: &DataSet,
        frames: &BTreeSet<u64>,
        flown: &[FlownFrame],
        plan: &FlightPlan,
        stats: &RunStats,
        progress: &Progress,
    ) -> Result<(), Failure> {
        let listed = set.list(flown, &plan.config.run_id).map_err(Failure::failed)?;
        let folder = set.folder();
        if listed.dropped > 0 {
            progress.warn(&format!(
                "{} listed {} of a flight with another size, CRS, frame rate or exaggeration; they are no longer listed",
                folder.join(FRAMES_FILE).display(),
                super::frames(listed.dropped as u64)
            ));
        }
        let also = if listed.has_transforms { format!(", and in {TRANSFORMS_FILE}") } else { String::new() };
        progress.say(&format!(
            "{} listed in {}{also}{}",
            super::frames(listed.frames as u64),
            folder.join(FRAMES_FILE).display(),
            rate(set.plane_bytes(frames), stats)
        ));
        Ok(())
    }
}

/// How fast planes were written: a clause.
fn rate(bytes: u64, stats: &RunStats) -> String {
    let frames = &stats.collector.frames;
    let first = frames.iter().map(|frame| frame.draw_started_nanos).filter(|nanos| *nanos > 0).min();
    let last = frames.iter().map(|frame| frame.written_nanos).max();
    let seconds = first.zip(last).map_or(0.0, |(first, last)| last.saturating_sub(first) as f64 / 1e9);
    if seconds <= 0.0 {
        return format!("; depth and ground: {}", bytes_for_people(bytes));
    }
    format!("; depth and ground: {}, {}/s", bytes_for_people(bytes), bytes_for_people((bytes as f64 / seconds) as u64))
}

/// The cameras of a flight, by frame: those of the plan, or those that came.
fn flown<'a>(plan: &'a FlightPlan, stats: &'a RunStats) -> impl Iterator<Item = FlownFrame> + 'a {
    let (first, fps) = (plan.config.frames[0], plan.config.fps);
    let planned = (first..).zip(&plan.cameras).map(move |(frame, camera)| FlownFrame {
        frame: FrameNumber::new(frame),
        time_s: frame as f64 / fps,
        camera: *camera,
    });
    let since = stats.poses.first().map_or(0, |first| first.camera.timestamp_nanos());
    // A sender without a clock is taken to have that of this machine, from its first pose.
    let own = move |camera: &Camera| camera.timestamp_nanos().saturating_sub(since) as f64 / 1e9;
    let timed = move |flown: &FlownFrame| {
        let time_s = if flown.time_s.is_finite() { flown.time_s } else { own(&flown.camera) };
        FlownFrame { time_s, ..*flown }
    };
    planned.chain(stats.poses.iter().map(timed))
}

/// Where half files of killed stages may be.
pub fn folders(plan: &FlightPlan) -> impl Iterator<Item = &FrameFolder> {
    plan.folders.iter().chain(plan.data_sets.iter().flat_map(|set| set.planes().map(|(folder, _)| folder)))
}
