//! The same handles on memory of a single process, for tests and benches.

use super::array_ring::{ElevationReader, ElevationWriter, StreamReader, StreamWriter};
use super::control::Control;
use super::error::ShmError;
use super::geometry::{Geometry, half_bytes};
use super::header::Segment;
use super::kind::SegmentKind;
use super::ping_pong::{TreeReader, TreeWriter};
use super::pool::{PoolReader, PoolWriter};
use super::process::ProcessId;
use super::region::Region;
use super::ring::{Consumer, Producer};
use super::vehicle_layout::{table_frame_bytes, table_frames};
use super::vehicle_table::{VehicleTableReader, VehicleTableWriter};
use super::want_list::{WantListReader, WantListWriter};
use crate::outcome::TileOutcome;
use bytemuck::Pod;
use std::sync::Arc;

pub(crate) fn segment(kind: SegmentKind, capacity: u64, item_bytes: u64) -> Result<Arc<Segment>, ShmError> {
    let Some(geometry) = Geometry::checked(kind, capacity, item_bytes) else {
        let expected = "a possible number of items (a power of two for a ring)";
        return Err(ShmError::corrupt(kind, "the capacity", capacity, expected));
    };
    Ok(Arc::new(Segment::create(Region::heap(geometry.total_bytes)?, geometry)?))
}

/// A control block whose launcher is this process.
///
/// # Errors
/// [`ShmError::Os`] when `/proc` cannot be read.
pub fn control() -> Result<Control, ShmError> {
    Control::attach(&segment(SegmentKind::Control, 1, 0)?, ProcessId::own()?)
}

/// Both ends of a ring of `capacity` slots.
///
/// # Errors
/// When `capacity` is not a power of two.
pub fn ring<T: Pod>(capacity: u32) -> Result<(Producer<T>, Consumer<T>), ShmError> {
    let segment = segment(SegmentKind::Ring, capacity.into(), size_of::<T>() as u64)?;
    Ok((Producer::attach(&segment)?, Consumer::attach(&segment)?))
}

/// Both ends of a ping-pong buffer with `nodes` nodes a half.
///
/// # Errors
/// When `nodes` is 0.
pub fn ping_pong(nodes: u32) -> Result<(TreeWriter, TreeReader), ShmError> {
    let segment = segment(SegmentKind::PingPong, 2, half_bytes(nodes.into()))?;
    Ok((TreeWriter::attach(&segment)?, TreeReader::attach(&segment)?))
}

/// Both ends of an elevation ring of `arrays` arrays of `array_f32` numbers.
///
/// # Errors
/// When `arrays` is not a power of two, or `array_f32` is 0.
pub fn elevation_ring(arrays: u32, array_f32: u32) -> Result<(ElevationWriter, ElevationReader), ShmError> {
    let segment = segment(SegmentKind::ElevationRing, arrays.into(), u64::from(array_f32) * 4)?;
    Ok((ElevationWriter::attach(&segment)?, ElevationReader::attach(&segment)?))
}

/// Both ends of a stream ring of `frames` frames of `frame_bytes` bytes.
///
/// # Errors
/// When `frames` is not a power of two, or `frame_bytes` is 0.
pub fn stream_ring(frames: u32, frame_bytes: u32) -> Result<(StreamWriter, StreamReader), ShmError> {
    let segment = segment(SegmentKind::StreamRing, frames.into(), frame_bytes.into())?;
    Ok((StreamWriter::attach(&segment)?, StreamReader::attach(&segment)?))
}

/// Both sides of a tile pool of `slots` slots of `slot_bytes` bytes.
///
/// # Errors
/// When `slots` is 0.
pub fn pool(slots: u32, slot_bytes: u64) -> Result<(PoolWriter, PoolReader), ShmError> {
    let segment = segment(SegmentKind::ColorPool, slots.into(), slot_bytes)?;
    Ok((PoolWriter::attach(&segment)?, PoolReader::attach(&segment)?))
}

/// Both ends of a want list of up to `tiles` tiles.
///
/// # Errors
/// When `tiles` is 0.
pub fn want_list(tiles: u32) -> Result<(WantListWriter, WantListReader), ShmError> {
    let segment = segment(SegmentKind::WantList, tiles.into(), 8)?;
    Ok((WantListWriter::attach(&segment)?, WantListReader::attach(&segment)?))
}

/// Both ends of a table of up to `vehicles` vehicles a frame.
///
/// # Errors
/// Never with numbers of a usual size.
pub fn vehicle_table(vehicles: u32) -> Result<(VehicleTableWriter, VehicleTableReader), ShmError> {
    let segment = segment(SegmentKind::VehicleTable, table_frames(vehicles), table_frame_bytes(vehicles))?;
    Ok((VehicleTableWriter::attach(&segment)?, VehicleTableReader::attach(&segment)?))
}

/// Both ends of a ring of `capacity` tile outcomes.
///
/// # Errors
/// When `capacity` is not a power of two.
pub fn outcomes(capacity: u32) -> Result<(Producer<TileOutcome>, Consumer<TileOutcome>), ShmError> {
    let segment = segment(SegmentKind::TileOutcomes, capacity.into(), size_of::<TileOutcome>() as u64)?;
    Ok((Producer::attach(&segment)?, Consumer::attach(&segment)?))
}
