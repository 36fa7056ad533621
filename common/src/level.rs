//! How fine to sample at a point: the level functions (design §4).

use serde::{Deserialize, Serialize};

/// How the screen resolution r(x, y), pixels per metre of a horizontal step, is measured from the two steps across
/// and along the line of sight.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Measure {
    /// The smaller: fewest facets, blurred where the ground is seen at a glancing angle.
    Min,
    /// Their geometric mean: facets and texels of constant *area* on screen.
    #[default]
    Area,
    /// The larger: the best picture, several times the facets at glancing angles.
    Max,
}
