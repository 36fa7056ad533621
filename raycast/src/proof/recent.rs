//! The rays of a line that were cast last: possible witnesses of the next one.

/// The last rays, from whichever the next one may take over its start.
#[derive(Debug)]
pub(crate) struct Recent<K> {
    rays: [Option<K>; MOST],
    next: usize,
}

/// Rays below that are tried. Two pixels of a scan-converted line, a few apart, lie more nearly
/// above each other the further apart they are. (Measured; see `docs/techniques.md`, *Thresholds*.)
const MOST: usize = 4;

impl<K: Copy> Recent<K> {
    /// None yet.
    pub(crate) fn new() -> Self {
        Self { rays: [None; MOST], next: 0 }
    }

    /// Adds a ray; `None` for one that proves nothing.
    #[inline(always)]
    pub(crate) fn push(&mut self, ray: Option<K>) {
        self.rays[self.next] = ray;
        self.next = (self.next + 1) % MOST;
    }

    /// Those that prove something of the last `count`, the nearest first.
    #[inline(always)]
    pub(crate) fn nearest_first(&self, count: usize) -> impl Iterator<Item = K> + '_ {
        (1..=count.min(MOST)).filter_map(|back| self.rays[(self.next + MOST - back) % MOST])
    }
}
