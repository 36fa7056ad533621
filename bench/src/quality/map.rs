//! A map of the displacement of a picture, to look at.

use super::displacement::Displacement;

/// Displacement of the brightest colour, pixels.
pub(super) const BRIGHTEST_PX: f64 = 4.0;
const SKY: [u8; 3] = [40, 60, 90];
/// Sky in place of land.
const SUNKEN: [u8; 3] = [255, 0, 255];
/// Ground in place of sky, and what cannot be compared.
const BESIDE: [u8; 3] = [90, 90, 90];
/// From none to [`BRIGHTEST_PX`] and more: black, red, yellow, white.
const SCALE: [[f64; 3]; 4] = [[0.0; 3], [200.0, 30.0, 20.0], [255.0, 210.0, 40.0], [255.0; 3]];

/// Draws it, rows from the top.
pub(super) fn draw(displacements: &[Option<Displacement>], is_sky: &[bool], is_land: &[bool]) -> Vec<[u8; 3]> {
    let of_pixel = |((displacement, is_sky), is_land): ((&Option<Displacement>, &bool), &bool)| match displacement {
        Some(displacement) => color(displacement.px),
        None if *is_sky && *is_land => SUNKEN,
        None if *is_sky => SKY,
        None => BESIDE,
    };
    displacements.iter().zip(is_sky).zip(is_land).map(of_pixel).collect()
}

/// Of a displacement, pixels.
pub(super) fn color(px: f64) -> [u8; 3] {
    let steps = (SCALE.len() - 1) as f64;
    let at = (px / BRIGHTEST_PX).clamp(0.0, 1.0) * steps;
    let below = (at as usize).min(SCALE.len() - 2);
    let share = at - below as f64;
    std::array::from_fn(|c| (SCALE[below][c] + (SCALE[below + 1][c] - SCALE[below][c]) * share) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_map_is_brighter_where_ground_is_farther_off_and_shows_lost_land() {
        let off = |px| Some(Displacement { m: 1.0, px });
        let map = draw(
            &[off(0.0), off(1.0), off(9.0), None, None, None],
            &[false, false, false, true, true, false],
            &[true, true, true, true, false, false],
        );
        assert_eq!(map[0], [0; 3]);
        assert!(map[1][0] > 100 && map[1][2] < 30, "{:?}", map[1]);
        assert_eq!(map[2..], [[255; 3], SUNKEN, SKY, BESIDE]);
    }
}
