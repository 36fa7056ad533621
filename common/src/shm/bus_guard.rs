//! The last words of a launcher whose mappings another program has cut the ground from under.
//!
//! The run's own segments are mapped, and whoever may open them, any other process of the same
//! user, may truncate their files. A page behind the end of a file ends who reads it by SIGBUS. In
//! a stage the launcher tells of it; this is for the launcher: it says why, removes what it has
//! made, and its stages end with it.

use rustix::fd::BorrowedFd;
use std::ffi::CString;
use std::io;
use std::os::unix::ffi::OsStrExt;
use std::path::PathBuf;
use std::sync::OnceLock;

struct LastWords {
    sentence: Vec<u8>,
    files: Vec<CString>,
    exit_code: i32,
}

static LAST_WORDS: OnceLock<LastWords> = OnceLock::new();

/// From now on a bus error of this process writes a sentence to standard error, removes these files
/// and ends the process with this exit code. Once in a process; what a second call asks for is
/// ignored.
///
/// # Errors
/// The system refuses.
pub fn end_on_bus_error(sentence: &str, files: Vec<PathBuf>, exit_code: u8) -> Result<(), io::Error> {
    // A text with a zero byte is not a path.
    let files = files.into_iter().filter_map(|file| CString::new(file.as_os_str().as_bytes()).ok()).collect();
    let words = LastWords { sentence: format!("{sentence}\n").into_bytes(), files, exit_code: exit_code.into() };
    LAST_WORDS.get_or_init(|| words);
    // SAFETY: the action is async-signal-safe: an atomic load, and the system calls write, unlink
    // and _exit, which neither allocate nor lock. It does not return, so that the access that
    // failed is not tried again.
    unsafe { signal_hook::low_level::register(signal_hook::consts::SIGBUS, end) }.map(drop)
}

fn end() {
    // It is set before the signal is listened to.
    let Some(words) = LAST_WORDS.get() else { signal_hook::low_level::exit(1) };
    // SAFETY: a descriptor that may be closed by now; then the call fails, and nobody is told.
    let stderr = unsafe { BorrowedFd::borrow_raw(2) };
    rustix::io::write(stderr, &words.sentence).ok();
    for file in &words.files {
        rustix::fs::unlink(file.as_c_str()).ok();
    }
    signal_hook::low_level::exit(words.exit_code)
}
