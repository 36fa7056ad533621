//! A flight against the clock while the link loses a third of all requests, damages and delays
//! others, and the server is gone for a while: frames go on, every texel is of a tile that belongs
//! there, nothing is seen through the ground, and afterwards the picture becomes what it should be.
//!
//! `scripts/loss.sh` flies the long form: TERRAVISION_STORM_S seconds, the server gone for
//! TERRAVISION_GONE_S. There frames have to be on time, too; a test machine may have no time at
//! all.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use serde_json::{Value, json};
use std::time::Duration;
use terravision_common::node::NodeId;
use terravision_common::shm::SharedFrame;
use terravision_common::synthetic::name_color;
use terravision_common::world::World;
use terravision_testkit::fault_server::{Fault, FaultServer, Link, Rule};
use terravision_tests::folder::TestFolder;
use terravision_tests::live::{reader, shared_name};
use terravision_tests::process::{Running, Terravision};
use terravision_tests::shot::read_report;
use terravision_tests::worlds::named_world;

const SIZE: [usize; 2] = [320, 180];
const FPS: f64 = 10.0;
/// The flight in parts: it moves until here, and the storm lasts; the server is gone from here on.
const REST_FROM: f64 = 0.55;
const GONE_FROM: f64 = 0.2;
/// JPEG keeps a colour within this.
const TOLERANCE: u8 = 8;

fn seconds(variable: &str, usual: f64) -> f64 {
    std::env::var(variable).map_or(usual, |text| text.parse().expect("a number of seconds"))
}

fn storm() -> Vec<Rule> {
    vec![
        Rule::new(Fault::Drop).percent(30),
        Rule::new(Fault::Garbage).percent(5),
        Rule::new(Fault::Late(5000)).percent(5),
    ]
}

/// What was seen of a flight's frames.
#[derive(Debug, Default)]
struct Seen {
    frames: u64,
    texels: u64,
    wrong: u64,
    holes: u64,
    /// Where the first of each was, and what was above and below it.
    first_wrong: Option<String>,
    first_hole: Option<String>,
    /// Texels by the level of the tile that they are of.
    by_level: [u64; 32],
}

impl Seen {
    /// Looks at every pixel of a frame: ground has the name of one of the tiles above it, and sky
    /// has sky above.
    fn look(&mut self, world: &World, frame: &SharedFrame) {
        let info = frame.info.unwrap();
        let width = SIZE[0];
        self.frames += 1;
        let is_sky = |k: usize| frame.ground[3 * k].is_nan();
        for (k, rgba) in frame.rgba.chunks_exact(4).enumerate() {
            if is_sky(k) {
                // Ground above sky in a column is a hole: the camera looks over terrain without
                // overhangs.
                if k >= width && !is_sky(k - width) {
                    self.holes += 1;
                    self.first_hole.get_or_insert_with(|| around(frame, k));
                }
                continue;
            }
            self.texels += 1;
            let point = [frame.ground[3 * k], frame.ground[3 * k + 1]];
            // Positions are as exact as depths are; a pixel is ten times as wide.
            let distance = (point[0] - info.position[0]).hypot(point[1] - info.position[1]);
            match tile_of(world, point, 0.5 + 5e-4 * distance, [rgba[0], rgba[1], rgba[2]]) {
                Some(node) => self.by_level[usize::from(node.q())] += 1,
                None => {
                    self.wrong += 1;
                    self.first_wrong.get_or_insert_with(|| around(frame, k));
                }
            }
        }
    }
}

/// A pixel and those above and below it: colour, ground and distance.
fn around(frame: &SharedFrame, k: usize) -> String {
    let info = frame.info.unwrap();
    let mut text =
        format!("frame {}, column {}, row {}, eye {:?}:", info.frame, k % SIZE[0], k / SIZE[0], info.position);
    for at in [k.wrapping_sub(SIZE[0]), k, k + SIZE[0]].into_iter().filter(|at| *at < SIZE[0] * SIZE[1]) {
        let (rgba, ground) = (&frame.rgba[4 * at..4 * at + 3], &frame.ground[3 * at..3 * at + 3]);
        let distance = (ground[0] - info.position[0]).hypot(ground[1] - info.position[1]);
        text += &format!(" {rgba:?} at {ground:.2?}, {distance:.1} m;");
    }
    text
}

/// The tile whose name a colour is, of those that lie above a point of the CRS, or so close to it.
fn tile_of(world: &World, point: [f64; 2], within_m: f64, rgb: [u8; 3]) -> Option<NodeId> {
    let fields = world.fields();
    let node = |shift: [f64; 2], q: u8| {
        let at = [0, 1].map(|axis| {
            let unit = (point[axis] + shift[axis] - fields.origin[axis]) / world.lattice_unit_m();
            (unit.clamp(0.0, f64::from(world.extent()[axis]) - 1.0) / world.node_side(q) as f64) as u32
        });
        NodeId::new(at[0], at[1], q)
    };
    let is_name = |node: &NodeId| name_color(*node).into_iter().zip(rgb).all(|(a, b)| a.abs_diff(b) <= TOLERANCE);
    let shifts = [[0.0, 0.0], [1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]].map(|at| at.map(|v| v * within_m));
    (world.finest_color_level()..world.levels())
        .flat_map(|q| shifts.into_iter().filter_map(move |shift| node(shift, q)))
        .find(is_name)
}

/// A path over the detailed part of the world: across it, a turn, and a rest.
fn write_path(folder: &TestFolder, world: &World, frames: u64, seconds: f64) {
    let [x0, y0] = world.fields().origin;
    let side = world.extent_m()[0] / 2.0;
    // As fast as the world allows, but no faster than a jet.
    let way = (250.0 * REST_FROM * seconds).min(0.6 * side);
    let poses: Vec<Value> = (0..frames)
        .map(|k| {
            let t = (k as f64 / frames as f64 / REST_FROM).min(1.0);
            let turn = 1.2 * (t * t * t);
            let [east, north] = [0.25 * side + way * t * (0.6 + 0.4 * turn).sin(), 0.15 * side + way * t * 0.8];
            json!({"x": x0 + east, "y": y0 + north, "z": 1500.0, "heading": 30.0 + 60.0 * turn, "pitch": -16.0, "roll": 0.0})
        })
        .collect();
    let text = json!({"width": SIZE[0], "height": SIZE[1], "vfov_deg": 60, "fps": FPS, "frames": poses});
    std::fs::write(folder.join("path.json"), text.to_string()).unwrap();
}

fn fly(server: &FaultServer, folder: &TestFolder, ring: &str, seconds: f64) -> Running {
    Terravision::verb("fly")
        .arg(server.url("world.tv"))
        .args(["--mode", "realtime", "--feedback", "off", "--ground", "--timeout", "4", "--path"])
        .arg(folder.join("path.json"))
        .args(["-o", &format!("shared:{ring}"), "--report"])
        .arg(folder.join("report.json"))
        .arg("--cache")
        .arg(folder.join("cache"))
        .deadline(Duration::from_secs_f64(120.0 + 2.0 * seconds))
        .spawn()
}

#[test]
fn a_texel_of_another_tile_is_found() {
    let world = terravision_common::database::read_world(&named_world()).unwrap();
    let q = world.finest_color_level();
    let side = world.node_side_m(q);
    let [x0, y0] = world.fields().origin;
    let point = [x0 + 5.5 * side, y0 + 6.5 * side];
    let named = |m, n, q| tile_of(&world, point, 1.0, name_color(NodeId::new(m, n, q).unwrap()));
    assert_eq!(named(5, 6, q), NodeId::new(5, 6, q));
    assert_eq!(named(2, 3, q + 1), NodeId::new(2, 3, q + 1));
    for (m, n) in [(4, 6), (6, 6), (5, 5), (5, 7), (7, 4)] {
        assert_eq!(named(m, n, q), None);
    }
    assert_eq!((named(3, 3, q + 1), tile_of(&world, point, 1.0, [150, 190, 235])), (None, None));
}

#[test]
fn frames_go_on_and_show_only_what_belongs_there_whatever_the_link_loses() {
    let (length, gone) = (seconds("TERRAVISION_STORM_S", 16.0), seconds("TERRAVISION_GONE_S", 2.0));
    let frames = (length * FPS) as u64;
    let database = named_world();
    let world = terravision_common::database::read_world(&database).unwrap();
    let server = FaultServer::serve(database.parent().unwrap());
    let (folder, name) = (TestFolder::new("loss"), shared_name("loss"));
    write_path(&folder, &world, frames, length);
    server.set_link(Link { latency: Duration::from_millis(20), bits_per_s: Some(20_000_000) });
    let mut flight = fly(&server, &folder, &name.to_string(), length);
    let mut ring = reader(&mut flight, &name);
    let mut shared = SharedFrame::default();
    let (mut seen, mut frame, mut was_storm) = (Seen::default(), 0, false);
    let part = |share: f64| (share * frames as f64) as u64;
    let while_gone = part(GONE_FROM)..part(GONE_FROM) + (gone * FPS) as u64;
    while !ring.is_ended() {
        // The storm begins with the second frame, when the clock has started, and ends when the
        // camera rests.
        let is_storm = (1..part(REST_FROM)).contains(&frame);
        if is_storm != was_storm {
            server.misbehave(if is_storm { storm() } else { Vec::new() });
            was_storm = is_storm;
        }
        server.set_down(while_gone.contains(&frame));
        if ring.read(&mut shared).unwrap()
            && let Some(info) = shared.info
        {
            assert!(info.frame >= frame, "frame numbers go on");
            frame = info.frame;
            seen.look(&world, &shared);
        } else {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
    let finished = flight.wait();
    println!("{}", finished.stderr);
    let report = read_report(&folder);
    let (realtime, network) = (&report["realtime"], &report["network"]);
    let failed: u64 = network["failures"].as_array().unwrap().iter().map(|f| f["count"].as_u64().unwrap()).sum();
    let sharp: Vec<f64> = realtime["drawn"]["sharp"].as_array().unwrap().iter().map(|s| s.as_f64().unwrap()).collect();
    let drawn = realtime["drawn"]["frame"].as_array().unwrap().iter().map(|f| f.as_u64().unwrap());
    let drawn_while_gone = drawn.filter(|frame| while_gone.contains(frame)).count() as u64;
    println!(
        "loss: {frames} frames, {:.1} % on time, {drawn_while_gone} of {} drawn while the server was gone; {failed} of {} requests \
         failed; {} texels looked at in {} frames, {} wrong, {} holes; drawn as wanted {:.3} on average, {:.3} at the end",
        100.0 * realtime["on_time_share"].as_f64().unwrap(),
        while_gone.end - while_gone.start,
        network["requests"],
        seen.texels,
        seen.frames,
        seen.wrong,
        seen.holes,
        realtime["sharp_mean"].as_f64().unwrap(),
        sharp.last().unwrap(),
    );
    println!("by level: {:?}", &seen.by_level[..usize::from(world.levels())]);
    // Texels.
    assert_eq!((seen.wrong, seen.first_wrong), (0, None));
    assert_eq!((seen.holes, seen.first_hole), (0, None));
    assert!(seen.frames > frames / 4 && seen.texels > 1_000_000, "{} frames", seen.frames);
    let levels = seen.by_level.iter().filter(|texels| **texels > 0).count();
    assert!(levels >= 3, "fine ground and coarse was seen: {:?}", seen.by_level);
    // Frames: a loaded machine leaves some out, a flight that waits for its link leaves out all.
    assert_eq!(realtime["frames"], frames);
    assert!(drawn_while_gone >= (while_gone.end - while_gone.start) / 4, "{drawn_while_gone}");
    if std::env::var_os("TERRAVISION_STORM_S").is_some() {
        let on_time = realtime["on_time_share"].as_f64().unwrap();
        assert!(on_time >= 0.95 && drawn_while_gone * 100 >= 95 * (while_gone.end - while_gone.start), "{on_time}");
    }
    // The link.
    assert!(failed > 10, "{network}");
    finished.assert_code(if report["tiles"]["unavailable_count"] == 0 { 0 } else { 3 });
    // What lacked came when the link was well again.
    assert!(sharp.iter().any(|share| *share < 1.0), "something lacked");
    assert_eq!(sharp.last(), Some(&1.0), "{sharp:?}");
    let column = |name: &str| realtime["drawn"][name].as_array().unwrap().last().unwrap().clone();
    assert_eq!(column("tiles_resident"), column("tiles_wanted"));
}
