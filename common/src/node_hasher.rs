//! The hash of maps from nodes.

use std::hash::Hasher;

/// Hash of a packed node id: one multiplication. Ids do not come from an attacker, so collisions
/// cannot be provoked.
#[derive(Debug, Default, Clone, Copy)]
pub(crate) struct NodeHasher(u64);

impl Hasher for NodeHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.write_u64(byte.into());
        }
    }

    fn write_u64(&mut self, value: u64) {
        // 2^64 divided by the golden ratio, made odd (Knuth, The Art of Computer Programming 3,
        // 6.4). The upper half is mixed into the lower: the table takes bits from both ends.
        let product = (self.0 ^ value).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 = product ^ product >> 32;
    }
}
