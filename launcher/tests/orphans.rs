//! What a stage has started and left behind is ended. A test program of its own: it ends all
//! children of its process.

use std::process::Command;
use std::time::{Duration, Instant};
use terravision_launcher::process::orphans::{adopt_orphans, children_of, end_orphans};

#[test]
fn an_orphan_of_a_stage_is_ended() {
    adopt_orphans();
    // The shell stands for a renderer that dies, the sleeper for its encoder.
    let mut shell = Command::new("sh").args(["-c", "sleep 600 & kill -9 $$"]).spawn().unwrap();
    shell.wait().unwrap();
    let end = Instant::now() + Duration::from_secs(60);
    let orphans = loop {
        let children = children_of(std::process::id()).unwrap();
        if !children.is_empty() {
            break children;
        }
        assert!(Instant::now() < end, "the orphan does not come");
        std::thread::sleep(Duration::from_millis(5));
    };
    while children_of(std::process::id()).is_some_and(|children| !children.is_empty()) {
        assert!(Instant::now() < end, "the orphan does not end");
        end_orphans();
    }
    for pid in orphans {
        assert!(!std::path::Path::new(&format!("/proc/{pid}")).exists());
    }
}
