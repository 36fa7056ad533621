//! What is left behind: files, exit codes, nothing.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod support;

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};
use support::{TestFolder, Tiff, command, error_line, finish, job, program, run};

fn files(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut files: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap())
        .map(|entry| (entry.file_name().to_string_lossy().into_owned(), fs::read(entry.path()).unwrap()))
        .collect();
    files.sort();
    files
}

fn rough(i: usize, j: usize) -> f32 {
    if i.abs_diff(300) + j.abs_diff(200) < 40 { -9999.0 } else { ((i * 31 + j * 17) % 101) as f32 + i as f32 }
}

#[test]
fn the_bytes_do_not_depend_on_the_number_of_threads() {
    let folder = TestFolder::new();
    let dem = Tiff { nodata: Some(-9999.0), ..Tiff::utm([700, 430], rough) }.write(&folder.path("dem.tif"));
    let made = [1, 3].map(|threads| {
        let mut job = job(std::slice::from_ref(&dem), &[], folder.path(&format!("{threads}")).join("w.tv"));
        job.threads = threads;
        run(&job).unwrap();
        files(&job.output)
    });
    assert_eq!(
        made[0].iter().map(|f| f.0.as_str()).collect::<Vec<_>>(),
        ["color.pmtiles", "elevation.pmtiles", "manifest.json", "nodes.tvn"]
    );
    assert!(made[0] == made[1]);
}

#[test]
fn a_finished_database_is_replaced_only_when_asked() {
    let folder = TestFolder::new();
    let dem = Tiff::utm([30, 30], |i, _| i as f32).write(&folder.path("dem.tif"));
    let mut job = job(&[dem], &[], folder.path("w.tv"));
    run(&job).unwrap();
    let before = files(&job.output);
    let error = run(&job).unwrap_err();
    assert!(error.to_string().contains("--overwrite"), "{error}");
    assert_eq!(error.exit_code(), 2);
    job.may_overwrite = true;
    // A mistake on the way leaves the old one as it was.
    let good = std::mem::replace(&mut job.elevation, vec![folder.path("missing.tif")]);
    run(&job).unwrap_err();
    assert!(files(&job.output) == before);
    job.elevation = good;
    run(&job).unwrap();
    assert!(files(&job.output) == before);
}

#[test]
fn a_half_written_output_is_no_obstacle_and_a_foreign_folder_is() {
    let folder = TestFolder::new();
    let dem = Tiff::utm([30, 30], |i, _| i as f32).write(&folder.path("dem.tif"));
    let job = job(&[dem], &[], folder.path("w.tv"));
    fs::create_dir(&job.output).unwrap();
    fs::write(job.output.join("elevation.pmtiles.part"), "half").unwrap();
    fs::write(job.output.join("color.pmtiles"), "old").unwrap();
    run(&job).unwrap();
    assert_eq!(files(&job.output).len(), 4);

    let foreign = folder.path("photos");
    fs::create_dir(&foreign).unwrap();
    fs::write(foreign.join("holiday.jpg"), "mine").unwrap();
    let error = run(&terravision_ingest::job::Job { output: foreign.clone(), ..job.clone() }).unwrap_err();
    assert!(error.to_string().contains("holiday.jpg"), "{error}");
    assert_eq!(files(&foreign).len(), 1);
    let error = run(&terravision_ingest::job::Job { output: foreign.join("holiday.jpg"), ..job }).unwrap_err();
    assert_eq!(error.exit_code(), 2);
}

#[test]
fn an_interrupt_leaves_nothing_and_says_that_it_can_be_run_again() {
    let folder = TestFolder::new();
    let dem = Tiff::utm([3000, 3000], rough).write(&folder.path("dem.tif"));
    let world = folder.path("w.tv");
    let arguments = ["ingest", "--elevation", dem.to_str().unwrap(), "-o", world.to_str().unwrap(), "--threads", "1"];
    let child = command(&arguments).spawn().unwrap();
    let deadline = Instant::now() + Duration::from_secs(120);
    while !world.join("elevation.pmtiles.part").exists() {
        assert!(Instant::now() < deadline, "it never began to write");
        std::thread::sleep(Duration::from_millis(5));
    }
    let pid = rustix::process::Pid::from_child(&child);
    rustix::process::kill_process(pid, rustix::process::Signal::INT).unwrap();
    let output = finish(child);
    assert_eq!(output.status.code(), Some(130));
    assert!(error_line(&output).contains("run again"));
    assert!(!world.exists());
}

#[test]
fn wrong_usage_and_input_end_with_2_and_one_sentence() {
    let folder = TestFolder::new();
    let dem = Tiff::utm([30, 30], |i, _| i as f32).write(&folder.path("dem.tif"));
    let (dem, world) = (dem.to_str().unwrap(), folder.path("w.tv"));
    let world = world.to_str().unwrap();
    let cases: [&[&str]; 7] = [
        &["--elevation", "/nowhere/dem.tif", "-o", world],
        &["--elevation", "/etc/passwd", "-o", world],
        &["--elevation", dem, "-o", world, "--crs", "EPSG:4326"],
        &["--elevation", dem, "-o", world, "--source-crs", "nonsense", "--crs", "nonsense"],
        &["--elevation", dem, "-o", world, "--memory", "1MiB"],
        &["--elevation", dem, "-o", dem],
        &["--elevation", dem, "-o", world, "--elevation-tile", "33"],
    ];
    for case in cases {
        let output = program(&[&["ingest"], case].concat());
        assert_eq!(output.status.code(), Some(2), "{case:?}");
        error_line(&output);
    }
    // clap's own messages have several lines, and the same code.
    assert_eq!(program(&["ingest", "-o", world]).status.code(), Some(2));
    assert_eq!(program(&["ingest", "--elevation", dem, "-o", world, "--color-quality", "0"]).status.code(), Some(2));
    assert!(!Path::new(world).exists());
}

#[test]
fn a_place_that_cannot_be_used_ends_with_2() {
    let folder = TestFolder::new();
    let dem = Tiff::utm([30, 30], |i, _| i as f32).write(&folder.path("dem.tif"));
    let output = program(&["ingest", "--elevation", dem.to_str().unwrap(), "-o", "/proc/world.tv"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(error_line(&output).contains("cannot write into /proc/world.tv"));
}
