use super::super::tests::{parse_text, parse_with, utm10};
use super::super::{Pose, Remarks};
use super::*;
use glam::DVec3;
use proptest::prelude::*;

fn document(content: &str) -> String {
    format!(
        r#"<?xml version="1.0" encoding="UTF-8"?>
<kml xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2"><Document>
{content}</Document></kml>"#
    )
}

fn tour(steps: &str) -> String {
    document(&format!("<gx:Tour><name>t</name><gx:Playlist>{steps}</gx:Playlist></gx:Tour>"))
}

fn camera(duration: f64, mode: &str, lon: f64, extra: &str) -> String {
    format!(
        "<gx:FlyTo><gx:duration>{duration}</gx:duration><gx:flyToMode>{mode}</gx:flyToMode><Camera><longitude>{lon}</longitude>\
         <latitude>45</latitude><altitude>3000</altitude>{extra}</Camera></gx:FlyTo>"
    )
}

fn wait(seconds: &str) -> String {
    format!("<gx:Wait><gx:duration>{seconds}</gx:duration></gx:Wait>")
}

const ABSOLUTE: &str = "<tilt>70</tilt><altitudeMode>absolute</altitudeMode>";

fn fly(text: &str) -> (CameraPath, Remarks) {
    let (path, remarks) = parse_with(text, CourseOptions::default());
    (path.unwrap(), remarks)
}

fn frames(text: &str) -> u64 {
    fly(text).0.course.frame_count(1.0, 1.0).unwrap().unwrap()
}

fn first(text: &str) -> Pose {
    fly(text).0.course.pose(0, 30.0, 1.0).unwrap()
}

#[test]
fn a_smooth_tour_is_flown_in_its_time() {
    let text = tour(&[camera(9.0, "smooth", -122.0, ABSOLUTE), camera(4.0, "smooth", -121.9, ABSOLUTE)].concat());
    let course = parse_text(&text).unwrap().course;
    assert_eq!(course.frame_count(10.0, 1.0).unwrap(), Some(41));
    let first = course.pose(0, 10.0, 1.0).unwrap();
    assert!((first.position - DVec3::new(578_815.30, 4_983_436.77, 3000.0)).length() < 0.01);
    assert!((first.pitch_rad.to_degrees() + 20.0).abs() < 1e-9);
    let last = course.pose(40, 10.0, 1.0).unwrap();
    let there = utm10().from_lonlat().unwrap().position(-121.9, 45.0).unwrap();
    assert!((last.position.truncate() - there).length() < 1e-6);
}

#[test]
fn a_bounce_rises_a_wait_waits_and_no_duration_cuts() {
    let steps = [
        camera(0.0, "bounce", -122.0, ABSOLUTE),
        camera(2.0, "bounce", -121.9, ABSOLUTE),
        wait("1"),
        camera(0.0, "smooth", -121.5, ABSOLUTE),
        camera(1.0, "smooth", -121.4, ABSOLUTE),
    ];
    let course = parse_text(&tour(&steps.concat())).unwrap().course;
    assert_eq!(course.frame_count(10.0, 1.0).unwrap(), Some(41));
    assert!(course.pose(10, 10.0, 1.0).unwrap().position.z > 4000.0);
    let (a, b) = (course.pose(22, 10.0, 1.0).unwrap(), course.pose(29, 10.0, 1.0).unwrap());
    assert!((a.position - b.position).length() < 1e-6);
    let jump = course.pose(30, 10.0, 1.0).unwrap().position.x - b.position.x;
    assert!(jump > 25_000.0, "{jump}");
}

#[test]
fn what_comes_before_the_first_view_and_steps_without_one_are_waits() {
    let (one, two) = (camera(5.0, "smooth", -122.0, ABSOLUTE), camera(5.0, "smooth", -121.9, ABSOLUTE));
    let empty = "<gx:FlyTo><gx:duration>2</gx:duration></gx:FlyTo>";
    assert_eq!(frames(&tour(&[&wait("3"), one.as_str()].concat())), 4);
    assert_eq!(frames(&tour(&[empty, &wait("3"), &one].concat())), 6);
    assert_eq!(frames(&tour(&[&one, empty, &two].concat())), 8);
    assert_eq!(frames(&tour(&[&one, "<gx:FlyTo/>", &two].concat())), 6);
    let course = fly(&tour(&[&one, empty, &two].concat())).0.course;
    let xs: Vec<f64> = (0..8).map(|frame| course.pose(frame, 1.0, 1.0).unwrap().position.x).collect();
    assert!((xs[2] - xs[0]).abs() < 1e-6 && xs[3] > xs[2] + 10.0, "{xs:?}");
}

#[test]
fn the_first_tour_with_a_view_is_flown() {
    let steps = |lon| format!("<gx:Tour><gx:Playlist>{}</gx:Playlist></gx:Tour>", camera(1.0, "smooth", lon, ABSOLUTE));
    let text = document(&["<gx:Tour><gx:Playlist/></gx:Tour>\n", &steps(-122.0), &steps(-120.0)].concat());
    let (path, remarks) = fly(&text);
    assert!((path.course.pose(0, 1.0, 1.0).unwrap().position.x - 578_815.30).abs() < 0.01);
    assert_eq!(remarks.notes, ["the file has 2 tours: the first, in line 4, is flown"]);
    // Steps that stand in the tour itself.
    let bare = document(&steps(-122.0).replace("<gx:Playlist>", "").replace("</gx:Playlist>", ""));
    assert_eq!(fly(&bare).0.course, fly(&document(&steps(-122.0))).0.course);
}

#[test]
fn a_look_at_looks_at_its_target_from_its_range() {
    let text = tour(
        "<gx:FlyTo><LookAt><longitude>-122</longitude><latitude>45</latitude><altitude>0</altitude><heading>0</heading>\
         <tilt>60</tilt><range>1000</range><gx:altitudeMode>relativeToGround</gx:altitudeMode></LookAt></gx:FlyTo>",
    );
    let pose = first(&text);
    let target = DVec3::new(578_815.30, 4_983_436.77, 100.0);
    assert!(((pose.position - target).length() - 1000.0).abs() < 0.02);
    let (sh, ch) = pose.heading_rad.sin_cos();
    let (sp, cp) = pose.pitch_rad.sin_cos();
    let seen = pose.position + DVec3::new(sh * cp, ch * cp, sp) * 1000.0;
    assert!((seen - target).length() < 0.02, "{seen}");
}

#[test]
fn heights_follow_the_altitude_mode_and_a_camera_is_never_clamped_to_the_ground() {
    let mode = |mode: &str| format!("<altitudeMode>{mode}</altitudeMode>");
    for (extra, camera_z, target_z) in [
        (mode("absolute"), 3000.0, 3000.0),
        (mode("relativeToGround"), 3100.0, 3100.0),
        (mode("clampToGround"), 3100.0, 100.0),
        ("<gx:altitudeMode>relativeToSeaFloor</gx:altitudeMode>".into(), 3100.0, 3100.0),
        ("<gx:altitudeMode>clampToSeaFloor</gx:altitudeMode>".into(), 3100.0, 100.0),
        (String::new(), 3100.0, 100.0),
        (mode(""), 3100.0, 100.0),
    ] {
        let text = tour(&camera(1.0, "smooth", -122.0, &extra));
        assert!((first(&text).position.z - camera_z).abs() < 1e-9, "Camera {extra}");
        let text = text.replace("Camera", "LookAt");
        assert!((first(&text).position.z - target_z).abs() < 1e-9, "LookAt {extra}");
    }
}

#[test]
fn values_are_wrapped_and_clamped_as_google_earth_does() {
    let angles = |h: &str, t: &str, r: &str| {
        let extra =
            format!("<heading>{h}</heading><tilt>{t}</tilt><roll>{r}</roll><altitudeMode>absolute</altitudeMode>");
        let (path, remarks) = fly(&tour(&camera(1.0, "smooth", -122.0, &extra)));
        let pose = path.course.pose(0, 30.0, 1.0).unwrap();
        let angles = [pose.heading_rad, pose.pitch_rad, pose.roll_rad].map(|v| (v.to_degrees() * 1e6).round() / 1e6);
        (angles, remarks.warnings.len())
    };
    let plain = angles("10", "60", "-160");
    assert_eq!(angles("370", "60", "200"), plain);
    assert_eq!(angles("-350", "60", "-520"), plain);
    assert_eq!(angles("10", "-1e-9", "0"), angles("10", "0", "0"));
    assert_eq!(angles("10", "0", "").1, 0);
    assert_eq!(angles("10", "190", "0"), (angles("10", "180", "0").0, 1));
    let far = |lon: f64| first(&tour(&camera(1.0, "smooth", lon, ABSOLUTE))).position;
    assert!((far(238.0) - far(-122.0)).length() < 1e-6);
    // An unknown word is the default, as is a time that runs backwards.
    let (path, remarks) = fly(&tour(&camera(-1.0, "jump", -122.0, "<altitudeMode>up</altitudeMode>")));
    assert!((path.course.pose(0, 1.0, 1.0).unwrap().position.z - 3100.0).abs() < 1e-9);
    assert!(
        remarks.warnings[0].starts_with("3 values outside of what KML allows (the first in line 3)"),
        "{remarks:?}"
    );
}

#[test]
fn the_first_field_of_view_is_flown() {
    let with = |first: &str, second: &str| {
        let steps = [camera(0.0, "smooth", -122.0, first), camera(1.0, "smooth", -121.9, second)];
        let (path, remarks) = fly(&tour(&steps.concat()));
        let vfov = path.settings.vfov_of(1280, 720).map(|v| (v.to_degrees() * 100.0).round() / 100.0);
        (vfov, remarks.warnings.len())
    };
    assert_eq!(with("<gx:horizFov>20</gx:horizFov>", "<gx:horizFov>20</gx:horizFov>"), (Some(11.33), 0));
    assert_eq!(with("<gx:fovy>35</gx:fovy>", "<gx:fovy>60</gx:fovy>"), (Some(35.0), 1));
    assert_eq!(with("", ""), (None, 0));
    assert_eq!(with("<gx:horizFov>0</gx:horizFov>", ""), (None, 0));
    assert_eq!(with("<gx:fovy>500</gx:fovy>", "<gx:fovy>170</gx:fovy>"), (Some(170.0), 1));
}

#[test]
fn a_tour_of_two_hundred_plain_cameras_is_flown_at_their_heights() {
    // As Google Earth records one: no altitudeMode, a bounce to the first view, then smooth.
    let steps: String = (0..200)
        .map(|i| {
            let (mode, lon) = (if i == 0 { "bounce" } else { "smooth" }, -122.0 + 0.0005 * f64::from(i));
            format!(
                "<gx:FlyTo>\n<gx:duration>0.5</gx:duration><gx:flyToMode>{mode}</gx:flyToMode><Camera>\n<longitude>{lon}</longitude>\
                 <latitude>45</latitude><altitude>{}</altitude><heading>90</heading><tilt>75</tilt><roll>-0.000001</roll></Camera></gx:FlyTo>",
                107.0 + 0.93 * f64::from(i)
            )
        })
        .collect();
    let (path, remarks) = fly(&tour(&steps));
    assert_eq!((path.course.frame_count(30.0, 1.0).unwrap(), remarks), (Some(2986), Remarks::default()));
    let heights: Vec<f64> =
        (0..2986).map(|frame| path.course.pose(frame, 30.0, 1.0).unwrap().position.z - 100.0).collect();
    assert!(heights.iter().all(|height| (106.9..293.0).contains(height)));
    assert!((heights[0] - 107.0).abs() < 1e-6 && (heights[2985] - 292.07).abs() < 1e-6);
}

#[test]
fn views_of_placemarks_are_flown_one_after_the_other() {
    let place = |lon: f64| {
        format!(
            "<Placemark><name>A &amp; B</name><LookAt><longitude>{lon}</longitude><latitude>45</latitude><range>900</range></LookAt>\
             <Point><coordinates>{lon},45,0</coordinates></Point></Placemark>"
        )
    };
    let text = document(&[place(-122.0), place(-121.9), place(-121.8)].concat());
    let (path, remarks) = fly(&text);
    assert_eq!(path.course.frame_count(1.0, 1.0).unwrap(), Some(11));
    assert!(remarks.notes[0].contains("its 3 views are flown"), "{remarks:?}");
    // One view, and the view with which a file opens: a still picture.
    assert_eq!(frames(&document(&place(-122.0))), 1);
    let opening = place(-122.0).replace("Placemark", "Folder").replace("Point", "X");
    assert_eq!(frames(&document(&opening)), 1);
    // A change of a view is not a view.
    let update =
        "<gx:AnimatedUpdate><Update><Change><Placemark><Camera/></Placemark></Change></Update></gx:AnimatedUpdate>";
    assert!(parse_text(&document(update)).is_err());
}

#[test]
fn tracks_and_lines_are_flown_as_ways() {
    let line = |mode: &str, separator: &str| {
        document(&format!(
            "<Placemark><LineString><altitudeMode>{mode}</altitudeMode><coordinates>\n-122,45,900 -121.99{separator}45{separator}900\n\
             </coordinates></LineString></Placemark>"
        ))
    };
    let z = |text: &str| {
        let (path, _) = fly(text);
        assert!((30..34).contains(&path.course.frame_count(1.0, 1.0).unwrap().unwrap()));
        path.course.pose(10, 1.0, 1.0).unwrap().position.z
    };
    assert_eq!(z(&line("clampToGround", ",")), 250.0);
    assert_eq!(z(&line("absolute", ", ")), 900.0);
    assert_eq!(z(&line("relativeToGround", " , ")), 1000.0);
    let agl = CourseOptions { agl_m: Some(70.0), ..CourseOptions::default() };
    let flown = parse_with(&line("absolute", ","), agl).0.unwrap().course;
    assert_eq!(flown.pose(10, 1.0, 1.0).unwrap().position.z, 170.0);
    let track = document(
        "<Placemark><gx:Track><when>2024-05-01T10:00:00Z</when><when>2024-05-01T10:01:00Z</when>\
         <gx:coord>-122 45 0</gx:coord><gx:coord>-121.99 45 0</gx:coord></gx:Track></Placemark>",
    );
    assert_eq!(frames(&track), 61);
}

#[test]
fn what_is_not_flown_is_told() {
    let places = "<Placemark><LookAt><longitude>-122</longitude><latitude>45</latitude></LookAt><Point/></Placemark>\
                  <Placemark><LookAt/><LineString><coordinates>-122,45,0 -121.99,45,0</coordinates></LineString></Placemark>\
                  <NetworkLink/>";
    let (one, two) = (camera(5.0, "smooth", -122.0, ABSOLUTE), camera(5.0, "smooth", -121.9, ABSOLUTE));
    let others = "<gx:SoundCue/><gx:TourControl/><gx:SoundCue/><gx:AnimatedUpdate/>";
    let notes = |text: &str| fly(text).1.notes;
    let text = tour(&[&one, others, &two].concat()).replace("<gx:Tour>", &format!("{places}<gx:Tour>"));
    let expected = [
        "of the tour only the camera's way is flown, without its 2 sounds, 1 pause and 1 animated change",
        "beside the tour the file has 1 line, 1 other view and 1 network link, not flown",
    ];
    assert_eq!(notes(&text), expected);
    assert_eq!(notes(&document(places)), ["beside the line the file has 1 other view and 1 network link, not flown"]);
    let views = places.replace("LineString", "Polygon").replace("<LookAt/>", "");
    assert_eq!(
        notes(&document(&views)),
        ["beside the views the file has 1 other placemark and 1 network link, not flown"]
    );
    let track = "<Placemark><gx:Track><altitudeMode>absolute</altitudeMode><when>2024-05-01T10:00:00Z</when>\
                 <when>2024-05-01T10:00:09Z</when><when>2024-05-01T10:01:00Z</when><gx:coord>-122 45 0</gx:coord>\
                 <gx:coord>-121.99 45 0</gx:coord><gx:angles>90 -5 0</gx:angles></gx:Track></Placemark>";
    let (_, remarks) = fly(&document(track));
    assert!(remarks.notes[0].contains("(gx:angles) are those of a model"), "{remarks:?}");
    assert_eq!(
        remarks.warnings,
        ["line 3: the track has 3 times (when) for 2 places (gx:coord): the last times are left out"]
    );
}

#[test]
fn the_sun_of_google_earth_is_told_with_the_flag_that_gives_it() {
    let view = |option: &str, stamp: &str| {
        let options =
            format!("{stamp}<gx:ViewerOptions><gx:option name=\"historicalimagery\"/>{option}</gx:ViewerOptions>");
        fly(&tour(&camera(1.0, "smooth", -122.0, &options))).1.notes
    };
    let stamp = "<gx:TimeStamp><when>2011-07-14T13:00:00Z</when></gx:TimeStamp>";
    let told = view("<gx:option name=\"sunlight\"></gx:option>", stamp);
    assert_eq!(
        told,
        ["Google Earth shows its first view by the sun of 2011-07-14T13:00:00Z; here --sun 2011-07-14T13:00:00Z does"]
    );
    assert!(view("<gx:option enabled=\"1\" name=\"sunlight\"/>", "")[0].ends_with("here --sun DATE-TIME does"));
    assert_eq!(view("<gx:option enabled=\"0\" name=\"sunlight\"></gx:option>", stamp), [""; 0]);
    assert_eq!(view("", stamp), [""; 0]);
}

#[test]
fn coordinates_are_read_as_programs_write_them() {
    let points = |coordinates: &str| {
        let text = format!(
            "<LineString><altitudeMode>absolute</altitudeMode><coordinates>{coordinates}</coordinates></LineString>"
        );
        parse_with(&document(&text), CourseOptions::default()).0.map(|path| path.course)
    };
    let line = points("-122,45,900 -121.99,45,900").unwrap();
    for same in [
        "\n\t-122,45,900\n\t-121.99,45,900\n",
        "-122,45,900, -121.99,45,900,",
        "-122 , 45 , 900 -121.99, 45, 900",
        "-122,45,900 , -121.99,45,900",
        "-122,45,900\n,-121.99,45,900",
    ] {
        assert!(points(same).unwrap() == line, "{same}");
    }
    // Without heights it is flown above ground.
    let flat = points("-122,45 -121.99,45").unwrap();
    assert!(points("-122,45,NaN -121.99,45,nan").unwrap() == flat);
    for wrong in ["-122,45,900,-121.99,45,900", "-122,45,x -121.99,45,x", "-122,45,1e300", "-122 45 900", "-122,45,1,2"]
    {
        let message = points(wrong).unwrap_err().to_string();
        assert!(message.contains("line 3: coordinates: expected longitude,latitude,height, and a blank"), "{message}");
    }
}

#[test]
fn an_altitude_mode_is_that_of_the_way_or_of_the_tracks_around_it() {
    let height = |text: &str| {
        let (path, remarks) = fly(&document(text));
        (path.course.pose(0, 1.0, 1.0).unwrap().position.z, remarks.warnings)
    };
    let track = |outer: &str, own: &str| {
        height(&format!(
            "<Placemark><gx:MultiTrack>{outer}<gx:Track>{own}<gx:coord>-122 45 900</gx:coord><gx:coord>-121.99 45 900</gx:coord>\
             </gx:Track></gx:MultiTrack></Placemark>"
        ))
    };
    let absolute = "<altitudeMode>absolute</altitudeMode>";
    let relative = "<gx:altitudeMode>relativeToSeaFloor</gx:altitudeMode>";
    assert_eq!(track(absolute, ""), (900.0, vec![]));
    assert_eq!(track(absolute, relative), (1000.0, vec![]));
    assert_eq!(track("", "<altitudeMode/>"), (250.0, vec![]));
    let (z, warnings) = track("", "<altitudeMode>Absolute</altitudeMode>");
    assert_eq!(
        (z, warnings[0].as_str()),
        (
            250.0,
            "line 3: altitudeMode: expected absolute, relativeToGround or clampToGround, found \"Absolute\": taken as \
             clampToGround"
        )
    );
}

#[test]
fn what_cannot_be_flown_is_named_with_what_to_do() {
    let step = |extra: &str| tour(&camera(1.0, "smooth", -122.0, extra));
    for (text, expected) in [
        (tour(""), "nothing to fly: expected a tour (gx:Tour) with views"),
        (tour("<gx:FlyTo/>"), "found a tour without any view: record it again"),
        (document("<Placemark><Point/></Placemark>"), "found 1 placemark without: give each a view"),
        (document("<NetworkLink/>"), "links to other files alone"),
        (document(""), "no placemarks either"),
        (step("").replace("-122", "NaN"), "line 3: longitude: expected degrees from -180 to 180, found \"NaN\""),
        (step("").replace(">45<", ">91<"), "latitude: expected degrees from -90 to 90, found \"91\""),
        (step("<heading>1e300</heading>"), "heading: expected degrees, found \"1e300\""),
        (step("<tilt>12,5</tilt>"), "tilt: expected degrees, found \"12,5\""),
        (tour("<gx:FlyTo><Camera/></gx:FlyTo>"), "longitude: expected degrees from -180 to 180, found nothing"),
        (
            tour(&wait("soon")).replace("</gx:Playlist>", &format!("{}</gx:Playlist>", camera(1.0, "smooth", 0.0, ""))),
            "duration",
        ),
        (document("<LineString><coordinates>1,x</coordinates></LineString>"), "expected longitude,latitude,height"),
    ] {
        let message = parse_text(&text).unwrap_err().to_string();
        assert!(message.contains(expected), "{text}\n  {message}\n  {expected}");
    }
    let agl = CourseOptions { agl_m: Some(70.0), ..CourseOptions::default() };
    let message = parse_with(&step(""), agl).0.unwrap_err().to_string();
    assert!(message.contains("has heights of its own: leave --agl out"), "{message}");
}

#[test]
fn any_root_and_undeclared_prefixes_are_read() {
    let text = tour(&[camera(0.0, "smooth", -122.0, ABSOLUTE), camera(4.0, "smooth", -121.9, ABSOLUTE)].concat());
    let same = fly(&text).0;
    let element =
        |begin: &str, end: &str| text[text.find(begin).unwrap()..text.find(end).unwrap() + end.len()].to_owned();
    for other in [
        text.replace(" xmlns:gx=\"http://www.google.com/kml/ext/2.2\"", ""),
        text.replace("<Document>", "<Document><atom:link href=\"x\"/>"),
        text.replace("<kml ", "<kml xsi:schemaLocation=\"a b\" "),
        text.replace("<kml ", "<kml:kml ").replace("</kml>", "</kml:kml>"),
        text.replace("gx:", ""),
        element("<Document>", "</Document>"),
        element("<gx:Tour>", "</gx:Tour>"),
        format!("\n \n{text}\n\n"),
    ] {
        assert_eq!(fly(&other).0, same, "{other}");
    }
}

proptest! {
    #[test]
    fn any_values_never_panic(values in proptest::collection::vec("(-?[0-9]{1,4}(e[0-9]{1,3})?|NaN|inf|[a-z]{0,3}|&amp;)", 6)) {
        let extra = format!("<heading>{}</heading><tilt>{}</tilt><roll>{}</roll>", values[0], values[1], values[2]);
        let step = camera(1.0, "smooth", -122.0, &extra)
            .replace("<gx:duration>1<", &format!("<gx:duration>{}<", values[3]))
            .replace(">45<", &format!(">{}<", values[4]))
            .replace(">3000<", &format!(">{}<", values[5]));
        if let Ok(path) = parse_text(&tour(&format!("{step}{step}"))) {
            drop(path.course.frame_count(30.0, 1.0));
            prop_assert!(path.course.pose(0, 30.0, 1.0).is_some());
        }
    }
}
