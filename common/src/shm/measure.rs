//! How long a hand-over takes from one process to another: what `terravision bench queues` and the example `hand_over`
//! run. One process makes the segments and calls [`receive`]; it starts another that calls [`send`] with the same
//! numbers. Messages carry the time at which they were sent, by the clock that all processes of a machine share.

use super::{
    CameraRecord, Consumer, Control, Producer, RunId, SegmentKind, ShmError, TreeReader, TreeWriter, WaitError,
};
use crate::event::monotonic_nanos;
use crate::slot::{FrameEnd, Slot, SlotContent};
use crate::tree::{TreeHeader, TreeNode};
use bytemuck::Zeroable;
use std::time::Duration;

/// What is measured, the same on both sides.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Plan {
    /// Messages of each kind.
    pub rounds: u32,
    /// The sender rests so long before each message. With a millisecond the receiver sleeps when it comes, as a stage
    /// does that is faster than the one before it; without a rest it never sleeps.
    pub pause: Duration,
    /// Slots pushed together in the measurement of throughput, as a frame's are.
    pub batch: u32,
}

/// Nanoseconds from just before the write of a message to just after its read, sorted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Latencies {
    sorted_nanos: Vec<u64>,
}

impl Latencies {
    fn of(mut nanos: Vec<u64>) -> Self {
        nanos.sort_unstable();
        Self { sorted_nanos: nanos }
    }

    /// The latency that a share `p` (0 to 1) of the messages did not exceed, nanoseconds; 0 without messages.
    #[must_use]
    pub fn percentile(&self, p: f64) -> u64 {
        let last = self.sorted_nanos.len().saturating_sub(1);
        let index = (p.clamp(0.0, 1.0) * last as f64).round() as usize;
        self.sorted_nanos.get(index).copied().unwrap_or(0)
    }

    /// Number of messages.
    #[must_use]
    pub fn count(&self) -> usize {
        self.sorted_nanos.len()
    }
}

/// What [`receive`] found.
#[derive(Debug, Clone, PartialEq)]
pub struct HandOver {
    /// One slot through the ring.
    pub ring: Latencies,
    /// One tree through the ping-pong buffer; it is not copied, so its size does not matter.
    pub ping_pong: Latencies,
    /// Slots per second through the ring, pushed in batches, 64 times `rounds` of them.
    pub slots_per_second: f64,
}

/// Sends what [`receive`] waits for.
///
/// # Errors
/// The segments cannot be opened, or the run ended.
pub fn send(run: &RunId, plan: Plan) -> Result<(), WaitError> {
    let control = Control::open(run)?;
    let mut ring = Producer::<Slot>::open(run, SegmentKind::Ring)?;
    let mut trees = TreeWriter::open(run)?;
    let mut go = Consumer::<CameraRecord>::open(run, SegmentKind::CameraRing)?;
    go.pop(&control)?;
    for _ in 0..plan.rounds {
        std::thread::sleep(plan.pause);
        let slot = Slot::new(&SlotContent::End(FrameEnd { frame: monotonic_nanos(), ..FrameEnd::zeroed() }));
        ring.push(&slot, &control)?;
    }
    go.pop(&control)?;
    for _ in 0..plan.rounds {
        std::thread::sleep(plan.pause);
        let mut half = trees.begin(&control)?;
        if let Some(root) = half.nodes_mut().first_mut() {
            *root = TreeNode::zeroed();
        }
        half.publish(&TreeHeader { node_count: 1, finished_nanos: monotonic_nanos(), ..TreeHeader::zeroed() })?;
    }
    go.pop(&control)?;
    let batch = vec![Slot::new(&SlotContent::End(FrameEnd::zeroed())); plan.batch.max(1) as usize];
    let mut rest = throughput_slots(plan);
    while rest > 0 {
        let count = rest.min(batch.len());
        ring.push_all(&batch[..count], &control)?;
        rest -= count;
    }
    Ok(())
}

fn throughput_slots(plan: Plan) -> usize {
    plan.rounds as usize * 64
}

/// Receives what [`send`] sends, in another process.
///
/// # Errors
/// The segments cannot be opened, the run ended, or the sender sent something else.
pub fn receive(run: &RunId, plan: Plan) -> Result<HandOver, WaitError> {
    let control = Control::open(run)?;
    let mut ring = Consumer::<Slot>::open(run, SegmentKind::Ring)?;
    let mut trees = TreeReader::open(run)?;
    let mut go = Producer::<CameraRecord>::open(run, SegmentKind::CameraRing)?;

    let mut nanos = Vec::with_capacity(plan.rounds as usize);
    go.push(&CameraRecord::zeroed(), &control)?;
    for _ in 0..plan.rounds {
        let slot = ring.pop(&control)?;
        let now = monotonic_nanos();
        let Some(SlotContent::End(end)) = slot.read() else {
            return Err(ShmError::corrupt(SegmentKind::Ring, "a slot", 0, "a frame end").into());
        };
        nanos.push(now.saturating_sub(end.frame));
    }
    let ring_latencies = Latencies::of(nanos);

    let mut nanos = Vec::with_capacity(plan.rounds as usize);
    go.push(&CameraRecord::zeroed(), &control)?;
    for _ in 0..plan.rounds {
        let tree = trees.next(&control)?;
        nanos.push(monotonic_nanos().saturating_sub(tree.header().finished_nanos));
    }
    let ping_pong = Latencies::of(nanos);

    go.push(&CameraRecord::zeroed(), &control)?;
    let start = monotonic_nanos();
    for _ in 0..throughput_slots(plan) {
        ring.pop(&control)?;
    }
    let elapsed = Duration::from_nanos(monotonic_nanos().saturating_sub(start).max(1));
    let slots_per_second = throughput_slots(plan) as f64 / elapsed.as_secs_f64();
    Ok(HandOver { ring: ring_latencies, ping_pong, slots_per_second })
}
