//! Unproven intervals: parts of a ray that no other ray proves to be in the air.

/// Intervals of distances from the eye.
pub(crate) const RINGS: usize = 64;
/// Rings per doubling of the distance.
const RINGS_PER_OCTAVE: usize = 4;

/// Distance at which each ring ends, in units of the end of ring 0.
pub(crate) const RING_ENDS: [f32; RINGS] = ring_ends();

const fn ring_ends() -> [f32; RINGS] {
    // Powers of the fourth root of 2.
    let within_octave = [1.0, 1.189_207_1, std::f32::consts::SQRT_2, 1.681_792_9];
    let mut ends = [1.0; RINGS];
    let (mut ring, mut octave) = (0, 1.0);
    while ring < RINGS {
        ends[ring] = octave * within_octave[ring % RINGS_PER_OCTAVE];
        ring += 1;
        if ring % RINGS_PER_OCTAVE == 0 {
            octave *= 2.0;
        }
    }
    ends
}

/// Intervals of a ray's parameter, as far as its witness is in the air, in order.
#[derive(Debug, Clone, Copy)]
pub struct Unproven {
    /// One bit for each ring.
    rings: u64,
    /// Parameter of the end of ring 0, of the ray that reaches it first (for where an interval
    /// begins) and of the ray that reaches it last (for where it ends).
    first: f32,
    last: f32,
}

impl Unproven {
    /// No interval: all is proven.
    pub const NONE: Self = Self { rings: 0, first: 0.0, last: 0.0 };

    /// The rings of these bits.
    #[inline(always)]
    pub(super) fn new(rings: u64, first: f32, last: f32) -> Self {
        Self { rings, first, last }
    }

    /// How many rings are unproven.
    #[inline(always)]
    pub(super) fn ring_count(&self) -> u32 {
        self.rings.count_ones()
    }
}

impl Iterator for Unproven {
    type Item = [f32; 2];

    #[inline(always)]
    fn next(&mut self) -> Option<[f32; 2]> {
        if self.rings == 0 {
            return None;
        }
        let from = self.rings.trailing_zeros();
        let count = (self.rings >> from).trailing_ones();
        let to = from + count;
        self.rings = if to >= 64 { 0 } else { self.rings >> to << to };
        let begin = if from == 0 { 0.0 } else { self.first * RING_ENDS[from as usize - 1] };
        // The last ring has no end.
        let end = if to as usize >= RINGS { f32::INFINITY } else { self.last * RING_ENDS[to as usize - 1] };
        Some([begin, end])
    }
}
