#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use super::*;
use proptest::prelude::*;

const SIZE: [usize; 2] = [40, 30];

fn corner([x, y]: [f32; 2], nearness: f32) -> Corner {
    Corner { place: [x, y], nearness, light: [1.0; 3], uv: [0.0; 2] }
}

fn paint(is_double_sided: bool) -> Paint<'static> {
    Paint { rgb: [1.0, 0.5, 0.0], texture: None, is_double_sided }
}

/// How often each pixel is drawn by triangles, each nearer than the one before.
fn drawn(triangles: &[[[f32; 2]; 3]], paint: &Paint<'_>) -> Vec<u32> {
    let mut counts = vec![0; SIZE[0] * SIZE[1]];
    for triangle in triangles {
        let (mut rgba, mut nearness) = (vec![0; 4 * counts.len()], vec![0.0; counts.len()]);
        let mut canvas = Canvas { rgba: &mut rgba, nearness: &mut nearness, stride: SIZE[0], at: [0; 2], size: SIZE };
        canvas.triangle(&triangle.map(|place| corner(place, 0.5)), paint);
        counts.iter_mut().zip(&nearness).for_each(|(count, near)| *count += u32::from(*near > 0.0));
    }
    counts
}

#[test]
fn fronts_are_drawn_and_backs_are_not() {
    let front = [[5.0, 25.0], [35.0, 25.0], [20.0, 5.0]];
    let back = [front[0], front[2], front[1]];
    let count = |triangle, sides| drawn(&[triangle], &paint(sides)).iter().sum::<u32>();
    let expected = 30 * 20 / 2;
    assert!((count(front, false) as i32 - expected).abs() < 12);
    assert_eq!(count(back, false), 0);
    assert_eq!(count(back, true), count(front, true));
}

#[test]
fn the_nearer_wins_and_a_view_stays_in_its_part() {
    let (mut rgba, mut nearness) = (vec![0; 4 * 1200], vec![0.25; 1200]);
    let mut canvas = Canvas { rgba: &mut rgba, nearness: &mut nearness, stride: 40, at: [10, 10], size: [10, 10] };
    let whole = [[-50.0, 90.0], [90.0, 90.0], [20.0, -90.0]];
    canvas.triangle(&whole.map(|place| corner(place, 0.2)), &paint(false));
    assert!(canvas.nearness.iter().all(|near| *near == 0.25), "it is behind");
    canvas.triangle(&whole.map(|place| corner(place, 0.3)), &paint(false));
    canvas.point([9.0, 9.0], 6.0, 0.9, [0.0, 0.0, 1.0]);
    for (pixel, near) in nearness.iter().enumerate() {
        let (x, y) = (pixel % 40, pixel / 40);
        let is_inside = (10..20).contains(&x) && (10..20).contains(&y);
        let is_point = is_inside && x >= 16 && y >= 16;
        let expected = if is_point {
            0.9
        } else if is_inside {
            0.3
        } else {
            0.25
        };
        assert_eq!(*near, expected, "{x} {y}");
        assert_eq!(rgba[4 * pixel + 3] == 255, is_inside);
    }
    assert_eq!(rgba[4 * (10 * 40 + 10)..][..4], [255, 128, 0, 255]);
}

#[test]
fn depth_is_that_of_the_plane() {
    // A plane that goes away from the eye: 1 / depth is linear on the picture.
    let places = [[0.0, 30.0], [40.0, 30.0], [20.0, 0.0]];
    let (mut rgba, mut nearness) = (vec![0; 4 * 1200], vec![0.0; 1200]);
    let mut canvas = Canvas { rgba: &mut rgba, nearness: &mut nearness, stride: 40, at: [0; 2], size: SIZE };
    let of = |[x, y]: [f32; 2]| 0.01 + 0.001 * x + 0.02 * y;
    canvas.triangle(&places.map(|place| corner(place, of(place))), &paint(false));
    let mut count = 0;
    for (pixel, near) in nearness.iter().enumerate().filter(|(_, near)| **near > 0.0) {
        let middle = [(pixel % 40) as f32 + 0.5, (pixel / 40) as f32 + 0.5];
        assert!((near - of(middle)).abs() < 1e-5, "{middle:?}: {near}");
        count += 1;
    }
    assert!(count > 500);
}

proptest! {
    #[test]
    fn triangles_about_a_point_cover_each_pixel_once(
        middle in [10.0f32..30.0, 8.0f32..22.0], rim in prop::collection::vec(0.0f32..9.0, 5)
    ) {
        // A fan around a point, all of it counter-clockwise.
        let around = |index: usize| {
            let angle = (index % 5) as f32 * std::f32::consts::TAU / 5.0;
            let radius = 12.0 + rim[index % 5];
            [middle[0] + radius * angle.cos(), middle[1] - radius * angle.sin()]
        };
        let fan: Vec<_> = (0..5).map(|index| [middle, around(index), around(index + 1)]).collect();
        let counts = drawn(&fan, &paint(false));
        prop_assert!(counts.iter().all(|count| *count <= 1));
        for (pixel, count) in counts.iter().enumerate() {
            let [x, y] = [(pixel % 40) as f32 + 0.5 - middle[0], (pixel / 40) as f32 + 0.5 - middle[1]];
            // A circle within the fan.
            prop_assert!(*count == 1 || x.hypot(y) > 9.0, "{x} {y}");
        }
    }

    #[test]
    fn any_corners_are_drawn_or_passed_over(numbers in prop::collection::vec(any::<f32>(), 9)) {
        let corners = [0, 3, 6].map(|i| corner([numbers[i], numbers[i + 1]], numbers[i + 2]));
        let (mut rgba, mut nearness) = (vec![0; 4 * 1200], vec![0.0; 1200]);
        let mut canvas = Canvas { rgba: &mut rgba, nearness: &mut nearness, stride: 40, at: [0; 2], size: SIZE };
        canvas.triangle(&corners, &paint(true));
        canvas.point([numbers[0], numbers[1]], numbers[2], numbers[3], [0.0; 3]);
    }
}
