//! Memory of this process that a device may import: whole pages with an owner that keeps them
//! mapped.

use std::alloc::{Layout, alloc_zeroed, dealloc, handle_alloc_error};
use std::fmt;
use std::ptr::NonNull;
use std::sync::Arc;
use terravision_common::shm::SegmentMemory;

/// Page size of the architectures that we run on, and the alignment that drivers ask of imported
/// memory.
const PAGE: usize = 4096;

/// Pages that are mapped as long as the value (or a clone) lives.
///
/// Shared bytes are never borrowed as a slice through this type: another process may be writing
/// them.
#[derive(Clone)]
pub struct HostMemory {
    start: NonNull<u8>,
    len: usize,
    /// Whether the pages are this process's own and nobody writes them any more.
    is_constant: bool,
    _owner: Arc<dyn Send + Sync>,
}

// SAFETY: the pointer is only handed out within `gpu`, which passes it to Vulkan and copies from
// it; the owner behind the `Arc` is `Send + Sync` and keeps the pages mapped on every thread.
unsafe impl Send for HostMemory {}
// SAFETY: as above; a reference to the bytes is given out only when nobody writes them.
unsafe impl Sync for HostMemory {}

impl HostMemory {
    /// A segment of shared memory; `None` when it is empty. The handle keeps it mapped.
    #[must_use]
    pub fn of_segment(segment: SegmentMemory) -> Option<Self> {
        let start = NonNull::new(segment.as_ptr()).filter(|_| !segment.is_empty())?;
        let len = usize::try_from(segment.len()).ok()?;
        Some(Self { start, len, is_constant: false, _owner: Arc::new(segment) })
    }

    /// Fresh pages with `content` at their start; the rest is zero.
    #[must_use]
    pub fn copy_of(content: &[u8]) -> Self {
        let pages = Arc::new(Pages::new(content.len()));
        // SAFETY: `Pages` has at least `content.len()` bytes, fresh and so not overlapping.
        unsafe { pages.start.copy_from_nonoverlapping(NonNull::from(content).cast(), content.len()) };
        Self { start: pages.start, len: pages.layout.size(), is_constant: true, _owner: pages }
    }

    /// The bytes, when nobody writes them ([`HostMemory::copy_of`]).
    #[must_use]
    pub fn constant_bytes(&self) -> Option<&[u8]> {
        // SAFETY: mapped for `len` bytes while `self` lives; `copy_of` was the last to write them,
        // and a device that imports them only reads (imported buffers are storage buffers declared
        // `read`, or sources of copies).
        self.is_constant.then(|| unsafe { std::slice::from_raw_parts(self.start.as_ptr(), self.len) })
    }

    /// Number of bytes.
    #[must_use]
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there is nothing.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Where it starts.
    pub(super) fn start(&self) -> NonNull<u8> {
        self.start
    }
}

impl fmt::Debug for HostMemory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("HostMemory").field("len", &self.len).finish_non_exhaustive()
    }
}

struct Pages {
    start: NonNull<u8>,
    layout: Layout,
}

// SAFETY: plain memory that this value alone owns.
unsafe impl Send for Pages {}
// SAFETY: as above; it gives out no references.
unsafe impl Sync for Pages {}

impl Pages {
    fn new(len: usize) -> Self {
        let layout = Layout::from_size_align(len.max(1).next_multiple_of(PAGE), PAGE)
            .expect("a slice's length rounded up to a page fits in isize");
        // SAFETY: the size is not zero.
        let start = NonNull::new(unsafe { alloc_zeroed(layout) }).unwrap_or_else(|| handle_alloc_error(layout));
        Self { start, layout }
    }
}

impl Drop for Pages {
    fn drop(&mut self) {
        // SAFETY: allocated in `new` with this layout.
        unsafe { dealloc(self.start.as_ptr(), self.layout) };
    }
}
