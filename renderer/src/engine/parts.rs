//! Which technique draws which tiles: the draws of a frame.

use crate::frame::Frame;
use crate::gpu::MOST_PIECES;
use crate::technique::{Draw, Technique, TileSubset};
use std::ops::Range;
use terravision_common::rig::MAX_VIEWS;
use terravision_common::run::TechniqueChoice;
use terravision_common::slot::TileSlot;

/// Parts of a view at most, so that each draw has a time of its own.
pub const MOST_PARTS: usize = MOST_PIECES / MAX_VIEWS;

/// How the tiles of a view are shared among draws.
#[derive(Debug, Clone)]
pub struct Parts {
    /// What draws each part: [`TechniqueChoice::Mesh`] or [`TechniqueChoice::Rays`], at most
    /// [`MOST_PARTS`].
    pub techniques: Vec<TechniqueChoice>,
    /// Which part a tile is of. Tiles of no part are not drawn.
    pub part_of: fn(&TileSlot) -> usize,
}

impl Parts {
    /// All tiles by one technique.
    #[must_use]
    pub fn whole(technique: TechniqueChoice) -> Self {
        Self { techniques: vec![technique], part_of: |_| 0 }
    }

    /// The techniques, each once.
    pub(super) fn distinct(&self) -> Vec<TechniqueChoice> {
        let mut distinct: Vec<TechniqueChoice> = Vec::new();
        for technique in &self.techniques {
            if !distinct.contains(technique) {
                distinct.push(*technique);
            }
        }
        distinct
    }
}

/// One draw of a frame.
#[derive(Debug, Clone)]
pub(super) struct Planned {
    /// Index of its technique.
    pub(super) technique: usize,
    /// Its number among that technique's draws.
    pub(super) of_technique: usize,
    /// Which view it is of.
    pub(super) view: usize,
    /// Its tiles, among the list's numbers.
    pub(super) tiles: Range<usize>,
}

/// The draws of a frame, view by view; keeps its memory.
#[derive(Debug, Default)]
pub(super) struct DrawList {
    numbers: Vec<u32>,
    draws: Vec<Planned>,
}

impl DrawList {
    /// Plans a frame. `of_part`: index of each part's technique.
    pub(super) fn plan(
        &mut self,
        frame: &Frame,
        part_of: fn(&TileSlot) -> usize,
        of_part: &[usize],
        techniques: &[Box<dyn Technique>],
    ) {
        self.numbers.clear();
        self.draws.clear();
        for view in 0..frame.views.len() {
            for (part, &technique) in of_part.iter().enumerate() {
                let wants_unseen = techniques.get(technique).is_some_and(|technique| technique.wants_unseen());
                let start = self.numbers.len();
                let drawn = (0u32..)
                    .zip(&frame.tiles)
                    .filter(|(_, tile)| (wants_unseen || tile.may_be_seen_by(view)) && part_of(tile) == part);
                self.numbers.extend(drawn.map(|(number, _)| number));
                let tiles = start..self.numbers.len();
                if !tiles.is_empty() {
                    let of_technique = self.draws.iter().filter(|draw| draw.technique == technique).count();
                    self.draws.push(Planned { technique, of_technique, view, tiles });
                }
            }
        }
    }

    /// All draws, in order.
    pub(super) fn draws(&self) -> &[Planned] {
        &self.draws
    }

    /// The draws of a technique, as it is told of them.
    pub(super) fn of_technique(&self, technique: usize) -> impl Iterator<Item = Draw<'_>> {
        let own = self.draws.iter().enumerate().filter(move |(_, draw)| draw.technique == technique);
        own.map(|(number, draw)| {
            let tiles = TileSubset { numbers: &self.numbers[draw.tiles.clone()] };
            Draw { number, view: draw.view, tiles }
        })
    }
}
