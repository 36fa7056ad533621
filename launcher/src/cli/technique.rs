//! How the ground is drawn, how its size on screen is measured, and how its colours are kept for
//! that, as typed.

use clap::ValueEnum;
use terravision_common::level::Measure;
use terravision_common::run::{MadeUp, RaysChoice, TechniqueChoice};

/// [`TechniqueChoice`] as typed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum TechniqueArg {
    /// Triangles, by a Vulkan device
    Mesh,
    /// Rays, on the processor alone unless --rays says otherwise
    Rays,
}

impl From<TechniqueArg> for TechniqueChoice {
    fn from(technique: TechniqueArg) -> Self {
        match technique {
            TechniqueArg::Mesh => Self::Mesh,
            TechniqueArg::Rays => Self::Rays,
        }
    }
}

/// [`RaysChoice`] as typed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum RaysArg {
    /// Samples along columns of pixels, where each ray begins near the hit of the one below: voxels
    /// nearby, heights beyond
    Coherent,
    /// One exact ray per pixel through maxima of the heights
    Mipmap,
    /// All rays of a vertical plane at once, by samples of the heights from the eye outwards: the
    /// cheapest on a processor, above all with fine facets
    Sweep,
    /// One exact ray per pixel as with 'mipmap', by a Vulkan device
    Compute,
    /// In real time 'compute' on a GPU, else the faster of 'mipmap' and 'coherent'; in exact mode 'mipmap'
    Auto,
}

impl From<RaysArg> for RaysChoice {
    fn from(rays: RaysArg) -> Self {
        match rays {
            RaysArg::Coherent => Self::Coherent,
            RaysArg::Mipmap => Self::Mipmap,
            RaysArg::Sweep => Self::Sweep,
            RaysArg::Compute => Self::Compute,
            RaysArg::Auto => Self::Auto,
        }
    }
}

/// Whether colour tiles are compressed in memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum CompressionArg {
    /// On a GPU that samples compressed textures, unless --quality best is asked for
    Auto,
    /// Wherever the device can
    On,
    /// Never
    Off,
}

/// [`MadeUp`] as typed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum MadeUpArg {
    /// Not a number, as for sky
    Nan,
    /// The values, and a band that says what was measured
    Mark,
}

impl From<MadeUpArg> for MadeUp {
    fn from(choice: MadeUpArg) -> Self {
        match choice {
            MadeUpArg::Nan => Self::Nan,
            MadeUpArg::Mark => Self::Mark,
        }
    }
}

/// [`Measure`] as typed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum MeasureChoice {
    /// The shorter side: fewest facets, blurred at glancing angles
    Min,
    /// The area, as if the ground were level: an even load, but too few facets on slopes that face
    /// the camera
    Area,
    /// The longer side: the best picture for its triangles
    Max,
}

impl From<MeasureChoice> for Measure {
    fn from(choice: MeasureChoice) -> Self {
        match choice {
            MeasureChoice::Min => Self::Min,
            MeasureChoice::Area => Self::Area,
            MeasureChoice::Max => Self::Max,
        }
    }
}
