#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use super::*;
use crate::path::vehicles::{Appearance, Moment, Way};
use glam::DVec2;
use terravision_common::database::{Layer, TileError, TileScratch, TileSource};
use terravision_common::node::NodeId;
use terravision_common::world::WorldFields;
use terravision_testkit::worlds::fields;

/// Rough ground: waves of several lengths and steps from post to post, posts 2 m apart.
struct Rough(World);

impl TileSource for Rough {
    fn read_elevation(&self, node: NodeId, out: &mut [f32], _: &mut TileScratch) -> Result<(), TileError> {
        let posts = self.0.elevation_posts() as usize;
        let origin = self.0.node_origin(node);
        for (k, z) in out.iter_mut().enumerate() {
            let step = f64::from(1u32 << node.q());
            let [x, y] = [origin[0] as f64 + (k % posts) as f64 * step, origin[1] as f64 + (k / posts) as f64 * step];
            let hash = (x * 127.1 + y * 311.7).sin() * 43_758.545;
            *z = (20.0 * (0.05 * x).sin() * (0.043 * y).cos() + 1.5 * (0.6 * x + 0.4 * y).sin() + hash.fract()) as f32;
        }
        Ok(())
    }

    fn read_color(&self, node: NodeId, _: &mut [u8], _: &mut TileScratch) -> Result<(), TileError> {
        Err(TileError::Missing { layer: Layer::Color, node })
    }
}

fn world() -> World {
    World::new(WorldFields { origin: [500_000.0, 4_000_000.0], ..fields([1200, 1200], 2.0, [4, 16]) }).unwrap()
}

fn member(height: HeightReference, moments: Vec<Moment>) -> Member {
    let ways = vec![Way::new(moments, None, false).unwrap()];
    let vehicle = Vehicle { place: "one".into(), ways, height, appearance: Appearance::default() };
    let look = VehicleLook { model: None, scale: 1.0, point_px: 3.0, rgb: [0; 3] };
    Member { vehicle, look, length_m: 6.0 }
}

fn moment(t: f64, x: f64, y: f64, z: f64) -> Moment {
    Moment { t, position: DVec3::new(500_000.0 + x, 4_000_000.0 + y, z), attitude: None }
}

#[test]
fn a_ground_vehicle_stands_on_the_ground_and_leans_with_it() {
    let world = world();
    let source = Rough(world);
    let ground = WorldGround::finest(&source, &world, 1.0);
    // 10 km at 20 m/s: up and down the field.
    let turns: Vec<Moment> = (0..6)
        .flat_map(|k| {
            let (t, x) = (100.0 * f64::from(k), 300.0 * f64::from(k) + 100.0);
            let ends = if k % 2 == 0 { [100.0, 2000.0] } else { [2000.0, 100.0] };
            [moment(t, x, ends[0], 0.0), moment(t + 95.0, x + 30.0, ends[1], 0.0)]
        })
        .collect();
    let fleet = Fleet { vehicles: vec![member(HeightReference::OnGround, turns)], models: vec![] };
    let (mut records, mut worst_deg, mut count) = (Vec::new(), 0.0f64, 0);
    for step in 0..1190 {
        fleet.at(0.5 * f64::from(step), &ground, &world, &mut records);
        let Some(record) = records.first() else { continue };
        let [x, y, z] = record.position_in_world;
        let place = world.crs_frame().position(DVec3::new(500_000.0, 4_000_000.0, 0.0));
        let crs = [500_000.0 + x - place.x, 4_000_000.0 + y - place.y];
        assert!((z - ground.at(crs[0], crs[1]).unwrap().height_m).abs() < 0.05);
        // The mean of the slopes all over the square, in small steps.
        let attitude = glam::Quat::from_array(record.world_from_vehicle).as_dquat();
        let ahead = (attitude * DVec3::X).truncate().normalize();
        let (mut slope, cells) = (DVec2::ZERO, 60);
        let height = |p: DVec2| ground.at(p.x, p.y).unwrap().height_m;
        for k in 0..cells * cells {
            let [u, v] = [k % cells, k / cells].map(|i| 6.0 * ((f64::from(i) + 0.5) / f64::from(cells) - 0.5));
            let p = DVec2::from_array(crs) + ahead * u + ahead.perp() * v;
            let by = |axis: DVec2| (height(p + axis * 1e-3) - height(p - axis * 1e-3)) / 2e-3;
            slope += DVec2::new(by(DVec2::X), by(DVec2::Y)) / f64::from(cells * cells);
        }
        let normal = DVec3::new(-slope.x, -slope.y, 1.0).normalize();
        worst_deg = worst_deg.max((attitude * DVec3::Z).angle_between(normal).to_degrees());
        count += 1;
    }
    assert!(count > 1000 && worst_deg < 1.0, "{worst_deg} degrees of {count}");
}

#[test]
fn an_aircraft_flies_where_its_file_has_it_and_looks_ahead() {
    let world = world();
    let source = Rough(world);
    let ground = WorldGround::finest(&source, &world, 3.0);
    let way = || vec![moment(0.0, 100.0, 100.0, 500.0), moment(10.0, 200.0, 100.0, 600.0)];
    let above = member(HeightReference::AboveGround, way());
    let fleet = Fleet { vehicles: vec![member(HeightReference::Datum, way()), above], models: vec![] };
    assert_eq!((fleet.len(), fleet.start()), (2, Some(0.0)));
    let mut records = Vec::new();
    fleet.at(5.0, &ground, &world, &mut records);
    let height = ground.at(500_150.0, 4_000_100.0).unwrap().height_m;
    assert!((records[0].position_in_world[2] - 550.0).abs() < 1e-9);
    assert!((records[1].position_in_world[2] - 550.0 - height).abs() < 1e-9);
    let ahead = glam::Quat::from_array(records[0].world_from_vehicle) * glam::Vec3::X;
    assert!(ahead.distance(glam::Vec3::new(1.0, 0.0, 1.0).normalize()) < 1e-5, "east and up: {ahead}");
    for t in [-0.1, 10.1] {
        fleet.at(t, &ground, &world, &mut records);
        assert!(records.is_empty(), "{t}");
    }
}
