//! Detail coverage: the share of the visible ground that is drawn at the wanted resolution.

use crate::frame_tree::FrameTree;
use crate::truncation::{ColorLeaf, Tiles, Truncation};
use glam::{DVec2, DVec3};
use terravision_common::camera::Camera;
use terravision_common::node::NodeId;
use terravision_common::rig::Views;
use terravision_common::surface::tile::CellPosition;
use terravision_common::world::World;

/// Samples along a side of a leaf, ...
const SAMPLES: u32 = 4;
/// ... and of one that is coarser than wanted, which may be large on screen.
const COARSE_SAMPLES: u32 = 16;
/// Lower bound of the sine of the angle at which level ground is seen, as for the level functions.
const LEAST_SLANT: f64 = 0.15;

/// The share of the ground's area on screen that a truncated tree draws at the wanted resolution:
/// leaves of the full tree, against leaves that stand for nodes below them; over all views of the
/// frame. Ground that is hidden by other ground counts too. 1 when no ground is seen.
#[must_use]
pub fn detail_coverage(
    world: &World,
    views: &Views,
    exaggeration: f64,
    tree: &FrameTree,
    drawn: &Truncation,
    tiles: &impl Tiles,
) -> f64 {
    let eyes = views.cameras().map(|camera| View { world, camera, exaggeration, axes: camera.axes_in_world() });
    let (mut all, mut fine) = (0.0, 0.0);
    for leaf in drawn.elevation_leaves() {
        let Some((tile, posts)) = heights_of(world, tiles, leaf.node) else { continue };
        for color in &drawn.color_leaves()[leaf.first_color_leaf as usize..leaf.end_color_leaf as usize] {
            let is_fine = is_as_wanted(tree, color);
            let samples = if is_fine { SAMPLES } else { COARSE_SAMPLES };
            let area: f64 = eyes.clone().map(|view| view.area_px(color.node, tile, posts, samples)).sum();
            all += area;
            fine += if is_fine { area } else { 0.0 };
        }
    }
    if all > 0.0 { fine / all } else { 1.0 }
}

/// Whether this is a leaf of the full tree.
fn is_as_wanted(tree: &FrameTree, leaf: &ColorLeaf) -> bool {
    tree.nodes[leaf.index()].children().is_empty()
}

/// The elevation tile of a node, or of its nearest ancestor that has one.
fn heights_of<'t>(world: &World, tiles: &'t impl Tiles, node: NodeId) -> Option<(NodeId, &'t [f32])> {
    let posts = (world.elevation_posts() as usize).pow(2);
    (node.q()..world.levels()).map(|q| world.surface().ancestor(node, q)).find_map(|above| {
        let heights = tiles.elevation(above)?.get(..posts)?;
        Some((above, heights))
    })
}

struct View<'a> {
    world: &'a World,
    camera: &'a Camera,
    exaggeration: f64,
    axes: [DVec3; 3],
}

impl View<'_> {
    /// The area on screen of a node's ground with these heights, from `n` times `n` samples.
    fn area_px(&self, node: NodeId, tile: NodeId, posts: &[f32], n: u32) -> f64 {
        let surface = self.world.surface();
        let frame = surface.seen_by(self.camera.eye(), self.axes[2]);
        let (cells, row) = (self.world.elevation_tile(), self.world.elevation_posts() as usize);
        let focal = self.camera.focal_px();
        let plane = self.camera.picture_plane();
        let ([tan_x, tan_y], middle) = (plane.half(), plane.middle_x());
        let [right, up, forward] = self.axes;
        let mut sum = 0.0;
        for k in 0..n * n {
            let share = (DVec2::new(f64::from(k % n), f64::from(k / n)) + 0.5) / f64::from(n);
            let Some((foot, area_m2)) = surface.foot_in_node(node, share) else { continue };
            // The post to the south west is close enough.
            let place = surface.place_in_node(foot, tile);
            let [i, j] = [place.x, place.y].map(|v| CellPosition::within(v, cells).cell as usize);
            let height = posts.get(j * row + i).copied().unwrap_or(0.0);
            let point = surface.position(foot, self.exaggeration * f64::from(height));
            let to_point = frame.way_to(point);
            let depth = to_point.dot(forward);
            let (across, above) = (to_point.dot(right) - middle * depth, to_point.dot(up));
            let is_seen = depth > 0.0 && across.abs() <= tan_x * depth && above.abs() <= tan_y * depth;
            if is_seen {
                // A step on level ground covers f²·A·|dz| / depth³ pixels.
                let rise = frame.rise_of(point, to_point).abs().max(LEAST_SLANT * to_point.length());
                sum += area_m2 * rise / depth.powi(3);
            }
        }
        sum * (focal / f64::from(n)).powi(2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use terravision_common::camera::CameraFields;
    use terravision_testkit::worlds;

    #[test]
    fn level_ground_straight_below_fills_the_picture() {
        let world = worlds::world([64; 2], 10.0, [4, 64]);
        // 90 degrees up and down, from 300 m above 100 m: 400 m of ground, 40 lattice units.
        let camera = Camera::new(CameraFields {
            eye_in_world: [320.0, 320.0, 300.0],
            heading_rad: 0.0,
            pitch_rad: -std::f64::consts::FRAC_PI_2,
            roll_rad: 0.0,
            vfov_rad: std::f64::consts::FRAC_PI_2,
            width: 100,
            height: 100,
            timestamp_nanos: 0,
        })
        .expect("valid");
        let view = View { world: &world, camera: &camera, exaggeration: 2.0, axes: camera.axes_in_world() };
        let area = |node, n| view.area_px(node, world.root(), &[50.0; 25], n);
        let whole = area(world.root(), 64);
        assert!((whole - 10_000.0).abs() < 800.0, "{whole}");
        let parts: f64 = world.children(world.root()).map(|child| area(child, 32)).sum();
        assert!((whole - parts).abs() < 1e-6, "{whole} {parts}");
    }
}
