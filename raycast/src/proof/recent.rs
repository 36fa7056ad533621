//! The last rays that were cast of a line: possible witnesses of the next one.

/// The last rays; the next one may take its start from any of them.
#[derive(Debug)]
pub(crate) struct Recent<K> {
    rays: [Option<K>; MOST],
    next: usize,
}

/// How many rays below are tried. The farther apart two nearby pixels of a scan-converted line are,
/// the more nearly they lie above each other. (Measured; see `docs/techniques.md`, *Thresholds*.)
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

    /// Those of the last `count` rays that prove something, the nearest first.
    #[inline(always)]
    pub(crate) fn nearest_first(&self, count: usize) -> impl Iterator<Item = K> + '_ {
        (1..=count.min(MOST)).filter_map(|back| self.rays[(self.next + MOST - back) % MOST])
    }
}
