//! How a film is encoded: what `--codec`, `--crf`, `--preset` and the name of the file come to, and
//! whether this machine's ffmpeg can do it.

use crate::cli::film::FilmArgs;
use crate::failure::Failure;
use crate::machine::find_program;
use crate::stream::film::{Codec, Container, FilmFormat};
use anyhow::anyhow;
use std::io::Read;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// How long ffmpeg may take to say what it can do.
const PATIENCE: Duration = Duration::from_secs(5);
/// Between two looks at whether it has.
const TICK: Duration = Duration::from_millis(2);

/// The format of a film of this name; `None` when it is not the name of a film.
///
/// # Errors
/// Bad input: a codec that the file cannot hold, a rate factor out of range. Failed: no ffmpeg, or
/// one without the encoder.
pub(super) fn format(path: &Path, args: &FilmArgs) -> Result<Option<FilmFormat>, Failure> {
    let Some(container) = Container::of(path) else { return Ok(None) };
    let known = container.codecs();
    let codec = args.codec.unwrap_or(known[0]);
    if !known.contains(&codec) {
        let names: Vec<&str> = known.iter().map(|codec| codec.name()).collect();
        return Err(Failure::bad_input(anyhow!(
            "--codec {}: expected {} for {}",
            codec.name(),
            names.join(" or "),
            path.display()
        )));
    }
    let crf = match (codec.crf(args.preset), args.crf) {
        (Some((_, most)), Some(asked)) if asked > most => {
            return Err(Failure::bad_input(anyhow!(
                "--crf {asked}: expected a number from 0 (best) to {most} for {}",
                codec.name()
            )));
        }
        (Some((usual, _)), asked) => Some(asked.unwrap_or(usual)),
        (None, Some(asked)) => {
            return Err(Failure::bad_input(anyhow!(
                "--crf {asked}: {} has no rate factor: it {}",
                codec.name(),
                if codec == Codec::Ffv1 { "is lossless" } else { "always has 256 colours a frame" }
            )));
        }
        (None, None) => None,
    };
    if let Some(preset) = args.preset.filter(|_| !codec.has_presets()) {
        return Err(Failure::bad_input(anyhow!(
            "--preset {}: {} has no such presets, expected h264 or h265; leave it out",
            preset.name(),
            codec.name()
        )));
    }
    has_encoder(codec, path)?;
    Ok(Some(FilmFormat { container, codec, crf, preset: args.preset }))
}

/// `--codec`, `--crf` and `--preset` are for films.
///
/// # Errors
/// Bad input: one is given.
pub(super) fn refuse(args: &FilmArgs, output: &Path) -> Result<(), Failure> {
    let flags = [("--codec", args.codec.is_some()), ("--crf", args.crf.is_some()), ("--preset", args.preset.is_some())];
    let Some((flag, _)) = flags.into_iter().find(|(_, is_given)| *is_given) else { return Ok(()) };
    Err(Failure::bad_input(anyhow!(
        "{flag} applies to films (.{}) only, not to -o {}",
        Container::EXTENSIONS.join(", ."),
        output.display()
    )))
}

/// Whether ffmpeg can make it; said before the flight, not after.
fn has_encoder(codec: Codec, path: &Path) -> Result<(), Failure> {
    let Some(program) = find_program("ffmpeg") else {
        return Err(Failure::failed(anyhow!(
            "ffmpeg makes the film and is not installed: apt-get install ffmpeg, or write frames with -o DIR/"
        )));
    };
    match encoders(&program) {
        Some(known) if !known.iter().any(|name| name == codec.encoder()) => Err(Failure::failed(anyhow!(
            "{}: this ffmpeg ({}) has no encoder {}, which makes {}; expected one built with it, or another --codec or kind of file",
            path.display(),
            program.display(),
            codec.encoder(),
            codec.name()
        ))),
        // What does not say what it can do may still do it: the flight will tell.
        _ => Ok(()),
    }
}

/// The names of the encoders that an ffmpeg has; `None` when it does not say so in time.
fn encoders(program: &Path) -> Option<Vec<String>> {
    let mut child = Command::new(program)
        .args(["-hide_banner", "-nostdin", "-loglevel", "error", "-encoders"])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .ok()?;
    let mut stdout = child.stdout.take()?;
    let reader = std::thread::spawn(move || {
        let mut text = Vec::new();
        stdout.read_to_end(&mut text).map(|_| String::from_utf8_lossy(&text).into_owned())
    });
    let until = Instant::now() + PATIENCE;
    while matches!(child.try_wait(), Ok(None)) {
        if Instant::now() >= until {
            drop(child.kill());
            drop(child.wait());
            // The thread ends with the last one that holds the other end of the pipe.
            return None;
        }
        std::thread::sleep(TICK);
    }
    let text = reader.join().ok()?.ok()?;
    parse_encoders(&text)
}

/// Lines such as ` V....D libx264              libx264 H.264 …`, behind a line of dashes.
fn parse_encoders(text: &str) -> Option<Vec<String>> {
    let (_, list) = text.split_once("------")?;
    let names = list.lines().filter_map(|line| {
        let mut words = line.split_whitespace();
        words.next().filter(|flags| flags.starts_with('V'))?;
        words.next().map(str::to_owned)
    });
    Some(names.collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::film::Preset;

    #[test]
    fn encoders_are_read_from_what_ffmpeg_says() {
        let text = "Encoders:\n V..... = Video\n A..... = Audio\n ------\n V....D libx264              libx264 H.264 (codec h264)\n \
                    A....D aac                  AAC\n V....D gif                  GIF\n";
        assert_eq!(parse_encoders(text).unwrap(), ["libx264", "gif"]);
        assert_eq!(parse_encoders("frame=1"), None);
        assert_eq!(encoders(Path::new("/nonexistent/ffmpeg")), None);
    }

    #[test]
    fn a_file_has_codecs_of_its_kind_and_factors_of_its_codec() {
        let args = |codec, crf| FilmArgs { codec, crf, preset: None };
        let told = |path: &str, args: FilmArgs| format(Path::new(path), &args).unwrap_err().to_string();
        assert_eq!(told("a.webm", args(Some(Codec::H264), None)), "--codec h264: expected vp9 or av1 for a.webm");
        assert!(told("a.mov", args(Some(Codec::Av1), None)).contains("expected h264 or h265"));
        assert!(told("a.mp4", args(None, Some(52))).contains("from 0 (best) to 51 for h264"));
        assert!(told("a.gif", args(None, Some(5))).contains("256 colours"));
        assert!(told("a.mkv", args(Some(Codec::Ffv1), Some(5))).contains("lossless"));
        let preset = |codec| FilmArgs { codec, crf: None, preset: Some(Preset::Slow) };
        assert!(told("a.webm", preset(None)).contains("--preset slow: vp9 has no such presets"));
        assert!(refuse(&preset(None), Path::new("x/")).unwrap_err().to_string().contains("--preset applies to films"));
        assert_eq!(format(Path::new("frames"), &args(None, None)).unwrap(), None);
        assert!(
            refuse(&args(None, Some(5)), Path::new("x/")).unwrap_err().to_string().contains("--crf applies to films")
        );
        assert!(refuse(&args(None, None), Path::new("x/")).is_ok());
    }
}
