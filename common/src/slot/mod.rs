//! The slots of the ring between preparer and renderer.
//!
//! A frame is one [`Slot`] of kind [`FRAME_MARKER`], one of kind [`FRAME_VIEW`] per drawn view, one
//! of kind [`TILE`] per colour leaf, near to far, and one of kind [`FRAME_END`]. Where heights are read
//! out of the elevation pool, slots of kind [`ELEVATION`] before the tiles name its tiles. All slots have the
//! same size; the kind determines the payload. The reader ([`Slot::read`]) does not trust them. A
//! marker within a frame aborts that frame, if it comes from another preparer: the first one was
//! killed.

mod elevation;
mod frame_marker;
mod tile;

pub use elevation::{ElevationSlot, ElevationTile};
pub use frame_marker::{FrameEnd, FrameMarker, ViewSlot};
pub use tile::TileSlot;

use bytemuck::{Pod, Zeroable};

/// Kind of a [`FrameMarker`] slot.
pub const FRAME_MARKER: u64 = 1;
/// Kind of a [`TileSlot`] slot.
pub const TILE: u64 = 2;
/// Kind of a [`FrameEnd`] slot.
pub const FRAME_END: u64 = 3;
/// Kind of a [`ViewSlot`] slot.
pub const FRAME_VIEW: u64 = 4;

/// Kind of an [`ElevationSlot`] slot.
pub const ELEVATION: u64 = 5;

/// A ring slot, 136 bytes: the kind, then the payload.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Slot {
    kind: u64,
    payload: [u64; 16],
}

const _: () = assert!(size_of::<FrameMarker>() == 128 && size_of::<ViewSlot>() == 96);
const _: () = assert!(size_of::<TileSlot>() == 56 && size_of::<FrameEnd>() == 40);
const _: () = assert!(size_of::<ElevationSlot>() == 128);

/// The content of a slot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SlotContent {
    /// A frame opens.
    Marker(FrameMarker),
    /// One view of it.
    View(ViewSlot),
    /// Some of its tiles of the elevation pool.
    Elevation(ElevationSlot),
    /// One tile to draw.
    Tile(TileSlot),
    /// The frame is complete.
    End(FrameEnd),
}

impl Slot {
    /// A slot with this content.
    #[must_use]
    pub fn new(content: &SlotContent) -> Self {
        let mut slot = Slot::zeroed();
        let (kind, bytes) = match content {
            SlotContent::Marker(marker) => (FRAME_MARKER, bytemuck::bytes_of(marker)),
            SlotContent::View(view) => (FRAME_VIEW, bytemuck::bytes_of(view)),
            SlotContent::Elevation(tiles) => (ELEVATION, bytemuck::bytes_of(tiles)),
            SlotContent::Tile(tile) => (TILE, bytemuck::bytes_of(tile)),
            SlotContent::End(end) => (FRAME_END, bytemuck::bytes_of(end)),
        };
        slot.kind = kind;
        bytemuck::bytes_of_mut(&mut slot.payload)[..bytes.len()].copy_from_slice(bytes);
        slot
    }

    /// Its content; `None` for an unknown kind. The numbers inside still have to be checked against
    /// the rings and pools that they index.
    #[must_use]
    pub fn read(&self) -> Option<SlotContent> {
        let bytes: &[u8] = bytemuck::bytes_of(&self.payload);
        Some(match self.kind {
            FRAME_MARKER => SlotContent::Marker(bytemuck::pod_read_unaligned(&bytes[..size_of::<FrameMarker>()])),
            FRAME_VIEW => SlotContent::View(bytemuck::pod_read_unaligned(&bytes[..size_of::<ViewSlot>()])),
            ELEVATION => SlotContent::Elevation(bytemuck::pod_read_unaligned(&bytes[..size_of::<ElevationSlot>()])),
            TILE => SlotContent::Tile(bytemuck::pod_read_unaligned(&bytes[..size_of::<TileSlot>()])),
            FRAME_END => SlotContent::End(bytemuck::pod_read_unaligned(&bytes[..size_of::<FrameEnd>()])),
            _ => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slot_reads_back_what_was_put_into_it() {
        let tile = TileSlot { node: 7, end: [32, 31], edge_snap: [0, 1, 2, 0], ..TileSlot::zeroed() };
        assert_eq!(Slot::new(&SlotContent::Tile(tile)).read(), Some(SlotContent::Tile(tile)));
        let end = FrameEnd { frame: 9, tile_count: 3, ..FrameEnd::zeroed() };
        assert_eq!(Slot::new(&SlotContent::End(end)).read(), Some(SlotContent::End(end)));
        let marker = FrameMarker { frame: 9, r_z_px: 10.0, ..FrameMarker::zeroed() };
        assert_eq!(Slot::new(&SlotContent::Marker(marker)).read(), Some(SlotContent::Marker(marker)));
        let view = ViewSlot { at: [640, 0], index: 1, count: 2, ..ViewSlot::zeroed() };
        assert_eq!(Slot::new(&SlotContent::View(view)).read(), Some(SlotContent::View(view)));
        let tile = |slot| ElevationTile { node: 3, slot, generation: 2 };
        let tiles = ElevationSlot::of(&[tile(4), tile(1)]);
        assert_eq!(Slot::new(&SlotContent::Elevation(tiles)).read(), Some(SlotContent::Elevation(tiles)));
        assert_eq!(tiles.tiles().collect::<Vec<_>>(), [tile(4), tile(1)]);
    }

    #[test]
    fn a_slot_of_no_kind_says_nothing() {
        assert_eq!(Slot::zeroed().read(), None);
    }
}
