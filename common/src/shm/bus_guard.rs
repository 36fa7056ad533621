//! A handler for SIGBUS in the launcher, for when another program truncates a mapped file.
//!
//! The run's own segments are mapped, and any process of the same user can truncate their files. An
//! access to a page behind the end of a file raises SIGBUS. If that kills a stage, the launcher
//! reports it. This handler is for the launcher itself: it prints the reason and removes its files;
//! its stages end with it.

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

/// From now on a bus error in this process writes a sentence to standard error, removes these files
/// and ends the process with this exit code. Only the first call in a process has an effect.
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
    // It is set before the handler is installed.
    let Some(words) = LAST_WORDS.get() else { signal_hook::low_level::exit(1) };
    // SAFETY: the descriptor may be closed by now; then the call only fails.
    let stderr = unsafe { BorrowedFd::borrow_raw(2) };
    rustix::io::write(stderr, &words.sentence).ok();
    for file in &words.files {
        rustix::fs::unlink(file.as_c_str()).ok();
    }
    signal_hook::low_level::exit(words.exit_code)
}
