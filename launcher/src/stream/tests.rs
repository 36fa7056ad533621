//! Streams over pipes of this process.

use super::encoder::Encoder;
use super::film::{Codec, Container, FilmFormat};
use super::relay::{Passage, Relay, StreamShape};
use super::{StreamError, StreamTarget};
use std::fs;
use std::io::{self, PipeReader, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};
use terravision_common::film::{FrameEncoding, Packet};
use terravision_common::run::OPEN_END;
use terravision_common::shm::{StreamReader, memory};

const BYTES: u64 = 3;

/// A writer that several threads share; it breaks after this many bytes.
#[derive(Clone)]
struct Shared(Arc<Mutex<Vec<u8>>>, usize);

impl Write for Shared {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut all = self.0.lock().unwrap();
        if all.len() >= self.1 {
            return Err(io::ErrorKind::BrokenPipe.into());
        }
        all.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Frames that a renderer has put into the ring, and what it has said of them before it ended.
#[derive(Clone)]
struct Renderer {
    frames: Vec<u64>,
    /// Bytes of its last packet.
    last_bytes: usize,
}

fn sends(frames: &[u64]) -> Renderer {
    Renderer { frames: frames.to_vec(), last_bytes: Packet::SIZE }
}

/// A pipe through which a renderer has sent these bytes before it ended.
fn pipe(bytes: &[u8]) -> PipeReader {
    let (read, mut write) = io::pipe().unwrap();
    write.write_all(bytes).unwrap();
    read
}

struct Relayed {
    result: Result<(), StreamError>,
    /// The first byte of each frame.
    frames: Vec<u8>,
    has_failed: bool,
}

fn relay(frames: [u64; 2], has_gaps: bool, renderers: &[Renderer], is_complete: bool, breaks_after: usize) -> Relayed {
    let (mut writer, reader) = memory::stream_ring(32, BYTES as u32).unwrap();
    let control = memory::control().unwrap();
    let mut said = Vec::new();
    for Renderer { frames, last_bytes } in renderers {
        let mut bytes = Packet { frame: Packet::BEGIN, position: writer.next_position() }.to_bytes().to_vec();
        for frame in frames {
            let mut array = writer.begin(&control).unwrap();
            array.fill(*frame as u8);
            bytes.extend(Packet { frame: *frame, position: array.publish() }.to_bytes());
        }
        bytes.truncate(bytes.len() - Packet::SIZE + last_bytes);
        said.push(bytes);
    }
    relay_said(frames, has_gaps, reader, &said, is_complete, breaks_after)
}

fn relay_said(
    frames: [u64; 2],
    has_gaps: bool,
    ring: StreamReader,
    said: &[Vec<u8>],
    is_complete: bool,
    breaks_after: usize,
) -> Relayed {
    let shape = StreamShape { frames, has_gaps };
    let out = Shared(Arc::default(), breaks_after);
    let passage = Arc::new(Passage::default());
    passage.is_complete.store(is_complete, Ordering::Relaxed);
    #[expect(clippy::disallowed_methods, reason = "a test sends a few")]
    let (pipes, coming) = channel();
    said.iter().for_each(|bytes| pipes.send(pipe(bytes)).unwrap());
    drop(pipes);
    let result = Relay::new(shape, ring, Box::new(out.clone()), Arc::clone(&passage)).run(&coming);
    let frames = out.0.lock().unwrap().chunks(BYTES as usize).map(|frame| frame[0]).collect();
    Relayed { result, frames, has_failed: passage.has_failed.load(Ordering::Relaxed) }
}

/// What a flight of frames 5 to 9 becomes, against the clock.
fn filled(renderers: &[Renderer]) -> Vec<u8> {
    let relayed = relay([5, 10], true, renderers, true, usize::MAX);
    relayed.result.unwrap();
    relayed.frames
}

#[test]
fn every_frame_of_a_flight_against_the_clock_has_a_picture() {
    assert_eq!(filled(&[sends(&[5, 6, 9])]), [5, 6, 6, 6, 9]);
    assert_eq!(filled(&[sends(&[7])]), [7, 7, 7, 7, 7]);
    assert_eq!(filled(&[]), [0; 0]);
}

#[test]
fn a_renderer_that_is_killed_takes_half_a_packet_along_and_no_more() {
    for last_bytes in [0, 1, 8, 15] {
        let killed = Renderer { last_bytes, ..sends(&[5, 6, 7]) };
        assert_eq!(filled(&[killed.clone(), sends(&[8, 9])]), [5, 6, 6, 8, 9], "{last_bytes} bytes of the last one");
        // In exact mode the next one draws it again.
        let relayed = relay([5, 10], false, &[killed, sends(&[7, 8, 9])], true, usize::MAX);
        relayed.result.unwrap();
        assert_eq!(relayed.frames, [5, 6, 7, 8, 9]);
    }
}

#[test]
fn what_comes_again_is_passed_on_once() {
    assert_eq!(filled(&[sends(&[5, 6, 7]), sends(&[6, 7, 8]), sends(&[9])]), [5, 6, 7, 8, 9]);
}

#[test]
fn a_flight_without_a_known_end_ends_with_its_last_frame() {
    let relayed = relay([0, OPEN_END], true, &[sends(&[0, 2])], true, usize::MAX);
    relayed.result.unwrap();
    assert_eq!(relayed.frames, [0, 0, 2]);
}

#[test]
fn a_stream_that_is_broken_off_is_not_filled_up() {
    let relayed = relay([5, 10], true, &[sends(&[5])], false, usize::MAX);
    relayed.result.unwrap();
    assert_eq!(relayed.frames, [5]);
}

#[test]
fn exact_frames_have_no_stand_in() {
    let relayed = relay([5, 10], false, &[sends(&[5, 7])], true, usize::MAX);
    assert!(matches!(relayed.result, Err(StreamError::Gap { frame: 6 })) && relayed.has_failed);
}

#[test]
fn packets_of_another_flight_are_refused() {
    for strange in [
        Packet { frame: 4, position: 0 },
        Packet { frame: 10, position: 0 },
        Packet { frame: 5, position: 1 },
        Packet { frame: 5, position: u64::MAX },
    ] {
        let (mut writer, reader) = memory::stream_ring(2, BYTES as u32).unwrap();
        writer.begin(&memory::control().unwrap()).unwrap().publish();
        let relayed = relay_said([5, 10], true, reader, &[strange.to_bytes().to_vec()], true, usize::MAX);
        assert!(matches!(relayed.result, Err(StreamError::StrangePacket { .. })) && relayed.has_failed);
    }
    let (_writer, reader) = memory::stream_ring(2, BYTES as u32).unwrap();
    let strange = Packet { frame: Packet::BEGIN, position: 1 };
    let relayed = relay_said([5, 10], true, reader, &[strange.to_bytes().to_vec()], true, usize::MAX);
    assert!(matches!(relayed.result, Err(StreamError::Ring { .. })) && relayed.has_failed);
}

/// A renderer that waits for room is not held up by one before it that told of nothing.
#[test]
fn frames_that_nobody_told_of_are_given_back() {
    let (mut writer, reader) = memory::stream_ring(2, BYTES as u32).unwrap();
    let control = memory::control().unwrap();
    for _ in 0..2 {
        writer.begin(&control).unwrap().publish();
    }
    assert!(!writer.has_room().unwrap());
    let begin = Packet { frame: Packet::BEGIN, position: writer.next_position() };
    relay_said([5, 10], false, reader, &[begin.to_bytes().to_vec()], false, usize::MAX).result.unwrap();
    assert!(writer.has_room().unwrap());
}

#[test]
fn a_reader_that_goes_is_told_of_before_the_renderer_notices() {
    let relayed = relay([5, 10], true, &[sends(&[5, 6, 7])], true, 2 * BYTES as usize);
    assert!(matches!(relayed.result, Err(StreamError::ReaderGone { frames: 2 })) && relayed.has_failed);
}

#[test]
fn targets_have_their_encodings() {
    assert_eq!(StreamTarget::Stdout.encoding(), FrameEncoding::Y4m);
    let film =
        StreamTarget::Film { path: "a.mp4".into(), temporary: ".a.part.mp4".into(), format: FilmFormat::usual() };
    assert_eq!(film.encoding(), FrameEncoding::Yuv420);
}

/// What is left of an ffmpeg that could write all but the end of the file.
#[test]
fn an_encoder_that_complains_and_ends_with_success_has_failed() {
    let folder = folder("complains");
    let program = folder.join("ffmpeg");
    let script = "#!/bin/sh\ncat > /dev/null\necho 'Error writing trailer: No space left on device' >&2\n";
    fs::write(&program, script).unwrap();
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
    let started = loop {
        match Encoder::start(&program, &folder.join("a.mp4"), FilmFormat::usual(), [2, 2], 30.0) {
            // Another test's fork holds the script open for writing for a moment.
            Err(StreamError::StartEncoder { source }) if source.kind() == io::ErrorKind::ExecutableFileBusy => {}
            started => break started,
        }
    };
    let (encoder, input) = started.unwrap();
    drop(input);
    assert_eq!(encoder.end().unwrap_err(), "Error writing trailer: No space left on device");
    fs::remove_dir_all(folder).unwrap();
}

fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("terravision-film-{name}-{}", std::process::id()));
    fs::create_dir_all(&folder).unwrap();
    folder
}

fn film(path: &Path, size: [u32; 2]) -> Result<(), String> {
    film_of(path, FilmFormat::usual(), size)
}

fn film_of(path: &Path, format: FilmFormat, size: [u32; 2]) -> Result<(), String> {
    let (encoder, mut input) = Encoder::start("ffmpeg".as_ref(), path, format, size, 30.0).unwrap();
    let bytes = format.codec.encoding().frame_bytes(size);
    let frame: Vec<u8> = (0..bytes).map(|i| (i % 251) as u8).collect();
    // An encoder that gives up closes its input.
    (0..10).try_for_each(|_| input.write_all(&frame)).ok();
    drop(input);
    encoder.end()
}

#[test]
fn the_same_pictures_make_the_same_film() {
    let folder = folder("same");
    let films = ["a.mp4", "b.mp4"].map(|name| folder.join(name));
    films.iter().for_each(|path| film(path, [65, 33]).unwrap());
    let [a, b] = films.map(|path| fs::read(path).unwrap());
    assert!(a.len() > 500 && a == b, "{} and {} bytes", a.len(), b.len());
    fs::remove_dir_all(folder).unwrap();
}

/// What ffprobe says of the first stream of a film.
fn probe(path: &Path) -> String {
    let output = std::process::Command::new("ffprobe")
        .args(["-v", "error", "-count_frames", "-select_streams", "v:0", "-of", "csv=p=0"])
        .args(["-show_entries", "stream=codec_name,width,height,nb_read_frames"])
        .arg(path)
        .output()
        .unwrap();
    String::from_utf8(output.stdout).unwrap().trim().trim_end_matches(',').to_owned()
}

/// Of those that this machine's ffmpeg can do.
#[test]
fn every_codec_makes_the_same_film_of_the_same_pictures() {
    let folder = folder("codecs");
    let listed = std::process::Command::new("ffmpeg").args(["-hide_banner", "-encoders"]).output().unwrap();
    let listed = String::from_utf8_lossy(&listed.stdout).into_owned();
    for (name, found, codec) in [
        ("mp4", "h264", Codec::H264),
        ("mov", "hevc", Codec::H265),
        ("webm", "vp9", Codec::Vp9),
        ("mp4", "av1", Codec::Av1),
        ("mkv", "ffv1", Codec::Ffv1),
        ("gif", "gif", Codec::Gif),
    ] {
        if !listed.contains(&format!(" {} ", codec.encoder())) {
            continue;
        }
        let films = ["a", "b"].map(|stem| folder.join(format!("{stem}-{}.{name}", codec.name())));
        let container = Container::of(&films[0]).unwrap();
        assert!(container.codecs().contains(&codec));
        let format = FilmFormat { container, codec, crf: codec.crf(None).map(|(usual, _)| usual), preset: None };
        // SVT-AV1 takes no smaller pictures.
        films.iter().for_each(|path| film_of(path, format, [129, 65]).unwrap());
        assert_eq!(probe(&films[0]), format!("{found},130,66,10"), "{}", codec.name());
        let [a, b] = films.map(|path| fs::read(path).unwrap());
        assert!(a == b, "{}: {} and {} bytes", codec.name(), a.len(), b.len());
    }
    fs::remove_dir_all(folder).unwrap();
}

#[test]
fn an_encoder_that_fails_is_quoted_and_one_that_is_killed_ends() {
    let folder = folder("fails");
    // The container that belongs to this extension does not exist.
    let words = film(&folder.join("a.nonsense"), [512, 512]).unwrap_err();
    assert!(words.len() > 10, "{words}");
    let (mut encoder, _input) =
        Encoder::start("ffmpeg".as_ref(), &folder.join("b.mp4"), FilmFormat::usual(), [64, 64], 30.0).unwrap();
    assert!(encoder.is_busy());
    let pid = encoder.pid();
    encoder.kill();
    assert!(!Path::new(&format!("/proc/{pid}")).exists());
    let missing =
        Encoder::start("/nonexistent/ffmpeg".as_ref(), &folder.join("c.mp4"), FilmFormat::usual(), [64, 64], 30.0);
    assert!(matches!(missing, Err(StreamError::StartEncoder { .. })));
    fs::remove_dir_all(folder).unwrap();
}
