//! Labels, as typed.

use super::values::ValueError;
use clap::Args;

const HEADING: &str = "Labels (docs/light.md)";
/// Longest text, letters.
const MOST_LETTERS: usize = 200;

/// What is burnt into pictures; shared by `fly`, `still` and `view`.
#[derive(Debug, Clone, Args)]
pub struct LabelArgs {
    /// Burn a text in, at the lower left
    #[arg(long, help_heading = HEADING, value_name = "TEXT", value_parser = parse_label)]
    pub label: Option<String>,
    /// Burn a scale bar in, at the lower right
    ///
    /// It holds at the distance of the ground in the middle of the picture.
    #[arg(long, help_heading = HEADING)]
    pub scale_bar: bool,
    /// Burn an arrow to grid north in, at the upper right
    #[arg(long, help_heading = HEADING)]
    pub north_arrow: bool,
    /// Burn the time since the beginning of the flight in, at the upper left
    #[arg(long, help_heading = HEADING)]
    pub clock: bool,
}

impl LabelArgs {
    /// Whether any is asked for.
    #[must_use]
    pub fn is_any(&self) -> bool {
        self.label.is_some() || self.scale_bar || self.north_arrow || self.clock
    }
}

/// Parses `--label`.
///
/// # Errors
/// [`ValueError`]: it is too long, or has more than one line.
pub fn parse_label(text: &str) -> Result<String, ValueError> {
    let is_line = !text.chars().any(char::is_control) && text.chars().count() <= MOST_LETTERS;
    if is_line { Ok(text.to_owned()) } else { Err(ValueError { expected: "one line of at most 200 letters" }) }
}
