//! The program itself, as far as it goes without a world: help, usage errors, commands that are
//! other programs.
#![expect(clippy::unwrap_used, reason = "a test that finds nothing to unwrap has failed")]

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const PROGRAM: &str = env!("CARGO_BIN_EXE_terravision");

fn run(program: &Path, arguments: &[&str]) -> Output {
    loop {
        match Command::new(program).args(arguments).output() {
            // Another test's fork holds the copied program open for writing for a moment.
            Err(error) if error.kind() == std::io::ErrorKind::ExecutableFileBusy => {}
            output => return output.unwrap(),
        }
    }
}

fn assert_told(output: &Output, code: i32, words: &str) {
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{text}");
    assert!(text.starts_with("terravision: ") && text.contains(words), "{text}");
    assert_eq!(text.trim_end().lines().count(), 1, "{text}");
}

/// A folder with the program alone in it, removed at the end.
struct Alone(PathBuf);

impl Alone {
    fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("terravision-commands-{}-{name}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        fs::copy(PROGRAM, folder.join("terravision")).unwrap();
        Self(folder)
    }

    fn run(&self, arguments: &[&str]) -> Output {
        run(&self.0.join("terravision"), arguments)
    }
}

impl Drop for Alone {
    fn drop(&mut self) {
        fs::remove_dir_all(&self.0).ok();
    }
}

#[test]
fn help_is_a_result() {
    for arguments in
        [&["--help"][..], &["help", "fly"], &["fly", "--help"], &["still", "--help"], &["path", "-h"], &["--version"]]
    {
        let output = run(Path::new(PROGRAM), arguments);
        assert_eq!(output.status.code(), Some(0), "{arguments:?}");
        assert!(!output.stdout.is_empty() && output.stderr.is_empty(), "{arguments:?}");
    }
}

#[test]
fn bad_usage_and_bad_worlds_are_told_in_one_sentence() {
    let program = Path::new(PROGRAM);
    assert_told(&run(program, &["fly", "w.tv", "-o", "a.mp4", "--size", "0x0"]), 2, "1280x720");
    assert_told(&run(program, &["fly"]), 2, "required");
    assert_told(&run(program, &["fyl"]), 2, "fyl");
    assert_told(&run(program, &["info", "/nonexistent.tv"]), 2, "no finished terrain database");
    assert_told(&run(program, &["fly", "/nonexistent.tv", "-o", "/tmp/never/"]), 2, "no finished terrain database");
    assert!(!Path::new("/tmp/never").exists());
}

#[test]
fn commands_that_are_other_programs_get_their_arguments() {
    let alone = Alone::new("passed-on");
    assert_told(&alone.run(&["ingest", "--elevation", "a.tif"]), 1, "terravision-ingest is missing");
    for (name, verb, expected) in
        [("terravision-ingest", "synth", "synth --help -o x y\n"), ("terravision-bench", "bench", "--help -o x y\n")]
    {
        let path = alone.0.join(name);
        fs::write(&path, "#!/bin/sh\necho \"$@\"\nexit 7\n").unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
        let output = alone.run(&[verb, "--help", "-o", "x", "y"]);
        assert_eq!((output.status.code(), String::from_utf8_lossy(&output.stdout).as_ref()), (Some(7), expected));
    }
}

#[test]
fn the_doctor_says_what_is_missing_and_what_to_do() {
    let output = Alone::new("doctor").run(&["doctor"]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("MISSING  programs") && text.contains("cargo build --release"), "{text}");
    assert!(String::from_utf8_lossy(&output.stderr).contains("lacks what a flight needs: programs"));
}
