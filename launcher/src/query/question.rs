//! What is asked, and the places that it is asked of.

use crate::path::crs::Transform;
use glam::{DVec2, DVec3};
use terravision_common::ground::{
    Answer, GroundSample, GroundScratch, GroundTiles, Interpolation, LineOfSight, NoGround, Touch,
};
use terravision_common::surface::CrsFrame;
use terravision_common::validity::Validity;

/// Largest radius of a sphere, metres: what it may touch has to be looked at.
pub(super) const MOST_RADIUS_M: f64 = 1000.0;

/// What is asked of each place, or each pair of places.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Question {
    /// Height and normal of the ground.
    Height,
    /// Whether the second place is seen from the first.
    Sight,
    /// Where a sphere of this radius, metres, touches the ground on its way.
    Sphere(f64),
}

impl Question {
    /// What a line or a point of this question has.
    pub(super) fn expected(self) -> &'static str {
        match self {
            Self::Height => "x y or x y z",
            Self::Sight | Self::Sphere(_) => "x1 y1 z1 x2 y2 z2",
        }
    }
}

/// How places are given, and what is asked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Terms {
    pub(super) question: Question,
    pub(super) interpolation: Interpolation,
    /// Whether places are longitude and latitude, degrees.
    pub(super) is_lonlat: bool,
    /// Whether heights are above the ground.
    pub(super) is_agl: bool,
}

/// Why a place has no answer.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Refusal {
    /// There is no ground, although there are data.
    Hole,
    /// The place is beside the world.
    Outside,
    /// Tiles cannot be read.
    Unreadable,
    /// The place cannot be understood: a sentence.
    Bad(String),
}

impl Refusal {
    /// The word for it.
    pub(super) fn status(&self) -> &'static str {
        match self {
            Self::Hole => "hole",
            Self::Outside => "outside",
            Self::Unreadable => "unreadable",
            Self::Bad(_) => "bad",
        }
    }
}

impl From<NoGround> for Refusal {
    fn from(error: NoGround) -> Self {
        match error {
            NoGround::Outside => Self::Outside,
            NoGround::Unreadable => Self::Unreadable,
        }
    }
}

/// What was found, in the coordinates of the question.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Found {
    /// Of a height.
    Ground {
        height_m: f64,
        /// East, north, up.
        normal: DVec3,
        /// Of a place that was given with a height.
        above_m: Option<f64>,
        is_measured: bool,
    },
    /// Of a line of sight.
    Visible { distance_m: f64 },
    /// Of a line of sight.
    Hidden { distance_m: f64, at: [f64; 3] },
    /// Of a sphere.
    Free,
    /// Of a sphere.
    Touch { distance_m: f64, center: [f64; 3], contact: [f64; 3], normal: DVec3 },
}

pub(super) type Reply = Result<Answer<Found>, Refusal>;

/// Places as numbers: two or three of a height, six of a pair; or why they are none.
pub(super) type Given = Result<([f64; 6], usize), String>;

/// Answers questions, on one thread.
pub(super) struct Asker<'a> {
    tiles: &'a GroundTiles<'a>,
    frame: CrsFrame,
    /// From longitude and latitude, where the world's CRS allows it.
    transform: Option<&'a Transform>,
    scratch: GroundScratch,
    feet: Vec<DVec2>,
    samples: Vec<Result<Answer<GroundSample>, NoGround>>,
}

impl<'a> Asker<'a> {
    pub(super) fn new(tiles: &'a GroundTiles<'a>, transform: Option<&'a Transform>) -> Self {
        let frame = tiles.world().crs_frame();
        Self { tiles, frame, transform, scratch: GroundScratch::default(), feet: Vec::new(), samples: Vec::new() }
    }

    /// Whether places can be longitude and latitude.
    pub(super) fn knows_lonlat(&self) -> bool {
        self.transform.is_some()
    }

    /// Answers a batch, one reply for each that is given, in order.
    pub(super) fn answer_all(&mut self, terms: &Terms, given: Vec<Given>, replies: &mut Vec<Reply>) {
        match terms.question {
            Question::Height => self.heights(terms, given, replies),
            _ => replies.extend(given.into_iter().map(|given| self.pair(terms, given))),
        }
    }

    /// The transform, for places in longitude and latitude.
    fn way(&self, terms: &Terms) -> Option<&'a Transform> {
        self.transform.filter(|_| terms.is_lonlat)
    }

    /// The foot of a place.
    fn foot(&self, terms: &Terms, x: f64, y: f64) -> Result<DVec2, Refusal> {
        let place = match self.way(terms) {
            Some(way) => way.position(x, y).map_err(|error| Refusal::Bad(error.to_string()))?,
            None => DVec2::new(x, y),
        };
        Ok(self.frame.foot(place))
    }

    fn heights(&mut self, terms: &Terms, given: Vec<Given>, replies: &mut Vec<Reply>) {
        let mut feet = std::mem::take(&mut self.feet);
        let mut samples = std::mem::take(&mut self.samples);
        feet.clear();
        samples.clear();
        let places: Vec<Result<Option<f64>, Refusal>> = given
            .into_iter()
            .map(|given| {
                let ([x, y, z, ..], count) = given.map_err(Refusal::Bad)?;
                feet.push(self.foot(terms, x, y)?);
                Ok((count > 2).then_some(z))
            })
            .collect();
        self.tiles.sample_all(&feet, terms.interpolation, &mut self.scratch, &mut samples);
        let mut found = samples.iter();
        replies.extend(places.into_iter().map(|place| {
            let z = place?;
            let Answer { found: sample, is_finest } = (*found.next().unwrap_or(&Err(NoGround::Outside)))?;
            if sample.ground.validity == Validity::Hole {
                return Err(Refusal::Hole);
            }
            let height_m = sample.ground.height_m;
            // A height above the ground is one already.
            let above_m = z.map(|z| if terms.is_agl { z } else { z - height_m });
            let is_measured = sample.ground.validity == Validity::Measured;
            Ok(Answer { found: Found::Ground { height_m, normal: sample.normal, above_m, is_measured }, is_finest })
        }));
        (self.feet, self.samples) = (feet, samples);
    }

    fn pair(&mut self, terms: &Terms, given: Given) -> Reply {
        let ([x1, y1, z1, x2, y2, z2], _) = given.map_err(Refusal::Bad)?;
        let from = self.position(terms, [x1, y1, z1])?;
        let to = self.position(terms, [x2, y2, z2])?;
        let length_m = from.distance(to);
        let place = |asker: &Self, position: DVec3| asker.place(terms, position, [x1, y1], [x2, y2]);
        match terms.question {
            Question::Sphere(radius_m) => {
                let Answer { found, is_finest } = self.tiles.sweep_sphere(from, to, radius_m, &mut self.scratch)?;
                let found = found.map_or(Found::Free, |Touch { share, center, contact, normal }| Found::Touch {
                    distance_m: share * length_m,
                    center: place(self, center),
                    contact: place(self, contact),
                    normal,
                });
                Ok(Answer { found, is_finest })
            }
            _ => {
                let Answer { found, is_finest } = self.tiles.line_of_sight(from, to, &mut self.scratch)?;
                let found = match found {
                    LineOfSight::Visible => Found::Visible { distance_m: length_m },
                    LineOfSight::Hidden { at, share } => {
                        Found::Hidden { distance_m: share * length_m, at: place(self, at) }
                    }
                };
                Ok(Answer { found, is_finest })
            }
        }
    }

    /// The position of a place with a height.
    fn position(&mut self, terms: &Terms, [x, y, z]: [f64; 3]) -> Result<DVec3, Refusal> {
        let foot = self.foot(terms, x, y)?;
        let mut height_m = z;
        if terms.is_agl {
            let sample = self.tiles.sample(foot, Interpolation::Facet, &mut self.scratch)?;
            if sample.found.ground.validity == Validity::Hole {
                return Err(Refusal::Hole);
            }
            height_m += sample.found.ground.height_m;
        }
        Ok(self.tiles.world().surface().position(foot, height_m))
    }

    /// The place of a position between two places, in the coordinates that they are given in. Its
    /// height is above sea level, or whatever heights of the world are above.
    fn place(&self, terms: &Terms, position: DVec3, from: [f64; 2], to: [f64; 2]) -> [f64; 3] {
        let place = self.frame.place(position);
        let Some(way) = self.way(terms) else { return place.to_array() };
        let middle = [0, 1].map(|axis| 0.5 * (from[axis] + to[axis]));
        let [lon, lat] = way.source_of(place.truncate(), middle).unwrap_or([f64::NAN; 2]);
        [lon, lat, place.z]
    }
}
