//! Frames as the preparer put them into the ring, kept in memory, and played again.

use crate::flight::Flight;
use crate::session::{EventLog, Session, Settings};
use anyhow::{Context, bail, ensure};
use std::ops::Range;
use terravision_common::database::{TileScratch, TileSource};
use terravision_common::event::{Event, SpanName, monotonic_nanos};
use terravision_common::ids::{RingPosition, Sequence, SlotKey};
use terravision_common::node::NodeId;
use terravision_common::shm::{
    CameraRecord, Consumer, Control, ElevationReader, ElevationWriter, PoolWriter, Producer, Residency, RunId,
    RunState, SegmentKind, Stage, TreeReader, TreeWriter,
};
use terravision_common::slot::{Slot, SlotContent};
use terravision_common::tree::{TreeHeader, TreeNode};

/// Trees as the generator wrote them.
#[derive(Debug, Default)]
pub struct RecordedTrees {
    /// Header and nodes of each.
    pub trees: Vec<(TreeHeader, Vec<TreeNode>)>,
    /// Seconds that the generator took for them, alone.
    pub seconds: f64,
    /// Milliseconds of each.
    pub span_ms: Vec<f64>,
}

/// One recorded frame.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Frame {
    slots: Range<usize>,
    arrays: Range<usize>,
    /// Position that its first array had in the elevation ring.
    first_position: u64,
}

/// Frames as the preparer wrote them.
#[derive(Debug, Default)]
pub struct RecordedFrames {
    slots: Vec<Slot>,
    arrays: Vec<f32>,
    array_len: usize,
    frames: Vec<Frame>,
    /// Seconds that the preparer took for the measured round, alone.
    pub seconds: f64,
    /// Milliseconds of each frame of the measured round, waits for tiles left out.
    pub span_ms: Vec<f64>,
}

/// Runs the generator alone.
///
/// # Errors
/// When the run fails.
pub fn record_trees(settings: &Settings, flight: &Flight, rounds: u64) -> anyhow::Result<RecordedTrees> {
    let records = flight.records(rounds);
    let mut session = Session::new(settings, flight, records.len() as u64)?;
    let mut cameras = Producer::<CameraRecord>::open(session.run(), SegmentKind::CameraRing)?;
    let mut trees = TreeReader::open(session.run())?;
    let mut events = Consumer::<Event>::open(session.run(), Stage::Generator.events())?;
    session.start(Stage::Generator)?;
    let mut log = EventLog::default();
    let mut recorded = RecordedTrees::default();
    let mut start = 0;
    let mut fed = 0;
    while recorded.trees.len() < records.len() {
        fed += feed(&mut cameras, &records[fed..]);
        let mut is_idle = true;
        while let Some(tree) = trees.try_next()? {
            // The first tree pays for the start of the process.
            if recorded.trees.is_empty() {
                start = monotonic_nanos();
            }
            recorded.trees.push((*tree.header(), tree.to_vec()));
            is_idle = false;
        }
        log.drain(&mut events)?;
        if is_idle {
            session.check()?;
            std::thread::yield_now();
        }
    }
    recorded.seconds = (monotonic_nanos() - start) as f64 / 1e9;
    log.drain(&mut events)?;
    recorded.span_ms = log.span_ms(SpanName::Generate, 1);
    Ok(recorded)
}

/// Runs the preparer alone (with the prefetcher, which has nothing to do in the second round),
/// twice over the recorded round: what it does in the second, when all tiles are there, is measured
/// and kept.
///
/// # Errors
/// When the run fails.
pub fn record_frames(settings: &Settings, flight: &Flight, trees: &RecordedTrees) -> anyhow::Result<RecordedFrames> {
    let round = trees.trees.len();
    let total = 2 * round as u64;
    let mut session = Session::new(settings, flight, total)?;
    let run = *session.run();
    let mut writer = TreeWriter::open(&run)?;
    let mut ring = Consumer::<Slot>::open(&run, SegmentKind::Ring)?;
    let mut elevation = ElevationReader::open(&run)?;
    let mut events = Consumer::<Event>::open(&run, Stage::Preparer.events())?;
    session.start(Stage::Prefetcher)?;
    session.start(Stage::Preparer)?;
    let control = Control::open(&run)?;
    let mut recorded = RecordedFrames { array_len: elevation.array_len() as usize, ..RecordedFrames::default() };
    let mut log = EventLog::default();
    let mut start = 0;
    std::thread::scope(|scope| {
        let writing = scope.spawn(move || {
            for frame in 0..total {
                let (header, nodes) = &trees.trees[frame as usize % round];
                writer.write(&control, |out| {
                    out[..nodes.len()].copy_from_slice(nodes);
                    TreeHeader { frame, ..*header }
                })?;
            }
            anyhow::Ok(())
        });
        let mut read = || {
            for sequence in 1..=total {
                if sequence == round as u64 + 1 {
                    start = monotonic_nanos();
                }
                let is_kept = sequence > round as u64;
                recorded.frame(&mut session, &mut ring, &mut elevation, is_kept)?;
                session.control().set_completed_sequence(Sequence::new(sequence));
                log.drain(&mut events)?;
            }
            anyhow::Ok(())
        };
        let result = read();
        if result.is_err() {
            session.control().set_state(RunState::Stopping);
        }
        let written = writing.join().map_err(|_panic| anyhow::anyhow!("the writer of trees panicked"))?;
        result.and(written)
    })?;
    recorded.seconds = (monotonic_nanos() - start) as f64 / 1e9;
    log.drain(&mut events)?;
    recorded.span_ms = log.span_ms(SpanName::Prepare, round as u64);
    Ok(recorded)
}

/// Pushes as many poses as fit, and returns their number.
pub fn feed(cameras: &mut Producer<CameraRecord>, records: &[CameraRecord]) -> usize {
    records.iter().take_while(|record| cameras.try_push(**record).is_ok()).count()
}

/// The node whose colour tile a slot uses.
fn color_node(flight: &Flight, tile: &terravision_common::slot::TileSlot) -> anyhow::Result<NodeId> {
    let side = flight.database.world().node_side(tile.color_level);
    let index = tile.color_origin.map(|c| (u64::from(c) / side) as u32);
    NodeId::new(index[0], index[1], tile.color_level).context("a slot names no node")
}

impl RecordedFrames {
    /// Number of frames.
    #[must_use]
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// Whether it is empty.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// Tile slots in all frames.
    #[must_use]
    pub fn tile_slots(&self) -> u64 {
        self.frames.iter().map(|frame| frame.slots.len() as u64 - 2).sum()
    }

    /// Elevation arrays in all frames.
    #[must_use]
    pub fn elevation_arrays(&self) -> u64 {
        self.frames.iter().map(|frame| frame.arrays.len() as u64).sum()
    }

    /// Numbers in an array.
    #[must_use]
    pub fn array_len(&self) -> usize {
        self.array_len
    }

    /// All arrays, one after the other.
    #[must_use]
    pub fn arrays(&self) -> &[f32] {
        &self.arrays
    }

    /// Reads one frame out of the ring and gives its arrays back.
    fn frame(
        &mut self,
        session: &mut Session,
        ring: &mut Consumer<Slot>,
        elevation: &mut ElevationReader,
        is_kept: bool,
    ) -> anyhow::Result<()> {
        let first_slot = self.slots.len();
        let first_array = self.arrays.len();
        let first_position = elevation.released_position().get();
        loop {
            let slot = loop {
                if let Some(slot) = ring.try_pop()? {
                    break slot;
                }
                session.check()?;
                std::thread::yield_now();
            };
            if is_kept {
                self.slots.push(slot);
            }
            match slot.read() {
                Some(SlotContent::End(end)) => {
                    for position in elevation.released_position().get()..end.elevation_end {
                        let array = elevation.read_array(position)?.context("an array is not where it should be")?;
                        if is_kept {
                            self.arrays.extend_from_slice(array);
                        }
                    }
                    elevation.released(RingPosition::new(end.elevation_end))?;
                    ensure!(end.unavailable_count == 0, "a tile of the database cannot be read");
                    break;
                }
                Some(_) => {}
                None => bail!("the preparer wrote a slot of no kind"),
            }
        }
        if is_kept {
            let arrays = first_array / self.array_len..self.arrays.len() / self.array_len;
            self.frames.push(Frame { slots: first_slot..self.slots.len(), arrays, first_position });
        }
        Ok(())
    }

    /// Plays `rounds` rounds into the rings and pools of a run in which only the renderer runs.
    /// Returns when everything is in the rings.
    ///
    /// # Errors
    /// When the run ends early.
    pub fn play(&self, run: &RunId, control: &Control, flight: &Flight, rounds: u64) -> anyhow::Result<()> {
        let mut ring = Producer::<Slot>::open(run, SegmentKind::Ring)?;
        let mut elevation = ElevationWriter::open(run)?;
        let mut pool = PoolWriter::open(run, SegmentKind::ColorPool)?;
        let mut scratch = TileScratch::default();
        let mut block = Vec::new();
        for sequence in 1..=rounds * self.frames.len() as u64 {
            let frame = &self.frames[(sequence as usize - 1) % self.frames.len()];
            let first_position = elevation.next_position();
            block.clear();
            for slot in &self.slots[frame.slots.clone()] {
                let content = match slot.read().context("a recorded slot is of no kind")? {
                    SlotContent::Marker(mut marker) => {
                        marker.frame = sequence - 1;
                        marker.sequence = sequence;
                        marker.elevation_start = first_position;
                        SlotContent::Marker(marker)
                    }
                    SlotContent::View(view) => SlotContent::View(view),
                    SlotContent::Elevation(_) => bail!("frames of elevation tiles in place cannot be replayed"),
                    SlotContent::Tile(mut tile) => {
                        tile.elevation_position = tile.elevation_position - frame.first_position + first_position;
                        let node = color_node(flight, &tile)?;
                        let key = resident(&mut pool, control, flight, node, Sequence::new(sequence), &mut scratch)?;
                        SlotContent::Tile(tile.with_color(key))
                    }
                    SlotContent::End(mut end) => {
                        end.frame = sequence - 1;
                        end.elevation_end = first_position + frame.arrays.len() as u64;
                        SlotContent::End(end)
                    }
                };
                block.push(Slot::new(&content));
            }
            for array in frame.arrays.clone() {
                let mut out = elevation.begin(control)?;
                out.copy_from_slice(&self.arrays[array * self.array_len..][..self.array_len]);
                out.publish();
            }
            ring.push_all(&block, control)?;
        }
        Ok(())
    }
}

/// Where a node's colour tile lies; it is loaded if need be.
fn resident(
    pool: &mut PoolWriter,
    control: &Control,
    flight: &Flight,
    node: NodeId,
    sequence: Sequence,
    scratch: &mut TileScratch,
) -> anyhow::Result<SlotKey> {
    loop {
        if let Residency::Resident { key } = pool.touch_node(node, sequence) {
            return Ok(key);
        }
        let completed = control.completed_sequence();
        if let Some(mut guard) = pool.allocate(node, sequence, completed) {
            flight.database.read_color(node, guard.bytes_mut(), scratch)?;
            return Ok(guard.publish());
        }
        control.wait_completed(completed.next())?;
    }
}
