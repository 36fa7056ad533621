//! Measures of pictures against the reference, and against each other.

mod holes;
mod motion;
mod quality;

pub use holes::{Holes, count_holes};
pub use motion::{Frame, MotionChange, largest_pop, motion_compensated_change};
pub use quality::{Quality, compare, median_absolute_error, try_compare};
