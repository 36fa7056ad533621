//! What one call of a technique draws: some of a frame's tiles, as one of its views sees them.

use terravision_common::slot::TileSlot;

/// Some of the tiles of a frame, near to far: their numbers among [`crate::frame::Frame::tiles`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TileSubset<'a> {
    /// The numbers.
    pub numbers: &'a [u32],
}

impl<'a> TileSubset<'a> {
    /// The tiles, each with its number. Numbers of no tile are passed over.
    pub fn of(self, tiles: &'a [TileSlot]) -> impl Iterator<Item = (usize, &'a TileSlot)> + Clone {
        self.numbers.iter().filter_map(move |&number| Some((number as usize, tiles.get(number as usize)?)))
    }
}

/// One call of a technique. Several of them, of one technique or of several, share a view's picture
/// and its depth: each pixel shows what is nearest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Draw<'a> {
    /// Its number among all draws of the frame, by which its time comes back
    /// ([`crate::gpu::FrameRecording::timed`]).
    pub number: usize,
    /// Which view of the frame, from 0.
    pub view: usize,
    /// What is drawn.
    pub tiles: TileSubset<'a>,
}
