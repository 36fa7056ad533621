//! `terravision doctor`: whether this machine has what a flight needs.

use crate::cli::DoctorArgs;
use crate::device::{self, Compression, DeviceQuestion};
use crate::failure::Failure;
use crate::machine::{bytes_for_people, find_program, outcome};
use crate::process::own_folder;
use anyhow::{Context, anyhow};
use serde_json::{Value, json};
use std::io::{self, IsTerminal, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use terravision_common::shm::{Layout, Stage, free_bytes, reap_dead_runs};
use terravision_common::simd::Instructions;
use terravision_common::technique::{Asked, Decision};
use terravision_common::terminal::printable;
use terravision_common::texels::TexelFormat;
use terravision_common::world::{World, WorldFields};

/// How one thing stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Health {
    Good,
    /// Works, with a limit that is said.
    Limited,
    /// A flight will fail.
    Missing,
}

/// One thing that a flight needs.
#[derive(Debug)]
struct Finding {
    subject: &'static str,
    health: Health,
    text: String,
    /// What to do about it.
    advice: Option<String>,
}

impl Finding {
    fn good(subject: &'static str, text: String) -> Self {
        Self { subject, health: Health::Good, text, advice: None }
    }

    fn limited(subject: &'static str, text: String, advice: &str) -> Self {
        Self { subject, health: Health::Limited, text, advice: Some(advice.to_owned()) }
    }

    fn missing(subject: &'static str, text: String, advice: &str) -> Self {
        Self { subject, health: Health::Missing, text, advice: Some(advice.to_owned()) }
    }
}

/// Looks and tells.
///
/// # Errors
/// Something that a flight needs is missing (exit code 1).
pub fn doctor(args: &DoctorArgs) -> Result<(), Failure> {
    let programs = own_folder()?;
    let answer = DeviceQuestion::ask(&programs).answer();
    let answer = answer.as_ref().map_err(String::as_str);
    let findings = [
        stages(&programs),
        vulkan(answer),
        technique(answer),
        instructions(Instructions::widest()),
        compression(answer),
        shared_memory(args.memory.0, answer),
        leftovers(),
        ffmpeg(),
        gdal(&programs),
        memory(args.memory.0),
    ];
    let print = if args.json { print_json } else { print };
    print(&findings).context("cannot write to standard output").map_err(Failure::failed)?;
    let missing: Vec<&str> =
        findings.iter().filter(|finding| finding.health == Health::Missing).map(|finding| finding.subject).collect();
    if missing.is_empty() {
        return Ok(());
    }
    Err(Failure::failed(anyhow!("this machine lacks what a flight needs: {}", missing.join(", "))))
}

fn print(findings: &[Finding]) -> io::Result<()> {
    let mut out = io::stdout().lock();
    let has_color = out.is_terminal();
    for finding in findings {
        let (mark, color) = match finding.health {
            Health::Good => ("ok", "32"),
            Health::Limited => ("limited", "33"),
            Health::Missing => ("MISSING", "31"),
        };
        let mark = if has_color { format!("\x1b[{color}m{mark:<8}\x1b[0m") } else { format!("{mark:<8}") };
        writeln!(out, "{mark} {:<14} {}", finding.subject, printable(&finding.text))?;
        if let Some(advice) = &finding.advice {
            writeln!(out, "{:8} {:14} → {advice}", "", "")?;
        }
    }
    out.flush()
}

/// One object: `ok` says whether a flight has what it needs.
fn print_json(findings: &[Finding]) -> io::Result<()> {
    let mut out = io::stdout().lock();
    writeln!(out, "{:#}", as_json(findings))?;
    out.flush()
}

fn as_json(findings: &[Finding]) -> Value {
    let each = findings.iter().map(|finding| {
        let health = match finding.health {
            Health::Good => "ok",
            Health::Limited => "limited",
            Health::Missing => "missing",
        };
        json!({"subject": finding.subject, "health": health, "text": finding.text, "advice": finding.advice})
    });
    let is_ok = findings.iter().all(|finding| finding.health != Health::Missing);
    json!({"schema": "terravision-doctor-1", "ok": is_ok, "findings": each.collect::<Vec<_>>()})
}

fn stages(programs: &Path) -> Finding {
    let names = Stage::ALL.into_iter().map(Stage::name).chain(["ingest", "bench"]);
    let programs_of = names.map(|name| format!("terravision-{name}"));
    let missing: Vec<String> = programs_of.filter(|name| !programs.join(name).is_file()).collect();
    if missing.is_empty() {
        return Finding::good("programs", format!("all in {}", programs.display()));
    }
    let text = format!("no {} in {}", missing.join(", no "), programs.display());
    Finding::missing("programs", text, "cargo build --release builds all of them")
}

/// What a program writes to standard output, or what went wrong, a message.
fn output_of(program: &Path, arguments: &[&str]) -> Result<String, String> {
    let output = Command::new(program).args(arguments).stdin(Stdio::null()).output();
    outcome(&output.map_err(|error| format!("{}: {error}", program.display()))?)
}

const INSTALL_VULKAN: &str =
    "apt-get install libvulkan1 mesa-vulkan-drivers (a software device), or the driver of your GPU";

/// What a sweep takes without AVX2 and AVX-512. A picture of 1280x720 over hills, by one thread of a
/// Xeon, the least of 27 draws of a release build: 19.6 ms, with AVX2 10.6, with AVX-512 9.3.
const PORTABLE_COST: &str = "it takes about twice as long, for the same bytes";

/// What a flight does without a device.
const RAYS_INSTEAD: &str = "flights sweep the ground by rays on the processor, and --technique mesh is not possible";

fn vulkan(answer: Result<&Value, &str>) -> Finding {
    match answer {
        Ok(answer) => vulkan_finding(answer),
        Err(message) => Finding::missing("Vulkan", message.to_owned(), INSTALL_VULKAN),
    }
}

/// The finding of the renderer's list of devices.
fn vulkan_finding(answer: &Value) -> Finding {
    let Some(device) = device::chosen(answer) else {
        let text = format!("the Vulkan loader finds no device; {RAYS_INSTEAD}");
        return Finding::limited("Vulkan", text, INSTALL_VULKAN);
    };
    let text = |key: &str| device[key].as_str().unwrap_or("?").to_owned();
    let mut line = format!("{} ({}), driver {}, Vulkan {}", text("name"), text("type"), text("driver"), text("vulkan"));
    let count = device::devices(answer).len();
    if count > 1 {
        line += &format!("; chosen of {count}");
    }
    let missing = device::lacks(device);
    if !missing.is_empty() {
        let text = format!("{line}; lacks {}; {RAYS_INSTEAD}", missing.join(", "));
        return Finding::limited(
            "Vulkan",
            text,
            "a newer driver may have it; mesa-vulkan-drivers brings a software device that does",
        );
    }
    if device["has_host_import"] == true {
        return Finding::good("Vulkan", format!("{line}; uses shared memory in place (VK_EXT_external_memory_host)"));
    }
    let advice = "nothing to do; each frame copies its elevation once more";
    Finding::limited("Vulkan", format!("{line}; has no VK_EXT_external_memory_host"), advice)
}

/// What draws flights if nothing else is said.
fn technique(answer: Result<&Value, &str>) -> Finding {
    let decision = Decision::new(Asked::default(), device::found(answer));
    let name = if decision.is_swept() { "rays, by the sweep" } else { decision.technique.name() };
    Finding::good("technique", format!("{name}: {}; --technique and --rays choose otherwise", decision.reason))
}

/// Which instructions a sweep takes. Every set gives the same bytes.
fn instructions(widest: Instructions) -> Finding {
    const SUBJECT: &str = "sweep";
    if widest == Instructions::PORTABLE {
        let text = format!("a sweep goes without vector instructions: {PORTABLE_COST}");
        return Finding::limited(SUBJECT, text, "nothing to do; a processor with AVX2 or AVX-512 is faster");
    }
    Finding::good(SUBJECT, format!("a sweep takes {}; without vector instructions, {PORTABLE_COST}", widest.name()))
}

/// Whether flights compress colour tiles if nothing else is said. Either way they fly.
fn compression(answer: Result<&Value, &str>) -> Finding {
    let text = match Compression::of(answer) {
        Compression::Fast(why) => format!("flights compress colour tiles (BC1): {why}; not with --quality best"),
        Compression::Slow(why) => {
            format!(
                "flights do not compress colour tiles: {why}; --texture-compression on compresses them nevertheless"
            )
        }
        Compression::Impossible(why) => format!("flights do not compress colour tiles: {why}"),
    };
    Finding::good("compression", text)
}

/// The layout of a flight over a world of default tiles.
fn default_layout(memory_bytes: u64, is_swept: bool) -> Option<Layout> {
    let world = World::new(WorldFields {
        origin: [0.0; 2],
        lattice_unit_m: 10.0,
        extent: [4096; 2],
        elevation_tile: 32,
        color_tile: 256,
        levels: 8,
        finest_elevation_level: 0,
        finest_color_level: 0,
        body: None,
    });
    // The larger of the two.
    let layout = Layout::for_run(&world.ok()?, memory_bytes, TexelFormat::Rgba8).ok()?;
    Some(if is_swept { layout.without_arrays() } else { layout })
}

fn shared_memory(memory_bytes: u64, answer: Result<&Value, &str>) -> Finding {
    const SUBJECT: &str = "shared memory";
    const ADVICE: &str = "mount -o remount,size=2g /dev/shm, or docker run --shm-size=2g, or fly with less --memory";
    let is_swept = Decision::new(Asked::default(), device::found(answer)).is_swept();
    let Some(layout) = default_layout(memory_bytes, is_swept) else {
        let text = format!("--memory {} is too small for any flight", bytes_for_people(memory_bytes));
        return Finding::missing(SUBJECT, text, "use at least --memory 64MiB");
    };
    let needed = layout.total_bytes();
    let free = match free_bytes() {
        Ok(free) => free,
        Err(error) => return Finding::missing(SUBJECT, error.to_string(), "mount -t tmpfs tmpfs /dev/shm"),
    };
    let text = format!(
        "/dev/shm has {} free; a flight with --memory {} needs {}",
        bytes_for_people(free),
        bytes_for_people(memory_bytes),
        bytes_for_people(needed)
    );
    if free < needed { Finding::missing(SUBJECT, text, ADVICE) } else { Finding::good(SUBJECT, text) }
}

fn leftovers() -> Finding {
    let removed = reap_dead_runs();
    let text = match removed.len() {
        0 => "no shared memory is left over from killed runs".into(),
        count => format!("removed {count} shared-memory segments of runs that were killed"),
    };
    Finding::good("leftovers", text)
}

fn ffmpeg() -> Finding {
    const ADVICE: &str = "apt-get install ffmpeg; without it frames can be written as pictures (-o DIR/) or Y4M (-o -)";
    let Some(program) = find_program("ffmpeg") else {
        return Finding::limited("ffmpeg", "not installed: no films".into(), ADVICE);
    };
    match output_of(&program, &["-hide_banner", "-version"]) {
        Ok(text) => Finding::good("ffmpeg", text.lines().next().unwrap_or("?").trim_end().to_owned()),
        Err(message) => Finding::limited("ffmpeg", message, ADVICE),
    }
}

fn gdal(programs: &Path) -> Finding {
    const ADVICE: &str = "apt-get install libgdal-dev; flights do without it, ingest and synth need it";
    match output_of(&programs.join("terravision-ingest"), &["--version"]) {
        Ok(text) => Finding::good("GDAL", text.split_whitespace().collect::<Vec<_>>().join(" ")),
        Err(message) => Finding::limited("GDAL", message, ADVICE),
    }
}

fn memory(memory_bytes: u64) -> Finding {
    const SUBJECT: &str = "memory";
    let text = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let available = text
        .lines()
        .find_map(|line| line.strip_prefix("MemAvailable:")?.split_whitespace().next()?.parse::<u64>().ok());
    let Some(available) = available.map(|kib| kib * 1024) else {
        return Finding::limited(SUBJECT, "the system does not say how much memory is free".into(), "nothing to do");
    };
    // Pools, and what the processes need besides.
    let needed = memory_bytes.saturating_add(300 << 20);
    let text = format!("{} available; a flight needs about {}", bytes_for_people(available), bytes_for_people(needed));
    if available < needed {
        Finding::missing(SUBJECT, text, "fly with less --memory")
    } else {
        Finding::good(SUBJECT, text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_that_lacks_something_is_told_by_it() {
        let good = json!([{"name": "llvmpipe", "type": "cpu", "driver": "Mesa 22.3.6", "vulkan": "1.3", "is_chosen": true,
                           "has_host_import": true, "missing": []}]);
        assert_eq!(vulkan_finding(&good).health, Health::Good);
        let mut old = good.clone();
        old[0]["missing"] = json!(["dynamic rendering"]);
        let finding = vulkan_finding(&old);
        assert!(finding.health == Health::Limited && finding.text.contains("lacks dynamic rendering"));
        assert!(finding.text.contains("by rays"));
        let mut plain = good.clone();
        plain[0]["has_host_import"] = json!(false);
        assert_eq!(vulkan_finding(&plain).health, Health::Limited);
        for nothing in [json!([]), json!({}), json!(null), json!({"devices": []})] {
            let finding = vulkan_finding(&nothing);
            assert!(finding.health == Health::Limited && finding.text.contains("by rays"), "{finding:?}");
        }
    }

    #[test]
    fn what_would_draw_is_told_with_its_reason() {
        let device = |kind: &str| json!([{"name": "it", "type": kind, "is_chosen": true, "missing": []}]);
        let text = |answer: Result<&Value, &str>| technique(answer).text;
        assert!(text(Ok(&device("discrete"))).starts_with("mesh: there is a GPU; "));
        assert!(text(Ok(&device("cpu"))).starts_with("rays, by the sweep: there is no GPU, only"));
        assert!(text(Err("no renderer")).starts_with("rays, by the sweep: there is no Vulkan device that can be used"));
        assert_eq!(instructions(Instructions::PORTABLE).health, Health::Limited);
        for wide in &Instructions::all()[1..] {
            assert!(instructions(*wide).text.contains(wide.name()));
        }
    }

    #[test]
    fn findings_are_one_object() {
        let limited = Finding::limited("ffmpeg", "not installed".into(), "install it");
        let value = as_json(&[Finding::good("memory", "much".into()), limited]);
        assert_eq!((&value["ok"], &value["findings"][1]["health"]), (&json!(true), &json!("limited")));
        assert_eq!(
            (&value["findings"][0]["advice"], &value["findings"][1]["advice"]),
            (&json!(null), &json!("install it"))
        );
        assert_eq!(as_json(&[Finding::missing("memory", "little".into(), "buy")])["ok"], false);
    }

    #[test]
    fn shared_memory_is_compared_with_what_is_needed() {
        assert_eq!(shared_memory(1, Err("no renderer")).health, Health::Missing);
        let [swept, mesh] = [true, false].map(|is_swept| default_layout(512 << 20, is_swept).unwrap().total_bytes());
        assert!(swept > 200 << 20 && mesh > swept + (15 << 20), "{swept} and {mesh} bytes");
    }
}
