use super::color::{ColorLayout, ColorPlace};
use super::*;
use glam::{DVec2, DVec3};
use terravision_common::surface::Plane;

const SHAPE: GroundShape = GroundShape {
    surface: Plane::new(10.0, [u32::MAX; 2], 16),
    levels: 3,
    color: ColorLayout { side: 16, mips: 1 },
    filter: Some(Filter::OrientedBox),
};

fn spec(origin: [u32; 2], heights: &[f32]) -> TileSpec<'_> {
    let color = ColorPlace::new(0, DVec2::ZERO, 1.0);
    TileSpec {
        origin,
        level: 0,
        log_spacing: 0,
        cells: [16, 16],
        heights,
        shares: None,
        stride: 17,
        datum_m: 0.0,
        color,
        is_accurate: true,
    }
}

fn field(origin: [u32; 2], height: impl Fn(u32, u32) -> f32) -> Vec<f32> {
    (0..17 * 17).map(|k| height(origin[0] + k % 17, origin[1] + k / 17)).collect()
}

fn rough(x: u32, y: u32) -> f32 {
    ((x * 37 + y * 61) % 29) as f32 * 3.0 + x as f32
}

#[test]
fn columns_on_the_edge_of_two_tiles_are_the_same_in_both() {
    for filter in [Filter::OrientedBox, Filter::Gaussian] {
        let mut ground = Ground::new(GroundShape { filter: Some(filter), ..SHAPE });
        for origin in [[0, 0], [16, 0], [0, 16], [16, 16]] {
            ground.add(&spec(origin, &field(origin, rough))).unwrap();
        }
        ground.finish();
        let density = |tile: usize, i: usize, j: usize, layer: i32| {
            let tile = &ground.tiles()[tile];
            let at = layer - tile.voxels.lowest_layer;
            let layers = tile.voxels.layers as i32;
            if at < 0 || at >= layers {
                return None;
            }
            Some(ground.densities(tile)[(j * 17 + i) * layers as usize + at as usize])
        };
        let mut compared = 0;
        for layer in -10..60 {
            for k in 0..17 {
                for (a, b) in [
                    (density(0, 16, k, layer), density(1, 0, k, layer)),
                    (density(0, k, 16, layer), density(2, k, 0, layer)),
                    (density(1, 0, 16, layer), density(2, 16, 0, layer)),
                ] {
                    if let (Some(a), Some(b)) = (a, b) {
                        assert_eq!(a, b, "{filter:?}: post {k}, layer {layer}");
                        compared += 1;
                    }
                }
            }
        }
        assert!(compared > 500);
    }
}

#[test]
fn the_boundary_array_says_where_densities_cross_the_threshold() {
    for filter in [Filter::OrientedBox, Filter::Gaussian] {
        let mut ground = Ground::new(GroundShape { filter: Some(filter), ..SHAPE });
        ground.add(&spec([16, 32], &field([16, 32], rough))).unwrap();
        ground.finish();
        let tile = &ground.tiles()[0];
        let (densities, layers) = (ground.densities(tile), tile.voxels.layers as usize);
        for (cell, span) in ground.spans(tile).iter().enumerate() {
            let (i, j) = (cell % 16, cell / 16);
            let is_ground = |layer: usize| {
                let columns = [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)];
                columns.map(|(i, j)| f32::from(densities[(j * 17 + i) * layers + layer]) > THRESHOLD)
            };
            let is_boundary = |layer: usize| {
                let voxels = [is_ground(layer), is_ground(layer + 1)].concat();
                voxels.contains(&true) && voxels.contains(&false)
            };
            let found: Vec<usize> = (0..layers - 1).filter(|layer| is_boundary(*layer)).collect();
            assert_eq!([found[0], found[found.len() - 1]], [span.lowest, span.highest].map(usize::from));
        }
    }
}

#[test]
fn maxima_are_the_highest_posts_of_their_blocks() {
    let mut ground = Ground::new(SHAPE);
    let heights = field([0, 0], rough);
    ground.add(&TileSpec { cells: [13, 10], ..spec([0, 0], &heights) }).unwrap();
    ground.finish();
    let tile = &ground.tiles()[0];
    let mut at = 0;
    for level in 1..=4u32 {
        let side = 1usize << level;
        for j in 0..10usize.div_ceil(side) {
            for i in 0..13usize.div_ceil(side) {
                let rows = (j * side)..=((j + 1) * side).min(10);
                let posts = rows.flat_map(|row| (i * side..=((i + 1) * side).min(13)).map(move |column| (row, column)));
                let highest = posts.map(|(row, column)| heights[row * 17 + column]).fold(f32::NEG_INFINITY, f32::max);
                assert_eq!(ground.maxima(tile)[at], highest, "level {level}, block {i}, {j}");
                at += 1;
            }
        }
    }
}

#[test]
fn voxels_are_for_the_nearest_tiles_and_within_their_bytes() {
    let mut ground = Ground::new(SHAPE);
    let origins = [[32, 0], [0, 0], [16, 0], [48, 0]];
    // The eye is 400 m above a flat ground, over the second tile; they are 160 m wide.
    let eye_in_world = DVec3::new(80.0, 80.0, 400.0);
    let mut finish = |detail: Detail| {
        ground.clear(400.0);
        for origin in origins {
            ground.add(&TileSpec { datum_m: 0.0, ..spec(origin, &field(origin, |_, _| 0.0)) }).unwrap();
        }
        ground.finish_for(&detail);
        let mut accurate: Vec<u32> =
            ground.tiles().iter().filter(|tile| tile.voxels.is_accurate).map(|tile| tile.origin[0] / 16).collect();
        accurate.sort_unstable();
        assert_eq!(accurate.len(), ground.accurate_count());
        assert!(ground.voxel_bytes() <= detail.most_bytes);
        assert_eq!(ground.spans(&ground.tiles()[3]).len(), 16 * 16, "all have the boundary array");
        (accurate, ground.voxel_bytes())
    };
    let all = Detail { eye_in_world, ..Detail::ALL };
    let (accurate, bytes) = finish(all);
    assert_eq!(accurate, [0, 1, 2, 3]);
    // Distances: 370 m down to the top of the voxels; beside 0, 80, 240 and 400 m.
    assert_eq!(finish(Detail { reach: 1.1, ..all }).0, [0, 1]);
    assert_eq!(finish(Detail { reach: 1.3, ..all }).0, [0, 1, 2]);
    assert_eq!(finish(Detail { reach: 0.0, ..all }).0, [] as [u32; 0], "no tile is as near as it is wide");
    let near = Detail { eye_in_world: DVec3::new(80.0, 80.0, 50.0), reach: 0.0, ..all };
    assert_eq!(finish(near).0, [0, 1], "as near as it is wide");
    for tiles in 0..=4 {
        let (accurate, _) = finish(Detail { most_bytes: tiles * bytes / 4, ..all });
        assert_eq!(accurate, (0..tiles as u32).collect::<Vec<_>>(), "the nearest ones");
    }
    assert_eq!(finish(Detail { most_bytes: bytes / 4 - 1, ..all }), (vec![], 0));
}

#[test]
fn what_is_no_tile_is_refused_and_changes_nothing() {
    let mut ground = Ground::new(SHAPE);
    let heights = field([0, 0], rough);
    ground.add(&spec([0, 0], &heights)).unwrap();
    let mut broken = heights.clone();
    broken[20] = f32::NAN;
    for (spec, expected) in [
        (spec([0, 0], &heights), "covers"),
        (spec([8, 0], &heights), "no node"),
        (spec([64, 0], &heights), "no node"),
        (TileSpec { level: 3, ..spec([0, 0], &heights) }, "no node"),
        (TileSpec { cells: [17, 1], ..spec([16, 0], &heights) }, "fill"),
        (TileSpec { cells: [0, 1], ..spec([16, 0], &heights) }, "fill"),
        (spec([16, 0], &heights[1..]), "fill"),
        (spec([16, 0], &broken), "finite"),
    ] {
        let error = ground.add(&spec).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    ground.finish();
    assert_eq!(ground.tile_count(), 1);
    assert_eq!(ground.height_at([3.5, 2.0]), Some(0.5 * (rough(3, 2) + rough(4, 2))));
    assert_eq!(ground.height_at([17.0, 2.0]), None);
}
