//! Measures how long ring and ping-pong buffer take from one process to another:
//! `cargo run --release -p terravision-common --example hand_over`.
//!
//! Also the smallest program that shares memory between two processes: make the segments, start the other process with
//! the run's name, open the handles on both sides.

use std::error::Error;
use std::io::Write;
use std::process::Command;
use std::time::Duration;
use terravision_common::shm::measure::{Latencies, Plan, receive, send};
use terravision_common::shm::{Layout, RunId, RunSegments};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [run, pause_micros] = arguments.as_slice() {
        send(&RunId::parse(run)?, plan(pause_micros.parse()?))?;
        return Ok(());
    }
    let mut out = std::io::stdout().lock();
    for pause_micros in [0, 100, 1000, 5000] {
        let run = RunId::new_for_this_process()?;
        let _segments = RunSegments::create(&run, &Layout { ring_slots: 8192, ..Layout::small() })?;
        let mut child =
            Command::new(std::env::current_exe()?).args([run.to_string(), pause_micros.to_string()]).spawn()?;
        let found = receive(&run, plan(pause_micros))?;
        child.wait()?;
        writeln!(
            out,
            "sender rests {pause_micros:>4} us: ring {}, ping-pong {}, {:.1} M slots/s",
            line(&found.ring),
            line(&found.ping_pong),
            found.slots_per_second / 1e6
        )?;
    }
    Ok(())
}

fn plan(pause_micros: u64) -> Plan {
    let rounds = if pause_micros > 1000 { 500 } else { 2000 };
    Plan { rounds, pause: Duration::from_micros(pause_micros), batch: 512 }
}

fn line(latencies: &Latencies) -> String {
    let [p50, p99, worst] = [0.5, 0.99, 1.0].map(|p| latencies.percentile(p) as f64 / 1000.0);
    format!("p50 {p50:.1} us, p99 {p99:.1} us, worst {worst:.1} us")
}
