//! No background is seen through the ground: not from above, not at grazing angles, on terrain as
//! rough as none is.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use terravision_testkit::metrics::count_holes;
use terravision_tests::flight::{Pose, read_png, write_png};
use terravision_tests::folder::{TestFolder, target_tmp};
use terravision_tests::process::Terravision;
use terravision_tests::shot::Shot;
use terravision_tests::worlds::{TestWorld, named_world, rough_world};

/// Saturated, where all textures of the rough world are grey.
const SKY: [u8; 3] = [255, 0, 255];

/// Pixels that a facet may move a silhouette by. Facets are of 10 pixels, and a ridge between two
/// posts of a coarser level may be lower than it is by the facet's own size; beyond that, sky is a
/// hole.
const TOLERANCE_PX: usize = 20;

fn poses(world: &TestWorld) -> Vec<(&'static str, Pose)> {
    vec![
        ("from above", Pose::new(world.above(0.5, 0.5, 2500.0), 30.0, -90.0)),
        ("oblique", Pose::new(world.above(0.4, 0.2, 900.0), 15.0, -35.0)),
        ("grazing", Pose::new(world.above(0.5, 0.1, 350.0), 0.0, -5.0)),
        ("close", Pose::new(world.above(0.6, 0.6, 60.0), 200.0, -15.0)),
        ("rolled", Pose { roll: 70.0, ..Pose::new(world.above(0.3, 0.5, 500.0), 80.0, -12.0) }),
    ]
}

/// By default; coarse facets with fine texels (colour leaves far below elevation leaves); fine
/// facets with coarse texels (elevation leaves far below colour tiles).
const SETTINGS: [&[&str]; 3] =
    [&[], &["--facet-px", "60", "--measure", "max"], &["--facet-px", "4", "--texel-px", "4", "--measure", "min"]];

#[test]
fn no_sky_is_seen_through_the_ground() {
    let world = rough_world();
    for (name, pose) in poses(&world) {
        let shot = Shot { sky_rgb: SKY, ..Shot::new(&world, pose) };
        let reference = shot.reference(2);
        for arguments in SETTINGS {
            let taken = shot.take(arguments, false);
            let holes = count_holes(&taken.is_sky(SKY), &reference, TOLERANCE_PX);
            println!("{name:12} {arguments:?}: {holes:?}");
            assert!(holes.looked_at > 200_000, "{name} shows land");
            if holes.count > 0 {
                let evidence = target_tmp().join(format!("holes-{}.png", name.replace(' ', "-")));
                write_png(&evidence, reference.width, &taken.rgb);
                panic!("{name} with {arguments:?}: {holes:?}, see {}", evidence.display());
            }
        }
    }
}

/// On the crests of these views lies a facet that is seen so nearly edge on that taking its
/// vertices to the rasterizer's grid turns it round. A device that culls before it rounds then
/// leaves a pixel open, two of 786 million.
#[test]
fn facets_that_are_seen_edge_on_leave_no_pixel_open() {
    let views = [
        ([510_228.182_411_356_6, 5_009_268.130_909_091], 48.029_375_406_962_174, [320, 180], [261, 94]),
        ([507_715.563_773_312_43, 5_006_631.796_363_636], 33.418_962_935_136_484, [640, 360], [116, 243]),
    ];
    let database = named_world();
    for ([x, y], heading, [width, height], [column, row]) in views {
        let folder = TestFolder::new("crest");
        Terravision::verb("still")
            .arg("--quality=default")
            .arg(&database)
            .args(Pose::new([x, y, 1500.0], heading, -16.0).arguments())
            .args([format!("--size={width}x{height}"), "--sky=255,0,255".to_owned(), "--technique=mesh".to_owned()])
            .arg("-o")
            .arg(folder.join("a.png"))
            .succeed();
        let (width, _, rgb) = read_png(&folder.join("a.png"));
        assert_ne!(rgb[row * width + column], SKY, "{width} pixels wide");
        assert_ne!(rgb[(row - 1) * width + column], SKY, "it is ground that lies behind");
    }
}
