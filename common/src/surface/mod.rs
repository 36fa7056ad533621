//! Geometry of the ground in space. All geometry is in this module.
//!
//! Other code identifies ground by integers (nodes, lattice points) or by a *foot*, a point of the
//! surface without a height, and asks this module for everything else. No other code combines a
//! height with an x and a y, compares an eye with the borders of the world, or computes the
//! neighbour of a node (`tests/tests/geometry.rs` checks the sources for that).
//!
//! | question | asked of |
//! |---|---|
//! | one name for each lattice point | [`Plane::canonical`], [`Plane::posts`] |
//! | the node beside another one, its corner, its cells inside the world | [`Plane::neighbor`], [`Plane::node_origin`], [`Plane::cells_inside`] |
//! | the position of a lattice point with a height | [`Plane::vertex`], of a [`Plane::column`] and a [`Plane::row`] |
//! | the position over a foot, and the way back | [`Plane::position`], [`Plane::foot`], [`Plane::height_m`], [`Plane::up`] |
//! | whether an eye is over the world | [`Plane::is_over`] |
//! | what space a node may fill | [`Plane::node_bounds`] |
//! | which child is nearest to the eye | [`Plane::near_to_far`] |
//! | distances, depth and slant from an eye; vertices relative to it | [`EyeFrame`], [`Vertices`] |
//! | directions in the local frame of a place | [`direction()`], [`heading`], [`pitch`] |
//! | places in the database's CRS | [`CrsFrame`] |
//! | the height between the posts of a tile | [`facet`], [`tile`] |
//!
//! [`Surface`] is a plane, metres east and north of the world's origin, and height up; or a body,
//! longitude and latitude in degrees, and height above its ellipsoid. It has the answers of either,
//! under the same names. Positions on an ellipsoid are not sums, so callers keep the terms separate: **a vertex is made of its column, its
//! row and its height**, each looked up or interpolated on its own. Everything is inlined and
//! statically typed: the abstraction costs nothing.
//!
//! [`globe`] has the ellipsoid's side of it: lattice and nodes around a body, positions, vertices
//! relative to an eye, what a node may fill.
//!
//! Invariant: a vertex's position depends only on its canonical lattice point, its height and the
//! eye, so that edges that two leaves share are equal to the bit.

mod any;
mod bounds;
mod device;
mod direction;
pub mod facet;
mod frame;
pub mod globe;
mod lattice_point;
mod plane;
mod post_line;
mod sight;
pub mod tile;
mod vertices;

pub use any::{Across, Children, Column, Columns, MOST_CHILDREN, NodeBounds, Row, Surface};
pub use bounds::WorldBox;
pub use device::{BlockFault, DeviceEye, DrawnBlock};
pub use direction::{direction, heading, level_right, look, pitch};
pub use frame::{EyeBox, EyeFrame};
pub use lattice_point::{LatticePoint, SIDES};
pub use plane::{CrsFrame, EyeCell, Plane, PlaneFrame, PlaneRow};
pub use post_line::PostLine;
pub use sight::Sight;
pub use vertices::{VertexTerms, Vertices};
