//! Frames: the same for any number of workers, and no memory taken for one more.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

use terravision_raycast::model::Filter;
use terravision_raycast::{CastOptions, CastTask, Caster, Counts, Picture};
use terravision_testkit::rays::{AnyMethod, Field, camera};

const SIZE: [u32; 2] = [120, 90];
const METHODS: [AnyMethod; 4] = [AnyMethod::Coherent, AnyMethod::Plain, AnyMethod::Mipmap, AnyMethod::Sweep];

#[test]
fn pictures_and_counts_do_not_depend_on_the_number_of_workers() {
    let field = Field::hills(100, 250.0, 1);
    let ground = field.ground(32, Filter::OrientedBox);
    let colors = field.colors();
    for roll in [0.0, 27.0, -140.0] {
        let camera = camera([500.0, 100.0, 400.0], [0.0, -30.0, roll], 60.0, SIZE);
        for method in METHODS {
            for is_approximate in [false, true] {
                let options = CastOptions { is_approximate, ..CastOptions::default() };
                let draw = |workers: usize| -> (Vec<u32>, Vec<u32>, Counts) {
                    let picture = Picture::new(SIZE);
                    let mut caster = Caster::new(workers).unwrap();
                    let counts = method.draw(
                        &mut caster,
                        &CastTask {
                            ground: &ground,
                            colors: &[&colors[..]],
                            heights: &[],
                            camera: &camera,
                            options: &options,
                            picture: &picture,
                        },
                    );
                    (picture.rgba().collect(), picture.depth().map(f32::to_bits).collect(), counts)
                };
                let alone = draw(1);
                assert!(alone.2.hits > 1000);
                for workers in [2, 3, 5] {
                    assert!(draw(workers) == alone, "{method:?} by {workers} workers, roll {roll}");
                }
            }
        }
    }
}

#[test]
fn a_frame_takes_no_memory_once_there_was_one() {
    let field = Field::hills(100, 250.0, 1);
    let colors = field.colors();
    for (method, workers) in METHODS.into_iter().flat_map(|method| [(method, 1), (method, 2)]) {
        let mut ground = field.ground(32, Filter::OrientedBox);
        let mut caster = Caster::new(workers).unwrap();
        let picture = Picture::new(SIZE);
        let options = CastOptions::default();
        let mut draw = |turn: u32| {
            let roll = f64::from(turn) * 29.0;
            let camera = camera([500.0, 100.0, 400.0], [0.0, -30.0, roll], 60.0, SIZE);
            // The ground is made anew as well, as from the arrays of a ring.
            field.fill(&mut ground, 32);
            method.draw(
                &mut caster,
                &CastTask {
                    ground: &ground,
                    colors: &[&colors[..]],
                    heights: &[],
                    camera: &camera,
                    options: &options,
                    picture: &picture,
                },
            );
        };
        draw(0);
        // A queue between threads may take a block now and then.
        let taken = allocation_counter::measure(|| (1..40).for_each(&mut draw)).count_total;
        assert!(taken <= if workers == 1 { 0 } else { 4 }, "{method:?} by {workers} workers: {taken} allocations");
    }
}
