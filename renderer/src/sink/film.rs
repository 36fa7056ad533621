//! Films, made by an ffmpeg child that is fed raw frames. The film appears under its name when it is complete.
//!
//! H.264, 4:2:0, BT.709, constant quality. The number of the encoder's threads is fixed, because x264's output depends on
//! it: the same pictures make the same bytes on any machine with the same ffmpeg.

use super::temporary::{failure, temporary_name};
use super::y4m::rational_fps;
use super::{FrameSink, Picture, SinkError};
use std::fs;
use std::io::{self, Read, Write};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, Stdio};
use std::thread::JoinHandle;

/// Threads of the encoder, on every machine.
const ENCODER_THREADS: &str = "4";
/// x264's constant rate factor: 18 is taken for visually lossless; 23, its default, smears forests.
const QUALITY: &str = "18";
/// Bytes of ffmpeg's messages that are kept.
const MESSAGE_BYTES: usize = 4096;

/// Feeds ffmpeg.
#[derive(Debug)]
pub struct FilmSink {
    path: PathBuf,
    temporary: PathBuf,
    program: PathBuf,
    fps: [u64; 2],
    encoder: Option<Encoder>,
    padded: Vec<u8>,
}

#[derive(Debug)]
struct Encoder {
    child: Child,
    messages: Option<JoinHandle<String>>,
}

impl FilmSink {
    /// A film at `path` (its extension chooses the container), playing at `fps`.
    ///
    /// # Errors
    /// ffmpeg is not installed, or the folder cannot be written.
    pub fn new(path: &Path, fps: f64) -> Result<Self, SinkError> {
        Self::with_program(path, fps, Path::new("ffmpeg"))
    }

    /// With this program in ffmpeg's place.
    ///
    /// # Errors
    /// It is not there, or the folder cannot be written.
    pub fn with_program(path: &Path, fps: f64, program: &Path) -> Result<Self, SinkError> {
        let temporary = temporary_name(path);
        // Before anything is drawn: can the film be written, and is there an ffmpeg?
        fs::File::create(&temporary).map_err(|source| failure(path, source))?;
        let sink = Self {
            path: path.to_owned(),
            temporary,
            program: program.to_owned(),
            fps: rational_fps(fps),
            encoder: None,
            padded: Vec::new(),
        };
        let mut version = Command::new(program);
        version.arg("-version").stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        version.status().map_err(start_failure)?;
        Ok(sink)
    }

    fn start(&self, [width, height]: [u32; 2]) -> Result<Encoder, SinkError> {
        let [n, d] = self.fps;
        let mut command = Command::new(&self.program);
        command
            .args(["-hide_banner", "-nostdin", "-loglevel", "error", "-y"])
            .args(["-f", "rawvideo", "-pixel_format", "rgb0"])
            .args(["-video_size", &format!("{width}x{height}"), "-framerate", &format!("{n}/{d}"), "-i", "pipe:0"])
            .args(["-vf", "scale=out_color_matrix=bt709:out_range=limited:flags=accurate_rnd+full_chroma_int"])
            .args(["-pix_fmt", "yuv420p", "-c:v", "libx264", "-preset", "veryfast", "-crf", QUALITY])
            .args(["-threads", ENCODER_THREADS, "-colorspace", "bt709", "-color_primaries", "bt709"])
            .args(["-color_trc", "bt709", "-color_range", "tv"])
            .args(["-map_metadata", "-1", "-fflags", "+bitexact", "-flags:v", "+bitexact", "-movflags", "+faststart"])
            .arg(&self.temporary)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            // Ctrl-C is for the launcher: ffmpeg ends when its input does, or when it is killed on drop.
            .process_group(0);
        let mut child = command.spawn().map_err(start_failure)?;
        let messages = child.stderr.take().map(|stderr| std::thread::spawn(move || last_words(stderr)));
        Ok(Encoder { child, messages })
    }

    fn give_up(&mut self, fallback: &str) -> SinkError {
        let words = self.encoder.take().map(Encoder::end).map(|(_, words)| words).unwrap_or_default();
        let line = words.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or(fallback);
        SinkError::Ffmpeg { reason: line.trim().to_owned(), path: self.path.clone() }
    }
}

impl Encoder {
    /// Closes its input and waits: whether it succeeded, and what it said.
    fn end(mut self) -> (bool, String) {
        drop(self.child.stdin.take());
        let is_success = self.child.wait().is_ok_and(|status| status.success());
        let words = self.messages.take().and_then(|thread| thread.join().ok()).unwrap_or_default();
        (is_success, words)
    }
}

impl FrameSink for FilmSink {
    fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
        // 4:2:0 needs even sides: an odd one is made even by repeating its last column or row.
        let size = picture.size.map(|side| side.next_multiple_of(2));
        let bytes = if size == picture.size {
            picture.rgba
        } else {
            pad(picture, size, &mut self.padded);
            &self.padded
        };
        if self.encoder.is_none() {
            self.encoder = Some(self.start(size)?);
        }
        let input = self.encoder.as_mut().and_then(|encoder| encoder.child.stdin.as_mut());
        let written = input.map_or_else(|| Err(io::ErrorKind::BrokenPipe.into()), |input| input.write_all(bytes));
        written.map_err(|error: io::Error| self.give_up(&error.to_string()))
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        let Some(encoder) = self.encoder.take() else { return Ok(()) };
        let (is_success, words) = encoder.end();
        if !is_success {
            let line = words.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or("it ended with an error");
            return Err(SinkError::Ffmpeg { reason: line.trim().to_owned(), path: self.path.clone() });
        }
        fs::rename(&self.temporary, &self.path).map_err(|source| failure(&self.path, source))
    }
}

impl Drop for FilmSink {
    fn drop(&mut self) {
        if let Some(mut encoder) = self.encoder.take() {
            // Unfinished: it may have ended already, and what it wrote is removed in any case.
            let _killed = encoder.child.kill();
            let _ended = encoder.end();
        }
        // After `finish` there is none.
        let _removed = fs::remove_file(&self.temporary);
    }
}

fn start_failure(source: io::Error) -> SinkError {
    if source.kind() == io::ErrorKind::NotFound { SinkError::NoFfmpeg } else { SinkError::StartFfmpeg { source } }
}

/// The end of what ffmpeg says; reads until it closes its messages.
fn last_words(mut stderr: ChildStderr) -> String {
    let (mut kept, mut chunk) = (Vec::new(), [0; 1024]);
    while let Ok(count) = stderr.read(&mut chunk) {
        if count == 0 {
            break;
        }
        kept.extend_from_slice(&chunk[..count]);
        let surplus = kept.len().saturating_sub(MESSAGE_BYTES);
        kept.drain(..surplus);
    }
    String::from_utf8_lossy(&kept).into_owned()
}

fn pad(picture: &Picture<'_>, size: [u32; 2], out: &mut Vec<u8>) {
    let [width, height] = picture.size.map(|side| side as usize);
    out.clear();
    for row in 0..size[1] as usize {
        let start = row.min(height - 1) * width * 4;
        let pixels = &picture.rgba[start..start + width * 4];
        out.extend_from_slice(pixels);
        if size[0] as usize > width {
            out.extend_from_slice(&pixels[width * 4 - 4..]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use terravision_common::camera::Camera;

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("terravision-film-{name}-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        folder
    }

    fn frames(sink: &mut FilmSink, size: [u32; 2]) -> Result<(), SinkError> {
        let rgba: Vec<u8> = (0..size[0] * size[1] * 4).map(|i| (i % 251) as u8).collect();
        let camera = Camera::zeroed();
        for frame in 0..10 {
            sink.write(&Picture { frame, size, rgba: &rgba, reversed_depth: None, camera, is_settled: true })?;
        }
        Ok(())
    }

    #[test]
    fn a_film_appears_when_it_is_complete_twice_the_same() {
        let folder = folder("same");
        let films = ["a.mp4", "b.mp4"].map(|name| folder.join(name));
        for film in &films {
            let mut sink = FilmSink::new(film, 30.0).unwrap();
            frames(&mut sink, [65, 33]).unwrap();
            assert!(!film.exists());
            sink.finish().unwrap();
        }
        let [a, b] = films.map(|film| fs::read(film).unwrap());
        assert!(a.len() > 500 && a == b, "{} and {} bytes", a.len(), b.len());
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 2);
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn an_unfinished_film_leaves_nothing() {
        let folder = folder("unfinished");
        let mut sink = FilmSink::new(&folder.join("a.mp4"), 30.0).unwrap();
        frames(&mut sink, [64, 64]).unwrap();
        drop(sink);
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 0);
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_missing_ffmpeg_is_said_before_anything_is_drawn() {
        let folder = folder("missing");
        let made = FilmSink::with_program(&folder.join("a.mp4"), 30.0, Path::new("/nonexistent/ffmpeg"));
        assert!(matches!(made, Err(SinkError::NoFfmpeg)));
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 0);
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn an_ffmpeg_that_fails_is_quoted() {
        let folder = folder("fails");
        // The container that belongs to this extension does not exist.
        let mut sink = FilmSink::new(&folder.join("a.nonsense"), 30.0).unwrap();
        let error = frames(&mut sink, [512, 512]).and_then(|()| sink.finish()).unwrap_err();
        assert!(matches!(&error, SinkError::Ffmpeg { .. }), "{error}");
        drop(sink);
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 0);
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn an_unwritable_place_is_said_at_once() {
        let made = FilmSink::new(Path::new("/proc/nowhere/a.mp4"), 30.0);
        assert!(matches!(made, Err(SinkError::Write { .. })));
    }
}
