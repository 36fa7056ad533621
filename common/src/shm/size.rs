//! Sizes of pictures in the words of public segments: two numbers of 32 bits, the width first in
//! memory.

/// A width and a height as one word.
pub(super) fn pack_size([width, height]: [u32; 2]) -> u64 {
    u64::from(width) | u64::from(height) << 32
}

/// The width and the height of a word.
pub(super) fn unpack_size(word: u64) -> [u32; 2] {
    [word as u32, (word >> 32) as u32]
}
