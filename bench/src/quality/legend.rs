//! The scale of a map of displacement, drawn into its lower left corner.

use super::map::{BRIGHTEST_PX, color};

/// Pixels of a pixel of the letters.
const ZOOM: usize = 2;
const LETTER: [usize; 2] = [3, 5];
const BAR: [usize; 2] = [160, 10];
const MARGIN: usize = 6;
const PAPER: [u8; 3] = [20, 20, 20];
const INK: [u8; 3] = [230, 230, 230];

/// Rows of a letter from the top, three bits each.
fn letter(of: char) -> [u8; 5] {
    match of {
        '0' => [0b111, 0b101, 0b101, 0b101, 0b111],
        '1' => [0b010, 0b110, 0b010, 0b010, 0b111],
        '2' => [0b111, 0b001, 0b111, 0b100, 0b111],
        '3' => [0b111, 0b001, 0b111, 0b001, 0b111],
        '4' => [0b101, 0b101, 0b111, 0b001, 0b001],
        '+' => [0b000, 0b010, 0b111, 0b010, 0b000],
        'p' => [0b110, 0b101, 0b110, 0b100, 0b100],
        'x' => [0b000, 0b101, 0b010, 0b101, 0b000],
        _ => [0; 5],
    }
}

/// Draws it into a map of `width` columns: colors from none to the brightest displacement, and how
/// many pixels they are. Maps without room for it stay as they are.
pub(super) fn draw(map: &mut [[u8; 3]], width: usize) {
    let height = map.len() / width.max(1);
    let step = (LETTER[0] + 1) * ZOOM;
    let size = [BAR[0] + 5 * step + 2 * MARGIN, BAR[1] + LETTER[1] * ZOOM + 3 * MARGIN];
    if size[0] > width || size[1] > height {
        return;
    }
    let top = height - size[1];
    let mut put = |x: usize, y: usize, rgb: [u8; 3]| map[(top + y) * width + x] = rgb;
    for y in 0..size[1] {
        (0..size[0]).for_each(|x| put(x, y, PAPER));
    }
    for x in 0..BAR[0] {
        let rgb = color(BRIGHTEST_PX * x as f64 / (BAR[0] - 1) as f64);
        (0..BAR[1]).for_each(|y| put(MARGIN + x, MARGIN + y, rgb));
    }
    let whole = BRIGHTEST_PX as usize;
    let labels = (0..=whole)
        .map(|px| (px * (BAR[0] - 1) / whole, if px < whole { px.to_string() } else { format!("{px}+ px") }));
    for (at, text) in labels {
        for (n, of) in text.chars().enumerate() {
            for (row, bits) in letter(of).into_iter().enumerate() {
                for column in (0..LETTER[0]).filter(|column| bits >> (LETTER[0] - 1 - column) & 1 == 1) {
                    for k in 0..ZOOM * ZOOM {
                        let x = MARGIN + at + n * step + column * ZOOM + k % ZOOM;
                        put(x, 2 * MARGIN + BAR[1] + row * ZOOM + k / ZOOM, INK);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scale_has_all_colors_and_small_maps_stay_as_they_are() {
        let mut map = vec![[0, 0, 255]; 320 * 180];
        draw(&mut map, 320);
        for px in [0.0, 1.0, 2.0, 4.0] {
            let near = |rgb: &[u8; 3]| rgb.iter().zip(color(px)).all(|(a, b)| a.abs_diff(b) < 12);
            assert!(map.iter().any(near), "{px} px");
        }
        assert!(map.contains(&INK) && map[..320 * 100].iter().all(|rgb| *rgb == [0, 0, 255]));
        let mut small = vec![[1; 3]; 100 * 30];
        draw(&mut small, 100);
        assert!(small.iter().all(|rgb| *rgb == [1; 3]));
    }
}
