//! Stages, and the segments between them.

use std::fmt;

/// A stage of the pipeline.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u32)]
pub enum Stage {
    /// Searches the quad tree.
    Generator = 0,
    /// Computes elevation arrays and the ring's slots.
    Preparer = 1,
    /// Draws.
    Renderer = 2,
    /// Reads tiles into the pools.
    Prefetcher = 3,
}

impl Stage {
    /// All stages: first those that a frame passes through, in order, then the prefetcher.
    pub const ALL: [Self; 4] = [Self::Generator, Self::Preparer, Self::Renderer, Self::Prefetcher];

    /// Its name in messages and file names.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Generator => "generator",
            Self::Preparer => "preparer",
            Self::Renderer => "renderer",
            Self::Prefetcher => "prefetcher",
        }
    }

    /// Its event ring.
    #[must_use]
    pub const fn events(self) -> SegmentKind {
        match self {
            Self::Generator => SegmentKind::EventsGenerator,
            Self::Preparer => SegmentKind::EventsPreparer,
            Self::Renderer => SegmentKind::EventsRenderer,
            Self::Prefetcher => SegmentKind::EventsPrefetcher,
        }
    }
}

impl fmt::Display for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The segments of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u32)]
pub enum SegmentKind {
    /// Run state, heartbeats, counters, newest camera: [`super::Control`].
    Control = 1,
    /// Truncated quad trees, generator to preparer: [`super::TreeWriter`], [`super::TreeReader`].
    PingPong = 2,
    /// [`crate::slot::Slot`]s, preparer to renderer.
    Ring = 3,
    /// Elevation arrays, preparer to renderer: [`super::ElevationWriter`],
    /// [`super::ElevationReader`].
    ElevationRing = 4,
    /// Colour tiles: [`super::PoolWriter`], [`super::PoolReader`].
    ColorPool = 5,
    /// Elevation tiles: [`super::PoolWriter`], [`super::PoolReader`].
    ElevationPool = 6,
    /// [`super::CameraRecord`]s, launcher to generator.
    CameraRing = 7,
    /// [`crate::event::Event`]s of the generator, to the launcher.
    EventsGenerator = 8,
    /// [`crate::event::Event`]s of the preparer, to the launcher.
    EventsPreparer = 9,
    /// [`crate::event::Event`]s of the renderer, to the launcher.
    EventsRenderer = 10,
    /// The tiles that the newest frame wants and lacks, preparer to prefetcher:
    /// [`super::WantListWriter`], [`super::WantListReader`].
    WantList = 11,
    /// [`crate::outcome::TileOutcome`]s, prefetcher to preparer.
    TileOutcomes = 12,
    /// [`crate::event::Event`]s of the prefetcher, to the launcher.
    EventsPrefetcher = 13,
    /// Future [`super::CameraRecord`]s, launcher to prefetcher; used only by prediction with
    /// `oracle`.
    PathRing = 14,
    /// Frames of a film or of Y4M, renderer to launcher: [`super::StreamWriter`],
    /// [`super::StreamReader`]; without arrays where pictures go elsewhere.
    StreamRing = 15,
    /// Where vehicles are in each frame, launcher to renderer: [`super::VehicleTableWriter`],
    /// [`super::VehicleTableReader`]; without vehicles where a run has none.
    VehicleTable = 16,
}

impl SegmentKind {
    /// All kinds.
    pub const ALL: [Self; 16] = [
        Self::Control,
        Self::PingPong,
        Self::Ring,
        Self::ElevationRing,
        Self::ColorPool,
        Self::ElevationPool,
        Self::CameraRing,
        Self::EventsGenerator,
        Self::EventsPreparer,
        Self::EventsRenderer,
        Self::WantList,
        Self::TileOutcomes,
        Self::EventsPrefetcher,
        Self::PathRing,
        Self::StreamRing,
        Self::VehicleTable,
    ];

    /// The last part of the segment's name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Control => "control",
            Self::PingPong => "ping-pong",
            Self::Ring => "ring",
            Self::ElevationRing => "elevation-ring",
            Self::ColorPool => "color-pool",
            Self::ElevationPool => "elevation-pool",
            Self::CameraRing => "camera-ring",
            Self::EventsGenerator => "events-generator",
            Self::EventsPreparer => "events-preparer",
            Self::EventsRenderer => "events-renderer",
            Self::WantList => "want-list",
            Self::TileOutcomes => "tile-outcomes",
            Self::EventsPrefetcher => "events-prefetcher",
            Self::PathRing => "path-ring",
            Self::StreamRing => "stream-ring",
            Self::VehicleTable => "vehicle-table",
        }
    }

    /// The stage that writes it; `None` for the launcher, or for several.
    #[must_use]
    pub const fn writer(self) -> Option<Stage> {
        match self {
            Self::Control | Self::CameraRing | Self::PathRing | Self::VehicleTable => None,
            Self::PingPong | Self::EventsGenerator => Some(Stage::Generator),
            Self::Ring | Self::ElevationRing | Self::WantList | Self::EventsPreparer => Some(Stage::Preparer),
            Self::ColorPool | Self::ElevationPool | Self::TileOutcomes | Self::EventsPrefetcher => {
                Some(Stage::Prefetcher)
            }
            Self::EventsRenderer | Self::StreamRing => Some(Stage::Renderer),
        }
    }

    /// The stage that reads it; `None` for the launcher, or for several.
    #[must_use]
    pub const fn reader(self) -> Option<Stage> {
        match self {
            Self::Control | Self::ColorPool | Self::StreamRing => None,
            Self::EventsGenerator | Self::EventsPreparer | Self::EventsRenderer | Self::EventsPrefetcher => None,
            Self::CameraRing => Some(Stage::Generator),
            Self::PingPong | Self::ElevationPool | Self::TileOutcomes => Some(Stage::Preparer),
            Self::Ring | Self::ElevationRing | Self::VehicleTable => Some(Stage::Renderer),
            Self::WantList | Self::PathRing => Some(Stage::Prefetcher),
        }
    }
}

impl fmt::Display for SegmentKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
