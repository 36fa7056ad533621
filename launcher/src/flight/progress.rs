//! What a person sees while a run goes on: a bar on a terminal, and lines that begin with the
//! program's name.

use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use std::fmt;
use std::io::{self, IsTerminal};
use terravision_common::terminal::complain;

/// How fast frames are written and how long the rest takes; nothing before the first is written.
fn pace(state: &ProgressState, out: &mut dyn fmt::Write) {
    if state.pos() > 0 {
        // A bar that cannot be written to shows nothing.
        write!(out, ", {:.1}/s, {} left", state.per_sec(), HumanDuration(state.eta())).unwrap_or_default();
    }
}

/// Progress of a run, on standard error.
#[derive(Debug)]
pub struct Progress {
    bar: Option<ProgressBar>,
    is_quiet: bool,
}

impl Progress {
    /// For a run of this many frames. Without a terminal, or with `is_quiet`, there is no bar.
    #[must_use]
    pub fn new(frames: u64, is_quiet: bool) -> Self {
        let has_bar = !is_quiet && frames > 1 && io::stderr().is_terminal();
        let bar = has_bar.then(|| {
            let bar = ProgressBar::with_draw_target(Some(frames), ProgressDrawTarget::stderr_with_hz(5));
            let template = "{wide_bar} {pos}/{len} frames{pace}";
            let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
            bar.set_style(style.with_key("pace", pace));
            bar
        });
        Self { bar, is_quiet }
    }

    /// This many frames are written.
    pub fn show(&self, written: u64) {
        if let Some(bar) = &self.bar {
            bar.set_position(written);
        }
    }

    /// Takes the bar away.
    pub fn finish(&mut self) {
        if let Some(bar) = self.bar.take() {
            bar.finish_and_clear();
        }
    }

    /// Something that is not as asked.
    pub fn warn(&self, text: &str) {
        self.line(&format!("terravision: warning: {text}"));
    }

    /// Something about the input that is good to know.
    pub fn note(&self, text: &str) {
        self.say(&format!("note: {text}"));
    }

    /// What happens.
    pub fn say(&self, text: &str) {
        if !self.is_quiet {
            self.line(&format!("terravision: {text}"));
        }
    }

    fn line(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.suspend(|| complain(text)),
            None => complain(text),
        }
    }
}
