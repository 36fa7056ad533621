//! Signals by which processes end, for people.

/// Sent when the terminal is closed.
pub const HUP: i32 = 1;
/// Ctrl-C.
pub const INT: i32 = 2;
/// Asks a process to end.
pub const TERM: i32 = 15;

/// How a process ended that was killed by a signal: words that follow its name.
#[must_use]
pub fn killed_by(signal: i32) -> String {
    format!("was killed by signal {signal}{}", signal_name(signal))
}

/// What a signal means, in brackets, for those that a person may wonder at.
fn signal_name(signal: i32) -> &'static str {
    match signal {
        HUP => " (HUP)",
        INT => " (INT)",
        4 => " (illegal instruction)",
        6 => " (aborted)",
        7 => " (bus error)",
        9 => " (KILL)",
        11 => " (segmentation fault)",
        13 => " (PIPE)",
        TERM => " (TERM)",
        24 => " (XCPU: the limit of processor time, ulimit -t)",
        25 => " (XFSZ: the limit of a file's size, ulimit -f)",
        31 => " (SYS: a system call that is not allowed)",
        _ => "",
    }
}
