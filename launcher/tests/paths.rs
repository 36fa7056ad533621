//! What foreign path files cost: memory and looks at the ground grow with their size alone, and no
//! bytes make the program panic.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use proptest::prelude::*;
use std::cell::Cell;
use std::path::Path;
use terravision_launcher::path::crs::Georeference;
use terravision_launcher::path::{self, CourseOptions, Ground, Remarks};

/// A plain that counts how often it is asked.
#[derive(Default)]
struct Counted(Cell<u64>);

impl Ground for Counted {
    fn height_m(&self, _x: f64, _y: f64) -> Option<f64> {
        self.0.set(self.0.get() + 1);
        Some(100.0)
    }
}

/// Allocations, bytes at most at a time, and questions to the ground that a path costs.
fn cost(text: &str) -> [u64; 3] {
    let ground = Counted::default();
    let world = Georeference::new("WGS 84 / UTM zone 10N".into(), Some(32610), None);
    let info = allocation_counter::measure(|| {
        let mut remarks = Remarks::default();
        let path = path::parse(Path::new("p"), text, &world, &ground, CourseOptions::default(), &mut remarks);
        // Frames, too: a path of many pieces must not be searched from its beginning for each.
        if let Ok(path) = path
            && let Ok(Some(count)) = path.course.frame_count(1.0, 1.0)
        {
            assert!((0..count.min(100)).all(|frame| path.course.pose(frame, 1.0, 1.0).is_some()));
        }
    });
    [info.count_total, info.bytes_max, ground.0.get()]
}

fn gpx(points: impl Iterator<Item = String>) -> String {
    format!("<gpx><trk><trkseg>{}</trkseg></trk></gpx>", points.collect::<String>())
}

fn point(seconds: usize, lon: f64, more: &str) -> String {
    let (hour, minute, second) = (seconds / 3600 % 24, seconds / 60 % 60, seconds % 60);
    let day = 1 + seconds / 86_400 % 28;
    format!(
        "<trkpt lat=\"45\" lon=\"{lon}\"><time>2024-05-{day:02}T{hour:02}:{minute:02}:{second:02}Z</time>{more}</trkpt>\n"
    )
}

fn tour(steps: String) -> String {
    format!("<kml><gx:Tour><gx:Playlist>{steps}</gx:Playlist></gx:Tour></kml>")
}

/// Documents of CZML and GeoJSON of which each grows with its number.
fn documents(count: usize) -> Vec<(&'static str, String)> {
    let joined = |part: &dyn Fn(usize) -> String| (0..count).map(part).collect::<Vec<_>>().join(",");
    let sample = |i: usize| format!("{i},{},45,900", -122.0 + 1e-5 * i as f64);
    let packet = |samples: &str, more: &str| {
        format!("{{\"id\":\"a\",\"position\":{{\"cartographicDegrees\":[{samples}]}}{more}}}")
    };
    let interval = |i: usize| {
        let (hour, minute, second) = (i / 3600 % 24, i / 60 % 60, i % 60);
        format!(
            "{{\"interval\":\"20240501T{hour:02}{minute:02}{second:02}Z/9999Z\",\"cartographicDegrees\":[-122,45,900]}}"
        )
    };
    let turns = format!(",\"orientation\":{{\"unitQuaternion\":[{}]}}", joined(&|i| format!("{i}.5,0,0,0,1")));
    let line = |_: usize| "{\"type\":\"LineString\",\"coordinates\":[[-122,45],[-122.0001,45]]}".to_owned();
    let collection = |list: String| format!("{{\"type\":\"FeatureCollection\",\"features\":[{list}]}}");
    let open = "{\"type\":\"GeometryCollection\",\"geometries\":[";
    vec![
        ("samples", format!("[{}]", packet(&joined(&sample), ""))),
        ("samples with an orientation", format!("[{}]", packet(&joined(&sample), &turns))),
        ("samples in packets, backwards", format!("[{}]", joined(&|i| packet(&sample(count - i), "")))),
        ("packets of others", format!("[{}]", joined(&|i| format!("{{\"id\":\"{i}\",\"position\":1}}")))),
        ("intervals", format!("[{{\"position\":[{}]}}]", joined(&interval))),
        ("features", collection(joined(&line))),
        ("collections", format!("{}{}", open.repeat(count), "]}".repeat(count))),
        (
            "coordinates and times",
            format!(
                "{{\"type\":\"Feature\",\"properties\":{{\"times\":[{}]}},\"geometry\":{{\"type\":\"LineString\",\"coordinates\":[{}]}}}}",
                joined(&|i| i.to_string()),
                joined(&|i| format!("[{},45,900]", -122.0 + 1e-5 * i as f64))
            ),
        ),
    ]
}

/// Files of which each grows with its number.
fn files(count: usize) -> Vec<(&'static str, String)> {
    let step = |i: usize, duration: usize| {
        let lon = -122.0 + 1e-5 * i as f64;
        format!(
            "<gx:FlyTo><gx:duration>{duration}</gx:duration><Camera><longitude>{lon}</longitude><latitude>45</latitude></Camera></gx:FlyTo>\n"
        )
    };
    let pose = |i: usize| format!("{{\"t\":{i},\"x\":{i},\"y\":1,\"z\":1,\"heading\":0,\"pitch\":0}}");
    let poses = |key: &str| format!("{{\"{key}\":[{}]}}", (0..count).map(pose).collect::<Vec<_>>().join(","));
    vec![
        ("points", gpx((0..count).map(|i| point(i, -122.0 + 1e-5 * i as f64, "")))),
        ("points at rest", gpx((0..count).map(|i| point(i, -122.0, "")))),
        ("times back", gpx((0..count).map(|i| point(count - i, -122.0 + 1e-5 * i as f64, "")))),
        ("times of no order", gpx((0..count).map(|i| point(i * 7919 % count, -122.0 + 1e-5 * i as f64, "")))),
        ("no times", gpx((0..count).map(|i| format!("<trkpt lat='45' lon='{}'/>", -122.0 + 1e-6 * i as f64)))),
        ("extensions", gpx((0..count).map(|i| point(i, -122.0, "<extensions><a:hr>80</a:hr></extensions>")))),
        ("segments", gpx((0..count).map(|i| point(900 * i, -122.0 + 1e-2 * (i % 9) as f64, "</trkseg><trkseg>")))),
        ("a smooth tour", tour((0..count).map(|i| step(i, 1)).collect())),
        ("cuts", tour((0..count).map(|i| step(i, i % 2)).collect())),
        ("waits", tour("<gx:Wait><gx:duration>1</gx:duration></gx:Wait>".repeat(count) + &step(0, 0))),
        ("tours", format!("<kml>{}</kml>", tour(step(0, 1)).replace("kml>", "Folder>").repeat(count))),
        (
            "a line",
            format!(
                "<Placemark><LineString><coordinates>{}</coordinates></LineString></Placemark>",
                "-122,45,0 -122.00001,45,0 ".repeat(count)
            ),
        ),
        (
            "commas",
            format!(
                "<Placemark><LineString><coordinates>{}</coordinates></LineString></Placemark>",
                ", ".repeat(count)
            ),
        ),
        ("attributes", format!("<gpx {}/>", (0..count).map(|i| format!("a{i}='b' ")).collect::<String>())),
        (
            "points of many attributes",
            gpx((0..count / 100).map(|_| format!("<trkpt {} lat='45' lon='-122'/>", "lat='45' ".repeat(100)))),
        ),
        ("namespaces", format!("<gpx>{}</gpx>", "<a:b xmlns:a='c'/>".repeat(count))),
        ("references", format!("<kml><name>{}</name></kml>", "&amp;&nope;&#65;".repeat(count))),
        ("sections", format!("<kml><name>{}</name></kml>", "<![CDATA[x]]><!-- y -->".repeat(count))),
        ("keyframes", poses("keyframes")),
        ("frames", poses("frames")),
        ("keys", format!("{{{}\"frames\":[]}}", (0..count).map(|i| format!("\"k{i}\":[{{}}],")).collect::<String>())),
        ("brackets", format!("{{\"a\":{}{}}}", "[".repeat(count), "]".repeat(count))),
    ]
}

#[test]
fn the_cost_of_a_path_grows_with_its_size_alone() {
    // Large enough that constant parts do not count.
    let all = |count| [files(count), documents(count)].concat();
    let (small, large) = (all(2000), all(16_000));
    for ((name, small), (_, large)) in small.iter().zip(&large) {
        let (few, many) = (cost(small), cost(large));
        let growth = large.len() as f64 / small.len() as f64;
        for (what, (few, many)) in ["allocations", "bytes", "looks"].iter().zip(few.into_iter().zip(many)) {
            // Vectors double, so that the memory at most may grow by twice as much as what is in
            // it.
            let most = 2.2 * growth * few as f64 + 4096.0;
            assert!(many as f64 <= most, "{name}: {few} {what}, and {many} for {growth:.1} times the size");
        }
        // A text is kept once, its elements and what is flown beside it.
        assert!(many[1] as f64 <= 60.0 * large.len() as f64 + 65_536.0, "{name}: {} bytes of {}", many[1], large.len());
    }
}

/// Pieces of files as they are and as they are not.
const PIECES: [&str; 24] = [
    "<kml>",
    "</kml>",
    "<gpx>",
    "<trk>",
    "<trkpt lat='45' lon='-122'>",
    "<time>2024-05-01T10:00:00Z</time>",
    "</trkpt>",
    "<gx:Tour>",
    "<gx:FlyTo>",
    "<Camera>",
    "<longitude>-122</longitude>",
    "<latitude>45</latitude>",
    "</Camera>",
    "</gx:FlyTo>",
    "</gx:Tour>",
    "<LineString><coordinates>",
    "-122,45,0 ",
    "{\"frames\":[",
    "{\"t\":1e300,\"x\":1,",
    "\"y\":2}",
    "]}",
    "&#0;",
    "<![CDATA[",
    "<!--",
];

proptest! {
    #[test]
    fn no_bytes_panic_or_cost_more_than_their_size(
        pieces in proptest::collection::vec((0usize..PIECES.len(), proptest::collection::vec(any::<u8>(), 0..3)), 0..40),
    ) {
        let mut bytes = Vec::new();
        for (piece, noise) in &pieces {
            bytes.extend(PIECES[*piece].as_bytes());
            // Noise in one piece of eight: most files are nearly right.
            if piece % 8 == 0 {
                bytes.extend(noise);
            }
        }
        let text = String::from_utf8_lossy(&bytes);
        let [count, most, looks] = cost(&text);
        prop_assert!(count < 3000 + text.len() as u64 && most < 1_000_000 + 200 * text.len() as u64, "{count} {most}");
        prop_assert!(looks <= 1000 + 10 * text.len() as u64);
    }
}
