//! Worlds of several spacings: the finest levels exist only where the data are as fine.
//!
//! ```text
//!   level 0   ▓▓▓▓                 1 m, where the 1 m data are
//!   level 1  ▒▓▓▓▓▒                2 m: filtered from level 0 where it is, else sampled; a rim of nodes, so that
//!   …                              levels of neighbouring leaves never differ by more than one
//!   level 5 ▓▓▓▓▓▓▓▓▓▓▓▓▓▓▓▓       30 m, everywhere
//! ```
//!
//! A source's level is the one with the closest spacing (but at most 7 % coarser). At each level,
//! from the finest up, blocks are sampled where there are sources of this level, or nodes without
//! children; nodes with children are filtered from these. Finer heights are blended into coarser
//! ones within some posts ([`blend`]).

mod blend;
mod blocks;
mod color;
mod elevation;
mod nodes;

pub(crate) use blocks::meeting;
pub(crate) use nodes::Nodes;

use crate::IngestError;
use crate::plan::Plan;
use crate::sample::elevation::Summary;
use crate::source::values::{ColorValues, ElevationValues};
use crate::source::{Note, Raster, TargetCrs};
use crate::store::{Level, Rect, Rgb};
use crate::tint::{Place, Tint};
use crate::work::Work;
use std::path::Path;
use terravision_common::database::Layer;
use terravision_common::level::deepest_color_below;
use terravision_common::node::NodeId;
use terravision_common::tint::HeightColors;

/// The levels of both pyramids, which of their nodes exist, and what was found.
pub(crate) struct Nested {
    pub(crate) elevation: Vec<Level<f32>>,
    pub(crate) elevation_nodes: Nodes,
    pub(crate) color: Vec<Level<Rgb>>,
    pub(crate) color_nodes: Nodes,
    pub(crate) summary: Summary,
    /// Of the tint.
    pub(crate) tint: HeightColors,
    /// Area without elevation data, and without colour.
    pub(crate) void_areas_m2: [f64; 2],
}

/// What an ingest of several spacings works on.
pub(crate) struct Sources<'a> {
    pub(crate) plan: &'a Plan,
    pub(crate) target: &'a TargetCrs,
    pub(crate) elevation: &'a [(Raster, ElevationValues)],
    pub(crate) color: &'a [(Raster, ColorValues)],
    pub(crate) place: Place<'a>,
    pub(crate) folder: &'a Path,
    pub(crate) work: &'a Work,
}

impl Sources<'_> {
    /// Makes all levels.
    pub(crate) fn levels(&self, note: &mut dyn FnMut(Note)) -> Result<Nested, IngestError> {
        let Self { plan, target, folder, work, .. } = *self;
        let elevation = elevation::NestedElevation { plan, target, sources: self.elevation, folder, work };
        let elevation = elevation.levels(&self.nodes_above_color())?;
        let fail = |source| IngestError::Output { source, path: folder.to_owned() };
        // The terrain's range is taken from the finest complete level with at most a million posts.
        let world = &plan.world;
        let finest = world.finest_elevation_level();
        let is_whole = |q: u8| {
            let all: u64 = world.nodes_at(q).map(u64::from).iter().product();
            elevation.nodes.of_level(q).len() as u64 == all
        };
        let is_small = |q: u8| elevation.levels[usize::from(q - finest)].size().iter().product::<u64>() <= 1 << 20;
        let overview = (finest..world.levels()).find(|q| is_small(*q) && is_whole(*q)).unwrap_or(world.root().q());
        let posts = &elevation.levels[usize::from(overview - finest)];
        let overview_m = world.elevation_spacing_m(overview);
        let tint = Tint::new(posts, overview_m, overview_m, (posts, overview_m), self.place).map_err(fail)?;
        let color =
            color::Color { plan, target, sources: self.color, elevation: &elevation, tint: &tint, folder, work };
        let (color, colors) = (color.levels()?, tint.colors());
        note(Note::Info(format!(
            "the finest levels are only where the data are as fine: {} elevation and {} colour tiles",
            elevation.nodes.count(),
            color.nodes.count()
        )));
        Ok(Nested {
            elevation: elevation.levels,
            elevation_nodes: elevation.nodes,
            color: color.levels,
            color_nodes: color.nodes,
            summary: elevation.summary,
            tint: colors,
            void_areas_m2: [elevation.void_area_m2, color.tint_area_m2],
        })
    }

    /// Elevation nodes that must exist because finer colour lies below them.
    fn nodes_above_color(&self) -> Vec<NodeId> {
        let world = &self.plan.world;
        let nodes = Nodes::new(world, Layer::Elevation);
        let side = world.color_tile() as usize;
        let mut above = Vec::new();
        for (native, bounds) in self.plan.color_levels.iter().zip(&self.plan.color_bounds) {
            let q = native + deepest_color_below(world);
            let q = q.clamp(world.finest_elevation_level(), world.root().q());
            let step = world.color_spacing_m(q);
            let lattice = crate::plan::Lattice { first: world.fields().origin, step };
            let size = world.nodes_at(q).map(|n| u64::from(n) * side as u64);
            let rect: Option<Rect> = blocks::samples_of(bounds, &lattice, size);
            above.extend(rect.into_iter().flat_map(|rect| nodes.meeting(q, rect, side)));
        }
        above
    }
}
