//! The storm that kills stages.

use super::{FPS, Random, SKY, crash_in, flight, run_of};
use crate::folder::TestFolder;
use crate::live::{left_of, reader, shared_name};
use crate::process::{Running, is_alive, pss_kib, segments_of_launcher, signal_process};
use crate::worlds::TestWorld;
use rustix::process::Signal;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt;
use std::time::{Duration, Instant};
use terravision_common::shm::{Control, Counter, PoolReader, RunId, SegmentKind, SharedFrame};

const STAGES: [&str; 4] = ["generator", "preparer", "renderer", "prefetcher"];

/// A flight of which a stage is killed every so often.
#[derive(Debug, Clone, Copy)]
pub struct DeathStorm {
    /// How long stages are killed.
    pub seconds: f64,
    /// Time from one kill to the next.
    pub every: Duration,
    /// Decides who is killed when.
    pub seed: u64,
}

/// What a storm of death came to.
#[derive(Debug, Clone, Default)]
pub struct DeathReport {
    /// Kills by stage.
    pub kills: BTreeMap<&'static str, u32>,
    /// Restarts that the launcher tells of, in its report.
    pub restarts: u64,
    /// Frames that the reader saw.
    pub frames_seen: u64,
    /// Frames that are not later in the flight than the one before.
    pub frames_back: u64,
    /// Frames whose colours and depths are not of one picture.
    pub frames_torn: u64,
    /// Publications that the reader found corrupt.
    pub reader_errors: u64,
    /// Longest time from one new frame to the next.
    pub longest_gap: Duration,
    /// Who had been killed last before it.
    pub gap_after: &'static str,
    /// Longest time from one new frame to the next before the first kill.
    pub longest_gap_before: Duration,
    /// Looks at which more tiles had been loaded than the pools held, although they had room for
    /// all.
    pub loaded_twice: u64,
    /// Files that the launcher had open after the first second, and after the storm.
    pub open_files: [usize; 2],
    /// Memory of all processes of the flight then, proportional sets, KiB.
    pub memory_kib: [u64; 2],
    /// Exit code of the launcher.
    pub code: Option<i32>,
    /// Segments and frame rings that are left.
    pub segments_left: usize,
    /// Processes of the flight that are left.
    pub processes_left: usize,
    /// A line that tells of a crash other than by our own hand.
    pub crash: Option<String>,
    /// What the launcher said last.
    pub last_words: String,
}

impl DeathReport {
    /// What does not hold that must, whatever the machine.
    #[must_use]
    pub fn faults(&self) -> Vec<String> {
        let kills = u64::from(self.kills.values().sum::<u32>());
        let mut faults = Vec::new();
        let mut check = |holds: bool, what: String| {
            if !holds {
                faults.push(what);
            }
        };
        check(self.code == Some(0), format!("the flight ended with {:?}: {}", self.code, self.last_words));
        check(self.frames_back == 0, format!("{} frames went back", self.frames_back));
        check(self.frames_torn == 0, format!("{} frames are torn", self.frames_torn));
        check(self.reader_errors == 0, format!("the reader found {} errors", self.reader_errors));
        // One that is killed behind the last frame is not missed.
        check(self.restarts + 1 >= kills && self.restarts <= kills, format!("{} restarts", self.restarts));
        check(self.loaded_twice == 0, format!("tiles were loaded twice at {} looks", self.loaded_twice));
        check(self.segments_left == 0, format!("{} segments are left", self.segments_left));
        check(self.processes_left == 0, format!("{} processes are left", self.processes_left));
        check(self.open_files[1] <= self.open_files[0] + 2, format!("open files grew: {:?}", self.open_files));
        check(self.crash.is_none(), format!("a crash: {:?}", self.crash));
        faults
    }

    /// What does not hold that must where nothing else uses the cores: besides
    /// [`DeathReport::faults`], no picture is missing for a second, and memory is where it began
    /// (tiles that came meanwhile, and the longer report, are allowed an eighth).
    #[must_use]
    pub fn faults_on_an_idle_machine(&self) -> Vec<String> {
        let mut faults = self.faults();
        if self.longest_gap > Duration::from_secs(1) {
            faults.push(format!("{:.0} ms without a new picture", self.longest_gap.as_secs_f64() * 1e3));
        }
        let [before, after] = self.memory_kib;
        if before == 0 || after > before + before / 8 {
            faults.push(format!("memory of all processes grew from {before} to {after} KiB"));
        }
        faults
    }
}

impl fmt::Display for DeathReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kills: Vec<String> = self.kills.iter().map(|(stage, count)| format!("{count} {stage}")).collect();
        let ms = |time: Duration| time.as_secs_f64() * 1e3;
        write!(
            f,
            "{} kills ({}), {} restarts, {} frames seen, {} back, {} torn; longest gap {:.0} ms (after the {}; {:.0} ms \
             without kills); {} segments and {} processes left; open files of the launcher: {} to {}; memory of all: {} to {} MiB",
            self.kills.values().sum::<u32>(),
            kills.join(", "),
            self.restarts,
            self.frames_seen,
            self.frames_back,
            self.frames_torn,
            ms(self.longest_gap),
            if self.gap_after.is_empty() { "start" } else { self.gap_after },
            ms(self.longest_gap_before),
            self.segments_left,
            self.processes_left,
            self.open_files[0],
            self.open_files[1],
            self.memory_kib[0] >> 10,
            self.memory_kib[1] >> 10,
        )
    }
}

impl DeathStorm {
    /// Flies through it.
    ///
    /// # Panics
    /// When the flight does not start, or does not end in time.
    #[must_use]
    pub fn fly(&self, world: &TestWorld) -> DeathReport {
        let (folder, name) = (TestFolder::new("storm-death"), shared_name("storm-death"));
        // A second before the first kill, and two behind the last.
        let mut flight = flight(world, &folder, &name, self.seconds + 3.0, 1_000_000).spawn();
        let mut ring = reader(&mut flight, &name);
        let run = flight.until("the control block", run_of);
        let eyes = Eyes::open(&run);
        let mut watch = Watch { report: DeathReport::default(), last: None, seen_at: None, victim: "" };
        let (mut random, mut order, mut pids) = (Random::new(self.seed), Vec::new(), Vec::new());
        let (mut start, mut next_kill, mut ended) = (None, None, None);
        let mut frame = SharedFrame::default();
        while ended.is_none() {
            let now = Instant::now();
            watch.look(ring.read(&mut frame), &frame, now);
            if start.is_none() && watch.last.is_some() {
                start = Some(now);
                next_kill = Some(now + Duration::from_secs(1));
            }
            if let (Some(start), Some(at)) = (start, next_kill)
                && now >= at
            {
                let is_over = now.duration_since(start).as_secs_f64() > 1.0 + self.seconds;
                if watch.victim.is_empty() || is_over {
                    let at = usize::from(is_over);
                    watch.report.open_files[at] = open_files(flight.pid());
                    let pids = std::iter::once(flight.pid()).chain(flight.children().into_iter().map(|(pid, _)| pid));
                    watch.report.memory_kib[at] = pids.filter_map(pss_kib).sum();
                }
                watch.report.loaded_twice += u64::from(eyes.is_any_tile_loaded_twice());
                next_kill = None;
                if !is_over {
                    if order.is_empty() {
                        order = shuffled(&mut random);
                    }
                    let victim = order.pop().unwrap_or(STAGES[0]);
                    next_kill = Some(at + self.every);
                    if let Some(pid) = stage_of(&flight, victim) {
                        pids.push(pid);
                        signal_process(pid, Signal::KILL);
                        *watch.report.kills.entry(victim).or_insert(0) += 1;
                        watch.victim = victim;
                    }
                }
            }
            ended = flight.has_ended().then_some(());
            std::thread::sleep(Duration::from_millis(1));
        }
        let launcher = flight.pid();
        let finished = flight.wait();
        let mut report = watch.report;
        report.code = finished.code();
        report.crash = crash_in(&finished.stderr).map(str::to_owned);
        report.last_words = finished.stderr.lines().last().unwrap_or_default().to_owned();
        report.segments_left = segments_of_launcher(launcher).len() + left_of(&name).len();
        report.processes_left = pids.into_iter().filter(|pid| is_alive(*pid)).count();
        report.restarts = restarts_in(&folder);
        report
    }
}

fn shuffled(random: &mut Random) -> Vec<&'static str> {
    let mut order = STAGES.to_vec();
    for at in (1..order.len()).rev() {
        order.swap(at, random.below(at + 1));
    }
    order
}

fn stage_of(flight: &Running, stage: &str) -> Option<u32> {
    let name = format!("terravision-{stage}");
    flight.children().into_iter().find(|(_, child)| *child == name).map(|(pid, _)| pid)
}

fn open_files(pid: u32) -> usize {
    std::fs::read_dir(format!("/proc/{pid}/fd")).map_or(0, Iterator::count)
}

/// Restarts in all, as the launcher's report tells.
fn restarts_in(folder: &TestFolder) -> u64 {
    let text = std::fs::read_to_string(folder.join("report.json")).unwrap_or_default();
    let report: Value = serde_json::from_str(&text).unwrap_or_default();
    report["restarts"].as_object().map_or(0, |by_stage| by_stage.values().filter_map(Value::as_u64).sum())
}

/// The run's counters and pools, looked at from outside.
struct Eyes {
    control: Control,
    pools: [PoolReader; 2],
}

impl Eyes {
    fn open(run: &RunId) -> Self {
        let control = Control::open(run).expect("the run has a control block");
        let pools = [SegmentKind::ColorPool, SegmentKind::ElevationPool];
        Self { control, pools: pools.map(|kind| PoolReader::open(run, kind).expect("the run has a pool")) }
    }

    /// More tiles were loaded than are there, although none had to make room. (A prefetcher that is
    /// killed may have loaded one and not counted it, never the other way round.)
    fn is_any_tile_loaded_twice(&self) -> bool {
        let loaded = self.control.counter(Counter::TilesLoaded);
        let held = |pool: &PoolReader| pool.slots().filter(|slot| slot.state.is_readable()).count() as u64;
        let has_room = self.pools.iter().all(|pool| held(pool) < u64::from(pool.capacity()));
        has_room && loaded > self.pools.iter().map(held).sum()
    }
}

/// The reader that watches.
struct Watch {
    report: DeathReport,
    /// The last frame that was seen.
    last: Option<u64>,
    seen_at: Option<Instant>,
    victim: &'static str,
}

impl Watch {
    fn look(&mut self, read: Result<bool, terravision_common::shm::ShmError>, frame: &SharedFrame, now: Instant) {
        let report = &mut self.report;
        match read {
            Err(_corrupt) => report.reader_errors += 1,
            Ok(false) => {}
            Ok(true) => {
                let Some(info) = frame.info else { return };
                report.frames_seen += 1;
                report.frames_back += u64::from(self.last.is_some_and(|last| info.frame <= last));
                report.frames_torn += u64::from(is_torn(frame));
                // The clock of the flight starts with the first frame; the second may be as late as
                // one period and more.
                if let Some(before) = self.seen_at {
                    let gap = now.duration_since(before);
                    if self.victim.is_empty() {
                        report.longest_gap_before = report.longest_gap_before.max(gap);
                    }
                    if gap > report.longest_gap {
                        (report.longest_gap, report.gap_after) = (gap, self.victim);
                    }
                }
                self.seen_at = Some(now);
                self.last = Some(info.frame);
            }
        }
    }
}

/// Sky in the picture is sky in the depths, and the other way round.
fn is_torn(frame: &SharedFrame) -> bool {
    let is_sky = |pixel: &[u8]| pixel[..3] == SKY;
    frame.rgba.chunks_exact(4).zip(&frame.depth).any(|(pixel, depth)| is_sky(pixel) != depth.is_nan())
}

const _: () = assert!(FPS >= 10, "a gap of a second has to stand out");
