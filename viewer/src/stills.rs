//! Exact pictures: drawn by `terravision still`, one at a time, so that they are its bytes.

use crate::command::{Running, ScratchFile, reason, terravision};
use bytes::Bytes;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use terravision_common::viewer::{StreamSettings, ViewerPose, ViewerSetup};
use tokio::io::AsyncReadExt;
use tokio::sync::Semaphore;

/// Most stills that wait to be drawn.
pub(crate) const MOST_WAITING: usize = 8;
/// Longest time that one may take.
const LONGEST: Duration = Duration::from_secs(120);
/// Most bytes of a still's messages that are read.
const MESSAGE_BYTES: u64 = 4096;

/// Why there is no still.
#[derive(Debug, thiserror::Error)]
pub(crate) enum StillError {
    /// Others wait already.
    #[error("{MOST_WAITING} stills wait to be drawn; try again later")]
    Busy,
    /// It was not drawn.
    #[error("the still was not drawn: {0}")]
    Failed(String),
}

/// What is to be drawn.
#[derive(Debug, Clone)]
pub(crate) struct StillOrder {
    /// From where.
    pub(crate) pose: ViewerPose,
    /// Width and height, pixels; of one eye.
    pub(crate) size: [u32; 2],
    /// As the flight shows it.
    pub(crate) settings: StreamSettings,
}

/// Draws stills.
#[derive(Debug)]
pub(crate) struct Stills {
    program: PathBuf,
    world: String,
    flags: Vec<String>,
    scratch: PathBuf,
    queue: Semaphore,
    turn: Semaphore,
    drawn: AtomicU64,
}

impl Stills {
    pub(crate) fn new(setup: &ViewerSetup) -> Self {
        Self {
            program: setup.programs.join("terravision"),
            world: setup.world.clone(),
            flags: setup.still_flags.clone(),
            scratch: setup.scratch.clone(),
            queue: Semaphore::new(MOST_WAITING + 1),
            turn: Semaphore::new(1),
            drawn: AtomicU64::new(0),
        }
    }

    /// Stills that were drawn.
    pub(crate) fn drawn(&self) -> u64 {
        self.drawn.load(Ordering::Relaxed)
    }

    /// The arguments of a still, without the file.
    fn arguments(&self, order: &StillOrder) -> Vec<String> {
        let ViewerPose { x, y, z, heading, pitch, roll, vfov } = order.pose;
        let [width, height] = order.size;
        let own = [
            "still".to_owned(),
            self.world.clone(),
            format!("--eye={x},{y},{z}"),
            format!("--heading={heading}"),
            format!("--pitch={pitch}"),
            format!("--roll={roll}"),
            format!("--vfov={vfov}"),
            format!("--size={width}x{height}"),
        ];
        own.into_iter().chain(self.flags.iter().cloned()).chain(order.settings.picture_flags()).collect()
    }

    /// The command that makes the same file, as it is typed.
    pub(crate) fn command(&self, order: &StillOrder) -> String {
        let quoted = |word: &String| {
            let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_=,./:+%".contains(c);
            if word.chars().all(is_plain) { word.clone() } else { format!("'{}'", word.replace('\'', r"'\''")) }
        };
        let words: Vec<String> = self.arguments(order).iter().map(quoted).collect();
        format!("terravision {} -o still.png", words.join(" "))
    }

    /// Draws one when it is its turn; what waits and is dropped is not drawn.
    pub(crate) async fn draw(&self, order: &StillOrder) -> Result<Bytes, StillError> {
        let _place = self.queue.try_acquire().map_err(|_full| StillError::Busy)?;
        let _turn = self.turn.acquire().await.map_err(|_closed| StillError::Busy)?;
        let number = self.drawn.fetch_add(1, Ordering::Relaxed);
        let file = ScratchFile(self.scratch.join(format!("still-{}-{number}.png", std::process::id())));
        let failed = |error: std::io::Error| StillError::Failed(error.to_string());
        let output = ["--quiet".to_owned(), "-o".into(), file.0.display().to_string()];
        let arguments = self.arguments(order).into_iter().chain(output).collect();
        let mut running = Running::start(&mut terravision(&self.program, arguments)).map_err(failed)?;
        let mut said = String::new();
        let stderr = running.stderr();
        let ended = tokio::time::timeout(LONGEST, async {
            if let Some(stderr) = stderr {
                stderr.take(MESSAGE_BYTES).read_to_string(&mut said).await.ok();
            }
            running.ended().await
        });
        let code = ended.await.map_err(|_late| StillError::Failed("it took too long".into()))?.map_err(failed)?;
        // 3: some tiles were missing, and the picture says what there is.
        if !matches!(code, Some(0 | 3)) {
            return Err(StillError::Failed(reason(&said)));
        }
        std::fs::read(&file.0).map(Bytes::from).map_err(failed)
    }
}
