//! The fleet of a flight: where its vehicles are at the time of each frame. It is a function of the
//! time alone, so that every run and every piece of a flight shows the same.
//!
//! * [`load`]: files, checked, with the models that they name.
//! * [`standing`]: how a vehicle stands on the ground.
//! * [`driver`]: the vehicle table, frame by frame.

mod driver;
mod load;
mod standing;

pub use driver::Driver;
pub use load::FleetPlan;

use crate::ground::WorldGround;
use crate::path::vehicles::{HeightReference, Placed, Vehicle};
use glam::{DMat3, DQuat, DVec3};
use terravision_common::vehicle::{VehicleLook, VehicleRecord, VehiclesConfig};
use terravision_common::world::World;

/// A vehicle without a model stands on this much ground, metres.
const USUAL_LENGTH_M: f64 = 2.0;

/// All vehicles.
#[derive(Debug, Clone)]
pub struct Fleet {
    vehicles: Vec<Member>,
    models: Vec<std::path::PathBuf>,
}

/// A vehicle of a fleet.
#[derive(Debug, Clone)]
struct Member {
    vehicle: Vehicle,
    look: VehicleLook,
    /// The side of the square of ground that it stands on.
    length_m: f64,
}

impl Fleet {
    /// How many vehicles it has.
    #[must_use]
    pub fn len(&self) -> usize {
        self.vehicles.len()
    }

    /// Whether it has none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.vehicles.is_empty()
    }

    /// What the renderer is told of it.
    #[must_use]
    pub fn config(&self) -> VehiclesConfig {
        let vehicles = self.vehicles.iter().map(|member| member.look.clone()).collect();
        VehiclesConfig { models: self.models.clone(), vehicles }
    }

    /// The first moment of any vehicle, seconds; `None` where all are there at all times.
    #[must_use]
    pub fn start(&self) -> Option<f64> {
        let starts = self.vehicles.iter().flat_map(|member| member.vehicle.ways.iter().filter_map(|way| way.start()));
        starts.min_by(f64::total_cmp)
    }

    /// Where vehicles are at a time, over this ground; those that are not there are left out.
    pub fn at(&self, t: f64, ground: &WorldGround<'_>, world: &World, out: &mut Vec<VehicleRecord>) {
        out.clear();
        for (number, member) in self.vehicles.iter().enumerate() {
            let Some(placed) = member.vehicle.at(t) else { continue };
            let Some((position, attitude)) = member.place(&placed, ground) else { continue };
            let position = world.crs_frame().position(position);
            out.push(VehicleRecord::new(number as u32, position, attitude.as_quat()));
        }
    }
}

impl Member {
    /// Position in the CRS and attitude; `None` where it would stand on ground that is not there.
    fn place(&self, placed: &Placed, ground: &WorldGround<'_>) -> Option<(DVec3, DQuat)> {
        let DVec3 { x, y, z } = placed.position;
        let ahead = placed.attitude.map(|attitude| attitude * DVec3::X).or(placed.ahead).unwrap_or(DVec3::Y);
        match self.vehicle.height {
            HeightReference::OnGround => {
                let height_m = ground.at(x, y)?.height_m;
                let up = standing::up(ground, [x, y], ahead, self.length_m);
                // It heads along its way, up or down with the ground: the part of that across the
                // ground would turn it to a side on a slope.
                let along = DVec3::new(ahead.x, ahead.y, 0.0).try_normalize().unwrap_or(DVec3::Y);
                let ahead = along - DVec3::Z * (up.dot(along) / up.z);
                Some((DVec3::new(x, y, height_m), turned(ahead, up)))
            }
            HeightReference::AboveGround => {
                let z = z + ground.at(x, y)?.height_m;
                Some((DVec3::new(x, y, z), placed.attitude.unwrap_or_else(|| turned(ahead, DVec3::Z))))
            }
            HeightReference::Datum => {
                Some((placed.position, placed.attitude.unwrap_or_else(|| turned(ahead, level(ahead)))))
            }
        }
    }
}

/// The rotation to axes of which the third is `up`, and the first as near to `ahead` as can be.
fn turned(ahead: DVec3, up: DVec3) -> DQuat {
    let left = up.cross(ahead).try_normalize().unwrap_or(DVec3::NEG_X);
    let up = up.normalize();
    DQuat::from_mat3(&DMat3::from_cols(left.cross(up), left, up)).normalize()
}

/// Up for what goes ahead without leaning to a side.
fn level(ahead: DVec3) -> DVec3 {
    let left = DVec3::Z.cross(ahead).try_normalize().unwrap_or(DVec3::NEG_X);
    ahead.cross(left).try_normalize().unwrap_or(DVec3::Z)
}

#[cfg(test)]
mod tests;
