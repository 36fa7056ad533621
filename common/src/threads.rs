//! Checks whether threads can be started.

use std::io;
use std::sync::mpsc::sync_channel;

/// Stack size of the test threads.
const STACK_BYTES: usize = 64 << 10;

/// Checks whether this many more threads can be started now: starts them, and ends them again. For
/// libraries that panic if they cannot start threads.
///
/// # Errors
/// The system refuses, because of `ulimit -u`, a container's limit of processes, or lack of memory;
/// the message is a sentence.
pub fn ensure(count: usize) -> io::Result<()> {
    let mut threads = Vec::with_capacity(count);
    let mut started = Ok(());
    for _ in 0..count {
        let (end, wait) = sync_channel::<()>(0);
        let builder = std::thread::Builder::new().stack_size(STACK_BYTES);
        // It ends with its channel, so that all of them exist at the same time.
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
        // It contains no code that can panic.
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
