//! The bytes of a segment: a shared mapping, or private memory of this process. Every access is
//! checked against the length here; no other file of this module computes an address.

use super::error::ShmError;
use super::large_pages::LargePages;
use bytemuck::Pod;
use std::alloc::{Layout as HeapLayout, alloc_zeroed, dealloc, handle_alloc_error};
use std::ptr::NonNull;
use std::sync::OnceLock;

/// Bytes with a fixed address, aligned to 4096, for as long as the value lives.
pub(crate) struct Region {
    base: NonNull<u8>,
    len: usize,
    owner: Owner,
}

enum Owner {
    Mapping {
        /// When dropped, unmaps, and unlinks the name if it owns it.
        shmem: shared_memory::Shmem,
        /// Once somebody populates it; `None` where the system has none.
        large_pages: OnceLock<Option<LargePages>>,
    },
    Heap(HeapLayout),
    /// Unmaps when dropped.
    #[expect(dead_code, reason = "held for its Drop")]
    File(memmap2::MmapRaw),
}

impl std::fmt::Debug for Region {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Region").field("base", &self.base).field("len", &self.len).finish_non_exhaustive()
    }
}

// SAFETY: the pointer stays valid until the drop, which munmap and dealloc allow on any thread;
// `Shmem` has no thread affinity, it is not Send only because it holds a raw pointer.
unsafe impl Send for Region {}
// SAFETY: as above; the methods of `&Region` reach the bytes through atomics, or through unsafe
// functions whose callers answer for exclusive access.
unsafe impl Sync for Region {}

/// Control words that lie in a region.
///
/// # Safety
/// - Made of atomics alone (or arrays and structs of them), `#[repr(C)]`: shared references to it
///   are sound while other processes write, and any bytes are a value.
/// - Its alignment is at most 256.
pub(crate) unsafe trait SharedWords {}

impl Region {
    /// Zeroed private memory.
    pub(crate) fn heap(len: u64) -> Result<Self, ShmError> {
        let too_large = || ShmError::NotEnoughSpace { needed: len, available: isize::MAX.unsigned_abs() as u64 };
        let size = usize::try_from(len).map_err(|_too_large| too_large())?;
        let layout = HeapLayout::from_size_align(size.max(1), 4096).map_err(|_too_large| too_large())?;
        // SAFETY: the size is not zero.
        let Some(base) = NonNull::new(unsafe { alloc_zeroed(layout) }) else { handle_alloc_error(layout) };
        Ok(Self { base, len: size, owner: Owner::Heap(layout) })
    }

    /// A mapping of the `shared_memory` crate.
    pub(crate) fn mapping(shmem: shared_memory::Shmem, name: &str) -> Result<Self, ShmError> {
        let len = shmem.len();
        match NonNull::new(shmem.as_ptr()) {
            Some(base) if base.as_ptr().addr() % 4096 == 0 => {
                Ok(Self { base, len, owner: Owner::Mapping { shmem, large_pages: OnceLock::new() } })
            }
            _ => Err(ShmError::Os { action: "map", name: name.to_owned(), source: rustix::io::Errno::FAULT }),
        }
    }

    /// A mapping of a file. A read-only mapping must not be stored to.
    pub(crate) fn file(map: memmap2::MmapRaw, name: &str) -> Result<Self, ShmError> {
        match NonNull::new(map.as_mut_ptr()) {
            Some(base) if base.as_ptr().addr() % 4096 == 0 => {
                Ok(Self { base, len: map.len(), owner: Owner::File(map) })
            }
            _ => Err(ShmError::Os { action: "map", name: name.to_owned(), source: rustix::io::Errno::FAULT }),
        }
    }

    /// Length in bytes.
    pub(crate) fn len(&self) -> u64 {
        self.len as u64
    }

    /// Address of the first byte.
    pub(crate) fn as_ptr(&self) -> *mut u8 {
        self.base.as_ptr()
    }

    /// Address of `len` bytes at `offset`, aligned to `align`.
    ///
    /// # Panics
    /// When they are not inside the region: offsets are computed from a
    /// [`super::geometry::Geometry`] that was checked against this region, so that this is a bug,
    /// which no peer can provoke.
    fn at(&self, offset: u64, len: u64, align: usize) -> *mut u8 {
        let is_inside = offset.checked_add(len).is_some_and(|end| end <= self.len as u64);
        assert!(is_inside, "{len} bytes at {offset} are outside of a segment of {} bytes", self.len);
        // SAFETY: offset <= len, within the one allocation or mapping that `base` points to.
        let pointer = unsafe { self.base.as_ptr().add(offset as usize) };
        assert!(pointer.addr() % align == 0, "offset {offset} is not aligned to {align}");
        pointer
    }

    /// Has the system give memory to bytes that nobody has written yet, all at once: page by page,
    /// as they are written, takes a third more time. Where it can it gives large pages, which are
    /// read faster, to what lies around them, too. Where it cannot (before Linux 5.14, and 6.1),
    /// that is how it goes.
    pub(crate) fn populate(&self, offset: u64, len: u64) {
        const PAGE: usize = 4096;
        let Owner::Mapping { shmem, large_pages } = &self.owner else { return };
        let first = self.at(offset, len, 1);
        let file = || rustix::shm::open(shmem.get_os_id(), rustix::shm::OFlags::RDWR, rustix::shm::Mode::empty());
        if let Some(pages) = large_pages.get_or_init(|| LargePages::of(&file().ok()?, self.len)) {
            pages.gather(offset as usize, len as usize);
        }
        let before = first.addr() % PAGE;
        // SAFETY: the pages are those of the region, which begins with a page; what is in them stays
        // as it is.
        let given = unsafe {
            rustix::mm::madvise(first.sub(before).cast(), len as usize + before, rustix::mm::Advice::LinuxPopulateWrite)
        };
        given.ok();
    }

    /// Control words at `offset`.
    pub(crate) fn words<W: SharedWords>(&self, offset: u64) -> &W {
        let pointer = self.at(offset, size_of::<W>() as u64, align_of::<W>());
        // SAFETY: in bounds and aligned, checked by `at`; initialised (mapped or zeroed); made of
        // atomics, by the trait.
        unsafe { &*pointer.cast::<W>() }
    }

    /// `len` control words from `offset` on.
    pub(crate) fn words_slice<W: SharedWords>(&self, offset: u64, len: u64) -> &[W] {
        let pointer = self.at(offset, (size_of::<W>() as u64).saturating_mul(len), align_of::<W>());
        // SAFETY: as in `words`; `at` checked all of them.
        unsafe { std::slice::from_raw_parts(pointer.cast::<W>(), len as usize) }
    }

    /// Copies a value out.
    ///
    /// # Safety
    /// - The protocol gives the bytes to the caller: no healthy peer writes them now.
    pub(crate) unsafe fn read<T: Pod>(&self, offset: u64) -> T {
        let pointer = self.at(offset, size_of::<T>() as u64, 1);
        // SAFETY: in bounds; any bytes are a `T`, being Pod; not written meanwhile, by the caller.
        unsafe { pointer.cast::<T>().read_unaligned() }
    }

    /// Copies a value in.
    ///
    /// # Safety
    /// - The protocol gives the bytes to the caller: no healthy peer reads or writes them now.
    pub(crate) unsafe fn write<T: Pod>(&self, offset: u64, value: &T) {
        let pointer = self.at(offset, size_of::<T>() as u64, 1);
        // SAFETY: in bounds; exclusive, by the caller.
        unsafe { pointer.cast::<T>().write_unaligned(*value) }
    }

    /// `len` values in place.
    ///
    /// # Safety
    /// - For the lifetime `'a` the protocol gives the bytes to the caller: no healthy peer writes
    ///   them, and `self` lives.
    pub(crate) unsafe fn slice<'a, T: Pod>(&self, offset: u64, len: u64) -> &'a [T] {
        let pointer = self.at(offset, (size_of::<T>() as u64).saturating_mul(len), align_of::<T>());
        // SAFETY: in bounds and aligned, checked by `at`; any bytes are a `T`; not written
        // meanwhile, by the caller.
        unsafe { std::slice::from_raw_parts(pointer.cast::<T>(), len as usize) }
    }

    /// `len` values in place, to be written.
    ///
    /// # Safety
    /// - For the lifetime `'a` the protocol gives the bytes to the caller alone, and `self` lives.
    /// - No other slice of these bytes is in use.
    pub(crate) unsafe fn slice_mut<'a, T: Pod>(&self, offset: u64, len: u64) -> &'a mut [T] {
        let pointer = self.at(offset, (size_of::<T>() as u64).saturating_mul(len), align_of::<T>());
        // SAFETY: in bounds and aligned, checked by `at`; any bytes are a `T`; exclusive, by the
        // caller.
        unsafe { std::slice::from_raw_parts_mut(pointer.cast::<T>(), len as usize) }
    }
}

impl Drop for Region {
    fn drop(&mut self) {
        if let Owner::Heap(layout) = self.owner {
            // SAFETY: allocated by `heap` with this layout, and dropped once.
            unsafe { dealloc(self.base.as_ptr(), layout) }
        }
    }
}
