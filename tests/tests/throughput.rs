//! The stages one by one, at full speed: what passes through them is checked, how fast is printed.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use terravision_bench::findings::Findings;
use terravision_bench::flight::Flight;
use terravision_bench::measurement::table;
use terravision_bench::queues;
use terravision_bench::session::Settings;
use terravision_bench::stages;
use terravision_common::event::SpanName;
use terravision_common::level::Measure;
use terravision_common::run::{RaysChoice, TechniqueChoice};
use terravision_common::tree::{COLOR_LEAF, ELEVATION_LEAF};
use terravision_tests::process::binary;
use terravision_tests::worlds::synth_world;

#[test]
fn everything_that_is_written_to_a_queue_is_read_in_order() {
    // The readers are processes.
    assert!(binary("terravision-bench").is_file());
    // Counts and checksums are compared by the bench itself.
    let found = queues::run(queues::Load { slots: 200_000, trees: 500, nodes: 1_000 }).unwrap();
    print!("{}", table(&found));
    assert!(found.iter().all(|m| m.value.is_finite() && m.value > 0.0));
}

#[test]
fn trees_slots_arrays_and_frames_pass_through_the_stages() {
    assert!(binary("terravision-bench").is_file());
    let world = synth_world(1024);
    const FRAMES: u64 = 40;
    let settings = Settings {
        world: world.database(),
        size: [960, 540],
        memory_bytes: 512 << 20,
        r_px: [10.0, 1.0],
        samples: 1,
        measure: Measure::default(),
        technique: TechniqueChoice::Mesh,
        rays: RaysChoice::Mipmap,
    };
    let flight = Flight::open(&settings.world, FRAMES, settings.size).unwrap();
    let recorded = stages::record(&settings, &flight).unwrap();
    assert_eq!(recorded.trees.trees.len() as u64, FRAMES);
    for ((frame, pose), (header, nodes)) in (0u64..).zip(&flight.round).zip(&recorded.trees.trees) {
        assert_eq!((header.frame, header.camera), (frame, *pose.fields()));
        assert_eq!((header.node_count as usize, header.is_cut_short), (nodes.len(), 0));
        let count = nodes.len() as u32;
        let children: u32 = (0u32..)
            .zip(nodes)
            .map(|(at, node)| node.children(at, count).expect("children lie after their node").len() as u32)
            .sum();
        assert_eq!(children + 1, count, "frame {frame}: each node but the root is one node's child");
        for node in nodes {
            assert_eq!(node.flags & COLOR_LEAF != 0, node.child_count == 0, "frame {frame}: {node:?}");
        }
        assert!(nodes.iter().any(|node| node.flags & ELEVATION_LEAF != 0));
    }
    assert_eq!(recorded.frames.len() as u64, FRAMES);
    assert!(recorded.frames.tile_slots() >= FRAMES);
    assert!(recorded.frames.elevation_arrays() >= FRAMES);
    assert!(recorded.frames.arrays().iter().all(|height| height.is_finite()));
    assert_eq!(recorded.trees.span_ms.len() as u64, FRAMES - 1, "a span is told for every frame");

    let alone = stages::fly_recorded(&settings, &flight, &recorded.frames).unwrap();
    let whole = stages::fly_whole(&settings, &flight).unwrap();
    assert_eq!(alone.triangles.len() as u64, FRAMES);
    assert_eq!(alone.triangles, whole.triangles, "recorded frames draw what the pipeline draws");
    assert!(alone.triangles.iter().all(|triangles| *triangles > 100));
    assert_eq!(whole.log.span_ms(SpanName::Prepare, FRAMES).len() as u64, FRAMES);
    let mut found = Findings::default();
    stages::generator_and_preparer(&recorded, &mut found);
    stages::renderer(&settings, std::slice::from_ref(&alone), &mut found);
    stages::replay(&recorded, &[whole], &[alone], &mut found);
    print!("{}", table(&found.measurements));
}
