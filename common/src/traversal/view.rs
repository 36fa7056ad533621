//! Visibility of nodes: bounding boxes and the view frustum.

use crate::camera::Camera;
use crate::database::{Layer, NodeRanges};
use crate::node::NodeId;
use crate::surface::{EyeBox, NodeBounds};
use crate::world::World;
use glam::DVec3;

/// Lowest and highest ground under nodes, metres, at any level of detail.
pub trait HeightRanges {
    /// The range of a node, `None` when the node does not exist.
    fn range(&self, node: NodeId) -> Option<[f32; 2]>;

    /// Whether the children of a node have tiles of a layer: all existing ones, or none. Only
    /// called for layers and levels of which the world has tiles; without sparse levels, they
    /// always have.
    fn has_children(&self, layer: Layer, node: NodeId) -> bool {
        let _ = (layer, node);
        true
    }
}

impl HeightRanges for NodeRanges {
    fn range(&self, node: NodeId) -> Option<[f32; 2]> {
        NodeRanges::range(self, node)
    }

    fn has_children(&self, layer: Layer, node: NodeId) -> bool {
        NodeRanges::has_children(self, layer, node)
    }
}

impl<R: HeightRanges + ?Sized> HeightRanges for &R {
    fn range(&self, node: NodeId) -> Option<[f32; 2]> {
        (**self).range(node)
    }

    fn has_children(&self, layer: Layer, node: NodeId) -> bool {
        (**self).has_children(layer, node)
    }
}

/// Box of a node, clipped to the extent, heights exaggerated; `None` when the node does not exist.
#[must_use]
pub fn node_box(world: &World, ranges: &impl HeightRanges, exaggeration: f64, node: NodeId) -> Option<NodeBounds> {
    if world.is_crown(node) {
        return Some(NodeBounds::Everywhere);
    }
    if !world.contains(node) {
        return None;
    }
    let heights = ranges.range(node)?.map(|z| exaggeration * f64::from(z));
    Some(world.surface().node_bounds(node, heights))
}

/// Boxes up to this far outside of the frustum, metres, count as inside, because planes are
/// rounded.
const TOLERANCE_M: f64 = 1e-5;

/// A unit vector up to this far on the wrong side of a plane through the eye counts as in the
/// plane.
const ROUNDING: f64 = 1e-12;

/// Maximum number of planes: 5 of the sides and the eye, 3 of the box's axes, and 2 silhouettes
/// along each axis.
const MAX_NORMALS: usize = 14;

/// The view frustum, an infinite pyramid, as half spaces that contain it; including those that
/// separate boxes from it.
///
/// The pyramid's own planes alone would not reject boxes beside it that are larger than the pyramid
/// is wide. By the separating axis theorem, a box and the pyramid are disjoint exactly when one of
/// these planes separates them: the planes of the pyramid, those of the box, and those along an
/// edge of each; all of them pass through the eye.
#[derive(Debug, Clone, Copy)]
pub struct Frustum {
    normals: [DVec3; MAX_NORMALS],
    normal_count: usize,
}

impl Frustum {
    /// The frustum of a valid camera.
    #[must_use]
    pub fn new(camera: &Camera) -> Self {
        let mut frustum = Self { normals: [DVec3::ZERO; MAX_NORMALS], normal_count: 0 };
        for normal in camera.frustum_normals_in_world() {
            frustum.push(normal);
        }
        frustum.push(camera.axes_in_world()[2]);
        let (width, height) = (f64::from(camera.width()), f64::from(camera.height()));
        let edges = [(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)]
            .map(|(x, y)| camera.ray_in_world(x, y).normalize());
        // Keep the normals that have the whole pyramid on their side.
        let holds_all = |normal: &DVec3| edges.iter().all(|edge| normal.dot(*edge) >= -ROUNDING);
        for axis in DVec3::AXES {
            // An axis that is nearly parallel to an edge of the pyramid has no plane along both.
            let along_edges = edges.iter().filter_map(|edge| edge.cross(axis).try_normalize());
            for normal in along_edges.chain([axis]).flat_map(|normal| [normal, -normal]).filter(holds_all) {
                frustum.push(normal);
            }
        }
        frustum
    }

    /// Omitting a plane only makes the test less precise.
    fn push(&mut self, normal: DVec3) {
        if let Some(place) = self.normals.get_mut(self.normal_count) {
            *place = normal;
            self.normal_count += 1;
        }
    }

    /// Whether any part of the box, relative to the camera's eye, is inside, or so close that rounding
    /// decides.
    #[must_use]
    pub fn may_see(&self, bounds: &EyeBox) -> bool {
        // The corner that is farthest along the normal is inside the plane.
        self.normals[..self.normal_count].iter().all(|normal| bounds.most_along(*normal) >= -TOLERANCE_M)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::CameraFields;
    use crate::surface::WorldBox;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_box_with_a_visible_point_is_never_culled(
            eye in prop::array::uniform3(-1e5f64..1e5),
            angles in prop::array::uniform3(-3.2f64..3.2),
            vfov_rad in 0.05f64..2.8,
            picture in prop::array::uniform2(0.0f64..=1.0),
            log_depth in -3.0f64..20.0,
            log_size in prop::array::uniform3(-8.0f64..20.0),
            inside in prop::array::uniform3(0.0f64..=1.0),
        ) {
            let camera = Camera::new(CameraFields {
                eye_in_world: eye, heading_rad: angles[0], pitch_rad: angles[1], roll_rad: angles[2],
                vfov_rad, width: 1280, height: 720, timestamp_nanos: 0,
            }).expect("valid");
            let visible = camera.eye() + camera.ray_in_world(picture[0] * 1280.0, picture[1] * 720.0) * log_depth.exp2();
            let size = DVec3::from_array(log_size.map(f64::exp2));
            let min = visible - size * DVec3::from_array(inside);
            let bounds = WorldBox { min, max: min + size };
            prop_assert!(Frustum::new(&camera).may_see(&EyeBox::Aligned(bounds.seen_from(camera.eye()))));
        }
    }

    #[test]
    fn boxes_beside_and_behind_are_culled() {
        let camera = Camera::new(CameraFields {
            eye_in_world: [0.0; 3],
            heading_rad: 0.0,
            pitch_rad: 0.0,
            roll_rad: 0.0,
            vfov_rad: 1.0,
            width: 100,
            height: 100,
            timestamp_nanos: 0,
        })
        .expect("valid");
        let frustum = Frustum::new(&camera);
        let sees = |bounds: &WorldBox| frustum.may_see(&EyeBox::Aligned(*bounds));
        let at = |x, y, z| WorldBox { min: DVec3::new(x, y, z) - 1.0, max: DVec3::new(x, y, z) + 1.0 };
        assert!(sees(&at(0.0, 50.0, 0.0)));
        for hidden in [at(0.0, -50.0, 0.0), at(50.0, 50.0, 0.0), at(-50.0, 50.0, 0.0), at(0.0, 50.0, 50.0)] {
            assert!(!sees(&hidden));
        }
        // Wide, far behind: no side plane has all of it outside, the plane of the eye has.
        let behind = WorldBox { min: DVec3::new(-1e4, -1e4, -1e4), max: DVec3::new(1e4, -1e3, 1e4) };
        assert!(!sees(&behind));
    }

    #[test]
    fn a_large_box_beside_a_narrow_view_is_culled() {
        let camera = Camera::new(CameraFields {
            eye_in_world: [0.0, 0.0, 500.0],
            heading_rad: 0.3,
            pitch_rad: -1.2,
            roll_rad: 0.1,
            vfov_rad: 0.1,
            width: 100,
            height: 100,
            timestamp_nanos: 0,
        })
        .expect("valid");
        let frustum = Frustum::new(&camera);
        let sees = |bounds: &WorldBox| frustum.may_see(&EyeBox::Aligned(bounds.seen_from(camera.eye())));
        // The view goes below the ground some 200 m away; no plane of it has all of these boxes
        // outside.
        let ground = |min: [f64; 2], max: [f64; 2]| WorldBox {
            min: DVec3::new(min[0], min[1], 0.0),
            max: DVec3::new(max[0], max[1], 100.0),
        };
        assert!(sees(&ground([0.0, 0.0], [1e4, 1e4])));
        assert!(!sees(&ground([0.0, 300.0], [1e4, 1e4])));
        assert!(!sees(&ground([-1e4, 400.0], [1e4, 1e5])));
    }
}
