//! Films of paths: made by `terravision fly` in exact mode, one at a time, in a folder of the
//! server's own that has a bound in bytes (docs/viewer.md).

mod making;
mod order;

pub(crate) use order::FilmOrder;

use crate::hub::{Hub, Refusal, lock};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use terravision_common::viewer::ViewerSetup;
use tokio::sync::{Notify, watch};

/// Most films that are kept, or that failed.
const MOST_FILMS: usize = 64;

/// What is kept of a film's order.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Summary {
    name: String,
    size: [u32; 2],
    fps: f64,
    quality: String,
}

/// How a film is.
#[derive(Debug, Clone)]
enum State {
    /// Frames that were written, of how many; 0 until it is known.
    Drawing { drawn: u64, frames: u64 },
    /// It is there; what there is to say of it.
    Done { bytes: u64, text: Option<String> },
    /// Why it was not made.
    Failed { text: String },
}

#[derive(Debug)]
struct Film {
    id: u32,
    summary: Summary,
    state: State,
    cancel: Arc<Notify>,
}

/// All films of this server.
#[derive(Debug)]
pub(crate) struct Films {
    folder: PathBuf,
    most_bytes: u64,
    list: Mutex<Vec<Film>>,
    /// `films` of the protocol, as text.
    pub(crate) changed: watch::Sender<Arc<str>>,
}

/// A film to be sent.
pub(crate) struct FilmFile {
    pub(crate) file: fs::File,
    pub(crate) bytes: u64,
    /// Its name at the client's.
    pub(crate) name: String,
}

impl Films {
    pub(crate) fn new(setup: &ViewerSetup) -> Self {
        let folder = setup.scratch.join("films");
        let list = Mutex::new(found_in(&folder));
        let films = Self { folder, most_bytes: setup.film_bytes, list, changed: watch::Sender::new(Arc::from("{}")) };
        films.publish();
        films
    }

    /// What the folder has, also of a film that is being made.
    fn bytes(&self) -> u64 {
        let entries = fs::read_dir(&self.folder).into_iter().flatten().flatten();
        entries.filter_map(|entry| entry.metadata().ok()).map(|found| found.len()).sum()
    }

    fn file_of(&self, id: u32) -> PathBuf {
        self.folder.join(format!("film-{id}.mp4"))
    }

    fn publish(&self) {
        let text = self.value(&lock(&self.list)).to_string();
        self.changed.send_replace(text.into());
    }

    fn value(&self, list: &[Film]) -> Value {
        let films: Vec<Value> = list.iter().map(Film::value).collect();
        json!({"type": "films", "films": films, "bytes": self.bytes(), "most_bytes": self.most_bytes})
    }

    /// Begins with a film: its id.
    pub(crate) fn order(&self, hub: &Arc<Hub>, order: &FilmOrder) -> Result<u32, Refusal> {
        let id = {
            let mut list = lock(&self.list);
            if list.iter().any(|film| matches!(film.state, State::Drawing { .. })) {
                return Err(("busy", "another film is being made: wait for its end, or cancel it".into()));
            }
            let used = self.bytes();
            if used >= self.most_bytes {
                let (used, most) = (for_people(used), for_people(self.most_bytes));
                let text = format!(
                    "the films of this server take {used}, and may take {most} (--film-bytes): remove one first"
                );
                return Err(("no-room", text));
            }
            if list.len() >= MOST_FILMS {
                let failed = list.iter().position(|film| matches!(film.state, State::Failed { .. }));
                let text = || format!("this server keeps {MOST_FILMS} films: remove one first");
                drop(list.remove(failed.ok_or_else(|| ("no-room", text()))?));
            }
            let id = list.iter().map(|film| film.id).max().unwrap_or(0) + 1;
            let name = if order.name.is_empty() { format!("Film {id}") } else { order.name.clone() };
            let summary = Summary { name, size: order.size, fps: order.fps, quality: order.quality.name().to_owned() };
            let (state, cancel) = (State::Drawing { drawn: 0, frames: 0 }, Arc::new(Notify::new()));
            list.push(Film { id, summary, state, cancel: Arc::clone(&cancel) });
            tokio::spawn(making::make(Arc::clone(hub), id, order.clone(), cancel));
            id
        };
        self.publish();
        Ok(id)
    }

    /// A film that is being made is no longer, and one that is there goes.
    pub(crate) fn remove(&self, id: u32) -> Result<(), Refusal> {
        {
            let mut list = lock(&self.list);
            let at = list.iter().position(|film| film.id == id).ok_or_else(|| unknown(id))?;
            if let State::Drawing { .. } = list[at].state {
                list[at].cancel.notify_one();
                return Ok(());
            }
            list.remove(at);
        }
        fs::remove_file(self.file_of(id)).ok();
        fs::remove_file(self.file_of(id).with_extension("json")).ok();
        self.publish();
        Ok(())
    }

    /// The file of a film that is there.
    pub(crate) fn open(&self, id: u32) -> Result<FilmFile, Refusal> {
        let name = {
            let list = lock(&self.list);
            let film = list.iter().find(|film| film.id == id).ok_or_else(|| unknown(id))?;
            if !matches!(film.state, State::Done { .. }) {
                return Err(("not-found", format!("film {id} is not there yet")));
            }
            film.file_name()
        };
        let failed = |error: std::io::Error| ("failed", format!("film {id} cannot be read: {error}"));
        let file = fs::File::open(self.file_of(id)).map_err(failed)?;
        let bytes = file.metadata().map_err(failed)?.len();
        Ok(FilmFile { file, bytes, name })
    }

    /// A film is further than before, or has ended; without a state it is gone.
    fn change(&self, id: u32, state: Option<State>) {
        {
            let mut list = lock(&self.list);
            let Some(at) = list.iter().position(|film| film.id == id) else { return };
            match state {
                Some(state) => list[at].state = state,
                None => drop(list.remove(at)),
            }
            let film = list.get(at).filter(|film| film.id == id);
            if let Some(Film { state: State::Done { .. }, summary, .. }) = film {
                // For the next viewer, should this one die.
                let text = json!(summary).to_string();
                fs::write(self.file_of(id).with_extension("json"), text).ok();
            }
        }
        self.publish();
    }
}

fn unknown(id: u32) -> Refusal {
    ("not-found", format!("there is no film {id}"))
}

impl Film {
    fn value(&self) -> Value {
        let Summary { name, size, fps, quality } = &self.summary;
        let mut value = json!({"id": self.id, "name": name, "size": size, "fps": fps, "quality": quality});
        let more = match &self.state {
            State::Drawing { drawn, frames } => json!({"state": "drawing", "drawn": drawn, "frames": frames}),
            State::Done { bytes, text } => json!({"state": "done", "bytes": bytes, "text": text}),
            State::Failed { text } => json!({"state": "failed", "text": text}),
        };
        if let (Some(value), Value::Object(more)) = (value.as_object_mut(), more) {
            value.extend(more);
        }
        value
    }

    /// Its name as a file, which every system takes.
    fn file_name(&self) -> String {
        let plain = |c: char| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '-' };
        format!("{}.mp4", self.summary.name.chars().map(plain).collect::<String>())
    }
}

/// The films that an earlier viewer of this server has left; what is half is removed.
fn found_in(folder: &Path) -> Vec<Film> {
    let mut films = Vec::new();
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        let id =
            path.file_name().and_then(|name| name.to_str()?.strip_prefix("film-")?.strip_suffix(".mp4")?.parse().ok());
        let summary = fs::read(path.with_extension("json")).ok().and_then(|text| serde_json::from_slice(&text).ok());
        if let (Some(id), Some(summary), Ok(found)) = (id, summary, entry.metadata()) {
            let state = State::Done { bytes: found.len(), text: None };
            films.push(Film { id, summary, state, cancel: Arc::default() });
        } else if path.extension().is_none_or(|extension| extension != "json") {
            fs::remove_file(path).ok();
        }
    }
    films.sort_by_key(|film| film.id);
    films
}

/// Bytes, as people read them.
fn for_people(bytes: u64) -> String {
    match bytes {
        0..1_000_000 => format!("{:.1} kB", bytes as f64 / 1e3),
        1_000_000..1_000_000_000 => format!("{:.1} MB", bytes as f64 / 1e6),
        _ => format!("{:.1} GB", bytes as f64 / 1e9),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_successor_finds_whole_films_and_removes_halves() {
        let folder = std::env::temp_dir().join(format!("tv-films-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let summary = r#"{"name":"Ridge, north","size":[640,360],"fps":25.0,"quality":"best"}"#;
        for (name, content) in
            [("film-7.mp4", "film"), ("film-7.json", summary), ("film-8.mp4", "half"), (".x", "half")]
        {
            fs::write(folder.join(name), content).unwrap();
        }
        let films = found_in(&folder);
        assert_eq!((films.len(), films[0].id, films[0].file_name().as_str()), (1, 7, "Ridge--north.mp4"));
        assert!(
            !folder.join("film-8.mp4").exists() && !folder.join(".x").exists() && folder.join("film-7.mp4").exists()
        );
        assert_eq!(films[0].value()["bytes"], 4);
        fs::remove_dir_all(folder).unwrap();
        assert_eq!(for_people(2_500_000), "2.5 MB");
    }
}
