//! How a vehicle stands on the ground: its up axis is the ground's normal, low-passed over the
//! square between its wheels.
//!
//! The mean slope over a square is the difference of the mean heights of two opposite edges,
//! divided by its side: heights along four lines give what normals all over the square would.

use crate::ground::WorldGround;
use glam::{DVec2, DVec3};

/// Heights along an edge.
const ALONG_EDGE: usize = 9;

/// The direction up of what stands at a place in the CRS and heads `ahead`, on a square of this
/// side, length 1. Straight up where there is no ground around.
pub(super) fn up(ground: &WorldGround<'_>, at: [f64; 2], ahead: DVec3, side_m: f64) -> DVec3 {
    let along = ahead.truncate().try_normalize().unwrap_or(DVec2::Y);
    let across = along.perp();
    let half = 0.5 * side_m;
    let middle = DVec2::from_array(at);
    let slope = |to: DVec2, beside: DVec2| {
        let [front, back] = [half, -half].map(|by| mean_height(ground, middle + to * by, beside * half));
        Some((front? - back?) / side_m)
    };
    let (Some(ahead), Some(left)) = (slope(along, across), slope(across, along)) else { return DVec3::Z };
    let gradient = along * ahead + across * left;
    DVec3::new(-gradient.x, -gradient.y, 1.0).normalize()
}

/// The mean height of an edge, by the trapezoid rule.
fn mean_height(ground: &WorldGround<'_>, middle: DVec2, half: DVec2) -> Option<f64> {
    let last = ALONG_EDGE - 1;
    let mut sum = 0.0;
    for k in 0..=last {
        let place = middle + half * (2.0 * k as f64 / last as f64 - 1.0);
        let weight = if k == 0 || k == last { 0.5 } else { 1.0 };
        sum += weight * ground.at(place.x, place.y)?.height_m;
    }
    Some(sum / last as f64)
}
