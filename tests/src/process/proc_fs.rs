//! What the kernel tells about processes and shared memory.

use std::fs;

/// Process ids and names of the children of `parent`: those of their programs, which the kernel
/// cuts nowhere.
#[must_use]
pub fn children_of(parent: u32) -> Vec<(u32, String)> {
    let Ok(entries) = fs::read_dir("/proc") else { return Vec::new() };
    entries
        .flatten()
        .filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok())
        .filter_map(|pid| {
            let (name, fields) = stat(pid)?;
            let state = fields.first()?;
            (fields.get(1)?.parse::<u32>().ok()? == parent && state != "Z")
                .then(|| (pid, program_of(pid).unwrap_or(name)))
        })
        .collect()
}

/// Name of the program that a process runs, as it was started.
fn program_of(pid: u32) -> Option<String> {
    let line = fs::read(format!("/proc/{pid}/cmdline")).ok()?;
    let program = line.split(|byte| *byte == 0).next().filter(|program| !program.is_empty())?;
    let name = program.rsplit(|byte| *byte == b'/').next()?;
    Some(String::from_utf8_lossy(name).into_owned())
}

/// Name (at most 15 characters) and the fields from the state on.
fn stat(pid: u32) -> Option<(String, Vec<String>)> {
    let text = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    let (open, close) = (text.find('(')?, text.rfind(')')?);
    Some((text[open + 1..close].to_owned(), text[close + 1..].split_whitespace().map(str::to_owned).collect()))
}

/// Whether a process runs (one that only waits to be reaped does not).
#[must_use]
pub fn is_alive(pid: u32) -> bool {
    stat(pid).is_some_and(|(_, fields)| fields.first().is_some_and(|state| state != "Z" && state != "X"))
}

/// Proportional set size of a process, KiB; `None` when it is gone.
#[must_use]
pub fn pss_kib(pid: u32) -> Option<u64> {
    let text = fs::read_to_string(format!("/proc/{pid}/smaps_rollup")).ok()?;
    text.lines().find_map(|line| line.strip_prefix("Pss:")?.trim().strip_suffix(" kB")?.trim().parse().ok())
}

/// Largest resident set that a process has had, KiB; `None` when it is gone.
#[must_use]
pub fn peak_kib(pid: u32) -> Option<u64> {
    let text = fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    text.lines().find_map(|line| line.strip_prefix("VmHWM:")?.trim().strip_suffix(" kB")?.trim().parse().ok())
}

/// Names in /dev/shm of the run whose launcher has (or had) this process id.
#[must_use]
pub fn segments_of_launcher(pid: u32) -> Vec<String> {
    segments_with(&format!("tv-{pid}-"))
}

/// All names in /dev/shm that TerraVision made.
#[must_use]
pub fn segments_of_tests() -> Vec<String> {
    segments_with("tv-")
}

fn segments_with(prefix: &str) -> Vec<String> {
    let Ok(entries) = fs::read_dir("/dev/shm") else { return Vec::new() };
    entries.flatten().filter_map(|e| e.file_name().into_string().ok()).filter(|n| n.starts_with(prefix)).collect()
}

/// The port of loopback at which a process has a socket of its own of a protocol, "tcp" or "udp".
#[must_use]
pub fn loopback_port(pid: u32, protocol: &str) -> Option<u16> {
    let links = std::fs::read_dir(format!("/proc/{pid}/fd")).ok()?.flatten();
    let sockets: Vec<String> = links
        .filter_map(|link| std::fs::read_link(link.path()).ok()?.to_str()?.strip_prefix("socket:[").map(str::to_owned))
        .collect();
    let table = std::fs::read_to_string(format!("/proc/{pid}/net/{protocol}")).ok()?;
    table.lines().skip(1).find_map(|line| {
        let fields: Vec<&str> = line.split_whitespace().collect();
        let is_ours = sockets.iter().any(|socket| socket.strip_suffix(']') == fields.get(9).copied());
        let port = fields.get(1)?.strip_prefix("0100007F:")?;
        is_ours.then(|| u16::from_str_radix(port, 16).ok())?
    })
}
