//! Large pages under a segment: what is read here and there all over a pool, as texels are, costs
//! less than half the time where memory lies together in pieces of 2 MiB. The system gives such
//! pages to shared memory by itself only where an administrator has allowed it; on request it
//! gathers small ones into large ones, whatever is set (since Linux 6.1).

use crate::sync::{AtomicBool, Ordering};
use rustix::fd::OwnedFd;
use rustix::mm::{MapFlags, ProtFlags};
use std::ffi::c_void;
use std::ptr::NonNull;

/// Bytes of a large page: those of x86-64, and of aarch64 whose small pages have 4 KiB. Elsewhere
/// the system declines.
const LARGE: usize = 2 << 20;

/// A second mapping of a file that begins at an address where a large page can, through which its
/// memory is gathered. Nobody reads or writes through it.
#[derive(Debug)]
pub(super) struct LargePages {
    /// Addresses that are taken, and how many; the file begins at the first one that is aligned.
    taken: NonNull<c_void>,
    taken_len: usize,
    /// Whether each piece of the file has been asked for.
    asked: Box<[AtomicBool]>,
}

// SAFETY: addresses that are only handed to the system, on any thread, and unmapped by the drop.
unsafe impl Send for LargePages {}
// SAFETY: as above; what changes is atomic.
unsafe impl Sync for LargePages {}

impl LargePages {
    /// Of a file of `len` bytes; `None` if it is too short, or there is no room for it.
    pub(super) fn of(file: &OwnedFd, len: usize) -> Option<Self> {
        let pieces = len / LARGE;
        if pieces == 0 {
            return None;
        }
        let taken_len = (pieces + 1) * LARGE;
        // SAFETY: addresses that the system chooses, of no memory that anybody has.
        let taken = unsafe {
            rustix::mm::mmap_anonymous(std::ptr::null_mut(), taken_len, ProtFlags::empty(), MapFlags::PRIVATE)
        };
        let taken = NonNull::new(taken.ok()?)?;
        let asked = (0..pieces).map(|_| AtomicBool::new(false)).collect();
        // From here on a failure gives the addresses back.
        let pages = Self { taken, taken_len, asked };
        // SAFETY: within the addresses taken above, which are nobody else's; at most `LARGE - 1`
        // bytes were skipped, and they are longer by that.
        let mapped = unsafe {
            let flags = MapFlags::SHARED | MapFlags::FIXED;
            rustix::mm::mmap(pages.piece(0), pieces * LARGE, ProtFlags::READ | ProtFlags::WRITE, flags, file, 0)
        };
        mapped.ok().map(|_| pages)
    }

    /// Address of a piece.
    fn piece(&self, number: usize) -> *mut c_void {
        let address = self.taken.as_ptr();
        address.wrapping_byte_add(address.addr().wrapping_neg() % LARGE + number * LARGE)
    }

    /// Gathers the memory around `len` bytes at `offset`, of which the file has all, if that has not
    /// been tried yet. Contents stay, though other threads and processes read or write them meanwhile.
    pub(super) fn gather(&self, offset: usize, len: usize) {
        let pieces = offset / LARGE..(offset + len).div_ceil(LARGE);
        for (number, asked) in self.asked.iter().enumerate().take(pieces.end).skip(pieces.start) {
            // Relaxed: nothing depends on which thread asks, and when that has been done.
            if asked.swap(true, Ordering::Relaxed) {
                continue;
            }
            // SAFETY: a piece of the mapping; the system moves its memory, and changes none of it.
            // If it cannot, small pages stay.
            let _given = unsafe { libc::madvise(self.piece(number), LARGE, libc::MADV_COLLAPSE) };
        }
    }
}

impl Drop for LargePages {
    fn drop(&mut self) {
        // SAFETY: taken by `of`, and unmapped once; nobody else has an address of it.
        let given_back = unsafe { rustix::mm::munmap(self.taken.as_ptr(), self.taken_len) };
        given_back.ok();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sync::AtomicU64;
    use memmap2::MmapRaw;
    use rustix::fs::MemfdFlags;

    /// A file in memory, and the numbers in it.
    fn file_of(len: usize) -> (OwnedFd, MmapRaw) {
        let file = rustix::fs::memfd_create("large-pages", MemfdFlags::CLOEXEC).unwrap();
        rustix::fs::fallocate(&file, rustix::fs::FallocateFlags::empty(), 0, len as u64).unwrap();
        let map = MmapRaw::map_raw(&file).unwrap();
        (file, map)
    }

    fn numbers(map: &MmapRaw) -> &[AtomicU64] {
        // SAFETY: a mapping of whole pages that lives as long; only atomics reach it.
        unsafe { std::slice::from_raw_parts(map.as_ptr().cast(), map.len() / 8) }
    }

    #[test]
    fn what_is_written_stays_while_memory_is_gathered() {
        // Two pieces and a half.
        let (file, map) = file_of(5 << 20);
        let pages = LargePages::of(&file, map.len()).unwrap();
        assert_eq!(pages.asked.len(), 2);
        assert!(pages.piece(0).addr().is_multiple_of(LARGE));
        let is_written = |k: usize| k as u64 * 3 + 1;
        std::thread::scope(|scope| {
            scope.spawn(|| {
                numbers(&map).iter().enumerate().for_each(|(k, of)| of.store(is_written(k), Ordering::Relaxed))
            });
            // A stretch over the border of two pieces, and one behind the last whole one.
            scope.spawn(|| pages.gather(LARGE - 10, 20));
            pages.gather((5 << 20) - 1, 1);
        });
        assert!(pages.asked.iter().all(|asked| asked.load(Ordering::Relaxed)));
        for (k, number) in numbers(&map).iter().enumerate() {
            assert_eq!(number.load(Ordering::Relaxed), is_written(k), "number {k}");
        }
        drop(pages);
        assert_eq!(numbers(&map)[17].load(Ordering::Relaxed), is_written(17));
    }

    #[test]
    fn short_files_and_files_that_were_cut_do_no_harm() {
        let (file, map) = file_of(LARGE - 4096);
        assert!(LargePages::of(&file, map.len()).is_none());
        let (file, map) = file_of(2 * LARGE);
        let pages = LargePages::of(&file, map.len()).unwrap();
        rustix::fs::ftruncate(&file, 4096).unwrap();
        pages.gather(0, 2 * LARGE);
        numbers(&map)[0].store(5, Ordering::Relaxed);
    }
}
