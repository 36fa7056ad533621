//! Memory that is read soon: a hint to the processor, which changes nothing but the time.
#![cfg_attr(target_arch = "x86_64", expect(unsafe_code, reason = "an instruction that the language has no word for"))]

/// Has the line of memory with byte `at` of a table fetched into the first cache, for a loop whose
/// places a processor cannot foresee. It may lie beyond the end: then the hint is wasted.
#[inline(always)]
pub fn prefetch(table: &[u8], at: usize) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a hint may name any address: nothing is read, no fault is raised. Every processor
        // of this architecture has it.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(table.as_ptr().wrapping_add(at).cast()) }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (table, at);
}
