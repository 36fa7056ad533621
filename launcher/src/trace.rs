//! The trace of a run: what every process did when, in the Trace Event Format (Chrome's JSON, which Perfetto opens).
//!
//! All processes share the monotonic clock, so their spans lie on one timeline; it begins with the program.

use crate::report::RunFigures;
use serde_json::json;
use std::collections::BTreeSet;
use std::io::{self, Write};
use terravision_common::event::{Event, EventKind, SpanName};
use terravision_common::node::NodeId;
use terravision_common::shm::Stage;

/// Writes the trace.
///
/// # Errors
/// The writer's.
pub fn write(writer: &mut impl Write, figures: &RunFigures) -> io::Result<()> {
    let pid_of = |stage: Stage| figures.pids.iter().find(|(other, _)| *other == stage).map_or(0, |(_, pid)| *pid);
    let no_events = Vec::new();
    let events = figures.collector.trace.as_ref().unwrap_or(&no_events);
    let mut list = List { writer, is_first: true };
    list.writer.write_all(b"{\"displayTimeUnit\":\"ms\",\"traceEvents\":[\n")?;
    for (order, (stage, pid)) in figures.pids.iter().enumerate() {
        list.put(&json!({"name": "process_name", "ph": "M", "pid": pid, "args": {"name": stage.name()}}))?;
        list.put(&json!({"name": "process_sort_index", "ph": "M", "pid": pid, "args": {"sort_index": order}}))?;
    }
    let threads: BTreeSet<(u32, u32)> = events
        .iter()
        .filter(|(_, event)| is_span(event))
        .map(|(stage, event)| (pid_of(*stage), event.thread))
        .collect();
    for (pid, thread) in threads {
        let name = if thread == 0 { "main".to_owned() } else { format!("thread {thread}") };
        list.put(&json!({"name": "thread_name", "ph": "M", "pid": pid, "tid": thread, "args": {"name": name}}))?;
    }
    let at = |nanos: u64| nanos.saturating_sub(figures.started_nanos) as f64 / 1e3;
    for (stage, event) in events {
        let (pid, tid, ts) = (pid_of(*stage), event.thread, at(event.start_nanos));
        let frame = event.frame;
        match EventKind::from_number(event.kind) {
            Some(EventKind::Span) => {
                let name = SpanName::from_number(event.value).map_or("unknown", SpanName::as_str);
                let duration = event.duration_nanos as f64 / 1e3;
                let mut args = json!({"frame": frame});
                if let (SpanName::LoadTile | SpanName::FetchTile, Some(node)) =
                    (SpanName::from_number(event.value).unwrap_or(SpanName::Draw), NodeId::unpack(event.node))
                {
                    args["node"] = json!(node.to_string());
                }
                list.put(
                    &json!({"name": name, "ph": "X", "pid": pid, "tid": tid, "ts": ts, "dur": duration, "args": args}),
                )?;
            }
            Some(EventKind::FrameWritten) => {
                list.put(&json!({"name": "frame written", "ph": "i", "s": "p", "pid": pid, "tid": tid, "ts": ts, "args": {"frame": frame}}))?;
            }
            Some(EventKind::TileUnavailable) => {
                let node = NodeId::unpack(event.node).map(|node| node.to_string());
                list.put(&json!({"name": "tile unavailable", "ph": "i", "s": "g", "pid": pid, "tid": tid, "ts": ts, "args": {"node": node}}))?;
            }
            Some(EventKind::FrameDone) => {
                list.put(
                    &json!({"name": "triangles", "ph": "C", "pid": pid, "ts": ts, "args": {"triangles": event.value}}),
                )?;
            }
            _ => {}
        }
    }
    list.writer.write_all(b"\n]}\n")
}

fn is_span(event: &Event) -> bool {
    event.kind == EventKind::Span as u32
}

struct List<'a, W> {
    writer: &'a mut W,
    is_first: bool,
}

impl<W: Write> List<'_, W> {
    fn put(&mut self, value: &serde_json::Value) -> io::Result<()> {
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
    use crate::report::tests::figures;

    #[test]
    fn a_trace_has_all_processes_on_one_timeline() {
        let mut bytes = Vec::new();
        write(&mut bytes, &figures()).unwrap();
        let trace: serde_json::Value = serde_json::from_slice(&bytes).unwrap();
        let events = trace["traceEvents"].as_array().unwrap();
        let named = |name: &str| events.iter().filter(|event| event["name"] == name).count();
        assert_eq!((named("process_name"), named("generate"), named("prepare"), named("record")), (4, 3, 3, 3));
        let first = events.iter().find(|event| event["name"] == "record").unwrap();
        // 102 ms on the clock, 15 ms of it before the program.
        assert_eq!(
            (first["ts"].as_f64(), first["dur"].as_f64(), first["pid"].as_u64()),
            (Some(87e3), Some(1e3), Some(13))
        );
    }

    #[test]
    fn a_trace_of_nothing_is_valid() {
        let mut figures = figures();
        figures.collector.trace = None;
        figures.pids.clear();
        let mut bytes = Vec::new();
        write(&mut bytes, &figures).unwrap();
        let trace: serde_json::Value = serde_json::from_slice(&bytes).unwrap();
        assert_eq!(trace["traceEvents"].as_array().map(Vec::len), Some(0));
    }
}
