//! The geometry of a terrain database: nodes, elevation posts and colour texels, and where they lie
//! on its surface.
//!
//! Inside the system positions are **world coordinates**: metres east and north of the world's
//! origin (its south west elevation post), and height in metres; [`crate::surface`] makes them. The
//! origin's easting and northing are added only at the edges ([`World::crs_frame`]).
//!
//! ```text
//!        elevation posts sit on the corners          colour texels are cells
//!        of the lattice, borders shared              between them
//!
//!     n  o---o---o---o---o      one node,            +---+---+---+---+
//!     o  |   |   |   |   |      Nz = 4 intervals     | . | . | . | . |
//!     r  o---o---o---o---o      (5 posts a side)     +---+---+---+---+
//!     t  |   |   |   |   |                           | . | . | . | . |
//!     h  o---o---o---o---o      Nc = 4 texels        +---+---+---+---+
//!        ^ lower left corner = the node's origin
//! ```
//!
//! The **lattice** is the set of elevation posts that level 0 has or would have; its unit is
//! `b/Nz`. Every vertex that is ever drawn is a lattice point, so positions along an edge that two
//! leaves share are equal as integers.

mod body;

pub use body::BodyGrid;

use crate::node::{MAX_LEVEL, NodeId};
use crate::surface::globe::Globe;
use crate::surface::{CrsFrame, Plane, Surface};
use glam::DVec2;
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// Geometry of a terrain database: where its nodes, posts and texels are. Valid by construction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "WorldFields", into = "WorldFields")]
pub struct World {
    fields: WorldFields,
    /// Not part of [`WorldFields`], because it is not geometry: the manifest has it as a feature of
    /// the database.
    has_validity: bool,
    /// Likewise.
    has_holes: bool,
    /// The finest level of which, and of all coarser ones, every node has its tiles.
    complete_level: u8,
    /// Made of the fields.
    surface: Surface,
}

/// The unchecked numbers of a [`World`], as in the manifest.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorldFields {
    /// Easting and northing (metres, in the database's CRS) of the south west elevation post. Of a
    /// body: longitude of column 0, and -90, degrees.
    pub origin: [f64; 2],
    /// Distance of two lattice points, metres: `b/Nz`. Of a body: [`Globe::unit_m`].
    pub lattice_unit_m: f64,
    /// Extent east and north of the origin, lattice units. Terrain is defined on the closed
    /// rectangle. Of a body: columns around, and rows from pole to pole.
    pub extent: [u32; 2],
    /// Nz: intervals along the side of an elevation tile (it has Nz + 1 posts). A power of two.
    pub elevation_tile: u32,
    /// Nc: texels along the side of a colour tile, without its border. A power of two.
    pub color_tile: u32,
    /// Levels of the quad tree; the root is at level `levels - 1`.
    pub levels: u8,
    /// The finest level that has elevation tiles (0 unless colour is much finer than elevation).
    pub finest_elevation_level: u8,
    /// The finest level that has colour tiles.
    pub finest_color_level: u8,
    /// Where the lattice lies on a whole body; absent of a plane.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub body: Option<BodyGrid>,
}

/// Why numbers are not a valid [`World`].
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum WorldError {
    /// One number is out of its range.
    #[error("{field} is {found}, expected {expected}")]
    OutOfRange {
        /// The manifest's name of the number.
        field: &'static str,
        /// What was found.
        found: f64,
        /// What was expected, in words.
        expected: &'static str,
    },
}

/// Border of a stored colour tile, texels on each side: keeps bilinear taps of the first three mip
/// levels (borders of 4, 2 and 1 texel) inside the tile, so that no seam shows between neighbours.
pub const COLOR_BORDER: u32 = 4;
/// Mip levels of a colour tile in the pool: the borders allow no more, and conservative levels need
/// no more.
pub const COLOR_MIPS: u32 = 3;

impl World {
    /// Checks the numbers.
    ///
    /// # Errors
    /// [`WorldError::OutOfRange`] for the first number that is wrong.
    pub fn new(fields: WorldFields) -> Result<Self, WorldError> {
        let fail = |field, found, expected| Err(WorldError::OutOfRange { field, found, expected });
        let f = &fields;
        if !f.origin.iter().all(|v| v.is_finite() && v.abs() < 1e12) {
            return fail("origin", f.origin[0], "two finite coordinates");
        }
        if !(f.lattice_unit_m.is_finite() && f.lattice_unit_m > 1e-6 && f.lattice_unit_m < 1e6) {
            return fail("lattice_unit_m", f.lattice_unit_m, "a length between 1e-6 and 1e6 metres");
        }
        if !(f.elevation_tile.is_power_of_two() && (2..=256).contains(&f.elevation_tile)) {
            return fail("elevation_tile", f64::from(f.elevation_tile), "a power of two from 2 to 256");
        }
        if !(f.color_tile.is_power_of_two() && (16..=1024).contains(&f.color_tile)) {
            return fail("color_tile", f64::from(f.color_tile), "a power of two from 16 to 1024");
        }
        let longer = u64::from(f.extent[0].max(f.extent[1]));
        if f.extent[0] == 0 || f.extent[1] == 0 || longer > 1 << 28 {
            return fail("extent", longer as f64, "1 to 2^28 lattice units along each side");
        }
        let globe = f.body.as_ref().map(|grid| body::globe_of(f, grid)).transpose()?;
        let covers = |levels: u8| globe.is_some() || u64::from(f.elevation_tile) << (levels - 1) >= longer;
        if f.levels == 0 || f.levels > MAX_LEVEL + 1 || !covers(f.levels) {
            return fail("levels", f64::from(f.levels), "enough levels for the root to cover the extent, at most 25");
        }
        if f.finest_elevation_level >= f.levels {
            return fail("finest_elevation_level", f64::from(f.finest_elevation_level), "a level of the tree");
        }
        if f.finest_color_level >= f.levels {
            return fail("finest_color_level", f64::from(f.finest_color_level), "a level of the tree");
        }
        if 1u64 << f.finest_elevation_level.saturating_sub(f.finest_color_level) > u64::from(f.elevation_tile) {
            return fail(
                "finest_elevation_level",
                f64::from(f.finest_elevation_level),
                "at most log2(elevation_tile) levels above the finest colour level",
            );
        }
        let plane = Plane::new(fields.lattice_unit_m, fields.extent, fields.elevation_tile);
        let surface = globe.map_or(Surface::Plane(plane), Surface::Globe);
        Ok(Self { fields, has_validity: false, has_holes: false, complete_level: 0, surface })
    }

    /// The same world with planes of validity beside its heights ([`crate::validity`]);
    /// `has_holes`: some of it is not ground.
    #[must_use]
    pub fn with_validity(self, has_holes: bool) -> Self {
        Self { has_validity: true, has_holes, ..self }
    }

    /// Whether there are holes in its extent, through which rays see the rest from below.
    #[must_use]
    pub fn has_holes(&self) -> bool {
        self.has_holes
    }

    /// Whether elevation tiles and arrays have planes of validity beside heights, because some
    /// posts have no data.
    #[must_use]
    pub fn has_validity(&self) -> bool {
        self.has_validity
    }

    /// Planes of `(Nz + 1)²` numbers that an elevation tile or array has: heights alone, or heights
    /// and validity.
    #[must_use]
    pub fn elevation_planes(&self) -> usize {
        if self.has_validity { crate::validity::PLANES } else { 1 }
    }

    /// Numbers that an elevation tile or array has, all planes together.
    #[must_use]
    pub fn elevation_values(&self) -> usize {
        self.elevation_planes() * (self.elevation_posts() as usize).pow(2)
    }

    /// The same world with sparse levels: only at level `q` and above every node has its tiles.
    #[must_use]
    pub fn with_complete_level(self, q: u8) -> Self {
        Self { complete_level: q.min(self.fields.levels - 1), ..self }
    }

    /// The finest level from which on every node has its tiles; 0 for a world without sparse
    /// levels. [`crate::database::NodeRanges`] has the nodes of finer levels that exist.
    #[must_use]
    pub fn complete_level(&self) -> u8 {
        self.complete_level
    }

    /// The numbers it is made of.
    #[must_use]
    pub fn fields(&self) -> &WorldFields {
        &self.fields
    }

    /// The body that it is, if it is not a plane.
    #[must_use]
    pub const fn globe(&self) -> Option<&Globe> {
        match &self.surface {
            Surface::Globe(globe) => Some(globe),
            Surface::Plane(_) => None,
        }
    }

    /// Where its ground lies in space.
    #[inline]
    #[must_use]
    pub const fn surface(&self) -> &Surface {
        &self.surface
    }

    /// Its plane, for what draws planes alone; of a body, a plane of its lattice's size.
    #[inline]
    #[must_use]
    pub const fn plane(&self) -> Plane {
        Plane::new(self.fields.lattice_unit_m, self.fields.extent, self.fields.elevation_tile)
    }

    /// Where it lies in the database's CRS: places of a body are longitude and latitude in degrees.
    #[inline]
    #[must_use]
    pub const fn crs_frame(&self) -> CrsFrame {
        CrsFrame::new(if self.fields.body.is_some() { [0.0; 2] } else { self.fields.origin })
    }

    /// South west and north east corner in the database's CRS.
    #[must_use]
    pub fn crs_bounds(&self) -> [DVec2; 2] {
        if let Some(body) = &self.fields.body {
            return [DVec2::new(body.west_deg, -90.0), DVec2::new(body.west_deg + 360.0, 90.0)];
        }
        [DVec2::ZERO, self.plane().end()].map(|foot| self.crs_frame().place_of_foot(foot))
    }

    /// The middle in the database's CRS.
    #[must_use]
    pub fn crs_middle(&self) -> DVec2 {
        let [low, high] = self.crs_bounds();
        if self.globe().is_some() {
            0.5 * (low + high)
        } else {
            self.crs_frame().place_of_foot(0.5 * self.plane().end())
        }
    }

    /// Distance of two lattice points, metres.
    #[must_use]
    pub fn lattice_unit_m(&self) -> f64 {
        self.fields.lattice_unit_m
    }

    /// Extent in lattice units, east and north.
    #[must_use]
    pub fn extent(&self) -> [u32; 2] {
        self.fields.extent
    }

    /// Extent in metres, east and north; of a body, around its equator and from pole to pole.
    #[must_use]
    pub fn extent_m(&self) -> [f64; 2] {
        match &self.surface {
            Surface::Plane(plane) => plane.end().to_array(),
            Surface::Globe(globe) => [TAU, PI].map(|angle| angle * globe.body().semi_major_m()),
        }
    }

    /// Nz, intervals along an elevation tile's side.
    #[must_use]
    pub fn elevation_tile(&self) -> u32 {
        self.fields.elevation_tile
    }

    /// Posts along an elevation tile's side: Nz + 1.
    #[must_use]
    pub fn elevation_posts(&self) -> u32 {
        self.fields.elevation_tile + 1
    }

    /// Nc, texels along a colour tile's side, without border.
    #[must_use]
    pub fn color_tile(&self) -> u32 {
        self.fields.color_tile
    }

    /// Texels along a stored colour tile's side, borders included.
    #[must_use]
    pub fn color_stored(&self) -> u32 {
        self.fields.color_tile + 2 * COLOR_BORDER
    }

    /// Levels of the quad tree.
    #[must_use]
    pub fn levels(&self) -> u8 {
        self.fields.levels
    }

    /// The root node: of a body the crown, which has no tiles itself, above the nodes of its coarsest
    /// level.
    #[must_use]
    pub fn root(&self) -> NodeId {
        match &self.surface {
            Surface::Plane(_) => NodeId::root(self.fields.levels),
            Surface::Globe(globe) => globe.lattice().crown(),
        }
    }

    /// Whether a node is of the coarsest level, without whose tiles there is no picture.
    #[must_use]
    pub fn is_root(&self, node: NodeId) -> bool {
        node.q() == self.coarsest_level()
    }

    /// Whether a node is the one above all that have tiles.
    #[must_use]
    pub fn is_crown(&self, node: NodeId) -> bool {
        self.globe().is_some() && node == self.root()
    }

    /// The coarsest level that has tiles.
    #[must_use]
    pub fn coarsest_level(&self) -> u8 {
        self.fields.levels - 1
    }

    /// Finest level with elevation tiles.
    #[must_use]
    pub fn finest_elevation_level(&self) -> u8 {
        self.fields.finest_elevation_level
    }

    /// Finest level with colour tiles.
    #[must_use]
    pub fn finest_color_level(&self) -> u8 {
        self.fields.finest_color_level
    }

    /// Side of a node of level `q`, lattice units of a plane.
    #[must_use]
    pub fn node_side(&self, q: u8) -> u64 {
        self.plane().node_side(q)
    }

    /// Side of a node of level `q`, metres: `b·2^q`.
    #[must_use]
    pub fn node_side_m(&self, q: u8) -> f64 {
        self.plane().node_side_m(q)
    }

    /// Lower left corner of a node, lattice units.
    #[must_use]
    pub fn node_origin(&self, node: NodeId) -> [u64; 2] {
        self.surface().node_origin(node)
    }

    /// Number of columns and rows of nodes that overlap the extent at level `q`. Of a body: the most
    /// columns that a row has, and numbers of rows, of which some do not exist.
    #[must_use]
    pub fn nodes_at(&self, q: u8) -> [u32; 2] {
        match &self.surface {
            Surface::Globe(globe) => body::nodes_at(globe.lattice(), q),
            Surface::Plane(plane) => plane.nodes_at(q),
        }
    }

    /// Number of nodes of row `n` of level `q`; none where the row does not exist.
    #[must_use]
    pub fn columns_of_row(&self, q: u8, n: u32) -> u32 {
        match self.globe() {
            Some(globe) => body::columns_of_row(globe.lattice(), q, n),
            None => {
                let [columns, rows] = self.nodes_at(q);
                if n < rows { columns } else { 0 }
            }
        }
    }

    /// Number of nodes of level `q`.
    #[must_use]
    pub fn node_count(&self, q: u8) -> u64 {
        match self.globe() {
            Some(_) => (0..self.nodes_at(q)[1]).map(|n| u64::from(self.columns_of_row(q, n))).sum(),
            None => self.nodes_at(q).map(u64::from).iter().product(),
        }
    }

    /// The nodes of the coarsest level: one of a plane, two rows of a body.
    pub fn roots(&self) -> impl Iterator<Item = NodeId> + use<> {
        let plane = self.globe().is_none().then(|| self.root());
        plane.into_iter().chain(self.globe().copied().into_iter().flat_map(|globe| globe.lattice().roots()))
    }

    /// The children of a node, those that there are: from the west, the southern row first.
    pub fn children(&self, node: NodeId) -> impl Iterator<Item = NodeId> + use<> {
        let world = *self;
        self.surface.children(node).iter().filter(move |child| world.contains(*child))
    }

    /// The node of the next coarser level that has this one as a child; `None` for a root.
    #[must_use]
    pub fn parent(&self, node: NodeId) -> Option<NodeId> {
        match self.globe() {
            Some(globe) => globe.lattice().parent(node),
            None => (node.q() + 1 < self.fields.levels).then(|| node.parent()),
        }
    }

    /// The node of level `q` above a node, or the node itself; `None` when `q` is not a level of it
    /// or above.
    #[must_use]
    pub fn ancestor(&self, node: NodeId, q: u8) -> Option<NodeId> {
        let above = q.checked_sub(node.q())?;
        (0..above).try_fold(node, |node, _| self.parent(node))
    }

    /// Whether any of the node lies inside the extent (and it is of this tree). Other nodes do not
    /// exist.
    #[must_use]
    pub fn contains(&self, node: NodeId) -> bool {
        match &self.surface {
            Surface::Globe(globe) => globe.lattice().contains(node),
            Surface::Plane(plane) => {
                node.q() < self.fields.levels && {
                    let [columns, rows] = plane.nodes_at(node.q());
                    node.m() < columns && node.n() < rows
                }
            }
        }
    }

    /// The nodes across the west, east, south or north edge of a node that exist
    /// ([`Surface::across`]).
    #[inline]
    pub fn across(&self, node: NodeId, side: usize) -> impl Iterator<Item = NodeId> {
        self.surface.across(node, side).into_iter().flatten().filter(|id| self.contains(*id))
    }

    /// The node of the same level `east` columns and `north` rows away, when it exists; of a plane.
    #[must_use]
    pub fn neighbor(&self, node: NodeId, east: i32, north: i32) -> Option<NodeId> {
        self.plane().neighbor(node, east, north).filter(|id| self.contains(*id))
    }

    /// Whether the database has a place for an elevation tile of this node.
    #[must_use]
    pub fn has_elevation(&self, node: NodeId) -> bool {
        node.q() >= self.fields.finest_elevation_level && self.contains(node)
    }

    /// Whether the database has a place for a colour tile of this node.
    #[must_use]
    pub fn has_color(&self, node: NodeId) -> bool {
        node.q() >= self.fields.finest_color_level && self.contains(node)
    }

    /// Spacing of elevation posts at level `q`, metres: `s_z(q)`.
    #[must_use]
    pub fn elevation_spacing_m(&self, q: u8) -> f64 {
        self.surface().spacing_m(q)
    }

    /// Spacing of colour texels at level `q`, metres: `s_c(q)`.
    #[must_use]
    pub fn color_spacing_m(&self, q: u8) -> f64 {
        self.elevation_spacing_m(q) * f64::from(self.fields.elevation_tile) / f64::from(self.fields.color_tile)
    }

    /// `l_z(q) - l_c(q) = log2(Nc/Nz)`: how many sampling levels elevation is coarser than colour
    /// in one node.
    #[must_use]
    pub fn elevation_over_color_levels(&self) -> i32 {
        self.fields.color_tile.ilog2().cast_signed() - self.fields.elevation_tile.ilog2().cast_signed()
    }
}

impl TryFrom<WorldFields> for World {
    type Error = WorldError;
    fn try_from(fields: WorldFields) -> Result<Self, WorldError> {
        Self::new(fields)
    }
}

impl From<World> for WorldFields {
    fn from(world: World) -> Self {
        world.fields
    }
}
