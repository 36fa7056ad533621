//! The world: heights of its ground, and what there is to know of it.

use glam::DVec2;
use serde_json::{Value, json};
use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use terravision_common::database::{TileError, TileScratch, TileSource, ground_at};
use terravision_common::node::NodeId;
use terravision_common::run::DatabaseConfig;
use terravision_common::surface::CrsFrame;
use terravision_common::validity::Validity;
use terravision_store::{Location, Store, StoreOptions};

/// Tiles that one question keeps: points that are asked together are often neighbours.
const KEPT_TILES: usize = 256;

/// A camera that is farther from the world than this many times the world's longer side is refused.
const FAR_FROM_WORLD: f64 = 2.0;

/// The world that is shown.
#[derive(Debug)]
pub(crate) struct Terrain {
    store: Store,
}

impl Terrain {
    pub(crate) fn open(config: &DatabaseConfig) -> Result<Self, crate::error::ViewerError> {
        let location = Location::parse_os(std::ffi::OsStr::new(&config.location))?;
        Ok(Self { store: Store::open(&location, &StoreOptions::of(config))? })
    }

    /// From places in the CRS to positions of cameras.
    pub(crate) fn crs_frame(&self) -> CrsFrame {
        self.store.world().crs_frame()
    }

    /// Whether places are degrees.
    pub(crate) fn is_geographic(&self) -> bool {
        self.store.manifest().fields().crs.proj4.as_ref().is_some_and(|proj4| proj4.contains("longlat"))
    }

    /// Whether a place is so far from the world that the flight refuses to go there.
    pub(crate) fn is_far(&self, x: f64, y: f64) -> bool {
        let [low, high] = self.store.world().crs_bounds();
        let place = DVec2::new(x, y);
        let away = (low - place).max(place - high).max(DVec2::ZERO).length();
        away > FAR_FROM_WORLD * (high - low).max_element()
    }

    /// Heights of the ground at places in the CRS, metres; `None` outside of the world, in holes
    /// and where no tile can be had. Blocks on storage.
    pub(crate) fn heights(&self, places: &[[f64; 2]]) -> Vec<Option<f64>> {
        let source = Kept { store: &self.store, tiles: Mutex::default() };
        let (world, mut scratch, mut is_told) = (self.store.world(), TileScratch::default(), false);
        let height = |&[x, y]: &[f64; 2]| {
            let foot = world.crs_frame().foot([x, y].into());
            let read = ground_at(&source, world, foot.x, foot.y, &mut scratch);
            if let (Err(error), false) = (&read, is_told) {
                tracing::warn!(%error, "a question for heights met a tile that cannot be read");
                is_told = true;
            }
            let ground = read.ok()??;
            (ground.validity != Validity::Hole).then_some(ground.height_m)
        };
        places.iter().map(height).collect()
    }

    /// `world` of the protocol, without the camera's start.
    pub(crate) fn facts(&self) -> Value {
        let (world, manifest) = (self.store.world(), self.store.manifest().fields());
        let [low, high] = world.crs_bounds();
        // In the units of the CRS.
        let node_side = (high - low) / DVec2::from(world.extent_m()) * world.node_side_m(0);
        let ([low, high], node_side) = ([low, high].map(|place| place.to_array()), node_side.to_array());
        json!({
            "name": manifest.name,
            "crs": manifest.crs.name,
            "epsg": manifest.crs.epsg,
            "is_geographic": self.is_geographic(),
            "body": manifest.body.name,
            "bounds": [low, high],
            "heights": self.store.ranges().range(world.root()),
            // Node m, n of level q is from the low corner of the bounds m and n times this, times 2^q.
            "node_side": node_side,
            "post_spacing_m": world.elevation_spacing_m(world.finest_elevation_level()),
        })
    }
}

/// A store that remembers the tiles of one question.
struct Kept<'a> {
    store: &'a Store,
    tiles: Mutex<HashMap<NodeId, Vec<f32>>>,
}

impl TileSource for Kept<'_> {
    fn read_elevation(&self, node: NodeId, out: &mut [f32], scratch: &mut TileScratch) -> Result<(), TileError> {
        let mut tiles = self.tiles.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(kept) = tiles.get(&node) {
            out.copy_from_slice(kept);
            return Ok(());
        }
        self.store.read_elevation(node, out, scratch)?;
        if tiles.len() < KEPT_TILES {
            tiles.insert(node, out.to_vec());
        }
        Ok(())
    }

    fn read_color(&self, node: NodeId, out: &mut [u8], scratch: &mut TileScratch) -> Result<(), TileError> {
        self.store.read_color(node, out, scratch)
    }
}
