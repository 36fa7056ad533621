//! A scan of all samples of an elevation source before they are used, for undeclared fill and
//! implausible heights.

use super::raster::Raster;
use super::readers::{open_raster, read_alpha, read_mask};
use super::values::{ElevationValues, MAX_HEIGHT_M, SENTINEL_GAP, SENTINELS, lone_sentinels};
use crate::error::IngestError;
use crate::work::Work;
use gdal::Dataset;
use gdal::raster::GdalDataType;

/// Samples that are read at a time.
const PART_SAMPLES: usize = 4 << 20;
/// No sentinel is closer to zero, so most samples need no further check.
const LEAST_SENTINEL: f32 = 9_999.0;

/// Number and range of values.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stats {
    pub(super) count: u64,
    pub(super) low: f64,
    pub(super) high: f64,
}

impl Default for Stats {
    fn default() -> Self {
        Self { count: 0, low: f64::MAX, high: f64::MIN }
    }
}

impl Stats {
    fn add(&mut self, value: f64, count: u64) {
        self.count += count;
        self.low = self.low.min(value);
        self.high = self.high.max(value);
    }

    fn merge(&mut self, other: &Self) {
        self.count += other.count;
        self.low = self.low.min(other.low);
        self.high = self.high.max(other.high);
    }
}

/// Statistics of a source's samples, without declared or masked voids.
#[derive(Debug, Clone, Default)]
pub(super) struct Survey {
    /// Undeclared fill and how many samples have it.
    pub(super) sentinels: Vec<(f32, u64)>,
    /// Plausible heights, metres.
    pub(super) heights: Stats,
    /// Samples beyond the heights of any body, in the file's values.
    pub(super) beyond: Stats,
    /// Those of them that could be distances from the body's centre, metres.
    pub(super) distances: Stats,
}

#[derive(Default)]
struct Part {
    survey: Survey,
    sentinels: [[u64; 2]; SENTINELS.len()],
    huge: (f32, u64),
}

/// The checks of every sample.
struct Question<'a> {
    values: &'a ElevationValues,
    radius_m: f64,
}

impl Question<'_> {
    fn look(&self, part: &mut Part, sample: f32) {
        if !sample.is_finite() || self.values.is_declared_void(sample) {
            return;
        }
        if sample.abs() > 1e30 {
            part.huge = (sample, part.huge.1 + 1);
            return;
        }
        if sample.abs() >= LEAST_SENTINEL - SENTINEL_GAP {
            let mut is_sentinel = false;
            for (sentinel, count) in SENTINELS.iter().zip(&mut part.sentinels) {
                let distance = (sample - sentinel).abs();
                if distance <= SENTINEL_GAP {
                    count[usize::from(distance > 0.0)] += 1;
                    is_sentinel |= distance == 0.0;
                }
            }
            if is_sentinel {
                // Whether it is a sentinel is only known after all samples.
                return;
            }
        }
        self.count(&mut part.survey, sample, 1);
    }

    fn count(&self, survey: &mut Survey, sample: f32, count: u64) {
        let height = self.values.meters(sample);
        let share = height / self.radius_m;
        if (0.5..1.5).contains(&share) {
            survey.distances.add(height, count);
        }
        if height.abs() <= f64::from(MAX_HEIGHT_M) {
            survey.heights.add(height, count);
        } else {
            survey.beyond.add(f64::from(sample), count);
        }
    }
}

impl Survey {
    /// Reads all of a source (except 8-bit samples, which cannot be implausible). Looks for fill if
    /// `finds_fill`.
    pub(super) fn of(
        raster: &Raster,
        values: &ElevationValues,
        radius_m: f64,
        finds_fill: bool,
        work: &Work,
    ) -> Result<Self, IngestError> {
        if raster.bands()[0].data_type == GdalDataType::UInt8 && values.is_plain() {
            return Ok(Self::default());
        }
        let parts = parts_of(raster)?;
        let question = Question { values, radius_m };
        let mut all = Part::default();
        work.in_order(
            "looking for voids",
            parts.len(),
            || open_raster(raster),
            |dataset, index| look_at(raster, dataset, &question, parts[index]),
            |part| {
                all.merge(&part);
                Ok(())
            },
        )?;
        Ok(all.finish(&question, finds_fill))
    }
}

impl Part {
    fn merge(&mut self, other: &Self) {
        self.survey.heights.merge(&other.survey.heights);
        self.survey.beyond.merge(&other.survey.beyond);
        self.survey.distances.merge(&other.survey.distances);
        let counts = self.sentinels.iter_mut().flatten().zip(other.sentinels.iter().flatten());
        counts.for_each(|(count, more)| *count += more);
        if other.huge.1 > 0 {
            self.huge = (other.huge.0, self.huge.1 + other.huge.1);
        }
    }

    fn finish(mut self, question: &Question<'_>, finds_fill: bool) -> Survey {
        let alone = if finds_fill { lone_sentinels(&self.sentinels) } else { Vec::new() };
        for (sentinel, [count, _]) in SENTINELS.into_iter().zip(self.sentinels) {
            if count > 0 && !alone.iter().any(|(value, _)| *value == sentinel) {
                question.count(&mut self.survey, sentinel, count);
            }
        }
        self.survey.sentinels = alone;
        if self.huge.1 > 0 && finds_fill {
            self.survey.sentinels.push(self.huge);
        }
        self.survey
    }
}

/// Rectangles `[x, y, width, height]` of rows that lie together in the file, not larger than a
/// thread may hold.
fn parts_of(raster: &Raster) -> Result<Vec<[usize; 4]>, IngestError> {
    let dataset = open_raster(raster)?;
    let band = dataset.rasterband(1).map_err(|e| unreadable(raster, &e))?;
    let [columns, rows] = raster.size();
    let (_, block_rows) = band.block_size();
    let step = (block_rows * PART_SAMPLES.div_ceil(columns * block_rows).max(1)).min(rows);
    let mut parts = Vec::new();
    for y in (0..rows).step_by(step) {
        let height = step.min(rows - y);
        // A strip of rows that would not fit is read in pieces.
        let width = (4 * PART_SAMPLES).div_ceil(height).min(columns);
        parts.extend((0..columns).step_by(width).map(|x| [x, y, width.min(columns - x), height]));
    }
    Ok(parts)
}

fn unreadable(raster: &Raster, error: &gdal::errors::GdalError) -> IngestError {
    raster.fails("cannot be read", error)
}

fn look_at(
    raster: &Raster,
    dataset: &mut Dataset,
    question: &Question<'_>,
    [x, y, width, height]: [usize; 4],
) -> Result<Part, IngestError> {
    let (origin, size) = ([x, y], [width, height]);
    let band = dataset.rasterband(1).map_err(|e| unreadable(raster, &e))?;
    let first = [0, 1].map(|axis| (raster.first()[axis] + origin[axis]) as isize);
    let samples = band.read_as::<f32>((first[0], first[1]), (width, height), (width, height), None);
    let samples = samples.map_err(|e| unreadable(raster, &e))?;
    let mut part = Part::default();
    let mut is_shown = vec![true; 0];
    for mask in [read_mask(raster, dataset, origin, size)?, read_alpha(raster, dataset, origin, size)?] {
        match (mask, is_shown.is_empty()) {
            (Some(mask), true) => is_shown = mask,
            (Some(mask), false) => is_shown.iter_mut().zip(mask).for_each(|(shown, other)| *shown &= other),
            (None, _) => {}
        }
    }
    for (at, sample) in samples.data().iter().enumerate() {
        if is_shown.get(at).copied().unwrap_or(true) {
            question.look(&mut part, *sample);
        }
    }
    Ok(part)
}
