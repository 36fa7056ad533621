//! Hands over level ground at height 0, without a display.

use super::view::project;
use super::*;

const SIZE: Size = [800.0, 600.0];
const START: ViewerPose =
    ViewerPose { x: 5000.0, y: 5000.0, z: 1000.0, heading: 0.0, pitch: -45.0, roll: 0.0, vfov: 60.0 };

/// Hands, and a ground that answers at once.
struct Person {
    hands: Hands,
    now_s: f64,
    ground_m: f64,
}

impl Person {
    fn new() -> Self {
        let world = World { side_m: 10_000.0, middle_m: 0.0, start: START };
        let mut person = Self { hands: Hands::new(world, START, SIZE), now_s: 10.0, ground_m: 0.0 };
        person.answer();
        person
    }

    fn does(&mut self, inputs: &[Input]) -> &mut Self {
        for input in inputs {
            self.now_s += 0.01;
            self.hands.input(self.now_s, *input);
            self.answer();
        }
        self
    }

    fn answer(&mut self) {
        for question in self.hands.take_questions() {
            let answer = match question {
                Question::Below(_) => Answer::Below(Some(self.ground_m)),
                Question::Place { id, pose, size, at } => {
                    let ray = ray_through(&pose, size, at);
                    let place = (ray.z < 0.0).then(|| eye_of(&pose) + ray * ((self.ground_m - pose.z) / ray.z));
                    Answer::Place { id, place }
                }
            };
            self.hands.answer(self.now_s, answer);
        }
    }

    fn waits(&mut self, seconds: f64) -> &mut Self {
        let until = self.now_s + seconds;
        while self.now_s < until {
            self.now_s += 0.01;
            self.hands.tick(self.now_s);
            self.answer();
        }
        self
    }

    fn pose(&self) -> ViewerPose {
        *self.hands.pose()
    }

    fn place(&self, at: Point) -> DVec3 {
        let ray = ray_through(&self.pose(), SIZE, at);
        eye_of(&self.pose()) + ray * ((self.ground_m - self.pose().z) / ray.z)
    }
}

fn is_near(pose: &ViewerPose, place: DVec3, at: Point) -> bool {
    project(pose, SIZE, place).is_some_and(|[u, v]| (u - at[0]).hypot(v - at[1]) < 1e-3)
}

#[test]
fn a_left_drag_holds_the_ground_and_a_right_drag_turns_about_it() {
    let mut person = Person::new();
    let (from, to) = ([300.0, 400.0], [420.0, 350.0]);
    let place = person.place(from);
    person.does(&[Input::Point(from), Input::Press(Grip::Ground), Input::Point(to)]);
    assert!(is_near(&person.pose(), place, to) && person.pose().z == START.z);
    person.does(&[Input::Release, Input::Point([0.0, 0.0])]);
    let rested = person.pose();
    let place = person.place(from);
    let away = |pose: &ViewerPose| (eye_of(pose) - place).length();
    person.does(&[Input::Point(from), Input::Press(Grip::Turn), Input::Point([310.0, 420.0]), Input::Release]);
    let turned = person.pose();
    assert!(
        (turn(rested.heading, turned.heading) - 3.0).abs() < 1e-9 && (turned.pitch - rested.pitch + 6.0).abs() < 1e-9
    );
    assert!((away(&turned) - away(&rested)).abs() < 1e-6);
}

use super::view::turn;

#[test]
fn a_drag_that_is_not_answered_yet_makes_up_for_its_way() {
    let mut person = Person::new();
    let (from, to) = ([300.0, 400.0], [350.0, 450.0]);
    let place = person.place(from);
    for input in [Input::Point(from), Input::Press(Grip::Ground), Input::Point([340.0, 440.0])] {
        person.hands.input(person.now_s, input);
    }
    assert_eq!(person.pose(), START);
    person.answer();
    person.does(&[Input::Point(to)]);
    assert!(is_near(&person.pose(), place, to));
}

#[test]
fn the_wheel_zooms_to_the_cursor_and_a_double_click_flies_there() {
    let mut person = Person::new();
    let at = [200.0, 500.0];
    let place = person.place(at);
    let away = |pose: &ViewerPose| (eye_of(pose) - place).length();
    person.does(&[Input::Point(at), Input::Wheel(-100.0), Input::Wheel(-100.0)]).waits(1.0);
    let zoomed = person.pose();
    assert!(is_near(&zoomed, place, at));
    assert!((away(&zoomed) / away(&START) - (-0.4f64).exp()).abs() < 1e-6);
    person.does(&[Input::Wheel(200.0)]).waits(1.0);
    assert!((away(&person.pose()) - away(&START)).abs() < 1e-3);
    // Two clicks, the second nearly where the first was.
    let click = [Input::Press(Grip::Ground), Input::Release];
    person.does(&click).does(&[Input::Point([202.0, 501.0])]).does(&click);
    assert!(person.hands.is_moving());
    person.waits(3.0);
    assert!((away(&person.pose()) / away(&START) - 0.35).abs() < 0.01 && !person.hands.is_moving());
    // Two that are far apart are not one.
    person.does(&click).does(&[Input::Point([300.0, 501.0])]).does(&click);
    assert!(!person.hands.is_moving());
}

#[test]
fn keys_fly_turn_and_zoom_while_they_are_held() {
    for (key, is_shifted, moved) in [
        (HeldKey::Up, false, [0.0, 1.0, 0.0, 0.0, 0.0]),
        (HeldKey::Left, false, [-1.0, 0.0, 0.0, 0.0, 0.0]),
        (HeldKey::Forward, false, [0.0, 1.0, -1.0, 0.0, 0.0]),
        (HeldKey::RightWing, false, [1.0, 0.0, 0.0, 0.0, 0.0]),
        (HeldKey::Rise, false, [0.0, 0.0, 1.0, 0.0, 0.0]),
        (HeldKey::Sink, true, [0.0, 0.0, -1.0, 0.0, 0.0]),
        (HeldKey::Right, true, [-1.0, 1.0, 0.0, 1.0, 0.0]),
        // Who looks further up at a place stands lower, and farther back.
        (HeldKey::Up, true, [0.0, -1.0, -1.0, 0.0, 1.0]),
        (HeldKey::ZoomIn, false, [0.0, 1.0, -1.0, 0.0, 0.0]),
        (HeldKey::ZoomOut, false, [0.0, -1.0, 1.0, 0.0, 0.0]),
    ] {
        let mut person = Person::new();
        person.does(&[Input::Shift(is_shifted), Input::Hold(key)]).waits(0.5).does(&[Input::LetGo(key)]);
        let now = person.pose();
        let found =
            [now.x - START.x, now.y - START.y, now.z - START.z, turn(START.heading, now.heading), now.pitch + 45.0];
        let signs = found.map(|v| if v.abs() < 1e-6 { 0.0 } else { v.signum() });
        assert_eq!(signs, moved, "{key:?} {is_shifted}: {found:?}");
        assert!(!person.hands.is_moving());
    }
    // Half a second at 700 m a second, more slowly as the ground comes nearer, and four times as far with Shift.
    let way = |inputs: &[Input]| {
        let mut person = Person::new();
        person.does(inputs).waits(0.5);
        eye_of(&person.pose()).distance(eye_of(&START))
    };
    let (slow, fast) =
        (way(&[Input::Hold(HeldKey::LeftWing)]), way(&[Input::Shift(true), Input::Hold(HeldKey::LeftWing)]));
    assert!((slow - 350.0).abs() < 20.0 && (fast / slow - 4.0).abs() < 0.1, "{slow} {fast}");
}

#[test]
fn the_ground_is_never_entered() {
    let mut person = Person::new();
    person.does(&[Input::Shift(true), Input::Hold(HeldKey::Sink)]).waits(10.0);
    assert!((person.pose().z - navigate::LEAST_CLEARANCE_M).abs() < 1e-9);
    // Ground that rises under the camera lifts it.
    person.does(&[Input::LetGo(HeldKey::Sink), Input::Shift(false)]);
    person.ground_m = 500.0;
    person.does(&[Input::Hold(HeldKey::Up)]).waits(0.2);
    assert!((person.pose().z - 500.0 - navigate::LEAST_CLEARANCE_M).abs() < 1e-9);
}

#[test]
fn single_keys_turn_north_come_back_and_stop() {
    let mut person = Person::new();
    person.does(&[Input::Shift(true), Input::Hold(HeldKey::Right)]).waits(1.0);
    person.does(&[Input::LetGo(HeldKey::Right), Input::Shift(false)]);
    assert!((person.pose().heading - 50.0).abs() < 1.0);
    person.does(&[Input::NorthUp]).waits(0.5);
    assert!(turn(0.0, person.pose().heading).abs() < 1e-9);
    person.does(&[Input::Hold(HeldKey::Up)]).waits(1.0).does(&[Input::LetGo(HeldKey::Up), Input::Reset]).waits(3.0);
    let back = person.pose();
    assert!(eye_of(&back).distance(eye_of(&START)) < 1e-6 && back.pitch == START.pitch);
    person.does(&[Input::Hold(HeldKey::Up)]).waits(1.0).does(&[Input::Blur]);
    assert!(!person.hands.is_moving());
    person.does(&[Input::Reset, Input::Stop]);
    assert!(!person.hands.is_moving());
}

#[test]
fn sky_is_dragged_about_the_camera_itself() {
    let mut person = Person::new();
    let level = ViewerPose { pitch: 0.0, ..START };
    person.hands = Hands::new(person.hands.world, level, SIZE);
    person.answer();
    person.does(&[
        Input::Point([400.0, 100.0]),
        Input::Press(Grip::Ground),
        Input::Point([300.0, 100.0]),
        Input::Release,
    ]);
    let now = person.pose();
    assert!(now.heading > 5.0 && now.pitch == 0.0 && (now.x, now.y, now.z) == (level.x, level.y, level.z));
}

/// A second of a path that goes up, and turns through north.
fn path() -> Vec<ViewerPose> {
    (0..=10).map(f64::from).map(|i| ViewerPose { z: 2000.0 + 10.0 * i, heading: 355.0 + i, ..START }).collect()
}

#[test]
fn a_path_is_played_until_hands_take_the_camera_and_goes_on_where_it_was() {
    let mut person = Person::new();
    person.hands = Hands::new(person.hands.world, START, SIZE).with_path(path(), 10.0);
    person.does(&[Input::Play]).waits(0.6);
    let played = person.pose();
    assert!((played.z - 2060.0).abs() < 2.0 && turn(1.0, played.heading).abs() < 0.2, "{played:?}");
    assert!((0.0..360.0).contains(&played.heading));
    assert!(person.hands.playing_s().is_some_and(|[passed, length]| (passed - 0.6).abs() < 0.02 && length == 1.0));
    // Each of these pauses it.
    for input in [Input::Hold(HeldKey::Up), Input::Press(Grip::Ground), Input::Wheel(10.0), Input::NorthUp, Input::Stop]
    {
        person.does(&[input]);
        assert!(person.hands.playing_s().is_none(), "{input:?}");
        person.does(&[Input::Play]);
        assert!(person.hands.playing_s().is_some());
    }
    // Keys and drags of before do not move it, nor do answers that come late.
    person.waits(0.05);
    assert_eq!((person.pose().x, person.pose().y), (START.x, START.y));
    person.hands.input(person.now_s, Input::NorthUp);
    person.hands.input(person.now_s, Input::Play);
    person.answer();
    person.waits(2.0);
    let end = person.pose();
    assert_eq!((end.z, end.heading, person.hands.is_moving()), (2100.0, 5.0, false));
    // From its end it is played again.
    person.does(&[Input::Play]).waits(0.1);
    assert!((person.pose().z - 2010.0).abs() < 2.0);
    person.does(&[Input::Play]);
    assert!(!person.hands.is_moving());
}

#[test]
fn a_path_is_played_as_it_is_over_ground_that_rises() {
    let mut person = Person::new();
    person.hands = Hands::new(person.hands.world, START, SIZE).with_path(path(), 10.0);
    person.ground_m = 2500.0;
    person.does(&[Input::Play]).waits(0.5);
    assert!((person.pose().z - 2050.0).abs() < 2.0);
}

#[test]
fn without_a_path_there_is_nothing_to_play() {
    let mut person = Person::new();
    person.does(&[Input::Play]).waits(0.1);
    assert_eq!((person.pose(), person.hands.is_moving()), (START, false));
}
