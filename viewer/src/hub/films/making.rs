//! A film in the making: a flight that is watched until it ends, is cancelled, or has filled the
//! folder.

use super::{FilmOrder, Films, State, for_people};
use crate::command::{Running, terravision};
use crate::hub::{Hub, lock};
use std::fs::{self, DirBuilder};
use std::net::SocketAddr;
use std::os::unix::fs::DirBuilderExt;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, BufReader};
use tokio::process::ChildStderr;
use tokio::sync::Notify;

/// Between two looks at how far it is.
const LOOK_EVERY: Duration = Duration::from_millis(300);
/// Longest line of the flight that is read.
const LINE_BYTES: u64 = 4096;
/// Warnings that are told with a film.
const MOST_WARNINGS: usize = 3;

/// What the flight of a film has said.
#[derive(Debug, Default)]
struct Said {
    metrics: Option<SocketAddr>,
    warnings: Vec<String>,
    last: String,
}

/// Makes a film to its end, or until it is cancelled.
pub(super) async fn make(hub: Arc<Hub>, id: u32, order: FilmOrder, cancel: Arc<Notify>) {
    let path = hub.setup().scratch.join(format!("path-{id}.json"));
    let state = match begin(&hub, id, &order, &path) {
        Ok(running) => watch(&hub, id, running, &cancel).await,
        Err(error) => Some(State::Failed { text: format!("the film cannot be begun: {error}") }),
    };
    fs::remove_file(&path).ok();
    // Messages name the path's file, which means nothing to the client.
    let state = match state {
        Some(State::Failed { text }) => {
            Some(State::Failed { text: text.replace(&path.display().to_string(), "the path") })
        }
        other => other,
    };
    hub.films.change(id, state);
}

fn begin(hub: &Hub, id: u32, order: &FilmOrder, path: &Path) -> std::io::Result<Running> {
    let Films { folder, .. } = &hub.films;
    DirBuilder::new().mode(0o700).recursive(true).create(folder)?;
    fs::write(path, order.path.to_string())?;
    let setup = hub.setup();
    let picture_flags = hub.flight.borrow().settings.picture_flags();
    let mut arguments = vec!["fly".to_owned(), setup.world.clone(), "--path".into(), path.display().to_string()];
    arguments.extend(setup.still_flags.iter().cloned().chain(picture_flags).chain(order.flags()));
    arguments.extend(["--metrics".into(), "0".into(), "-o".into(), hub.films.file_of(id).display().to_string()]);
    Running::start(&mut terravision(&setup.programs.join("terravision"), arguments))
}

/// Watches a flight: how the film is in the end; `None` when it was cancelled.
async fn watch(hub: &Hub, id: u32, mut running: Running, cancel: &Notify) -> Option<State> {
    let said = Arc::new(Mutex::new(Said::default()));
    let listening = running.stderr().map(|stderr| tokio::spawn(listen(stderr, Arc::clone(&said))));
    let mut looks = tokio::time::interval(LOOK_EVERY);
    let (mut is_cancelled, mut is_too_large) = (false, false);
    let code = loop {
        tokio::select! {
            ended = running.ended() => break ended,
            () = cancel.notified() => {
                is_cancelled = true;
                running.end();
            }
            _ = looks.tick() => {
                if !is_too_large && hub.films.bytes() > hub.films.most_bytes {
                    is_too_large = true;
                    running.end();
                }
                if let Some([drawn, frames]) = progress(&said).await {
                    hub.films.change(id, Some(State::Drawing { drawn, frames }));
                }
            }
        }
    };
    if let Some(listening) = listening {
        listening.await.ok();
    }
    if is_cancelled {
        return None;
    }
    let Said { warnings, last, .. } = std::mem::take(&mut *lock(&said));
    Some(match (code, fs::metadata(hub.films.file_of(id))) {
        _ if is_too_large => {
            let most = for_people(hub.films.most_bytes);
            State::Failed {
                text: format!("the film would need more than the {most} that films may take here (--film-bytes)"),
            }
        }
        // 3: some tiles were missing, and coarser ones were drawn in their place.
        (Ok(Some(0 | 3)), Ok(found)) => {
            State::Done { bytes: found.len(), text: Some(warnings.join("; ")).filter(|text| !text.is_empty()) }
        }
        (Err(error), _) => State::Failed { text: format!("the film's flight cannot be watched: {error}") },
        _ if last.is_empty() => State::Failed { text: "the film's flight ended without a message".into() },
        _ => State::Failed { text: last },
    })
}

/// Frames that were written, of how many, once the flight tells.
async fn progress(said: &Mutex<Said>) -> Option<[u64; 2]> {
    let address = lock(said).metrics?;
    let text = crate::hub::flight_metrics::metrics_at(address).await?;
    let number = |name: &str| {
        let line = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '))?;
        line.trim().parse::<f64>().ok().map(|value| value as u64)
    };
    Some([number("terravision_frames_written_total")?, number("terravision_frames")?])
}

/// Takes in what the flight says until it ends.
async fn listen(stderr: ChildStderr, said: Arc<Mutex<Said>>) {
    let mut reader = BufReader::new(stderr);
    loop {
        let mut line = Vec::new();
        match (&mut reader).take(LINE_BYTES).read_until(b'\n', &mut line).await {
            Ok(0) | Err(_) => return,
            Ok(_) => {}
        }
        let line = String::from_utf8_lossy(&line);
        let Some(text) = line.trim().strip_prefix("terravision: ") else { continue };
        let mut said = lock(&said);
        if let Some(url) = text.strip_prefix("metrics of the run: http://") {
            said.metrics = url.trim_end_matches("/metrics").parse().ok();
        } else if let Some(warning) = text.strip_prefix("warning: ") {
            if said.warnings.len() < MOST_WARNINGS {
                said.warnings.push(warning.to_owned());
            }
        } else if !text.starts_with("note: ") {
            text.clone_into(&mut said.last);
        }
    }
}
