//! Processes that a process of ours has started and left behind.

use rustix::process::{Pid, Signal, WaitOptions, kill_process, waitpid};
use std::time::{Duration, Instant};

/// Kills what the stages have left behind: with this process as the reaper of its descendants, an
/// orphan of a stage (an encoder, say) is now a child of it.
pub fn end_orphans() {
    let end = Instant::now() + Duration::from_millis(300);
    while let Some(children) = own_children().filter(|children| !children.is_empty()) {
        let is_late = Instant::now() > end;
        for pid in children {
            if is_late {
                kill_process(pid, Signal::KILL).ok();
            }
            waitpid(Some(pid), WaitOptions::NOHANG).ok();
        }
        if Instant::now() > end + Duration::from_millis(300) {
            break;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Makes this process the parent of orphans below it, so that nothing that a stage started outlives
/// the run unseen.
pub fn adopt_orphans() {
    // Where it is refused, orphans end by themselves when their pipes close.
    rustix::process::set_child_subreaper(Some(rustix::process::getpid())).ok();
}

fn own_children() -> Option<Vec<Pid>> {
    children_of(std::process::id())
        .map(|children| children.into_iter().filter_map(|pid| Pid::from_raw(pid.cast_signed())).collect())
}

/// Process ids of the children of a process; `None` where the kernel does not tell.
#[must_use]
pub fn children_of(pid: u32) -> Option<Vec<u32>> {
    let mut children = Vec::new();
    for task in std::fs::read_dir(format!("/proc/{pid}/task")).ok()? {
        let text = std::fs::read_to_string(task.ok()?.path().join("children")).ok()?;
        children.extend(text.split_whitespace().filter_map(|word| word.parse::<u32>().ok()));
    }
    Some(children)
}
