//! What a flight, and an ingest, may use: memory.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use terravision_tests::folder::TestFolder;
use terravision_tests::process::{Terravision, peak_kib, pss_kib};
use terravision_tests::shot::read_report;
use terravision_tests::worlds::synth_world;

/// All processes together stay below --memory + 300 MB at 1280 x 720.
#[test]
fn all_processes_together_stay_within_the_memory_they_were_given() {
    let world = synth_world(1024);
    for memory_mib in [128u64, 512] {
        let folder = TestFolder::new("memory");
        let mut running = Terravision::verb("fly")
            .arg(world.database())
            .args(["--path", "orbit", "--frames", "0..40", "--size", "1280x720"])
            .args(["--memory", &format!("{memory_mib}MiB")])
            .arg("-o")
            .arg(folder.join("a/"))
            .arg("--report")
            .arg(folder.join("report.json"))
            .spawn();
        let mut peak = 0;
        let mut samples = 0;
        let last = folder.join("a/frame-000039.png");
        running.until("the last frame", |running| {
            let pids = std::iter::once(running.pid()).chain(running.children().into_iter().map(|(pid, _)| pid));
            peak = peak.max(pids.filter_map(pss_kib).sum());
            samples += 1;
            last.exists().then_some(())
        });
        running.wait().assert_code(0);
        let report = read_report(&folder);
        println!(
            "--memory {memory_mib}MiB: peak of {} MiB in {samples} samples; {}",
            peak >> 10,
            report["rss_peak_mb"]
        );
        assert!(samples > 5, "the flight was watched");
        assert!(peak > 20 << 10, "the processes were seen");
        assert!(peak * 1024 <= (memory_mib << 20) + 300_000_000, "{} KiB with --memory {memory_mib}MiB", peak);
    }
}

/// Ingest stays below its --memory, for rasters that are larger: 268 MB of samples here.
#[test]
fn ingest_stays_within_the_memory_it_was_given() {
    const MEMORY_KIB: u64 = 256 << 10;
    let world = synth_world(4096);
    let folder = TestFolder::new("ingest-memory");
    let mut running = Terravision::verb("ingest")
        .arg("--elevation")
        .arg(world.dem())
        .arg("--color")
        .arg(world.ortho())
        .args(["--memory", "256MiB", "-o"])
        .arg(folder.join("w.tv"))
        .spawn();
    let mut peak = 0;
    // The largest resident set that the process ever had; the last look is one at its end.
    while !running.has_ended() {
        peak = peak.max(peak_kib(running.pid()).unwrap_or(0));
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    running.wait().assert_code(0);
    println!("peak of {} MiB", peak >> 10);
    assert!(peak > 20 << 10, "the process was seen");
    assert!(peak <= MEMORY_KIB, "{peak} KiB with --memory 256MiB");
}

/// A frame that can never fit is refused with what it would take, and the exit code of bad input.
#[test]
fn a_frame_that_needs_more_than_its_memory_is_refused() {
    let world = synth_world(4096);
    let folder = TestFolder::new("too-little-memory");
    let finished = Terravision::verb("fly")
        .arg(world.database())
        .args(["--path", "orbit", "--frames", "0..2", "--size", "1280x720", "--texel-px", "0.25"])
        .args(["--memory", "128MiB", "-o"])
        .arg(folder.join("a/"))
        .run();
    finished.assert_told(2);
    assert!(finished.stderr.contains("allow more"), "{}", finished.stderr);
}
