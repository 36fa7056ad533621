use super::super::recording::{At, Recorded, Stamp};
use super::super::tests::Plain;
use super::*;
use proptest::prelude::*;

fn fly(segments: Vec<Segment>, options: CourseOptions) -> (Course, Remarks) {
    let mut remarks = Remarks::default();
    let path = course(Path::new("p"), segments, &Plain, options, &mut remarks).unwrap();
    (path.course, remarks)
}

fn segment(points: &[(f64, f64)], height_m: Option<f64>) -> Segment {
    let point =
        |(t, x): &(f64, f64)| Recorded { stamp: Stamp::At(*t), place: DVec2::new(*x, 0.0), height_m, at: At::Line(1) };
    Segment { points: points.iter().map(point).collect() }
}

#[test]
fn a_way_that_flew_keeps_its_heights_and_one_on_the_ground_does_not() {
    let line = [(0.0, 0.0), (60.0, 900.0)];
    let z = |height: Option<f64>, agl_m: Option<f64>| {
        let options = CourseOptions { agl_m, ..CourseOptions::default() };
        let (course, remarks) = fly(vec![segment(&line, height)], options);
        (course.pose(30, 1.0, 1.0).unwrap().position.z, remarks.notes.len())
    };
    // The plain lies at 100 m.
    assert_eq!(z(Some(900.0), None), (900.0, 1));
    assert_eq!(z(Some(900.0), Some(50.0)), (150.0, 0));
    assert_eq!(z(Some(101.0), None), (250.0, 0));
    assert_eq!(z(None, None), (250.0, 0));
}

#[test]
fn two_devices_at_the_same_time_are_flown_one_after_the_other() {
    let way: Vec<(f64, f64)> = (0..60).map(|i| (f64::from(i), 5.0 * f64::from(i))).collect();
    let other: Vec<(f64, f64)> = way.iter().map(|(t, x)| (t + 0.5, x + 9000.0)).collect();
    let (course, remarks) = fly(vec![segment(&other, None), segment(&way, None)], CourseOptions::default());
    assert_eq!(course.frame_count(1.0, 1.0).unwrap(), Some(119));
    assert!(course.pose(30, 1.0, 1.0).unwrap().position.x < 1000.0);
    assert!(remarks.notes[0].starts_with("1 gap in the recording became"), "{remarks:?}");
}

#[test]
fn the_place_ahead_is_the_first_that_is_away_far_enough() {
    let places: Vec<DVec2> = (0..500).map(|i| DVec2::new(f64::from(i * 37 % 101), f64::from(i) * 0.4)).collect();
    let ahead = Ahead::new(&places, 3);
    for i in 0..places.len() {
        for metres in [0.0, 5.0, 60.0, 150.0, 1e4] {
            let plain = (i + 3..places.len()).find(|&j| places[j].distance(places[i]) >= metres);
            assert_eq!(ahead.first_away(places[i], i + 3, metres), plain, "{i} {metres}");
        }
    }
}

#[test]
fn a_camera_that_gets_nowhere_looks_at_few_boxes() {
    // All places but those of the camera lie on a circle that is a little too near: the worst for
    // boxes. The bound on boxes is a bound on the work, so that this ends.
    let circle = (0..100_000).map(|i| DVec2::from_angle(f64::from(i)) * 449.0);
    let places: Vec<DVec2> = std::iter::repeat_n(DVec2::ZERO, 100_000).chain(circle).collect();
    let ahead = Ahead::new(&places, 16);
    assert!((0..places.len()).step_by(7).all(|i| ahead.look(i, 450.0).0.is_finite()));
}

#[test]
fn many_short_pieces_are_flown() {
    let segments: Vec<Segment> = (0..2000)
        .map(|i| {
            let t = 1000.0 * f64::from(i);
            segment(&[(t, t), (t + 2.0, t + 9.0)], None)
        })
        .collect();
    let (course, remarks) = fly(segments, CourseOptions::default());
    assert_eq!(course.frame_count(1.0, 1.0).unwrap(), Some(4001));
    assert!(remarks.notes[0].starts_with("1999 gaps"), "{remarks:?}");
}

proptest! {
    #[test]
    fn smoothing_keeps_straight_lines(n in 1usize..50, radius in 0usize..20) {
        let line: Vec<f64> = (0..n).map(|i| i as f64 * 2.0 + 1e6).collect();
        for (a, b) in smooth(&line, radius).iter().zip(&line) {
            prop_assert!((a - b).abs() < 1e-6);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn any_recording_is_a_flight_of_bounded_size(
        parts in proptest::collection::vec(proptest::collection::vec((-1e10f64..1e10, -1e7f64..1e7, any::<bool>()), 0..20), 0..6),
        keeps_rests: bool,
    ) {
        let segments: Vec<Segment> = parts.iter().map(|part| Segment {
            points: part.iter().map(|(t, x, has_time)| Recorded {
                stamp: if *has_time { Stamp::At(*t) } else { Stamp::Missing },
                place: DVec2::new(*x, 0.0), height_m: None, at: At::Line(1),
            }).collect(),
        }).collect();
        let mut remarks = Remarks::default();
        let options = CourseOptions { keeps_rests, ..CourseOptions::default() };
        if let Ok(path) = course(Path::new("p"), segments, &Plain, options, &mut remarks)
            && let Ok(Some(count)) = path.course.frame_count(1e-4, 1.0)
        {
            for frame in [0, count / 2, count - 1] {
                prop_assert!(path.course.pose(frame, 1e-4, 1.0).is_none_or(|pose| pose.position.is_finite()));
            }
        }
    }
}
