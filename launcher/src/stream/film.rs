//! What a film is encoded with: containers, codecs, and what ffmpeg is told of them.
//!
//! The same pictures make the same bytes with the same ffmpeg: encoders run with a fixed number of
//! threads, in the modes in which their output does not depend on when a thread was done.

use std::path::Path;
use terravision_common::film::FrameEncoding;

/// Threads of the encoder, on every machine: x264's output depends on their number.
const ENCODER_THREADS: &str = "4";

/// What x264 is told unless `--preset` says otherwise: its quickest preset, with the three parts of
/// it back that pay for themselves. Of 120 frames of an orbit of rough synthetic mountains (1280x720,
/// Y'CbCr to file, ffmpeg 5.1), in ms of processor time and kB a frame, dB and SSIM: these with a
/// rate factor of 19 7.1, 56.6, 41.8, .980; superfast with 19 12.6, 49.9, 41.4, .979; veryfast with
/// 18, which films were made with before, 19.6, 37.5, 41.2, .979.
const USUAL_X264: &[&str] =
    &["-preset", "ultrafast", "-x264-params", "no-deblock=0:subme=1:partitions=i4x4+i8x8:aq-mode=1"];

/// How pictures are compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Codec {
    /// H.264 by x264: plays everywhere
    H264,
    /// H.265 by x265: smaller, slower
    H265,
    /// VP9 by libvpx: for browsers
    Vp9,
    /// AV1 by SVT-AV1: smallest
    Av1,
    /// FFV1: lossless, for editing and for keeping
    Ffv1,
    /// GIF: 256 colours a frame
    Gif,
}

/// How much time x264 and x265 take for how small a film, as they name it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
#[expect(missing_docs, reason = "the names are those of the encoders")]
pub enum Preset {
    Ultrafast,
    Superfast,
    Veryfast,
    Faster,
    Fast,
    Medium,
    Slow,
    Slower,
    Veryslow,
}

impl Preset {
    /// As encoders and `--preset` name it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Ultrafast => "ultrafast",
            Self::Superfast => "superfast",
            Self::Veryfast => "veryfast",
            Self::Faster => "faster",
            Self::Fast => "fast",
            Self::Medium => "medium",
            Self::Slow => "slow",
            Self::Slower => "slower",
            Self::Veryslow => "veryslow",
        }
    }
}

/// A kind of file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Container {
    /// `.mp4`
    Mp4,
    /// `.mov`
    QuickTime,
    /// `.mkv`
    Matroska,
    /// `.webm`
    WebM,
    /// `.gif`
    Gif,
}

impl Container {
    /// What names of films end with.
    pub const EXTENSIONS: [&str; 5] = ["mp4", "mov", "mkv", "webm", "gif"];

    /// The container of a file of this name.
    #[must_use]
    pub fn of(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "mp4" => Some(Self::Mp4),
            "mov" => Some(Self::QuickTime),
            "mkv" => Some(Self::Matroska),
            "webm" => Some(Self::WebM),
            "gif" => Some(Self::Gif),
            _ => None,
        }
    }

    /// What it can hold; the first is what is taken where nothing is said.
    #[must_use]
    pub fn codecs(self) -> &'static [Codec] {
        match self {
            Self::Mp4 => &[Codec::H264, Codec::H265, Codec::Av1],
            Self::QuickTime => &[Codec::H264, Codec::H265],
            Self::Matroska => &[Codec::H264, Codec::H265, Codec::Vp9, Codec::Av1, Codec::Ffv1],
            Self::WebM => &[Codec::Vp9, Codec::Av1],
            Self::Gif => &[Codec::Gif],
        }
    }
}

impl Codec {
    /// As `--codec` names it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::H264 => "h264",
            Self::H265 => "h265",
            Self::Vp9 => "vp9",
            Self::Av1 => "av1",
            Self::Ffv1 => "ffv1",
            Self::Gif => "gif",
        }
    }

    /// The encoder, as ffmpeg names it.
    #[must_use]
    pub fn encoder(self) -> &'static str {
        match self {
            Self::H264 => "libx264",
            Self::H265 => "libx265",
            Self::Vp9 => "libvpx-vp9",
            Self::Av1 => "libsvtav1",
            Self::Ffv1 => "ffv1",
            Self::Gif => "gif",
        }
    }

    /// The constant rate factor that is taken where none is said, and the largest; `None` for
    /// codecs that have none. Each is taken for visually lossless: 18 or 19 with x264, whose default
    /// of 23 smears forests, and what looks like it with the others.
    #[must_use]
    pub fn crf(self, preset: Option<Preset>) -> Option<(u32, u32)> {
        match self {
            Self::H264 => Some((if preset.is_some() { 18 } else { 19 }, 51)),
            Self::H265 => Some((20, 51)),
            Self::Vp9 => Some((24, 63)),
            Self::Av1 => Some((24, 63)),
            Self::Ffv1 | Self::Gif => None,
        }
    }

    /// Whether its encoder knows [`Preset`]s.
    #[must_use]
    pub fn has_presets(self) -> bool {
        matches!(self, Self::H264 | Self::H265)
    }

    /// How pictures are handed to ffmpeg: as the encoder takes them, or as they are.
    #[must_use]
    pub fn encoding(self) -> FrameEncoding {
        match self {
            Self::H264 | Self::H265 | Self::Vp9 | Self::Av1 => FrameEncoding::Yuv420,
            Self::Ffv1 | Self::Gif => FrameEncoding::Raw,
        }
    }
}

/// How a film is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FilmFormat {
    /// The kind of file.
    pub container: Container,
    /// How pictures are compressed.
    pub codec: Codec,
    /// Constant rate factor, of codecs that have one.
    pub crf: Option<u32>,
    /// The encoder's preset, of codecs that have them; `None`: the settings that were chosen here.
    pub preset: Option<Preset>,
}

impl FilmFormat {
    /// H.264 in MP4, as films are if nothing is said.
    #[must_use]
    pub fn usual() -> Self {
        let crf = Codec::H264.crf(None).map(|(usual, _)| usual);
        Self { container: Container::Mp4, codec: Codec::H264, crf, preset: None }
    }

    /// The arguments of ffmpeg that say what its input is made of.
    #[must_use]
    pub fn input_arguments(&self) -> &'static [&'static str] {
        match self.codec.encoding() {
            FrameEncoding::Yuv420 => {
                &["-f", "rawvideo", "-pixel_format", "yuv420p", "-color_range", "tv", "-colorspace", "bt709"]
            }
            FrameEncoding::Raw | FrameEncoding::Y4m => &["-f", "rawvideo", "-pixel_format", "rgb0"],
        }
    }

    /// The arguments of ffmpeg between its input and the name of the film.
    #[must_use]
    pub fn arguments(&self) -> Vec<String> {
        let mut words = self.picture_arguments();
        if let Some(crf) = self.crf {
            words.extend(["-crf".to_owned(), crf.to_string()]);
        }
        words.extend(["-map_metadata", "-1", "-fflags", "+bitexact", "-flags:v", "+bitexact"].map(str::to_owned));
        if self.is_mp4() {
            words.extend(["-movflags", "+faststart"].map(str::to_owned));
        }
        words
    }

    /// Whether it is a file of boxes, as those of Apple are.
    fn is_mp4(&self) -> bool {
        matches!(self.container, Container::Mp4 | Container::QuickTime)
    }

    fn picture_arguments(&self) -> Vec<String> {
        const BT709: &[&str] =
            &["-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709", "-color_range", "tv"];
        let threads: &[&str] = &["-threads", ENCODER_THREADS];
        let preset = self.preset.map(|preset| ["-preset", preset.name()]);
        let encoder: &[&str] = &["-c:v", self.codec.encoder()];
        let parts: Vec<&[&str]> = match self.codec {
            Codec::H264 => match &preset {
                Some(preset) => vec![encoder, preset, threads, BT709],
                None => vec![encoder, USUAL_X264, threads, BT709],
            },
            // One frame at a time: with several, what rate control knows depends on when they were
            // done.
            Codec::H265 => vec![
                encoder,
                preset.as_ref().map_or(&["-preset", "fast"], |preset| preset),
                &["-x265-params", "pools=4:frame-threads=1:log-level=error"],
                // The tag that players of Apple know.
                if self.is_mp4() { &["-tag:v", "hvc1"] } else { &[] },
                BT709,
            ],
            Codec::Vp9 => {
                vec![encoder, &["-b:v", "0", "-deadline", "good", "-cpu-used", "4", "-row-mt", "0"], threads, BT709]
            }
            Codec::Av1 => vec![encoder, &["-preset", "8", "-g", "240", "-svtav1-params", "lp=2"], BT709],
            // The colours as they are.
            Codec::Ffv1 => vec![&["-pix_fmt", "bgr0"], encoder, &["-level", "3", "-g", "1", "-slices", "4"], threads],
            // A palette for each frame: one for the whole film would hold all of it in memory.
            Codec::Gif => vec![
                &[
                    "-vf",
                    "split[a][b];[a]palettegen=stats_mode=single[p];[b][p]paletteuse=new=1:dither=bayer:bayer_scale=3",
                ],
                encoder,
                threads,
            ],
        };
        parts.concat().into_iter().map(str::to_owned).collect()
    }
}
