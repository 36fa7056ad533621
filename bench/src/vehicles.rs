//! Vehicles: what one costs where 400 are in the picture, and a flight with 400 against the same
//! without.

use crate::findings::Findings;
use crate::measurement::{Measurement, Target, median};
use crate::session::sibling;
use anyhow::{Context, ensure};
use glam::{DVec3, Quat};
use std::fmt::Write as _;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::database::Database;
use terravision_common::files::temporary_folder;
use terravision_common::rig::View;
use terravision_common::vehicle::{VehicleLook, VehicleRecord};
use terravision_vehicles::model::Model;
use terravision_vehicles::painter::Painter;

/// Vehicles.
const COUNT: usize = 400;
/// Rounds of which the median counts.
const ROUNDS: usize = 5;
/// Pictures of a round.
const PICTURES: usize = 50;
/// Frames of a flight.
const FRAMES: u32 = 240;
/// Turns of flights with vehicles and without.
const TURNS: usize = 3;
const SIZE: [u32; 2] = [1280, 720];
/// Near plane, metres: that of the renderer.
const NEAR_M: f64 = 0.5;

/// Measures over a database.
///
/// # Errors
/// When it cannot be read, or a flight fails.
pub fn run(world: &Path, findings: &mut Findings) -> anyhow::Result<()> {
    let truck = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/vehicles/truck.gltf");
    let per_vehicle = painted_micros(&truck)?;
    let painted =
        Measurement::new("vehicles", "drawing one of 400 trucks, 60 m to 3 km away", per_vehicle, "µs", ROUNDS as u64);
    findings.measurements.push(painted.with_target(Target::AtMost(20.0)));
    let [without, with] = flown_seconds(world, &truck)?;
    let each = |seconds: f64| 1e3 * seconds / f64::from(FRAMES);
    for (name, seconds) in [("a frame of a flight by a sweep", without), ("the same with 400 trucks", with)] {
        findings.measurements.push(Measurement::new("vehicles", name, each(seconds), "ms", TURNS as u64));
    }
    findings.measurements.push(Measurement::new(
        "vehicles",
        "with trucks over without",
        with / without,
        "x",
        TURNS as u64,
    ));
    Ok(())
}

/// Microseconds of a core for a vehicle, in a picture of many from a hill.
fn painted_micros(truck: &Path) -> anyhow::Result<f64> {
    let look = VehicleLook { model: Some(0), scale: 1.0, point_px: 3.0, rgb: [255, 220, 0] };
    let painter = Painter::of_models(vec![Model::read(truck)?], vec![look; COUNT], None, NEAR_M);
    let camera = Camera::new(CameraFields {
        eye_in_world: [0.0, 0.0, 60.0],
        heading_rad: 0.0,
        pitch_rad: -0.1,
        roll_rad: 0.0,
        vfov_rad: 1.0,
        width: SIZE[0],
        height: SIZE[1],
        timestamp_nanos: 0,
    })?;
    let view = View { camera, at: [0; 2] };
    // As far from each other as they are from the eye: twenty rows of twenty.
    let record = |number: usize| {
        let (row, column) = (number / 20, number % 20);
        let north = 60.0 * 50f64.powf(row as f64 / 19.0);
        let east = north * 0.9 * (column as f64 / 9.5 - 1.0);
        VehicleRecord::new(number as u32, DVec3::new(east, north, 0.0), Quat::from_rotation_z(number as f32))
    };
    let records: Vec<VehicleRecord> = (0..COUNT).map(record).collect();
    let pixels = (SIZE[0] * SIZE[1]) as usize;
    let (mut rgba, mut nearness) = (vec![0; 4 * pixels], vec![0.0; pixels]);
    let micros: Vec<f64> = (0..ROUNDS)
        .map(|_| {
            let mut seconds = 0.0;
            for _ in 0..PICTURES {
                nearness.fill(0.0);
                let start = Instant::now();
                painter.draw((&mut rgba, &mut nearness), SIZE[0] as usize, &[view], &records);
                seconds += start.elapsed().as_secs_f64();
                black_box(&rgba);
            }
            1e6 * seconds / (PICTURES * COUNT) as f64
        })
        .collect();
    Ok(median(&micros))
}

/// How long flights take without vehicles and with them, turn by turn.
fn flown_seconds(world: &Path, truck: &Path) -> anyhow::Result<[f64; 2]> {
    let folder = temporary_folder("terravision-bench-")?;
    let outcome = fly_both(world, truck, &folder);
    // What is left in the folder for temporary files is no reason to fail.
    std::fs::remove_dir_all(&folder).ok();
    outcome
}

fn fly_both(world: &Path, truck: &Path, folder: &Path) -> anyhow::Result<[f64; 2]> {
    std::fs::copy(truck, folder.join("truck.gltf"))?;
    let fleet = folder.join("fleet.geojson");
    std::fs::write(&fleet, fleet_of(world)?)?;
    let mut seconds = [Vec::new(), Vec::new()];
    for turn in 0..TURNS * 2 {
        let has_vehicles = turn % 2 == 1;
        let start = Instant::now();
        fly(world, has_vehicles.then_some(&fleet))?;
        seconds[usize::from(has_vehicles)].push(start.elapsed().as_secs_f64());
    }
    Ok([median(&seconds[0]), median(&seconds[1])])
}

/// Trucks all over the middle of a world, 100 m from each other.
fn fleet_of(world: &Path) -> anyhow::Result<String> {
    let database = Database::open(world)?;
    let middle = database.world().crs_middle();
    let crs = &database.manifest().fields().crs;
    let name = crs.epsg.map_or(crs.name.clone(), |code| format!("EPSG:{code}"));
    let mut text =
        format!("{{\"type\":\"FeatureCollection\",\"crs\":{{\"properties\":{{\"name\":{name:?}}}}},\"features\":[");
    for number in 0..COUNT {
        let [x, y] = [number % 20, number / 20].map(|v| 100.0 * (v as f64 - 9.5));
        let (x, y) = (middle.x + x, middle.y + y);
        let comma = if number > 0 { "," } else { "" };
        write!(
            text,
            "{comma}{{\"type\":\"Feature\",\"properties\":{{\"model\":\"truck.gltf\",\"times\":[0,1000]}},\"geometry\":\
             {{\"type\":\"LineString\",\"coordinates\":[[{x},{y}],[{},{y}]]}}}}",
            x + 900.0
        )
        .context("text grows in memory")?;
    }
    text.push_str("]}");
    Ok(text)
}

/// Flies around the middle of the world.
fn fly(world: &Path, fleet: Option<&PathBuf>) -> anyhow::Result<()> {
    let middle = *Database::open(world)?.world();
    let middle = middle.crs_middle();
    let mut command = Command::new(sibling("terravision")?);
    command.arg("fly").arg(world).args(["--around", &format!("{},{}", middle.x, middle.y), "--radius", "1500"]);
    command.args(["--height", "600", "--frames", &format!("0..{FRAMES}"), "--rays", "sweep", "-o", "/dev/null"]);
    if let Some(fleet) = fleet {
        command.arg("--vehicles").arg(fleet);
    }
    let status = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).status();
    let status = status.context("terravision does not start")?;
    ensure!(status.success(), "terravision fly: {status}");
    Ok(())
}
