//! Compressed colour tiles: nearly the picture of plain ones, the same bytes on every run, more
//! tiles in the same memory.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use terravision_testkit::metrics::compare;
use terravision_tests::flight::{Pose, read_png, write_path};
use terravision_tests::folder::TestFolder;
use terravision_tests::process::Terravision;
use terravision_tests::shot::read_report;
use terravision_tests::worlds::synth_world;

const FRAMES: u64 = 4;
const SIZE: [u32; 2] = [320, 180];

fn fly(folder: &TestFolder, name: &str, arguments: &[&str]) -> Terravision {
    Terravision::verb("fly")
        .arg(synth_world(1024).database())
        .arg("--path")
        .arg(folder.join("path.json"))
        .arg("-o")
        .arg(folder.join(format!("{name}/")))
        .arg("--report")
        .arg(folder.join("report.json"))
        .args(arguments)
}

/// From close by to far above: colour tiles of all levels, and all their mips.
fn write_flight(folder: &TestFolder) {
    let world = synth_world(1024);
    let pose = |k: u64| {
        let t = k as f64 / FRAMES as f64;
        Pose::new(world.above(0.3 + 0.2 * t, 0.3, 150.0 + 4000.0 * t), 40.0, -20.0 - 30.0 * t)
    };
    write_path(&folder.join("path.json"), &(0..FRAMES).map(pose).collect::<Vec<_>>(), SIZE, 60.0);
}

#[test]
fn compressed_flights_are_nearly_the_plain_ones_and_the_same_on_every_run() {
    let folder = TestFolder::new("compression");
    write_flight(&folder);
    // Of each run its report.
    let flown = |name: &str, arguments: &[&str]| {
        fly(&folder, name, arguments).succeed();
        let report = read_report(&folder);
        assert_eq!(report["settled"], true, "{report}");
        report
    };
    let frame = |name: &str, frame: u64| folder.join(format!("{name}/frame-{frame:06}.png"));
    let on = ["--texture-compression", "on"];
    // Compressed tiles and the validation layer are the mesh's, on any machine.
    let compressed = flown("on", &[&on[..], &["--validation"]].concat());
    assert_eq!((&compressed["settings"]["texels"], &compressed["technique"]), (&"bc1".into(), &"mesh".into()));
    // An eighth of the memory per tile: this would be too little for plain ones.
    flown("again", &[&on[..], &["--memory", "16MiB", "--threads", "1"]].concat());
    let mesh = ["--technique", "mesh"];
    let plain = flown("off", &[&mesh[..], &["--texture-compression", "off"]].concat());
    assert_eq!(plain["settings"]["texels"], "rgba8");
    for k in 0..FRAMES {
        let [on, again, off] = ["on", "again", "off"].map(|name| frame(name, k));
        assert!(std::fs::read(&on).unwrap() == std::fs::read(&again).unwrap(), "frame {k}: the same bytes");
        let ((width, _, on), (_, _, off)) = (read_png(&on), read_png(&off));
        assert!(on != off, "frame {k}: there is something to compress");
        let quality = compare(width, &on, &off, &vec![true; off.len()]);
        println!("frame {k}: {:.1} dB, SSIM {:.4}", quality.psnr_db, quality.ssim);
        assert!(quality.psnr_db > 36.0 && quality.ssim > 0.97, "frame {k}: {quality:?}");
    }
    // Nothing said: never on a device that is the processor itself.
    let auto = flown("auto", &mesh);
    if auto["device"].as_str().unwrap().contains("llvmpipe") {
        assert_eq!(auto["settings"]["texels"], "rgba8");
        for k in 0..FRAMES {
            assert!(std::fs::read(frame("auto", k)).unwrap() == std::fs::read(frame("off", k)).unwrap(), "frame {k}");
        }
    }
}

#[test]
fn compression_that_cannot_be_is_refused_and_nothing_is_made() {
    let folder = TestFolder::new("no-compression");
    write_flight(&folder);
    let refused = |command: Terravision, words: &str| {
        let finished = command.run();
        finished.assert_told(2);
        assert!(finished.stderr.contains(words), "{}", finished.stderr);
        assert!(!folder.join("a").exists());
    };
    let on = ["--texture-compression", "on"];
    refused(fly(&folder, "a", &[&on[..], &["--technique", "rays"]].concat()), "--technique mesh");
    let without_device = ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"]
        .iter()
        .fold(fly(&folder, "a", &on), |command, name| command.env(name, "/nonexistent.json"));
    refused(without_device, "there is no Vulkan device that can be used");
    // As plain tiles, the least memory of compressed ones is too little.
    refused(fly(&folder, "a", &["--texture-compression", "off", "--memory", "16MiB"]), "--memory 16 MiB");
    let doctor = Terravision::verb("doctor").args(["--memory", "64MiB"]).run();
    let words = String::from_utf8_lossy(&doctor.stdout);
    assert!(words.lines().any(|line| line.contains("compression") && line.contains("colour tiles")), "{words}");
}
