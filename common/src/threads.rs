//! Threads that the system may refuse.

use std::io;
use std::sync::mpsc::sync_channel;

/// Stack of the threads that are tried.
const STACK_BYTES: usize = 64 << 10;

/// Whether so many threads more can be started now: tries, and ends them again. For libraries that
/// panic when they cannot.
///
/// # Errors
/// The system refuses, because of `ulimit -u`, a container's limit of processes, or for want of
/// memory; in a sentence.
pub fn ensure(count: usize) -> io::Result<()> {
    let mut threads = Vec::with_capacity(count);
    let mut started = Ok(());
    for _ in 0..count {
        let (end, wait) = sync_channel::<()>(0);
        let builder = std::thread::Builder::new().stack_size(STACK_BYTES);
        // It ends when its channel does: all of them are there at a time.
        match builder.spawn(move || wait.recv().unwrap_or_default()) {
            Ok(thread) => threads.push((end, thread)),
            Err(error) => {
                let place = threads.len() + 1;
                let why = format!(
                    "cannot start thread {place} of {count}: {error}; too many threads or processes run here \
                                   (ulimit -u says how many may)"
                );
                started = Err(io::Error::new(error.kind(), why));
                break;
            }
        }
    }
    for (end, thread) in threads {
        drop(end);
        // It has nothing that can panic.
        drop(thread.join());
    }
    started
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_few_threads_are_there() {
        super::ensure(0).unwrap();
        super::ensure(9).unwrap();
    }
}
