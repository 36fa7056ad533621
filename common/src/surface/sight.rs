//! The inputs of level functions at a point.

/// Depth and distances of a point from the eye, metres and square metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sight {
    /// Along the view axis.
    pub depth: f64,
    /// Square of the horizontal distance.
    pub horizontal2: f64,
    /// Square of the difference in height.
    pub vertical2: f64,
    /// Square of the distance in space.
    pub distance2: f64,
}
