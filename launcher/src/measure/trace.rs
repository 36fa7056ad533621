//! The trace of a run: what every process did when, in the Trace Event Format (Chrome's JSON, which
//! Perfetto opens).
//!
//! All processes share the monotonic clock, so their spans lie on one timeline; it begins with the
//! program. Viewers draw spans of one row over each other when they overlap, so no two on a row do:
//! what a process does at the same time (requests for tiles, uploads while a frame is recorded)
//! stands on rows of its own.

use super::stats::RunStats;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::{self, Write};
use terravision_common::event::{Event, EventContent};
use terravision_common::shm::Stage;

/// Threads of a process are numbered below this; further rows of the same thread follow in steps of
/// it.
const ROW_STEP: u32 = 10_000;

/// A part of the run of a process that sends no events: this program, or its encoder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Phase {
    pid: u32,
    process: &'static str,
    name: &'static str,
    start_nanos: u64,
    end_nanos: u64,
}

impl Phase {
    /// Of this program.
    #[must_use]
    pub fn own(name: &'static str, start_nanos: u64, end_nanos: u64) -> Self {
        Self { pid: std::process::id(), process: "launcher", name, start_nanos, end_nanos }
    }

    /// Of the encoder of a film, from its start to its end.
    #[must_use]
    pub fn encoder(pid: u32, start_nanos: u64, end_nanos: u64) -> Self {
        Self { pid, process: "ffmpeg", name: "encode film", start_nanos, end_nanos }
    }
}

/// A span on a row.
struct Slice {
    pid: u32,
    thread: u32,
    start_nanos: u64,
    duration_nanos: u64,
    name: &'static str,
    args: Value,
}

/// Writes the trace.
///
/// # Errors
/// The writer's.
pub fn write(writer: &mut impl Write, stats: &RunStats) -> io::Result<()> {
    let pid_of = |stage: Stage| stats.pids.iter().find(|(other, _)| *other == stage).map_or(0, |(_, pid)| *pid);
    let no_events = Vec::new();
    let events = stats.collector.trace.as_ref().unwrap_or(&no_events);
    let mut list = List { writer, is_first: true };
    list.writer.write_all(b"{\"displayTimeUnit\":\"ms\",\"traceEvents\":[\n")?;
    write_processes(&mut list, stats)?;

    let of_phases = stats.phases.iter().map(Slice::of_phase);
    let of_events = events.iter().filter_map(|(stage, event)| Slice::of_event(pid_of(*stage), event));
    let mut slices: Vec<Slice> = of_phases.chain(of_events).collect();
    slices.sort_by_key(|slice| (slice.pid, slice.thread, slice.start_nanos, slice.duration_nanos));
    let at = |nanos: u64| nanos.saturating_sub(stats.started_nanos) as f64 / 1e3;
    let mut rows = Rows::default();
    for slice in &slices {
        let tid = rows.place(slice);
        let (ts, dur) = (at(slice.start_nanos), slice.duration_nanos as f64 / 1e3);
        list.put(
            &json!({"name": slice.name, "ph": "X", "pid": slice.pid, "tid": tid, "ts": ts, "dur": dur, "args": slice.args}),
        )?;
    }
    for (pid, thread, row) in rows.all() {
        let name = if thread == 0 { "main".to_owned() } else { format!("thread {thread}") };
        let name = if row == 0 { name } else { format!("{name}, at the same time {row}") };
        let tid = thread + row * ROW_STEP;
        list.put(&json!({"name": "thread_name", "ph": "M", "pid": pid, "tid": tid, "args": {"name": name}}))?;
    }
    for (stage, event) in events {
        write_moment(&mut list, pid_of(*stage), event, at(event.start_nanos))?;
    }
    list.writer.write_all(b"\n]}\n")
}

/// The names of all processes: this program's first, then the stages, then the encoder.
fn write_processes<W: Write>(list: &mut List<'_, W>, stats: &RunStats) -> io::Result<()> {
    let mut names: Vec<(u32, &str)> = Vec::new();
    let stages = stats.pids.iter().map(|(stage, pid)| (*pid, stage.name()));
    let of = |name: &'static str| {
        stats.phases.iter().filter(move |phase| phase.process == name).map(|phase| (phase.pid, phase.process))
    };
    for (pid, name) in of("launcher").chain(stages).chain(of("ffmpeg")) {
        if !names.iter().any(|(known, _)| *known == pid) {
            names.push((pid, name));
        }
    }
    for (order, (pid, name)) in names.into_iter().enumerate() {
        list.put(&json!({"name": "process_name", "ph": "M", "pid": pid, "args": {"name": name}}))?;
        list.put(&json!({"name": "process_sort_index", "ph": "M", "pid": pid, "args": {"sort_index": order}}))?;
    }
    Ok(())
}

/// Moments, not spans: a frame that is written, a tile that cannot be read, the triangles of a
/// frame.
fn write_moment<W: Write>(list: &mut List<'_, W>, pid: u32, event: &Event, ts: f64) -> io::Result<()> {
    let (tid, frame) = (event.thread, event.frame().get());
    match event.content() {
        Some(EventContent::FrameWritten { .. }) => list.put(
            &json!({"name": "frame written", "ph": "i", "s": "p", "pid": pid, "tid": tid, "ts": ts, "args": {"frame": frame}}),
        ),
        Some(EventContent::TileUnavailable { tile, .. }) => {
            let node = tile.node.to_string();
            list.put(
                &json!({"name": "tile unavailable", "ph": "i", "s": "g", "pid": pid, "tid": tid, "ts": ts, "args": {"node": node}}),
            )
        }
        Some(EventContent::FrameDone { triangles }) => {
            list.put(&json!({"name": "triangles", "ph": "C", "pid": pid, "ts": ts, "args": {"triangles": triangles}}))
        }
        _ => Ok(()),
    }
}

impl Slice {
    fn of_phase(phase: &Phase) -> Self {
        Self {
            pid: phase.pid,
            thread: 0,
            start_nanos: phase.start_nanos,
            duration_nanos: phase.end_nanos.saturating_sub(phase.start_nanos),
            name: phase.name,
            args: json!({}),
        }
    }

    fn of_event(pid: u32, event: &Event) -> Option<Self> {
        let Some(EventContent::Span { name, node }) = event.content() else { return None };
        let mut args = json!({"frame": event.frame().get()});
        if let Some(node) = node {
            args["node"] = json!(node.to_string());
        }
        Some(Self {
            pid,
            thread: event.thread.min(ROW_STEP - 1),
            start_nanos: event.start_nanos,
            duration_nanos: event.duration_nanos,
            name: name.as_str(),
            args,
        })
    }
}

/// When the last span of each row of each thread ends.
#[derive(Default)]
struct Rows(BTreeMap<(u32, u32), Vec<u64>>);

impl Rows {
    /// The row of a span: the first that is free when it begins. Spans of a thread come by their
    /// beginning.
    fn place(&mut self, slice: &Slice) -> u32 {
        let rows = self.0.entry((slice.pid, slice.thread)).or_default();
        let row = rows.iter().position(|end| *end <= slice.start_nanos).unwrap_or(rows.len());
        let end = slice.start_nanos.saturating_add(slice.duration_nanos);
        match rows.get_mut(row) {
            Some(last) => *last = end,
            None => rows.push(end),
        }
        slice.thread + row as u32 * ROW_STEP
    }

    /// Process, thread, and number of the row among those of its thread.
    fn all(&self) -> impl Iterator<Item = (u32, u32, u32)> {
        self.0.iter().flat_map(|((pid, thread), rows)| (0..rows.len() as u32).map(|row| (*pid, *thread, row)))
    }
}

struct List<'a, W> {
    writer: &'a mut W,
    is_first: bool,
}

impl<W: Write> List<'_, W> {
    fn put(&mut self, value: &Value) -> io::Result<()> {
        if !std::mem::take(&mut self.is_first) {
            self.writer.write_all(b",\n")?;
        }
        serde_json::to_writer(&mut *self.writer, value)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::report::tests::stats;
    use terravision_common::event::SpanName;
    use terravision_common::ids::FrameNumber;
    use terravision_common::node::NodeId;

    fn events(stats: &RunStats) -> Vec<Value> {
        let mut bytes = Vec::new();
        write(&mut bytes, stats).unwrap();
        let trace: Value = serde_json::from_slice(&bytes).unwrap();
        trace["traceEvents"].as_array().unwrap().clone()
    }

    #[test]
    fn a_trace_has_all_processes_on_one_timeline() {
        const MS: u64 = 1_000_000;
        let mut stats = stats();
        stats.phases = vec![Phase::own("plan", 15 * MS, 20 * MS), Phase::own("fly", 20 * MS, 200 * MS)];
        stats.phases.push(Phase::encoder(77, 30 * MS, 210 * MS));
        let events = events(&stats);
        let named = |name: &str| events.iter().filter(|event| event["name"] == name).count();
        assert_eq!((named("process_name"), named("generate"), named("prepare"), named("record")), (6, 3, 3, 3));
        let first = events.iter().find(|event| event["name"] == "record").unwrap();
        // 102 ms on the clock, 15 ms of it before the program.
        assert_eq!(
            (first["ts"].as_f64(), first["dur"].as_f64(), first["pid"].as_u64()),
            (Some(87e3), Some(1e3), Some(13))
        );
        let fly = events.iter().find(|event| event["name"] == "fly").unwrap();
        assert_eq!((fly["ts"].as_f64(), fly["pid"].as_u64()), (Some(5e3), Some(std::process::id().into())));
        let film = events.iter().find(|event| event["name"] == "encode film").unwrap();
        assert_eq!((film["dur"].as_f64(), film["pid"].as_u64()), (Some(180e3), Some(77)));
        let order: Vec<&str> = events
            .iter()
            .filter(|event| event["name"] == "process_name")
            .map(|event| event["args"]["name"].as_str().unwrap())
            .collect();
        assert_eq!(order, ["launcher", "generator", "preparer", "renderer", "prefetcher", "ffmpeg"]);
    }

    #[test]
    fn spans_of_one_row_do_not_overlap() {
        let mut stats = stats();
        for (start, duration) in [(500, 400), (600, 50), (600, 300), (650, 10), (900, 5), (700, 600), (500, 400)] {
            let span = EventContent::Span { name: SpanName::FetchTile, node: NodeId::new(0, 0, 0) };
            // Behind the start of the program.
            let event =
                Event::new(span).on_thread(3).of_frame(FrameNumber::new(5)).at(20_000_000 + start).lasting(duration);
            stats.collector.take(Stage::Prefetcher, event);
        }
        let mut by_row: BTreeMap<(u64, u64), Vec<(f64, f64)>> = BTreeMap::new();
        let events = events(&stats);
        for event in events.iter().filter(|event| event["ph"] == "X") {
            let span = (event["ts"].as_f64().unwrap(), event["dur"].as_f64().unwrap());
            by_row.entry((event["pid"].as_u64().unwrap(), event["tid"].as_u64().unwrap())).or_default().push(span);
        }
        for ((pid, tid), mut spans) in by_row.clone() {
            spans.sort_by(|a, b| a.0.total_cmp(&b.0));
            assert!(spans.windows(2).all(|pair| pair[0].0 + pair[0].1 <= pair[1].0 + 1e-6), "{pid} {tid}: {spans:?}");
            let is_named =
                |event: &&Value| event["name"] == "thread_name" && event["pid"] == pid && event["tid"] == tid;
            assert_eq!(events.iter().filter(is_named).count(), 1);
        }
        assert_eq!(by_row.keys().filter(|(pid, _)| *pid == 14).count(), 4, "as many rows as spans at once");
    }

    #[test]
    fn a_trace_of_nothing_is_valid() {
        let mut stats = stats();
        stats.collector.trace = None;
        stats.pids.clear();
        assert!(events(&stats).is_empty());
    }
}
