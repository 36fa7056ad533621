//! Which tile is at a point: a quad tree of the tiles, with the highest ground of each of its
//! nodes.

/// The target of a link of the tree.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Link {
    /// Nothing.
    Empty,
    /// The tile of this index.
    Tile(u32),
    /// The node of this index.
    Node(u32),
}

/// An inner node.
#[derive(Debug, Clone, Copy)]
pub struct Node {
    /// South west, south east, north west, north east.
    pub children: [Link; 4],
    /// Highest ground below it, metres above the datum.
    pub highest_m: f32,
}

/// Where a descent ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Found {
    /// In a tile.
    Tile(u32),
    /// In a square without tiles: its lower left corner and log2 of its side, lattice units.
    Hole([u32; 2], u32),
    /// Outside of the root.
    Outside,
}

/// The tree. Level 0 nodes have sides of `2^log_side` lattice units.
#[derive(Debug, Default)]
pub struct Tree {
    nodes: Vec<Node>,
    root: Option<Link>,
    log_side: u32,
    root_level: u32,
}

/// There is a tile already: at the same node, below it or above it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Occupied;

impl Tree {
    /// Removes all tiles. The root is a node of `root_level`.
    pub fn clear(&mut self, log_side: u32, root_level: u32) {
        self.nodes.clear();
        self.root = None;
        self.log_side = log_side;
        self.root_level = root_level;
    }

    /// The root.
    #[inline]
    #[must_use]
    pub fn root(&self) -> Link {
        self.root.unwrap_or(Link::Empty)
    }

    #[inline]
    pub(crate) fn root_level(&self) -> u32 {
        self.root_level
    }

    #[inline]
    pub(crate) fn log_side(&self) -> u32 {
        self.log_side
    }

    #[inline]
    pub(crate) fn node(&self, index: u32) -> &Node {
        &self.nodes[index as usize]
    }

    /// The child of a node that holds a point, of side `2^log`.
    #[inline]
    pub(crate) fn child(&self, node: u32, point: [u32; 2], log: u32) -> Link {
        self.node(node).children[child(point, log)]
    }

    /// All nodes; [`Link::Node`] has their indices.
    #[must_use]
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// Inserts a tile of `level` at its origin, lattice units; `highest_m`: its highest ground.
    ///
    /// # Errors
    /// It covers another one.
    pub fn insert(&mut self, origin: [u32; 2], level: u32, tile: u32, highest_m: f32) -> Result<(), Occupied> {
        let mut place: Option<(usize, usize)> = None;
        let mut at = self.root_level;
        loop {
            let link = match place {
                None => self.root.unwrap_or(Link::Empty),
                Some((node, child)) => self.nodes[node].children[child],
            };
            if at == level {
                if link != Link::Empty {
                    return Err(Occupied);
                }
                self.set(place, Link::Tile(tile));
                return Ok(());
            }
            let node = match link {
                Link::Tile(_) => return Err(Occupied),
                Link::Node(node) => node as usize,
                Link::Empty => {
                    self.nodes.push(Node { children: [Link::Empty; 4], highest_m: f32::NEG_INFINITY });
                    let node = self.nodes.len() - 1;
                    self.set(place, Link::Node(node as u32));
                    node
                }
            };
            self.nodes[node].highest_m = self.nodes[node].highest_m.max(highest_m);
            at -= 1;
            place = Some((node, child(origin, self.log_side + at)));
        }
    }

    fn set(&mut self, place: Option<(usize, usize)>, link: Link) {
        match place {
            None => self.root = Some(link),
            Some((node, child)) => self.nodes[node].children[child] = link,
        }
    }

    /// Upper bound of the height of the ground in a rectangle, lattice units; `top` gives that of a
    /// tile.
    pub(crate) fn highest_in(&self, low: [f64; 2], high: [f64; 2], top: &impl Fn(u32) -> f32) -> f32 {
        let log = self.log_side + self.root_level;
        let mut highest = f32::NEG_INFINITY;
        self.raise(self.root(), [0.0; 2], log, &[low, high], top, &mut highest);
        highest
    }

    fn raise(
        &self,
        link: Link,
        corner: [f64; 2],
        log: u32,
        rectangle: &[[f64; 2]; 2],
        top: &impl Fn(u32) -> f32,
        highest: &mut f32,
    ) {
        let side = (1u64 << log) as f64;
        let [low, high] = rectangle;
        if (0..2).any(|axis| high[axis] < corner[axis] || low[axis] > corner[axis] + side) {
            return;
        }
        match link {
            Link::Empty => {}
            Link::Tile(tile) => *highest = highest.max(top(tile)),
            Link::Node(node) if self.node(node).highest_m <= *highest => {}
            Link::Node(node) => {
                for (n, child) in self.node(node).children.into_iter().enumerate() {
                    let by = |bit: usize| if n & bit == 0 { 0.0 } else { 0.5 * side };
                    self.raise(child, [corner[0] + by(1), corner[1] + by(2)], log - 1, rectangle, top, highest);
                }
            }
        }
    }

    /// The tile at a point, lattice units.
    #[inline]
    pub(crate) fn find(&self, point: [f64; 2]) -> Found {
        let side = (1u64 << (self.log_side + self.root_level)) as f64;
        if !point.iter().all(|v| (0.0..side).contains(v)) {
            return Found::Outside;
        }
        let point = point.map(|v| v as u32);
        let mut link = self.root();
        let mut log = self.log_side + self.root_level;
        loop {
            match link {
                Link::Tile(tile) => return Found::Tile(tile),
                Link::Empty => return Found::Hole(point.map(|v| (v >> log) << log), log),
                Link::Node(node) => {
                    log -= 1;
                    link = self.nodes[node as usize].children[child(point, log)];
                }
            }
        }
    }
}

/// The index, within its parent, of the node of side `2^log` that contains a point.
#[inline(always)]
fn child(point: [u32; 2], log: u32) -> usize {
    ((point[0] >> log) & 1 | ((point[1] >> log) & 1) << 1) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_of_several_levels_are_found_and_holes_have_their_size() {
        let mut tree = Tree::default();
        tree.clear(4, 2);
        tree.insert([0, 0], 1, 7, 5.0).unwrap();
        tree.insert([48, 32], 0, 8, 9.0).unwrap();
        assert_eq!(tree.insert([16, 0], 0, 9, 1.0), Err(Occupied));
        assert_eq!(tree.insert([32, 32], 1, 9, 1.0), Err(Occupied));
        assert_eq!(tree.find([31.9, 0.0]), Found::Tile(7));
        assert_eq!(tree.find([48.0, 47.5]), Found::Tile(8));
        assert_eq!(tree.find([47.9, 47.5]), Found::Hole([32, 32], 4));
        assert_eq!(tree.find([33.0, 31.0]), Found::Hole([32, 0], 5));
        assert_eq!((tree.find([64.0, 0.0]), tree.find([0.0, -0.1])), (Found::Outside, Found::Outside));
        let Link::Node(root) = tree.root() else { panic!("the root has children") };
        assert_eq!(tree.node(root).highest_m, 9.0);
        let highest = |low, high| tree.highest_in(low, high, &|tile| if tile == 7 { 5.0 } else { 9.0 });
        assert_eq!(highest([1.0, 1.0], [50.0, 31.0]), 5.0);
        assert_eq!(highest([1.0, 1.0], [50.0, 33.0]), 9.0);
        assert_eq!(highest([49.0, 1.0], [50.0, 3.0]), f32::NEG_INFINITY);
        tree.clear(9, 0);
        tree.insert([0, 0], 0, 0, 1.0).unwrap();
        assert_eq!(tree.find([511.0, 3.0]), Found::Tile(0));
    }
}
