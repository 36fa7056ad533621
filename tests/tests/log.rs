//! The log: off unless it is asked for, of every process when it is, and never taken for a message.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

use terravision_tests::process::Terravision;
use terravision_tests::worlds::synth_world;

fn fly() -> Terravision {
    let world = synth_world(1024).database();
    Terravision::verb("fly").arg(world).args(["--size", "64x36", "--frames", "0..3", "-o", "/dev/null"])
}

/// Lines of a log: a time, a level, a target.
fn logged<'t>(stderr: &'t str, target: &str) -> Vec<&'t str> {
    let is_logged = |line: &&str| line.split_whitespace().nth(2).is_some_and(|word| word.starts_with(target));
    stderr.lines().filter(is_logged).collect()
}

#[test]
fn every_process_logs_when_it_is_asked_to_and_none_otherwise() {
    let quiet = fly().succeed();
    assert_eq!(quiet.stderr.lines().filter(|line| !line.starts_with("terravision: ")).count(), 0, "{}", quiet.stderr);
    let traced = fly().args(["--log", "trace"]).succeed();
    for target in ["generator", "preparer", "prefetcher", "renderer", "launcher", "common"] {
        let lines = logged(&traced.stderr, &format!("terravision_{target}"));
        assert!(!lines.is_empty(), "{target} logs nothing: {}", traced.stderr);
    }
    // What stages log is not a message of theirs: those are quoted at the end as warnings.
    assert!(!traced.stderr.contains("@log") && !traced.stderr.contains("warning"), "{}", traced.stderr);
    assert_eq!(logged(&traced.stderr, "terravision_generator").iter().filter(|l| l.contains(" tree ")).count(), 3);
}

#[test]
fn filters_choose_targets_and_the_flag_wins_over_the_variable() {
    let one = fly().args(["--log", "off,terravision_preparer=trace"]).env("TERRAVISION_LOG", "trace").succeed();
    assert!(!logged(&one.stderr, "terravision_preparer").is_empty(), "{}", one.stderr);
    assert!(logged(&one.stderr, "terravision_generator").is_empty(), "{}", one.stderr);
    let stages = fly().env("TERRAVISION_LOG", "stages").succeed();
    assert!(logged(&stages.stderr, "terravision").is_empty(), "{}", stages.stderr);
    let refused = fly().args(["--log", "debg"]).run();
    refused.assert_code(2);
    assert!(refused.stderr.contains("--log: expected off, error, warn, info, debug or trace"), "{}", refused.stderr);
    // Programs of their own get it as their argument, or in their environment.
    for arguments in [&["--size", "64", "--log", "debg"][..], &["--log", "debg", "--size", "64"]] {
        let refused = Terravision::verb("synth").args(arguments).args(["-o", "/nonexistent/w"]).run();
        refused.assert_code(2);
        assert!(refused.stderr.contains("--log: expected off, error"), "{}", refused.stderr);
    }
}
