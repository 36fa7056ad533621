//! A run of the pipeline in which this program plays the launcher, and any of the stages that it
//! does not start.

use crate::flight::Flight;
use anyhow::{Context, bail};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use terravision_common::event::{Event, EventContent, SpanName, TextKind};
use terravision_common::files::temporary_folder;
use terravision_common::level::Measure;
use terravision_common::run::{DatabaseConfig, RaysChoice, RenderConfig, RunConfig, TechniqueChoice};
use terravision_common::shm::{Consumer, Control, Layout, RunId, RunSegments, RunState, Stage};
use terravision_common::stage::STAGE_ENVIRONMENT;
use terravision_common::texels::TexelFormat;
use terravision_testkit::runs;

/// How a flight is flown.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Folder of the database.
    pub world: PathBuf,
    /// Picture size.
    pub size: [u32; 2],
    /// Bytes for the pools.
    pub memory_bytes: u64,
    /// Wanted screen resolutions of facets and texels, pixels.
    pub r_px: [f64; 2],
    /// Samples per pixel.
    pub samples: u32,
    /// How screen resolution is measured.
    pub measure: Measure,
    /// What the renderer draws by.
    pub technique: TechniqueChoice,
    /// What casts its rays, when it does.
    pub rays: RaysChoice,
}

/// No bench waits longer for anything.
const DEADLINE: Duration = Duration::from_secs(300);

/// Processes and segments of a run; everything goes away with it.
pub struct Session {
    config: RunConfig,
    run: RunId,
    control: Control,
    layout: Layout,
    stages: Vec<(Stage, Child)>,
    deadline: Instant,
    _segments: RunSegments,
}

impl std::fmt::Debug for Session {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Session").field("run", &self.run).field("stages", &self.stages).finish_non_exhaustive()
    }
}

/// Processor time that a stage has used, seconds.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct CpuSeconds(pub f64);

impl Session {
    /// Makes the segments for a flight of `frames` frames in all.
    ///
    /// # Errors
    /// When they cannot be made.
    pub fn new(settings: &Settings, flight: &Flight, frames: u64) -> anyhow::Result<Self> {
        // Unlike the launcher, a bench has several runs, in tests at the same time.
        let run = RunId::unique_for_tests();
        let [width, height] = settings.size;
        let layout = Layout::for_run(flight.database.world(), settings.memory_bytes, TexelFormat::Rgba8)?;
        let segments = RunSegments::create(&run, &layout).context("cannot make the segments")?;
        let control = Control::open(&run).context("cannot open the control block")?;
        control.set_resolutions(settings.r_px[0], settings.r_px[1]);
        let usual = runs::config([0, frames]);
        let config = RunConfig {
            run_id: run.to_string(),
            world: settings.world.clone(),
            database: DatabaseConfig::folder(&settings.world),
            width,
            height,
            r_z_px: settings.r_px[0],
            r_c_px: settings.r_px[1],
            measure: settings.measure,
            decoder_threads: std::thread::available_parallelism().map_or(1, |n| n.get() as u32),
            render: RenderConfig {
                technique: settings.technique,
                technique_reason: "asked for".to_owned(),
                rays: settings.rays,
                sky_rgb: [150, 190, 235],
                samples: settings.samples,
                // As many as the launcher leaves to the renderer.
                frames_in_flight: 0,
                ..usual.render
            },
            ..usual
        };
        let deadline = Instant::now() + DEADLINE;
        Ok(Self { config, run, control, layout, stages: Vec::new(), deadline, _segments: segments })
    }

    /// The run, for opening ends of its segments.
    #[must_use]
    pub fn run(&self) -> &RunId {
        &self.run
    }

    /// The control block.
    #[must_use]
    pub fn control(&self) -> &Control {
        &self.control
    }

    /// Sizes of the segments.
    #[must_use]
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Starts the process of a stage.
    ///
    /// # Errors
    /// When its program is not beside this one or does not start.
    pub fn start(&mut self, stage: Stage) -> anyhow::Result<()> {
        let program = sibling(&format!("terravision-{stage}"))?;
        let config = serde_json::to_string(&self.config).context("cannot write the run down")?;
        let mut command = Command::new(&program);
        command
            .envs(STAGE_ENVIRONMENT)
            // Standard error of a stage is read only after it has failed: its log would fill the
            // pipe.
            .env_remove(terravision_common::log::VARIABLE)
            .arg("--run")
            .arg(config)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped());
        let child = command.spawn().with_context(|| format!("cannot start {}", program.display()))?;
        tracing::debug!(%stage, pid = child.id(), "stage started");
        self.stages.push((stage, child));
        Ok(())
    }

    /// Checks that no stage has failed and that the deadline has not passed. Call it while waiting.
    ///
    /// # Errors
    /// When a stage has failed, with its last words, or the deadline has passed.
    pub fn check(&mut self) -> anyhow::Result<()> {
        for (stage, child) in &mut self.stages {
            if let Some(status) = child.try_wait().context("cannot look after a stage")?
                && !status.success()
            {
                let mut words = String::new();
                if let Some(stderr) = child.stderr.as_mut() {
                    // What it said is all there: it has ended.
                    stderr.read_to_string(&mut words).unwrap_or_default();
                }
                bail!("the {stage} ended with {status}: {}", words.trim());
            }
        }
        if Instant::now() > self.deadline {
            bail!("the run took longer than {} s", DEADLINE.as_secs());
        }
        Ok(())
    }

    /// Processor time of a stage so far, all its threads; 0 when it has ended.
    #[must_use]
    pub fn cpu_of(&self, stage: Stage) -> CpuSeconds {
        let pid = self.stages.iter().find(|(s, _)| *s == stage).map(|(_, child)| child.id());
        CpuSeconds(pid.and_then(cpu_seconds).unwrap_or_default())
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        self.control.set_state(RunState::Stopping);
        let patience = Instant::now() + Duration::from_secs(5);
        for (_, child) in &mut self.stages {
            while Instant::now() < patience && matches!(child.try_wait(), Ok(None)) {
                std::thread::sleep(Duration::from_millis(2));
            }
            // Fails when it has ended, as it should have.
            child.kill().unwrap_or_default();
            drop(child.wait());
        }
    }
}

/// Processor time of a process. The scheduler counts nanoseconds of each thread that lives, as all
/// of a stage's do; where it does not tell, hundredths of a second have to do, in which some
/// machines count in steps of several.
fn cpu_seconds(pid: u32) -> Option<f64> {
    threads_cpu_seconds(pid).or_else(|| ticks_cpu_seconds(pid))
}

/// The first field of `/proc/PID/task/TID/schedstat`, of all threads
/// (Documentation/scheduler/sched-stats.rst).
fn threads_cpu_seconds(pid: u32) -> Option<f64> {
    let mut nanos = 0.0;
    for thread in std::fs::read_dir(format!("/proc/{pid}/task")).ok()? {
        // One that ends meanwhile does not count.
        let Ok(text) = std::fs::read_to_string(thread.ok()?.path().join("schedstat")) else { continue };
        nanos += text.split_whitespace().next()?.parse::<f64>().ok()?;
    }
    (nanos > 0.0).then_some(1e-9 * nanos)
}

/// User and system time from `/proc/PID/stat` (fields 14 and 15).
fn ticks_cpu_seconds(pid: u32) -> Option<f64> {
    let text = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    let fields: Vec<&str> = text[text.rfind(')')? + 1..].split_whitespace().collect();
    let ticks = |at: usize| fields.get(at)?.parse::<f64>().ok();
    Some((ticks(11)? + ticks(12)?) / 100.0)
}

/// A program beside this one; for a test, which cargo puts one folder deeper, also beside that.
///
/// # Errors
/// When it is not there.
pub fn sibling(name: &str) -> anyhow::Result<PathBuf> {
    let own = std::env::current_exe().context("cannot find this program")?;
    let folders = own.ancestors().skip(1).take(2).map(Path::to_owned);
    let mut paths = folders.map(|folder| folder.join(name));
    paths
        .find(|path| path.exists())
        .with_context(|| format!("{name} is not beside {}: build the whole workspace", own.display()))
}

/// What the stages told by events.
#[derive(Debug, Default)]
pub struct EventLog {
    /// End of each finished frame, nanoseconds of the monotonic clock, in the order of frames.
    pub done_nanos: Vec<u64>,
    /// Triangles of each finished frame.
    pub triangles: Vec<u64>,
    /// Milliseconds of each span: name, frame, duration.
    pub spans: Vec<(SpanName, u64, f64)>,
    /// Tiles copied to the device, in all.
    pub uploaded: u64,
    /// Name of the device, and of its driver.
    pub device: [Vec<u8>; 2],
}

impl EventLog {
    /// Takes what is in a ring.
    ///
    /// # Errors
    /// When the ring is corrupt.
    pub fn drain(&mut self, events: &mut Consumer<Event>) -> anyhow::Result<()> {
        while let Some(event) = events.try_pop()? {
            match event.content() {
                Some(EventContent::FrameDone { triangles }) => {
                    self.done_nanos.push(event.start_nanos);
                    self.triangles.push(triangles);
                }
                Some(EventContent::Span { name, .. }) => {
                    self.spans.push((name, event.frame().get(), event.duration_nanos as f64 / 1e6));
                }
                Some(EventContent::FrameUploaded { tiles }) => self.uploaded += tiles,
                Some(EventContent::Text { kind: TextKind::Device }) => {
                    event.collect_text(&mut self.device[0]);
                }
                Some(EventContent::Text { kind: TextKind::Driver }) => {
                    event.collect_text(&mut self.device[1]);
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Milliseconds between the ends of frames `from`, `from + 1`, …
    #[must_use]
    pub fn frame_ms(&self, from: usize) -> Vec<f64> {
        let ends = self.done_nanos.get(from.saturating_sub(1)..).unwrap_or_default();
        ends.windows(2).map(|pair| pair[1].saturating_sub(pair[0]) as f64 / 1e6).collect()
    }

    /// Milliseconds per frame of a span, frames from `from` on.
    #[must_use]
    pub fn span_ms(&self, name: SpanName, from: u64) -> Vec<f64> {
        self.spans.iter().filter(|(n, frame, _)| *n == name && *frame >= from).map(|(_, _, ms)| *ms).collect()
    }

    /// Name of the device and its driver.
    #[must_use]
    pub fn device_name(&self) -> String {
        self.device.iter().map(|name| String::from_utf8_lossy(name)).collect::<Vec<_>>().join(", ")
    }
}

/// A folder for reports that goes away.
#[derive(Debug)]
pub struct Scratch(PathBuf);

impl Scratch {
    /// A folder for the bench of this name.
    ///
    /// # Errors
    /// When it cannot be made.
    pub fn new(bench: &str) -> anyhow::Result<Self> {
        let path = temporary_folder(&format!("terravision-bench-{bench}")).context("cannot make a temporary folder")?;
        Ok(Self(path))
    }

    /// Its path.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.0).unwrap_or_default();
    }
}
