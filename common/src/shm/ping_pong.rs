//! The ping-pong buffer: the generator fills one half with a truncated quad tree while the preparer
//! reads the other. Neither copies. It is a ring of two items, each read and written in place.

use super::control::Control;
use super::cursor::{Positions, ReadCursor, WriteCursor};
use super::error::{ShmError, WaitError};
use super::geometry::half_bytes;
use super::header::{Role, RoleClaim, Segment};
use super::kind::{SegmentKind, Stage};
use super::run_id::RunId;
use super::segments::open_segment;
use crate::ids::FrameNumber;
use crate::tree::{TreeHeader, TreeNode};
use std::ops::Deref;
use std::sync::Arc;

const HEADER_BYTES: u64 = size_of::<TreeHeader>() as u64;

/// Node capacity of a half.
fn node_capacity(segment: &Segment) -> Result<u32, ShmError> {
    let geometry = segment.geometry();
    let corrupt = |field, found, expected| Err(ShmError::corrupt(SegmentKind::PingPong, field, found, expected));
    if geometry.kind != SegmentKind::PingPong {
        return Err(ShmError::WrongKind { name: geometry.kind.name().to_owned(), kind: geometry.kind });
    }
    if geometry.capacity != 2 {
        return corrupt("the number of halves", geometry.capacity, "2");
    }
    let nodes = geometry.item_bytes.saturating_sub(HEADER_BYTES) / size_of::<TreeNode>() as u64;
    match u32::try_from(nodes) {
        Ok(nodes) if nodes > 0 && half_bytes(nodes.into()) == geometry.item_bytes => Ok(nodes),
        _ => corrupt("the size of a half", geometry.item_bytes, "a tree header and a number of nodes"),
    }
}

/// The generator's end.
#[derive(Debug)]
pub struct TreeWriter {
    segment: Arc<Segment>,
    cursor: WriteCursor,
    nodes: u32,
    _claim: RoleClaim,
}

impl TreeWriter {
    /// Opens the writing end; waits a short time for the segment to become ready. A half that a
    /// killed generator had begun was never published, and is written again.
    ///
    /// # Errors
    /// See [`ShmError`].
    pub fn open(run: &RunId) -> Result<Self, ShmError> {
        Self::attach(&open_segment(run, SegmentKind::PingPong)?)
    }

    pub(crate) fn attach(segment: &Arc<Segment>) -> Result<Self, ShmError> {
        let nodes = node_capacity(segment)?;
        let claim = RoleClaim::take(segment, Role::Writer)?;
        let cursor = WriteCursor::attach(segment.words(), SegmentKind::PingPong, 2)?;
        Ok(Self { segment: Arc::clone(segment), cursor, nodes, _claim: claim })
    }

    /// Maximum number of nodes of a tree.
    #[must_use]
    pub fn capacity(&self) -> u32 {
        self.nodes
    }

    /// Trees published since the run began, by this generator or earlier ones.
    #[must_use]
    pub fn published(&self) -> u64 {
        self.cursor.position()
    }

    /// The header of the last published tree, by this generator or the one before; `None` before
    /// the first.
    #[must_use]
    pub fn last_header(&self) -> Option<TreeHeader> {
        let offset = self.segment.item_offset(self.cursor.position().checked_sub(1)? & 1);
        // SAFETY: only the generator, which is us, ever changes a half; the position's Acquire
        // (SYNC ring.publish) made the writes of earlier generators visible.
        Some(unsafe { self.segment.region().read(offset) })
    }

    /// Waits for a free half, passes its nodes to `fill` (all [`TreeWriter::capacity`] of them,
    /// with the content of an earlier tree), and publishes the tree with the header that `fill`
    /// returns.
    ///
    /// # Errors
    /// The run ended; or the header counts more nodes than a half has, and nothing was published.
    pub fn write(
        &mut self,
        control: &Control,
        fill: impl FnOnce(&mut [TreeNode]) -> TreeHeader,
    ) -> Result<(), WaitError> {
        let mut half = self.begin(control)?;
        let header = fill(half.nodes_mut());
        half.publish(&header)?;
        Ok(())
    }

    /// Waits for a free half.
    ///
    /// # Errors
    /// The run ended, or the reader wrote an invalid value.
    pub fn begin(&mut self, control: &Control) -> Result<TreeHalf<'_>, WaitError> {
        let cursor = &mut self.cursor;
        let positions: &Positions = self.segment.words();
        control.wait_for(positions.writable(), Some(Stage::Preparer), || {
            Ok((cursor.room(positions, 1)? > 0).then_some(()))
        })?;
        Ok(TreeHalf { writer: self })
    }
}

/// A half that is being filled. If dropped without [`TreeHalf::publish`], nothing happens.
#[derive(Debug)]
#[must_use]
pub struct TreeHalf<'a> {
    writer: &'a mut TreeWriter,
}

impl TreeHalf<'_> {
    fn offset(&self) -> u64 {
        self.writer.segment.item_offset(self.writer.cursor.position() & 1)
    }

    /// All nodes of the half.
    pub fn nodes_mut(&mut self) -> &mut [TreeNode] {
        let offset = self.offset() + HEADER_BYTES;
        // SAFETY: the half is ours: `begin` found it released, and it is not published. The slice
        // borrows `self`, of which there is only one.
        unsafe { self.writer.segment.region().slice_mut(offset, self.writer.nodes.into()) }
    }

    /// Makes the tree visible to the reader.
    ///
    /// # Errors
    /// [`ShmError::Corrupt`] when the header counts more nodes than a half has; then nothing is
    /// published.
    pub fn publish(self, header: &TreeHeader) -> Result<(), ShmError> {
        check_count(header, self.writer.nodes)?;
        let offset = self.offset();
        let writer = self.writer;
        // SAFETY: the half is ours, as in `nodes_mut`.
        unsafe { writer.segment.region().write(offset, header) }
        writer.cursor.publish(writer.segment.words(), 1);
        Ok(())
    }
}

fn check_count(header: &TreeHeader, nodes: u32) -> Result<(), ShmError> {
    if header.node_count <= nodes {
        return Ok(());
    }
    let found = header.node_count.into();
    Err(ShmError::corrupt(SegmentKind::PingPong, "the number of nodes", found, "at most the nodes of a half"))
}

/// The preparer's end.
#[derive(Debug)]
pub struct TreeReader {
    segment: Arc<Segment>,
    cursor: ReadCursor,
    nodes: u32,
    _claim: RoleClaim,
}

impl TreeReader {
    /// Opens the reading end; waits a short time for the segment to become ready. A tree that a
    /// killed preparer had not released is read again.
    ///
    /// # Errors
    /// See [`ShmError`].
    pub fn open(run: &RunId) -> Result<Self, ShmError> {
        Self::attach(&open_segment(run, SegmentKind::PingPong)?)
    }

    pub(crate) fn attach(segment: &Arc<Segment>) -> Result<Self, ShmError> {
        let nodes = node_capacity(segment)?;
        let claim = RoleClaim::take(segment, Role::Reader)?;
        let cursor = ReadCursor::attach(segment.words(), SegmentKind::PingPong, 2)?;
        Ok(Self { segment: Arc::clone(segment), cursor, nodes, _claim: claim })
    }

    /// Maximum number of nodes of a tree.
    #[must_use]
    pub fn capacity(&self) -> u32 {
        self.nodes
    }

    /// Trees released since the run began, by this preparer or earlier ones.
    #[must_use]
    pub fn returned(&self) -> u64 {
        self.cursor.position()
    }

    /// Waits for the next tree. The number of nodes is checked; the caller has to check the content
    /// of nodes ([`TreeNode::children`], [`TreeNode::id`]).
    ///
    /// # Errors
    /// The run ended, or the writer wrote an invalid value.
    pub fn next(&mut self, control: &Control) -> Result<TreeGuard<'_>, WaitError> {
        let cursor = &mut self.cursor;
        let positions: &Positions = self.segment.words();
        control.wait_for(positions.readable(), Some(Stage::Generator), || {
            Ok((cursor.filled(positions)? > 0).then_some(()))
        })?;
        Ok(self.guard()?)
    }

    /// The next tree, if there is one.
    ///
    /// # Errors
    /// [`ShmError::Corrupt`] when the writer wrote an invalid value.
    pub fn try_next(&mut self) -> Result<Option<TreeGuard<'_>>, ShmError> {
        if self.cursor.filled(self.segment.words())? == 0 {
            return Ok(None);
        }
        self.guard().map(Some)
    }

    /// Releases the next tree unread, if there is one and it belongs to this frame.
    ///
    /// # Errors
    /// [`ShmError::Corrupt`] when the writer wrote an invalid value.
    pub fn return_tree_of(&mut self, frame: FrameNumber) -> Result<(), ShmError> {
        if self.cursor.filled(self.segment.words())? > 0 {
            let offset = self.segment.item_offset(self.cursor.position() & 1);
            // SAFETY: the half is ours, as in `guard`.
            let header: TreeHeader = unsafe { self.segment.region().read(offset) };
            if header.frame == frame.get() {
                self.cursor.release(self.segment.words(), 1);
            }
        }
        Ok(())
    }

    fn guard(&mut self) -> Result<TreeGuard<'_>, ShmError> {
        let offset = self.segment.item_offset(self.cursor.position() & 1);
        // SAFETY: the half is ours: `filled` found it published, and it is not released before the
        // guard's drop.
        let header: TreeHeader = unsafe { self.segment.region().read(offset) };
        check_count(&header, self.nodes)?;
        Ok(TreeGuard { reader: self, header })
    }
}

/// A tree in its half, which is released to the generator when the guard is dropped. Derefs to the
/// nodes.
#[derive(Debug)]
pub struct TreeGuard<'a> {
    reader: &'a mut TreeReader,
    header: TreeHeader,
}

impl TreeGuard<'_> {
    /// The header of the tree: a copy, with a checked number of nodes.
    #[must_use]
    pub fn header(&self) -> &TreeHeader {
        &self.header
    }

    /// The nodes, in place.
    #[must_use]
    pub fn nodes(&self) -> &[TreeNode] {
        let reader = &*self.reader;
        let offset = reader.segment.item_offset(reader.cursor.position() & 1) + HEADER_BYTES;
        // SAFETY: the half is ours until the drop; the count was checked, and is our copy.
        unsafe { reader.segment.region().slice(offset, self.header.node_count.into()) }
    }
}

impl Deref for TreeGuard<'_> {
    type Target = [TreeNode];

    fn deref(&self) -> &[TreeNode] {
        self.nodes()
    }
}

impl Drop for TreeGuard<'_> {
    fn drop(&mut self) {
        let reader = &mut *self.reader;
        reader.cursor.release(reader.segment.words(), 1);
    }
}
