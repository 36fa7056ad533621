//! The last resort against faults of this program: a panic becomes one sentence, and one within a
//! decoder of foreign bytes an error.
//!
//! No input should bring a panic about: readers of foreign bytes give errors. Where one does so
//! nevertheless, the user is told in a sentence what to do, destructors run (they remove segments
//! and half-written files), and the exit code is [`INTERNAL_ERROR`].

use crate::terminal::complain;
use std::any::Any;
use std::backtrace::{Backtrace, BacktraceStatus};
use std::cell::Cell;
use std::panic::{AssertUnwindSafe, PanicHookInfo, catch_unwind};

/// Exit code of a program that a fault of its own has ended (the one that Rust gives it).
pub const INTERNAL_ERROR: u8 = 101;
/// How the sentence begins.
pub const INTERNAL_ERROR_WORDS: &str = "internal error";

thread_local! {
    /// Whether this thread is within [`contained`].
    static IS_CONTAINED: Cell<bool> = const { Cell::new(false) };
}

/// Work that ended by a panic: what it decoded cannot be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("its decoder failed")]
pub struct Contained;

/// From now on a panic is told in one sentence that begins like this program's other messages: with
/// `prefix`.
pub fn report_panics(prefix: &'static str) {
    std::panic::set_hook(Box::new(move |panic| {
        if IS_CONTAINED.get() {
            return;
        }
        complain(&format!("{prefix}{}", sentence(panic)));
        let trace = Backtrace::capture();
        if trace.status() == BacktraceStatus::Captured {
            trace.to_string().lines().for_each(complain);
        }
    }));
}

fn sentence(panic: &PanicHookInfo<'_>) -> String {
    let what = words_of(panic.payload());
    let place = panic.location().map_or_else(|| "an unknown place".to_owned(), ToString::to_string);
    let thread = std::thread::current().name().unwrap_or("without a name").to_owned();
    format!(
        "{INTERNAL_ERROR_WORDS} ({what}, at {place}, thread {thread}): this is a fault of TerraVision, please report it with \
         the command that you gave and this message"
    )
}

fn words_of(payload: &(dyn Any + Send)) -> &str {
    let text = payload.downcast_ref::<&str>().copied();
    text.or_else(|| payload.downcast_ref::<String>().map(String::as_str)).unwrap_or("no message")
}

/// Does work on foreign bytes by code that is not ours. A panic of it is an error, without a
/// message on standard error; what the work was changing is then in an undefined, but safe state.
///
/// # Errors
/// [`Contained`].
pub fn contained<T>(work: impl FnOnce() -> T) -> Result<T, Contained> {
    let outer = IS_CONTAINED.replace(true);
    let result = catch_unwind(AssertUnwindSafe(work));
    IS_CONTAINED.set(outer);
    result.map_err(|_panic| Contained)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_of_a_decoder_is_an_error() {
        assert_eq!(contained(|| 7), Ok(7));
        let bytes: &[u8] = &[1];
        assert_eq!(contained(|| bytes[std::hint::black_box(3)]), Err(Contained));
        let nested = contained(|| contained(|| -> u8 { panic!("inner") }));
        assert_eq!(nested, Ok(Err(Contained)));
        assert!(!IS_CONTAINED.get());
    }

    #[test]
    fn messages_of_panics_are_found() {
        let payload = |work: fn()| catch_unwind(work).expect_err("a panic");
        IS_CONTAINED.set(true);
        assert_eq!(words_of(&*payload(|| panic!("plain"))), "plain");
        let number = std::hint::black_box(3);
        assert_eq!(words_of(&*catch_unwind(|| panic!("number {number}")).expect_err("a panic")), "number 3");
        assert_eq!(words_of(&*payload(|| std::panic::panic_any(7))), "no message");
        IS_CONTAINED.set(false);
    }
}
