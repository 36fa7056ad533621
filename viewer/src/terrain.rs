//! The world: heights of its ground, and what there is to know of it.

use glam::DVec2;
use serde_json::{Value, json};
use terravision_common::ground::{GroundScratch, GroundTiles, Interpolation};
use terravision_common::run::DatabaseConfig;
use terravision_common::surface::CrsFrame;
use terravision_common::surface::tile::GroundPoint;
use terravision_common::validity::Validity;
use terravision_store::{Location, Store, StoreOptions};

/// Tiles that one question keeps, bytes: points that are asked together are often neighbours.
const KEPT_BYTES: usize = 16 << 20;

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
        let world = self.store.world();
        let tiles = GroundTiles::new(&self.store, world, KEPT_BYTES).bounded(self.store.ranges());
        let feet: Vec<DVec2> = places.iter().map(|place| world.crs_frame().foot((*place).into())).collect();
        let mut answers = Vec::with_capacity(feet.len());
        tiles.sample_all(&feet, Interpolation::Facet, &mut GroundScratch::default(), &mut answers);
        if let Some((_, error)) = tiles.take_failures() {
            tracing::warn!(%error, "a question for heights met a tile that cannot be read");
        }
        let height = |ground: &GroundPoint| (ground.validity != Validity::Hole).then_some(ground.height_m);
        answers.iter().map(|answer| height(&answer.ok()?.found.ground)).collect()
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
