//! Path files of clients, brought into the world's coordinates by `terravision path`: the one
//! reader of paths there is, whatever kind they are of.

use crate::command::{Running, ScratchFile, reason, terravision};
use crate::hub::{Hub, Refusal};
use bytes::Bytes;
use std::process::Stdio;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::io::AsyncReadExt;
use tokio::sync::Semaphore;

/// Largest path file of a client, bytes.
pub(crate) const MOST_PATH_BYTES: usize = 16 << 20;
/// Most bytes of what becomes of it.
const MOST_CONVERTED_BYTES: u64 = 64 << 20;
/// Conversions that wait; more are refused.
const MOST_WAITING: usize = 4;
/// Longest time that one may take.
const LONGEST: Duration = Duration::from_secs(60);
/// Most bytes of a conversion's messages that are read.
const MESSAGE_BYTES: u64 = 4096;
/// Longest name of a file in a message, characters.
const NAME_CHARS: usize = 80;

/// Converts paths, one at a time.
#[derive(Debug)]
pub(crate) struct Conversions {
    queue: Semaphore,
    turn: Semaphore,
    done: AtomicU64,
}

impl Default for Conversions {
    fn default() -> Self {
        Self { queue: Semaphore::new(MOST_WAITING + 1), turn: Semaphore::new(1), done: AtomicU64::new(0) }
    }
}

/// A path file as JSON keyframes (or frames) in the world's CRS. `name`: what the client calls it.
pub(crate) async fn convert(hub: &Hub, name: &str, file: &[u8]) -> Result<Bytes, Refusal> {
    let busy = || ("busy", "other paths are being read; try again later".to_owned());
    let _place = hub.conversions.queue.try_acquire().map_err(|_full| busy())?;
    let _turn = hub.conversions.turn.acquire().await.map_err(|_closed| busy())?;
    let number = hub.conversions.done.fetch_add(1, Ordering::Relaxed);
    let setup = hub.setup();
    let scrap = ScratchFile(setup.scratch.join(format!("upload-{}-{number}", std::process::id())));
    let failed = |error: std::io::Error| ("failed", format!("the path cannot be read: {error}"));
    std::fs::write(&scrap.0, file).map_err(failed)?;
    let shown = scrap.0.display().to_string();
    let mut arguments =
        vec!["path".to_owned(), setup.world.clone(), "--path".into(), shown.clone(), "--keyframes".into()];
    if let Some(factor) = hub.flight.borrow().settings.exaggeration {
        arguments.push(format!("--exaggeration={factor}"));
    }
    arguments.extend(setup.database_flags.iter().cloned());
    let mut command = terravision(&setup.programs.join("terravision"), arguments);
    let mut running = Running::start(command.stdout(Stdio::piped())).map_err(failed)?;
    let (stdout, stderr) = (running.stdout(), running.stderr());
    let (mut converted, mut said) = (Vec::new(), String::new());
    let ended = tokio::time::timeout(LONGEST, async {
        if let (Some(stdout), Some(stderr)) = (stdout, stderr) {
            let out = async { stdout.take(MOST_CONVERTED_BYTES + 1).read_to_end(&mut converted).await.ok() };
            let err = async { stderr.take(MESSAGE_BYTES).read_to_string(&mut said).await.ok() };
            tokio::join!(out, err);
        }
        if converted.len() as u64 > MOST_CONVERTED_BYTES {
            running.end();
        }
        running.ended().await
    });
    let code = ended.await.map_err(|_late| ("failed", "the path took too long to be read".to_owned()))?;
    if converted.len() as u64 > MOST_CONVERTED_BYTES {
        return Err(("too-large", format!("the path has more than {} MiB of poses", MOST_CONVERTED_BYTES >> 20)));
    }
    let name: String = name.chars().filter(|c| !c.is_control()).take(NAME_CHARS).collect();
    let name = if name.is_empty() { "the path".to_owned() } else { name };
    if code.map_err(failed)? != Some(0) {
        return Err(("bad-path", reason(&said).replace(&shown, &name)));
    }
    for (is_warning, text) in remarks(&said) {
        hub.note(is_warning, format!("{name}: {}", text.replace(&shown, &name)));
    }
    Ok(Bytes::from(converted))
}

/// The notes and warnings of a reader that was successful; whether each is a warning.
fn remarks(said: &str) -> impl Iterator<Item = (bool, &str)> {
    said.lines().filter_map(|line| {
        let line = line.strip_prefix("terravision: ")?;
        let warning = line.strip_prefix("warning: ").map(|text| (true, text));
        warning.or_else(|| Some((false, line.strip_prefix("note: ")?)))
    })
}
