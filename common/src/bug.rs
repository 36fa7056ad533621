//! The last resort against bugs of this program: a panic becomes one sentence, and a panic within a
//! decoder of foreign bytes becomes an error.
//!
//! No input should cause a panic: readers of foreign bytes return errors. If a panic happens
//! nevertheless, one sentence tells the user what to do, destructors run (they remove segments and
//! half-written files), and the exit code is [`INTERNAL_ERROR`].

use crate::terminal::complain;
use std::any::Any;
use std::backtrace::{Backtrace, BacktraceStatus};
use std::cell::Cell;
use std::panic::{AssertUnwindSafe, PanicHookInfo, catch_unwind};
use std::sync::Once;

/// Exit code after a panic (that of Rust).
pub const INTERNAL_ERROR: u8 = 101;
/// The beginning of the sentence.
pub const INTERNAL_ERROR_WORDS: &str = "internal error";

thread_local! {
    /// Whether this thread is within [`contained`].
    static IS_CONTAINED: Cell<bool> = const { Cell::new(false) };
}

/// Work that ended with a panic: its result cannot be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("its decoder failed")]
pub struct Contained;

/// From now on a panic is reported in one sentence that begins with `prefix`, like the other
/// messages of this program.
pub fn report_panics(prefix: &'static str) {
    // Should work have been contained already, its wrapper of the hook goes with the hook.
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

/// From the first contained work on, the hook that was there before is not told of contained
/// panics: Rust's own would print a message and, where `RUST_BACKTRACE` is set, read the program's
/// debug information (tens of MB) to name the calls.
fn keep_contained_panics_quiet() {
    static QUIET: Once = Once::new();
    QUIET.call_once(|| {
        let outer = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            if !IS_CONTAINED.get() {
                outer(panic);
            }
        }));
    });
}

/// Runs third-party code on foreign bytes. A panic becomes an error, without a message on standard
/// error; data that the work was changing is then in an undefined, but safe state.
///
/// # Errors
/// [`Contained`].
pub fn contained<T>(work: impl FnOnce() -> T) -> Result<T, Contained> {
    keep_contained_panics_quiet();
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
