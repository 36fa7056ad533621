//! The size of the vehicle table (docs/vehicles.md).

/// Frames that the table holds: more than a pipeline has on its way.
pub(crate) const TABLE_FRAMES: u64 = 64;
/// Bytes before the records of a frame.
pub(crate) const FRAME_HEAD_BYTES: u64 = 3 * 128;
/// Words of a record.
pub(crate) const RECORD_WORDS: usize = 8;

/// Frames of a table for frames of this many vehicles.
pub(crate) const fn table_frames(vehicles: u32) -> u64 {
    if vehicles == 0 { 1 } else { TABLE_FRAMES }
}

/// Bytes of a frame of this many vehicles.
pub(crate) const fn table_frame_bytes(vehicles: u32) -> u64 {
    FRAME_HEAD_BYTES + vehicles as u64 * 8 * RECORD_WORDS as u64
}
