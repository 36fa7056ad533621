//! H.264 for a client whose link carries less than JPEG needs: an ffmpeg of its own, which makes an
//! access unit of each picture at once, and ends with the client.

mod flv;
mod link;

pub(crate) use link::LinkRate;

use crate::command::Running;
use bytes::{BufMut, Bytes, BytesMut};
use flv::{Tag, read_header, read_tag};
use std::io::{self, ErrorKind};
use std::process::Stdio;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::process::{ChildStdin, ChildStdout, Command};

/// Clients that have an encoder at a time; others have JPEG.
pub(crate) const MOST_ENCODERS: usize = 4;
/// Longest time that one picture may take.
const LONGEST: Duration = Duration::from_secs(5);
/// Bits a second: of the slowest link, and of the fastest one that is not for JPEG anyway.
const RATES: [f64; 2] = [150e3, 6e6];
/// Share of the link that pictures take; the rest is for everything else, and for links that become
/// slower.
const SHARE: f64 = 0.7;
/// A link that has become this many times faster or slower is worth a new encoder.
const OTHER_LINK: f64 = 2.0;
/// Bytes of what ffmpeg says that are read, and the longest time that this may take.
const MOST_SAID: u64 = 4 << 10;
const SAID_WITHIN: Duration = Duration::from_millis(500);

/// Why there is no encoder.
#[derive(Debug, thiserror::Error)]
pub(crate) enum VideoError {
    /// There is no ffmpeg.
    #[error("ffmpeg is not installed on the server")]
    NoFfmpeg,
    /// It could not be started.
    #[error("ffmpeg cannot be started on the server: {0}")]
    NotStarted(io::Error),
    /// It does not encode.
    #[error("ffmpeg of the server does not encode H.264: {0}")]
    Failed(String),
}

/// A picture, encoded.
#[derive(Debug)]
pub(crate) struct Unit {
    /// Nothing before it is needed to decode it.
    pub(crate) is_key: bool,
    /// Length of the decoder's configuration (u32), the configuration where it is new, the access
    /// unit.
    pub(crate) file: Bytes,
}

/// An encoder of pictures of one size.
#[derive(Debug)]
pub(crate) struct VideoEncoder {
    size: [u32; 2],
    link_bytes_per_s: f64,
    stdin: ChildStdin,
    stdout: BufReader<ChildStdout>,
    has_begun: bool,
    running: Running,
}

impl VideoEncoder {
    /// For a link that carries this many bytes a second.
    pub(crate) fn start(size: [u32; 2], fps: f64, link_bytes_per_s: f64) -> Result<Self, VideoError> {
        let bits_per_s = (8.0 * SHARE * link_bytes_per_s).clamp(RATES[0], RATES[1]);
        let mut command = Command::new("ffmpeg");
        command.args(arguments(size, fps, bits_per_s));
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut running = Running::start(&mut command).map_err(|error| match error.kind() {
            ErrorKind::NotFound => VideoError::NoFfmpeg,
            _ => VideoError::NotStarted(error),
        })?;
        let pipes = running.stdin().zip(running.stdout());
        let (stdin, stdout) = pipes.ok_or_else(|| VideoError::NotStarted(ErrorKind::BrokenPipe.into()))?;
        Ok(Self { size, link_bytes_per_s, stdin, stdout: BufReader::new(stdout), has_begun: false, running })
    }

    /// Whether it was started for a link that carries about as much.
    pub(crate) fn fits_link(&self, bytes_per_s: Option<f64>) -> bool {
        let change = bytes_per_s.map_or(1.0, |now| now / self.link_bytes_per_s);
        (1.0 / OTHER_LINK..=OTHER_LINK).contains(&change)
    }

    /// Size of its pictures.
    pub(crate) fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Encodes the next picture.
    pub(crate) async fn encode(&mut self, rgba: &[u8]) -> Result<Unit, VideoError> {
        match tokio::time::timeout(LONGEST, self.encode_at_last(rgba)).await {
            Ok(Ok(unit)) => Ok(unit),
            Ok(Err(error)) => Err(VideoError::Failed(self.said().await.unwrap_or_else(|| error.to_string()))),
            Err(_late) => Err(VideoError::Failed(format!("a picture took more than {} s", LONGEST.as_secs()))),
        }
    }

    /// What ffmpeg said when it failed.
    async fn said(&mut self) -> Option<String> {
        let mut said = String::new();
        let mut stderr = self.running.stderr()?.take(MOST_SAID);
        // What came until then is of use, whatever ended it.
        tokio::time::timeout(SAID_WITHIN, stderr.read_to_string(&mut said)).await.ok();
        said.lines().rfind(|line| !line.trim().is_empty()).map(|line| line.trim().to_owned())
    }

    async fn encode_at_last(&mut self, rgba: &[u8]) -> io::Result<Unit> {
        self.stdin.write_all(rgba).await?;
        self.stdin.flush().await?;
        if !std::mem::replace(&mut self.has_begun, true) {
            read_header(&mut self.stdout).await?;
        }
        let mut config = Vec::new();
        loop {
            match read_tag(&mut self.stdout).await? {
                Tag::Config(bytes) => config = bytes,
                Tag::Unit { is_key, bytes } => {
                    let mut file = BytesMut::with_capacity(4 + config.len() + bytes.len());
                    file.put_u32_le(config.len() as u32);
                    file.put_slice(&config);
                    file.put_slice(&bytes);
                    return Ok(Unit { is_key, file: file.freeze() });
                }
                Tag::Other => {}
            }
        }
    }
}

/// The arguments of ffmpeg: RGBA in, H.264 out in tags of Flash Video, whose lengths come first, so
/// that a picture is known to be complete before the next one comes. Constrained baseline: decoders
/// hold nothing back. A decoder of several threads would, of raw video too: one frame for each.
fn arguments([width, height]: [u32; 2], fps: f64, bits_per_s: f64) -> Vec<String> {
    let (rate, buffer) = (format!("{bits_per_s:.0}"), format!("{:.0}", bits_per_s / 5.0));
    let text = format!(
        "-hide_banner -v error -nostats -threads 1 -probesize 32 -f rawvideo -pix_fmt rgba -s {width}x{height} \
         -framerate {fps} -i pipe:0 -an -vf scale=out_color_matrix=bt709:out_range=tv,format=yuv420p -colorspace bt709 \
         -color_primaries bt709 -color_trc bt709 -color_range tv -c:v libx264 -preset veryfast -tune zerolatency \
         -profile:v baseline -threads 1 -bf 0 -g 600 -b:v {rate} -maxrate {rate} -bufsize {buffer} \
         -fps_mode passthrough -flush_packets 1 -flvflags no_duration_filesize -f flv pipe:1"
    );
    text.split_whitespace().map(str::to_owned).collect()
}
