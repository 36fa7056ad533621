//! Shares of ground and of measured ground are interpolated as heights are, at every vertex: so two
//! leaves agree on them along their common edge wherever they agree on heights (tests of cracks),
//! and holes grow and shrink as smoothly as heights do.

mod support;

use proptest::prelude::*;
use support::{NODES, case, tile_slots};
use terravision_common::rig::Views;
use terravision_common::validity::{GROUND_PLANE, MEASURED_PLANE, PLANES};
use terravision_preparer::frame::{FrameBuffer, FrameMaker, FrameRequest};
use terravision_preparer::frame_tree::FrameTree;

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

    #[test]
    fn shares_have_the_weights_of_heights(case in case()) {
        let mut case = case;
        case.world = case.world.with_validity(true);
        let tree = case.tree();
        let mut tiles = case.tiles(&tree);
        let posts = (case.world.elevation_posts() as usize).pow(2);
        // In place of shares what is easy to compare: the heights themselves, and their negatives.
        for tile in tiles.elevation.values_mut() {
            tile.truncate(posts);
            let heights = tile.clone();
            tile.extend(&heights);
            tile.extend(heights.iter().map(|height| -height));
        }
        let mut frame_tree = FrameTree::new(&case.world, NODES, NODES);
        frame_tree.read(&tree).expect("a valid tree");
        let mut out = FrameBuffer::new(16, PLANES * posts);
        let mut maker = FrameMaker::new(&case.world, NODES).with_whole_blocks();
        let (header, views, level) = (case.header(&tree), Views::single(&case.camera), case.level());
        let request = FrameRequest { header: &header, pose: &case.camera, views: &views, level: &level };
        maker.make(&request, &frame_tree, &tiles, 0, &mut out).expect("a frame");
        let row = case.world.elevation_posts() as usize;
        let level = case.level();
        for slot in tile_slots(&out) {
            let array = out.array(slot.elevation_position).expect("of the frame");
            let step = 1 << slot.grid_snap;
            for j in (usize::from(slot.start[1])..=usize::from(slot.end[1])).step_by(step) {
                for i in (usize::from(slot.start[0])..=usize::from(slot.end[0])).step_by(step) {
                    let at = |plane: usize| f64::from(array[plane * posts + j * row + i]);
                    let [height, ground, measured] = [at(0), at(GROUND_PLANE), at(MEASURED_PLANE)];
                    let expected = level.exaggeration() * ground - level.frame().eye().z;
                    let tolerance = 1e-5 * (1.0 + height.abs() + level.frame().eye().z.abs() + ground.abs() * level.exaggeration());
                    prop_assert!((height - expected).abs() <= tolerance, "post {i}, {j}: {height}, {expected}");
                    prop_assert_eq!(ground, -measured);
                }
            }
        }
    }
}
