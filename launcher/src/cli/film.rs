//! How films are encoded.

use crate::stream::film::{Codec, Preset};
use clap::Args;

/// Encoding; of `fly`.
#[derive(Debug, Default, Args)]
#[command(next_help_heading = "Film")]
pub struct FilmArgs {
    /// How a film is compressed [default: h264 for .mp4, .mov and .mkv, vp9 for .webm, gif for
    /// .gif]
    ///
    /// .mp4 takes h264, h265 and av1; .mov h264 and h265; .webm vp9 and av1; .mkv all but gif. The
    /// same flight gives the same bytes on every run with the same ffmpeg.
    #[arg(long, value_enum, value_name = "CODEC")]
    pub codec: Option<Codec>,
    /// Quality of a film, the encoder's constant rate factor [default: 19 for h264 (18
    /// with --preset), 20 for h265, 24
    /// for vp9 and av1]
    ///
    /// A smaller number gives a better and larger film; 0 is best. The largest is 51 for h264 and
    /// h265, and 63 for vp9 and av1. ffv1 is lossless and gif has 256 colours: they have no such
    /// factor.
    #[arg(long, value_name = "N")]
    pub crf: Option<u32>,
    /// How long the encoder may take to make the film small, of h264 and h265: a preset of x264 or
    /// x265 [default: settings of TerraVision's own; h265: fast]
    ///
    /// By default an h264 film takes a third of the processor time that 'veryfast' takes, and 1.5
    /// times the bytes, at the same quality. For a small film, e.g. '--preset medium'.
    #[arg(long, value_enum, value_name = "PRESET")]
    pub preset: Option<Preset>,
}
