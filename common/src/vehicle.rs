//! Vehicles: what each looks like, fixed for a run, and where it is in a frame.

use bytemuck::{Pod, Zeroable};
use glam::{DVec3, Quat};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Most vehicles of a run.
pub const MOST_VEHICLES: usize = 4096;
/// Set in [`VehicleRecord::flags`] where the vehicle is there at the frame's time.
pub const IS_THERE: u32 = 1;

/// Where a vehicle is in a frame, as it lies in the vehicle table: 64 bytes, every bit pattern is a
/// value.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct VehicleRecord {
    /// Which vehicle: its number in [`VehiclesConfig::vehicles`].
    pub vehicle: u32,
    /// [`IS_THERE`]; all other bits are 0.
    pub flags: u32,
    /// Where its origin is, in the world's coordinates, metres.
    pub position_in_world: [f64; 3],
    /// The rotation from its axes (ahead, left, up) to the world's (east, north, up): a quaternion
    /// x, y, z, w of length 1.
    pub world_from_vehicle: [f32; 4],
    /// 0.
    pub reserved: [u64; 2],
}

const _: () = assert!(size_of::<VehicleRecord>() == 64);

impl VehicleRecord {
    /// A vehicle that is there.
    #[must_use]
    pub fn new(vehicle: u32, position_in_world: DVec3, world_from_vehicle: Quat) -> Self {
        Self {
            vehicle,
            flags: IS_THERE,
            position_in_world: position_in_world.to_array(),
            world_from_vehicle: world_from_vehicle.to_array(),
            reserved: [0; 2],
        }
    }

    /// Whether its numbers are a place and a rotation.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        let length: f32 = self.world_from_vehicle.iter().map(|v| v * v).sum();
        self.position_in_world.iter().all(|v| v.abs() < 1e12) && (0.99..1.01).contains(&length)
    }
}

/// What the vehicles of a run look like.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VehiclesConfig {
    /// Files of models, glTF 2.0.
    pub models: Vec<PathBuf>,
    /// What there is of vehicles, at most [`MOST_VEHICLES`].
    pub vehicles: Vec<VehicleLook>,
}

/// What a vehicle looks like.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VehicleLook {
    /// Which of the models; `None`: it is drawn as a point.
    pub model: Option<u32>,
    /// Factor on the model's size.
    pub scale: f32,
    /// The side of the point that stands for it where it is farther away than its model shows,
    /// pixels.
    pub point_px: f32,
    /// Colour of that point.
    pub rgb: [u8; 3],
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_are_no_place_or_no_rotation_are_found() {
        let good = VehicleRecord::new(1, DVec3::new(1.0, 2.0, 3.0), Quat::IDENTITY);
        assert!(good.is_valid());
        for wrong in [f64::NAN, f64::INFINITY, 1e12] {
            assert!(!VehicleRecord { position_in_world: [0.0, wrong, 0.0], ..good }.is_valid());
        }
        for wrong in [[0.0; 4], [f32::NAN, 0.0, 0.0, 1.0], [1.0; 4]] {
            assert!(!VehicleRecord { world_from_vehicle: wrong, ..good }.is_valid());
        }
    }
}
