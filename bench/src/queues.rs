//! The queues between processes: how long a hand-over takes, how much passes.
//!
//! This process writes, a child process reads. Both read one clock. For hand-overs the reader
//! acknowledges each thing and only then the next is written, so no latency is time spent in a
//! queue. *Hot* is a reader that has just begun to wait; *asleep* is one that has waited for
//! milliseconds and sleeps on the futex, as a renderer does that waits for a slow preparer.

use crate::cli::{Queue, ReaderArgs};
use crate::measurement::{Measurement, Target, median, quantile};
use crate::session::sibling;
use anyhow::{Context, bail, ensure};
use bytemuck::Zeroable;
use std::io::{Read, Write};
use std::process::{Child, Command, Stdio};
use std::time::Duration;
use terravision_common::event::{Event, monotonic_nanos};
use terravision_common::shm::{
    Consumer, Control, Layout, Producer, RunId, RunSegments, RunState, SegmentKind, Stage, TreeReader, TreeWriter,
};
use terravision_common::slot::{Slot, SlotContent, TileSlot};
use terravision_common::tree::{TreeHeader, TreeNode};

/// Hand-overs of each kind.
const HAND_OVERS: u64 = 2_000;
/// Of those with a pause: some milliseconds each.
const SLEEPS: u64 = 150;
const PAUSE: Duration = Duration::from_millis(3);
/// What a hand-over may cost: a thousandth of a frame or so.
const HAND_OVER: Target = Target::AtMost(20.0);

/// How much is passed by the throughput part.
#[derive(Debug, Clone, Copy)]
pub struct Load {
    /// Slots through the ring.
    pub slots: u64,
    /// Trees through the ping-pong buffer.
    pub trees: u64,
    /// Nodes of each tree.
    pub nodes: u32,
}

impl Default for Load {
    fn default() -> Self {
        Self { slots: 2_000_000, trees: 3_000, nodes: 1_500 }
    }
}

/// What the child found, in the order of the things it read.
#[derive(Debug)]
struct Received {
    latencies_us: Vec<f64>,
    checksum: u64,
}

/// Measures both queues.
///
/// # Errors
/// When the run cannot be made, or the child read other things than were written.
pub fn run(load: Load) -> anyhow::Result<Vec<Measurement>> {
    let mut found = Vec::new();
    for queue in [Queue::Ring, Queue::PingPong] {
        let hot = hand_over(queue, HAND_OVERS, Duration::ZERO)?;
        let asleep = hand_over(queue, SLEEPS, PAUSE)?;
        for (how, latencies) in [("hot", &hot), ("asleep", &asleep)] {
            let name = format!("{} hand-over, reader {how}", queue.name());
            let samples = latencies.len() as u64;
            let middle = Measurement::new("queues", format!("{name}, median"), median(latencies), "us", samples);
            found.push(if how == "hot" { middle.with_target(HAND_OVER) } else { middle });
            found.push(Measurement::new("queues", format!("{name}, p99"), quantile(latencies, 0.99), "us", samples));
        }
    }
    found.push(slots_per_second(load.slots)?);
    found.push(trees_per_second(load.trees, load.nodes)?);
    Ok(found)
}

/// A run of two processes with the small segments that the queues need.
struct Pair {
    run: RunId,
    control: Control,
    child: Child,
    _segments: RunSegments,
}

impl Pair {
    fn start(queue: Queue, count: u64, is_acknowledged: bool) -> anyhow::Result<Self> {
        // Unlike the launcher, a bench has several runs, in tests at the same time.
        let run = RunId::unique_for_tests();
        let layout = Layout::small().with_room(8192, 65_536);
        let segments = RunSegments::create(&run, &layout).context("cannot make the segments")?;
        let control = Control::open(&run).context("cannot open the control block")?;
        let program = sibling("terravision-bench")?;
        let mut command = Command::new(program);
        command.args(["reader", "--run", &run.to_string(), "--queue", queue.name(), "--count", &count.to_string()]);
        if is_acknowledged {
            command.arg("--acknowledge");
        }
        let child = command.stdout(Stdio::piped()).stdin(Stdio::null()).spawn().context("cannot start the reader")?;
        Ok(Self { run, control, child, _segments: segments })
    }

    /// What the child found, when it has read everything.
    fn finish(mut self, count: u64) -> anyhow::Result<Received> {
        let mut bytes = Vec::new();
        if let Some(mut stdout) = self.child.stdout.take() {
            stdout.read_to_end(&mut bytes).context("cannot read what the reader found")?;
        }
        let status = self.child.wait().context("cannot wait for the reader")?;
        ensure!(status.success(), "the reader ended with {status}");
        let (words, rest) = bytes.as_chunks::<8>();
        ensure!(
            words.len() as u64 == count + 1 && rest.is_empty(),
            "the reader read {} things of {count}",
            words.len()
        );
        let numbers: Vec<u64> = words.iter().map(|word| u64::from_le_bytes(*word)).collect();
        let latencies_us = numbers[..count as usize].iter().map(|nanos| *nanos as f64 / 1e3).collect();
        Ok(Received { latencies_us, checksum: numbers[count as usize] })
    }
}

impl Drop for Pair {
    fn drop(&mut self) {
        self.control.set_state(RunState::Stopping);
        // It ends by itself, or has ended: an error says the latter.
        drop(self.child.wait());
    }
}

fn tile(k: u64) -> Slot {
    Slot::new(&SlotContent::Tile(TileSlot { node: monotonic_nanos(), elevation_position: k, ..TileSlot::zeroed() }))
}

fn hand_over(queue: Queue, count: u64, pause: Duration) -> anyhow::Result<Vec<f64>> {
    let pair = Pair::start(queue, count, true)?;
    let mut events = Consumer::<Event>::open(&pair.run, SegmentKind::EventsRenderer)?;
    // The reader says by its first event that it is there, by the others that it has read.
    let mut ready = || {
        events.pop(&pair.control).context("the reader went away")?;
        std::thread::sleep(pause);
        anyhow::Ok(())
    };
    match queue {
        Queue::Ring => {
            let mut ring = Producer::<Slot>::open(&pair.run, SegmentKind::Ring)?;
            for k in 0..count {
                ready()?;
                ring.push(&tile(k), &pair.control)?;
            }
        }
        Queue::PingPong => {
            let mut trees = TreeWriter::open(&pair.run)?;
            for k in 0..count {
                ready()?;
                trees.write(&pair.control, |_| header(k, 0))?;
            }
        }
    }
    Ok(pair.finish(count)?.latencies_us)
}

/// The child says by an event that it is ready.
fn wait_for_reader(pair: &Pair) -> anyhow::Result<()> {
    let mut events = Consumer::<Event>::open(&pair.run, SegmentKind::EventsRenderer)?;
    events.pop(&pair.control).context("the reader did not come")?;
    Ok(())
}

fn header(frame: u64, node_count: u32) -> TreeHeader {
    TreeHeader { frame, node_count, finished_nanos: monotonic_nanos(), ..TreeHeader::zeroed() }
}

fn slots_per_second(count: u64) -> anyhow::Result<Measurement> {
    let pair = Pair::start(Queue::Ring, count, false)?;
    let mut ring = Producer::<Slot>::open(&pair.run, SegmentKind::Ring)?;
    wait_for_reader(&pair)?;
    let start = monotonic_nanos();
    let mut block = Vec::with_capacity(512);
    for k in 0..count {
        block.push(Slot::new(&SlotContent::Tile(TileSlot { elevation_position: k, ..TileSlot::zeroed() })));
        if block.len() == block.capacity() || k + 1 == count {
            ring.push_all(&block, &pair.control)?;
            block.clear();
        }
    }
    let received = pair.finish(count)?;
    let seconds = (monotonic_nanos() - start) as f64 / 1e9;
    ensure!(received.checksum == sum_to(count), "the ring lost or repeated slots");
    Ok(Measurement::new("queues", "slots through the ring", count as f64 / seconds, "slots/s", count))
}

fn trees_per_second(count: u64, nodes: u32) -> anyhow::Result<Measurement> {
    let pair = Pair::start(Queue::PingPong, count, false)?;
    let mut trees = TreeWriter::open(&pair.run)?;
    wait_for_reader(&pair)?;
    let start = monotonic_nanos();
    for k in 0..count {
        trees.write(&pair.control, |out| {
            for (node, n) in out.iter_mut().zip(0..nodes) {
                *node = TreeNode { node: u64::from(n) + k, ..TreeNode::zeroed() };
            }
            header(k, nodes)
        })?;
    }
    let received = pair.finish(count)?;
    let seconds = (monotonic_nanos() - start) as f64 / 1e9;
    let expected = sum_to(count).wrapping_mul(u64::from(nodes)).wrapping_add(sum_to(nodes.into()).wrapping_mul(count));
    ensure!(received.checksum == expected, "the ping-pong buffer lost or repeated trees");
    let name = format!("trees of {nodes} nodes through the ping-pong buffer");
    Ok(Measurement::new("queues", name, count as f64 / seconds, "trees/s", count))
}

/// 0 + 1 + … + (n - 1).
fn sum_to(n: u64) -> u64 {
    n.wrapping_mul(n.wrapping_sub(1)) / 2
}

/// The child process: reads things, then writes each one's latency (nanoseconds) and a checksum of
/// all to `out`, 8 bytes each, little endian.
///
/// # Errors
/// When the run cannot be opened or ends early.
pub fn read(arguments: &ReaderArgs, out: &mut impl Write) -> anyhow::Result<()> {
    let ReaderArgs { run, queue, count, acknowledge } = arguments;
    let (count, acknowledge) = (*count, *acknowledge);
    let run = RunId::parse(run).context("--run is not the id of a run")?;
    let control = Control::open(&run)?;
    control.register(Stage::Renderer)?;
    let mut events = Producer::<Event>::open(&run, SegmentKind::EventsRenderer)?;
    let mut latencies = Vec::with_capacity(count as usize);
    let mut checksum = 0u64;
    match *queue {
        Queue::Ring => {
            let mut ring = Consumer::<Slot>::open(&run, SegmentKind::Ring)?;
            events.push(&Event::zeroed(), &control)?;
            for _ in 0..count {
                let slot = ring.pop(&control)?;
                let now = monotonic_nanos();
                let Some(SlotContent::Tile(tile)) = slot.read() else { bail!("a slot of another kind came out") };
                latencies.push(now.saturating_sub(tile.node));
                checksum = checksum.wrapping_add(tile.elevation_position);
                if acknowledge {
                    events.push(&Event::zeroed(), &control)?;
                }
            }
        }
        Queue::PingPong => {
            let mut trees = TreeReader::open(&run)?;
            events.push(&Event::zeroed(), &control)?;
            for _ in 0..count {
                let tree = trees.next(&control)?;
                latencies.push(monotonic_nanos().saturating_sub(tree.header().finished_nanos));
                checksum = tree.iter().fold(checksum, |sum, node| sum.wrapping_add(node.node));
                drop(tree);
                if acknowledge {
                    events.push(&Event::zeroed(), &control)?;
                }
            }
        }
    }
    for latency in latencies {
        out.write_all(&latency.to_le_bytes())?;
    }
    out.write_all(&checksum.to_le_bytes())?;
    Ok(())
}
